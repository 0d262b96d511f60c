// A drawing of the rig from above, which moves with θ₁ and α.

import { make } from "./elements.js";

const HINT = "The rig from above. Dashed: the arm without deflection. Pale: the angle is in the dead band.";
const SVG = "http://www.w3.org/2000/svg";

function shape(tag, attributes, ...children) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

export class ArmDrawing {
  constructor(where) {
    // Angle 0 points to the right. The rig's angles are counterclockwise, and SVG's are clockwise.
    this.chassis = shape("g", { class: "chassis" }, shape("circle", { r: 34 }), shape("line", { x1: 0, y1: 0, x2: 34, y2: 0 }));
    this.arm = shape("g", { class: "arm" }, shape("line", { x1: 0, y1: 0, x2: 92, y2: 0 }), shape("circle", { cx: 92, cy: 0, r: 6 }));
    this.unbent = shape("line", { class: "unbent", x1: 34, y1: 0, x2: 98, y2: 0 });
    const drawing = shape("svg", { viewBox: "-105 -105 210 210", role: "img", "aria-label": "The chassis and its arm from above" }, shape("circle", { class: "rim", r: 100 }), this.unbent, this.arm, this.chassis, shape("circle", { class: "axle", r: 4 }));
    this.note = make("p", { className: "hint", textContent: HINT });
    where.replaceChildren(drawing, this.note);
    this.drawing = drawing;
  }

  // Show the angles, in °; if an angle is unknown, show the last known angle in a pale colour.
  show(theta_1, alpha) {
    this.drawing.classList.toggle("pale", theta_1 === null || alpha === null);
    if (theta_1 !== null) this.theta_1 = theta_1;
    if (alpha !== null) this.alpha = alpha;
    const [chassis, arm] = [this.theta_1 ?? 0, (this.theta_1 ?? 0) + (this.alpha ?? 0)];
    for (const part of [this.chassis, this.unbent]) part.setAttribute("transform", `rotate(${-chassis})`);
    this.arm.setAttribute("transform", `rotate(${-arm})`);
  }

  get text() {
    return this.theta_1 === undefined ? "" : `θ₁ ${this.theta_1.toFixed(1)} °`;
  }

  // Show the age of the angles instead of the hint; "" for fresh angles.
  setAge(text) {
    if (this.note.textContent !== (text || HINT)) this.note.textContent = text || HINT;
  }
}
