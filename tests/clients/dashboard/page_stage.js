// A browser of stubs: the page's own scripts run on it, and what has changed is told as text.

import { createInterface } from "node:readline";

process.env.TZ = "UTC";
const FRAME_MS = 16;
let isFrame = false;
let now = 0;
const began = Date.UTC(2026, 2, 1, 10);
globalThis.Date = class extends Date {
  constructor(...given) {
    super(...(given.length ? given : [began + now]));
  }
  toLocaleString() {
    return this.toISOString();
  }
  static now() {
    return began + now;
  }
};
const due = [];
const listeners = {};
const replies = {};
const streams = [];
const lines = [];
const say = (text) => lines.push(`  ${text}`);
// What several charts have in common is told once.
const sayOf = (chart, text) => {
  const n = charts.indexOf(chart);
  for (const [i, line] of lines.entries()) {
    const [, before, same] = /^  charts? ([\d ]+): (.*)$/.exec(line) ?? [];
    if (same !== text || before.split(" ").includes(`${n}`)) continue;
    lines[i] = `  charts ${before} ${n}: ${text}`;
    return;
  }
  say(`chart ${n}: ${text}`);
};

class Element {
  constructor(tag = "") {
    Object.assign(this, { tag, children: [], attributes: {}, on: {}, style: {}, dataset: {}, kinds: new Set() });
    Object.assign(this, { own: "", hidden: false, disabled: false, className: "", title: "", value: "", type: "", clientWidth: 400, offsetTop: 160 });
    this.classList = { toggle: (name, is) => (is ? this.kinds.add(name) : this.kinds.delete(name)) };
  }
  get textContent() {
    return this.own + this.children.map((one) => one.textContent ?? one).join("");
  }
  set textContent(text) {
    [this.own, this.children] = [String(text), []];
  }
  set id(id) {
    known.set(id, this);
    this.known = id;
  }
  setAttribute(name, value) {
    this.attributes[name] = value;
  }
  getAttribute(name) {
    return this.attributes[name] ?? null;
  }
  append(...made) {
    this.children.push(...made);
    if (this.tag === "select" && made.length) this.value ||= made[0].value;
  }
  replaceChildren(...made) {
    [this.own, this.children] = ["", made];
  }
  addEventListener(type, does) {
    (this.on[type] ??= []).push(does);
  }
  fire(type, event = {}) {
    for (const does of this.on[type] ?? []) does({ type, target: this, preventDefault: () => say(`${type}: prevented`), stopPropagation: () => {}, ...event });
  }
  click() {
    if (this.download) say(`saved as ${this.download}`);
    this.fire("click");
  }
  focus() {
    say(`${[...known].find(([, one]) => one === this)[0]}: has the focus`);
  }
  scrollIntoView() {
    say(`${this.known ?? this.tag}: is scrolled into view`);
  }
  get isConnected() {
    return true;
  }
  querySelectorAll(tag) {
    return this.children.flatMap((one) => (one instanceof Element ? [...(one.tag === tag ? [one] : []), ...one.querySelectorAll(tag)] : []));
  }
}
class Input extends Element {
  constructor(tag) {
    super(tag);
    this.type = "text";
  }
}
class Select extends Element {}

const known = new Map();
const byId = (id) => known.get(id) ?? known.set(id, new Element()).get(id);
const made = { input: Input, select: Select };
const body = new Element("body");

Object.assign(globalThis, {
  HTMLInputElement: Input,
  HTMLSelectElement: Select,
  ResizeObserver: class {
    observe() {}
  },
  Path2D: class {
    constructor() {
      this.drawn = "";
    }
    moveTo(...at) {
      this.drawn += ` M${at}`;
    }
    lineTo(...at) {
      this.drawn += ` L${at}`;
    }
  },
  TextDecoderStream: class {},
  location: { hash: "#token=secret", reload: () => say("the page is loaded again") },
  history: { replaceState: () => {} },
  innerWidth: 1280,
  innerHeight: 900,
  devicePixelRatio: 2,
  localStorage: { "armrig-owner": "", getItem: (name) => localStorage[name] || null, setItem: (name, value) => (localStorage[name] = value) },
  scrollTo: ({ top }) => say(`scrolled to ${top}`),
  matchMedia: () => ({ matches: true, addEventListener: () => {} }),
  getComputedStyle: (one) => ({ getPropertyValue: (name) => ` ${one.dataset.theme}${name}` }),
  requestAnimationFrame: (does) => due.push([isFrame ? now + FRAME_MS : now, (at) => {
    isFrame = true;
    does(at);
    isFrame = false;
  }]),
  addEventListener: (type, does) => ((listeners[type] ??= []).push(does)),
  setInterval: (does) => (listeners.interval ??= []).push(does),
  clearInterval: (n) => (listeners.interval[n - 1] = () => {}),
  setTimeout: (does, ms) => due.push([now + ms, does]),
  clearTimeout: (n) => n && (due[n - 1] = [Infinity, () => {}]),
  document: {
    getElementById: byId,
    createElement: (tag) => new (made[tag] ?? Element)(tag),
    createElementNS: (_, tag) => new Element(tag),
    querySelectorAll: () => [byId("tab-recordings")],
    documentElement: new Element("html"),
    body,
    hidden: false,
    title: "",
    addEventListener: () => {},
  },
});
Object.defineProperty(globalThis, "performance", { value: { now: () => now } });
let saved = null;
URL.createObjectURL = (blob) => {
  saved = blob;
  return "blob:1";
};
URL.revokeObjectURL = () => {};

