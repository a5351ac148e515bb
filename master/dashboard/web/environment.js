// Page of one environment: nodes, parameters, interfaces, output and usage.

import { remember } from "./address.js";
import { attempt, bytes, h, rate, short, show, state, table } from "./dom.js";
import { Chart } from "./chart.js";
import { confirm } from "./forms.js";
import { newInterface, newNode, newParameter } from "./create.js";
import { sends } from "./graph.js";
import { LogView } from "./logview.js";

export function environmentPage(main, app, user, tag, query) {
  app.reveal(user);
  const key = `${user}/${tag}`;
  const path = `/environments/${tag}`;
  const who = app.acting(user);
  const parts = Object.fromEntries(["head", "nodes", "parameters", "interfaces"].map((name) => [name, h("div")]));
  const [cores, memory] = [new Chart("Cores", (value) => value.toFixed(2)), new Chart("Memory", bytes, 1024)];
  const logs = new LogView(app, path, who, (node) => remember({ node }));
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
      log: (name) => { remember({ node: name }); logs.select(name); },
      stop: (name) => attempt(() => app.api.remove(`${path}/nodes/${name}`, who), `Stopped ${name}`),
    });
    show(parts.parameters, parametersOf(app, user, tag, mine("parameters")));
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
  logs.filter(query.get("lines") ?? "", (lines) => remember({ lines }));
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
const title = (text, more) => h("div.head", h("h2", text), h("span.grow"), ...[more].flat());

function head(app, view) {
  const { containerData: data } = view;
  const facts = [view.machine && `on ${view.machine}`, data.memory && bytes(data.memory), data.cpu && `${data.cpu} ${data.cpu === 1 ? "core" : "cores"}`,
    data.group && `group ${data.group}`, view.address, data.image, data.gpus && `${data.gpus} GPUs`,
    view.notEnforced.length && `not enforced by this engine: ${view.notEnforced.join(", ")}`,
    (data.packages ?? []).join(", "), Object.entries(data.env ?? {}).map(([name, value]) => `${name}=${value}`).join(" ")].filter(Boolean);
  return [h("div.head", h("h1", app.named(view.user, view.containerTag)), state(view.state), h("span.grow"),
    app.me.may("data.read", view.user) && h("a.button", { href: `#/topics/${view.user}/${view.containerTag}` }, "Topics and services"),
    app.me.may("node.create", view.user) && h("a.button", { href: `terminal.html#${view.user}/${view.containerTag}` }, "Terminal"),
    view.user === app.me.user && app.me.may("interface.create") && h("a.button", { href: `examples/joystick.html?environment=${view.containerTag}` }, "Joystick"),
    app.me.may("environment.remove", view.user) && button("stop", "", "Stop environment", ".danger")),
  h("p.soft", facts.join(" · "))];
}

function nodesOf(app, user, nodes) {
  return h("div", title("Nodes", app.me.may("node.create", user) && button("add", "", "Start node")), table({
    Name: (each) => each.nodeTag,
    State: (each) => state(each.state),
    Program: (each) => h("span.mono", `${each.pkg} ${each.launch || each.exe}`),
    " ": (each) => [button("log", each.nodeTag, "Log"), !each.partOf && app.me.may("node.remove", user) && button("stop", each.nodeTag, "Stop", ".danger")],
  }, nodes, "No nodes run here."));
}

function parametersOf(app, user, tag, parameters) {
  return h("div", title("Parameters", [
    app.me.may("interface.create", user) && h("a.button.small", { href: `#/parameters/${user}/${tag}` }, "Of running nodes"),
    app.me.may("parameter.set", user) && button("add", "", "Set parameter")]), table({
    Name: (each) => (each.nodeTag ? `${each.nodeTag}: ${each.name}` : each.name),
    Value: (each) => h("span.mono", JSON.stringify(each.value)),
    " ": (each) => app.me.may("parameter.remove", user) && button("remove", JSON.stringify([each.nodeTag, each.name]), "Remove"),
  }, parameters, "No parameters are set."));
}

const VIEWS = { // by type: page and the field of the topic
  OccupancyGrid: ["map", "topic"], Image: ["image", "topic"], CompressedImage: ["image", "topic"], LaserScan: ["space", "scan"],
  PointCloud2: ["space", "cloud"],
};

function interfacesOf(app, user, tag, interfaces) {
  const seen = app.me.may("data.read", user);
  return h("div", title("Interfaces", app.me.may("interface.create", user) && button("add", "", "Add interface")), table({
    Name: (each) => each.interfaceTag,
    Kind: (each) => `${each.interfaceType.replace("Interface", "")} (${sends(each) ? "sends" : "receives"})`,
    Topic: (each) => h("span.mono", each.addr),
    Type: (each) => each.className,
    "#Rate": (each) => rate(each.rate),
    "#Dropped": (each) => String(each.rate?.drops ?? 0),
    "#Nobody subscribes": (each) => (each.rate?.unheard ? `${each.rate.unheard} discarded` : ""),
    " ": (each) => {
      const view = seen && /^(Subscriber|Publisher)Interface$/.test(each.interfaceType) && VIEWS[short(each.className)];
      return [view && h("a.button.small", { "aria-label": `View ${each.addr}`, href: `#/${view[0]}/${user}/${tag}?${view[1]}=${encodeURIComponent(each.addr)}` }, "View"),
        app.me.may("trace.read", user) && h("a.button.small", { href: `#/trace/${user}/${tag}/${each.interfaceTag}`,
          "aria-label": `Trace ${each.interfaceTag}` }, "Trace"),
        app.me.may("interface.remove", user) && button("remove", each.interfaceTag, "Remove")];
    },
  }, interfaces, "It has no interfaces."));
}
