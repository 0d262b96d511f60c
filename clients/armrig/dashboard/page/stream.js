// The stream of events from the server. It is opened again when it breaks, for as long as it takes.

import { ask } from "./elements.js";

const SILENT_MS = 700; // 30 messages a second come: without one for so long the server is gone
const AGAIN_MS = 250;
const LOOK_MS = 100;
const BUSY_MS = 500; // a timer that is so late shows a busy browser, not a silent server
const LOST_MS = 5000; // silent for so long it is opened anew; so long has each attempt to be answered

export class Stream {
  constructor(handlers, lost, busy) {
    this.handlers = handlers;
    this.lost = lost; // called with why, again and again while nothing comes
    this.busy = busy; // called with how late this browser was, in ms
    this.looked = performance.now();
    this.heard = performance.now();
    this.why = "";
    setInterval(() => this.#look(), LOOK_MS);
    this.#run();
  }

  // Open it anew.
  open() {
    this.abort?.abort();
  }

  get silence() {
    return performance.now() - this.heard;
  }

  #look() {
    const late = performance.now() - this.looked - LOOK_MS;
    this.looked += late + LOOK_MS;
    // What came meanwhile is still to be read: it is not the server that is silent.
    if (late > BUSY_MS) return document.hidden ? undefined : this.busy(late);
    if (this.silence > SILENT_MS) {
      this.lost(this.silence, this.why || "the dashboard's server is silent");
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