const charts = [];
let cost = 0; // ms that a chart takes to be drawn
globalThis.uPlot = class {
  constructor(options, data, where) {
    Object.assign(this, { options, data, where, width: options.width, height: options.height, bbox: { left: -300, top: 0, width: 800, height: 90 }, cursor: { left: 0 }, select: {} });
    charts.push(this);
    this.over = new Element();
    for (const does of options.hooks.ready) does(this);
  }
  setData(data) {
    this.data = data;
    now += cost;
    const { series, scales, axes, hooks } = this.options;
    const path = (i) => series[i].paths(this, i, 0, data[0].length - 1).stroke.drawn;
    const x = scales.x.range(this, 0, 0);
    const y = scales.y.range(this, ...ends(data.slice(1).flat()));
    this.scales = { x: { min: x[0], max: x[1] }, y: { min: y[0], max: y[1] } };
    const splits = [axes[0].splits(this, 0, ...x, (x[1] - x[0]) / 3), [y[0], (y[0] + y[1]) / 2, y[1]]];
    this.axes = splits.map((_splits, i) => ({ _splits, _values: axes[i].values(this, _splits) }));
    const over = data[3]?.some((value) => value !== null) ? `; over it${path(3)}` : "";
    this.ctx = pen();
    for (const does of hooks.draw) does(this);
    const labels = axes[0].values(this, [0, 1.23456]).join("");
    const parts = [`x ${short(x)}`, `y ${short(y)},${path(1)}${over}`, labels && `axis ${labels}`, this.ctx.drawn && `marks${this.ctx.drawn}`];
    parts.forEach((text, i) => text && text !== this.told?.[i] && sayOf(this, text));
    this.told = parts;
  }
  valToPos(value) {
    return +value.toFixed(3);
  }
  posToVal(x) {
    return x / 100 - 1; // 100 pixels a second, the first of them before 0
  }
  setSelect() {}
  setCursor(at) {
    sayOf(this, `cursor at ${JSON.stringify(at)}`);
  }
  setSize(size) {
    sayOf(this, JSON.stringify(size));
  }
  redraw() {
    sayOf(this, `is drawn again in ${this.options.series[1].stroke()}`);
  }
  destroy() {
    for (const does of this.options.hooks.destroy) does(this);
    sayOf(this, "is gone");
  }
  drag(left, width) {
    this.select = { left, width };
    this.options.hooks.setSelect[0](this);
  }
  point(left, idx) {
    this.cursor = { left, idx, event: true };
    this.options.hooks.setCursor[0](this);
  }
};
// The pen that draws marks: a colour with its place, and a name; a letter is 10 wide.
const pen = () => ({
  drawn: "",
  measureText: (text) => ({ width: 10 * text.length }),
  save: () => {},
  restore: () => {},
  fillRect(...at) {
    this.drawn += ` ${this.fillStyle} ${short(at)};`;
  },
  fillText(text, ...at) {
    this.drawn += ` ${text} ${short(at)};`;
  },
});
const short = (values) => values.map((value) => +value.toFixed(3));
const ends = (values) => {
  const found = values.filter((value) => value !== null && value !== undefined);
  return found.length ? [Math.min(...found), Math.max(...found)] : [null, null];
};

