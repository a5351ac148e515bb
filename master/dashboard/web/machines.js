// Page of the platform's machines and their usage.

import { bytes, h, show, state, table } from "./dom.js";
import { ask, confirm, tell } from "./forms.js";

export function machinesPage(main, app) {
  const list = h("div");
  main.append(h("div.head", h("h1", "Machines"), h("span.grow"),
    app.me.may("machine.invite", "") && h("button.main", { onclick: () => invite(app) }, "Invite machine")), h("section.panel", list));
  const draw = () => show(list, table({
    Name: (each) => each.name,
    State: (each) => state(each.state),
    "What it does": (each) => ({ container: "environments", robot: "robots", service: "service" })[each.role] ?? each.role,
    Capacity: (each) => (each.role === "container" ? slots(each) : ""),
    "#Environments": (each) => (each.role === "container" ? String(each.environments) : ""),
    "#Robots": (each) => (each.role === "robot" ? String(each.robots) : ""),
    "#Cores": (each) => each.usage?.cores.toFixed(2) ?? "",
    "#Memory": (each) => (each.usage ? bytes(each.usage.memory) : ""),
    Features: (each) => [...each.features, each.gpus && `${each.gpusUsed} of ${each.gpus} GPUs`].filter(Boolean).join(", "),
    Address: (each) => each.url && h("span.mono", each.url),
    " ": (each) => app.me.may("machine.remove", "") && h("button.small.danger", { "data-of": each.name, "aria-label": `Remove ${each.name}` }, "Remove"),
  }, [...app.live.machines.values()].sort((a, b) => a.role.localeCompare(b.role) || a.name.localeCompare(b.name)), "No machine has joined."));
  list.onclick = (event) => {
    const name = event.target.closest("[data-of]")?.dataset.of;
    if (name) confirm(`Remove ${name}?`, "It is disconnected for good, with its environments; it joins again only with a new code.", "Remove machine", () => app.api.remove(`/machines/${name}`));
  };
  draw();
  return app.live.on(draw);
}

function slots({ used, slots: all }) {
  const share = all ? (100 * used) / all : 0;
  const inner = h(share >= 100 ? "div.full" : "div");
  inner.style.width = `${share}%`;
  return h("div", `${used} of ${all} slots`, h("div.bar", { role: "meter", "aria-valuenow": used, "aria-valuemin": 0, "aria-valuemax": all,
    "aria-label": "slots in use" }, inner));
}

function invite(app) {
  ask("Invite a machine", [
    { name: "name", label: "Name", required: true, pattern: "[A-Za-z0-9]+(-[A-Za-z0-9]+)*" },
    { name: "address", label: "Address", help: "by which others reach it; empty: where it comes from" },
    { name: "hours", label: "Good for", help: "hours", type: "number", min: 1, value: 24 },
  ], async (wanted) => {
    const made = await app.api.post("/machines/invitations", wanted);
    tell(`Join code of ${made.name}`, h("p", "It is shown this once, and good for one machine."), h("code.secret", made.code));
  }, { button: "Invite" });
}

