// Plots of models: their curves in linked colours, with zoom, cursor and pictures.

import { charts, colour, wheel } from "./chart.js";
import { byId, make } from "./elements.js";
import { dashOf, drawnSeries, drawShapes, highsOf, lowsOf, paperColour, svgShapes } from "./model_shapes.js";
import { swatch } from "./model_table.js";
import { savePng, saveSvg } from "./picture.js";

const LARGEST_PLANE = 2.5; // largest |z| that is shown first
const MOST_NAMED = 8; // values at the cursor
let shown = []; // of each chart {u, panel, models, extent, value, outside}
let shownKey = "";

// Join the panels of several models; equal panels become one, and the measured curve is in it once.
function joined(answers) {
  const panels = new Map();
  for (const { model, panels: found } of answers) {
    for (const panel of found) {
      const key = [panel.title, panel.y.label, panel.y.unit].join("|");
      if (!panels.has(key)) panels.set(key, { ...panel, key, series: panel.series.filter((one) => one.model === null) });
      panels.get(key).series.push(...panel.series.filter((one) => one.model !== null).map((one) => ({ ...one, model })));
    }
  }
  return [...panels.values()];
}

// Show the curves of the models: `answers` are {model, panels}, and `models` the visible ones. If
// only the switches have changed, the charts are drawn again with the same zoom. The visible models
// are a map to {name, colour}.
export function showPlots(kind, answers, models) {
  const panels = joined(answers);
  const key = JSON.stringify([kind, panels.map((panel) => panel.key)]);
  if (key !== shownKey) {
    for (const { u } of shown) u.destroy();
    byId("model-curves").replaceChildren();
    shownKey = key;
    shown = [];
    for (const panel of panels) shown.push(chartOf(kind, panel, panels, models));
  }
  shown.forEach((one, i) => {
    Object.assign(one, { panel: panels[i], models });
    one.u.setData(extentOf(one), true);
    tellOutside(one);
  });
}

// Return the range of a chart's x and y values as data of uPlot, which sets the scales by them.
function extentOf(chart) {
  const all = chart.panel.series;
  const ends = (columns) => {
    let [low, high] = [Infinity, -Infinity];
    for (const values of columns) {
      for (const x of values) {
        if (x === null) continue;
        if (x < low) low = x;
        if (x > high) high = x;
      }
    }
    return low < high ? [low, high] : Number.isFinite(low) ? [low - 1, low + 1] : [1, 2];
  };
  const margin = all.some(({ style }) => style === "stems") ? 0.7 : 0;
  const [first, last] = ends(all.map(({ x }) => x));
  chart.extent = [first - margin, last + margin];
  return [chart.extent, [0, 0]];
}

// Return the range of the visible values. Only the bands of residuals count.
function valueRange(chart) {
  const { u, panel } = chart;
  if (u.wantedY) return u.wantedY;
  const [from, to] = u.wanted ?? chart.extent;
  let [low, high] = [Infinity, -Infinity];
  for (const one of drawnSeries(chart)) {
    const [lows, highs, isStems] = [lowsOf(one), highsOf(one), one.style === "stems"];
    for (let i = 0; i < one.x.length; i++) {
      if (one.x[i] < from || one.x[i] > to || lows[i] === null) continue;
      low = Math.min(low, lows[i], isStems ? one.low?.[i] ?? 0 : low);
      high = Math.max(high, highs[i], isStems ? one.high?.[i] ?? 0 : high);
    }
  }
  for (const band of panel.bands) [low, high] = [Math.min(low, band.low), Math.max(high, band.high)];
  if (low > high) return [-1, 1];
  const half = Math.max((high - low) * 0.55, Math.abs(high) * 1e-6, 1e-12);
  return [(low + high) / 2 - half, (low + high) / 2 + half];
}

const rootsOf = (chart) => drawnSeries(chart).filter(({ style }) => style === "cross" || style === "ring");

// Return half the height of the complex plane that is shown first.
const reachOf = (chart) => Math.min(LARGEST_PLANE, Math.max(1.1, ...rootsOf(chart).flatMap((one) => one.x.flatMap((re, i) => [1.1 * Math.abs(re), 1.1 * Math.abs(one.y[i])]))));

function tellOutside(chart) {
  if (!chart.u.isPlane) return;
  const reach = reachOf(chart);
  const count = rootsOf(chart).reduce((sum, one) => sum + one.x.filter((re, i) => Math.hypot(re, one.y[i]) > reach).length, 0);
  chart.outside.textContent = count && !chart.u.wantedY ? `${count} outside of this view: zoom out` : "";
}

