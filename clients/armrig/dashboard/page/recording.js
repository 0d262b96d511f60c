// One recording: its verdict, its curves with zoom, downloads.

import { chart } from "./chart.js";
import { ask, askJson, attempt, byId, make, notice, setText } from "./elements.js";
import { aligned, chooser, curvesOf } from "./compared.js";
import { identify } from "./model.js";
import { save, savePng, saveSvg } from "./picture.js";
import { Replay } from "./replay.js";

const SIGNALS = [
  { key: "u", name: "u", unit: "V", range: [0, 5], pad: 0.3, digits: 3, splits: [0, 1, 2, 3, 4, 5] },
  { key: "theta_1", name: "θ₁, turns counted", unit: "°", range: null, least: 1, digits: 2 },
  { key: "alpha", name: "α", unit: "°", range: null, least: 1, digits: 2 },
];

let chosen = ""; // the file
let seconds = 0;
let seen = null; // [from, to] in s while zoomed
let charts = [];
let others = []; // other recordings for a comparison, as {file, text}
let over = null; // curves drawn over this recording's: {name, file} or {name, signal, curve}
let request = 0; // number of the newest request for curves; older answers are ignored

export const setUpRecording = () => new ResizeObserver(resize).observe(byId("one"));

export async function look(file, list = []) {
  chosen = file;
  others = list.filter((one) => one.file !== file);
  over = null;
  request += 1; // curves that arrive late are of another recording
  for (const one of charts) one.destroy();
  charts = [];
  byId("one").replaceChildren(make("p", { textContent: `reading ${file} …` }));
  let found;
  try {
    found = await askJson("recording", { file });
  } catch (error) {
    byId("one").replaceChildren(make("p", { className: "bad-text", textContent: error.message }));
    return;
  }
  if (file !== chosen) return;
  seconds = found.seconds;
  seen = null;
  const heading = make("h2", { textContent: file });
  const verdict = make("p", { className: rank(found), textContent: found.summary });
  const facts = make("dl", {}, ...pairs(found.about));
  const findings = make(
    "ul",
    {},
    ...found.findings.filter(([level]) => level !== "good").map(([level, about, text]) => make("li", { className: level === "unusable" ? "bad-text" : "warn-text", textContent: `${about}: ${text}` })),
  );
  const gaps = found.gaps.map(([t, count, reason]) => make("li", { textContent: `${t.toFixed(2)} s: ${count} samples missing: ${reason}` }));
  const notes = found.notes.map(([t, owner, text]) => make("li", {}, `${t.toFixed(2)} s, ${owner}: ${text}`));
  if (found.more_notes) notes.push(make("li", { textContent: `${found.more_notes} more; \`armrig info --verbose\` lists them` }));
  const where = make("div", { id: "curves" });
  const replay = new Replay(charts, () => seen || [0, seconds]);
  const section = (title, items) => (items.length ? [make("h3", { textContent: title }), make("ul", {}, ...items)] : []);
  const about = [make("h3", { textContent: "Details" }), facts];
  byId("one").replaceChildren(heading, verdict, findings, buttons(), make("p", { className: "hint", id: "seen" }), where, replay.element, ...section("Notes", notes), ...about, ...section("Missing samples", gaps), make("div", { id: "model" }));
  charts.push(...SIGNALS.map((signal, i) => curve(where, signal, i === SIGNALS.length - 1)));
  charts.forEach((u, i) => Object.assign(u, { marks: found.notes.map(([x]) => ({ x, kind: "note" })), namesMarks: i === 0 }));
  where.addEventListener("dblclick", () => attempt(() => zoom(null)));
  draw(found.curves);
}

const rank = (found) => {
  if (!found.usable) return "bad-text";
  return found.findings.every(([level]) => level === "good") ? "good-text" : "warn-text";
};

const pairs = (rows) => rows.flatMap(([name, value]) => [make("dt", { textContent: name }), make("dd", { textContent: value })]);

