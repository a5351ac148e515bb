// Choice of an environment and of the topics to show, of those that its nodes and interfaces have.

import { h, show } from "./dom.js";

/** Return the types of an environment's topics that have an interface, by topic. */
function typesOfInterfaces(app, owner, environment) {
  const of = [...app.live.interfaces.values()].filter((each) =>
    each.user === owner && each.endpointTag === environment && /^(Publisher|Subscriber)Interface$/.test(each.interfaceType));
  return new Map(of.map((each) => [each.addr, each.className]));
}

/** Return the types of all topics of an environment, by topic. */
export async function typesOfTopics(app, owner, environment) {
  const types = typesOfInterfaces(app, owner, environment);
  try {
    const topics = await app.api.list(`/environments/${environment}/topics`, app.acting(owner));
    for (const each of topics) types.set(each.name, each.types[0].replace("/msg/", "/"));
  } catch {
    // It may be starting: then only interfaces are known.
  }
  return types;
}

/** Return a form for `fields` {name, label, types, value}; submitting it opens `page` with the chosen values. */
export function chooser(app, page, owner, environment, fields) {
  const select = h("select", { name: "environment", required: true });
  const inputs = fields.map((each) => h("input", { name: each.name, value: each.value, list: `${each.name}-topics`, size: 16, autocomplete: "off" }));
  const lists = fields.map((each) => h("datalist", { id: `${each.name}-topics` }));
  const element = h("form.panel.head", h("label.inline", "Environment", select),
    fields.map((each, index) => h("label.inline", each.label, inputs[index], lists[index])), h("button.main", { type: "submit" }, "Show"));
  const values = () => Object.fromEntries(fields.map((each, index) => [each.name, inputs[index].value.trim()]));
  element.onsubmit = (event) => {
    event.preventDefault();
    const address = `/${page}/${select.value}?${new URLSearchParams(values())}`;
    if (location.hash === `#${address}`) window.dispatchEvent(new HashChangeEvent("hashchange"));
    else app.go(address);
  };
  const known = new Map(); // types by topic, by environment
  const ask = (place) => {
    const [user, tag] = place.split("/");
    known.set(place, new Map());
    typesOfTopics(app, user, tag).then((types) => { known.set(place, types); draw(); });
  };
  select.onchange = () => draw();
  const draw = () => {
    const found = [...app.live.environments.values()].filter((each) => app.me.may("data.read", each.user));
    const names = new Map(found.map((each) => [`${each.user}/${each.containerTag}`, app.named(each.user, each.containerTag)]).sort());
    const chosen = select.value || (environment && `${owner}/${environment}`);
    show(select, !names.has(chosen) && h("option", { value: "" }, names.size ? "choose …" : "there is none"),
      [...names].map(([value, name]) => h("option", { value }, name)));
    select.value = names.has(chosen) ? chosen : "";
    if (fields.length && app.live.environments.get(select.value)?.state === "ready" && !known.has(select.value)) ask(select.value);
    const topics = new Map([...typesOfInterfaces(app, ...select.value.split("/")), ...known.get(select.value) ?? []]);
    fields.forEach((each, index) => show(lists[index], fitting(topics, each).map((topic) => h("option", { value: topic }))));
  };
  /** Choose, for each required field whose usual topic the environment lacks, one that it has. */
  const choose = (topics) => fields.forEach((each, index) => {
    if (!each.optional && !topics.has(each.value)) inputs[index].value = fitting(topics, each)[0] ?? each.value;
  });
  draw();
  return { element, values, choose, stop: app.live.on(draw) };
}

/** Return the topics whose type a field takes. */
function fitting(topics, field) {
  return [...topics].filter(([, type]) => field.types.includes(type)).map(([topic]) => topic).sort();
}
