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
  if (field.value === text) {
    field.value = "";
    byId("plots").focus(); // the space bar stops from there
  }
  notice(recorded ? "the note is in the recording" : "no run is being recorded, so the note is not in a recording");
}

// While the motor may turn the space bar alone is always the stop; with Shift a note takes a blank.
export const takesBlank = (event) => event.target === byId("note-text") && event.shiftKey;
