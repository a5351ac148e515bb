// Pages of users for administrators: roles, passwords, quotas with their usage, and keys.

import { attempt, h, notice, show, table, time } from "./dom.js";
import { ask, confirm } from "./forms.js";
import { keysOf } from "./keys.js";
import { changeQuotas, quotas, summary } from "./quotas.js";

const ROLES = ["user", "viewer", "operator", "admin"];
const SHOWN = ["environments", "cores", "total_memory"]; // uses in the list of users
const MAX_USES = 50; // users whose use is in the list
const PASSWORD = { type: "password", required: true };

export function usersPage(main, app) {
  const list = h("div");
  const { api } = app;
  const load = () => attempt(async () => {
    const users = await api.list("/users");
    const read = (each) => Promise.all(["limits", "usage"].map((what) => api.get(`/users/${each.name}/${what}`)));
    const known = new Map();
    const draw = () => show(list, table({
      Name: (each) => h("a", { href: `#/users/${each.name}` }, each.name),
      Role: (each) => each.role,
      Use: (each) => known.has(each.name) && h("div.uses", summary(...known.get(each.name), SHOWN)),
      Created: (each) => time(each.created),
    }, users, "There are no users."));
    draw();
    for (const each of users.slice(0, MAX_USES)) {
      known.set(each.name, await read(each));
      draw();
    }
  });
  const add = () => ask("New user", [
    { name: "name", label: "Name", required: true, pattern: "[A-Za-z][A-Za-z0-9_]*", title: "a letter, then letters, digits or _" },
    { name: "role", label: "Role", options: ROLES, value: "user" },
    { name: "password", label: "Password", ...PASSWORD },
  ], async (wanted) => { await api.post("/users", wanted); load(); });
  main.append(h("div.head", h("h1", "Users"), h("span.grow"), h("button.main", { onclick: add }, "New user")), h("section.panel", list));
  load();
  return () => {};
}

export function userPage(main, app, name) {
  const { api, me } = app;
  const [about, limits, keys] = [h("div"), h("div"), h("div")];
  const list = keysOf(app, keys, name === me.user ? {} : { user: name });
  const path = `/users/${name}`;
  const load = () => attempt(async () => {
    const user = await api.get(path);
    show(about, h("div.head", h("h1", user.name), h("span.soft", user.role)));
    const [given, used] = [await api.get(`${path}/limits`), await api.get(`${path}/usage`)];
    show(limits, ...quotas(given, used));
  });
  const change = {
    role: () => ask(`Role of ${name}`, [{ name: "role", label: "Role", options: ROLES }],
      async (wanted) => { await api.patch(path, wanted); load(); }, { button: "Change" }),
    password: () => newPassword(app, name),
    limits: () => attempt(async () => changeQuotas(app, name, await api.get(`${path}/limits`), load)),
    remove: () => confirm(`Remove ${name}?`, "With all robots, environments, keys and packages of theirs.", "Remove user",
      async () => { await api.remove(path); app.go("/users"); }),
  };
  const button = (does, text, kind = "") => h(`button${kind}`, { onclick: change[does] }, text);
  main.append(h("div.head", about, h("span.grow"), me.may("user.change", name) && button("role", "Change role"),
    me.may("password.change", name) && button("password", "Change password"),
    me.may("user.remove", name) && name !== me.user && button("remove", "Remove user", ".danger")),
  h("section.panel", h("div.head", h("h2", "Quotas"), h("span.grow"), me.may("limits.change", name) && button("limits", "Change quotas")), limits),
  h("section.panel", h("div.head", h("h2", "API keys"), h("span.grow"),
    me.may("key.create", name) && h("button", { onclick: list.add }, "New key")), keys));
  load();
  list.load();
  return () => {};
}

/** Open the dialog for a new password; changing one's own needs the old one. */
export function newPassword(app, name) {
  const old = name === app.me.user ? [{ name: "old", label: "Old password", ...PASSWORD }] : [];
  ask(`Password of ${name}`, [...old, { name: "new", label: "New password", ...PASSWORD }], async (wanted) => {
    await app.api.put(`/users/${name}/password`, wanted);
    notice("The password is changed");
  }, { button: "Change" });
}
