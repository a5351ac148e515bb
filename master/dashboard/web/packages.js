// Page of a user's ROS packages: pushed by drag and drop, their versions, and with whom they are shared.

import { attempt, bytes, h, notice, show, table, time } from "./dom.js";
import { dropArea } from "./dropped.js";
import { ask, confirm } from "./forms.js";
import { packageFiles } from "./packagefiles.js";
import { archive } from "./tar.js";

const DIGITS = 12; // shown of a version

export function packagesPage(main, app) {
  const { api, me } = app;
  const list = h("div");
  let packages = [];
  const load = () => attempt(async () => {
    packages = await api.list("/packages");
    show(list, ...(packages.length ? packages.map(panel) : [h("p.empty", "There are no packages yet.")]));
  });
  const panel = (each) => {
    const owned = each.name.startsWith(`${me.user}/`);
    const shared = each.shared.includes("*") ? "everybody" : each.shared.join(", ");
    const button = (does, text, kind = "", of = "") => h(`button.small${kind}`, { "data-do": does, "data-name": each.name, "data-of": of,
      "aria-label": `${text} ${each.name} ${of.slice(0, DIGITS)}` }, text);
    return h("section.panel", h("div.head", h("h2", each.name), owned && h("span.soft", shared ? `shared with ${shared}` : "not shared"),
      h("span.grow"), owned && me.may("package.share") && button("share", "Share"),
      owned && shared && me.may("package.share") && button("unshare", "Stop sharing"),
      owned && me.may("package.remove") && button("remove", "Remove", ".danger")),
    table({
      Version: (version) => h("span.mono", version.digest.slice(0, DIGITS)),
      Pushed: (version) => time(version.created),
      "#Size": (version) => bytes(version.size),
      "ROS packages": (version) => version.packages.join(", "),
      " ": (version) => owned && me.may("package.remove") && button("remove", "Remove version", "", version.digest),
    }, [...each.versions].reverse(), "It has no versions."));
  };
  const actions = {
    share: (own) => ask(`Share ${own}`, [{ name: "users", label: "With", help: "names of users with commas between, or * for everybody", required: true }],
      async ({ users }) => { await api.post(`/packages/${own}/shares`, { users: users.split(/[\s,]+/).filter(Boolean) }); load(); }, { button: "Share" }),
    unshare: (own) => attempt(async () => { await api.remove(`/packages/${own}/shares`); load(); }, `${own} is not shared any more`),
    remove: (own, version) => confirm(`Remove ${version ? `version ${version.slice(0, DIGITS)} of ` : ""}${own}?`,
      "Environments that use it keep it.", "Remove",
      async () => { await api.remove(version ? `/packages/${own}/versions/${version}` : `/packages/${own}`); load(); }),
  };
  list.onclick = (event) => {
    const button = event.target.closest("[data-do]");
    if (button) actions[button.dataset.do](button.dataset.name.split("/")[1], button.dataset.of);
  };
  main.append(h("div.head", h("h1", "Packages")));
  if (me.may("package.push")) {
    main.append(h("section.panel", dropArea("Drop the directory of a ROS package here, of several packages, or an install space.",
      "Choose a directory", async (files) => { await push(api, files); load(); }, { directory: true })));
  }
  main.append(list);
  load();
  return () => {};
}

async function push(api, given) {
  const { name, files } = await packageFiles(given);
  const content = archive(files);
  if (!crypto.subtle) throw new Error("Browsers upload packages only where the dashboard is at https or on this machine.");
  const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", content));
  const digest = Array.from(hash, (each) => each.toString(16).padStart(2, "0")).join("");
  const { upload, token } = await api.post("/packages", { name, digest, size: content.length });
  if (upload) await api.upload(upload, token, content);
  notice(`Pushed ${name}: ${files.length} files, ${bytes(content.length)}`);
}
