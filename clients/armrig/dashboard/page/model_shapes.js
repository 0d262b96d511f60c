// Shapes of the curves of models, drawn on a canvas or written as SVG.

import { colour } from "./chart.js";
import { COLOURS } from "./model_table.js";

// Colours of pictures, on white: those of the light theme in dashboard.css.
const PAPER = ["#0072b2", "#b84a00", "#007a5a", "#6b2fb3", "#b0186a", "#7a6200", "#3f7000", "#5a5f66"];
const PAPER_INK = "#14181d"; // of the measured curve
const MEASURED = -1; // as the number of a colour
const MARK = 4; // half a cross, in pixels
const DASHES = [[], [6, 4], [2, 3]];

export const paperColour = (n) => (n === MEASURED ? PAPER_INK : PAPER[n % COLOURS]);
const themeColour = (n) => colour(n === MEASURED ? "u" : `m${n % COLOURS}`);
export const dashOf = (n) => (n === MEASURED ? [] : DASHES[Math.floor(n / COLOURS) % DASHES.length]);

export const lowsOf = (one) => one.least ?? one.y;
export const highsOf = (one) => one.largest ?? one.y;

// Return the visible series of a chart: those of the models that are switched on, and the measured one.
export const drawnSeries = ({ panel, models }) => panel.series.filter(({ model }) => model === null || models.has(model));

// Draw the curves of a chart on its canvas.
export function drawShapes(u, chart) {
  const { left, top, width, height } = u.bbox;
  const pen = u.ctx;
  pen.save();
  pen.beginPath();
  pen.rect(left, top, width, height);
  pen.clip();
  pen.lineJoin = "round";
  const places = { at: (x) => u.valToPos(x, "x", true), up: (y) => u.valToPos(y, "y", true), pixel: devicePixelRatio };
  for (const { path, n, width, dash, opacity } of shapes(chart, Path2D, places)) {
    pen.globalAlpha = opacity ?? 1;
    if (opacity) {
      pen.fillStyle = themeColour(n);
      pen.fill(path);
      continue;
    }
    Object.assign(pen, { strokeStyle: themeColour(n), lineWidth: width * devicePixelRatio });
    pen.setLineDash(dash.map((length) => length * devicePixelRatio));
    pen.stroke(path);
  }
  pen.restore();
}

// Return the curves of a chart as SVG; `at` and `up` return the place of a value.
export function svgShapes(chart, at, up) {
  const texts = [...shapes(chart, SvgPath, { at, up, pixel: 1 })].map(({ path, n, width, dash, opacity }) => {
    const how = opacity ? `fill="${paperColour(n)}" fill-opacity="${opacity}"` : `fill="none" stroke="${paperColour(n)}" stroke-width="${width}" stroke-dasharray="${dash.join(" ")}"`;
    return `<path d="${path.d}" ${how}/>`;
  });
  return texts.join("\n");
}

class SvgPath {
  d = "";
  moveTo(x, y) {
    this.d += `M${x.toFixed(1)} ${y.toFixed(1)}`;
  }
  lineTo(x, y) {
    this.d += `L${x.toFixed(1)} ${y.toFixed(1)}`;
  }
}

// Yield the shapes of a chart as {path, n, width, dash, opacity}: n is the number of the colour, and a
// shape with opacity is an area. The bands come first, so that no curve is hidden.
function* shapes(chart, Path, places) {
  const series = drawnSeries(chart);
  const order = [...chart.models.keys()];
  const numberOf = ({ model }) => (model === null ? MEASURED : chart.models.get(model).colour);
  const line = (x, y) => trace(new Path(), { style: "line", x, y }, places, 0);
  for (const { low, high } of chart.panel.bands) {
    for (const y of [low, high]) yield { path: line(chart.extent, [y, y]), n: MEASURED, width: 1, dash: [5, 4] };
  }
  const bands = series.filter(({ low }) => low);
  for (const one of bands) {
    if (one.style !== "stems") yield { path: area(new Path(), one, places), n: numberOf(one), opacity: Math.min(0.2, 0.36 / bands.length) };
    else for (const edge of [one.low, one.high]) yield { path: line(one.x, edge), n: numberOf(one), width: 1, dash: [5, 4] };
  }
  for (const one of series) {
    const isLine = one.style === "line";
    const isRegion = chart.u.isPlane && isLine; // or the unit circle
    const apart = Math.min(4, 12 / order.length); // pixels between the stems of two models
    const shift = one.style === "stems" ? (order.indexOf(one.model) - (order.length - 1) / 2) * apart * places.pixel : 0;
    yield { path: trace(new Path(), one, places, shift), n: numberOf(one), width: isRegion ? 1 : isLine ? 1.6 : 2, dash: isLine && !isRegion ? dashOf(numberOf(one)) : [] };
  }
}

// Add a series to a path, which breaks at missing values; marks are `shift` to the right.
function trace(path, one, { at, up, pixel }, shift) {
  const [lows, highs] = [lowsOf(one), highsOf(one)];
  let before = null; // height of the last point; null after a break
  for (let i = 0; i < one.x.length; i++) {
    if (lows[i] === null) {
      before = null;
      continue;
    }
    const [x, low] = [at(one.x[i]), up(lows[i])];
    if (one.style !== "line") {
      for (const points of markOf(one.style, x + shift, low, up(0), MARK * pixel)) follow(path, points);
      continue;
    }
    const ends = highs[i] === lows[i] ? [low] : [low, up(highs[i])];
    if (before !== null && ends.length > 1 && Math.abs(before - ends[1]) < Math.abs(before - low)) ends.reverse();
    if (before === null) path.moveTo(x, ends[0]);
    for (const y of ends) path.lineTo(x, y);
    before = ends.at(-1);
  }
  return path;
}

const CIRCLE = Array.from({ length: 17 }, (_, k) => [Math.cos((k * Math.PI) / 8), Math.sin((k * Math.PI) / 8)]);

// Return the lines of a mark at a place, each a list of points; r is half its size.
function markOf(style, x, y, zero, r) {
  if (style === "stems") return [[[x, zero], [x, y]]];
  if (style === "ring") return [CIRCLE.map(([a, b]) => [x + r * a, y + r * b])];
  if (style === "cross") return [[[x - r, y - r], [x + r, y + r]], [[x - r, y + r], [x + r, y - r]]];
  return [[[x - r / 8, y], [x + r / 8, y]]];
}

function area(path, { x, low, high }, { at, up }) {
  const known = x.map((_, i) => i).filter((i) => low[i] !== null && high[i] !== null);
  return follow(path, [...known.map((i) => [at(x[i]), up(low[i])]), ...known.reverse().map((i) => [at(x[i]), up(high[i])])]);
}

function follow(path, points) {
  points.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
  return path;
}
