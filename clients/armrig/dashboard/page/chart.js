// A uPlot chart of least and largest values in the page's colours, with zoom and cursor.

import { placedNames, ROWS } from "./marks.js";

const colours = new Map(); // colours of the theme; reading the style 30 times a second would be slow

// Return a colour of the theme.
export function colour(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return colours.get(name);
}

export const charts = new Set(); // all charts on the page

// Draw all charts again, in the colours of another theme.
export function redrawCharts() {
  colours.clear();
  for (const one of charts) one.redraw(false, true);
}

// Return a path through the least and the largest value of each pixel, with breaks where values are
// missing. uPlot's own paths cross a break and are clipped to whole pixels, which leaves stubs.
function drawnPath(u, series, from, to, stepped) {
  const [x, low, high] = [u.data[0], u.data[series], u.data[series + 1]];
  const path = new Path2D();
  let before = null; // y of the last point drawn; null after a break
  for (let i = from; i <= to; i++) {
    if (low[i] === undefined) continue; // another curve's point
    if (low[i] === null) {
      before = null;
      continue;
    }
    const at = u.valToPos(x[i], "x", true);
    const ends = [u.valToPos(low[i], "y", true), u.valToPos(high[i], "y", true)];
    // Draw the nearer end first.
    if (before !== null && Math.abs(before - ends[1]) < Math.abs(before - ends[0])) ends.reverse();
    if (before === null) path.moveTo(at, ends[0]);
    else if (stepped) path.lineTo(at, before);
    for (const y of ends) path.lineTo(at, y);
    before = ends[1];
  }
  return path;
}

const REACH = 1; // of a range of values, in its width
const NAME_PIXELS = 11; // height of the names of marks and limits

// Return the least round number that is at least x.
function roundedUp(x) {
  const power = 10 ** Math.floor(Math.log10(x));
  return power * [1, 2, 3, 4, 6, 8, 10].find((step) => step * power >= x * (1 - 1e-9));
}

const markColour = (kind) => colour(kind === "trip" ? "bad" : kind === "start" ? "good" : "soft");

// Call `does` with a pen for texts of `size` pixels.
function withPen(u, size, does) {
  u.ctx.save();
  u.ctx.textBaseline = "alphabetic";
  u.ctx.textAlign = "left";
  u.ctx.font = `${size * devicePixelRatio}px system-ui, DejaVu Sans, sans-serif`;
  does(u.ctx, size * devicePixelRatio);
  u.ctx.restore();
}

// Draw a vertical line at each event in u.marks, which are {x, kind, text}. Their names are above
// the plot, where they hide no curve.
function drawMarks(u, size) {
  const { left, top, width, height } = u.bbox;
  withPen(u, size, (pen, high) => {
    for (const { x, kind } of u.marks ?? []) {
      const at = u.valToPos(x, "x", true);
      if (at < left || at > left + width) continue;
      pen.fillStyle = markColour(kind);
      pen.fillRect(Math.round(at), top, devicePixelRatio, height);
    }
    if (!u.namesMarks) return;
    const at = (x) => u.valToPos(x, "x", true) - left;
    for (const { text, x, row, kind } of placedNames(u.marks ?? [], { width, at, widthOf: (words) => pen.measureText(words).width })) {
      pen.fillStyle = markColour(kind);
      pen.fillText(text, left + x, top - high * (0.4 + 1.2 * row));
    }
  });
}

// Draw a red line with its name at each limit. A limit outside the plot has a dashed line at the edge.
function drawLimits(u, limits, size) {
  const { left, top, width, height } = u.bbox;
  withPen(u, size, (pen, high) => {
    for (const { y, isUpper, text } of limits) {
      const at = u.valToPos(y, "y", true);
      const seen = Math.round(Math.max(top, Math.min(top + height - devicePixelRatio, at)));
      const isInside = at >= top - devicePixelRatio && at <= top + height;
      pen.fillStyle = colour("bad");
      const dash = isInside ? width : 6 * devicePixelRatio;
      for (let x = 0; x < width; x += 2 * dash) pen.fillRect(left + x, seen, Math.min(dash, width - x), devicePixelRatio);
      const words = isInside ? text : `${text} ${at < top ? "↑" : "↓"}`;
      if (!text) continue;
      // The text is on the inner side of the line, on a ground of its own.
      const below = at < top || (isUpper && isInside);
      const base = seen + (below ? 1.15 : -0.35) * high;
      pen.fillStyle = colour("card");
      pen.fillRect(left + 4, base - high, pen.measureText(words).width + 4, 1.25 * high);
      pen.fillStyle = colour("bad");
      pen.fillText(words, left + 6, base);
    }
  });
}

