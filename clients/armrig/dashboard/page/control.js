// Commands to the rig: arm, release, and an experiment with its preview.

import { chart } from "./chart.js";
import { askJson, attempt, byId, make, notice, owner, plural, setText, show } from "./elements.js";
import { chosenLaw, listLaws, showLaw } from "./laws.js";
import { presented, scaleText } from "./signals.js";
import { duration, isStale } from "./status.js";

const LEVELS = ["low", "high"];
const RANDOM = ["input", "seconds", ...LEVELS, "a", "seed"];
const KINDS = {
  blackbox: { title: "black box: a random input to the whole rig", fields: RANDOM, seconds: 30 },
  greybox: { fields: RANDOM, seconds: 30 },
  step: { title: "step: time constant, delay, gain", fields: ["seconds", "at", ...LEVELS], seconds: 5 },
  staircase: { title: "staircase: the static curve", fields: ["seconds", "levels", ...LEVELS], seconds: 30 },
  csv: { title: "an input of your own, from a CSV file", fields: ["file"] },
  control: { title: "control: a law in a closed loop", fields: ["law", "reference", "seconds", "levels", "r_low", "r_high", "word"], seconds: "" },
};
const FIELDS = {
  input: { label: "input", options: ["telegraph", "prbs", "white", "multisine", "chirp"] },
  law: { label: "law", options: [] },
  reference: { label: "reference", options: ["step", "staircase"] },
  seconds: { label: "length [s]", value: 30, step: "any", min: 0 },
  at: { label: "step at [s]", value: 1, step: "any", min: 0 },
  levels: { label: "levels", value: 6, min: 2 },
  r_low: { label: "lowest r", step: "any" },
  r_high: { label: "highest r", step: "any" },
  low: { label: "lower level [V]", value: 0.5, step: "any", min: 0, max: 5 },
  high: { label: "upper level [V]", value: 4.5, step: "any", min: 0, max: 5 },
  a: { label: "switch probability", value: 0.05, step: "any", min: 0, max: 1 },
  seed: { label: "seed", value: 1, min: 0 },
  file: { label: "file: a row with u, or t and u, for each sample", type: "file" },
  word: { label: "word", type: "text", maxLength: 20 },
  Ts: { label: "sampling time [s]", step: "any", min: 0, placeholder: "the rig's" },
  name: { label: "name for the recording", type: "text", pattern: "[a-z0-9\\-]{0,20}", placeholder: "a-z, 0-9, -" },
};
const MOST_FILE = 6 << 20;

let shown = null; // the experiment in the preview
let plot = null;
let asking = new AbortController(); // aborts the newest request for a run
let newest = { is_going: false, experiment: "" }; // run of this page
let going = false;
let status = {};
let look = () => {};
let suggestion = {}; // sampling time, lengths and levels that suit the rig
let scale = null; // scale of an input that rests at another voltage than 0 V: levels are its own values

export function setUpControl(lookAt) {
  look = lookAt;
  const form = byId("experiment");
  const kind = make("select", { id: "kind" });
  for (const [name, { title }] of Object.entries(KINDS)) kind.append(make("option", { value: name, textContent: title ?? "" }));
  form.append(make("label", { className: "wide" }, "experiment", kind));
  for (const name of Object.keys(FIELDS)) form.append(field(name));
  const who = make("input", { id: "owner-name", maxLength: 80, required: true, value: localStorage.getItem("armrig-owner") || "dashboard" });
  who.addEventListener("change", () => localStorage.setItem("armrig-owner", who.value));
  form.append(make("p", { id: "input-unit", className: "hint wide", hidden: true }));
  form.append(make("label", { className: "wide" }, "your name, for others to read", who));
  form.append(make("button", { id: "show", type: "submit", textContent: "Preview" }), make("button", { id: "run", type: "button", className: "go", textContent: "Run" }));
  kind.addEventListener("change", chooseKind);
  byId("label-law").className = byId("label-word").className = "wide";
  form.append(make("ul", { id: "law-faults", className: "hint wide", hidden: true }));
  for (const name of ["law", "reference"]) byId(`field-${name}`).addEventListener("change", showFields);
  form.addEventListener("input", (event) => event.target !== who && forget());
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(preview);
  });
  byId("run").addEventListener("click", () => attempt(run));
  byId("new-reference").addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(() => askJson("reference", { r: Number(byId("new-r").value) }));
  });
  byId("look").addEventListener("click", () => look(byId("look").dataset.file));
  byId("arm").addEventListener("click", () => attempt(arm));
  byId("release").addEventListener("click", () => attempt(release));
  chooseKind();
}

