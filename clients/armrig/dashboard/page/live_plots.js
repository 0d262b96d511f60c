// Live plots: a chart of each signal in the last seconds or minutes, with zoom and cursor.

import { chart } from "./chart.js";
import { aligned } from "./compared.js";
import { FIGURES_MS, byId, make, setText, show } from "./elements.js";
import { onPlotKey } from "./live_keys.js";
import { setUpSaving } from "./live_saving.js";
import { presented, valueText, withReference } from "./signals.js";
import { textNear } from "./marks.js";
import { KEPT_S, Rows } from "./rows.js";
import { dated, isStale } from "./status.js";
import { AXES, originOf } from "./time_axis.js";

const SPANS = [5, 30, 300];
const [NAMES_PIXELS, AXIS_PIXELS] = [18, 22]; // additional height of the first plot, and of the last
const LARGE_BORDER = 60; // below the plots, and between them, in the projector view
const HELD_S = 0.3; // a reference without a decision for this time, and two decisions, has ended
const HEAD_PIXELS = 255; // width of the name and value next to a chart in the projector view

// On a wide screen the plots fill the height; on a phone they have the least readable height.
const heightOf = (n) => (innerWidth > 900 ? Math.max(85, Math.min(210, (innerHeight - 380) / n)) : 88);

// Return a value of r in the unit of the plot of a signal.
const inPlot = (r, { factor = 1, wraps }) => (wraps ? (((r * factor) % 360) + 360) % 360 : r * factor);

export class LivePlots {
  constructor() {
    this.rows = new Rows();
    this.reference = new Rows(1); // r of a run in control, in the unit of its law
    this.control = null; // law of a run in control, and its shares; null without one
    this.described = []; // signals of the rig, as the server describes them
    this.signals = []; // those that have a chart
    this.span = 30;
    this.rateMost = 0; // rate that the largest voltage can cause, in °/s; 0 if it is not known
    this.frozen = null; // {zero, from, to} while zoomed
    this.cursorAt = null; // in s relative to the newest sample, as on the x axis
    this.toldAt = -FIGURES_MS; // time at which the values were last shown
    this.restUntil = 0; // no drawing until then: the pause is as long as the last drawing took
    this.setLarge(false);
    for (const span of SPANS) {
      const text = span < 60 ? `${span} s` : `${span / 60} min`;
      const button = make("button", { type: "button", textContent: text });
      button.addEventListener("click", () => this.setSpan(span));
      button.dataset.span = span;
      byId("span-choice").append(button);
    }
    this.setSpan(30);
    this.marks = []; // events {t, kind, text}; t is on the clock of the samples
    this.setAxis(localStorage.getItem("armrig-axis") || AXES[0]);
    byId("axis").addEventListener("click", () => this.setAxis(AXES[(AXES.indexOf(this.axis) + 1) % AXES.length]));
    byId("follow").addEventListener("click", () => this.follow());
    byId("charts").addEventListener("dblclick", () => this.follow());
    setUpSaving(this);
    const sizes = new ResizeObserver(() => this.#resize());
    for (const part of ["charts", "fault", "top"]) sizes.observe(byId(part));
    byId("plots").addEventListener("keydown", (event) => onPlotKey(this, event));
  }

  // Plot the signals of a rig.
  describe(signals) {
    this.described = presented(signals).map((signal, column) => ({ ...signal, column }));
    this.rows.setSignals(signals.length);
    this.follow();
    this.#arrange();
  }

  // Show the reference, the limits and the shares of a run in control; null without one.
  setControl(found) {
    setText("shares", found?.shares ?? "");
    const place = (control) => JSON.stringify({ ...control, shares: "" });
    const isOther = place(found) !== place(this.control);
    this.control = found;
    if (!isOther) return;
    if (found) this.reference.forgetBefore(found.first_s); // these rows are of another law
    this.#arrange();
  }

  #arrange() {
    this.signals = withReference(this.described, this.control);
    this.setLarge(this.isLarge);
  }

