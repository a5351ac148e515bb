// Frame of the dashboard: sign-in, the bar at the top, and the current page.

import { Api, withPassword } from "./api.js";
import { remember } from "./address.js";
import { auditPage } from "./audit.js";
import { bagsPage } from "./bags.js";
import { attempt, h, show } from "./dom.js";
import { environmentPage } from "./environment.js";
import { eventsPage } from "./eventlog.js";
import { followEvents } from "./events.js";
import { graphPage } from "./graph.js";
import { jobsPage } from "./jobs.js";
import { keysPage } from "./keys.js";
import { knowledgePage } from "./knowledge.js";
import { Live } from "./live.js";
import { machinesPage } from "./machines.js";
import { cataloguePage } from "./catalogue.js";
import { packagesPage } from "./packages.js";
import { panelsPage } from "./panelspage.js";
import { parametersPage } from "./parameters.js";
import { Person } from "./person.js";
import { topicsPage } from "./topics.js";
import { tracePage } from "./trace.js";
import { userPage, usersPage } from "./users.js";
import { viewPage } from "./viewpage.js";

const KEY = "rce.key"; // in sessionStorage, so it is gone with the tab
const HOURS = 12;
const [bar, main] = [document.getElementById("bar"), document.getElementById("main")];
const PAGES = [ // path, page, label in the bar, and the operation that it needs
  [/^\/$/, graphPage, "Graph"],
  [/^\/environments\/(\w+)\/(\w+)$/, environmentPage],
  [/^\/map(?:\/(\w+)\/(\w+))?$/, viewPage("map", "map", "Choose an environment whose nodes publish a map."), "Map", "data.read"],
  [/^\/topics(?:\/(\w+)\/(\w+))?$/, topicsPage, "Topics", "data.read"],
  [/^\/image(?:\/(\w+)\/(\w+))?$/, viewPage("image", "image", "Choose an environment whose nodes publish images."), "Image", "data.read"],
  [/^\/space(?:\/(\w+)\/(\w+))?$/, viewPage("space", "space", "Choose an environment with laser scans or point clouds."), "3D", "data.read"],
  [/^\/panels$/, panelsPage, "Panels", "data.read"],
  [/^\/recordings$/, jobsPage, "Recordings", "job.read"],
  [/^\/bags$/, bagsPage, "Bags", "recording.read"],
  [/^\/knowledge(?:\/(\w+)\/([\w.%-]+))?$/, knowledgePage, "Knowledge", "knowledge.read"],
  [/^\/services$/, cataloguePage, "Services", "catalogue.read"],
  [/^\/packages$/, packagesPage, "Packages", "package.read"],
  [/^\/parameters\/(\w+)\/(\w+)$/, parametersPage],
  [/^\/trace(?:\/(\w+)\/([\w@]+)\/([\w@.]+))?$/, tracePage, "Trace", "trace.read"],
  [/^\/events$/, eventsPage, "Events", "feed.read"],
  [/^\/machines$/, machinesPage, "Machines", "machine.read"],
  [/^\/users$/, usersPage, "Users", "user.create"],
  [/^\/users\/(\w+)$/, userPage],
  [/^\/keys$/, keysPage, "Keys", "key.read"],
  [/^\/audit$/, auditPage, "Audit", "audit.read"],
];

let app = null;
let leave = null; // ends the current page

async function start() {
  const stored = sessionStorage.getItem(KEY);
  if (!stored) return signInPage();
  const api = new Api(stored);
  try {
    const me = new Person(await api.get("/whoami"));
    const live = new Live(stored, me.user, () => forget("Your key is not good any more: sign in again."));
    const ended = new AbortController();
    app = { api, me, live, ended, key: stored, go: (path) => { location.hash = path; } };
    app.acting = (user = live.user === "*" ? me.user : live.user) => (user === me.user ? {} : { user });
    app.named = (user, tag) => (user === me.user ? tag : `${user}/${tag}`);
    app.reveal = (user) => user !== me.user && live.user !== "*" && me.may("environment.read", "*") && live.watch("*");
    live.on(drawBar);
    followEvents(app, ended.signal);
    window.addEventListener("hashchange", route);
    window.addEventListener("resize", showCurrent);
    route();
  } catch (error) {
    if (error.status === 401) return forget("Sign in again: your key has expired or was revoked.");
    show(main, h("p.error", error.message), h("button", { onclick: () => location.reload() }, "Try again"));
  }
  return undefined;
}

