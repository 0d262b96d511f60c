// Choice of a control law from the folder of the recordings, and the levels of its reference.

import { askJson, byId, make } from "./elements.js";

let laws = []; // those that fit the rig
let word = "";

// Return the chosen law; undefined without one.
export const chosenLaw = () => laws.find(({ file }) => file === byId("field-law").value);

// Ask for the laws, and list them; each file that is no law for this rig has its reason in a row.
export async function listLaws() {
  const found = await askJson("laws", {});
  const before = byId("field-law").value;
  laws = found.laws.filter(({ why }) => !why);
  word = found.word;
  byId("field-law").replaceChildren(...laws.map(({ file, method, reference }) => make("option", { value: file, textContent: `${file}: ${method ? `${method}, ` : ""}r is ${reference.name}` })));
  byId("field-law").value = chosenOf(before);
  const rows = found.laws.filter(({ why }) => why).map(({ file, why }) => `${file}: ${why}`);
  if (!laws.length) rows.unshift(`no law for this rig in ${found.folder}: \`armrig design -h\` lists the commands that write a law`);
  byId("law-faults").replaceChildren(...rows.map((textContent) => make("li", { textContent })));
}

const chosenOf = (before) => (laws.some(({ file }) => file === before) ? before : (laws[0]?.file ?? ""));

// Show the levels and the word of the chosen law; return the names of the fields that it has not.
export function showLaw() {
  const law = chosenLaw();
  const isStaircase = byId("field-reference").value === "staircase";
  const hidden = [...(isStaircase ? [] : ["levels"]), ...(law && !law.monitored ? [] : ["word"])];
  if (!law) return [...hidden, "r_low", "r_high"];
  const { unit, low, high } = law.reference;
  const short = (value) => +value.toPrecision(4);
  for (const [name, label, level] of [["r_low", `lowest r [${unit}], from ${short(low)}`, law.levels[0]], ["r_high", `highest r [${unit}], to ${short(high)}`, law.levels[1]]]) {
    const input = byId(`field-${name}`);
    Object.assign(input, { min: low, max: high, placeholder: `${short(level)}` });
    byId(`label-${name}`).replaceChildren(label, input);
  }
  const length = byId("field-seconds");
  length.placeholder = law.monitored ? "what suits the law" : "";
  byId("label-word").replaceChildren(`this law has no monitor: a stuck sensor then drives the rig to full input. To allow it, type ${word}`, byId("field-word"));
  return hidden;
}