// Offer the experiments of a rig; the grey box is for a rig with a body that moves alone.
export function describeRig({ signals, body, suggested = {} }) {
  suggestion = suggested;
  const kind = byId("kind");
  const option = [...kind.children].find(({ value }) => value === "greybox");
  option.hidden = !body;
  if (body) option.textContent = `grey box: a random input to the ${body} alone`;
  if (!body && kind.value === "greybox") {
    kind.value = "blackbox";
    chooseKind();
  }
  const [{ label, own }] = signals;
  show("input-unit", Boolean(own));
  scale = own?.[3] ? own : null;
  if (own) setText("input-unit", `${label} is ${scaleText(own)}${scale ? `. Levels are values of ${label}, and ${ownValue(own[3])} ${own[2]} is rest` : ""}.`);
  if (scale) describeLevels(own);
  for (const [name, value] of Object.entries(suggestion)) {
    if (name in FIELDS && name !== "seconds") byId(`field-${name}`).value = scale && LEVELS.includes(name) ? ownValue(value) : value;
  }
  chooseKind();
}

function describeLevels(own) {
  setText("arm", "Arm at rest");
  for (const level of LEVELS) {
    const { label: text, min, max } = FIELDS[level];
    const input = byId(`field-${level}`);
    byId(`label-${level}`).replaceChildren(text.replace("[V]", `[${own[2]}]`), input);
    [input.min, input.max] = [ownValue(min), ownValue(max)].sort((a, b) => a - b);
    input.value = ownValue(level === "low" ? 0.2 * own[3] : own[3] + 0.8 * (max - own[3]));
  }
}

// Return the value of the input at a voltage of the pin, and the voltage of a value.
const ownValue = (volts) => +(scale[1] + scale[0] * volts).toPrecision(6);
const voltsOf = (value) => +((value - scale[1]) / scale[0]).toFixed(9);

function field(name) {
  const { label, options, ...how } = FIELDS[name];
  const input = options ? make("select", { id: `field-${name}` }) : make("input", { id: `field-${name}`, type: "number", ...how });
  for (const option of options || []) input.append(make("option", { value: option, textContent: option }));
  const made = make("label", { id: `label-${name}` }, label, input);
  if (how.type === "file") {
    input.accept = ".csv,.txt";
    made.className = "wide";
  }
  return made;
}

// Show the fields of the chosen experiment; the sampling time of a law is in its file.
function showFields() {
  const kind = byId("kind").value;
  const isControl = kind === "control";
  const hidden = isControl ? showLaw() : [];
  const common = isControl ? ["name"] : ["Ts", "name"];
  for (const name of Object.keys(FIELDS)) show(`label-${name}`, (KINDS[kind].fields.includes(name) || common.includes(name)) && !hidden.includes(name));
  show("law-faults", isControl);
}

function chooseKind() {
  const { seconds } = KINDS[byId("kind").value];
  showFields();
  if (byId("kind").value === "control") attempt(async () => showFields(await listLaws()));
  if (seconds !== undefined) byId("field-seconds").value = suggestion.seconds?.[byId("kind").value] ?? seconds;
  forget();
}

function forget() {
  show("preview", false);
  offer(null);
}

// Offer the run of an experiment whose preview is shown; null for no experiment.
export function offer(experiment) {
  shown = experiment;
  allow();
}

async function asked() {
  const kind = byId("kind").value;
  const experiment = { kind };
  if (kind === "control") experiment.law_sha256 = chosenLaw().sha256;
  for (const name of [...KINDS[kind].fields, "Ts", "name"]) {
    const input = byId(`field-${name}`);
    if (kind === "control" && byId(`label-${name}`).hidden) continue;
    if (name === "file") {
      const file = input.files[0];
      if (!file) throw new Error("choose a file first");
      if (file.size > MOST_FILE) throw new Error(`${file.name} has ${file.size} B; at most ${MOST_FILE} B are accepted`);
      Object.assign(experiment, { file: file.name.slice(0, 200), text: await file.text() });
    } else if (input.value !== "") {
      experiment[name] = input.type === "number" ? Number(input.value) : input.value;
    }
  }
  if (scale && !["csv", "control"].includes(kind)) {
    experiment.named = true;
    const levels = LEVELS.filter((level) => level in experiment);
    const volts = levels.map((level) => voltsOf(experiment[level])).sort((a, b) => a - b);
    levels.forEach((level, i) => Object.assign(experiment, { [level]: volts[i] }));
  }
  return experiment;
}