function buttons() {
  const output = make("select", { id: "output" }, make("option", { value: "theta_1", textContent: "θ₁" }), make("option", { value: "alpha", textContent: "α" }));
  output.setAttribute("aria-label", "Output of the model");
  return make(
    "p",
    { className: "tools" },
    button("Download MCAP", () => download("mcap", { file: chosen }, chosen)),
    button("CSV of what is seen", () => download("csv", { file: chosen, ...(seen ? { start: seen[0], stop: seen[1] } : {}) }, chosen.replace(/mcap$/, "csv"))),
    button("Picture, PNG", () => savePng(seenCharts(), pictureTitle(), chosen.replace(/\.mcap$/, ""))),
    button("Picture, SVG", () => saveSvg(seenCharts(), pictureTitle(), chosen.replace(/\.mcap$/, ""))),
    button("Whole length", () => zoom(null)),
    chooser(others, (file) => attempt(() => lay(file ? { file, name: file } : null))),
    output,
    button("Identify", () => identify(chosen, output.value, layModel), "go"),
    button("Report", () => download("report", { file: chosen }, chosen.replace(/mcap$/, "pdf"))),
  );
}

const dashed = () => (over ? `; dashed: ${over.name}` : "");

const pictureTitle = () => `${chosen}${dashed()}`;

const seenCharts = () => charts.map((u, i) => ({ u, signal: SIGNALS[i] }));

function button(text, does, className = "") {
  const made = make("button", { type: "button", textContent: text, className });
  made.addEventListener("click", () =>
    attempt(async () => {
      made.disabled = true;
      try {
        await does();
      } finally {
        made.disabled = false;
      }
    }),
  );
  return made;
}

function curve(where, signal, last) {
  const value = make("span", { className: "value" });
  const place = make("div", { className: "chart" }, make("div", { className: "chart-head" }, make("span", { className: `swatch ${signal.key}` }), make("span", { textContent: `${signal.name} [${signal.unit}]` }), value));
  where.append(place);
  return chart(place, {
    signal,
    height: last ? 190 : 150,
    xLabel: last ? "s" : "",
    sync: "recording",
    compares: true,
    stepped: signal.key === "u",
    onZoom: (from, to) => attempt(() => zoom([Math.max(0, from), Math.min(seconds, Math.max(to, from + 0.01))])),
    onCursor: (x, u) => (value.textContent = valueAt(u, signal, x)),
  });
}

function valueAt(u, signal, x) {
  let i = u.cursor.idx;
  if (x === null || i === null || i === undefined) return "";
  while (i > 0 && u.data[1][i] === undefined) i -= 1; // skip the points of the other curve
  if (u.data[1][i] == null) return "";
  const [least, largest] = [u.data[1][i], u.data[2][i]].map((value) => value.toFixed(signal.digits));
  return `${least === largest ? least : `${least} … ${largest}`} ${signal.unit} at ${u.data[0][i].toFixed(3)} s`;
}

async function zoom(range) {
  if (!range) for (const one of charts) one.wantedY = null;
  const mine = ++request;
  const part = range || [0, seconds];
  const [found, other] = await Promise.all([curvesOf(chosen, part), over?.file ? curvesOf(over.file, part) : null]);
  if (mine !== request) return;
  seen = range;
  draw(found, other);
}

// Draw another recording, a model or nothing over the curves.
async function lay(what) {
  over = what;
  await zoom(seen);
}

async function layModel(name, signal, curve) {
  byId("compared").value = "";
  await lay({ name, signal, curve });
}

function draw(found, other) {
  const overOf = (key) => (over?.file ? other?.[key] : over?.signal === key ? over.curve : null);
  const [from, to] = seen || [0, seconds];
  setText("seen", (seen ? `${from.toFixed(2)} to ${to.toFixed(2)} s are shown; double-click for the whole length` : "drag across a plot or turn the wheel to zoom in time; turn the wheel with Shift to move, with Alt to zoom the values") + dashed());
  SIGNALS.forEach((signal, i) => {
    charts[i].wanted = [from, to];
    charts[i].setData(aligned(found[signal.key], overOf(signal.key)), true);
  });
}

function resize() {
  const width = byId("curves")?.clientWidth;
  if (!width) return;
  for (const one of charts) if (one.width !== width) one.setSize({ width, height: one.height });
}

async function download(what, body, name) {
  notice(what === "report" ? "typesetting the report …" : `fetching ${name} …`);
  save(await (await ask(what, body)).blob(), name);
}
