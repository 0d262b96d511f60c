// One recording: its verdict, its curves with zoom, downloads.

import { chart } from "./chart.js";
import { ask, askJson, attempt, button, byId, make, notice, plural, setText } from "./elements.js";
import { aligned, chooser, curvesOf, differenceOf, legendOf, valuesText } from "./compared.js";
import { identify, report } from "./model.js";
import { save, savePng, saveSvg } from "./picture.js";
import { Replay } from "./replay.js";
import { outputsOf, presented } from "./signals.js";

let chosen = ""; // the file
let name = ""; // its @name
let seconds = 0;
let seen = null; // [from, to] in s while zoomed
let signals = []; // of its rig
let charts = [];
let others = []; // other recordings for a comparison, as {file, text}
let own = {}; // curves of this recording by signal, [x, least, largest]
let over = null; // source drawn over this recording: {name, file} or {name, curves}
let overCurves = {}; // its curves by signal
let isDifference = false; // the charts show the second source minus the first
let request = 0; // number of the newest request for curves; older answers are ignored

export const setUpRecording = () => new ResizeObserver(resize).observe(byId("one"));

export async function look(file, list = []) {
  chosen = file;
  others = list.filter((one) => one.file !== file);
  name = list.find((one) => one.file === file)?.text ?? file;
  [over, overCurves, isDifference] = [null, {}, false];
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
  signals = presented(found.signals, true);
  seen = null;
  const heading = make("h2", { textContent: name, title: file });
  const verdict = make("p", { className: rank(found), textContent: found.summary });
  const facts = make("dl", {}, ...pairs(found.about));
  // The verdict on usable data contains the findings.
  const findings = make(
    "ul",
    {},
    ...found.findings.filter(([level]) => level !== "good" && !found.usable).map(([level, about, text]) => make("li", { className: level === "unusable" ? "bad-text" : "warn-text", textContent: `${about}: ${text}` })),
  );
  const gaps = found.gaps.map(([t, count, reason]) => make("li", { textContent: `${t.toFixed(2)} s: ${plural(count, "sample")} missing: ${reason}` }));
  const notes = found.notes.map(([t, owner, text]) => make("li", {}, `${t.toFixed(2)} s, ${owner}: ${text}`));
  if (found.more_notes) notes.push(make("li", { textContent: `${found.more_notes} more; \`armrig info --verbose\` lists them` }));
  const where = make("div", { id: "curves" });
  const replay = new Replay(charts, () => own, () => seen || [0, seconds], found.arm ? outputsOf(signals).map(({ key }) => key) : []);
  const section = (title, items) => (items.length ? [make("h3", { textContent: title }), make("ul", {}, ...items)] : []);
  const about = [make("h3", { textContent: "Details" }), facts];
  byId("one").replaceChildren(heading, verdict, findings, buttons(), make("p", { id: "legend", hidden: true }), make("p", { className: "hint", id: "seen" }), where, make("div", { id: "model" }), make("div", { id: "reported" }), replay.element, ...section("Notes", notes), ...about, ...section("Missing samples", gaps));
  charts.push(...signals.map((signal, i) => curve(where, signal, i === signals.length - 1)));
  for (const u of charts) Object.assign(u, { marks: found.notes.map(([x, , text]) => ({ x, kind: "note", text })) });
  where.addEventListener("dblclick", () => attempt(() => zoom(null)));
  own = found.curves;
  draw();
  byId("one").scrollIntoView({ block: "nearest" }); // on a phone the recording is below the list
}

const rank = (found) => {
  if (!found.usable) return "bad-text";
  return found.findings.every(([level]) => level === "good") ? "good-text" : "warn-text";
};

const pairs = (rows) => rows.flatMap(([name, value]) => [make("dt", { textContent: name }), make("dd", { textContent: value })]);

