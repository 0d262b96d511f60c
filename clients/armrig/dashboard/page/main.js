// The page: it forwards the messages of the stream to its parts, and handles keys and the theme.

import { ArmDrawing } from "./arm.js";
import { redrawCharts } from "./chart.js";
import { allow, describeRig, setUpControl, showRun, showControl, withdrawRun } from "./control.js";
import { ask, attempt, byId, notice, owner, setText, show, token, useCommand } from "./elements.js";
import { LivePlots } from "./live_plots.js";
import { isInAddress, noteView, openModels, setUpModels } from "./models.js";
import { setUpNote, takesBlank } from "./note.js";
import { listRecordings, setUpRecordings } from "./recordings.js";
import { begin as beginStatus, dated, isStale, setUpStatus, showBusy, showLive, showLost, showStatus, showTiming, rigStatus } from "./status.js";
import { outputsOf } from "./signals.js";
import { Stream } from "./stream.js";

const VIEWS = ["live", "recordings", "models"];
const THEMES = ["system", "light", "dark"];
const systemDark = matchMedia("(prefers-color-scheme: dark)");
const WIDE = 900; // pixels; a narrower screen has no space for names next to the charts
const CONNECTION_MS = 60; // a stop that has a connection is answered within this time
let plots = null;
let stream = null;
let rig = null; // signals of the rig, and what only the arm has

function useTheme() {
  const wanted = localStorage.getItem("armrig-theme") || "system";
  const dark = wanted === "dark" || (wanted === "system" && systemDark.matches);
  document.documentElement.dataset.theme = dark ? "dark" : "light";
  byId("theme").textContent = `Theme: ${wanted}`;
  redrawCharts();
}

// Stop at once: ask the user nothing, and wait for no earlier answer.
async function stop() {
  withdrawRun();
  // A browser has six connections to a server, for all its tabs. If all are in use, our stream
  // closes its connection for the stop, and connects again later.
  const waits = setTimeout(() => stream.open(), CONNECTION_MS);
  try {
    await ask("stop", { owner: owner() });
    show("undelivered", false);
    notice("stop sent: 0 V");
  } catch (error) {
    setText("undelivered-why", error.isSilent ? "The dashboard's server does not answer." : `${error.message}.`);
    show("undelivered", true);
  } finally {
    clearTimeout(waits);
  }
}

const isText = (target) => target instanceof HTMLInputElement && !["button", "file"].includes(target.type);

function onKey(event) {
  if (event.ctrlKey || event.altKey || event.metaKey) return;
  const typing = isText(event.target);
  if (event.code === "Space") {
    // At rest, a text field accepts a space; while the motor may turn, the space bar always stops.
    if (typing && (takesBlank(event) || !["armed", "active"].includes(rigStatus().phase))) return;
    event.preventDefault();
    event.stopPropagation();
    if (event.type === "keydown" && !event.repeat) stop();
    return;
  }
  if (event.type !== "keydown" || typing || event.target instanceof HTMLSelectElement) return;
  if (event.key === "Escape") plots.follow();
  if (event.key.toLowerCase() === "l") choose("live");
  for (const tab of ["recordings", "models"]) {
    if (event.key.toLowerCase() === tab[0] && !byId(`tab-${tab}`).hidden) choose(tab);
  }
}

function choose(name) {
  for (const tab of VIEWS) {
    byId(tab).hidden = tab !== name;
    byId(`tab-${tab}`).setAttribute("aria-selected", String(tab === name));
  }
  noteView(name);
  if (name === "live") plots.wants();
  else attempt(name === "models" ? openModels : listRecordings);
}

// Show the rig. If the page has shown the default rig before, it asks for the rows of this one.
function describe(found) {
  const hasCharts = Boolean(rig);
  rig = found;
  plots.describe(rig.signals);
  describeRig(rig);
  show("arm-card", Boolean(rig.arm));
  if (hasCharts) stream.open();
}

function begin() {
  plots = new LivePlots();
  const arm = new ArmDrawing(byId("arm-drawing"));
  byId("projector").addEventListener("click", () => {
    const isOn = document.body.classList.toggle("projector");
    byId("projector").setAttribute("aria-pressed", String(isOn));
    choose("live");
    plots.setLarge(isOn && innerWidth > WIDE);
  });
  useTheme();
  systemDark.addEventListener("change", useTheme);
  byId("theme").addEventListener("click", () => {
    const now = localStorage.getItem("armrig-theme") || "system";
    localStorage.setItem("armrig-theme", THEMES[(THEMES.indexOf(now) + 1) % THEMES.length]);
    useTheme();
  });
  byId("stop").addEventListener("click", stop);
  byId("undelivered-seen").addEventListener("click", () => show("undelivered", false));
  addEventListener("keydown", onKey, true);
  addEventListener("keyup", onKey, true);
  addEventListener("hashchange", () => isInAddress() && !byId("tab-models").hidden && choose("models"));
  document.addEventListener("visibilitychange", () => plots.wants());
  for (const tab of VIEWS) byId(`tab-${tab}`).addEventListener("click", () => choose(tab));
  const showAges = () => {
    arm.setAge(isStale() ? dated(arm.text(plots.signals[1]?.label)) : "");
    if (isStale()) plots.tell();
  };
  setUpStatus();
  setUpControl((file) => {
    choose("recordings");
    attempt(() => listRecordings(file));
  });
  setUpRecordings();
  setUpModels();
  setUpNote();
  if (!token) notice("open the address in the dashboard's terminal: it ends with a token");
  stream = new Stream(
    {
      hello: (hello) => {
        plots.rows.begin();
        plots.reference.begin();
        beginStatus(hello.late_us);
        useCommand(hello.command);
        document.body.classList.toggle("viewer", !hello.may_command);
        for (const part of document.querySelectorAll("[data-commands]")) part.hidden = !hello.may_command;
        if (hello.may_command && isInAddress() && byId("models").hidden) choose("models");
      },
      rig: (found) => {
        if (rig && (!found.hash || found.hash === rig.hash)) return; // without a hash it is a default
        if (rig?.hash) location.reload(); // the whole page shows one rig
        else describe(found);
      },
      past: (rows) => plots.rows.add(rows),
      past_reference: (rows) => plots.reference.add(rows),
      whole: () => {
        plots.rows.endPast();
        plots.reference.endPast();
        plots.wants();
      },
      live: (live) => {
        showLive(live);
        if (live.newest && rig?.arm) {
          const [first, second] = outputsOf(rig.signals).map(({ key }) => live.newest[key]);
          arm.show(first, rigStatus().arm_removed ? 0 : (second ?? null));
        }
        allow();
        showAges();
        if (live.reference) plots.reference.addLive(live.reference);
        if (live.rows.length) {
          plots.rows.addLive(live.rows);
          plots.wants();
        }
      },
      status: (status) => {
        showStatus(status);
        showControl(status);
        plots.rateMost = status.rate_max;
      },
      run: showRun,
      control: (found) => plots.setControl(found),
      marks: (marks) => plots.setMarks(marks),
      timing: showTiming,
    },
    (why) => {
      showLost(why);
      allow();
      showAges();
    },
    showBusy,
  );
}

begin();
