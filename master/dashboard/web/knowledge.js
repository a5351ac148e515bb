// Page of the knowledge repository: search for entries, read their texts and old versions, files and maps.

import { Api, Problem } from "./api.js";
import { attempt, bytes, h, show, table, time } from "./dom.js";
import { save, tellPicture } from "./forms.js";

const NAME = "knowledge-service";
const KINDS = ["recipe", "object", "environment"];
const PICTURE = /\.(png|jpe?g)$/i;
const pathOf = (entry) => `/entries/${entry.kind}/${encodeURIComponent(entry.uid)}`;

export function knowledgePage(main, app, kind, uid) {
  main.append(h("div.head", h("h1", "Knowledge"), kind && h("a", { href: "#/knowledge" }, "All entries")));
  let ended = false;
  connect(app).then((api) => {
    if (ended) return;
    if (kind) entryPage(main, api, { kind, uid: decodeURIComponent(uid) });
    else searchPage(main, api);
  }).catch((error) => main.append(h("p.error", { role: "alert" }, error.message)));
  return () => { ended = true; main.onclick = null; };
}

async function connect(app) {
  const found = (await app.api.list("/services")).find((each) => each.name === NAME);
  if (!found) throw new Problem(404, { detail: "No knowledge service has joined this platform." });
  return new Api(app.key, found.url);
}

function searchPage(main, api) {
  const list = h("div");
  const form = h("form.head",
    h("label.inline", "Words", h("input", { name: "text", type: "search" })),
    h("label.inline", "Kind", h("select", { name: "kind" }, h("option", { value: "" }, "all"), KINDS.map((each) => h("option", { value: each }, each)))),
    h("label.inline", "Class", h("input", { name: "class", placeholder: "or one above it" })),
    h("label.inline", "Uid begins with", h("input", { name: "prefix" })),
    h("button.main", { type: "submit" }, "Search"));
  const load = () => attempt(async () => {
    const page = await api.get("/entries", Object.fromEntries(new FormData(form)));
    show(list, table({
      Uid: (entry) => h("a", { href: `#/knowledge/${entry.kind}/${encodeURIComponent(entry.uid)}` }, entry.uid),
      Kind: (entry) => entry.kind,
      Description: (entry) => h("span.any", entry.description),
      Author: (entry) => entry.author,
      Changed: (entry) => time(entry.modified),
      "#Version": (entry) => entry.version,
      "#Rating": (entry) => entry.rating.toFixed(1),
      Readers: (entry) => (entry.public ? "everybody" : entry.shared.join(", ") || "the author"),
    }, page.items, "There are no such entries."), page.next && h("p.soft", "There are more: search for less."));
  });
  form.onsubmit = (event) => { event.preventDefault(); load(); };
  main.append(h("section.panel", form, list));
  load();
}

function entryPage(main, api, name) {
  const [head, text, files, versions] = [h("div"), h("pre.log", { tabindex: 0, "aria-label": "OWL text" }), h("div"), h("div")];
  const path = pathOf(name);
  const read = (version) => attempt(async () => {
    text.textContent = await (await api.file(`${path}/owl${version ? `?version=${version}` : ""}`)).text();
  });
  const actions = {
    read: (version) => read(version),
    fetch: (version, file) => attempt(async () => save(await api.file(`${path}/files/${file}?version=${version}`), file)),
    picture: (version, file) => showPicture(api, `${path}/files/${file}?version=${version}`, file),
  };
  main.onclick = (event) => {
    const button = event.target.closest("[data-do]");
    if (button) actions[button.dataset.do](button.dataset.of, button.dataset.name);
  };
  main.append(h("section.panel", head, files), h("section.panel", h("h2", "Text"), text), h("section.panel", h("h2", "History"), versions));
  attempt(async () => {
    const [entry, all] = await Promise.all([api.get(path), api.get(`${path}/versions`)]);
    show(head, h("h2", `${entry.kind} ${entry.uid}`), h("p.any", entry.description),
      h("p.soft", `by ${entry.author}, rated ${entry.rating.toFixed(1)}`, entry.location && `, at ${entry.location.latitude}°, ${entry.location.longitude}°`));
    show(files, entry.files.map((file) => fileButtons(entry.version, file)));
    show(versions, table({
      "#Version": (each) => each.number,
      Changed: (each) => time(each.time),
      By: (each) => each.author,
      Description: (each) => h("span.any", each.description),
      Files: (each) => each.files.map((file) => fileButtons(each.number, file)),
      " ": (each) => button("read", each.number, `Read version ${each.number}`),
    }, all, "There are no versions."));
    await read("");
  });
}

const button = (does, of, text, name = "") => h("button.small", { "data-do": does, "data-of": of, "data-name": name }, text);

const fileButtons = (version, file) => h("div.files", button("fetch", version, `${file.name} (${bytes(file.size)})`, file.name),
  PICTURE.test(file.name) && button("picture", version, `Show ${file.name}`, file.name));

const showPicture = (api, path, name) => tellPicture(name, () => api.file(path));
