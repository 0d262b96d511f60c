// A chart of least and largest values in the page's colours: uPlot's, with zoom and cursor.

const colours = new Map(); // of this theme: to ask the style at each of twenty drawings a second is slow

function colour(name) {
  if (!colours.has(name)) colours.set(name, getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim());
  return colours.get(name);
}

const charts = new Set(); // all that are on the page

// Draw all anew, in the colours of another theme.
export function redrawCharts() {
  colours.clear();
  for (const one of charts) one.redraw(false, true);
}

// From the least to the largest value of each pixel, and on to the next; lifted where there is none.
// uPlot's own paths go across a break and are clipped there to whole pixels, which leaves stubs.
function drawnPath(u, from, to, stepped) {
  const [x, low, high] = u.data;
  const path = new Path2D();
  let before = null; // y of the last point drawn, null where the pen is up
  for (let i = from; i <= to; i++) {
    if (low[i] == null) {
      before = null;
      continue;
    }
    const at = u.valToPos(x[i], "x", true);
    const ends = [u.valToPos(low[i], "y", true), u.valToPos(high[i], "y", true)];
    // First the end that is nearer.
    if (before !== null && Math.abs(before - ends[1]) < Math.abs(before - ends[0])) ends.reverse();
    if (before === null) path.moveTo(at, ends[0]);
    else if (stepped) path.lineTo(at, before);
    for (const y of ends) path.lineTo(at, y);
    before = ends[1];
  }
  return path;
}

// A chart of least and largest values in the page's colours.
export function chart(where, { signal, height, xLabel, onZoom, onCursor, sync, stepped }) {
  const ink = () => colour("soft");
  const stroke = () => colour(signal.key);
  const axis = { stroke: ink, grid: { stroke: () => colour("grid"), width: 1 }, ticks: { stroke: () => colour("line"), width: 1 }, font: "12px system-ui, DejaVu Sans, sans-serif" };
  const series = { stroke, width: 1.5, points: { show: false } };
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
      series: [{}, { ...series, paths: (u, i, from, to) => ({ stroke: drawnPath(u, from, to, stepped), fill: null }) }, { ...series, paths: () => null }],
      hooks: {
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
    [[], [], []],
    where,
  );
  charts.add(made);
  return made;
}
