// The view Models: models are estimated, compared and chosen.

import { ask, askJson, attempt, button, byId, make, notice, plural, setText, show, token } from "./elements.js";
import { showData, showHandForm } from "./model_forms.js";
import { legendItems, onModelPlotKey, resizePlots, savePlots, showPlots, showWhole } from "./model_plots.js";
import { COLOURS, keyed, refill, showSwitch, showTable } from "./model_table.js";
import { KINDS, keyOf, MOST_ROWS, readState, setAddress, viewOfAddress, writeState } from "./model_state.js";
import { save } from "./picture.js";

const TITLES = { output: "Output", residuals: "Residuals", poles: "Poles and zeros", frequency: "Frequency", step: "Step" };
const PAGE = `page ${Math.random()}`; // distinguishes the searches of two tabs
const STORE_MS = 150;
const MOST_COLOURS = 3 * COLOURS;
const state = { data: null, facts: null, error: "", isBusy: false, recordings: [], rows: [], kind: "output", horizon: 0 };
let isOpen = false; // the view was open before
let isWorking = false;
let dataVersion = 0; // of the data; results of earlier data are ignored
let lastId = 0;
let storing = 0; // timer
let drawing = 0; // number of the newest drawing
const curves = new Map(); // panels by plot and model: a switch needs no request
let searching = null; // AbortController of a search

export function setUpModels() {
  byId("model-plots").addEventListener("keydown", onModelPlotKey);
  new ResizeObserver(resizePlots).observe(byId("model-plots"));
}

// Return whether the address opens this view.
export const isInAddress = () => viewOfAddress() === "models";

// Open the view: with the state of the address, or with the newest recording.
export async function openModels() {
  const isFirst = !isOpen;
  isOpen = true;
  if (isFirst) {
    showActions();
    redraw();
  }
  await showRecordings();
  if ((await restore()) || !isFirst) return;
  const newest = state.recordings.find((one) => !one.validation) ?? state.recordings[0];
  if (newest) await useData({ file: newest.file, validation: null, inputs: [], outputs: [], treatments: [] });
}

async function showRecordings() {
  state.recordings = (await askJson("recordings", {})).recordings.toSorted((a, b) => Date.parse(b.started) - Date.parse(a.started));
  redrawData();
}

// Restore the state of the address; return whether there is one that is not present already.
async function restore() {
  const before = readState();
  if (!before) return false;
  const { data, rows, kind, horizon } = before;
  Object.assign(state, { kind, horizon, rows: rows.map((row) => ({ ...row, id: ++lastId, state: "waiting" })) });
  showPlotTools();
  state.facts = null;
  redraw();
  if (data) await useData(data);
  return Boolean(data);
}

const redrawData = () => showData(byId("model-data"), state, (changes) => useData({ ...state.data, ...changes }));

function redraw() {
  showTable(byId("model-table"), state.rows, { toggle, remove, retry, beginSave, save: saveModel, copy });
  show("model-empty", !state.rows.length);
  allowActions();
}

function allowActions() {
  for (const button of byId("model-actions").children) button.disabled = !visible().length;
}

// Write the state into the address, soon: a browser takes some ms for it, and only 200 in 30 s.
function store() {
  clearTimeout(storing);
  storing = setTimeout(() => state.data && writeState(state), STORE_MS);
}

// Use other data, and estimate all models again. If the data are refused, the present data remain.
async function useData(wanted) {
  const version = ++dataVersion;
  const before = state.data;
  Object.assign(state, { data: wanted, isBusy: true, error: "" });
  redrawData();
  try {
    const facts = await askJson("models/data", { data: wanted });
    if (version !== dataVersion) return;
    const isImport = facts.inputs.length > 1 || facts.inputs[0]?.name === facts.outputs[0]?.name;
    Object.assign(state, { facts: { ...facts, isImport }, data: facts.data });
    curves.clear();
    for (const row of state.rows) Object.assign(row, { state: "waiting", found: null, saved: "" });
    if (!byId("model-hand").children.length) showHandForm(byId("model-hand"), facts.structures, (request) => addAll([request]));
  } catch (error) {
    if (version !== dataVersion) return;
    state.error = error.message;
    if (state.facts) state.data = before;
    else for (const row of state.rows) Object.assign(row, { state: "failed", why: `no data: ${error.message}` });
  }
  state.isBusy = false;
  if (state.facts) store();
  redrawData();
  redraw();
  for (const one of byId("model-starts").querySelectorAll("button")) one.disabled = !state.facts;
  drawPlots();
  work();
}

