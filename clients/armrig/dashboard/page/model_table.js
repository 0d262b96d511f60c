// Table of the models: one row each, with a switch, numbers, verdicts, and buttons.

import { make } from "./elements.js";

export const COLOURS = 8; // of curves; each has three kinds of line

// Return the mean; a value that is not finite (null in JSON) is the worst of all.
const mean = (values, worst) => values.reduce((sum, x) => sum + (x ?? worst), 0) / values.length;
const lossesOf = ({ loss }) => [loss].flat();
const percent = (x) => (Math.abs(x) < 1e5 ? x.toFixed(2) : x.toExponential(2));
const short = (x) => (x !== 0 && Math.abs(x) < 1e-3 ? x.toExponential(3) : x.toPrecision(4));

// `of` is the value by which the column is sorted, and `way` the sign of the first sorting.
// `values` are numbers by output, and `better` is 1 if the largest number is the best.
const COLUMNS = [
  { title: "model", of: ({ place }) => place, way: 1 },
  { title: "fit simulated", of: ({ found }) => mean(Object.values(found.fit_simulated), -Infinity), way: -1, values: ({ fit_simulated: fits }) => fits, better: 1, text: percent, unit: " %" },
  { title: "fit one step ahead", of: ({ found }) => mean(Object.values(found.fit_predicted), -Infinity), way: -1, values: ({ fit_predicted: fits }) => fits, better: 1, text: percent, unit: " %" },
  { title: "residuals", of: ({ found }) => found.residuals.filter((one) => one.rejected).length, way: 1 },
  { title: "parameters", of: ({ found }) => found.parameters, way: 1, values: ({ parameters }) => ({ "": parameters }), better: -1, text: String, unit: "" },
  { title: "loss", of: ({ found }) => mean(lossesOf(found), Infinity), way: 1, values: (found) => Object.fromEntries(lossesOf(found).map((loss, i) => [lossesOf(found).length > 1 ? Object.keys(found.fit_simulated)[i] : "", loss])), better: -1, text: short, unit: "" },
  { title: "trust", of: ({ found }) => (found.trust ? 0 : 1), way: 1 },
];

let sorted = { column: COLUMNS[0], way: 1 };

// Replace the children of an element; the element with the same data-key keeps the focus.
export function refill(where, ...children) {
  const key = where.contains(document.activeElement) ? document.activeElement.dataset.key : "";
  where.replaceChildren(...children);
  if (key) [...where.querySelectorAll("[data-key]")].find((one) => one.dataset.key === key)?.focus();
}

// Return a small button; `key` identifies it after the table is drawn again.
export function keyed(key, text, does, properties = {}) {
  const made = make("button", { type: "button", textContent: text, "data-key": key, ...properties });
  made.addEventListener("click", does);
  return made;
}

// Return a piece of the model's line, with its colour.
export function swatch(colour) {
  const line = make("i", { className: "model-line", "aria-hidden": "true" });
  line.style.borderTopColor = `var(--m${colour % COLOURS})`;
  line.style.borderTopStyle = ["solid", "dashed", "dotted"][Math.floor(colour / COLOURS) % 3];
  return line;
}

// Show the rows. `acts` are the functions of the buttons: toggle, remove, retry, save, copy.
export function showTable(where, rows, acts) {
  const { column, way } = sorted;
  const numbered = rows.map((row, place) => ({ ...row, place, row }));
  const value = (one) => (one.found || column === COLUMNS[0] ? column.of(one) : Infinity * way);
  const order = [...numbered].sort((a, b) => way * (value(a) - value(b)) || a.place - b.place);
  const best = bestValues(rows.filter(({ found }) => found).map(({ found }) => found));
  const again = () => showTable(where, rows, acts);
  const head = make("tr", {}, ...COLUMNS.map((one) => heading(one, again)), make("th", { textContent: "" }));
  if (!rows.length) return refill(where);
  refill(where, make("table", {}, make("thead", {}, head), make("tbody", {}, ...order.map(({ row }) => line(row, best, acts)))));
}

function heading(column, again) {
  const isSorted = sorted.column === column;
  const press = () => {
    sorted = { column, way: isSorted ? -sorted.way : column.way };
    again();
  };
  const button = keyed(`sort ${column.title}`, `${column.title}${isSorted ? (sorted.way > 0 ? " ↑" : " ↓") : ""}`, press, { className: "sort" });
  return make("th", { className: column.values ? "n" : "", "aria-sort": isSorted ? (sorted.way > 0 ? "ascending" : "descending") : "none" }, button);
}

// Return the best text of each column by output. If all models are equal, no model is the best.
function bestValues(models) {
  const best = new Map();
  for (const column of COLUMNS.filter(({ values }) => values)) {
    const outputs = new Set(models.flatMap((found) => Object.keys(column.values(found))));
    const bestOf = (name) => {
      const values = models.map((found) => column.values(found)[name]).filter((x) => x !== undefined && x !== null);
      if (new Set(values.map(column.text)).size < 2) return "";
      return column.text(column.better * Math.max(...values.map((x) => column.better * x)));
    };
    best.set(column, Object.fromEntries([...outputs].map((name) => [name, bestOf(name)])));
  }
  return best;
}

