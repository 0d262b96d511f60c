// A note: a line that goes into the recording while it runs.

import { askJson, attempt, byId, notice, owner } from "./elements.js";

export function setUpNote() {
  byId("note").addEventListener("submit", (event) => {
    event.preventDefault();
    attempt(send);
  });
}

async function send() {
  const field = byId("note-text");
  const text = field.value;
  const { recorded } = await askJson("note", { owner: owner(), text: text.trim() });
  if (field.value === text) field.value = "";
  byId("plots").focus(); // the space bar stops from there
  notice(recorded ? "the note is in the recording" : "no run is being recorded, so the note is in no recording of the daemon");
}

// While the motor may turn a note takes a blank behind a letter only: whoever hits the space bar in
// an empty field, twice, or for long, means the stop.
export const takesBlank = (target) => target === byId("note-text") && /\S$/.test(target.value);
