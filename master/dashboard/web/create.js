// Dialogs that create environments, nodes, parameters and interfaces, with suggestions from what there is.

import { ask } from "./forms.js";

const TAG = { required: true, pattern: "[A-Za-z][A-Za-z0-9_]*", title: "a letter, then letters, digits or _" };
const KINDS = ["Publisher", "Subscriber", "ServiceClient", "ServiceProvider", "ActionClient", "ActionProvider"];
const TYPES = ["std_msgs/String", "nav_msgs/OccupancyGrid", "sensor_msgs/LaserScan", "sensor_msgs/Image", "geometry_msgs/Twist",
  "geometry_msgs/PoseWithCovarianceStamped", "nav_msgs/Odometry", "std_srvs/SetBool"];

/** Return the distinct values, sorted, without empty ones. */
const distinct = (values) => [...new Set(values.filter(Boolean))].sort();
const words = (text = "") => text.split(/[\s,]+/).filter(Boolean);

/** Return the answer of a request for suggestions; nothing if it is refused. */
const found = (promise, none) => promise.catch(() => none);

export async function newEnvironment(app) {
  const owner = app.acting();
  const [packages, limits] = await Promise.all([
    found(app.api.list("/packages"), []), found(app.api.get(`/users/${owner.user ?? app.me.user}/limits`), { images: [] })]);
  const data = [...app.live.environments.values()].map((each) => each.containerData);
  const machines = [...app.live.machines.values()];
  const gpus = machines.reduce((sum, each) => sum + each.gpus - each.gpusUsed, 0);
  ask("New environment", [
    { name: "containerTag", label: "Name", ...TAG },
    { name: "size", label: "Size", help: "slots of a machine", type: "number", min: 1, value: 1 },
    { name: "memory", label: "Memory", help: "MiB; empty: by its slots", type: "number", min: 1 },
    { name: "cpu", label: "Cores", help: "empty: by its slots", type: "number", min: 0, step: "any" },
    { name: "image", label: "Image", help: "empty: the platform's",
      list: distinct([...data.map((each) => each.image), ...limits.images.filter((each) => !each.includes("*"))]) },
    { name: "packages", label: "Packages", help: "with commas between", list: distinct(packages.map((each) => each.name)) },
    { name: "env", label: "Variables", help: "NAME=VALUE, one a line", type: "textarea" },
    { name: "gpus", label: "GPUs", help: gpus ? `${gpus} are free` : "optional", type: "number", min: 0 },
    { name: "specialFeatures", label: "Features of the machine", help: "optional, with commas between",
      list: distinct(machines.flatMap((each) => each.features)) },
    { name: "group", label: "Network group", help: "optional", list: distinct([...app.live.groups.values()].map((each) => each.group)) },
    { name: "restart", label: "When it dies", options: ["always", "no"], value: "always", help: "start again?" },
  ], ({ containerTag, memory, packages: chosen, specialFeatures, env, ...rest }) => app.api.post("/environments", {
    containerTag,
    containerData: { ...rest, packages: words(chosen), specialFeatures: words(specialFeatures), env: variables(env),
      ...(memory ? { memory: memory * 1024 ** 2 } : {}) },
  }, owner));
}

/** Return the variables that lines NAME=VALUE set. */
function variables(text = "") {
  return Object.fromEntries(text.split("\n").filter((line) => line.trim()).map((line) => {
    const [, name, value] = /^\s*(\w+)\s*=(.*)$/.exec(line) ?? [];
    if (!name) throw new Error(`write a variable as NAME=VALUE, not ${line}`);
    return [name, value.trim()];
  }));
}

export async function newNode(app, environment) {
  const owner = app.acting(environment.user);
  const packages = await found(app.api.list(`/environments/${environment.containerTag}/packages`, owner), []);
  ask(`New node in ${environment.containerTag}`, [
    { name: "nodeTag", label: "Name", ...TAG },
    { name: "pkg", label: "ROS package", required: true, list: packages.map((each) => each.name) },
    { name: "exe", label: "Executable", list: distinct(packages.flatMap((each) => each.executables)) },
    { name: "launch", label: "or launch file", help: "its arguments are NAME:=VALUE" },
    { name: "args", label: "Arguments", help: "may use $(find PKG) and $(env VAR)" },
    { name: "namespace", label: "Namespace", help: "optional" },
    { name: "restart", label: "When it ends", options: ["", "no", "on-failure", "always"], value: "", help: "start again?" },
  ], (values) => app.api.post(`/environments/${environment.containerTag}/nodes`, values, owner));
}

export function newParameter(app, environment) {
  const nodes = [...app.live.nodes.values()].filter((each) => each.user === environment.user && each.containerTag === environment.containerTag);
  ask(`Parameter of ${environment.containerTag}`, [
    { name: "name", label: "Name", required: true },
    { name: "value", label: "Value", help: "a number, true, false, a list [1, 2], or text", required: true },
    { name: "nodeTag", label: "Node", help: "empty: all nodes", list: distinct(nodes.map((each) => each.nodeTag)) },
  ], ({ name, value, nodeTag }) => app.api.post(
    `/environments/${environment.containerTag}/parameters`, { name, value: parsed(value), nodeTag }, app.acting(environment.user)),
  { button: "Set" });
}

/** Return the value of a parameter that a text stands for: JSON, but no objects, or the text itself. */
export function parsed(text) {
  try {
    const value = JSON.parse(text);
    return value !== null && (typeof value !== "object" || Array.isArray(value)) ? value : text;
  } catch {
    return text;
  }
}

export async function newInterface(app, owner) {
  const kinds = owner.containerTag ? KINDS.map((kind) => `${kind}Interface`)
    : ["Converter", "Forwarder"].flatMap((kind) => KINDS.map((each) => each + kind));
  const endpointTag = owner.containerTag ?? owner.robotID;
  const who = app.acting(owner.user);
  const there = !owner.containerTag ? [] : (await Promise.all(["topics", "services", "actions"].map((kind) =>
    found(app.api.list(`/environments/${endpointTag}/${kind}`, who), [])))).flat();
  const types = there.flatMap((each) => each.types).map((type) => type.replace(/\/(msg|srv|action)\//, "/"));
  const used = [...app.live.interfaces.values()].map((each) => each.className);
  ask(`New interface of ${endpointTag}`, [
    { name: "interfaceTag", label: "Name", ...TAG },
    { name: "interfaceType", label: "Kind", help: "Subscriber and Provider send, the others receive", options: kinds },
    { name: "className", label: "ROS type", required: true, list: distinct([...TYPES, ...used, ...types]), placeholder: "std_msgs/String" },
    ...(owner.containerTag ? [{ name: "addr", label: "Topic, service or action", required: true, placeholder: "/topic",
      list: distinct(there.map((each) => each.name)) }] : []),
  ], (values) => app.api.post("/interfaces", { endpointTag, ...values }, app.acting(owner.user)));
}