function line(row, best, acts) {
  const { found, why, state } = row;
  const first = make("td", {}, switchOf(row, acts), ...about(row, acts));
  const numbers = (column) => make("td", { className: "n", "data-label": column.title }, ...(found ? figures(column, found, best.get(column)) : []));
  const words = found ? found.residuals.map((one) => make("div", { className: one.rejected ? "bad-text" : "", textContent: one.words, title: one.p === null ? "" : `p = ${one.p}` })) : [];
  if (!found) {
    const text = state === "failed" ? why : state === "estimating" ? "estimating …" : "waiting …";
    const reason = make("td", { className: state === "failed" ? "bad-text" : "hint", colSpan: COLUMNS.length - 1, textContent: text });
    return make("tr", { "data-state": state }, first, reason, buttons(row, acts));
  }
  const [, simulated, predicted, , parameters, loss] = COLUMNS;
  const trust = make("td", { "data-label": "trust", className: found.trust ? "good-text" : "warn-text", textContent: found.trust ? "trust" : "do not trust" });
  return make("tr", { "data-state": state }, first, numbers(simulated), numbers(predicted), make("td", { className: "residuals", "data-label": "residuals" }, ...words), numbers(parameters), numbers(loss), trust, buttons(row, acts));
}

function figures(column, found, best = {}) {
  const values = Object.entries(column.values(found));
  return values.map(([output, x]) => {
    const text = x === null ? "not finite" : column.text(x);
    const isBest = best[output] === text;
    const name = values.length > 1 ? `${output} ` : "";
    return make("div", { className: isBest ? "best" : "", title: `${x}${isBest ? ": the best of the column" : ""}` }, `${name}${text}${x === null ? "" : column.unit}${isBest ? " ★" : ""}`);
  });
}

const nameOf = ({ found, request }) => found?.name ?? request.file ?? `${String(request.structure).toUpperCase()} ${Object.values(request.orders ?? {}).join(" ")}`;

function switchOf(row, acts) {
  const made = keyed(`switch ${row.id}`, "", () => acts.toggle(row, made), { className: "switch" });
  made.append(swatch(row.colour), ` ${nameOf(row)}`);
  return showSwitch(made, row);
}

// Show the state of a model's switch, and return the switch.
export function showSwitch(button, { isOn }) {
  button.setAttribute("aria-pressed", String(isOn));
  button.title = isOn ? "Hide the curves of this model" : "Show the curves of this model";
  return button;
}

const STRUCTURE_FIELDS = ["structure", "orders", "nk"];

// Return the orders and options of a model as text.
function optionsOf({ found, request }) {
  const given = found?.orders ?? request.orders ?? {};
  if (typeof given === "string") return given;
  const orders = Object.entries(given).map(([name, n]) => `${name} ${typeof n === "object" ? JSON.stringify(n) : n}`);
  const options = Object.entries(request).filter(([name, value]) => value && !STRUCTURE_FIELDS.includes(name));
  return [...orders, ...options.map(([name, value]) => (value === true ? name : `${name} ${value}`))].join(", ");
}

function about(row, acts) {
  const { found } = row;
  const lines = [make("div", { className: "hint", textContent: optionsOf(row) })];
  if (!found) return lines;
  if (found.rejected) lines.push(make("div", { className: "bad-text", textContent: "the data reject this model", title: found.rejected }));
  if (row.saved) lines.push(make("div", { className: "good-text", textContent: `saved as ${row.saved}` }));
  const warnings = found.warnings.length ? [make("ul", {}, ...found.warnings.map((text) => make("li", { className: "warn-text", textContent: text })))] : [];
  const copied = (text, name) => (text ? [make("pre", { textContent: text }), keyed(`copy ${name} ${row.id}`, `Copy ${name}`, () => acts.copy(text, name))] : []);
  const title = `answer, command, Python${found.warnings.length ? `, warnings: ${found.warnings.length}` : ""}`;
  const noCommand = found.command ? [] : [make("p", { className: "hint", textContent: "No command has options for these treatments; the Python lines have them." })];
  const parts = make("details", { open: Boolean(row.isOpen) }, make("summary", { textContent: title, "data-key": `more ${row.id}` }), make("p", { textContent: found.answer }), ...warnings, ...copied(found.command, "command"), ...noCommand, ...copied(found.python, "Python"));
  parts.addEventListener("toggle", () => (row.isOpen = parts.open));
  return [...lines, parts];
}

function buttons(row, acts) {
  const { found, state } = row;
  const made = [];
  if (found && row.isSaving) made.push(savingForm(row, acts));
  else if (found) made.push(keyed(`save ${row.id}`, "Save", () => acts.beginSave(row), { title: "Save the model in the recordings' folder" }));
  if (state === "failed") made.push(keyed(`again ${row.id}`, "Again", () => acts.retry(row)));
  made.push(keyed(`remove ${row.id}`, "Remove", () => acts.remove(row), { "aria-label": `Remove ${nameOf(row)}` }));
  return make("td", { className: "row-buttons" }, ...made);
}

function savingForm(row, acts) {
  const name = make("input", { type: "text", maxLength: 100, required: true, "aria-label": "Name of the file", "data-key": `name ${row.id}`, value: row.fileName ?? nameOf(row).replace(/[^\p{L}\d]+/gu, "-").replace(/^-|-$/g, "").toLowerCase() });
  name.addEventListener("input", () => (row.fileName = name.value));
  const form = make("form", { autocomplete: "off" }, name, make("button", { type: "submit", className: "go", textContent: "Save", "data-key": `save ${row.id}` }));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    acts.save(row, name.value);
  });
  return form;
}
