// Page of the live graph. Only what is near the window is in the document, so it stays fast with thousands of interfaces.

import { remember } from "./address.js";
import { attempt, h, rate, short, show, state, svg, table } from "./dom.js";
import { newEnvironment, newInterface, newNode } from "./create.js";
import { confirm, tell } from "./forms.js";
import { labels, line, model, place, wires } from "./layout.js";
import { welcome } from "./welcome.js";

const MARGIN = 600; // pixels above and below the window that are drawn as well

export function graphPage(main, app, query) {
  const graph = new Graph(app, query.get("filter") ?? "");
  const first = welcome(app);
  main.append(graph.head, first, graph.element);
  const redraw = () => {
    graph.draw();
    first.hidden = app.me.role === "admin" || !app.live.complete || app.live.robots.size + app.live.environments.size > 0;
  };
  const scroll = () => requestAnimationFrame(() => graph.paint());
  const size = new ResizeObserver(redraw);
  size.observe(graph.element);
  const off = app.live.on(redraw);
  window.addEventListener("scroll", scroll, { passive: true });
  const escape = (event) => event.key === "Escape" && graph.choose(null);
  window.addEventListener("keydown", escape);
  redraw();
  return () => {
    off();
    size.disconnect();
    window.removeEventListener("scroll", scroll);
    window.removeEventListener("keydown", escape);
  };
}

const kindOf = (view) => view.interfaceType.replace(/(Interface|Converter|Forwarder)$/, "");

/** Return whether messages and requests leave through this interface when it is connected; otherwise they enter. */
export const sends = (view) => /^(Subscriber|ServiceProvider|ActionProvider)$/.test(kindOf(view));

