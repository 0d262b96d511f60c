// State of the view Models, which the address contains: data by hash, models by request.

export const KINDS = ["output", "residuals", "poles", "frequency", "step"];
export const MOST_ROWS = 200;
const HASH_DIGITS = 12;

let written = ""; // state that this page wrote last
const parameters = () => new URLSearchParams(location.hash.slice(1));

// Set parameters of the address, and delete those that are empty; the token is not changed.
export function setAddress(changes) {
  const all = parameters();
  for (const [name, text] of Object.entries(changes)) {
    if (text) all.set(name, text);
    else all.delete(name);
  }
  if (`${all}` !== location.hash.slice(1)) history.replaceState(null, "", `#${all}`);
}

// Return the name of the view that the address opens.
export const viewOfAddress = () => parameters().get("view");

// Return a request without its defaults.
export function compact(request) {
  const isSet = ([name, value]) => value !== null && value !== false && value !== "" && !(name === "nk" && value === 1);
  return Object.fromEntries(Object.entries(request).filter(isSet).sort(([a], [b]) => (a < b ? -1 : 1)));
}

// Return a text that two equal requests have in common.
export function keyOf(request) {
  const orders = Object.entries(request.orders ?? {}).sort(([a], [b]) => (a < b ? -1 : 1));
  return JSON.stringify({ ...compact(request), orders });
}

const encoded = (value) => btoa(Array.from(new TextEncoder().encode(JSON.stringify(value)), (byte) => String.fromCharCode(byte)).join("")).replaceAll("+", "-").replaceAll("/", "_").replaceAll("=", "");

const decoded = (text) => JSON.parse(new TextDecoder().decode(Uint8Array.from(atob(text.replaceAll("-", "+").replaceAll("_", "/")), (letter) => letter.charCodeAt(0))));

// Write the state into the address. The recordings are named by their hashes if these are known.
export function writeState({ data, facts, rows, kind, horizon }) {
  const named = facts ? { ...data, file: facts.sha256.slice(0, HASH_DIGITS), validation: facts.validation_sha256.slice(0, HASH_DIGITS) } : data;
  const models = rows.map(({ request, colour, isOn }) => ({ r: compact(request), c: colour, ...(isOn ? {} : { off: 1 }) }));
  written = encoded({ data: named, models, kind, horizon });
  setAddress({ models: written });
}

// Return the state in the address; null without a state, or for the state of this page. An unreadable state raises an Error.
export function readState() {
  const text = parameters().get("models");
  if (!text || text === written) return null;
  try {
    const { data, models, kind, horizon } = decoded(text);
    const isObject = (value) => value !== null && typeof value === "object";
    const rows = models.slice(0, MOST_ROWS).filter(({ r }) => isObject(r)).map(({ r, c, off }) => ({ request: r, colour: Math.abs(Math.trunc(c)) || 0, isOn: !off }));
    return { data: isObject(data) ? data : null, rows, kind: KINDS.includes(kind) ? kind : KINDS[0], horizon: Math.abs(Math.trunc(horizon)) || 0 };
  } catch {
    throw new Error("the models in this address cannot be read: the address is incomplete");
  }
}
