// Elements of the page. All text from the server is inserted as text, never as markup.

export const FIGURES_MS = 200; // numbers that change more often cannot be read

export const plural = (n, noun) => `${n} ${noun}${n === 1 ? "" : "s"}`;

export const byId = (id) => document.getElementById(id);

export function make(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name.includes("-") || name === "for" || name === "role") made.setAttribute(name, value);
    else if (name === "textContent") write(made, value);
    else made[name] = value;
  }
  made.append(...children); // a string becomes a text node
  return made;
}

const written = new WeakMap();

// Write a text; the parts between backticks are shown in the font of commands.
function write(element, text) {
  if (written.get(element) === text) return;
  written.set(element, text);
  const parts = String(text).split("`");
  if (parts.length < 3) element.textContent = text;
  else element.replaceChildren(...parts.map((part, i) => (i % 2 ? make("code", { textContent: part }) : part)));
}

export const setText = (id, text) => write(byId(id), text);

export function show(id, visible) {
  byId(id).hidden = !visible;
}

let command = "armrig dashboard"; // has started the server

// Keep the command with which a person starts the server again.
export function useCommand(text) {
  command = text;
  setText("again-command", command);
}

const given = new URLSearchParams(location.hash.slice(1));
export const token = given.get("token") || (given.has("once") ? await exchanged(given.get("once")) : "");

// Exchange the one-time code for the token: with `ps`, other users can read the browser's arguments.
async function exchanged(once) {
  const how = { method: "POST", headers: { Authorization: `Bearer ${once}` }, cache: "no-store" };
  const answer = await fetch("api/token", how).catch(() => null);
  if (!answer?.ok) return "";
  const told = await answer.json();
  history.replaceState(null, "", `#token=${told.token}`);
  return told.token;
}

const headers = () => ({ Authorization: `Bearer ${token}` });

// Send a request to the server; for a failure, throw an Error with the server's message.
export async function ask(path, body, signal) {
  // If several requests wait for a connection, a stop is sent first.
  const priority = path === "stop" ? "high" : "low";
  const how = { headers: headers(), cache: "no-store", priority, signal };
  if (body !== undefined) Object.assign(how, { method: "POST", body: JSON.stringify(body) });
  let answer;
  try {
    answer = await fetch(`api/${path}`, how);
  } catch (error) {
    if (signal?.aborted) throw error;
    throw Object.assign(new Error(`the dashboard's server does not answer: start \`${command}\` again, and open the address that it prints`), { isSilent: true });
  }
  if (!answer.ok) {
    const told = await answer.json().catch(() => ({}));
    throw Object.assign(new Error(told.error || `error ${answer.status}`), { status: answer.status });
  }
  return answer;
}

export const askJson = async (path, body, signal) => (await ask(path, body, signal)).json();

let noticeEnds = 0;

// Show a notice for 12 s.
export function notice(text) {
  setText("notice", text);
  show("notice", Boolean(text));
  clearTimeout(noticeEnds);
  if (text) noticeEnds = setTimeout(() => show("notice", false), 12000);
}

// Remove the last notice, and do something; if it is refused, show the reason.
export async function attempt(does) {
  notice("");
  try {
    await does();
  } catch (error) {
    notice(error.message);
  }
}

// Return a button that does something, and meanwhile shows for how long; a refusal is a notice.
export function button(text, does, className = "") {
  const made = make("button", { type: "button", textContent: text, className });
  made.addEventListener("click", () =>
    attempt(async () => {
      made.disabled = true;
      const began = Date.now();
      const progress = () => (made.textContent = `${text} … ${Math.floor((Date.now() - began) / 1000)} s`);
      progress();
      const ticks = setInterval(progress, 500);
      try {
        await does();
      } finally {
        clearInterval(ticks);
        made.textContent = text;
        made.disabled = false;
      }
    }),
  );
  return made;
}

// Return the name of the user who sends commands from this page.
export const owner = () => byId("owner-name")?.value.trim() || "dashboard";
