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

// Return the number of the last point at t or earlier; -1 before the first point.
function placeOf(x, t) {
  let [a, b] = [-1, x.length];
  while (b - a > 1) {
    const middle = (a + b) >> 1;
    if (x[middle] <= t) a = middle;
    else b = middle;
  }
  return a;
}

// Return the least and the largest value of a curve at a time; null if they are not known.
export function valuesAt([x, low, high], t) {
  const i = placeOf(x, t);
  return i < 0 || low[i] === null ? null : [low[i], high[i]];
}

// Return the curve of the second source minus the first, at the times of the first; u holds its value.
export function differenceOf(first, second, isHeld) {
  const differences = first[0].map((t, i) => {
    const other = isHeld ? middleOf(valuesAt(second, t)) : between(second, t);
    return first[1][i] === null || other === null ? null : other - middleOf([first[1][i], first[2][i]]);
  });
  return [first[0], differences, differences];
}

const middleOf = (values) => values && (values[0] + values[1]) / 2;

// Return the value of a curve at a time, on the straight line between its points.
function between([x, low, high], t) {
  const i = placeOf(x, t);
  if (i < 0 || low[i] === null) return null;
  const here = middleOf([low[i], high[i]]);
  if (x[i] === t) return here;
  if (i + 1 === x.length || low[i + 1] === null) return null;
  return here + ((t - x[i]) / (x[i + 1] - x[i])) * (middleOf([low[i + 1], high[i + 1]]) - here);
}

// Return the values of one or two curves at a time as text, with the difference of two curves.
export function valuesText({ unit, digits }, first, second, x) {
  const text = (values) => (values ? [...new Set(values.map((value) => value.toFixed(digits)))].join(" … ") : "not known");
  const [a, b] = [first, second].map((curve) => curve && valuesAt(curve, x));
  if (!second) return a ? `${text(a)} ${unit} at ${x.toFixed(3)} s` : "";
  const apart = a && b ? `, difference ${(middleOf(b) - middleOf(a)).toFixed(digits)}` : "";
  return `${text(a)} and ${text(b)}${apart} ${unit} at ${x.toFixed(3)} s`;
}

// Return the entries of the legend, each with a line as in the charts.
export function legendOf(name, over, isDifference) {
  const entry = (kind, text) => make("span", {}, make("i", { className: `line ${kind}` }), text);
  if (!over) return [];
  return isDifference ? [entry("solid", `${over} minus ${name}`)] : [entry("solid", name), entry("dashed", over)];
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
