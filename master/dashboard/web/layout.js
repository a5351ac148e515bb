// Layout of the graph: robots on the left, environments on the right, wires in between. Free of the DOM.

const [TITLE, PORT, GAP, GUTTER] = [48, 28, 18, 200]; // pixels; of the gutter the minimum
export const MAX_UNFOLDED = 24; // up to this number, cards show their interfaces unless the user folds them

/** Return the cards and wires of the graph. `folded(key, many)` returns whether a card hides its interfaces. */
export function model(live, filter, folded) {
  const cards = new Map();
  const all = [...live.robots].map(([key, view]) => card(key, "robot", view.robotID, view))
    .concat([...live.environments].map(([key, view]) => card(key, "environment", view.containerTag, view)));
  for (const each of all) cards.set(each.key, each);
  for (const [key, view] of live.interfaces) cards.get(`${view.user}/${view.endpointTag}`)?.ports.push({ key, view });
  const links = [...live.connections.values()];
  for (const { user, tagA, tagB } of links) {
    const [a, b] = [tagA, tagB].map((tag) => cards.get(`${user}/${tag.split("/")[0]}`));
    if (!a || !b) continue;
    a.peers.add(b.key);
    b.peers.add(a.key);
  }
  const words = filter.toLowerCase();
  const fits = (each) => `${each.key} ${each.ports.map(({ view }) => `${view.interfaceTag} ${view.className}`).join(" ")}`
    .toLowerCase().includes(words);
  const kept = words ? all.filter(fits) : all;
  for (const each of kept) {
    each.ports.sort((a, b) => compare(a.key, b.key));
    each.folded = folded(each.key, kept.length > MAX_UNFOLDED);
    each.height = TITLE + (each.folded ? 0 : each.ports.length * PORT);
  }
  return { cards: new Map(order(kept).map((each) => [each.key, each])), links, total: all.length };
}

/** Place every card in a graph of this width, and return the graph's height. */
export function place(cards, width) {
  const column = Math.min(420, (width - Math.min(GUTTER + (width - 500) / 4, width * 0.34)) / 2);
  const ends = { robot: 0, environment: 0 };
  for (const each of cards.values()) {
    Object.assign(each, { x: each.kind === "robot" ? 1 : width - column - 1, y: ends[each.kind], width: column });
    ends[each.kind] += each.height + GAP;
  }
  return Math.max(ends.robot, ends.environment);
}

/** Return the wires between placed cards: connections with the same ends are one wire, which may go both ways. */
export function wires(cards, links) {
  const found = new Map();
  for (const link of links) {
    const [from, to] = [link.tagA, link.tagB].map((tag) => end(cards, link.user, tag));
    if (!from || !to) continue;
    const back = found.get(`${to.key} ${from.key}`);
    const key = `${from.key} ${to.key}`;
    const wire = back ?? found.get(key) ?? { key, from, to, links: [], messages: 0, bytes: 0, drops: 0, down: false, both: false };
    found.set(wire.key, wire);
    wire.both ||= back !== undefined;
    wire.links.push(link);
    wire.down ||= link.state === "down";
    wire.messages += link.rate?.messages ?? 0;
    wire.bytes += link.rate?.bytes ?? 0;
    wire.drops += link.rate?.drops ?? 0;
  }
  return [...found.values()];
}

/** Return the path of a wire and its middle. A wire within one column is an arc into the gutter. */
export function line({ from, to, both }) {
  const reach = from.side === to.side ? 90 + Math.min(60, Math.abs(to.y - from.y) / 6) : Math.max(40, Math.abs(to.x - from.x) / 2);
  const [a, b] = [from.x + from.side * reach, to.x + to.side * reach];
  const [tip, tail] = [to.x + to.side * 7, from.x + (both ? from.side * 7 : 0)];
  return {
    path: `M${tail} ${from.y}C${a} ${from.y} ${b} ${to.y} ${tip} ${to.y}`,
    x: (from.x + 3 * a + 3 * b + to.x) / 8,
    y: (from.y + to.y) / 2,
  };
}

function end(cards, user, tag) {
  const [owner, name] = tag.split("/");
  const card_ = cards.get(`${user}/${owner}`);
  if (!card_) return null;
  const index = card_.folded ? -1 : card_.ports.findIndex(({ view }) => view.interfaceTag === name);
  const side = card_.kind === "robot" ? 1 : -1;
  return {
    key: index < 0 ? card_.key : card_.ports[index].key,
    side,
    x: side > 0 ? card_.x + card_.width + 2 : card_.x - 2,
    y: card_.y + (index < 0 ? TITLE / 2 : TITLE + (index + 0.5) * PORT),
  };
}

function card(key, kind, name, view) {
  return { key, kind, name, view, ports: [], peers: new Set() };
}

/** Order environments by name, and robots beside the environments that they are connected to. */
function order(cards) {
  const environments = cards.filter(({ kind }) => kind === "environment").sort((a, b) => compare(a.key, b.key));
  const rank = new Map(environments.map(({ key }, index) => [key, index]));
  const weight = ({ peers }) => {
    const places = [...peers].map((key) => rank.get(key)).filter((place_) => place_ !== undefined);
    return places.length ? places.reduce((sum, place_) => sum + place_, 0) / places.length : Infinity;
  };
  const robots = cards.filter(({ kind }) => kind === "robot");
  const weights = new Map(robots.map((robot) => [robot.key, weight(robot)]));
  robots.sort((a, b) => weights.get(a.key) - weights.get(b.key) || compare(a.key, b.key));
  return [...robots, ...environments];
}

const compare = (a, b) => (a < b ? -1 : a > b ? 1 : 0);
