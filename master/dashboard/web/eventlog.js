// Page of events: what happened since the Master started, and what happens, with filters.

import { remember } from "./address.js";
import { h, longName, show, table, time } from "./dom.js";
import { tell } from "./forms.js";

const KEPT = 2000;
const SHOWN = 300;
const TYPES = ["", "robot", "robot.came", "robot.left", "environment", "environment.ready", "environment.failed", "environment.lost",
  "environment.gone", "node.died", "recorder.ended", "connection", "connection.made", "connection.gone", "interface.gone", "limit.reached",
  "knowledge", "knowledge.added", "knowledge.changed", "knowledge.removed", "machine", "machine.joined", "machine.left"];
const BAD = new Set(["environment.failed", "environment.lost", "node.died", "recorder.ended", "limit.reached", "machine.left"]);

export function eventsPage(main, app, query) {
  const type = h("select", { name: "type" }, TYPES.map((each) => h("option", { value: each, selected: each === query.get("type") }, each || "all")));
  const text = h("input", { type: "search", name: "text", size: 16, value: query.get("text") ?? "", autocomplete: "off" });
  const list = h("div");
  let events = [];
  let ended = new AbortController();
  const draw = () => {
    const words = text.value.trim().toLowerCase();
    const found = events.filter((each) => `${each.type} ${each.object} ${each.text ?? ""}`.toLowerCase().includes(words));
    show(list, table({
      Time: (each) => h("span.when", time(each.time)),
      Type: (each) => h(BAD.has(each.type) ? "span.bad" : "span", each.type),
      Object: (each) => longName(each.object),
      Reason: (each) => each.text ?? "",
      " ": (each) => each.lines?.length && h("button.small", { "data-of": each.id, "aria-label": `Output of ${each.object}` }, "Output"),
    }, found.slice(-SHOWN).reverse(), "Nothing has happened that fits."));
  };
  list.onclick = (event) => {
    const found = events.find((each) => each.id === event.target.closest("[data-of]")?.dataset.of);
    if (found) tell(found.object, h("pre.log", { tabindex: 0 }, found.lines.join("\n")));
  };
  const follow = async () => {
    ended.abort();
    ended = new AbortController();
    const { signal } = ended;
    events = [];
    draw();
    try {
      const wanted = { type: type.value, user: app.live.user === "*" ? "*" : "", after: "start" };
      for await (const event of app.api.follow("/events", wanted, signal)) {
        if (event.type === "missed") continue;
        events.push(event);
        if (events.length > KEPT) events.shift();
        later();
      }
    } catch (error) {
      if (!signal.aborted) show(list, h("p.error", error.message));
    }
  };
  let timer = 0;
  const later = () => { timer ||= setTimeout(() => { timer = 0; draw(); }, 100); };
  type.onchange = () => { remember({ type: type.value }); follow(); };
  text.oninput = () => { remember({ text: text.value.trim() }); draw(); };
  main.append(h("div.head", h("h1", "Events")),
    h("form.panel.head", { onsubmit: (event) => event.preventDefault() }, h("label.inline", "Type", type), h("label.inline", "Text", text)),
    h("section.panel", list));
  follow();
  return () => { ended.abort(); clearTimeout(timer); };
}
