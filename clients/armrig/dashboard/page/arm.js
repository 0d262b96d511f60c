// A drawing of the arm from above, which moves with the angles of its two joints.

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
    this.base = shape("g", { class: "base" }, shape("circle", { r: 34 }), shape("line", { x1: 0, y1: 0, x2: 34, y2: 0 }));
    this.arm = shape("g", { class: "arm" }, shape("line", { x1: 0, y1: 0, x2: 92, y2: 0 }), shape("circle", { cx: 92, cy: 0, r: 6 }));
    this.unbent = shape("line", { class: "unbent", x1: 34, y1: 0, x2: 98, y2: 0 });
    const drawing = shape("svg", { viewBox: "-105 -105 210 210", role: "img", "aria-label": "The rig from above" }, shape("circle", { class: "rim", r: 100 }), this.unbent, this.arm, this.base, shape("circle", { class: "axle", r: 4 }));
    this.note = make("p", { className: "hint", textContent: HINT });
    where.replaceChildren(drawing, this.note);
    this.drawing = drawing;
  }

  // Show the angles, in °; if an angle is unknown, show the last known angle in a pale colour.
  show(first, second) {
    this.drawing.classList.toggle("pale", first === null || second === null);
    if (first !== null) this.first = first;
    if (second !== null) this.second = second;
    const [base, arm] = [this.first ?? 0, (this.first ?? 0) + (this.second ?? 0)];
    for (const part of [this.base, this.unbent]) part.setAttribute("transform", `rotate(${-base})`);
    this.arm.setAttribute("transform", `rotate(${-arm})`);
  }

  // Return the angle of the first joint as text, with its name.
  text(label) {
    return this.first === undefined ? "" : `${label} ${this.first.toFixed(1)} °`;
  }

  // Show the age of the angles instead of the hint; "" for fresh angles.
  setAge(text) {
    if (this.note.textContent !== (text || HINT)) this.note.textContent = text || HINT;
  }
}
