// Page of API keys: create, rotate and revoke; a secret is shown once.

import { withPassword } from "./api.js";
import { attempt, h, show, table, time } from "./dom.js";
import { ask, confirm, tell } from "./forms.js";
import { newPassword } from "./users.js";

export function keysPage(main, app) {
  const list = h("div");
  const keys = keysOf(app, list, {});
  main.append(h("div.head", h("h1", "Your API keys"), h("span.grow"),
    app.me.may("password.change") && h("button", { onclick: () => newPassword(app, app.me.user) }, "Change password"),
    app.me.may("key.create") && h("button.main", { onclick: keys.add }, "New key")),
  h("section.panel", h("p.soft", "Robots and programs sign in with a key. It is shown once, when it is made."), list));
  keys.load();
  return () => {};
}

// What is made with the key of this page would end with it.
const PASSWORD = { name: "password", label: "Your password", type: "password", required: true };

/** Show the keys of one user in `list`; `who` is the query that names the user. */
export function keysOf(app, list, who) {
  const { api, me } = app;
  const owner = who.user ?? me.user;
  const load = () => attempt(async () => {
    const keys = await api.list("/keys", who);
    show(list, table({
      Label: (key) => key.label || h("span.soft", "none"),
      Role: (key) => key.role,
      "Tied to": (key) => [key.scopes?.robot && `robot ${key.scopes.robot}`, ...(key.scopes?.environments ?? [])].filter(Boolean).join(", "),
      Made: (key) => time(key.created),
      Expires: (key) => (key.expires ? time(key.expires) : "never"),
      "Last used": (key) => time(key.used) || "not yet",
      " ": (key) => [
        key.id === me.key && h("span.soft", "this page's"),
        key.id !== me.key && me.may("key.rotate", owner) && h("button.small", { "data-do": "rotate", "data-of": key.id }, "Rotate"),
        me.may("key.revoke", owner) && h("button.small.danger", { "data-do": "revoke", "data-of": key.id,
          "aria-label": `Revoke ${key.label || key.id}` }, "Revoke"),
      ],
    }, keys, "There are no keys."));
  });
  const secret = (made, words) => tell(words, h("p", "Copy it now: it is not shown again."), h("code.secret", made.secret));
  list.onclick = (event) => {
    const button = event.target.closest("[data-do]");
    const id = button?.dataset.of;
    if (button?.dataset.do === "revoke") {
      confirm("Revoke this key?", "What uses it, or a key that was made with it, is cut off at once.", "Revoke", async () => { await api.remove(`/keys/${id}`, who); load(); });
    } else if (button) {
      ask("Rotate this key?", [PASSWORD], async ({ password }) => {
        secret(await withPassword(me.user, password)(`/keys/${id}/rotate`, undefined, who), "New secret");
      }, { button: "Rotate", text: "The old secret is void at once." });
    }
  };
  const add = () => ask("New key", [
    { name: "label", label: "Label", help: "what it is for" },
    { name: "role", label: "Role", options: ["robot", "viewer", "user", "operator", "admin"], value: "robot" },
    { name: "robot", label: "Only robotID", help: "optional, for the role robot" },
    { name: "environments", label: "Only environments", help: "optional, names with blanks between" },
    { name: "days", label: "Expires after", help: "days; empty: never", type: "number", min: 1 },
    PASSWORD,
  ], async ({ label, role, robot, environments, days, password }) => {
    const scopes = { ...(robot && { robot }), ...(environments && { environments: environments.split(/[\s,]+/) }) };
    const made = await withPassword(me.user, password)("/keys", { label: label ?? "", role, scopes, ...(days && { expires: Date.now() / 1000 + days * 86_400 }) }, who);
    secret(made, `Key ${label ?? ""} of ${owner}`);
    load();
  });
  return { load, add };
}
