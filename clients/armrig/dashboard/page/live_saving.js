// Saving of the visible part of the live plots, as a picture or as values.

import { attempt, byId } from "./elements.js";
import { save, savePng, saveSvg } from "./picture.js";

export function setUpSaving(plots) {
  const does = {
    png: (name, title) => savePng(chartsOf(plots), title, name),
    svg: (name, title) => saveSvg(chartsOf(plots), title, name),
    csv: (name) => saveCsv(plots, name),
  };
  for (const [kind, write] of Object.entries(does)) {
    byId(`live-${kind}`).addEventListener("click", () => {
      const now = new Date();
      attempt(async () => write(`live-${now.toISOString().slice(0, 19).replaceAll(":", "")}`, `${byId("title").textContent}, ${now.toLocaleString()}`));
    });
  }
}

const chartsOf = (plots) => plots.charts.map((u, i) => ({ u, signal: plots.signals[i] }));

// Return the visible bins, each with the least and the largest value of each signal.
function saveCsv(plots, name) {
  const { rows, described, reference, control, seen: { zero, from, to } } = plots;
  const head = [...described, ...(reference.length ? [{ name: "r", unit: control?.unit ?? "" }] : [])].flatMap(({ name: of, unit }) => [`${of} least [${unit}]`, `${of} largest [${unit}]`]);
  const lines = [["t [s]", ...head].join(",")];
  for (let i = rows.find(zero + from); i < rows.length && rows.at(i, 0) <= zero + to; i++) {
    const values = Array.from({ length: 1 + 2 * described.length }, (_, column) => rows.at(i, column));
    if (reference.length) values.push(...plots.referenceAt(rows.at(i, 0), {}));
    lines.push(values.map((value) => String(value).toLowerCase()).join(","));
  }
  save(new Blob([`${lines.join("\n")}\n`], { type: "text/csv" }), `${name}.csv`);
}
