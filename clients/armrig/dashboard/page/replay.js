// Replay of a recording on the page: the cursor moves over the curves, and the drawn arm moves, too.

import { ArmDrawing } from "./arm.js";
import { valuesAt } from "./compared.js";
import { make } from "./elements.js";

export class Replay {
  // charts: the charts; curves: returns the curves by signal; range: returns the visible range [from, to] in s;
  // angles: the keys of the arm's angles; none for another rig, which is not drawn.
  constructor(charts, curves, range, angles) {
    this.angles = angles;
    this.charts = charts;
    this.curves = curves;
    this.range = range;
    this.speed = 0; // 0 at rest
    this.t = null;
    this.buttons = [1, 10].map((speed) => {
      const button = make("button", { type: "button", textContent: `Replay ${speed} ×`, "aria-pressed": "false" });
      button.addEventListener("click", () => this.play(this.speed === speed ? 0 : speed));
      button.dataset.speed = speed;
      return button;
    });
    this.time = make("span", { className: "value" });
    const drawing = make("div", { className: "arm-drawing", hidden: !angles.length });
    this.arm = new ArmDrawing(drawing);
    this.element = make("div", { className: "tools", id: "replay" }, ...this.buttons, this.time, drawing);
  }

  play(speed) {
    const [from, to] = this.range();
    if (this.t === null || this.t < from || this.t >= to) this.t = from;
    const isGoing = this.speed > 0;
    this.speed = speed;
    for (const button of this.buttons) button.setAttribute("aria-pressed", String(Number(button.dataset.speed) === speed));
    if (speed && !isGoing) requestAnimationFrame((now) => this.#step(now, now));
  }

  #step(now, before) {
    if (!this.speed || !this.element.isConnected) return;
    const [, to] = this.range();
    this.t = Math.min(to, this.t + (this.speed * (now - before)) / 1000);
    this.#show();
    if (this.t >= to) this.play(0);
    else requestAnimationFrame((next) => this.#step(next, now));
  }

  #show() {
    const left = this.charts[0].valToPos(this.t, "x");
    for (const u of this.charts) u.setCursor({ left, top: 10 });
    this.time.textContent = `${this.t.toFixed(2)} s`;
    if (!this.angles.length) return;
    const [first, second] = this.angles.map((key) => valuesAt(this.curves()[key], this.t)?.[0] ?? null);
    this.arm.show(first, second ?? null);
  }
}