// Add a row for each request; a model that is in the table already is switched on.
function addAll(requests, more = {}) {
  for (const request of requests) {
    const same = state.rows.find((row) => [row.request, row.found?.request ?? {}].some((one) => keyOf(one) === keyOf(request)));
    if (same) same.isOn = true;
    else if (state.rows.length >= MOST_ROWS) notice(`${MOST_ROWS} models are the most: remove some`);
    else state.rows.push({ id: ++lastId, request, colour: freeColour(), isOn: true, state: "waiting", ...more });
  }
  store();
  redraw();
  drawPlots();
  work();
}

function freeColour() {
  const used = state.rows.map(({ colour }) => colour % MOST_COLOURS);
  const count = (n) => used.filter((one) => one === n).length;
  return Array.from({ length: MOST_COLOURS }, (_, n) => n).reduce((best, n) => (count(n) < count(best) ? n : best), 0);
}

// Estimate the waiting models, one after the other: a request that waits would need a connection.
async function work() {
  if (isWorking || !state.facts) return;
  isWorking = true;
  for (let row = waitingRow(); row; row = waitingRow()) await estimate(row);
  isWorking = false;
}

const waitingRow = () => state.facts && state.rows.find((row) => row.state === "waiting");

async function estimate(row) {
  const version = dataVersion;
  row.state = "estimating";
  redraw();
  try {
    const found = await askJson("models/estimate", { data: state.data, request: row.request });
    if (version !== dataVersion) return;
    Object.assign(row, { state: "done", found }); // the request remains, for other data
  } catch (error) {
    if (version !== dataVersion) return;
    Object.assign(row, { state: "failed", why: error.message });
  } finally {
    if (version !== dataVersion && row.state === "estimating") row.state = "waiting";
  }
  store();
  redraw();
  drawPlots();
}

function toggle(row, button) {
  row.isOn = !row.isOn;
  showSwitch(button, row);
  allowActions();
  drawPlots();
  store();
}

function remove(row) {
  state.rows = state.rows.filter((one) => one !== row);
  redraw();
  drawPlots();
  store();
}

function retry(row) {
  row.state = "waiting";
  if (state.facts) work();
  else attempt(() => useData(state.data));
}

function beginSave(row) {
  row.isSaving = true;
  redraw();
  byId("model-table").querySelector(`[data-key="name ${row.id}"]`)?.select();
}

const saveModel = (row, name) =>
  attempt(async () => {
    const { file } = await askJson("models/save", { data: state.data, request: row.request, name });
    Object.assign(row, { saved: file, isSaving: false, fileName: undefined });
    redraw();
  });

const copy = (text, what) =>
  attempt(async () => {
    await navigator.clipboard.writeText(text);
    notice(`${what} copied`);
  });

async function addHints() {
  const { requests, why } = await askJson("models/hints", { data: state.data });
  addAll(requests);
  explain("Why these models", why);
}

const explain = (title, text) => byId("model-why").replaceChildren(make("details", { open: true }, make("summary", { textContent: title }), make("pre", { textContent: text })));

async function search() {
  searching = new AbortController();
  show("model-progress", true);
  showProgress({ done: 0, of: 0, seconds_left: null });
  try {
    const answer = await ask("models/search", { data: state.data, page: PAGE }, searching.signal);
    await readLines(answer, (line) => {
      if (line.error) throw new Error(line.error);
      if (!line.requests) return showProgress(line);
      addAll(line.requests);
      explain("What the search says", line.said);
    });
  } catch (error) {
    explain("The search", error.name === "AbortError" ? "the search was cancelled" : error.message);
  } finally {
    searching = null;
    show("model-progress", false);
  }
}

// Call `handle` with each line of an answer, which is JSON.
async function readLines(answer, handle) {
  const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
  let last = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return;
    const lines = (last + value).split("\n");
    last = lines.pop();
    for (const line of lines) handle(JSON.parse(line));
  }
}

function showProgress({ done, of, seconds_left: left }) {
  byId("model-part").value = of ? done / of : 0;
  setText("model-left", of ? `${done} of ${plural(of, "model")}${left === null ? "" : `, about ${Math.ceil(left)} s left`}` : "the search begins …");
}

async function cancel() {
  searching?.abort();
  await askJson("models/cancel", { page: PAGE });
}