/** Return whether two interfaces can be connected. */
export function fit(a, b) {
  const opposite = {
    Publisher: "Subscriber", Subscriber: "Publisher", ServiceClient: "ServiceProvider", ServiceProvider: "ServiceClient",
    ActionClient: "ActionProvider", ActionProvider: "ActionClient",
  };
  const type = (view) => view.className.replace(/\/(msg|srv|action)\//, "/");
  return a.user === b.user && opposite[kindOf(a)] === kindOf(b) && type(a) === type(b) && a.endpointTag !== b.endpointTag;
}

class Graph {
  #app;
  #folds = new Map(); // cards that the user folded or unfolded
  #chosen = null; // key of the interface to be connected
  #cards = new Map();
  #wires = [];
  #labels = new Map(); // positions of the labels of wires by their keys
  #drawn = new Map(); // elements in the document by key, with the content that they show
  #summary = h("span.soft", { "aria-live": "polite" });
  #none = h("p.empty");

  constructor(app, filter) {
    this.#app = app;
    this.filter = h("input", { type: "search", placeholder: "Filter by name or type", "aria-label": "Filter", value: filter });
    this.filter.addEventListener("input", () => { remember({ filter: this.filter.value.trim() }); this.draw(); });
    this.svg = svg("svg", { role: "group", "aria-label": "Connections" }, svg("defs", svg("marker", {
      id: "arrow", viewBox: "0 0 8 8", refX: 7, refY: 4, markerWidth: 7, markerHeight: 7, markerUnits: "userSpaceOnUse", orient: "auto-start-reverse",
    }, svg("path", { d: "M0 0L8 4L0 8z" }))), svg("g"));
    this.element = h("div.graph", this.svg, this.#none);
    this.head = h("div.head", h("h1", "Robots and environments"), this.#summary, h("span.grow"), this.filter,
      app.me.may("environment.create") && h("button.main", { onclick: () => newEnvironment(app) }, "New environment"));
  }

  /** Compute the layout of all cards and wires. */
  draw() {
    const { live } = this.#app;
    const folded = (key, many) => this.#folds.get(key) ?? many;
    const { cards, links, total } = model(live, this.filter.value.trim(), folded);
    this.#cards = cards;
    this.element.style.height = `${place(cards, this.element.clientWidth)}px`;
    this.#wires = wires(cards, links);
    if (this.#chosen && !live.interfaces.has(this.#chosen)) this.#chosen = null;
    this.#summary.textContent = this.#chosen
      ? `Choose what to connect ${live.interfaces.get(this.#chosen).interfaceTag} with, or press Escape.`
      : [[live.robots, "robot"], [live.environments, "environment"], [live.interfaces, "interface"], [live.connections, "connection"]]
        .map(([all, name]) => `${all.size} ${name}${all.size === 1 ? "" : "s"}`).join(", ");
    this.#none.textContent = live.complete && !cards.size ? this.#whyEmpty(total) : "";
    this.paint();
  }

  /** Return why nothing is shown; other users than administrators see their first steps instead. */
  #whyEmpty(total) {
    if (total) return "Nothing fits this filter.";
    const { live, me } = this.#app;
    if (live.user === "*") return "No user has robots or environments now.";
    return me.may("environment.read", "*") ? "You have no robots or environments now. Check “all users” at the top to see those of others." : "";
  }

  /** Add what is near the window to the document, and remove the rest. */
  paint() {
    const top = -this.element.getBoundingClientRect().top - MARGIN;
    const bottom = top + window.innerHeight + 2 * MARGIN;
    const seen = new Set();
    for (const card of this.#cards.values()) {
      if (card.y < bottom && card.y + card.height > top) seen.add(this.#card(card));
    }
    const near = this.#wires.filter(({ from, to }) => Math.min(from.y, to.y) < bottom && Math.max(from.y, to.y) > top)
      .map((wire) => ({ ...wire, ...line(wire), texts: [label(wire), brief(wire)] }));
    const [first] = this.#cards.values();
    const edge = first ? first.width + 12 : 0;
    this.#labels = labels(near, edge, this.element.clientWidth - edge);
    for (const wire of near) seen.add(this.#wire(wire));
    for (const [key, { element }] of this.#drawn) {
      if (!seen.has(key)) {
        element.remove();
        this.#drawn.delete(key);
      }
    }
    this.element.classList.toggle("connecting", this.#chosen !== null);
  }

  choose(key) {
    this.#chosen = key;
    this.draw();
  }

  #card(card) {
    const key = `card ${card.key}`;
    const chosen = this.#chosen && this.#app.live.interfaces.get(this.#chosen);
    const looks = card.ports.map(({ key: port, view }) =>
      port === this.#chosen ? "chosen" : chosen && fit(chosen, view) ? "fits" : "");
    const shown = JSON.stringify([card.view.state, card.folded, card.width, card.besides, looks, card.ports.map(({ key: port, view }) => [port, view.state])]);
    let drawn = this.#drawn.get(key);
    if (!drawn) this.#drawn.set(key, drawn = { element: h(`section.node.${card.kind}`, { "aria-label": `${card.kind} ${card.name}` }), shown: "" });
    if (drawn.shown !== shown) {
      drawn.shown = shown;
      drawn.element.style.width = `${card.width}px`;
      drawn.element.classList.toggle("narrow", card.narrow);
      drawn.element.classList.toggle("besides", card.besides);
      show(drawn.element, this.#title(card), ...(card.folded ? [] : card.ports.map((port, index) => this.#port(port, looks[index]))));
      this.#listen(drawn.element, card.key);
    }
    if (!drawn.element.isConnected) this.element.append(drawn.element);
    const transform = `translate(${card.x}px, ${card.y}px)`;
    if (drawn.element.style.transform !== transform) drawn.element.style.transform = transform;
    return key;
  }

  #title(card) {
    const name = this.#app.named(card.view.user, card.name) + (card.view.guest ? ` (${card.view.guest})` : "");
    return h("div.title", state(card.view.state),
      card.kind === "environment"
        ? h("a.name", { href: `#/environments/${card.view.user}/${card.name}`, title: name }, name)
        : h("span.name", { title: name }, name),
      card.ports.length > 0 && h("button.small", { "data-do": "fold", "aria-expanded": String(!card.folded),
        title: card.folded ? "Show interfaces" : "Hide interfaces" }, card.folded ? `${card.ports.length} ▸` : "▾"),
      h("button.small", { "data-do": "more", "aria-label": `Actions of ${name}` }, "⋯"));
  }

  #port({ key, view }, look) {
    const way = sends(view) ? "sends" : "receives";
    return h(`button.port.${way}${look ? `.${look}` : ""}`, { "data-do": "port", "data-port": key,
      title: `${way}: ${view.interfaceType} ${view.className} ${view.addr}`,
      "aria-label": `${view.endpointTag}/${view.interfaceTag}, ${kindOf(view)} of ${view.className}, ${way}` },
    h("span.tag", view.interfaceTag), h("span.type", short(view.className)));
  }

  /** Handle all clicks here, because `show` may keep elements with their old listeners. */
  #listen(element, key) {
    element.onclick = (event) => {
      const button = event.target.closest("[data-do]");
      const card = this.#cards.get(key);
      if (!button || !card) return;
      if (button.dataset.do === "fold") {
        this.#folds.set(key, !card.folded);
        this.draw();
      } else if (button.dataset.do === "more") this.#actions(card);
      else this.#pick(button.dataset.port);
    };
  }

  #pick(port) {
    const { live, me } = this.#app;
    const [chosen, other] = [live.interfaces.get(this.#chosen), live.interfaces.get(port)];
    if (chosen && fit(chosen, other)) {
      const [tagA, tagB] = [chosen, other].map((each) => `${each.endpointTag}/${each.interfaceTag}`);
      this.choose(null);
      attempt(() => this.#app.api.post("/connections", { tagA, tagB }, this.#app.acting(other.user)), `Connected ${tagA} and ${tagB}`);
    } else if (me.may("connection.create", other.user)) this.choose(port === this.#chosen ? null : port);
    else tell(other.interfaceTag, h("p", `${other.interfaceType} of ${other.className}`));
  }

  #actions(card) {
    const { api, me, acting } = this.#app;
    const { user } = card.view;
    const isEnvironment = card.kind === "environment";
    const stop = isEnvironment
      ? ["Stop environment", "environment.remove", `/environments/${card.name}`, "It is destroyed with all that is in it."]
      : ["Disconnect robot", "robot.disconnect", `/robots/${card.name}`, "Its session ends now; it may come back."];
    const then = (work) => () => { dialog.close(); work(); };
    const actions = [
      isEnvironment && h("button", { onclick: then(() => this.#app.go(`/environments/${user}/${card.name}`)) }, "Open"),
      isEnvironment && me.may("node.create", user) && h("button", { onclick: then(() => newNode(this.#app, card.view)) }, "Start node"),
      !card.view.guest && me.may("interface.create", user) && h("button", { onclick: then(() => newInterface(this.#app, card.view)) }, "Add interface"),
      me.may(stop[1], user) && h("button.danger", { onclick: then(() => confirm(`${stop[0]} ${card.name}?`, stop[3], stop[0],
        () => api.remove(stop[2], acting(user)))) }, stop[0]),
    ].filter(Boolean);
    const remove = (view) => me.may("interface.remove", user) && h("button.small.danger", {
      "aria-label": `Remove ${view.interfaceTag}`, onclick: () => attempt(async () => {
        await api.remove(`/interfaces/${view.endpointTag}/${view.interfaceTag}`, acting(user));
        dialog.close();
      }, `Removed ${view.interfaceTag}`) }, "Remove");
    const dialog = tell(card.name, h("p.head", actions), table({
      Interface: ({ view }) => view.interfaceTag, Kind: ({ view }) => view.interfaceType, Direction: ({ view }) => (sends(view) ? "sends" : "receives"), Type: ({ view }) => short(view.className),
      " ": ({ view }) => remove(view),
    }, card.ports, "It has no interfaces."));
  }

  #wire(wire) {
    const key = `wire ${wire.key}`;
    const { path, texts: [text] } = wire;
    const place_ = this.#labels.get(wire.key);
    const shown = JSON.stringify([path, text, place_, wire.drops, wire.down, wire.both]);
    let drawn = this.#drawn.get(key);
    if (!drawn) {
      const parts = { touch: svg("path.touch"), line: svg("path.line", { "marker-end": "url(#arrow)" }), text: svg("text") };
      const element = svg("g.wire", { tabindex: 0, role: "button" }, parts.touch, parts.line, parts.text);
      drawn = { element, parts, shown: "" };
      this.#drawn.set(key, drawn);
      element.onclick = () => this.#details(key);
      element.onkeydown = (event) => (event.key === "Enter" || event.key === " ") && (event.preventDefault(), this.#details(key));
      this.svg.lastChild.append(element);
    }
    if (drawn.shown !== shown) {
      drawn.shown = shown;
      const { element, parts } = drawn;
      element.setAttribute("class", `wire${wire.down ? " down" : ""}${wire.drops ? " drops" : ""}`);
      element.setAttribute("aria-label", `connection ${wire.links.map((each) => `${each.tagA} to ${each.tagB}`).join(", ")} ${text}`);
      parts.touch.setAttribute("d", path);
      parts.line.setAttribute("d", path);
      parts.line.toggleAttribute("marker-start", false);
      if (wire.both) parts.line.setAttribute("marker-start", "url(#arrow)");
      parts.text.setAttribute("x", place_?.x ?? 0);
      parts.text.setAttribute("y", place_?.y ?? 0);
      const [words, lost] = place_ ? place_.text.split(LOST) : [""];
      parts.text.replaceChildren(words, lost === undefined ? "" : svg("tspan.lost", `${LOST}${lost}`));
    }
    return key;
  }

  #details(key) {
    const wire = this.#wires.find((each) => `wire ${each.key}` === key);
    const { api, me, acting } = this.#app;
    const cut = (link) => me.may("connection.remove", link.user) && h("button.small.danger", { onclick: () => attempt(async () => {
      await api.remove(`/connections/${link.tagA}/${link.tagB}`, acting(link.user));
      dialog.close();
    }, `Disconnected ${link.tagA} and ${link.tagB}`) }, "Disconnect");
    const dialog = tell("Connections", table({
      From: (link) => link.tagA, To: (link) => link.tagB, Type: (link) => short(link.className), "#Rate": (link) => rate(link.rate),
      "#Dropped": (link) => String(link.rate?.drops ?? 0), " ": cut,
    }, wire.links, ""));
  }
}

const LOST = "  dropped "; // between the rate and the number of dropped messages

/** Return the label of a wire: how many connections it stands for, their rate, and what was dropped. */
function label(wire) {
  const many = wire.links.length > 1 ? `${wire.links.length}× ` : "";
  const words = rate(wire.links.some((each) => each.rate) ? wire : null);
  return many + words + (wire.drops ? `${LOST}${wire.drops}` : "");
}

/** Return the label of a wire where there is little room: its messages a second. */
const brief = (wire) => rate(wire.links.some((each) => each.rate) ? wire : null).split(" ")[0];
