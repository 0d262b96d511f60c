// Forms of the view Models: the data with their treatment, and a model by hand.

import { make } from "./elements.js";
import { keyed, refill } from "./model_table.js";

const TREATMENTS = [
  { kind: "means", text: "remove the means", fields: [] },
  { kind: "trend", text: "remove the trend", fields: [] },
  { kind: "part", text: "from … to …", fields: ["start", "stop"] },
  { kind: "resample", text: "resample", fields: ["Ts"] },
  { kind: "mask", text: "outputs missing from … to …", fields: ["start", "stop"] },
];
const LABELS = { start: "from [s]", stop: "to [s]", Ts: "sampling time [s]" };

// Return a treatment as text.
function stepText({ kind, start, stop, Ts }) {
  if (kind === "resample") return `resample to ${Ts} s`;
  const range = [start === undefined ? "" : `from ${start} s`, stop === undefined ? "" : `to ${stop} s`].filter(Boolean).join(" ");
  if (kind === "part") return range || "the whole length";
  if (kind === "mask") return `outputs missing ${range}`;
  return TREATMENTS.find((one) => one.kind === kind)?.text ?? kind;
}

const label = (text, field, isWide) => make("label", { className: isWide ? "wide" : "" }, text, field);

function select(key, options, chosen, changed) {
  const made = make("select", { "data-key": key }, ...options.map(([value, textContent]) => make("option", { value, textContent })));
  made.value = chosen;
  made.addEventListener("change", () => changed(made.value));
  return made;
}

// Show the data. `recordings` are those of the list, and `change` asks for changed data.
export function showData(where, { data, facts, error, isBusy, recordings }, change) {
  if (!data) return refill(where, make("p", { className: error ? "bad-text" : "hint", textContent: error || "There are no recordings yet: run an experiment on the page Live." }));
  const files = recordings.map(({ file, at, experiment }) => [file, `${at} ${experiment}`]);
  const list = (value) => (files.some(([file]) => file === value) || !value ? files : [[value, value], ...files]);
  const other = { validation: null, inputs: [], outputs: [], treatments: [] };
  const estimation = select("estimation", list(data.file), data.file, (file) => change({ ...other, file }));
  const halves = [["", "second half of the recording"]];
  const validation = select("validation", [...halves, ...list(data.validation).filter(([file]) => file !== data.file)], data.validation ?? "", (file) => change({ validation: file }));
  const signals = (title, name) => {
    const chosen = data[name] ?? [];
    const toggle = (signal) => {
      const isIn = chosen.includes(signal);
      change({ [name]: isIn ? chosen.filter((one) => one !== signal) : [...chosen, signal], ...(facts.isImport && !isIn ? { [name === "inputs" ? "outputs" : "inputs"]: data[name === "inputs" ? "outputs" : "inputs"].filter((one) => one !== signal) } : {}) });
    };
    const buttons = (facts?.[name] ?? []).map((signal) => keyed(`${name} ${signal.name}`, `${signal.name}${signal.unit ? ` [${signal.unit}]` : ""}`, () => toggle(signal.name), { "aria-pressed": String(chosen.includes(signal.name)) }));
    return make("div", { className: "tools", role: "group", "aria-label": title }, make("span", { className: "hint", textContent: title }), ...buttons);
  };
  const steps = (data.treatments ?? []).map((step, i) => make("li", {}, `${stepText(step)} `, keyed(`step ${i}`, "Remove", () => change({ treatments: data.treatments.filter((_, k) => k !== i) }), { "aria-label": `Remove the treatment: ${stepText(step)}` })));
  refill(
    where,
    make("form", {}, label("estimation", estimation, true), label("validation", validation, true)),
    signals("inputs", "inputs"),
    signals("outputs", "outputs"),
    make("h3", { textContent: "Treatment" }),
    steps.length ? make("ol", {}, ...steps) : make("p", { className: "hint", textContent: "none" }),
    treatmentForm((step) => change({ treatments: [...data.treatments, step] })),
    make("p", { className: "bad-text", role: "alert", textContent: error }),
    make("p", { className: "hint", textContent: isBusy ? "reading the data …" : "" }),
    ...(facts ? aboutData(facts) : []),
  );
}