// Return the limits of a signal as {y, isUpper, text}.
export function limitsOf({ limits = [], lawLimits = [], kind, unit }) {
  const [least, most] = kind === "turned" ? ["", "less than"] : ["at least", "at most"];
  const text = (y, side, name) => side && `${name}: ${side} ${+y.toPrecision(4)} ${unit}${kind === "turned" ? ", either way" : ""}`;
  const lines = (values, name) => values.flatMap((y, i) => (y === null ? [] : [{ y, isUpper: i === 1, text: text(y, i ? most : least, name) }]));
  return [...lines(limits, "limit"), ...lines(lawLimits.map((y, i) => (y === limits[i] ? null : y)), "limit of the law")];
}

// Return a range of values with the limits that are near to it: within `REACH` of its width.
function withNear([low, high], limits) {
  const reach = REACH * (high - low);
  const near = limits.map(({ y }) => y).filter((y) => y >= low - reach && y <= high + reach);
  return [Math.min(low, ...near), Math.max(high, ...near)];
}

// Handle the wheel: it zooms the time axis at the pointer. With Shift it moves in time; with Alt it
// zooms the values.
export function wheel(u, event, onZoom) {
  event.preventDefault();
  const factor = (event.deltaY || event.deltaX) > 0 ? 1.25 : 0.8;
  const [there, back] = u.scales.x.distr === 3 ? [Math.log, Math.exp] : [(x) => x, (x) => x]; // logarithmic
  const [min, max] = [there(u.scales.x.min), there(u.scales.x.max)];
  if (event.altKey) {
    const at = u.posToVal(u.cursor.top, "y");
    u.wantedY = [u.scales.y.min, u.scales.y.max].map((y) => at + (y - at) * factor);
    u.setData(u.data, true);
  } else if (event.shiftKey || Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
    const step = ((max - min) / 10) * (factor > 1 ? 1 : -1);
    onZoom?.(back(min + step), back(max + step));
  } else {
    const at = there(u.posToVal(u.cursor.left, "x"));
    onZoom?.(back(at + (min - at) * factor), back(at + (max - at) * factor));
  }
}

// The x axis shows x + u.origin.s: seconds from now, seconds since a start, or the time of day.
function xSplits(u, axis, min, max, step) {
  const origin = u.origin?.s ?? 0;
  const first = Math.ceil((min + origin) / step - 1e-9);
  return Array.from({ length: Math.floor((max + origin) / step + 1e-9) - first + 1 }, (_, i) => (first + i) * step - origin);
}

const xText = (u, x, unit) => (u.origin?.isClock ? clock(x + u.origin.s) : `${+(x + (u.origin?.s ?? 0)).toFixed(3)}${unit}`);

const fifths = ([low, high]) => [0, 1, 2, 3, 4].map((i) => low + ((high - low) * (i + 0.5)) / 5);

const clock = (s) => new Date(1000 * s).toTimeString().slice(0, 8);

