// DOM helpers of all pages: elements, tables and notices.

const SVG = "http://www.w3.org/2000/svg";

/** Create an element: `h("button.small", {onclick, title}, "text", child…)`. Null and false are ignored. */
export function h(name, ...rest) {
  return fill(document.createElement(name.split(".")[0]), name, rest);
}

export function svg(name, ...rest) {
  return fill(document.createElementNS(SVG, name.split(".")[0]), name, rest);
}

function fill(element, name, rest) {
  const classes = name.split(".").slice(1);
  if (classes.length) element.setAttribute("class", classes.join(" "));
  const plain = rest[0] && rest[0].constructor === Object ? rest.shift() : {};
  for (const [key, value] of Object.entries(plain)) {
    if (value === null || value === undefined || value === false) continue;
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else element.setAttribute(key, value === true ? "" : value);
  }
  element.append(...rest.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return element;
}

const WIDE = 6; // columns from which a table becomes a list of cards earlier

/** Create a table of `columns` {title: cell(row)}; a title with # in front is of numbers, a blank one of buttons. Where it
 * has no room, each row is a card. The roles stay those of a table then. */
export function table(columns, rows, none) {
  if (!rows.length) return h("p.empty", none);
  const kind = (title) => (title.startsWith("#") ? ".number" : title.trim() ? "" : ".actions");
  const titles = Object.keys(columns);
  const cell = (title, row) => h(`td${kind(title)}`, { role: "cell", "data-title": title.replace("#", "").trim() || null }, columns[title](row));
  const head = (title) => (title.trim() ? h(`th${kind(title)}`, { role: "columnheader", scope: "col" }, title.replace("#", "")) : h("td", { role: "cell" }));
  return h("div.cards", h(titles.length >= WIDE ? "table.wide" : "table", { role: "table" },
    h("thead", { role: "rowgroup" }, h("tr", { role: "row" }, titles.map(head))),
    h("tbody", { role: "rowgroup" }, rows.map((row) => h("tr", { role: "row" }, titles.map((title) => cell(title, row)))))));
}

/** Make the children of `element` equal to `children`. Equal nodes stay, so that no click or focus is lost. They keep
 * their old listeners: use one listener on `element` (`data-do`) if it needs the newest data. */
export function show(element, ...children) {
  patch(element, h("div", ...children));
}

function patch(old, fresh) {
  const [have, want] = [[...old.childNodes], [...fresh.childNodes]];
  want.forEach((node, index) => {
    const there = have[index];
    if (!there) old.append(node);
    else if (there.nodeName !== node.nodeName || there.id !== node.id) there.replaceWith(node);
    else if (node.nodeType !== Node.ELEMENT_NODE) {
      if (there.data !== node.data) there.data = node.data;
    } else {
      for (const { name, value } of node.attributes) if (there.getAttribute(name) !== value) set(there, name, value);
      for (const { name } of [...there.attributes]) if (!node.hasAttribute(name)) there.removeAttribute(name);
      patch(there, node);
    }
  });
  for (const node of have.slice(want.length)) node.remove();
}

/** Set an attribute. The content security policy forbids the attribute `style`, but not the property. */
function set(element, name, value) {
  if (name === "style") element.style.cssText = value;
  else element.setAttribute(name, value);
}

/** Show a notice for a while; `more` is an element beside the text. */
export function notice(text, bad = false, more = null) {
  const box = h(bad ? "div.bad" : "div", h("span", String(text)), more, h("button.small", { onclick: () => box.remove() }, "Close"));
  document.getElementById("notices").append(box);
  setTimeout(() => box.remove(), bad ? 20_000 : 5_000);
}

/** Run the action of a click, and show the error if the server refuses it. */
export async function attempt(work, done = "") {
  try {
    const result = await work();
    if (done) notice(done);
    return result;
  } catch (error) {
    notice(error.message, true);
    return undefined;
  }
}

const GOOD = new Set(["connected", "ready", "running", "joined", "up", "active", "done"]);
const BAD = new Set(["gone", "down", "failed", "lost", "expired", "revoked"]);

export function state(word) {
  return h(`span.state${GOOD.has(word) ? ".good" : BAD.has(word) ? ".bad" : ""}`, word);
}

/** Return a number of bytes with a binary prefix, as the console writes it. */
export function bytes(count) {
  const units = ["B", "KiB", "MiB", "GiB", "TiB"];
  let unit = 0;
  while (count >= 1023.5 && unit < 4) [count, unit] = [count / 1024, unit + 1];
  return `${unit && count < 10 ? Number(count.toFixed(1)) : Math.round(count)} ${units[unit]}`;
}

export function rate(each) {
  if (!each) return "";
  const messages = each.messages >= 10 ? Math.round(each.messages) : Number(each.messages.toFixed(1));
  return `${messages}/s · ${bytes(each.bytes)}/s`;
}

/** Return a long name, which is broken between its parts where it has no room. */
export const longName = (text) => h("span.any", text.split(/(?<=[/.])/).flatMap((part) => [part, h("wbr")]));

export const short = (type) => type.split("/").pop();
export const time = (seconds) => (seconds ? new Date(seconds * 1000).toLocaleString() : "");
