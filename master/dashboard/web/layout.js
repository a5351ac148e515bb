// Layout of the graph: robots on the left, environments on the right, wires in between. Free of the DOM.

const [TITLE, PORT, GAP, GUTTER] = [48, 28, 18, 200]; // pixels; of the gutter the minimum
const NARROW = { width: 560, title: 76, gutter: 76 }; // pixels: below this width names and buttons have a line each
const [LETTER, LABEL] = [7.4, 15]; // pixels: width of a letter and height of a label
const PLACES = [0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8]; // of a label on its wire, the best first
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
  const found = new Set(words ? all.filter(fits).map((each) => each.key) : cards.keys());
  const kept = all.filter((each) => found.has(each.key) || [...each.peers].some((key) => found.has(key)));
  for (const each of kept) {
    each.ports.sort((a, b) => compare(a.key, b.key));
    each.folded = folded(each.key, kept.length > MAX_UNFOLDED);
    each.besides = !found.has(each.key);
  }
  return { cards: new Map(order(kept).map((each) => [each.key, each])), links, total: all.length };
}

/** Place every card in a graph of this width, and return the graph's height. */
export function place(cards, width) {
  const narrow = width < NARROW.width;
  const gutter = narrow ? NARROW.gutter : Math.min(GUTTER + (width - 500) / 4, width * 0.34);
  const column = Math.min(420, (width - gutter) / 2);
  const ends = { robot: 0, environment: 0 };
  for (const each of cards.values()) {
    each.title = narrow ? NARROW.title : TITLE;
    each.height = each.title + (each.folded ? 0 : each.ports.length * PORT);
    Object.assign(each, { x: each.kind === "robot" ? 1 : width - column - 1, y: ends[each.kind], width: column, narrow });
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

/** Return the path of a wire, and `at(t)`, its points from 0 to 1. A wire within one column is an arc into the gutter. */
export function line({ from, to, both }) {
  const reach = from.side === to.side ? 90 + Math.min(60, Math.abs(to.y - from.y) / 6) : Math.max(40, Math.abs(to.x - from.x) / 2);
  const [a, b] = [from.x + from.side * reach, to.x + to.side * reach];
  const [tip, tail] = [to.x + to.side * 7, from.x + (both ? from.side * 7 : 0)];
  return {
    path: `M${tail} ${from.y}C${a} ${from.y} ${b} ${to.y} ${tip} ${to.y}`,
    at: (t) => [[from.x, a, b, to.x], [from.y, from.y, to.y, to.y]].map(([p, q, r, s]) =>
      (1 - t) ** 3 * p + 3 * (1 - t) ** 2 * t * q + 3 * (1 - t) * t * t * r + t ** 3 * s),
  };
}

/** Return the positions and texts of labels {key, at, texts} by key, none of which overlap. They stay between the columns,
 * from `left` to `right`. A label has the first of its texts for which there is room, or no position. */
export function labels(all, left, right) {
  const [rows, found] = [new Map(), new Map()];
  const rowsOf = (y) => [Math.floor((y - LABEL) / LABEL), Math.floor(y / LABEL)];
  for (const { key, at, texts } of all) {
    const text = texts.find((each) => each.length * LETTER <= right - left);
    if (!text) continue;
    const half = (text.length * LETTER) / 2;
    for (const t of PLACES) {
      const [middle, height] = at(t);
      const [x, y] = [Math.max(left + half, Math.min(right - half, middle)), height - 5];
      const others = rowsOf(y).flatMap((row) => rows.get(row) ?? []);
      if (others.some((each) => Math.abs(each.x - x) < each.half + half && Math.abs(each.y - y) < LABEL)) continue;
      found.set(key, { x, y, text });
      for (const row of rowsOf(y)) rows.set(row, [...(rows.get(row) ?? []), { x, y, half }]);
      break;
    }
  }
  return found;
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
    y: card_.y + (index < 0 ? card_.title / 2 : card_.title + (index + 0.5) * PORT),
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
