// Messages as JSON: the form in which they are written, and the short form in which they are shown.

import { attempt, bytes, h } from "./dom.js";
import { templates } from "./definitions.js";

const WORDS = { msg: "Message", srv: "Request", action: "Goal" };
const MAX_ITEMS = 12; // of an array that is shown

/** Return a form of a message as JSON, which begins with the default values of the type's fields. */
export function messageForm(place, type, sort, verb, send) {
  const text = h("textarea.mono", { rows: 6, spellcheck: "false", "aria-label": `${verb} ${type}` });
  const error = h("p.error", { role: "alert" });
  const button = h("button.main", { type: "submit" }, verb);
  const form = h("form", h("label", WORDS[sort], text), error, h("div.buttons", button));
  attempt(async () => {
    const { texts } = await place.app.api.get(`${place.path}/types`, { ...place.who, type, sort });
    text.value ||= JSON.stringify(templates(texts, type, sort)[0], null, 2);
    text.rows = Math.min(16, text.value.split("\n").length + 1);
  });
  form.onsubmit = async (event) => {
    event.preventDefault();
    [button.disabled, error.textContent] = [true, ""];
    try {
      const done = await send(JSON.parse(text.value || "{}"));
      button.textContent = done || verb;
      setTimeout(() => { button.textContent = verb; }, 1000);
    } catch (problem) {
      error.textContent = problem.message;
    }
    button.disabled = false;
  };
  return form;
}

/** Return a message for display: long arrays and byte strings are cut. */
export function brief(value) {
  if (value instanceof Uint8Array) return bytes(value.length);
  if (typeof value === "string") return value.length > 400 ? `${value.slice(0, 400)}… (${value.length} characters)` : value;
  if (Array.isArray(value)) {
    const first = value.slice(0, MAX_ITEMS).map(brief);
    return value.length > MAX_ITEMS ? [...first, `… ${value.length} in all`] : first;
  }
  if (value && typeof value === "object") return Object.fromEntries(Object.entries(value).map(([key, each]) => [key, brief(each)]));
  return value;
}
