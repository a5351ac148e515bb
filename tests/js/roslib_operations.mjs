// Every operation of rosbridge by the npm package roslib, against `rce gateway`: node roslib_operations.mjs URL NODE_MODULES
import { pathToFileURL } from "node:url";

const [url, modules] = process.argv.slice(2);
const ROSLIB = await import(pathToFileURL(`${modules}/roslib/dist/RosLib.js`).href);
const ros = new ROSLIB.Ros();
const wait = (ms) => new Promise((r) => setTimeout(r, ms));
const within = (p, what, ms = 60000) => Promise.race([p, new Promise((_, j) => setTimeout(() => j(new Error("timeout: " + what)), ms))]);
await within(new Promise((r, j) => { ros.on("connection", r); ros.on("error", j); ros.connect(url); }), "connect");
const results = {};
const check = (name, ok, info = "") => { results[name] = ok; console.log(ok ? "ok  " : "FAIL", name, ok ? "" : JSON.stringify(info)); };
const attempt = async (name, f) => { try { check(name, true, await f()); } catch (e) { check(name, false, String(e && e.stack || e)); } };
const assert = (c, m) => { if (!c) throw new Error(m); };
const once = (f) => { let done = false; return () => { if (!done) { done = true; f(); } }; };
const cb = (f) => new Promise((r, j) => f(r, j));
ros.setStatusLevel && ros.setStatusLevel("info", "s");
ros.on("status", (s) => console.log("status", JSON.stringify(s)));
for (const compression of ["none", "png", "cbor"]) {
  await attempt("topic " + compression, async () => {
    const name = "/js_" + compression;
    const t = new ROSLIB.Topic({ ros, name, messageType: "sensor_msgs/msg/LaserScan", compression });
    const got = within(new Promise((r) => t.subscribe(r)), name);
    const p = new ROSLIB.Topic({ ros, name, messageType: "sensor_msgs/LaserScan" });
    const repeat = setInterval(() => p.publish({ header: { frame_id: "laser" }, ranges: [1, 2.5, null] }), 200);
    const m = await got.finally(() => clearInterval(repeat));
    assert(m.header.frame_id === "laser", JSON.stringify(m));
    assert(m.header.stamp.sec > 1e9, "stamp");
    assert(Math.abs(m.ranges[1] - 2.5) < 1e-6 && m.ranges.length === 3, JSON.stringify(m.ranges));
    t.unsubscribe(); p.unadvertise();
  });
}
await attempt("throttle", async () => {
  const p = new ROSLIB.Topic({ ros, name: "/js_fast", messageType: "std_msgs/String" });
  const t = new ROSLIB.Topic({ ros, name: "/js_fast", messageType: "std_msgs/String", throttle_rate: 500, queue_length: 1 });
  let n = 0; t.subscribe(() => n++);
  const begin = Date.now();
  for (let i = 0; (i < 40 || n < 4) && i < 2400; i++) { p.publish({ data: "x" + i }); await wait(25); }
  const most = (Date.now() - begin) / 500 + 2;
  assert(n >= 4 && n <= most, `n=${n}, not 4 to ${most}`); t.unsubscribe();
});
await attempt("service both ways", async () => {
  const s = new ROSLIB.Service({ ros, name: "/js_bool", serviceType: "std_srvs/SetBool" });
  s.advertise((req, res) => { res.success = req.data; res.message = "got"; return true; });
  const c = new ROSLIB.Service({ ros, name: "/js_bool", serviceType: "std_srvs/SetBool" });
  const r = await within(cb((r, j) => c.callService({ data: true }, r, j)), "call");
  assert(r.success === true && r.message === "got", JSON.stringify(r)); s.unadvertise();
});
await attempt("operations take effect in the order in which they are sent", async () => {
  const t = new ROSLIB.Topic({ ros, name: "/js_order", messageType: "std_msgs/String" });
  const topics = async () => (await within(cb((r, j) => ros.getTopics(r, j)), "topics")).topics;
  t.advertise();
  assert((await topics()).includes("/js_order"), "advertised, and not there");
  t.unadvertise();
  assert(!(await topics()).includes("/js_order"), "unadvertised, and there");
  const s = new ROSLIB.Service({ ros, name: "/js_again", serviceType: "std_srvs/Trigger" });
  for (const message of ["first", "second", "third"]) {
    await s.advertise((_, res) => { res.success = true; res.message = message; return true; });
    const c = new ROSLIB.Service({ ros, name: "/js_again", serviceType: "std_srvs/Trigger" });
    const r = await within(cb((r, j) => c.callService({}, r, j)), message);
    assert(r.message === message, JSON.stringify(r));
    await s.unadvertise();
  }
});
await attempt("service that fails or does not answer", async () => {
  // A service of ROS 2 cannot answer with an error, so the caller waits for its timeout.
  const s = new ROSLIB.Service({ ros, name: "/js_fail", serviceType: "std_srvs/Trigger" });
  s.advertise(() => false);
  const c = new ROSLIB.Service({ ros, name: "/js_fail", serviceType: "std_srvs/Trigger" });
  let failed;
  try { await within(cb((r, j) => c.callService({}, r, j, 2)), "call"); } catch (e) { failed = String(e); }
  assert(failed && failed.includes("Timeout exceeded"), "no error: " + failed);
  s.unadvertise();
});
await attempt("unknown service fails", async () => {
  const c = new ROSLIB.Service({ ros, name: "/nope", serviceType: "std_srvs/Trigger" });
  let failed; try { await within(cb((r, j) => c.callService({}, r, j)), "call"); } catch (e) { failed = String(e); }
  assert(failed && failed.includes("does not exist"), failed);
});
await attempt("action goal", async () => {
  const a = new ROSLIB.Action({ ros, name: "/fibonacci", actionType: "example_interfaces/action/Fibonacci" });
  let feedback = 0;
  const r = await within(cb((r, j) => a.sendGoal({ order: 4 }, r, () => feedback++, j)), "goal");
  assert(r.sequence.length === 5 && feedback >= 2, JSON.stringify(r) + feedback);
});
await attempt("action cancel", async () => {
  const a = new ROSLIB.Action({ ros, name: "/fibonacci", actionType: "example_interfaces/Fibonacci" });
  const ended = within(new Promise((r) => { const id = a.sendGoal({ order: 30 }, (x) => r(["result", x]), once(() => a.cancelGoal(id)), (e) => r(["failed", String(e)])); }), "cancel");
  const e = await ended; assert(String(e[1]).includes("canceled"), JSON.stringify(e));
});
await attempt("cancelAllGoals", async () => {
  const a = new ROSLIB.Action({ ros, name: "/fibonacci", actionType: "example_interfaces/Fibonacci" });
  if (!a.cancelAllGoals) return;
  const ended = within(new Promise((r) => { a.sendGoal({ order: 30 }, (x) => r(["result", x]), once(() => a.cancelAllGoals()), (e) => r(["failed", String(e)])); }), "cancelAll");
  const e = await ended; assert(String(e[1]).includes("canceled"), JSON.stringify(e));
});
await attempt("action server", async () => {
  const server = new ROSLIB.Action({ ros, name: "/js_fib", actionType: "example_interfaces/Fibonacci" });
  const cancels = [];
  server.advertise((goal, id) => {
    server.sendFeedback(id, { sequence: [0] });
    if (goal.order < 100) { setTimeout(() => server.setSucceeded(id, { sequence: [0, goal.order] }), 200); }
  }, (id) => { cancels.push(id); server.setCanceled(id, { sequence: [9] }); });
  const a = new ROSLIB.Action({ ros, name: "/js_fib", actionType: "example_interfaces/Fibonacci" });
  const seen = [];
  const r = await within(cb((r, j) => a.sendGoal({ order: 7 }, r, (f) => seen.push(f), j)), "goal");
  assert(r.sequence[1] === 7 && seen.length === 1, JSON.stringify([r, seen]));
  const c = await within(new Promise((r) => { const id = a.sendGoal({ order: 200 }, (x) => r(["result", x]), once(() => a.cancelGoal(id)), (e) => r(["failed", String(e)])); }), "cancel at server");
  assert(cancels.length === 1, "cancel not seen"); assert(String(c[1]).includes("canceled"), JSON.stringify(c));
  server.unadvertise();
});
const calls = ["getTopics","getActionServers","getServices","getNodes","getParams"];
for (const f of calls) await attempt(f, async () => { const r = await within(cb((r, j) => ros[f](r, j)), f); assert(r, "nothing"); });
await attempt("getTopicsAndRawTypes", async () => { const r = await within(cb((r, j) => ros.getTopicsAndRawTypes(r, j)), "raw"); assert(r.typedefs_full_text.length === r.topics.length && r.typedefs_full_text.some((t) => t.includes("=====")), JSON.stringify(r).slice(0, 300)); });
await attempt("getTopicType", async () => { const r = await within(cb((r, j) => ros.getTopicType("/rosout", r, j)), "x"); assert(r === "rcl_interfaces/msg/Log", r); });
await attempt("getServiceType", async () => { const r = await within(cb((r, j) => ros.getServiceType("/example_fibonacci/get_parameters", r, j)), "x"); assert(r.includes("GetParameters"), r); });
await attempt("getTopicsForType", async () => { const r = await within(cb((r, j) => ros.getTopicsForType("rcl_interfaces/msg/Log", r, j)), "x"); assert(r.includes("/rosout"), r); });
await attempt("getServicesForType", async () => { const r = await within(cb((r, j) => ros.getServicesForType("rcl_interfaces/srv/GetParameters", r, j)), "x"); assert(r.length, r); });
await attempt("getNodeDetails", async () => { const r = await within(cb((r, j) => ros.getNodeDetails("/example_fibonacci", r, j)), "x"); const d = r; assert(d.publishing.includes("/rosout"), JSON.stringify(d)); });
await attempt("getMessageDetails", async () => { const r = await within(cb((r, j) => ros.getMessageDetails("geometry_msgs/TwistStamped", r, j)), "x"); assert(r.length >= 4, JSON.stringify(r)); const d = ros.decodeTypeDefs(r); assert(JSON.stringify(d).includes("twist"), JSON.stringify(d)); });
await attempt("getServiceRequestDetails", async () => { const r = await within(cb((r, j) => ros.getServiceRequestDetails("std_srvs/SetBool", r, j)), "x"); assert(r.typedefs[0].fieldnames[0] === "data", JSON.stringify(r)); });
await attempt("param", async () => {
  const p = new ROSLIB.Param({ ros, name: "/example_fibonacci:use_sim_time" });
  const v = await within(cb((r, j) => p.get(r, j)), "get"); assert(v === false, String(v));
  p.set(true);
  const w = await within(cb((r, j) => p.get(r, j)), "get"); assert(w === true, String(w));
  await within(cb((r, j) => p.set(false, r, j)), "set");
});
ros.close();
const bad = Object.entries(results).filter(([, ok]) => !ok).map(([n]) => n);
console.log(bad.length ? "failed: " + bad.join(", ") : "all ok");
process.exit(bad.length ? 1 : 0);
