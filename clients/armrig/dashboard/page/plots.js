// The live plots: least and largest value of each pixel's samples, with zoom and cursor.

import { byId, make, setText, show } from "./elements.js";

const COLUMNS = 9; // t, then least and largest of each signal
const MOST = 40000; // rows kept: five minutes
const KEPT_S = 300;
const SPANS = [5, 30, 300];

export const SIGNALS = [
  { key: "u", name: "u", unit: "V", range: [0, 5], pad: 0.3, digits: 2 },
  { key: "theta_1", name: "θ₁", unit: "°", range: [0, 360], pad: 10, digits: 1, splits: [0, 90, 180, 270, 360] },
  { key: "rate", name: "rate of θ₁", unit: "°/s", range: null, least: 40, digits: 0 },
  { key: "alpha", name: "α", unit: "°", range: null, least: 4, digits: 1 },
];

export class Rows {
  #values = new Float64Array(MOST * COLUMNS);
  length = 0;

  add(rows) {
    for (const row of rows) {
      if (this.length && row[0] <= this.newest) {
        if (row[0] > this.newest - KEPT_S) continue; // told already
        this.length = 0; // another clock
      }
      if (this.length === MOST) this.#forget(MOST / 4);
      const at = this.length * COLUMNS;
      for (let i = 0; i < COLUMNS; i++) this.#values[at + i] = row[i] === null ? NaN : row[i];
      this.length += 1;
    }
    if (this.length && this.newest - this.at(0, 0) > KEPT_S * 1.1) this.#forget(this.find(this.newest - KEPT_S));
  }

  clear() {
    this.length = 0;
  }

  at(row, column) {
    return this.#values[row * COLUMNS + column];
  }

  get newest() {
    return this.length ? this.at(this.length - 1, 0) : NaN;
  }

  // The first row at t or later.
  find(t) {
    let low = 0;
    let high = this.length;
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.at(middle, 0) < t) low = middle + 1;
      else high = middle;
    }
    return low;
  }

  #forget(n) {
    this.#values.copyWithin(0, n * COLUMNS, this.length * COLUMNS);
    this.length -= n;
  }

  // x, least, largest for uPlot: at most a few points a pixel, null where there is a break.
  drawn(signal, from, to, pixels, zero) {
    const column = 1 + 2 * signal;
    const first = Math.max(0, this.find(from) - 1);
    const last = Math.min(this.length, this.find(to) + 1);
    const width = (to - from) / Math.max(50, pixels);
    const x = [];
    const low = [];
    const high = [];
    let before = NaN;
    let valueBefore = NaN;
    for (let i = first; i < last; ) {
      const t = this.at(i, 0);
      let least = this.at(i, column);
      let largest = this.at(i, column + 1);
      const begins = t - before > 0.25 + 3 * width;
      let j = i + 1;
      for (; j < last && this.at(j, 0) < t + width; j++) {
        const a = this.at(j, column);
        const b = this.at(j, column + 1);
        if (SIGNALS[signal].key === "theta_1" && Math.abs(a - largest) > 180) break;
        if (!(least <= a)) least = Number.isNaN(a) ? least : a;
        if (!(largest >= b)) largest = Number.isNaN(b) ? largest : b;
      }
      const turns = SIGNALS[signal].key === "theta_1" && Math.abs(least - valueBefore) > 180;
      if (begins || turns) {
        x.push(Math.min(before + 1e-4, t - 1e-4) - zero);
        low.push(null);
        high.push(null);
      }
      before = this.at(j - 1, 0);
      if (!Number.isNaN(largest)) valueBefore = largest;
      x.push(t - zero);
      low.push(Number.isNaN(least) ? null : least);
      high.push(Number.isNaN(largest) ? null : largest);
      i = j;
    }
    return [x, low, high];
  }
}

export const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();

