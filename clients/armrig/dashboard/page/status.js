// State of the rig: phase, owner, fault, age of the data, timing.

import { askJson, attempt, byId, FIGURES_MS, make, notice, plural, setText, show } from "./elements.js";

const CLOCK_DRIFT = 2e-4; // largest relative drift between the clocks of two machines
const DRIVE = ["motor", "input"]; // of the arm, and of another rig
const FIRST = ["phase", "fault", "to do", ...DRIVE, "owner", "Ts", "arm"];

let status = { rows: [], trouble: "" };
let edges = [];
let age = null;
let leastLate = Infinity; // least arrival time of a message minus its sending time, in s
let arrived = performance.now();
let agedAt = -FIGURES_MS; // time at which the age was last shown
let stale = true;
let lost = ""; // reason why the dashboard's server sends nothing
let [rowsOf, rowsStale] = [null, null]; // status that the rows show

export const rigStatus = () => status;

export function begin(lateEdges) {
  edges = lateEdges;
  leastLate = Infinity; // another server has another clock
}

export function showStatus(found) {
  status = found;
  const title = found.rig ? `rig ${found.rig}` : "armrig";
  setText("title", title);
  setText("owner", found.owner || "nobody");
  setText("fault-name", `Fault ${found.fault}:`);
  setText("fault-reason", found.reason || "");
  setText("fault-remedy", found.remedy || "correct the cause");
  showState();
}

// Show one message for one cause: the connection, then the fault, then the line to the device.
function showState() {
  const isLost = stale && Boolean(lost || status.trouble);
  const isFault = Boolean(status.reason) && !isLost;
  const name = isFault ? "fault" : stale ? "stale" : status.phase || "init";
  const said = name === "stale" ? "no data" : name;
  setText("phase", said);
  byId("phase").className = `pill ${name}`;
  document.body.classList.toggle("is-stale", stale);
  document.title = `${said}${status.rig ? ` · rig ${status.rig}` : ""} · armrig`;
  show("fault", isFault);
  show("stale", stale && !isFault);
  if (stale) {
    const what = total() === null ? "No data from the rig yet" : `No data from the rig for ${seconds(total())}`;
    setText("stale-what", status.phase ? `${what}; the last phase was ${status.phase}.` : `${what}.`);
    setText("stale-why", lost || (status.trouble ? `${status.trouble}; the page reconnects by itself` : status.line || ""));
  }
  if (rowsOf !== status || rowsStale !== stale) showRows();
}

// Without data from the rig, the voltage of the motor is not known.
function showRows() {
  [rowsOf, rowsStale] = [status, stale];
  const text = ([name, value]) => (DRIVE.includes(name) && stale ? "not known" : value);
  const rows = (wanted) => status.rows.filter(([name]) => FIRST.includes(name) === wanted).flatMap((row) => [make("dt", { textContent: row[0] }), make("dd", { textContent: text(row) })]);
  byId("status").replaceChildren(...rows(true));
  byId("status-all").replaceChildren(...rows(false));
}

export function showLive(live) {
  const isCalm = age !== null && !stale && !live.is_stale;
  const before = arrived;
  arrived = performance.now();
  age = live.age_s === null ? null : live.age_s + delay(live.at_s, (arrived - before) / 1000);
  setStale(live.is_stale, "");
  if (!isCalm || arrived - agedAt >= FIGURES_MS) showAge();
}

function showAge() {
  agedAt = performance.now();
  setText("age", total() === null ? "none yet" : `${seconds(total())} old`);
}

// Return the age of the newest sample, in s; null if there is no sample.
const total = () => (age === null ? null : age + (performance.now() - arrived) / 1000);

// Return the text of a value, "" if it is not known; without fresh data, the last value with its age.
export const dated = (text) => (!text || age === null ? "not known" : stale ? `last: ${text}, ${total().toFixed(1)} s ago` : text);

// Return the delay of a message in a slow network, in s, relative to the fastest message.
function delay(at, since) {
  const late = arrived / 1000 - at;
  leastLate = Math.min(leastLate + CLOCK_DRIFT * since, late);
  return late - leastLate;
}

export function showLost(why) {
  showAge();
  setStale(true, why);
}

// Report that this browser was too slow to draw.
export function showBusy(late) {
  notice(`this browser was too busy to draw for ${seconds(late / 1000)}: close other programs or tabs; the rig continues`);
}

const seconds = (s) => (s < 10 ? `${s.toFixed(2)} s` : `${Math.round(s)} s`);

// Return a length of time as text.
export const duration = (s) => (s < 10 ? `${s.toFixed(1)} s` : s < 100 ? `${Math.round(s)} s` : `${Math.floor(s / 60)} min ${Math.floor(s % 60)} s`);

function setStale(now, why) {
  const isNew = now !== stale || why !== lost;
  [stale, lost] = [now, why];
  if (isNew || now) showState();
}

export const isStale = () => stale;

export function showTiming(timing) {
  const report = timing.report;
  const parts = [];
  if (report.wake_p99_us !== undefined) {
    parts.push(`wake-up delay of the daemon's loop p50 ${micros(report.wake_p50_us)}, p99 ${micros(report.wake_p99_us)}, max ${micros(report.wake_max_us)}`);
    parts.push(`jitter p99 ${micros(report.jitter_p99_us)}`, `round trip p99 ${micros(report.link_p99_us)}`);
  }
  setText("timing-text", parts.length ? `In the last second: ${parts.join("; ")}.` : "no report yet");
  const most = Math.max(1, ...timing.late);
  byId("histogram").replaceChildren(
    ...timing.late.map((count, i) => {
      const bar = make("i");
      // The scale is logarithmic: a single late sample among thousands remains visible.
      bar.style.height = `${count ? 8 + 72 * (Math.log1p(count) / Math.log1p(most)) : 0}%`;
      const edge = i < edges.length ? `${edges[i] / 1000}` : "more";
      const title = `${plural(count, "sample")}, ${i < edges.length ? `at most ${micros(edges[i])} late` : "later"}`;
      return make("div", { className: "bar", title }, `${count || ""}`, bar, edge);
    }),
  );
  const missing = [`missing: ${plural(timing.missing, "sample")} since this dashboard was started`];
  if (timing.last_gap) missing.push(`reason of the last gap: ${timing.last_gap}`);
  if (timing.unheard) missing.push(`${plural(timing.unheard, "sample")} did not reach the dashboard's server, but are in recordings`);
  setText("missing", missing.join("; "));
  byId("missing").className = timing.missing ? "warn-text" : "";
}

const micros = (us) => (us < 1000 ? `${us < 10 ? us.toFixed(1) : Math.round(us)} µs` : `${(us / 1000).toFixed(1)} ms`);

export function setUpStatus() {
  byId("reset").addEventListener("click", () =>
    attempt(async () => {
      const told = await askJson("reset", {});
      notice(told.was_latched ? "the rig was reset" : "nothing is latched, so there is nothing to reset");
    }),
  );
}
