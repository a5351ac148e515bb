// Page of one environment: nodes, parameters, interfaces, output and usage.

import { attempt, bytes, h, rate, short, show, state, table } from "./dom.js";
import { Chart } from "./chart.js";
import { confirm, newInterface, newNode, newParameter } from "./forms.js";
import { LogView } from "./logview.js";

export function environmentPage(main, app, user, tag, query) {
  app.reveal(user);
  const key = `${user}/${tag}`;
  const path = `/environments/${tag}`;
  const who = app.acting(user);
  const parts = Object.fromEntries(["head", "nodes", "parameters", "interfaces"].map((name) => [name, h("div")]));
  const [cores, memory] = [new Chart("Cores", (value) => value.toFixed(2)), new Chart("Memory", bytes)];
  const logs = new LogView(app, path, who);
  main.append(parts.head,
    h("div.two", cores.element, memory.element),
    h("div.two", h("section.panel", parts.nodes), h("section.panel", parts.parameters)),
    h("section.panel", parts.interfaces), logs.element);

  const mine = (kind) => [...app.live[kind].values()].filter((each) =>
    each.user === user && (each.containerTag ?? each.endpointTag) === tag);
  let measured = null;
  const draw = () => {
    const view = app.live.environments.get(key);
    if (!view) {
      if (app.live.complete) show(parts.head, h("h1", `There is no environment ${tag}`), h("p", h("a", { href: "#/" }, "To the graph")));
      return;
    }
    show(parts.head, head(app, view));
    bind(parts.head, {
      stop: () => confirm(`Stop environment ${tag}?`, "It is destroyed with all that is in it.", "Stop environment",
        () => app.api.remove(path, who).then(() => app.go("/"))),
    });
    if (view.usage && view.usage !== measured) {
      measured = view.usage;
      cores.add(view.usage.cores, view.containerData.cpu || 0);
      memory.add(view.usage.memory, view.containerData.memory || 0);
    }
    const nodes = mine("nodes");
    show(parts.nodes, nodesOf(app, user, nodes));
    bind(parts.nodes, {
      add: () => newNode(app, view),
      log: (name) => logs.select(name),
      stop: (name) => attempt(() => app.api.remove(`${path}/nodes/${name}`, who), `Stopped ${name}`),
    });
    show(parts.parameters, parametersOf(app, user, mine("parameters")));
    bind(parts.parameters, {
      add: () => newParameter(app, view),
      remove: (name) => {
        const [node, parameter] = JSON.parse(name);
        attempt(() => app.api.remove(`${path}/parameters/${encodeURIComponent(parameter)}`, { ...who, node }), `Removed ${parameter}`);
      },
    });
    show(parts.interfaces, interfacesOf(app, user, tag, mine("interfaces")));
    bind(parts.interfaces, {
      add: () => newInterface(app, view),
      remove: (name) => attempt(() => app.api.remove(`/interfaces/${tag}/${name}`, who), `Removed ${name}`),
    });
    logs.nodes(nodes.map((each) => each.nodeTag));
  };
  const off = app.live.on(draw);
  draw();
  logs.select(query.get("node") ?? "");
  return () => { off(); logs.stop(); };
}

/** Return the actions of the buttons, by their `data-do`; each takes the button's `data-of`. */
function bind(element, actions) {
  element.onclick = (event) => {
    const button = event.target.closest("[data-do]");
    if (button) actions[button.dataset.do](button.dataset.of);
  };
}

const button = (does, of, text, kind = "") => h(`button.small${kind}`, { "data-do": does, "data-of": of,
  "aria-label": of && `${text} ${of}` }, text);
const title = (text, more) => h("div.head", h("h2", text), h("span.grow"), more);

function head(app, view) {
  const { containerData: data } = view;
  const facts = [view.machine && `on ${view.machine}`, data.memory && bytes(data.memory), data.cpu && `${data.cpu} cores`,
    data.group && `group ${data.group}`, view.address, data.image].filter(Boolean);
  return h("div.head", h("h1", app.named(view.user, view.containerTag)),
    state(view.state), h("span.soft", facts.join(" · ")), h("span.grow"),
    app.me.may("environment.remove", view.user) && button("stop", "", "Stop environment", ".danger"));
}

function nodesOf(app, user, nodes) {
  return h("div", title("Nodes", app.me.may("node.create", user) && button("add", "", "Start node")), table({
    Name: (each) => each.nodeTag,
    State: (each) => state(each.state),
    Program: (each) => h("span.mono", `${each.pkg} ${each.exe}`),
    " ": (each) => [button("log", each.nodeTag, "Log"), app.me.may("node.remove", user) && button("stop", each.nodeTag, "Stop", ".danger")],
  }, nodes, "No nodes run here."));
}

function parametersOf(app, user, parameters) {
  return h("div", title("Parameters", app.me.may("parameter.set", user) && button("add", "", "Set parameter")), table({
    Name: (each) => (each.nodeTag ? `${each.nodeTag}: ${each.name}` : each.name),
    Value: (each) => h("span.mono", JSON.stringify(each.value)),
    " ": (each) => app.me.may("parameter.remove", user) && button("remove", JSON.stringify([each.nodeTag, each.name]), "Remove"),
  }, parameters, "No parameters are set."));
}

const VIEWS = { OccupancyGrid: "map", Image: "image", CompressedImage: "image" };

function interfacesOf(app, user, tag, interfaces) {
  const seen = app.me.may("data.read", user);
  return h("div", title("Interfaces", app.me.may("interface.create", user) && button("add", "", "Add interface")), table({
    Name: (each) => each.interfaceTag,
    Kind: (each) => each.interfaceType.replace("Interface", ""),
    Topic: (each) => h("span.mono", each.addr),
    Type: (each) => each.className,
    "#Rate": (each) => rate(each.rate),
    "#Dropped": (each) => String(each.rate?.drops ?? 0),
    " ": (each) => {
      const view = seen && each.interfaceType === "SubscriberInterface" && VIEWS[short(each.className)];
      return [view && h("a.button.small", { href: `#/${view}/${user}/${tag}?topic=${encodeURIComponent(each.addr)}` }, "View"),
        app.me.may("interface.remove", user) && button("remove", each.interfaceTag, "Remove")];
    },
  }, interfaces, "It has no interfaces."));
}
