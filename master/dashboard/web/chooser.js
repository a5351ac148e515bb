// Choice of an environment and of the topics to show, of those that its nodes and interfaces have.

import { h, show } from "./dom.js";

/** Return the types of an environment's topics that have an interface, by topic. */
export function topicsOf(app, owner, environment) {
  const of = [...app.live.interfaces.values()].filter((each) =>
    each.user === owner && each.endpointTag === environment && /^(Publisher|Subscriber)Interface$/.test(each.interfaceType));
  return new Map(of.map((each) => [each.addr, each.className]));
}

/** Return a form for `fields` {name, label, type, value}; submitting it opens `page` with the chosen values. */
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
  const known = new Map(); // types by topic, by environment, as ROS has them there
  const ask = (place) => {
    const [user, tag] = place.split("/");
    known.set(place, new Map());
    app.api.list(`/environments/${tag}/topics`, app.acting(user)).then((topics) => {
      known.set(place, new Map(topics.map((each) => [each.name, each.types[0].replace("/msg/", "/")])));
      draw();
    }, () => {}); // it may be starting: then only interfaces are offered
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
    const topics = new Map([...topicsOf(app, ...select.value.split("/")), ...known.get(select.value) ?? []]);
    fields.forEach((each, index) => show(lists[index],
      [...topics].filter(([, type]) => type === each.type).map(([topic]) => h("option", { value: topic }))));
  };
  draw();
  return { element, values, stop: app.live.on(draw) };
}