// Open a saved model. The first model of the table brings its own data, if they are in the folder.
async function openFile(file) {
  const name = file.endsWith(".json") ? file : `${file}.json`;
  const request = { file: name };
  if (!state.rows.length) {
    const { data } = await askJson("models/open", request).catch(() => ({}));
    if (data) await useData(data);
  }
  addAll([request]);
}

function showActions() {
  const file = make("input", { type: "text", required: true, maxLength: 200, placeholder: "name of a saved model", "aria-label": "Name of a saved model" });
  const form = make("form", { className: "open-model", autocomplete: "off" }, file, make("button", { type: "submit", textContent: "Open" }));
  form.addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(() => openFile(file.value.trim()));
  });
  byId("model-starts").replaceChildren(button("Hints: three models", addHints, "go"), button("Search", search), form);
  for (const one of byId("model-starts").querySelectorAll("button")) one.disabled = true;
  byId("model-cancel").addEventListener("click", () => attempt(cancel));
  byId("model-actions").replaceChildren(button("Report of the visible models", report));
  showPlotTools();
}

async function report() {
  const requests = visible().map(({ request }) => request);
  save(await (await ask("models/report", { data: state.data, requests })).blob(), `models-${state.facts.sha256.slice(0, 12)}.pdf`);
}

function showPlotTools() {
  const choose = (changes) => {
    Object.assign(state, changes);
    showPlotTools();
    drawPlots();
    store();
  };
  const kinds = KINDS.map((kind) => keyed(`plot ${kind}`, TITLES[kind], () => choose({ kind }), { "aria-pressed": String(kind === state.kind) }));
  const horizon = make("input", { type: "number", min: 0, max: 10000, step: 1, value: state.horizon || "", placeholder: "simulated", "data-key": "horizon" });
  horizon.addEventListener("change", () => choose({ horizon: Math.min(10000, Math.max(0, Math.trunc(Number(horizon.value)) || 0)) }));
  const steps = make("label", { className: "steps-ahead", hidden: state.kind !== "output", title: "Leave it empty for the simulated output" }, "steps ahead", horizon);
  const saved = (kind) => button(kind.toUpperCase(), () => savePlots(kind, pictureTitle(), `models-${state.kind}-${state.facts.sha256.slice(0, 12)}`));
  const files = make("span", { className: "together", role: "group", "aria-label": "Save the visible part" }, saved("png"), saved("svg"));
  refill(byId("model-kinds"), ...kinds, steps, keyed("whole", "Whole", () => showWhole()), files);
}

const horizonText = () => (state.horizon ? `predicted ${plural(state.horizon, "step")} ahead` : "simulated");

function pictureTitle() {
  const hashes = [state.facts.sha256, state.facts.validation_sha256].filter(Boolean).map((hash) => hash.slice(0, 12));
  return `${TITLES[state.kind]}${state.kind === "output" ? `, ${horizonText()}` : ""}; recordings sha256 ${hashes.join(", ")}`;
}

const visible = () => state.rows.filter(({ isOn, found }) => isOn && found);

const curveKey = (row) => JSON.stringify([state.kind, state.kind === "output" ? state.horizon : 0, keyOf(row.request)]);

// Draw the curves that the page has, and ask for the missing ones, one model after the other.
async function drawPlots() {
  const mine = ++drawing;
  const version = dataVersion;
  drawKnown();
  for (let row = missingRow(); row; row = missingRow()) {
    const key = curveKey(row);
    let found;
    try {
      found = await askJson("models/plot", { data: state.data, requests: [row.request], kind: state.kind, horizon: state.horizon });
    } catch (error) {
      found = { panels: [], note: error.message };
    }
    if (version !== dataVersion) return;
    curves.set(key, found);
    if (mine !== drawing) return;
    drawKnown();
  }
}

const missingRow = () => visible().find((row) => !curves.has(curveKey(row)));

function drawKnown() {
  const known = state.rows.filter((row) => row.found && curves.has(curveKey(row)));
  const answers = known.map((row) => ({ model: row.id, panels: curves.get(curveKey(row)).panels }));
  const models = new Map(visible().map((row) => [row.id, { name: row.found.name, colour: row.colour }]));
  showPlots(state.kind, answers, models);
  byId("model-legend").replaceChildren(...legendItems());
  const notes = known.filter(({ isOn }) => isOn).map((row) => [row.found.name, curves.get(curveKey(row)).note]).filter(([, note]) => note);
  setText("model-note", notes.map(([name, note]) => `${name}: ${note}`).join("; "));
}

// Note in the address whether this view is visible, so that a reload shows it again.
export const noteView = (name) => setAddress({ token, view: name === "models" ? name : "" });
