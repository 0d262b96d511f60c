// Keys of the live plots: arrows move the cursor, + and - zoom.

import { byId } from "./elements.js";

const CURSOR_STEPS = 100; // in the visible span

export function onPlotKey(plots, event) {
  if (event.target instanceof HTMLInputElement) return; // the user types a note
  const { from, to } = plots.seen;
  const steps = { ArrowLeft: -1, ArrowRight: 1 };
  if (event.key in steps && event.target === byId("plots")) {
    const step = ((to - from) / CURSOR_STEPS) * steps[event.key] * (event.shiftKey ? 10 : 1);
    const at = Math.min(to, Math.max(from, (plots.cursorAt ?? to) + step));
    const left = plots.charts[0].valToPos(at, "x");
    for (const u of plots.charts) u.setCursor({ left, top: 10 }, false);
    plots.point(at);
    event.preventDefault();
  } else if (event.key === "+" || event.key === "-") {
    const middle = plots.cursorAt ?? (from + to) / 2;
    const half = ((to - from) / 2) * (event.key === "+" ? 0.5 : 2);
    plots.zoom(middle - half, middle + half);
    event.preventDefault();
  }
}
