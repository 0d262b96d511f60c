// List of the recordings; the page filters and sorts the list.

import { askJson, attempt, byId, make, setText } from "./elements.js";
import { look, setUpRecording } from "./recording.js";

const COLUMNS = [
  { title: "recording", of: (one) => one.at },
  { title: "started", of: (one) => Date.parse(one.started) || 0, first: -1 },
  { title: "length", of: (one) => one.seconds, first: -1 },
  { title: "missing", of: (one) => one.missing, first: -1 },
];

let chosen = ""; // the file
let found = { recordings: [], left_out: [] };
let sorted = { column: COLUMNS[1], way: -1 };

const kindOf = (one) => `${one.experiment}${one.validation ? ", validation" : ""}`;

export function setUpRecordings() {
  byId("again").addEventListener("click", () => attempt(() => listRecordings()));
  byId("filter").addEventListener("input", fill);
  setUpRecording();
}

export async function listRecordings(file) {
  found = await askJson("recordings", {});
  const more = found.count > found.recordings.length ? `, the newest ${found.recordings.length} of ${found.count}` : "";
  setText("folder", `in ${found.folder}${more}`);
  fill();
  if (file) await choose(file);
}

function fill() {
  const words = byId("filter").value.toLowerCase().split(/\s+/);
  const text = (one) => [one.at, kindOf(one), one.run_id, one.started, one.outcome, one.file].join(" ").toLowerCase();
  const { column, way } = sorted;
  const order = (a, b) => way * (column.of(a) < column.of(b) ? -1 : column.of(a) > column.of(b) ? 1 : 0);
  const rows = found.recordings.filter((one) => words.every((word) => text(one).includes(word))).sort(order);
  const empty = found.recordings.length ? "No recording has these words." : "There are no recordings yet: run an experiment on the page Live.";
  byId("table").replaceChildren(
    rows.length ? make("table", {}, make("thead", {}, make("tr", {}, ...COLUMNS.map(head))), make("tbody", {}, ...rows.map(row))) : make("p", { textContent: empty }),
    ...found.left_out.map((why) => make("p", { className: "warn-text", textContent: why })),
  );
  mark();
}

function head(column, i) {
  const isSorted = sorted.column === column;
  const button = make("button", { type: "button", className: "sort", textContent: `${column.title}${isSorted ? (sorted.way > 0 ? " ↑" : " ↓") : ""}` });
  button.addEventListener("click", () => {
    sorted = { column, way: isSorted ? -sorted.way : (column.first ?? 1) };
    fill();
  });
  return make("th", { className: i > 0 ? "n" : "", "aria-sort": isSorted ? (sorted.way > 0 ? "ascending" : "descending") : "none" }, button);
}

function row(one) {
  const button = make("button", { type: "button", textContent: one.at, title: `${one.at}, ${one.file}` });
  button.addEventListener("click", () => attempt(() => choose(one.file)));
  button.dataset.file = one.file;
  const kind = make("span", { className: "kind", textContent: kindOf(one) });
  const early = one.outcome_code === "complete" ? [] : [make("div", { className: "warn-text early", textContent: `ended early: ${one.outcome}`, title: one.outcome })];
  return make(
    "tr",
    {},
    make("td", {}, button, " ", kind, ...early),
    make("td", { title: one.started, className: "n", textContent: `${one.started.slice(0, 10)} ${one.started.slice(11, 16)}` }),
    make("td", { className: "n", textContent: `${one.seconds.toPrecision(4) * 1} s` }),
    make("td", { className: `n ${one.missing ? "warn-text" : ""}`, textContent: one.missing }),
  );
}

async function choose(file) {
  chosen = file;
  mark();
  await look(file, found.recordings.map((one) => ({ file: one.file, text: one.at })));
}

function mark() {
  for (const button of byId("table").querySelectorAll("button")) {
    if (button.dataset.file) button.setAttribute("aria-pressed", String(button.dataset.file === chosen));
  }
}
