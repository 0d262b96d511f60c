// Picture of the visible curves, as SVG and PNG.

import { limitsOf } from "./chart.js";
import { make, notice } from "./elements.js";
import { placedNames } from "./marks.js";

const [WIDTH, HEIGHT, LEFT, TOP, GAP] = [1000, 170, 80, 84, 40];
const LETTER = 7.5; // width of a letter, in pixels
const [IN_A_ROW, LEGEND_ROW] = [4, 16]; // names of a legend in a row; height of a row
const PNG_SCALE = 2;

const escaped = (text) => String(text).replace(/[&<>"]/g, (c) => `&#${c.charCodeAt(0)};`);
const text = (x, y, what, more = "") => `<text x="${x.toFixed(1)}" y="${y.toFixed(1)}" ${more}>${escaped(what)}</text>`;

const PLOT_WIDTH = WIDTH - LEFT - 20;

// Return the height of a chart. A complex plane has the same scale on both axes.
const heightOf = ({ isPlane, scales: { x, y } }) => (isPlane ? (PLOT_WIDTH * (y.max - y.min)) / (x.max - x.min) : HEIGHT);

// Return one chart as SVG: frame, labels as on the page, curves and marks.
function panel(u, { signal, letter }, top) {
  const [x, y, width, high] = [u.scales.x, u.scales.y, PLOT_WIDTH, heightOf(u)];
  const along = x.distr === 3 ? Math.log : (t) => t;
  const at = (t) => LEFT + ((along(t) - along(x.min)) / (along(x.max) - along(x.min))) * width;
  const up = (value) => top + high - ((value - y.min) / (y.max - y.min)) * high;
  const labels = (axis) => u.axes[axis]._splits.map((value, i) => [value, u.axes[axis]._values[i]]);
  const out = [text(LEFT, top - 8, `(${letter}) ${signal.name}${signal.unit && ` [${signal.unit}]`}`)];
  for (const [value, label] of labels(1)) {
    if (value < y.min || value > y.max) continue;
    out.push(`<path d="M${LEFT} ${up(value).toFixed(1)}h${width}" stroke="#ddd"/>`, text(LEFT - 6, up(value) + 4, label ?? "", 'text-anchor="end"'));
  }
  for (const [value, label] of labels(0)) {
    if (value < x.min || value > x.max) continue;
    out.push(`<path d="M${at(value).toFixed(1)} ${top}v${high}" stroke="#ddd"/>`, text(at(value), top + high + 16, label ?? "", 'text-anchor="middle"'));
  }
  for (const { x: t } of u.marks ?? []) {
    if (t < x.min || t > x.max) continue;
    out.push(`<path d="M${at(t).toFixed(1)} ${top}v${high}" stroke="#888"/>`);
  }
  const names = u.namesMarks ? placedNames(u.marks ?? [], { width, at: (t) => at(t) - LEFT, widthOf: (words) => words.length * LETTER }) : [];
  for (const { text: name, x: left, row } of names) out.push(text(LEFT + left, top - 8 - 14 * (row + 1), name, 'fill="#555"'));
  for (const { y: value, text: name, isUpper } of limitsOf(signal)) {
    if (value < y.min || value > y.max) continue;
    out.push(`<path d="M${LEFT} ${up(value).toFixed(1)}h${width}" stroke="#b00020"/>`, text(LEFT + 6, up(value) + (isUpper ? 13 : -4), name, 'fill="#b00020"'));
  }
  out.push(`<clipPath id="clip-${letter}"><rect x="${LEFT}" y="${top}" width="${width}" height="${high}"/></clipPath>`);
  if (u.shapes) out.push(`<g clip-path="url(#clip-${letter})">${u.shapes(at, up)}</g>`);
  else for (const [d, colour, dash] of curves(u, at, up)) out.push(`<path d="${d}" fill="none" stroke="${colour}" stroke-width="1.3" stroke-dasharray="${dash}" clip-path="url(#clip-${letter})"/>`);
  return out.join("\n");
}

// Yield the path, colour and dashes of each curve. A path goes through the least and the largest
// value at each time, with breaks at missing values.
function* curves(u, at, up) {
  const x = u.data[0];
  for (let s = 1; s < u.data.length; s += 2) {
    let d = "";
    let isUp = true;
    for (let i = 0; i < x.length; i++) {
      const [low, high] = [u.data[s][i], u.data[s + 1][i]];
      if (low === undefined) continue;
      if (low === null) {
        isUp = true;
        continue;
      }
      const place = at(x[i]).toFixed(1);
      d += isUp ? `M${place} ${up(low).toFixed(1)}` : (s === 1 ? u.isStepped : u.isOverStepped) ? `H${place}V${up(low).toFixed(1)}` : `L${place} ${up(low).toFixed(1)}`;
      if (high !== low) d += `V${up(high).toFixed(1)}`;
      isUp = false;
    }
    if (d) yield [d, s === 1 ? "#0059a0" : "#b84a00", s === 1 ? "" : "6 3"];
  }
}

// Return the lines and names of a legend, which are {name, colour, dash}, below the title.
const legendRows = (legend) =>
  legend.map(({ name, colour, dash }, i) => {
    const [x, y] = [LEFT + (i % IN_A_ROW) * (PLOT_WIDTH / IN_A_ROW), 44 + LEGEND_ROW * Math.floor(i / IN_A_ROW)];
    return `<path d="M${x.toFixed(1)} ${y - 4}h24" stroke="${colour}" stroke-width="2" stroke-dasharray="${dash}"/>${text(x + 30, y, name)}`;
  });

// charts: a list of {u, signal}; title: the text above the charts; legend: of charts with shapes.
function svgOf(charts, title, legend = []) {
  let top = TOP + LEGEND_ROW * Math.max(0, Math.ceil(legend.length / IN_A_ROW) - 1);
  const panels = legendRows(legend);
  for (const [i, { u, signal }] of charts.entries()) {
    panels.push(panel(u, { signal, letter: String.fromCharCode(97 + i) }, top));
    top += heightOf(u) + GAP;
  }
  const height = Math.round(top + 10);
  return `<svg xmlns="http://www.w3.org/2000/svg" width="${WIDTH}" height="${height}" viewBox="0 0 ${WIDTH} ${height}" font-family="DejaVu Sans, Arial, sans-serif" font-size="12">
<rect width="100%" height="100%" fill="#fff"/>
${text(LEFT, 24, title, 'font-size="15"')}
${panels.join("\n")}
</svg>`;
}

async function pngOf(svg) {
  const url = URL.createObjectURL(new Blob([svg], { type: "image/svg+xml" }));
  const image = make("img", { src: url });
  await image.decode();
  const canvas = make("canvas", { width: PNG_SCALE * image.naturalWidth, height: PNG_SCALE * image.naturalHeight });
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  URL.revokeObjectURL(url);
  return new Promise((done) => canvas.toBlob(done, "image/png"));
}

export function save(data, name) {
  const link = make("a", { href: URL.createObjectURL(data), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
  notice(`${name}: ${data.size} B`);
}

// Save the visible curves as a picture; `name` has no ending.
export async function saveSvg(charts, title, name, legend) {
  save(new Blob([svgOf(charts, title, legend)], { type: "image/svg+xml" }), `${name}.svg`);
}

export async function savePng(charts, title, name, legend) {
  save(await pngOf(svgOf(charts, title, legend)), `${name}.png`);
}