function route() {
  const [path, query = ""] = (location.hash.slice(1) || "/").split("?");
  const found = PAGES.map(([pattern, page]) => [pattern.exec(path), page]).find(([match]) => match);
  leave?.();
  leave = null;
  main.replaceChildren();
  drawBar();
  if (!found) return show(main, h("h1", `There is no page ${path}`), h("p", h("a", { href: "#/" }, "To the graph")));
  const [match, page] = found;
  const given = new URLSearchParams(query);
  if (given.get("everybody") && app.live.user !== "*" && app.me.may("environment.read", "*")) app.live.watch("*");
  showCurrent();
  leave = page(main, app, ...match.slice(1).map((part) => part ?? ""), given);
  return undefined;
}

/** Scroll the bar, where it is narrow, to the link of the current page. */
function showCurrent() {
  bar.querySelector("nav [aria-current]")?.scrollIntoView({ inline: "center", block: "nearest" });
}

function drawBar() {
  const here = location.hash.slice(1).split("?")[0] || "/";
  const links = PAGES.filter(([, , title, operation]) => title && (!operation || app.me.may(operation)));
  const everybody = app.me.may("environment.read", "*");
  show(bar,
    h("a.brand", { href: "#/", "aria-label": "RCE" }, h("img", { src: "icon.svg", alt: "" }), h("span", "RCE")),
    h("nav", { "aria-label": "Pages" }, links.map(([pattern, , title]) => {
      const path = pattern.source.replace(/^\^|\(.*|\\|\$$/g, "") || "/";
      return h("a", { href: `#${path}${app.live.user === "*" ? "?everybody=yes" : ""}`, "aria-current": pattern.test(here) && "page" }, title);
    })),
    everybody && h("label.inline.soft", h("input", { type: "checkbox", id: "everybody" }), "all users"),
    h("span.who", h(`span.pulse${app.live.connected ? ".on" : ""}`, { role: "img",
      "aria-label": app.live.connected ? "live" : "not connected", title: app.live.connected ? "live" : "not connected" }),
    app.me.may("usage.read") ? h("a", { href: `#/users/${app.me.user}` }, app.me.user) : app.me.user, ` (${app.me.role})`, h("button.small", { id: "leave" }, "Sign out")));
  document.getElementById("leave").onclick = signOut;
  const box = document.getElementById("everybody");
  if (box) box.checked = app.live.user === "*";
  if (box) {
    box.onchange = () => {
      app.live.watch(box.checked ? "*" : app.me.user);
      remember({ everybody: box.checked && "yes" });
      drawBar();
    };
  }
}

function signInPage(message = "") {
  const error = h("p.error", { role: "alert" }, message);
  const button = h("button.main", { type: "submit" }, "Sign in");
  const form = h("form.panel.signin", h("img", { src: "icon.svg", alt: "" }), h("h1", "Sign in to RCE"),
    h("label", "User", h("input", { name: "user", required: true, autocomplete: "username" })),
    h("label", "Password", h("input", { name: "password", type: "password", required: true, autocomplete: "current-password" })),
    error, button);
  form.onsubmit = async (event) => {
    event.preventDefault();
    button.disabled = true;
    error.textContent = "";
    const { user, password } = Object.fromEntries(new FormData(form));
    try {
      const made = await withPassword(user, password)("/keys", { label: "dashboard", expires: Date.now() / 1000 + HOURS * 3600 });
      sessionStorage.setItem(KEY, made.secret);
      await start();
    } catch (problem) {
      error.textContent = problem.message;
    }
    button.disabled = false;
  };
  bar.replaceChildren();
  main.replaceChildren(form);
  form.user.focus();
}

async function signOut() {
  await attempt(() => app.api.remove(`/keys/${app.me.key}`));
  history.replaceState(null, "", location.pathname); // the next user begins at the graph
  forget();
}

/** Forget the key, and show the form to sign in. */
function forget(message = "") {
  sessionStorage.removeItem(KEY);
  window.removeEventListener("hashchange", route);
  window.removeEventListener("resize", showCurrent);
  leave?.();
  leave = null;
  app?.live.close();
  app?.ended.abort();
  app = null;
  signInPage(message);
}

document.documentElement.dataset.loaded = ""; // index.html reloads the page until then
sessionStorage.removeItem("rce.attempt");
window.addEventListener("pagehide", () => app?.guest?.connection?.close());
start();
