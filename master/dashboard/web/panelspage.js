// Page of several panels side by side, which this browser remembers for the user.

import { attempt, h, show } from "./dom.js";
import { endedNotice } from "./ended.js";
import { ask } from "./forms.js";
import { KINDS } from "./panels.js";

const STORED = "rce.panels."; // in localStorage, with the name of the user

export function panelsPage(main, app) {
  const key = STORED + app.me.user;
  let panels = read(key);
  const grid = h("div.grid");
  const none = h("p.empty");
  let stops = [];
  const store = () => {
    localStorage.setItem(key, JSON.stringify(panels));
    draw();
  };
  const draw = () => {
    stops.forEach((stop) => stop());
    const made = panels.map((each, index) => panel(each, index));
    stops = made.map(({ stop }) => stop);
    grid.replaceChildren(...made.map(({ element }) => element));
    show(none, panels.length ? "" : "Nothing is shown yet: add a map, images, or points in space.");
  };
  const panel = (each, index) => {
    const kind = KINDS[each.kind];
    const name = `${kind.label} of ${app.named(each.owner, each.environment)}`;
    const button = (text, label, work) => h("button.small", { "aria-label": `${label} ${name}`, title: label, onclick: work }, text);
    const move = () => { [panels[index - 1], panels[index]] = [panels[index], panels[index - 1]]; store(); };
    const { element, stop } = kind.make(app, each.owner, each.environment, each.topics);
    const ended = endedNotice(app, each.owner, each.environment);
    return { stop: () => { stop(); ended.stop(); }, element: h("section.panel", { "aria-label": name }, h("div.head", h("h2", name), h("span.grow"),
      index > 0 && button("◂", "Move to the front", move),
      button("×", "Remove", () => { panels = panels.filter((other) => other !== each); store(); })), ended.element, element) };
  };
  const add = (kind) => attempt(async () => {
    const there = [...app.live.environments.values()].filter((each) => app.me.may("data.read", each.user));
    if (!there.length) throw new Error("There is no environment yet.");
    ask(`New panel: ${KINDS[kind].label}`, [
      { name: "place", label: "Environment", options: there.map((each) => `${each.user}/${each.containerTag}`).sort() },
      ...KINDS[kind].fields.map(({ name, label, value }) => ({ name, label, value, help: "topic" })),
    ], async ({ place, ...topics }) => {
      const [owner, environment] = place.split("/");
      panels.push({ kind, owner, environment, topics });
      store();
    }, { button: "Add" });
  });
  main.append(h("div.head", h("h1", "Panels"), h("span.grow"),
    Object.entries(KINDS).map(([kind, { label }]) => h("button", { onclick: () => add(kind) }, `Add ${label}`))), none, grid);
  draw();
  return () => stops.forEach((stop) => stop());
}

function read(key) {
  try {
    return JSON.parse(localStorage.getItem(key) ?? "[]").filter((each) => each.kind in KINDS);
  } catch {
    return [];
  }
}
