// The live plots: four charts of the last seconds or minutes, with zoom and cursor.

import { chart } from "./chart.js";
import { FIGURES_MS, byId, make, setText, show } from "./elements.js";
import { KEPT_S, Rows } from "./rows.js";

const SPANS = [5, 30, 300];
const AXES = ["from now", "clock", "since start"]; // what the time axis counts

const SIGNALS = [
  { key: "u", name: "u", unit: "V", range: [0, 5], pad: 0.3, digits: 2, splits: [0, 1, 2, 3, 4, 5] },
  { key: "theta_1", name: "θ₁", unit: "°", range: [0, 360], pad: 10, digits: 1, splits: [0, 90, 180, 270, 360], wraps: true },
  { key: "rate", name: "rate of θ₁", unit: "°/s", range: null, least: 40, digits: 0, isSymmetric: true },
  { key: "alpha", name: "α", unit: "°", range: null, least: 4, digits: 1, isSymmetric: true },
];

// Four plots fill a screen where it is wide; on a phone each is as high as can be read.
const heightOf = (last) => (innerWidth > 900 ? Math.max(115, Math.min(210, (innerHeight - 330) / 4)) : 105) + (last ? 22 : 0);

export class LivePlots {
  constructor() {
    this.rows = new Rows();
    this.span = 30;
    this.frozen = null; // {zero, from, to} while zoomed
    this.cursorAt = null; // in s from the newest, as the x axis
    this.toldAt = -FIGURES_MS; // when the figures were shown
    this.restUntil = 0;
    this.charts = SIGNALS.map((signal, i) => this.#made(signal, i === SIGNALS.length - 1));
    this.values = SIGNALS.map((signal) => byId(`value-${signal.key}`));
    for (const span of SPANS) {
      const text = span < 60 ? `${span} s` : `${span / 60} min`;
      const button = make("button", { type: "button", textContent: text });
      button.addEventListener("click", () => this.setSpan(span));
      button.dataset.span = span;
      byId("span-choice").append(button);
    }
    this.setSpan(30);
    this.marks = []; // of {t, kind}: what happened, in the time of the samples
    this.setAxis(localStorage.getItem("armrig-axis") || AXES[0]);
    byId("axis").addEventListener("click", () => this.setAxis(AXES[(AXES.indexOf(this.axis) + 1) % AXES.length]));
    byId("follow").addEventListener("click", () => this.follow());
    byId("charts").addEventListener("dblclick", () => this.follow());
    new ResizeObserver(() => this.#resize()).observe(byId("charts"));
    byId("plots").addEventListener("keydown", (event) => this.#key(event));
  }

  #made(signal, last) {
    const where = make("div", { className: "chart" });
    where.append(
      make(
        "div",
        { className: "chart-head" },
        make("span", { className: `swatch ${signal.key}` }),
        make("span", { textContent: signal.name }),
        make("span", { className: "value", id: `value-${signal.key}` }),
      ),
    );
    byId("charts").append(where);
    return chart(where, {
      signal,
      height: heightOf(last),
      xLabel: last ? "s" : "",
      sync: "live",
      stepped: signal.key === "u",
      onZoom: (from, to) => this.zoom(from, to),
      onCursor: (x, u) => {
        if (u.cursor.event || x !== null || this.cursorAt === null) this.#point(x);
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
    this.marks = marks.map(([t, kind]) => ({ t, kind }));
    this.wants();
  }

  zoom(from, to) {
    const zero = this.frozen?.zero ?? this.rows.newest;
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

  // Draw at most once a frame, and only what is seen.
  wants() {
    // A browser that draws slowly draws less often, so that data and stops have their turn.
    if (this.due || document.hidden || byId("live").hidden || performance.now() < this.restUntil) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      this.draw();
    });
  }

  draw() {
    if (!this.charts) return;
    const began = performance.now();
    const zero = this.frozen?.zero ?? this.rows.newest;
    if (Number.isNaN(zero)) return;
    const [from, to] = this.frozen ? [this.frozen.from, this.frozen.to] : [-this.span, 0];
    const marks = this.marks.map(({ t, kind }) => ({ x: t - zero, kind }));
    const origin = this.#origin(zero);
    this.charts.forEach((u, i) => {
      Object.assign(u, { wanted: [from, to], marks, origin, namesMarks: i === 0 });
      const pixels = u.bbox.width / devicePixelRatio;
      u.setData(this.rows.drawn(i, { from: zero + from, to: zero + to, pixels, zero, wraps: SIGNALS[i].wraps }), true);
    });
    if (this.frozen || this.cursorAt !== null || performance.now() - this.toldAt >= FIGURES_MS) this.#tell();
    this.restUntil = 2 * performance.now() - began;
  }

  // Where the time axis begins to count.
  #origin(zero) {
    if (this.axis === "clock") return { s: (this.frozen ? this.shownAt : Date.now()) / 1000, isClock: true };
    const start = this.marks.findLast(({ kind }) => kind === "start");
    return { s: this.axis === "since start" && start ? zero - start.t : 0 };
  }

  #point(x) {
    this.cursorAt = x;
    this.#tell();
  }

  #tell() {
    this.toldAt = performance.now();
    const zero = this.frozen?.zero ?? this.rows.newest;
    const pointed = this.cursorAt !== null;
    const t = pointed ? zero + this.cursorAt : zero;
    const row = this.rows.holding(t);
    SIGNALS.forEach((signal, i) => {
      const value = this.values?.[i];
      if (!value || !this.rows.length) return;
      const least = this.rows.at(row, 1 + 2 * i);
      const largest = this.rows.at(row, 2 + 2 * i);
      const text = row === null
        ? "no data"
        : Number.isNaN(least)
          ? "not known"
          : least === largest
            ? `${least.toFixed(signal.digits)} ${signal.unit}`
            : `${least.toFixed(signal.digits)} … ${largest.toFixed(signal.digits)} ${signal.unit}`;
      if (value.textContent !== text) value.textContent = text;
    });
    const frozen = this.frozen ? "held; the rig goes on. " : "";
    setText("cursor", `${frozen}${pointed ? `cursor at ${this.cursorAt.toFixed(2)} s` : ""}`);
  }

  #resize() {
    const width = byId("charts").clientWidth;
    if (!width || width === this.width) return;
    this.width = width;
    this.charts.forEach((u, i) => u.setSize({ width, height: heightOf(i === this.charts.length - 1) }));
    this.draw();
  }

  #key(event) {
    const [from, to] = this.frozen ? [this.frozen.from, this.frozen.to] : [-this.span, 0];
    const steps = { ArrowLeft: -1, ArrowRight: 1 };
    if (event.key in steps && event.target === byId("plots")) {
      const step = ((to - from) / 100) * steps[event.key] * (event.shiftKey ? 10 : 1);
      const at = Math.min(to, Math.max(from, (this.cursorAt ?? to) + step));
      const left = this.charts[0].valToPos(at, "x");
      for (const u of this.charts) u.setCursor({ left, top: 10 }, false);
      this.#point(at);
      event.preventDefault();
    } else if (event.key === "+" || event.key === "-") {
      const middle = this.cursorAt ?? (from + to) / 2;
      const half = ((to - from) / 2) * (event.key === "+" ? 0.5 : 2);
      this.zoom(middle - half, middle + half);
      event.preventDefault();
    }
  }
}
