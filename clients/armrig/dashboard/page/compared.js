// Curves drawn over the curves of a recording: those of another recording, or of a model.

import { askJson, make } from "./elements.js";

// Return the curves [x, least, largest] of two sources on a common x, for uPlot. Where only one
// source has a point, the other source has undefined, so that its line does not break there.
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

// Return a menu of the other recordings; `changed` is called with the chosen file, "" for none.
export function chooser(files, changed) {
  const select = make("select", { id: "compared", "aria-label": "Compare with" }, make("option", { value: "", textContent: "compare with nothing" }));
  for (const { file, text } of files) select.append(make("option", { value: file, textContent: text }));
  select.addEventListener("change", () => changed(select.value));
  return select;
}

// Return the curves of another recording in the same range of time.
export const curvesOf = (file, [start, stop]) => askJson("curves", { file, start, stop });