function treatmentForm(add) {
  const fields = Object.fromEntries(Object.keys(LABELS).map((name) => [name, make("input", { type: "number", step: "any", min: 0, "data-key": `treatment ${name}` })]));
  const labels = Object.entries(fields).map(([name, field]) => [name, label(LABELS[name], field)]);
  const showFields = (kind) => {
    const wanted = TREATMENTS.find((one) => one.kind === kind).fields;
    for (const [name, one] of labels) one.hidden = !wanted.includes(name);
    fields.Ts.required = kind === "resample";
  };
  const kind = select("treatment", TREATMENTS.map((one) => [one.kind, one.text]), "means", showFields);
  showFields("means");
  const form = make("form", { autocomplete: "off" }, label("another step", kind, true), ...labels.map(([, one]) => one), make("button", { type: "submit", className: "wide", textContent: "Add the step", "data-key": "add" }));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    const wanted = TREATMENTS.find((one) => one.kind === kind.value).fields.filter((name) => fields[name].value !== "");
    add({ kind: kind.value, ...Object.fromEntries(wanted.map((name) => [name, Number(fields[name].value)])) });
  });
  return form;
}

function aboutData(facts) {
  const { verdict, N, Ts, seconds, judged, sha256, validation_sha256: other, history } = facts;
  const hashes = [sha256, other].filter(Boolean).map((hash) => hash.slice(0, 12));
  return [
    make("p", { className: verdict.usable ? "good-text" : "bad-text", textContent: verdict.summary }),
    make("p", { className: "hint", textContent: `${N} samples, ${+seconds.toPrecision(4)} s at Ts = ${Ts} s; models are judged on ${judged}` }),
    make("p", { className: "hint", textContent: `sha256 ${hashes.join(", ")}` }),
    make("details", {}, make("summary", { textContent: "history of the data", "data-key": "history" }), make("ul", {}, ...history.map((textContent) => make("li", { textContent })))),
  ];
}

// Show the form of a model by hand. `estimate` is called with the request.
export function showHandForm(where, structures, estimate) {
  const fields = make("div", { className: "wide hand-fields" });
  const equation = make("p", { className: "hint wide" });
  let read = () => ({});
  const choose = (name) => {
    const structure = structures.find((one) => one.name === name);
    equation.textContent = `${structure.equation}${structure.several ? "" : "; for one input and one output"}`;
    const orders = Object.entries({ ...structure.orders, ...(structure.has_nk ? { nk: 1 } : {}) }).map(([order, n]) => [order, make("input", { type: "number", min: 0, step: 1, value: n ?? "", placeholder: "automatic" })]);
    const options = structure.options.map((option) => [option.name, ...optionField(option)]);
    fields.replaceChildren(...orders.map(([text, field]) => label(text, field)), ...options.map(([, field]) => field));
    read = () => {
      const numbers = Object.fromEntries(orders.map(([order, { value }]) => [order, value === "" ? null : Number(value)]));
      const { nk, ...counts } = numbers;
      const given = options.map(([option, , valueOf]) => [option, valueOf()]).filter(([, value]) => value);
      return { structure: name, orders: counts, ...(structure.has_nk ? { nk: nk ?? 1 } : {}), ...Object.fromEntries(given) };
    };
  };
  const structure = select("structure", structures.map((one) => [one.name, one.title]), "oe", choose);
  choose("oe");
  const form = make("form", { autocomplete: "off" }, label("structure", structure, true), equation, fields, make("button", { type: "submit", className: "go wide", textContent: "Estimate" }));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    estimate(read());
  });
  where.replaceChildren(form);
}

// Return the field of an option, and a function that returns its value.
function optionField({ name, kind, choices, help }) {
  if (kind === "flag") {
    const press = () => made.setAttribute("aria-pressed", String(made.getAttribute("aria-pressed") === "false"));
    const made = keyed(`option ${name}`, name, press, { "aria-pressed": "false", title: help });
    return [made, () => made.getAttribute("aria-pressed") === "true"];
  }
  const field = kind === "choice" ? select(`option ${name}`, [["", "default"], ...choices.map((one) => [one, one])], "", () => {}) : make("input", { type: "text", maxLength: 40 });
  field.title = help;
  return [label(name, field), () => field.value.trim()];
}