function chartOf(kind, panel, panels, models) {
  const isPlane = kind === "poles";
  const value = make("span", { className: "value" });
  const outside = make("span", { className: "hint" });
  const place = make("div", { className: "chart" }, make("div", { className: "chart-head" }, make("span", { textContent: isPlane ? panel.title : `${panel.y.label === panel.title ? "" : `${panel.title}: `}${axisText(panel.y)}` }), outside), make("p", { className: "hint" }, value));
  byId("model-curves").append(place);
  const isShared = kind !== "residuals" && !isPlane; // the x axis of several charts
  const chart = { panel, models, value, outside };
  const group = () => (isShared ? shown : [chart]);
  const onZoom = (from, to) => zoom(group(), from, to);
  const font = "12px system-ui, DejaVu Sans, sans-serif";
  const axis = { stroke: () => colour("soft"), grid: { stroke: () => colour("grid"), width: 1 }, ticks: { stroke: () => colour("line"), width: 1 }, font };
  const text = (label) => (u, splits) => splits.map((x, i) => (x === null ? "" : `${+x.toPrecision(6)}${label && i === splits.length - 1 ? ` ${label}` : ""}`));
  const width = place.clientWidth || 300;
  const ratio = (u) => (u.width - 80) / (u.height - 40);
  const rangeX = (u) => u.wanted ?? (isPlane ? [-1, 1].map((way) => way * reachOf(chart) * ratio(u)) : chart.extent);
  const rangeY = (u) => (isPlane ? (u.wantedY ?? [-reachOf(chart), reachOf(chart)]) : valueRange(chart));
  const u = new uPlot(
    {
      width,
      height: isPlane ? Math.min(width, 460) : panels.length > 1 ? 210 : 300,
      legend: { show: false },
      cursor: { drag: { x: true, y: isPlane, setScale: false }, points: { show: false }, y: isPlane, sync: isShared ? { key: "models", setSeries: false } : undefined },
      scales: { x: { time: false, distr: panel.x.log ? 3 : 1, range: rangeX }, y: { range: rangeY } },
      axes: [
        { ...axis, size: 30, values: text(panel.x.log ? "" : panel.x.unit || panel.x.label) },
        { ...axis, size: 64, space: 22, values: text("") },
      ],
      series: [{}, { paths: () => null, points: { show: false } }],
      hooks: {
        draw: [(u) => drawShapes(u, chart)],
        ready: [(u) => u.over.addEventListener("wheel", (event) => (isPlane ? planeWheel(u, event) : wheel(u, event, onZoom)), { passive: false })],
        destroy: [(u) => charts.delete(u)],
        setSelect: [(u) => select(u, onZoom)],
        setCursor: [(u) => (value.textContent = u.cursor.left >= 0 ? (isPlane ? rootText(u, chart) : valuesText(u, chart)) : "")],
      },
    },
    [chart.panel.x.log ? [1, 2] : [0, 1], [0, 0]],
    place,
  );
  u.over.addEventListener("dblclick", () => showWhole(group()));
  Object.assign(u, { isPlane, shapes: (at, up) => svgShapes(chart, at, up) });
  charts.add(u);
  return Object.assign(chart, { u });
}

// Zoom the x axis of charts; the range stays within the data.
function zoom(group, from, to) {
  for (const { u, extent, panel } of group) {
    const [low, high] = extent;
    const seen = [Math.max(low, from), Math.min(high, to)];
    if (u.isPlane) u.wanted = [from, to];
    else if (seen[1] - seen[0] > (high - low) * 1e-4 * (panel.x.log ? 0.01 : 1)) u.wanted = seen;
    u.setData(u.data, true);
  }
}

export function showWhole(group = shown) {
  for (const chart of group) {
    Object.assign(chart.u, { wanted: null, wantedY: null });
    chart.u.setData(chart.u.data, true);
    tellOutside(chart);
  }
}

function select(u, onZoom) {
  const { left, top, width, height } = u.select;
  if (width > 4) {
    if (u.isPlane) u.wantedY = [u.posToVal(top + height, "y"), u.posToVal(top, "y")];
    onZoom(u.posToVal(left, "x"), u.posToVal(left + width, "x"));
  }
  u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
}

// Zoom the complex plane at a place in pixels, in both directions.
function zoomPlane(u, factor, left, top) {
  for (const [scale, name, at] of [["x", "wanted", u.posToVal(left, "x")], ["y", "wantedY", u.posToVal(top, "y")]]) {
    const { min, max } = u.scales[scale];
    u[name] = [min, max].map((z) => at + (z - at) * factor);
  }
  u.setData(u.data, true);
}

function planeWheel(u, event) {
  event.preventDefault();
  zoomPlane(u, event.deltaY > 0 ? 1.25 : 0.8, u.cursor.left, u.cursor.top);
}

