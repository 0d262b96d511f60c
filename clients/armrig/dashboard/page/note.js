// A note: a line of text that is written into the current recording.

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
    byId("plots").focus(); // with this focus, the space bar stops the motor
  }
  notice(recorded ? "the note is in the recording" : "no run is being recorded, so the note is not in a recording");
}

// Return whether a key types a space in the note: while the motor may turn, only Shift+Space does.
export const takesBlank = (event) => event.target === byId("note-text") && event.shiftKey;
