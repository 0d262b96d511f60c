// The list of what was recorded.

import { askJson, attempt, byId, make, setText } from "./elements.js";
import { look, setUpRecording } from "./recording.js";

let chosen = ""; // the file

export function setUpRecordings() {
  byId("again").addEventListener("click", () => attempt(() => listRecordings()));
  setUpRecording();
}

export async function listRecordings(file) {
  const found = await askJson("recordings", {});
  const more = found.count > found.recordings.length ? `, the newest ${found.recordings.length} of ${found.count}` : "";
  setText("folder", `in ${found.folder}${more}`);
  const rows = found.recordings.map((one) => {
    const button = make("button", { type: "button", textContent: `${one.experiment}${one.name ? ` ${one.name}` : ""}${one.validation ? ", validation" : ""}`, title: one.file });
    button.addEventListener("click", () => attempt(() => choose(one.file)));
    button.dataset.file = one.file;
    const outcome = one.outcome === "complete" ? "" : one.outcome;
    return make(
      "tr",
      {},
      make("td", {}, button, outcome ? make("div", { className: "warn-text", textContent: outcome }) : ""),
      make("td", { title: one.started, className: "n time" }, ...time(one.started)),
      make("td", { className: "n", textContent: `${one.seconds.toPrecision(4) * 1} s` }),
      make("td", { className: `n ${one.missing ? "warn-text" : ""}`, textContent: one.missing }),
    );
  });
  const head = ["recording", "started", "length", "missing"].map((text, i) => make("th", { className: i > 0 ? "n" : "", textContent: text }));
  byId("table").replaceChildren(
    rows.length
      ? make("table", {}, make("thead", {}, make("tr", {}, ...head)), make("tbody", {}, ...rows))
      : make("p", { textContent: "There are no recordings yet: run an experiment on the page Live." }),
    ...found.left_out.map((text) => make("p", { className: "warn-text", textContent: `not whole: ${text}` })),
  );
  if (file) await choose(file);
  else mark();
}

// Day and hour: between them the line may break, and nowhere else.
const time = (iso) => [make("span", { textContent: iso.slice(0, 10) }), " ", make("span", { textContent: iso.slice(11, 16) })];

async function choose(file) {
  chosen = file;
  mark();
  await look(file);
}

function mark() {
  for (const button of byId("table").querySelectorAll("button")) {
    button.setAttribute("aria-pressed", String(button.dataset.file === chosen));
  }
}