// Handle a key of the plots: arrows move the cursor, + and - zoom, Escape shows everything.
export function onModelPlotKey(event) {
  if (event.target !== byId("model-plots") || !shown.length) return;
  const way = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
  for (const chart of shown) {
    const { u } = chart;
    const [wide, high] = [u.over.clientWidth, u.over.clientHeight];
    const left = u.cursor.left >= 0 ? u.cursor.left : wide / 2;
    if (way) u.setCursor({ left: Math.min(wide, Math.max(0, left + (way * wide * (event.shiftKey ? 10 : 1)) / 100)), top: high / 2 });
    else if (!["+", "-"].includes(event.key)) continue;
    else if (u.isPlane) zoomPlane(u, event.key === "+" ? 0.5 : 2, left, u.cursor.top >= 0 ? u.cursor.top : high / 2);
    else {
      const half = (wide / 4) * (event.key === "+" ? 1 : 4);
      zoom([chart], u.posToVal(left - half, "x"), u.posToVal(left + half, "x"));
    }
  }
  if (event.key === "Escape") showWhole();
  else if (!way && !["+", "-"].includes(event.key)) return;
  event.preventDefault();
}

export function resizePlots() {
  const width = byId("model-curves").clientWidth;
  for (const { u } of shown) if (width && u.width !== width) u.setSize({ width, height: u.isPlane ? Math.min(width, 460) : u.height });
}

const axisText = ({ label, unit }) => `${label}${unit && ` [${unit}]`}`;

// Save the visible part of the plots as "svg" or "png".
export function savePlots(kind, title, name) {
  const { models, panel: first } = shown[0];
  const parts = shown.map(({ u, panel }) => ({ u, signal: { name: `${panel.title}: ${axisText(panel.y)} over ${axisText(panel.x)}`, unit: "" } }));
  const measured = first.series.filter(({ model }) => model === null).map(({ name }) => ({ name, colour: -1 }));
  const legend = [...measured, ...models.values()].map((one) => ({ name: one.name, colour: paperColour(one.colour), dash: dashOf(one.colour).join(" ") }));
  return (kind === "svg" ? saveSvg : savePng)(parts, title, name, legend);
}

// Return the names of the visible curves, each with its line.
export function legendItems() {
  if (!shown.length) return [];
  const { models, panel } = shown[0];
  const measured = panel.series.filter(({ model }) => model === null).map(({ name }) => make("span", {}, make("i", { className: "model-line" }), ` ${name}`));
  return [...measured, ...[...models.values()].map(({ name, colour: n }) => make("span", {}, swatch(n), ` ${name}`))];
}

// Return the values of the visible curves at the cursor as text.
function valuesText(u, chart) {
  const at = u.posToVal(u.cursor.left, "x");
  const texts = drawnSeries(chart).slice(0, MOST_NAMED).map((one) => {
    const i = nearest(one.x, at);
    const [low, high] = [lowsOf(one)[i], highsOf(one)[i]];
    const text = low === null ? "not known" : [...new Set([low, high].map((y) => String(+y.toPrecision(4))))].join(" … ");
    return `${one.name} ${text}`;
  });
  const { label, unit } = chart.panel.x;
  const more = drawnSeries(chart).length > MOST_NAMED ? ", …" : "";
  return `${label} = ${+at.toPrecision(4)}${unit && ` ${unit}`}: ${texts.join(", ")}${more}`;
}

// Return the number of the value that is nearest to `at`; the values increase.
function nearest(x, at) {
  let [a, b] = [0, x.length - 1];
  while (b - a > 1) {
    const middle = (a + b) >> 1;
    if (x[middle] <= at) a = middle;
    else b = middle;
  }
  return at - x[a] < x[b] - at ? a : b;
}

// Return the pole or zero that is nearest to the cursor as text.
function rootText(u, chart) {
  let [least, text] = [Infinity, ""];
  for (const one of rootsOf(chart)) {
    one.x.forEach((re, i) => {
      const apart = Math.hypot(u.valToPos(re, "x") - u.cursor.left, u.valToPos(one.y[i], "y") - u.cursor.top);
      if (apart >= least) return;
      const imaginary = one.y[i] ? ` ${one.y[i] < 0 ? "−" : "+"} ${Math.abs(one.y[i]).toFixed(4)}i` : "";
      [least, text] = [apart, `${one.name}: ${one.style === "cross" ? "pole" : "zero"} ${re.toFixed(4)}${imaginary}, |z| = ${Math.hypot(re, one.y[i]).toFixed(4)}`];
    });
  }
  return text;
}