  // Return the least and the largest r at a time, in the unit of its plot; NaN without a decision.
  referenceAt(t, signal) {
    const { reference } = this;
    const row = reference.holding(t);
    const apart = reference.length > 1 ? reference.newest - reference.at(reference.length - 2, 0) : 0;
    const isHeld = row !== null && t - reference.at(row, 0) <= HELD_S + 2 * Math.min(apart, 2);
    return [1, 2].map((column) => (isHeld ? inPlot(reference.at(row, column), signal) : NaN));
  }

  // Return the curve of r in a part of the time axis, in the unit of the plot of a signal.
  #referenceIn(part, signal) {
    const [x, ...values] = this.reference.drawn(0, { ...part, wraps: false });
    return [x, ...values.map((column) => column.map((value) => (value === null ? null : inPlot(value, signal))))];
  }

  // Make the charts; isLarge is true for the projector view.
  setLarge(isLarge) {
    for (const u of this.charts ?? []) u.destroy();
    byId("charts").replaceChildren();
    this.isLarge = isLarge;
    this.charts = this.signals.map((signal, i) => this.#made(signal, i));
    this.toldAt = -FIGURES_MS;
    this.draw();
  }

  #height(i) {
    const n = this.signals.length;
    const [first, last] = [i === 0 ? NAMES_PIXELS : 0, i === n - 1 ? AXIS_PIXELS : 0];
    if (!this.isLarge) return heightOf(n) + first + last;
    // What is above the plots, such as a fault, takes its height.
    const space = innerHeight - byId("charts").offsetTop - LARGE_BORDER;
    return Math.max(90, (space - 2 * (NAMES_PIXELS + AXIS_PIXELS)) / n) + 2 * (first + last);
  }

  #made(signal, i) {
    const last = i === this.signals.length - 1;
    const where = make("div", { className: "chart" });
    where.append(
      make(
        "div",
        { className: "chart-head" },
        make("span", { className: `swatch ${signal.colour}` }),
        make("span", { textContent: signal.name }),
        make("span", { className: "value", id: `value-${signal.key}` }),
        ...(signal.factor ? [make("span", { className: "swatch reference" }), make("span", { textContent: "r" }), make("span", { className: "value", id: "value-r" })] : []),
      ),
    );
    byId("charts").append(where);
    const width = this.isLarge ? byId("charts").clientWidth - HEAD_PIXELS : undefined;
    return chart(where, {
      width,
      signal,
      height: this.#height(i),
      size: this.isLarge ? 22 : 12,
      xLabel: last ? "s" : "",
      sync: "live",
      stepped: ["input", "reference"].includes(signal.kind),
      over: signal.factor ? "reference" : "",
      isOverStepped: true,
      namesMarks: signal === this.signals[0],
      onZoom: (from, to) => this.zoom(from, to),
      onCursor: (x, u) => {
        if (u.cursor.event || x !== null || this.cursorAt === null) this.point(x);
      },
    });
  }

  setSpan(span) {
    this.span = span;
    this.follow();
    for (const button of byId("span-choice").children) {
      button.setAttribute("aria-pressed", String(Number(button.dataset.span) === span));
    }
  }

  setAxis(axis) {
    this.axis = axis;
    localStorage.setItem("armrig-axis", axis);
    setText("axis", `Time: ${axis}`);
    this.draw();
  }

  setMarks(marks) {
    this.marks = marks.map(([t, kind, text]) => ({ t, kind, text }));
    this.wants();
  }

  zoom(from, to) {
    const { zero } = this.seen;
    if (!(to - from > 0.05) || Number.isNaN(zero)) return;
    const last = this.rows.newest - zero;
    if (!this.frozen) this.shownAt = Date.now();
    this.frozen = { zero, from: Math.max(from, last - KEPT_S), to: Math.max(Math.min(to, last), from + 0.05) };
    show("follow", true);
    this.draw();
  }

  follow() {
    this.frozen = null;
    this.cursorAt = null;
    for (const u of this.charts ?? []) u.wantedY = null;
    this.toldAt = -FIGURES_MS;
    show("follow", false);
    this.draw();
  }

  // The visible range: from and to in s relative to zero, the samples' time at 0 of the axis.
  get seen() {
    const zero = this.frozen?.zero ?? this.rows.newest;
    return { zero, from: this.frozen?.from ?? -this.span, to: this.frozen?.to ?? 0 };
  }

  // Request a drawing: at most one each frame, and none while the plots are hidden.
  wants() {
    if (this.due || document.hidden || byId("live").hidden) return;
    this.due = true;
    const frame = () =>
      requestAnimationFrame(() => {
        this.due = false;
        this.draw();
      });
    // A slow browser pauses between drawings, so that it can also handle data and stops.
    const rest = this.restUntil - performance.now();
    if (rest > 0) setTimeout(frame, rest);
    else frame();
  }

  draw() {
    if (!this.charts) return;
    const began = performance.now();
    const { zero, from, to } = this.seen;
    if (Number.isNaN(zero)) return;
    const marks = this.marks.map(({ t, ...mark }) => ({ x: t - zero, ...mark }));
    const origin = originOf(this.axis, zero, this.frozen ? this.shownAt : Date.now(), this.marks);
    this.charts.forEach((u, i) => {
      Object.assign(u, { wanted: [from, to], marks, origin, most: this.signals[i].isRate ? this.rateMost : 0 });
      const pixels = u.bbox.width / devicePixelRatio;
      const { column, factor, wraps } = this.signals[i];
      const part = { from: zero + from, to: zero + to, pixels, zero, wraps };
      const curve = column === undefined ? this.#referenceIn(part, {}) : this.rows.drawn(column, part);
      u.setData(factor ? aligned(curve, this.#referenceIn(part, this.signals[i])) : curve, true);
    });
    this.tell();
    this.restUntil = 2 * performance.now() - began;
  }

  point(x) {
    this.cursorAt = x;
    this.#tell();
  }

  // Show the values, at most five times a second.
  tell() {
    if (this.frozen || this.cursorAt !== null || performance.now() - this.toldAt >= FIGURES_MS) this.#tell();
  }

  #tell() {
    if (!this.signals.length) return;
    this.toldAt = performance.now();
    const { zero } = this.seen;
    const pointed = this.cursorAt !== null;
    const t = pointed ? zero + this.cursorAt : zero;
    const row = this.rows.holding(t);
    const texts = this.signals.map((signal) => {
      const value = valueText(signal, ...this.referenceAt(t, signal));
      const r = value && !pointed ? dated(value) : value || "no run";
      if (signal.factor) setText("value-r", r);
      if (signal.kind === "reference") return r;
      const [least, largest] = [1, 2].map((i) => (row === null ? NaN : this.rows.at(row, i + 2 * signal.column)));
      const known = row === null ? "no data" : valueText(signal, least, largest);
      if (signal.kind === "turned" && !known) return "no run";
      return pointed ? known || "not known" : dated(known);
    });
    this.signals.forEach(({ key }, i) => setText(`value-${key}`, texts[i]));
    if (!pointed) setText("motion", `${this.signals[0].label} ${texts[0]}, ${this.signals[1].label} ${texts[1]}`);
    const frozen = this.frozen ? "the plots are paused; the rig continues. " : "";
    const { from, to } = this.seen;
    const near = pointed && textNear(this.marks.map((mark) => ({ ...mark, x: mark.t - zero })), this.cursorAt, (to - from) / 100);
    setText("cursor", `${frozen}${pointed ? `cursor at ${this.cursorAt.toFixed(2)} s` : ""}${near ? `; ${near}` : ""}`);
  }

  #resize() {
    const width = byId("charts").clientWidth - (this.isLarge ? HEAD_PIXELS : 0);
    const heights = this.charts.map((_, i) => this.#height(i));
    if (!width || (width === this.width && `${heights}` === this.heights)) return;
    [this.width, this.heights] = [width, `${heights}`];
    this.charts.forEach((u, i) => u.setSize({ width, height: heights[i] }));
    this.draw();
  }
}
