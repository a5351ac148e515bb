// Dialogs: a form, a question, a text.

import { attempt, h } from "./dom.js";

/** Open a dialog with `fields` {name, label, …attributes, help, options}. `submit(values)` runs on confirmation; if the
 * server refuses, the dialog stays open with the error. */
export function ask(title, fields, submit, { button = "Create", text = "" } = {}) {
  const error = h("p.error", { role: "alert" });
  const send = h("button.main", { type: "submit" }, button);
  const dialog = h("dialog", { "aria-label": title },
    h("form", { method: "dialog" },
      h("h2", title), text && h("p", text), fields.map(field), error,
      h("div.buttons", h("button", { type: "button", onclick: () => dialog.close() }, "Cancel"), send)));
  dialog.addEventListener("close", () => dialog.remove());
  dialog.querySelector("form").addEventListener("submit", async (event) => {
    event.preventDefault();
    send.disabled = true;
    error.textContent = "";
    try {
      await submit(values(dialog, fields));
      dialog.close();
    } catch (problem) {
      error.textContent = problem.message;
    }
    send.disabled = false;
  });
  document.body.append(dialog);
  dialog.showModal();
}

/** Ask for confirmation. */
export function confirm(title, text, button, work) {
  ask(title, [], work, { button, text });
}

/** Open a dialog with a text and `children`. */
export function tell(title, ...children) {
  const dialog = h("dialog", { "aria-label": title }, h("h2", title), ...children,
    h("div.buttons", h("button.main", { onclick: () => dialog.close() }, "Close")));
  dialog.addEventListener("close", () => dialog.remove());
  document.body.append(dialog);
  dialog.showModal();
  return dialog;
}

function field({ name, label, help, options, value, type = "text", list, ...attributes }) {
  const common = { name, ...attributes };
  let input;
  if (type === "heading") return h("h3", label);
  if (options) {
    input = h("select", { ...common, "aria-label": label }, options.map((each) => h("option", { value: each, selected: each === value }, each || "(default)")));
  } else if (type === "checkbox") {
    return h("label", h("span.inline", h("input", { ...common, type, checked: value }), label), help && h("span.soft", ` ${help}`));
  } else if (type === "textarea") {
    input = h("textarea", { ...common, rows: 3, spellcheck: "false" }, value ?? "");
  } else {
    input = h("input", { ...common, type, value, list: list && `${name}-list`, autocomplete: "off" });
  }
  return h("label", label, help && h("span.soft", ` ${help}`), input,
    list && h("datalist", { id: `${name}-list` }, list.map((each) => h("option", { value: each }))));
}

/** Return the values of the form, without empty optional ones. */
function values(dialog, fields) {
  const given = {};
  for (const { name, type } of fields.filter((each) => each.name)) {
    const input = dialog.querySelector(`[name="${name}"]`);
    if (type === "checkbox") given[name] = input.checked;
    else if (input.value !== "") given[name] = type === "number" ? Number(input.value) : input.value.trim();
  }
  return given;
}

/** Show a picture, which `load` fetches as a blob, in a dialog. */
export function tellPicture(title, load) {
  const canvas = h("canvas.picture", { role: "img", "aria-label": title });
  tell(title, canvas);
  attempt(async () => {
    const bitmap = await createImageBitmap(await load());
    [canvas.width, canvas.height] = [bitmap.width, bitmap.height];
    canvas.getContext("2d").drawImage(bitmap, 0, 0);
  });
}

/** Have the browser store a file. */
export function save(blob, name) {
  const link = h("a", { href: URL.createObjectURL(blob), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
