// Page of the audit log.

import { remember } from "./address.js";
import { attempt, h, longName, show, table, time } from "./dom.js";

const FILTERS = [["user", "User"], ["action", "Action"], ["object", "Object"], ["result", "Result"]];

export function auditPage(main, app, query) {
  const list = h("div");
  const form = h("form.panel.head", FILTERS.map(([name, label]) => h("label.inline", label, h("input", { name, size: 12, autocomplete: "off", value: query.get(name) ?? "" }))),
    h("button.main", { type: "submit" }, "Show"));
  const more = h("button", { hidden: true }, "More");
  let entries = [];
  let after = "";
  const load = () => attempt(async () => {
    const page = await app.api.get("/audit", { ...Object.fromEntries(new FormData(form)), limit: 100, after });
    entries = [...entries, ...page.items];
    after = page.next;
    more.hidden = !after;
    show(list, table({
      Time: (each) => h("span.when", time(each.time)),
      User: (each) => each.user || h("span.soft", "nobody"),
      Action: (each) => each.action,
      Object: (each) => longName(each.object),
      Result: (each) => h(each.result === "ok" ? "span" : "span.bad", each.result),
      From: (each) => `${each.door} ${each.address}`,
    }, entries, "Nothing was done that fits."));
  });
  form.onsubmit = (event) => {
    event.preventDefault();
    remember(Object.fromEntries(new FormData(form)));
    [entries, after] = [[], ""];
    load();
  };
  more.onclick = load;
  main.append(h("div.head", h("h1", "Audit log")), form, h("section.panel", list, more));
  load();
  return () => {};
}
