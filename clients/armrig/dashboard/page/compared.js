// What is laid over the curves of a recording: those of another one, or of a model.

import { askJson, make } from "./elements.js";

// Curves [x, least, largest] of two sources on one x, for uPlot: undefined where only the other has
// a point, so that no line breaks there.
export function aligned(first, second) {
  if (!second) return [...first, first[0].map(() => null), first[0].map(() => null)];
  const x = [...new Set([...first[0], ...second[0]])].sort((a, b) => a - b);
  const place = new Map(x.map((t, i) => [t, i]));
  const spread = ([times, ...columns]) =>
    columns.map((column) => {
      const made = new Array(x.length).fill(undefined);
      times.forEach((t, i) => (made[place.get(t)] = column[i]));
      return made;
    });
  return [x, ...spread(first), ...spread(second)];
}

// A choice of the other recordings; `changed` is called with its file, "" for none.
export function chooser(files, changed) {
  const select = make("select", { id: "compared", "aria-label": "Compare with" }, make("option", { value: "", textContent: "compare with nothing" }));
  for (const { file, text } of files) select.append(make("option", { value: file, textContent: text }));
  select.addEventListener("change", () => changed(select.value));
  return select;
}

// The curves of another recording in the same part.
export const curvesOf = (file, [start, stop]) => askJson("curves", { file, start, stop });