// A chart of least and largest values in the page's colours. A second curve `over` the first one has
// this colour.
export function chart(where, { signal, height, xLabel, onZoom, onCursor, sync, stepped, over, isOverStepped, namesMarks, width = where.clientWidth, size = 12 }) {
  const ink = () => colour("soft");
  const stroke = () => colour(signal.colour);
  const axis = { stroke: ink, grid: { stroke: () => colour("grid"), width: 1 }, ticks: { stroke: () => colour("line"), width: 1 }, font: `${size}px system-ui, DejaVu Sans, sans-serif` };
  const series = { stroke, width: size / 8, points: { show: false } };
  const limits = limitsOf(signal);
  const range = (u, least, largest) => {
    if (u.wantedY) return u.wantedY;
    if (u.most) {
      const most = roundedUp(1.1 * u.most);
      return [Math.min(-most / 6, least ?? 0), Math.max(most, largest ?? 0)];
    }
    if (signal.range) return [(u.isDifference ? -signal.range[1] : signal.range[0]) - signal.pad, signal.range[1] + signal.pad];
    if (least === null || !Number.isFinite(least)) return [-signal.least, signal.least];
    if (signal.isSymmetric) {
      const half = roundedUp(Math.max(signal.least / 2, -least, largest));
      const [low, high] = withNear([-half, half], limits);
      const widest = roundedUp(Math.max(-low, high));
      return [-widest, widest];
    }
    const middle = (least + largest) / 2;
    const half = Math.max(signal.least / 2, ((largest - least) / 2) * 1.1);
    const seen = [middle - half, middle + half];
    const [low, high] = withNear(seen, limits);
    return [low === seen[0] ? low : low - half / 10, high === seen[1] ? high : high + half / 10];
  };
  // The least and the largest values are one path; only the first of the two series draws it.
  const names = size > 12 ? 0.8 * size : NAME_PIXELS;
  const pair = (one, isStepped) => [{ ...one, paths: (u, i, from, to) => ({ stroke: drawnPath(u, i, from, to, isStepped), fill: null }) }, { ...one, paths: () => null }];
  const withUnit = (u, splits) => splits.map((y, i) => `${+y.toPrecision(6)}${i === splits.length - 1 ? ` ${signal.unit}` : ""}`);
  const made = new uPlot(
    {
      width: width || 300,
      height,
      padding: [namesMarks ? Math.round(names * 1.2 * ROWS + 6) : null, null, null, null],
      legend: { show: false },
      cursor: { drag: { x: true, y: false, setScale: false }, points: { show: false }, y: false, sync: sync ? { key: sync, setSeries: false } : undefined },
      scales: { x: { time: false, range: (u, a, b) => u.wanted || [a, b] }, y: { range } },
      axes: [
        { ...axis, size: xLabel ? 18 + size : 8, splits: xSplits, values: (u, splits) => splits.map((x, i) => (xLabel ? xText(u, x, i === splits.length - 1 ? ` ${xLabel}` : "") : "")) },
        { ...axis, size: 10 + 4.5 * size, space: 1.7 * size, values: withUnit, ...(signal.splits ? { splits: (u) => (u.wantedY ? fifths(u.wantedY) : u.isDifference ? [-signal.range[1], 0, signal.range[1]] : signal.fewSplits && (size > 12 || u.height < 120) ? signal.fewSplits : signal.splits) } : {}) },
      ],
      series: [{}, ...pair(series, stepped), ...(over ? pair({ ...series, stroke: () => colour(over), dash: [6, 4] }, isOverStepped ?? stepped) : [])],
      hooks: {
        draw: [(u) => drawMarks(u, names), (u) => drawLimits(u, u.isDifference ? [] : limits, names)],
        ready: [(u) => u.over.addEventListener("wheel", (event) => wheel(u, event, onZoom), { passive: false })],
        destroy: [(u) => charts.delete(u)],
        setSelect: [
          (u) => {
            if (u.select.width > 4) onZoom?.(u.posToVal(u.select.left, "x"), u.posToVal(u.select.left + u.select.width, "x"));
            u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          },
        ],
        setCursor: [(u) => onCursor?.(u.cursor.left >= 0 ? u.posToVal(u.cursor.left, "x") : null, u)],
      },
    },
    over ? [[], [], [], [], []] : [[], [], []],
    where,
  );
  Object.assign(made, { isStepped: stepped, isOverStepped: isOverStepped ?? stepped });
  made.namesMarks = namesMarks;
  charts.add(made);
  return made;
}