async function preview() {
  const experiment = await asked();
  const found = await askJson("preview", experiment);
  show("preview", true);
  show("running", going);
  plot?.destroy();
  const volts = { colour: "u", unit: "V", range: [0, 5], pad: 0.3, splits: [0, 1, 2, 3, 4, 5] };
  const r = found.reference;
  const [signal] = r ? presented([{ kind: "reference", unit: r.unit, span: r.high - r.low || 1 }]) : [volts];
  plot = chart(byId("preview-plot"), { signal, height: 130, xLabel: "s", stepped: true });
  plot.wanted = [0, found.seconds];
  plot.setData(found.curve, true);
  setText("preview-told", unbroken(`${found.experiment}: ${plural(found.N, "sample")}, ${found.seconds.toPrecision(4) * 1} s at Ts = ${found.Ts} s.`));
  const lines = [`${found.rehearsal}.`];
  if (found.deviations.length) lines.push(`with the handout's parameters and the noise of the converter, the data would determine ${found.deviations.join(", ")}.`);
  byId("preview-lines").replaceChildren(...[...lines, ...found.notes].map((text) => make("li", { textContent: unbroken(text) })));
  offer(experiment);
  byId("run").focus();
}

// A number and its unit stay on one line.
const unbroken = (text) => text.replaceAll(/(\d) (?=(?:%|s|V)(?:\W|$))/g, "$1\u00a0");

async function run() {
  if (!shown) return;
  asking = new AbortController();
  await askJson("run", { owner: owner(), experiment: shown }, asking.signal);
  forget();
  scrollTo({ top: 0 }); // the plots are at the top
}

// Abort the request for a run: if it waited for a connection, the run would begin after the stop.
export function withdrawRun() {
  asking.abort(new Error("the run was not started: you stopped the rig"));
}

async function arm() {
  const Ts = byId("field-Ts").value;
  await askJson("arm", { owner: owner(), ...(Ts ? { Ts: Number(Ts) } : {}) });
  notice(`armed, at ${scale ? "rest" : "0 V"}; without a command the rig is released after 10 s`);
}

async function release() {
  const { released } = await askJson("release", {});
  notice(released ? "released" : "this page has not armed the rig");
}

export function showControl(found) {
  status = found;
  showRun(newest);
}

// A button is enabled only if the rig can take its command and sends data.
export function allow() {
  const answers = !isStale() && !status.trouble;
  byId("run").disabled = !shown || going || !answers || !["safe", "armed"].includes(status.phase);
  byId("arm").disabled = going || !answers || status.phase !== "safe";
  byId("release").disabled = going || status.phase !== "armed";
}

export function showRun(found) {
  newest = found;
  going = found.is_going;
  allow();
  showHeader();
  if (!found.experiment) return;
  show("running", true);
  byId("progress").value = found.total ? found.done / found.total : 0;
  show("progress", going);
  show("new-reference", going && Boolean(found.reference));
  setText("new-r-range", found.reference);
  setText("running-text", runText(found));
  byId("running-text").className = found.error ? "bad-text" : "";
  setText("running-told", going ? found.told : found.verdict);
  show("look", !going && Boolean(found.recording));
  byId("look").dataset.file = found.recording;
}

function runText(run) {
  if (run.is_going) return `${run.experiment}: ${run.total ? `${duration((run.total - run.done) * status.Ts)} left` : "starts"}`;
  if (!run.error) return `${run.experiment} is recorded: ${run.recording}`;
  if (!run.recording) return `${run.experiment} failed: ${run.error}`;
  // The page shows a fault once, in the line of the fault.
  const last = status.last_run;
  const why = status.reason && !status.trouble ? "see the fault" : last?.finished && last.file === run.recording ? last.outcome : run.error;
  return `${run.experiment} ended early, after ${duration(run.done * status.Ts)}: ${why}`;
}

// Show in the top line that a run is recorded; only a run of this page has a known end.
function showHeader() {
  const last = status.last_run?.finished === false ? status.last_run : null;
  show("recording", last || going);
  byId("recording").title = last?.file ?? "";
  setText("recording-text", going ? runText(newest) : last ? `recording, ${duration(last.samples * status.Ts)}` : "");
}
