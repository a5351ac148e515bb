// Page of recordings and of the map service's jobs: submit by drag and drop, progress, and results.

import { attempt, bytes, h, notice, show, state, table, time } from "./dom.js";
import { dropArea } from "./dropped.js";
import { confirm, save, tell, tellPicture } from "./forms.js";
import { mapService } from "./mapservice.js";
import { readPly } from "./ply.js";
import { OWN, Space } from "./space.js";

const REFRESH = 2000; // milliseconds
const OVER = new Set(["done", "failed", "cancelled"]);
const CLOUD = "cloud.ply";
const FILES = ".bag,.mcap,.db3,.clf,.log,.gz,.yaml";

export function jobsPage(main, app) {
  const [jobs, uploads, sending] = [h("div"), h("div"), h("div")];
  const options = h("form.head", { onsubmit: (event) => event.preventDefault() },
    h("label.inline", "Map of", h("select", { name: "kind" }, h("option", { value: "2d" }, "laser scans"), h("option", { value: "3d" }, "cameras or lidars in 3D"))),
    h("label.inline", "Mapper", h("select", { name: "mapper" }, ["graph", "particle"].map((each) => h("option", { value: each }, each)))),
    h("label.inline", "Metres a cell", h("input", { name: "resolution", type: "number", min: 0.01, max: 0.5, step: 0.01, value: 0.05 })),
    h("label.inline", "Longest beam, metres", h("input", { name: "max_range", type: "number", min: 1, max: 200, value: 30 })),
    h("label.inline", "Workers", h("input", { name: "parallel", type: "number", min: 1, max: 16, value: 1, title: "With two or more, single files that are dropped together become one map where they overlap" })),
    h("label.inline", "Scan topic", h("input", { name: "scan_topic", size: 10, placeholder: "the only one" })),
    h("label.inline", "Odometry topic", h("input", { name: "odometry_topic", size: 10, placeholder: "the only one" })));
  main.append(h("div.head", h("h1", "Recordings and maps")));
  let [service, timer, ended] = [null, 0, false];
  const wanted = () => Object.fromEntries([...new FormData(options)].map(([name, value]) =>
    [name, ["resolution", "max_range", "parallel"].includes(name) ? Number(value) : value]));
  const load = async () => {
    if (document.hidden) return;
    const [all, files] = await Promise.all([service.jobs(), service.uploads()]);
    show(jobs, jobTable(all));
    show(uploads, uploadTable(files, all));
  };
  const submit = (files) => attempt(async () => {
    for (const [name, group] of submissions(recordings(files), wanted().parallel)) {
      const ids = [];
      for (const file of group) {
        const line = h("p", `${file.name}: `, h("progress", { max: 1, value: 0, "aria-label": `Upload of ${file.name}` }));
        sending.append(line);
        try {
          ids.push(await service.upload(file, (share) => { line.lastChild.value = share; }));
        } finally {
          line.remove();
        }
      }
      await service.submit(ids, wanted(), name);
      notice(`Submitted ${name}`);
      await load();
    }
  });
  const actions = {
    map: (id) => showMap(service, id),
    cloud: (id) => showCloud(service, id),
    fetch: (id, name) => attempt(async () => save(await service.file(id, name), name)),
    cancel: (id) => attempt(() => service.cancel(id).then(load)),
    remove: (id) => confirm("Remove this job?", "With its map and all other files.", "Remove", () => service.removeJob(id).then(load)),
    again: (id, name) => attempt(() => service.submit([id], wanted(), name).then(load)),
    drop: (id, name) => confirm(`Remove ${name}?`, "Maps that were made of it stay.", "Remove", () => service.removeUpload(id).then(load)),
  };
  main.onclick = (event) => {
    const button = event.target.closest("[data-do]");
    if (button) actions[button.dataset.do](button.dataset.of, button.dataset.name);
  };
  const repeat = async () => {
    if (ended) return;
    await load().catch((error) => show(jobs, h("p.error", error.message)));
    timer = setTimeout(repeat, REFRESH);
  };
  mapService(app).then((found) => {
    service = found;
    if (app.me.may("job.submit")) {
      main.append(h("section.panel", dropArea("Drop recordings here: CARMEN logs, ROS 1 bags, or the directory of a ROS 2 bag.",
        "Choose recordings", submit, { accept: FILES }), h("details", h("summary", "Options"), options), sending));
    }
    main.append(h("section.panel", h("h2", "Jobs"), jobs), h("section.panel", h("h2", "Recordings"), uploads));
    return repeat();
  }).catch((error) => main.append(h("p.error", { role: "alert" }, error.message)));
  return () => { ended = true; clearTimeout(timer); main.onclick = null; };
}