// A chart of least and largest values in the page's colours.
export function chart(where, { signal, height, xLabel, onZoom, onCursor, sync, stepped }) {
  const ink = () => colour("soft");
  const stroke = () => colour(signal.key);
  const axis = { stroke: ink, grid: { stroke: () => colour("grid"), width: 1 }, ticks: { stroke: () => colour("line"), width: 1 }, font: "12px system-ui, DejaVu Sans, sans-serif" };
  const paths = stepped ? uPlot.paths.stepped({ align: 1 }) : undefined;
  const series = { stroke, width: 1.4, points: { show: false }, spanGaps: false, paths };
  const range = (u, least, largest) => {
    if (signal.range) return [signal.range[0] - signal.pad, signal.range[1] + signal.pad];
    if (least === null || !Number.isFinite(least)) return [-signal.least, signal.least];
    const middle = (least + largest) / 2;
    const half = Math.max(signal.least / 2, ((largest - least) / 2) * 1.1);
    return [middle - half, middle + half];
  };
  const made = new uPlot(
    {
      width: where.clientWidth || 300,
      height,
      legend: { show: false },
      cursor: { drag: { x: true, y: false, setScale: false }, points: { show: false }, y: false, sync: sync ? { key: sync, setSeries: false } : undefined },
      scales: { x: { time: false, range: (u, a, b) => u.wanted || [a, b] }, y: { range } },
      axes: [
        { ...axis, size: xLabel ? 30 : 8, values: (u, splits) => splits.map((x, i) => (xLabel ? `${+x.toFixed(3)}${i === splits.length - 1 ? ` ${xLabel}` : ""}` : "")) },
        { ...axis, size: 54, ...(signal.splits ? { splits: () => signal.splits } : {}) },
      ],
      series: [{}, series, { ...series }],
      bands: [{ series: [2, 1], fill: () => `${stroke()}55` }],
      hooks: {
        setSelect: [
          (u) => {
            if (u.select.width > 4) onZoom?.(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          },
        ],
        setCursor: [(u) => onCursor?.(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null, u)],
      },
    },
    [[], [], []],
    where,
  );
  return made;
}

// Four plots fill a screen where it is wide; on a phone each is as high as can be read.
const heightOf = (last) => (innerWidth > 900 ? Math.max(115, Math.min(210, (innerHeight - 330) / 4)) : 105) + (last ? 22 : 0);

export class LivePlots {
  constructor() {
    this.rows = new Rows();
    this.span = 30;
    this.frozen = null; // {zero, from, to} while zoomed
    this.cursorAt = null; // in s from the newest, as the x axis
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

  zoom(from, to) {
    const zero = this.frozen?.zero ?? this.rows.newest;
    if (!(to - from > 0.05) || Number.isNaN(zero)) return;
    this.frozen = { zero, from, to };
    show("follow", true);
    this.draw();
  }

  follow() {
    this.frozen = null;
    this.cursorAt = null;
    show("follow", false);
    this.draw();
  }

  // Draw at most once a frame, and only what is seen.
  wants() {
    if (this.due || document.hidden || byId("live").hidden) return;
    this.due = true;
    requestAnimationFrame(() => {
      this.due = false;
      this.draw();
    });
  }

  draw() {
    if (!this.charts) return;
    const zero = this.frozen?.zero ?? this.rows.newest;
    if (Number.isNaN(zero)) return;
    const [from, to] = this.frozen ? [this.frozen.from, this.frozen.to] : [-this.span, 0];
    this.charts.forEach((u, i) => {
      u.wanted = [from, to];
      u.setData(this.rows.drawn(i, zero + from, zero + to, u.bbox.width / devicePixelRatio, zero), true);
    });
    this.#tell();
  }

  #point(x) {
    this.cursorAt = x;
    this.#tell();
  }

  #tell() {
    const zero = this.frozen?.zero ?? this.rows.newest;
    const pointed = this.cursorAt !== null;
    const t = pointed ? zero + this.cursorAt : zero;
    let row = this.rows.find(t + 1e-9) - 1;
    row = Math.max(0, row);
    SIGNALS.forEach((signal, i) => {
      const value = this.values?.[i];
      if (!value || !this.rows.length) return;
      const least = this.rows.at(row, 1 + 2 * i);
      const largest = this.rows.at(row, 2 + 2 * i);
      const text = Number.isNaN(least)
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
      this.zoom(Math.max(-KEPT_S, middle - half), Math.min(0, middle + half));
      event.preventDefault();
    }
  }
}
