// Page of the services of the catalogue: what they take and give, their instances, and how often they were used.

import { attempt, h, notice, short, show, state, table } from "./dom.js";
import { ask, confirm } from "./forms.js";

const PORTS = { takes: "Takes", gives: "Gives", services: "ROS services", actions: "Actions" };

export function cataloguePage(main, app) {
  const { api, me } = app;
  const list = h("div");
  let offers = [];
  const load = () => attempt(async () => {
    offers = await api.list("/catalogue");
    show(list, ...(offers.length ? offers.map(panel) : [h("p.empty", "There are no services that you may use.")]));
  });
  const path = (offer) => `/catalogue/${offer.user}/${offer.service.name}`;
  const panel = (offer, index) => {
    const { service } = offer;
    const name = `${offer.user}/${service.name}`.replace(/^@rce\//, "");
    const owned = offer.user === me.user && me.may("catalogue.publish");
    const button = (does, text, kind = "") => h(`button.small${kind}`,
      { "data-do": does, "data-index": String(index), "aria-label": `${text} ${name}` }, text);
    const ports = Object.entries(PORTS).flatMap(([field, title]) => Object.entries(service[field] ?? {})
      .map(([port, given]) => ({ title, port, type: given.type ?? given })));
    return h("section.panel", h("div.head", h("h2", name),
      h("span.soft", (service.robots ?? 1) > 1 ? `shared by ${service.robots} robots` : "for one robot"), h("span.grow"),
      me.may("service.use") && button("use", "Use"),
      owned && (service.robots ?? 1) > 1 && button("scale", "Scale"), owned && button("remove", "Remove", ".danger")),
    h("p", service.description ?? ""),
    table({ "": (each) => each.title, Name: (each) => each.port, Type: (each) => short(each.type) }, ports, "It has no interfaces."),
    offer.instances.length > 0 && table({
      Instance: (each) => `${each.user}/${each.containerTag}`,
      State: (each) => state(each.state),
      Robots: (each) => each.robots.join(", "),
    }, offer.instances, ""),
    Object.keys(offer.uses).length > 0 && h("p.soft", `Used: ${Object.entries(offer.uses).map(([user, count]) => `${user} ${count}`).join(", ")}`));
  };
  const actions = {
    use: (offer) => ask(`Use ${offer.service.name}`, [
      { name: "robot", label: "Robot", help: "a connected robot of yours; empty: only start an instance of your own" },
      { name: "containerTag", label: "As", help: "by default the name of the service" },
    ], async ({ robot, containerTag }) => {
      await api.post(`${path(offer)}/uses`, { robot: robot ?? "", containerTag: containerTag ?? "" });
      notice(`${offer.service.name} is ready`);
      load();
    }, { button: "Use" }),
    scale: (offer) => ask(`Scale ${offer.service.name}`, [
      { name: "least", label: "At least", type: "number", value: offer.service.least ?? 0, required: true },
      { name: "most", label: "At most", type: "number", value: offer.service.most ?? 1, required: true },
    ], async ({ least, most }) => {
      await api.patch(path(offer), { least: Number(least), most: Number(most) });
      load();
    }, { button: "Scale" }),
    remove: (offer) => confirm(`Remove ${offer.service.name}?`, "Its shared instances end with it.", "Remove",
      async () => { await api.remove(path(offer)); load(); }),
  };
  list.onclick = (event) => {
    const button = event.target.closest("[data-do]");
    if (button) actions[button.dataset.do](offers[Number(button.dataset.index)]);
  };
  main.append(h("div.head", h("h1", "Services")), list);
  load();
  return () => {};
}
