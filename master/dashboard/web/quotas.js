// Limits of a user with their use, and the form that changes them, in the words and units of `rce user limits`.

import { bytes, h, table } from "./dom.js";
import { ask } from "./forms.js";

const size = { words: bytes, amount: true };
const speed = { words: (value) => `${bytes(value)}/s`, amount: true };
const GROUPS = [
  ["All together", { environments: ["Environments"], cores: ["Cores"], total_memory: ["Memory", size], total_bandwidth: ["Bandwidth", speed],
    robots: ["Robots"], connections: ["Connections"], package_bytes: ["Stored packages", size] }],
  ["On each machine", { recording_bytes: ["Recordings", size] }],
  ["Each environment, at most", { size: ["Slots"], cpu: ["Cores"], memory: ["Memory", size], pids: ["Processes"], disk: ["Disk", size],
    bandwidth: ["Bandwidth", speed], io: ["Disk traffic", speed], gpus: ["GPUs"] }],
  ["Each environment, unless it asks for more", { default_cpu: ["Cores"], default_memory: ["Memory", size], default_pids: ["Processes"],
    default_disk: ["Disk", size], default_bandwidth: ["Bandwidth", speed], default_io: ["Disk traffic", speed] }],
  ["Network and images", { egress: ["Network access"], images: ["Images"] }],
];
const TOTALS = Object.entries(GROUPS[0][1]);
const UNITS = [["Ti", 1024 ** 4], ["Gi", 1024 ** 3], ["Mi", 1024 ** 2], ["T", 1e12], ["G", 1e9], ["M", 1e6], ["Ki", 1024], ["k", 1e3]];

/** Return a limit as the console writes and reads it: `2Gi`, `-` for none, a list with commas. */
function text(value, options = {}) {
  if (value === null) return "-";
  if (Array.isArray(value)) return value.join(",");
  const unit = options.amount && value > 0 && UNITS.find(([, factor]) => Number.isInteger(value / factor));
  return unit ? `${value / unit[1]}${unit[0]}` : String(value);
}

/** Return a limit for reading. */
function shown(value, { words = String } = {}) {
  if (value === null || value.length === 0) return h("span.soft", "none");
  return typeof value === "number" ? words(value) : text(value).replaceAll(",", ", ");
}

/** Return the tables of all limits, and of the use of those that are counted. */
export function quotas(given, used) {
  return GROUPS.map(([title, limits], index) => [h("h3", title), table({
    Limit: ([, [label]]) => label,
    Name: ([key]) => h("span.mono", key),
    ...(index ? {} : { "#Used": ([key, [, options = {}]]) => (options.words ?? String)(used[key] ?? 0) }),
    "#At most": ([key, [, options]]) => shown(given[key], options),
    ...(index ? {} : { Share: ([key, [label]]) => (given[key] ? meter(used[key] ?? 0, given[key], label) : "") }),
  }, Object.entries(limits).filter(([key]) => key in given), "")]).flat();
}

/** Return the use of some limits in a few words each, for a list of users. */
export function summary(given, used, keys) {
  return TOTALS.filter(([key]) => keys.includes(key)).map(([key, [label, options = {}]]) => {
    const words = options.words ?? String;
    const most = given[key] === null ? "" : ` of ${words(given[key])}`;
    return h("div", `${label}: ${words(used[key] ?? 0)}${most}`, given[key] ? meter(used[key] ?? 0, given[key], label) : "");
  });
}

/** Open the form of all limits with their present values; what is not changed is not sent. */
export function changeQuotas(app, name, given, done) {
  const limits = GROUPS.flatMap(([, group]) => Object.entries(group)).filter(([key]) => key in given);
  const present = Object.fromEntries(limits.map(([key, [, options]]) => [key, text(given[key], options)]));
  const fields = GROUPS.flatMap(([title, group]) => [{ type: "heading", label: title }, ...limits.filter(([key]) => key in group)
    .map(([key, [label]]) => ({ name: key, label, help: key, value: present[key] }))]);
  ask(`Quotas of ${name}`, fields, async (wanted) => {
    const changed = limits.map(([key]) => [key, wanted[key] ?? ""]).filter(([key, value]) => value !== present[key]);
    if (changed.length) await app.api.patch(`/users/${name}/limits`, Object.fromEntries(changed));
    done();
  }, { button: "Change", text: "Numbers, or amounts as 2Gi and 500M (bytes; of rates, bytes a second). - is no limit; an empty field is "
    + "the platform's default." });
}

function meter(value, most, label) {
  const inner = h(value >= most ? "div.full" : "div");
  inner.style.width = `${Math.min(100, (100 * value) / most)}%`;
  return h("div.bar", { role: "meter", "aria-label": label, "aria-valuenow": value, "aria-valuemin": 0, "aria-valuemax": most }, inner);
}