/** Return the recordings among dropped files: a directory is one, and each single file. */
function recordings(files) {
  const found = new Map();
  for (const { path, file } of files) {
    const name = path.split("/")[0];
    found.set(name, [...(found.get(name) ?? []), file]);
  }
  return found;
}

/** Return the files of each job by its name: with several workers, recordings of one file each share a job. */
function submissions(found, parallel) {
  const groups = [...found.values()];
  if (parallel < 2 || groups.length < 2 || groups.some((group) => group.length > 1)) return found;
  return new Map([[`${groups.length} recordings`, groups.flat()]]);
}

const button = (does, of, text, name = "", kind = "") => h(`button.small${kind}`, { "data-do": does, "data-of": of, "data-name": name }, text);

function jobTable(all) {
  return table({
    Recording: (job) => h("span.any", job.recording),
    Submitted: (job) => time(job.created),
    State: (job) => [state(job.state), job.error && h("div.bad", job.error.message ?? job.error.detail ?? job.error.code)],
    Progress: (job) => progress(job),
    Result: (job) => h("div.files", job.files.map((file) => button("fetch", job.id, `${file.name} (${bytes(file.size)})`, file.name))),
    " ": (job) => [job.files.some((file) => file.name === "map.png") && button("map", job.id, "Show map"),
      job.files.some((file) => file.name === CLOUD) && button("cloud", job.id, "Show cloud"),
      OVER.has(job.state) ? button("remove", job.id, "Remove", "", ".danger") : button("cancel", job.id, "Cancel", "", ".danger")],
  }, all, "No maps were made yet.");
}

function progress(job) {
  if (OVER.has(job.state)) return `${job.scans} scans`;
  if (job.total) return h("span", h("progress", { max: job.total, value: job.scans, "aria-label": "scans" }), ` ${job.scans} of ${job.total} scans`);
  return job.ahead ? `after ${job.ahead} others` : job.stage;
}

function uploadTable(files, jobs) {
  const used = new Set(jobs.filter((job) => !OVER.has(job.state)).flatMap((job) => job.uploads));
  return table({
    Name: (file) => h("span.any", file.name),
    "#Size": (file) => bytes(file.length),
    State: (file) => (file.offset < file.length ? `${Math.floor((100 * file.offset) / file.length)} % uploaded` : "complete"),
    "Kept until": (file) => time(file.expires),
    " ": (file) => [file.offset === file.length && button("again", file.id, "Map again", file.name),
      !used.has(file.id) && button("drop", file.id, "Remove", file.name, ".danger")],
  }, files, "No recordings are stored.");
}

const showMap = (service, id) => tellPicture("Map", () => service.file(id, "map.png"));

/** Show the cloud of a map in space; it is turned by dragging. */
function showCloud(service, id) {
  const status = h("p.soft", { role: "status" }, "Loading the cloud …");
  let space;
  try {
    space = new Space();
  } catch (error) {
    tell("Cloud", h("p.error", error.message));
    return;
  }
  tell("Cloud", status, space.element).addEventListener("close", () => space.stop());
  attempt(async () => {
    const { points, matrix } = readPly(await (await service.file(id, CLOUD)).arrayBuffer());
    space.set("cloud", points, { matrix, colour: OWN });
    const { middle, extent } = bounds(points, matrix);
    space.look(...middle, 1.2 * extent);
    status.textContent = `${points.length / 4} points. Drag to turn, with Shift to move; the wheel scales.`;
  });
}

/** Return the middle and the extent of points that a matrix moves, metres. */
function bounds(points, m) {
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  for (let at = 0; at < points.length; at += 4) {
    for (let axis = 0; axis < 3; axis += 1) {
      const value = m[axis] * points[at] + m[4 + axis] * points[at + 1] + m[8 + axis] * points[at + 2] + m[12 + axis];
      [low[axis], high[axis]] = [Math.min(low[axis], value), Math.max(high[axis], value)];
    }
  }
  const sides = high.map((each, axis) => Math.max(0, each - low[axis]));
  return { middle: points.length ? low.map((each, axis) => each + sides[axis] / 2) : [0, 0, 0], extent: Math.max(1, ...sides) };
}