function buttons() {
  const outputs = outputsOf(signals);
  const chosenOf = outputs.length > 1 ? [...outputs.map((one) => [one]), outputs] : [outputs];
  const output = make("select", { id: "output" }, ...chosenOf.map((some) => make("option", { value: some.map(({ key }) => key).join(","), textContent: some.map(({ label }) => label).join(" and ") })));
  output.setAttribute("aria-label", "Output of the model");
  return make(
    "p",
    { className: "tools" },
    chooser(others, (file) => attempt(() => lay(file ? { file, name: others.find((one) => one.file === file).text } : null))),
    makeDifference(),
    output,
    button("Identify", () => identify(chosen, output.value, layModel), "go"),
    button("Report", () => report(chosen, output.value)),
    make(
      "span",
      { className: "together", role: "group", "aria-label": "Save" },
      button("MCAP", () => download("mcap", { file: chosen }, chosen)),
      button("CSV", () => download("csv", { file: chosen, ...(seen ? { start: seen[0], stop: seen[1] } : {}) }, chosen.replace(/mcap$/, "csv"))),
      button("PNG", () => savePng(seenCharts(), pictureTitle(), chosen.replace(/\.mcap$/, ""))),
      button("SVG", () => saveSvg(seenCharts(), pictureTitle(), chosen.replace(/\.mcap$/, ""))),
    ),
    Object.assign(button("Whole length", () => zoom(null)), { id: "whole" }),
  );
}

const overText = () => (!over ? "" : isDifference ? `; ${over.name} minus ${name}` : `; dashed: ${over.name}`);

const pictureTitle = () => `${chosen}${overText()}`;

function makeDifference() {
  const made = button("Difference", () => {
    isDifference = !isDifference;
    for (const one of charts) one.wantedY = null;
    draw();
  });
  return Object.assign(made, { id: "difference", title: "Show the dashed curve minus the other curve", hidden: true });
}

function showLegend() {
  byId("legend").replaceChildren(...legendOf(name, over?.name, isDifference));
  for (const id of ["legend", "difference"]) byId(id).hidden = !over;
  byId("difference").setAttribute("aria-pressed", String(isDifference));
}

const seenCharts = () => charts.map((u, i) => ({ u, signal: signals[i] }));

function curve(where, signal, last) {
  const value = make("span", { className: "value" });
  const place = make("div", { className: "chart" }, make("div", { className: "chart-head" }, make("span", { className: `swatch ${signal.colour}` }), make("span", { textContent: `${signal.name} [${signal.unit}]` }), value));
  where.append(place);
  return chart(place, {
    signal,
    height: last ? 190 : 150,
    xLabel: last ? "s" : "",
    sync: "recording",
    over: "bad",
    namesMarks: signal === signals[0],
    stepped: signal.key === "u",
    onZoom: (from, to) => attempt(() => zoom([Math.max(0, from), Math.min(seconds, Math.max(to, from + 0.01))])),
    onCursor: (x) => (value.textContent = x === null ? "" : valuesText(signal, own[signal.key], overCurves[signal.key], x)),
  });
}

async function zoom(range) {
  if (!range) for (const one of charts) one.wantedY = null;
  const mine = ++request;
  const part = range || [0, seconds];
  const [found, other] = await Promise.all([curvesOf(chosen, part), over?.file ? curvesOf(over.file, part) : null]);
  if (mine !== request) return;
  [seen, own] = [range, found];
  overCurves = over?.file ? other : over?.curves || {};
  draw();
}

// Draw another recording, a model or nothing over the curves.
async function lay(what) {
  over = what;
  isDifference &&= Boolean(what);
  await zoom(seen);
}

async function layModel(model, curves) {
  byId("compared").value = "";
  await lay({ name: model, curves });
}

function draw() {
  const [from, to] = seen || [0, seconds];
  setText("seen", seen ? `${from.toFixed(2)} to ${to.toFixed(2)} s are shown; double-click for the whole length` : "drag across a plot or turn the wheel to zoom in time; turn the wheel with Shift to move, with Alt to zoom the values");
  byId("whole").hidden = !seen;
  showLegend();
  signals.forEach(({ key }, i) => {
    Object.assign(charts[i], { wanted: [from, to], isDifference });
    const [first, second] = [own[key], overCurves[key]];
    const isHidden = isDifference && !second;
    charts[i].setData(isHidden ? aligned([[], [], []]) : isDifference ? aligned(differenceOf(first, second, key === "u")) : aligned(first, second), true);
  });
}

function resize() {
  const width = byId("curves")?.clientWidth;
  if (!width) return;
  for (const one of charts) if (one.width !== width) one.setSize({ width, height: one.height });
}

async function download(what, body, file) {
  notice(`fetching ${file} …`);
  save(await (await ask(what, body)).blob(), file);
}
