// Stream of events from the server; if the stream breaks, it is opened again until this succeeds.

import { ask } from "./elements.js";

const SILENT_MS = 700; // without a message for this time the server is silent; it sends 30 a second
const AGAIN_MS = 250;
const LOOK_MS = 100;
const BUSY_MS = 500; // if the timer is later than this, the browser is busy, not the server silent
const LOST_MS = 5000; // after this silence the stream is opened again; also limit for its first answer

export class Stream {
  constructor(handlers, lost, busy) {
    this.handlers = handlers;
    this.lost = lost; // called repeatedly with a reason while no message arrives
    this.busy = busy; // called with the lateness of this browser in ms
    this.looked = performance.now();
    this.heard = performance.now();
    this.why = "";
    setInterval(() => this.#look(), LOOK_MS);
    this.#run();
  }

  // Open the stream again.
  open() {
    this.abort?.abort();
  }

  get silence() {
    return performance.now() - this.heard;
  }

  #look() {
    const late = performance.now() - this.looked - LOOK_MS;
    this.looked += late + LOOK_MS;
    // If this browser was late, unread messages may be waiting, so the server need not be silent.
    if (late > BUSY_MS) return document.hidden ? undefined : this.busy(late);
    if (this.silence > SILENT_MS) {
      this.lost(this.why || "the dashboard's server is silent");
      if (Math.min(this.silence, performance.now() - this.opened) > LOST_MS) this.open();
    }
  }

  async #run() {
    for (;;) {
      this.abort = new AbortController();
      this.opened = performance.now();
      try {
        await this.#read(await ask("stream", undefined, this.abort.signal));
        this.why = "the dashboard's server has ended the stream";
      } catch (error) {
        this.why = error.name === "AbortError" ? "the dashboard's server is silent" : error.message;
      }
      await new Promise((done) => setTimeout(done, AGAIN_MS));
    }
  }

  async #read(answer) {
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      const parts = (rest + value).split("\n\n");
      rest = parts.pop();
      this.heard = performance.now();
      this.why = "";
      for (const part of parts) this.#handle(part);
    }
  }

  #handle(part) {
    const [first, second] = part.split("\n");
    const handler = this.handlers[first.slice(7)]; // event: NAME
    if (handler) handler(JSON.parse(second.slice(6))); // data: JSON
  }
}
