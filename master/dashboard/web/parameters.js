// Page of the parameters of running nodes: values with the ranges and descriptions that the nodes declare.

import { remember } from "./address.js";
import { h, show } from "./dom.js";
import { parsed } from "./create.js";
import { Guest } from "./robot.js";

const DESCRIBE = "/describe_parameters";
const FIELDS = ["", "bool_value", "integer_value", "double_value", "string_value", "byte_array_value", "bool_array_value",
  "integer_array_value", "double_array_value", "string_array_value"]; // of rcl_interfaces/ParameterValue by ParameterType
const MOST_SLIDER = 10_000; // range for which a slider is of use
const AGAIN = 2000; // milliseconds until the nodes are looked up again
const [BOOL, INTEGER, DOUBLE, STRING] = [1, 2, 3, 4];

export function parametersPage(main, app, owner, environment, query) {
  app.reveal(owner);
  const guest = new Guest(app, owner, environment);
  const select = h("select", { name: "node" });
  const status = h("p.soft", { role: "status" });
  const list = h("div.parameters");
  main.append(h("div.head", h("h1", "Parameters of running nodes"),
    h("a", { href: `#/environments/${owner}/${environment}` }, app.named(owner, environment))),
  h("form.panel.head", h("label.inline", "Node", select), status), h("section.panel", list));
  const load = async () => {
    remember({ node: select.value });
    status.textContent = "reading …";
    list.replaceChildren();
    const found = await read(guest, select.value);
    list.replaceChildren(...found.map((each) => row(guest, select.value, each)));
    status.textContent = found.length ? "" : "This node declares no parameters.";
  };
  let again = 0;
  const start = async () => {
    const services = await app.api.list(`/environments/${environment}/services`, app.acting(owner));
    const nodes = services.map((each) => each.name).filter((name) => name.endsWith(DESCRIBE)).map((name) => name.slice(0, -DESCRIBE.length)).sort();
    show(select, nodes.map((name) => h("option", { value: name }, name)));
    if (nodes.includes(query.get("node"))) select.value = query.get("node");
    if (nodes.length) await load();
    else {
      status.textContent = "No node with parameters runs here yet.";
      again = setTimeout(() => start().catch(report), AGAIN);
    }
  };
  const report = (error) => { status.textContent = error.message; };
  select.onchange = () => load().catch(report);
  start().catch(report);
  return () => { clearTimeout(again); guest.close(); };
}

/** Return the parameters of a node: {descriptor, value}, by name. */
async function read(guest, node) {
  const { result } = await guest.call(`${node}/list_parameters`, "rcl_interfaces/ListParameters", { prefixes: [], depth: 0 });
  const names = result.names.sort();
  if (!names.length) return [];
  const [{ descriptors }, { values }] = await Promise.all([
    guest.call(`${node}/describe_parameters`, "rcl_interfaces/DescribeParameters", { names }),
    guest.call(`${node}/get_parameters`, "rcl_interfaces/GetParameters", { names })]);
  return descriptors.map((descriptor, index) => ({ descriptor, value: values[index] }));
}

function row(guest, node, { descriptor, value }) {
  const { type } = value;
  const now = value[FIELDS[type]];
  const [range] = [...descriptor.floating_point_range, ...descriptor.integer_range];
  const error = h("span.error", { role: "alert" });
  const done = h("span.done", { role: "status" });
  const id = `parameter-${descriptor.name}`;
  const number = type === INTEGER || type === DOUBLE;
  const bounds = range ? { min: range.from_value, max: range.to_value, step: range.step || (type === INTEGER ? 1 : "any") }
    : { step: type === INTEGER ? 1 : "any" };
  const input = type === BOOL ? h("input", { type: "checkbox", id, checked: now })
    : number ? h("input", { type: "number", id, value: now, ...bounds })
      : h("input", { type: "text", id, value: type === STRING ? now : JSON.stringify(now ?? null) });
  const slider = number && range && range.to_value - range.from_value <= MOST_SLIDER && h("input", { type: "range", value: now, ...bounds, "aria-label": `${descriptor.name}, slider` });
  input.disabled = descriptor.read_only || !FIELDS[type];
  if (slider) slider.disabled = input.disabled;
  const set = async (wanted) => {
    error.textContent = done.textContent = "";
    try {
      const parameters = [{ name: descriptor.name, value: { type, [FIELDS[type]]: wanted } }];
      const { results: [result] } = await guest.call(`${node}/set_parameters`, "rcl_interfaces/SetParameters", { parameters });
      if (!result.successful) throw new Error(result.reason || "the node refuses this value");
      done.textContent = "set";
    } catch (problem) {
      error.textContent = problem.message;
    }
  };
  input.onchange = () => {
    if (slider) slider.value = input.value;
    if (!input.checkValidity()) error.textContent = input.validationMessage;
    else set(type === BOOL ? input.checked : number ? Number(input.value) : type === STRING ? input.value : parsed(input.value));
  };
  if (slider) slider.onchange = () => { input.value = slider.value; set(Number(slider.value)); };
  const limits = range ? `${range.from_value} to ${range.to_value}${range.step ? ` in steps of ${range.step}` : ""}` : "";
  const about = [descriptor.description, limits, descriptor.additional_constraints, descriptor.read_only && "read only"].filter(Boolean);
  return h("div.parameter", h("label", { for: id }, descriptor.name), input, slider, done, h("span.soft", about.join(" · ")), error);
}
