// Dialogs: the general form, and those that create resources.

import { h } from "./dom.js";

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
  if (options) {
    input = h("select", { ...common, "aria-label": label }, options.map((each) => h("option", { value: each, selected: each === value }, each || "(default)")));
  } else if (type === "checkbox") {
    return h("label", h("span.inline", h("input", { ...common, type, checked: value }), label), help && h("span.soft", ` ${help}`));
  } else {
    input = h("input", { ...common, type, value, list: list && `${name}-list`, autocomplete: "off" });
  }
  return h("label", label, help && h("span.soft", ` ${help}`), input,
    list && h("datalist", { id: `${name}-list` }, list.map((each) => h("option", { value: each }))));
}

/** Return the values of the form, without empty optional ones. */
function values(dialog, fields) {
  const given = {};
  for (const { name, type } of fields) {
    const input = dialog.querySelector(`[name="${name}"]`);
    if (type === "checkbox") given[name] = input.checked;
    else if (input.value !== "") given[name] = type === "number" ? Number(input.value) : input.value.trim();
  }
  return given;
}

const TAG = { required: true, pattern: "[A-Za-z][A-Za-z0-9_]*", title: "a letter, then letters, digits or _" };

export function newEnvironment(app) {
  ask("New environment", [
    { name: "containerTag", label: "Name", ...TAG },
    { name: "size", label: "Size", help: "slots of a machine", type: "number", min: 1, value: 1 },
    { name: "memory", label: "Memory", help: "MB; empty: by its slots", type: "number", min: 1 },
    { name: "cpu", label: "Cores", help: "empty: by its slots", type: "number", min: 0, step: "any" },
    { name: "group", label: "Network group", help: "optional" },
    { name: "restart", label: "When it dies", options: ["always", "no"], value: "always", help: "start again?" },
  ], ({ containerTag, memory, ...rest }) => app.api.post("/environments", {
    containerTag, containerData: { ...rest, ...(memory ? { memory: memory * 1_000_000 } : {}) },
  }, app.acting()));
}

export function newNode(app, environment) {
  ask(`New node in ${environment.containerTag}`, [
    { name: "nodeTag", label: "Name", ...TAG },
    { name: "pkg", label: "ROS package", required: true, list: ["rce_mapping", "rce_demo"] },
    { name: "exe", label: "Executable", required: true, list: ["mapper", "echo.py"] },
    { name: "args", label: "Arguments", help: "may use $(find PKG) and $(env VAR)" },
    { name: "namespace", label: "Namespace", help: "optional" },
  ], (values_) => app.api.post(`/environments/${environment.containerTag}/nodes`, values_, app.acting(environment.user)));
}

export function newParameter(app, environment) {
  ask(`Parameter of ${environment.containerTag}`, [
    { name: "name", label: "Name", required: true },
    { name: "value", label: "Value", help: "a number, true, false, a list [1, 2], or text", required: true },
    { name: "nodeTag", label: "Node", help: "empty: all nodes" },
  ], ({ name, value, nodeTag }) => app.api.post(
    `/environments/${environment.containerTag}/parameters`, { name, value: parsed(value), nodeTag }, app.acting(environment.user)),
  { button: "Set" });
}

function parsed(text) {
  try {
    const value = JSON.parse(text);
    return value !== null && (typeof value !== "object" || Array.isArray(value)) ? value : text;
  } catch {
    return text;
  }
}

const KINDS = ["Publisher", "Subscriber", "ServiceClient", "ServiceProvider"];
const TYPES = ["std_msgs/String", "nav_msgs/OccupancyGrid", "sensor_msgs/LaserScan", "sensor_msgs/Image", "geometry_msgs/Twist",
  "geometry_msgs/PoseWithCovarianceStamped", "nav_msgs/Odometry", "std_srvs/SetBool"];

export function newInterface(app, owner) {
  const kinds = owner.containerTag ? KINDS.map((kind) => `${kind}Interface`)
    : ["Converter", "Forwarder"].flatMap((kind) => KINDS.map((each) => each + kind));
  const endpointTag = owner.containerTag ?? owner.robotID;
  ask(`New interface of ${endpointTag}`, [
    { name: "interfaceTag", label: "Name", ...TAG },
    { name: "interfaceType", label: "Kind", options: kinds },
    { name: "className", label: "ROS type", required: true, list: TYPES, placeholder: "std_msgs/String" },
    ...(owner.containerTag ? [{ name: "addr", label: "Topic or service", required: true, placeholder: "/topic" }] : []),
  ], (values_) => app.api.post("/interfaces", { endpointTag, ...values_ }, app.acting(owner.user)));
}
