// Page of the messages of one interface, hop by hop: each message is a bar of the times between its hops.

import { remember } from "./address.js";
import { h, show } from "./dom.js";

const FORWARD = ["entered", "sent", "received", "delivered"];
const STEPS = [...FORWARD, ...FORWARD.map((hop) => `${hop} back`)].slice(1);
const KEPT = 30; // messages
const MESSAGES = 10_000; // until the trace ends

export function tracePage(main, app, owner, endpoint, name, query) {
  const list = h("div");
  const chosen = h("select", { name: "interface" });
  const draw = () => {
    const mine = [...app.live.interfaces.values()].filter((each) => each.user === (owner || app.me.user));
    const names = mine.map((each) => `${each.endpointTag}/${each.interfaceTag}`).sort();
    const wanted = `${endpoint}/${name}`;
    show(chosen, !names.includes(wanted) && h("option", { value: "" }, "choose …"), names.map((each) => h("option", { value: each }, each)));
    if (names.includes(wanted)) chosen.value = wanted;
  };
  chosen.onchange = () => app.go(`/trace/${owner || app.me.user}/${chosen.value}`);
  main.append(h("div.head", h("h1", "Messages hop by hop")), h("form.panel.head", h("label.inline", "Interface", chosen)));
  draw();
  const off = app.live.on(draw);
  if (!name) return off;
  app.reveal(owner);
  const ended = new AbortController();
  const status = h("p.soft", { role: "status" }, "Waiting for messages …");
  const pause = h("button.small", { onclick: () => {
    remember({ paused: !query.get("paused") && "yes" });
    if (query.get("paused")) query.delete("paused");
    else query.set("paused", "yes");
    pause.textContent = query.get("paused") ? "Go on" : "Pause";
  } }, query.get("paused") ? "Go on" : "Pause");
  main.append(h("section.panel", h("div.head", status, h("span.grow"), pause), legend(), list));
  const rows = [];
  const hosts = new Set();
  const take = (message) => {
    if (query.get("paused")) return;
    for (const { host } of message.hops) hosts.add(host);
    for (const row of paths(message)) rows.unshift(row);
    rows.length = Math.min(rows.length, KEPT);
    const clocks = hosts.size > 1 ? " Steps between machines compare two clocks." : "";
    status.textContent = `Median of the last ${rows.length}: ${words(median(rows.map((each) => each.total)))}.${clocks}`;
    const most = Math.max(...rows.map((each) => each.total));
    show(list, rows.map((row) => bar(row, most)));
  };
  follow(app, `/interfaces/${endpoint}/${name}/trace`, { ...app.acting(owner), follow: "true", messages: MESSAGES }, ended.signal, take)
    .catch((error) => { if (!ended.signal.aborted) status.textContent = error.message; });
  return () => { off(); ended.abort(); };
}

async function follow(app, path, query, signal, take) {
  for await (const message of app.api.follow(path, query, signal)) take(message);
}

/** Return the steps of a message to each interface that received it: {message, to, steps: [[name, seconds], …], total}. */
export function paths({ message, source, hops }) {
  const times = new Map();
  for (const { interface: place, hop, time } of hops) if (!times.has(`${place} ${hop}`)) times.set(`${place} ${hop}`, time);
  const others = [...new Set(hops.map((each) => each.interface))].filter((each) => each !== source);
  return others.map((to) => {
    const places = [source, source, to, to, to, to, source, source];
    const at = places.map((place, index) => times.get(`${place} ${FORWARD[index % 4]}`));
    const steps = STEPS.map((step, index) => [step, at[index + 1] - at[index]]).filter(([, seconds]) => Number.isFinite(seconds));
    const known = at.filter((each) => each !== undefined);
    return { message, to, steps, total: known.at(-1) - known[0] };
  });
}

function bar({ message, to, steps, total }, most) {
  const parts = steps.map(([step, seconds]) => {
    const part = h(`span.step.s${STEPS.indexOf(step)}`, { title: `${step}: ${words(seconds)}` });
    part.style.width = `${(100 * Math.max(0, seconds)) / most}%`;
    return part;
  });
  const text = steps.map(([step, seconds]) => `${step} ${words(seconds)}`).join(", ");
  return h("div.hops", h("div.head", h("span.mono", message.slice(0, 12)), h("span", `to ${to}`), h("span.grow"), h("strong", words(total))),
    h("div.steps", { role: "img", "aria-label": text }, parts), h("div.soft", text));
}

function legend() {
  return h("p.legend", STEPS.map((step, index) => h("span", h(`span.step.s${index}`), step)));
}

const words = (seconds) => (seconds < 0.001 ? `${Math.round(seconds * 1e6)} µs` : `${(seconds * 1000).toFixed(1)} ms`);

function median(values) {
  const sorted = [...values].sort((a, b) => a - b);
  return sorted[Math.floor(sorted.length / 2)];
}
