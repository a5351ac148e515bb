// Page of the topics, services and actions of an environment: messages as they come, a plot, publishing and calling.

import { h, show, table } from "./dom.js";
import { chooser } from "./chooser.js";
import { actionPanel } from "./actions.js";
import { endedNotice } from "./ended.js";
import { brief, messageForm } from "./messages.js";
import { Plot } from "./plot.js";
import { Guest } from "./robot.js";

const KEPT = 20; // messages in the table
const REFRESH = 3000; // milliseconds between readings of the lists
const HIDDEN = /^\/rosout$|^\/parameter_events$|\/_|\/(describe|get|list|set)_parameters(_atomically)?$|\/get_(parameter_types|type_description)$/;

export function topicsPage(main, app, owner, environment, query) {
  const pick = chooser(app, "topics", owner, environment, []);
  main.append(h("div.head", h("h1", "Topics and services"), environment && h("span.soft", app.named(owner, environment))), pick.element);
  if (!environment) {
    main.append(h("p.soft", "Choose an environment to see what its nodes publish, and to call their services."));
    return pick.stop;
  }
  app.reveal(owner);
  const lists = h("section.panel");
  const place = { app, path: `/environments/${environment}`, who: app.acting(owner), guest: new Guest(app, owner, environment),
    writes: app.me.may("interface.create", owner) };
  const link = (kind) => (each) => h("a", { href: `#/topics/${owner}/${environment}?${kind}=${encodeURIComponent(each.name)}` }, each.name);
  const shown = [];
  const read = async () => {
    if (document.hidden) return;
    const [topics, services, actions] = await Promise.all(["topics", "services", "actions"].map((kind) => app.api.list(`${place.path}/${kind}`, place.who)));
    const visible = (each) => !HIDDEN.test(each.name);
    show(lists, h("h2", "Topics"), table({
      Name: link("topic"), Type: (each) => each.types.join(", "), "#Publishers": (each) => String(each.publishers),
      "#Subscribers": (each) => String(each.subscribers),
    }, topics.filter(visible), "No node publishes or subscribes here."),
    h("h2", "Services"), table({ Name: link("service"), Type: (each) => each.types.join(", ") },
      services.filter(visible), "No node offers a service."),
    actions.length > 0 && h("h2", "Actions"), actions.length > 0 && table({
      Name: link("action"), Type: (each) => each.types.join(", "), Servers: (each) => each.servers.join(", "),
    }, actions, ""));
    const wanted = [["topic", topics, topicPanel], ["service", services, servicePanel], ["action", actions, actionPanel]];
    for (const [kind, all, panel] of wanted) {
      const found = all.find((each) => each.name === query.get(kind));
      if (!found || shown.length) continue;
      shown.push(panel(place, found.name, found.types[0].replace(/\/(msg|srv|action)\//, "/")));
      main.insertBefore(shown[0].element, lists);
    }
  };
  const update = () => read().catch((error) => show(lists, h("p.error", error.message)));
  const ended = endedNotice(app, owner, environment);
  main.append(ended.element, lists);
  update();
  const timer = setInterval(update, REFRESH);
  return () => { clearInterval(timer); pick.stop(); ended.stop(); shown.forEach((each) => each.stop()); place.guest.close(); };
}

/** Panel of one topic: what comes, and a form to publish. */
function topicPanel(place, topic, type) {
  const [status, latest, rows] = [h("span.soft", { role: "status" }, "Waiting for a message …"), h("pre.message"), h("div")];
  const plot = new Plot();
  const kept = [];
  const arrivals = [];
  let paused = false;
  const pause = h("button.small", { onclick: () => { paused = !paused; pause.textContent = paused ? "Go on" : "Pause"; } }, "Pause");
  const take = (message) => {
    const now = performance.now();
    arrivals.push(now);
    while (arrivals[0] < now - 5000) arrivals.shift();
    if (paused) return;
    plot.add(message);
    kept.unshift([new Date(), message]);
    kept.length = Math.min(kept.length, KEPT);
  };
  const draw = () => {
    if (!kept.length || paused || document.hidden) return;
    const rate = arrivals.length / 5;
    status.textContent = `${rate >= 10 ? Math.round(rate) : rate.toFixed(1)} messages a second`;
    latest.textContent = JSON.stringify(brief(kept[0][1]), null, 2);
    show(rows, table({ Time: ([when]) => when.toLocaleTimeString(), Message: ([, message]) => h("span.mono.any", JSON.stringify(brief(message))) }, kept, ""));
  };
  const timer = setInterval(draw, 200);
  place.guest.subscribe(topic, type, { depth: 100, qos: { depth: 100 }, callback: take })
    .catch((error) => { status.textContent = error.message; });
  const element = h("section.panel", h("div.head", h("h2", topic), h("span.soft", type), status, h("span.grow"), pause),
    h("div.two", h("div", h("h3", "Latest message"), latest), h("div", h("h3", "Plot"), plot.element, plot.fields)),
    h("details", h("summary", `Last ${KEPT} messages`), rows),
    place.writes && messageForm(place, type, "msg", "Publish", (message) => place.guest.publish(topic, type, message).then(() => "Published")));
  return { element, stop: () => { clearInterval(timer); plot.stop(); } };
}

/** Panel of one service: a form to call it, and the answer. */
function servicePanel(place, service, type) {
  const answer = h("pre.message");
  const call = async (request) => {
    answer.textContent = "";
    answer.textContent = JSON.stringify(brief(await place.guest.call(service, type, request)), null, 2);
    return "";
  };
  const form = place.writes ? messageForm(place, type, "srv", "Call", call) : h("p.soft", "Your role may not call services here.");
  return { element: h("section.panel", h("div.head", h("h2", service), h("span.soft", type)), form, h("h3", "Answer"), answer), stop: () => {} };
}
