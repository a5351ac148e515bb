// Page of recordings of topics: the recorders of environments, and the recordings that the platform keeps.

import { attempt, bytes, h, show, state, table, time } from "./dom.js";
import { ask, confirm, save } from "./forms.js";

const REFRESH = 3000; // milliseconds
const MEGABYTE = 1e6;

export function bagsPage(main, app) {
  const { api, me, live } = app;
  const [recorders, recordings, missing] = [h("div"), h("div"), h("p.bad", { role: "status" })];
  let [timer, ended] = [0, false];
  const named = (each) => `${each.machine}/${each.recording}`;
  const button = (does, of, user, text, label, kind = "") => h(`button.small${kind}`, { "data-do": does, "data-of": of, "data-user": user,
    "data-name": label, "aria-label": `${text} ${label}` }, text);
  const draw = () => show(recorders, table({
    Recorder: (each) => h("span.any", each.recorderTag),
    Environment: (each) => app.named(each.user, each.containerTag),
    State: (each) => state(each.state),
    Topics: (each) => each.topics.join(", ") || "all",
    "Next file after": (each) => [each.maxSize && bytes(each.maxSize), each.maxDuration && `${each.maxDuration} s`].filter(Boolean).join(" or "),
    " ": (each) => me.may("recorder.remove", each.user)
      && button("end", `${each.containerTag}/recorders/${each.recorderTag}`, each.user, "End", each.recorderTag, ".danger"),
  }, [...live.recorders.values()], "Nothing is being recorded."));
  const load = async () => {
    const { items, missing: away } = await api.get("/recordings", { limit: 1000, ...app.acting() });
    missing.textContent = away.length ? `Recordings on ${away.join(", ")} are missing here: these machines are away.` : "";
    show(recordings, table({
      File: (each) => h("span.any", each.name),
      Environment: (each) => each.containerTag || "uploaded",
      State: (each) => state(each.state),
      "#Size": (each) => bytes(each.size),
      Created: (each) => time(each.created),
      Machine: (each) => each.machine,
      " ": (each) => [button("fetch", named(each), each.user, "Download", each.name),
        me.may("recording.remove", each.user) && button("remove", named(each), each.user, "Remove", each.name, ".danger")],
    }, items.sort((one, other) => other.created - one.created), "No recordings are kept."));
  };
  const actions = {
    end: (of, user) => attempt(() => api.remove(`/environments/${of}`, app.acting(user)), "The recording is complete"),
    fetch: (of, user, name) => attempt(() => download(api, `/recordings/${of}/file`, app.acting(user), name)),
    remove: (of, user, name) => confirm(`Remove ${name}?`, "A recorder that still writes it ends.", "Remove",
      async () => { await api.remove(`/recordings/${of}`, app.acting(user)); await load(); }),
  };
  main.onclick = (event) => {
    const found = event.target.closest("[data-do]");
    if (found) actions[found.dataset.do](found.dataset.of, found.dataset.user, found.dataset.name);
  };
  const repeat = async () => {
    if (ended) return;
    if (!document.hidden) await load().catch((error) => show(recordings, h("p.error", error.message)));
    timer = setTimeout(repeat, REFRESH);
  };
  main.append(h("div.head", h("h1", "Recordings of topics"), h("span.grow"),
    me.may("recorder.create") && h("button.main", { onclick: () => add(app) }, "Record")),
  h("section.panel", h("h2", "Recorders"), recorders), h("section.panel", h("h2", "Recordings"), missing, recordings));
  const stop = live.on(draw);
  draw();
  repeat();
  return () => { ended = true; clearTimeout(timer); stop(); main.onclick = null; };
}

/** Ask what to record, and start a recorder. */
function add(app) {
  const places = [...app.live.environments.values()].filter((each) => app.me.may("recorder.create", each.user));
  const tags = new Map(places.map((each) => [app.named(each.user, each.containerTag), each]));
  ask("Record topics", [
    { name: "place", label: "Environment", options: [...tags.keys()].sort(), required: true },
    { name: "recorderTag", label: "Name", required: true },
    { name: "topics", label: "Topics", help: "with commas between; all unless some are named" },
    { name: "size", label: "Next file after", help: "MB", type: "number", min: 1 },
    { name: "maxDuration", label: "Next file after", help: "seconds", type: "number", min: 1 },
  ], ({ place, recorderTag, topics = "", size = 0, maxDuration = 0 }) => {
    if (!tags.has(place)) throw new Error("There is no environment to record in: create one first.");
    const { user, containerTag } = tags.get(place);
    return app.api.post(`/environments/${containerTag}/recorders`, {
      recorderTag, topics: topics.split(/[\s,]+/).filter(Boolean), maxSize: size * MEGABYTE, maxDuration,
    }, app.acting(user));
  }, { button: "Record" });
}

/** Store a file: where the browser can, straight to the disk, so that a large one does not fill the memory. */
async function download(api, path, query, name) {
  if (!window.showSaveFilePicker) return save(await api.file(path, query), name);
  const handle = await window.showSaveFilePicker({ suggestedName: name });
  return (await api.stream(path, query)).pipeTo(await handle.createWritable());
}