globalThis.fetch = async (path, { method = "GET", body: sent, priority, headers, signal }) => {
  say(`${method} ${path} ${sent ?? ""} (${priority}, ${headers.Authorization})`);
  if (path === "api/stream") {
    const pieces = [];
    const stream = {
      give: (text) => {
        const wake = stream.wake ?? ((piece) => pieces.push(piece));
        stream.wake = null;
        wake({ value: text });
      },
    };
    const read = () => (pieces.length ? pieces.shift() : new Promise((wake, fail) => {
      stream.wake = wake;
      signal.addEventListener("abort", () => fail(Object.assign(new Error("aborted"), { name: "AbortError" })));
    }));
    streams.push(stream);
    return { ok: true, body: { pipeThrough: () => ({ getReader: () => ({ read }) }) } };
  }
  const withdrawn = new Promise((_, fail) => signal?.addEventListener("abort", () => fail(signal.reason)));
  const found = replies[path.slice(4)] ?? {};
  const reply = await Promise.race([typeof found === "function" ? found(JSON.parse(sent)) : found, withdrawn]);
  return { ok: !reply.error, status: 400, json: async () => reply, blob: async () => ({ size: 77 }) };
};

// What a story's lines use.
const stage = {
  byId,
  say,
  costs: (ms) => (cost = ms),
  charts,
  replies,
  hold: (name) => (replies[name] = new Promise((give) => (stage.give = give))),
  key: (code, more = {}) => listeners[more.type ?? "keydown"].forEach((does) => does({ code, key: code, type: "keydown", target: body, preventDefault: () => say(`${code}: prevented`), stopPropagation: () => {}, ...more })),
  send: (name, value) => {
    const told = name === "live" ? { at_s: performance.now() / 1000, ...value } : value;
    streams.at(-1).give(`event: ${name}\ndata: ${JSON.stringify(told)}\n\n`);
  },
  file: async (most) => say(`its text: ${(await saved.text()).trim().split("\n").slice(0, most).join("\n    ")}`),
  raw: (text) => streams.at(-1).give(text),
  set: (id, value) => {
    byId(id).value = value;
    byId("experiment").fire("input", { target: byId(id) });
  },
  button: (text) => [...known.values()].flatMap((one) => one.querySelectorAll("button")).find((one) => one.textContent === text),
  // Time passes, with what is due in it; at once for a browser that does nothing meanwhile.
  pass: async (ms, step = 100) => {
    const end = now + ms;
    do {
      now = Math.min(end, now + step);
      for (const does of listeners.interval) does();
      for (let i = 0; i < due.length; i += 1) {
        const [at, does] = due[i];
        if (at > now) continue;
        due[i] = [Infinity, () => {}];
        does(now);
      }
    } while (now < end);
    await settled();
  },
};

const settled = async () => {
  for (let i = 0; i < 8; i += 1) await new Promise((done) => setImmediate(done));
};

const isValue = (id) => id.startsWith("value-"); // told with its chart

// One element as text: its words, and what is not usual about it. What has an id stands for itself.
function told(one, isInside) {
  if (!(one instanceof Element)) return [String(one)];
  if (isInside && one.known && !isValue(one.known)) return [`#${one.known}`];
  const about = [one.className, ...one.kinds, one.title, one.hidden && "hidden", one.disabled && "disabled", one.value, parseFloat(one.style.height)];
  about.push(...Object.entries(one.attributes).map(([name, value]) => `${name}=${value}`), ...Object.values(one.dataset), one.download);
  if (one.open !== undefined) about.push(`open=${one.open}`);
  const brackets = about.filter(Boolean).join(", ");
  const own = `${one.own}${brackets && ` [${brackets}]`}`.trim();
  return [...(own ? [own] : []), ...(one.hidden ? [] : one.children.flatMap((child) => told(child, true)))];
}

const before = new Map();
function changes() {
  for (const [id, one] of known) {
    if (isValue(id)) continue;
    const text = told(one).join(" | ");
    if ((text || before.has(id)) && before.get(id) !== text) say(`${id}: ${text}`);
    before.set(id, text);
  }
  const page = `${document.title} [${[...body.kinds]}; ${document.documentElement.dataset.theme}]`;
  if (before.get("") !== page) say(`the page: ${page}`);
  before.set("", page);
}

for await (const line of createInterface({ input: process.stdin })) {
  console.log(line);
  if (!line.startsWith("> ")) continue;
  await new Function("stage", `with (stage) { return (async () => { ${line.slice(2)} })(); }`)(stage);
  await settled();
  changes();
  for (const text of lines.splice(0)) console.log(text);
}
