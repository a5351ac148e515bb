// Contract tests of the JavaScript client at a real platform, for Node and for pages. `run(rce, options)` returns the
// names of the passed tests, or throws the first failure. `tag` makes the names of robots unique to a run, `skip` has
// the names of tests to leave out.

export async function run(rce, { url, user, password, WebSocket, tag, skip = [] }) {
  const passed = [];
  const robot = (name, more = {}) => new rce.Robot(url, {
    user, password, robot: `${tag}${name}`, timeout: 60, ...(WebSocket ? { WebSocket } : {}), ...more });
  for (const [name, test] of Object.entries(tests)) {
    if (skip.includes(name)) continue;
    const open = [];
    const make = async (letter, more) => {
      const made = robot(`${name.replace(/\W/g, "_")}_${letter}`, more);
      open.push(made);
      await made.open();
      return made;
    };
    try {
      await test(make, rce, tag, WebSocket ?? globalThis.WebSocket);
    } catch (error) {
      throw new Error(`${name}: ${error.stack}`);
    } finally {
      await Promise.all(open.map((each) => each.close()));
    }
    passed.push(name);
  }
  return passed;
}

const FIBONACCI = "example_interfaces/Fibonacci";
const [STRING, POSE, INT64, SET_BOOL] = ["std_msgs/String", "geometry_msgs/Pose2D", "std_msgs/Int64", "std_srvs/SetBool"];

function equal(got, wanted) {
  const text = (value) => JSON.stringify(value, (_, item) =>
    typeof item === "bigint" || Number.isNaN(item) || Math.abs(item) === Infinity ? `${typeof item} ${item}` : item);
  if (text(got) !== text(wanted)) throw new Error(`got ${text(got)?.slice(0, 300)}, not ${text(wanted)?.slice(0, 300)}`);
}

async function throws(kind, promise, words = "") {
  const error = await promise.then(() => null, (reason) => reason);
  if (!(error instanceof kind) || !error.message.includes(words)) {
    throw new Error(`got ${error?.stack}, not ${kind.name} ${words}`);
  }
  return error;
}

async function pair(make, type, options = {}) {
  const [a, b] = await Promise.all([make("a"), make("b")]);
  const subscriber = await b.subscriber("in", type, options);
  const publisher = await a.publisher("out", type, { ...options, to: `${b.name}/in` });
  return { a, b, subscriber, publisher };
}

async function event(events, topic) {
  for (;;) {
    const each = await events.get(60);
    if (each.topic === topic) return each;
  }
}

const breakSocket = (robot, code = 4000) => robot.connection.close(code, "broken by the test");

const tests = {
  async "message is delivered"(make) {
    const { publisher, subscriber } = await pair(make, POSE);
    await publisher.publish({ x: 1.5, y: -2, theta: 0.5 });
    equal(await subscriber.get(60), { x: 1.5, y: -2, theta: 0.5 });
    equal(subscriber.connected, true);
  },

  async "callback gets each message once in order"(make) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    const received = [];
    let finish = null;
    const done = new Promise((resolve) => { finish = resolve; });
    const callback = ({ data }) => {
      received.push(Number(data));
      if (data === "99") finish();
    };
    await b.subscriber("in", STRING, { depth: 100, callback });
    const publisher = await a.publisher("out", STRING, { to: `${b.name}/in` });
    for (let number = 0; number < 100; number += 1) await publisher.publish({ data: String(number) });
    await done;
    equal(received, Array.from({ length: 100 }, (_, index) => index));
  },

  async "values arrive unchanged"(make) {
    const { a, b, publisher, subscriber } = await pair(make, POSE);
    for (const pose of [{ x: 1.5, y: -2, theta: 0.5 }, { x: NaN, y: Infinity, theta: -Infinity }]) {
      await publisher.publish(pose);
      equal(await subscriber.get(60), pose);
    }
    const numbers = await b.subscriber("numbers", INT64);
    const number = await a.publisher("number", INT64, { to: `${b.name}/numbers` });
    await number.publish({ data: -42 });
    equal(await numbers.get(60), { data: -42 });
    if (JSON.rawJSON) {
      await number.publish({ data: 9007199254740993n });
      equal(await numbers.get(60), { data: 9007199254740993n });
    }
    const words = await b.subscriber("words", STRING);
    const word = await a.publisher("word", STRING, { to: `${b.name}/words` });
    await word.publish({ data: "NaN" });
    equal(await words.get(60), { data: "NaN" });
  },

  async "raw bytes of any size arrive unchanged"(make) {
    const { publisher, subscriber } = await pair(make, STRING, { raw: true });
    for (const size of [1, 1000, 262144, 3 * 262144 + 1]) {
      const bytes = Uint8Array.from({ length: size }, (_, index) => (index * 7919) >> 3);
      await publisher.publish(bytes);
      const got = await subscriber.get(60);
      equal([got instanceof Uint8Array, got.length, got.every((byte, index) => byte === bytes[index])], [true, size, true]);
    }
  },

  async "small message overtakes large one"(make) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    const order = [];
    const done = new Promise((resolve) => {
      b.subscriber("images", STRING, { raw: true, callback: () => { order.push("large"); resolve(); } });
    });
    await b.subscriber("velocities", POSE, { callback: () => order.push("small") });
    const images = await a.publisher("images", STRING, { raw: true, to: `${b.name}/images` });
    const velocities = await a.publisher("velocities", POSE, { to: `${b.name}/velocities` });
    await images.publish(new Uint8Array(10_000_000));
    await velocities.publish({ x: 1 });
    await done;
    equal(order, ["small", "large"]);
  },

  async "goals end as their server says"(make, rce) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    await b.actionServer("work", FIBONACCI, async ({ request, signal, publishFeedback }) => {
      if (request.order > 9) throw new Error("too many");
      if (!request.order) await new Promise((resolve) => { signal.addEventListener("abort", resolve); });
      publishFeedback({ sequence: [1] });
      return { sequence: [request.order] };
    }, { accept: ({ order }) => order >= 0 });
    const client = await a.actionClient("ask", FIBONACCI, { to: `${b.name}/work` });
    const goal = await client.sendGoal({ order: 3 });
    const feedback = [];
    for await (const each of goal) feedback.push(each.sequence);
    equal(feedback, [[1]]);
    equal(await goal.result(60), { status: "succeeded", value: { sequence: [3] } });
    await throws(rce.Forbidden, client.sendGoal({ order: -1 }), "rejected");
    const canceled = await client.sendGoal({ order: 0 });
    await canceled.cancel(60);
    equal(await canceled.result(60), { status: "canceled", value: { sequence: [0] } });
    await throws(rce.NotFound, canceled.cancel(60), "has ended");
    await throws(rce.RceError, (await client.sendGoal({ order: 10 })).result(60), "too many");
    const kept = await client.sendGoal({ order: 0 });
    const events = a.events();
    breakSocket(a);
    await event(events, "reconnected");
    await kept.cancel(60);
    equal((await kept.result(60)).status, "canceled");
  },

  async "service responses and errors"(make, rce) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    await b.serviceProvider("gripper", SET_BOOL, async ({ data }) => {
      if (!data) throw new TypeError("the gripper is stuck");
      return { success: true, message: "ok" };
    });
    const gripper = await a.serviceClient("gripper", SET_BOOL, { to: `${b.name}/gripper` });
    equal(await Promise.all([1, 2, 3].map(() => gripper.call({ data: true }))), Array(3).fill({ success: true, message: "ok" }));
    await throws(rce.RceError, gripper.call({ data: false }), "the gripper is stuck");
  },

  async "plain function as handler and timeout of slow service"(make, rce) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    await b.serviceProvider("quick", SET_BOOL, ({ data }) => ({ success: data, message: "" }));
    await b.serviceProvider("slow", SET_BOOL, () => new Promise(() => {}));
    const quick = await a.serviceClient("quick", SET_BOOL, { to: `${b.name}/quick` });
    equal(await quick.call({ data: true }), { success: true, message: "" });
    const slow = await a.serviceClient("slow", SET_BOOL, { to: `${b.name}/slow` });
    await throws(rce.TimedOut, slow.call({ data: true }, 0.05), "slow");
  },

  async "service call raises unavailable when socket breaks"(make, rce) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    let called = null;
    const call = new Promise((resolve) => { called = resolve; });
    await b.serviceProvider("serve", SET_BOOL, () => { called(); return new Promise(() => {}); });
    const client = await a.serviceClient("call", SET_BOOL, { to: `${b.name}/serve` });
    const answer = throws(rce.Unavailable, client.call({ data: true }), "not known");
    await call;
    const events = a.events();
    breakSocket(a);
    await answer;
    equal((await event(events, "reconnected")).resumed, true);
  },

  async "interface that cannot be connected is removed"(make, rce) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    await throws(rce.NotFound, a.publisher("out", STRING, { to: `${b.name}/in` }));
    const subscriber = await b.subscriber("in", STRING);
    const publisher = await a.publisher("out", STRING, { to: `${b.name}/in` });
    await publisher.publish({ data: "x" });
    equal(await subscriber.get(60), { data: "x" });
  },

  async "configure executes commands in order"(make, rce) {
    const a = await make("a");
    const add = (tag, interfaceType) => ["addInterfaces", {
      endpointTag: a.name, interfaceTag: tag, interfaceType, className: STRING }];
    await a.configure(add("out", "SubscriberConverter"), add("in", "PublisherConverter"),
      ["connect", { tagA: `${a.name}/out`, tagB: `${a.name}/in` }]);
    await throws(rce.AlreadyExists, a.connect(`${a.name}/in`, `${a.name}/out`));
  },

  async "failed commands raise"(make, rce) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    await a.publisher("out", STRING);
    await b.subscriber("in", POSE);
    await throws(rce.NotFound, a.connect(`${a.name}/out`, `${b.name}/nothing`));
    await throws(rce.NotConnectable, a.connect(`${a.name}/out`, `${b.name}/in`));
    const add = (tag) => ["addInterfaces", {
      endpointTag: a.name, interfaceTag: tag, interfaceType: "SubscriberConverter", className: STRING }];
    const error = await throws(rce.AlreadyExists, a.configure(add("other"), add("out")));
    equal([error.code, error.item], ["already_exists", "commands[1]"]);
    await a.removeInterface(a.name, "other");
    await throws(rce.NotFound, a.removeInterface(a.name, "other"));
    await throws(rce.NotFound, a.publisher("trace", STRING, { to: `${b.name}/nothing` }));
    await a.publisher("trace", STRING);
  },

  async "without peer publish raises and offer drops"(make, rce) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    const publisher = await a.publisher("out", STRING);
    await throws(rce.NotConnected, publisher.publish({ data: "x" }, 0.01), "out");
    equal([publisher.offer({ data: "x" }), publisher.dropped], [false, 1]);
    const subscriber = await b.subscriber("in", STRING, { to: `${a.name}/out` });
    await publisher.waitConnected();
    equal(publisher.offer({ data: "y" }), true);
    equal(await subscriber.get(60), { data: "y" });
  },

  async "publisher that does not wait keeps what it should"(make, rce) {
    for (const [offline, arrive] of [["drop", []], ["newest", [2]], ["store", [0, 1, 2]]]) {
      const [a, b] = await Promise.all([make(`a_${offline}`), make(`b_${offline}`)]);
      const publisher = await a.publisher("out", STRING, { offline });
      for (let number = 0; number < 3; number++) await publisher.publish({ data: `${number}` }, 10, false);
      equal(publisher.dropped, 3 - arrive.length);
      const subscriber = await b.subscriber("in", STRING, { to: `${a.name}/out` });
      await publisher.waitConnected(60);
      await publisher.publish({ data: "last" });
      for (const number of arrive) equal(await subscriber.get(60), { data: `${number}` });
      equal(await subscriber.get(60), { data: "last" });
      for (let number = 0; number < 20; number++) {
        await publisher.publish({ data: `${number}` }, 10, false);
        equal(await subscriber.get(60), { data: `${number}` });
      }
    }
    await throws(rce.InvalidRequest, (await make("c")).publisher("out", STRING, { offline: "stor" }), "drop, newest or store");
  },

  async "stored messages arrive once and in order"(make) {
    const { a, publisher, subscriber } = await pair(make, STRING, {
      offline: "store", depth: 100_000, qos: { history: "keep_all" } });
    let next = 0;
    const put = () => publisher.publish({ data: `${next++}` }, 10, false);
    for (let round = 0; round < 5; round++) {
      const events = a.events();
      for (let number = 0; number < 20; number++) await put();
      await new Promise((resolve) => { setTimeout(resolve, round); }); // the socket breaks at several places
      breakSocket(a);
      let back = false;
      event(events, "reconnected").then(() => { back = true; });
      while (!back) {
        await put();
        await new Promise((resolve) => { setTimeout(resolve, 1); });
      }
    }
    await publisher.publish({ data: "last" });
    for (let number = 0; number < next; number++) equal(await subscriber.get(60), { data: `${number}` });
    equal(await subscriber.get(60), { data: "last" });
    equal(publisher.dropped, 0);
  },

  async "dead line is noticed by the robot's own traffic"(make, rce, tag, Socket) {
    let cut = false;
    class Line extends Socket { // nothing passes while it is cut, and nobody says so
      send(data) { if (!cut) super.send(data); }
      set onmessage(handle) { super.onmessage = handle && ((event) => { if (!cut) handle(event); }); }
    }
    const [a, b] = await Promise.all([make("a", { WebSocket: Line }), make("b")]);
    const subscriber = await b.subscriber("in", STRING);
    const publisher = await a.publisher("out", STRING, { to: `${b.name}/in`, offline: "store" });
    const events = a.events();
    await publisher.publish({ data: "before" });
    cut = true;
    await publisher.publish({ data: "meanwhile" }, 10, false);
    equal((await event(events, "disconnected")).reason, "the line is dead");
    cut = false;
    equal((await event(events, "reconnected")).resumed, true);
    equal([await subscriber.get(60), await subscriber.get(60)], [{ data: "before" }, { data: "meanwhile" }]);
  },

  async "old messages are dropped and the rate is kept"(make) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    const subscriber = await b.subscriber("in", STRING);
    const large = await a.publisher("large", STRING, { to: `${b.name}/in` });
    const old = await a.publisher("old", STRING, { to: `${b.name}/in`, delivery: { maxAge: 1e-9 } });
    const slow = await a.publisher("slow", STRING, { to: `${b.name}/in`, delivery: { rate: 0.001, priority: "high" } });
    large.offer({ data: "x".repeat(1e6) }); // fills the socket, since the clock of a page has steps of 0.1 ms
    equal(old.offer({ data: "late" }), true);
    equal([slow.offer({ data: "first" }), slow.offer({ data: "second" })], [true, false]);
    equal((await subscriber.get(60)).data.length, 1e6);
    equal(await subscriber.get(60), { data: "first" });
    equal([old.dropped, slow.dropped], [1, 1]);
  },

  async "resumed session keeps interfaces and connections"(make) {
    const { a, b, publisher, subscriber } = await pair(make, STRING);
    for (const each of [a, b]) {
      const events = each.events();
      breakSocket(each);
      await event(events, "disconnected");
      const late = await a.publisher(`late_${each === a ? "a" : "b"}`, STRING); // a command while offline
      equal((await event(events, "reconnected")).resumed, true);
      await late.close();
      await publisher.publish({ data: each.name });
      equal(await subscriber.get(60), { data: each.name });
    }
  },

  async "new session restores interfaces and connections"(make, rce) {
    const { a, publisher, subscriber } = await pair(make, STRING);
    const gone = await a.publisher("gone", STRING);
    await gone.close();
    const events = a.events();
    breakSocket(a, 1000); // ends the session
    equal((await event(events, "reconnected")).resumed, false);
    await publisher.publish({ data: "again" });
    equal(await subscriber.get(60), { data: "again" });
    await throws(rce.NotFound, a.removeInterface(a.name, "gone"));
  },

  async "connection is back when the other robot is"(make, rce) {
    const { a, b, publisher } = await pair(make, STRING);
    const events = a.events();
    await b.close();
    equal((await event(events, "connection")).state, "waiting");
    const again = await make("b");
    const subscriber = await again.subscriber("in", STRING);
    equal((await event(events, "connection")).state, "restored");
    await publisher.publish({ data: "again" });
    equal(await subscriber.get(60), { data: "again" });
  },

  async "new session connects when the other robot is back"(make, rce) {
    const { a, b, publisher } = await pair(make, STRING);
    await b.close();
    const events = a.events();
    breakSocket(a, 1000); // ends the session
    equal((await event(events, "error")).error instanceof rce.NotFound, true);
    const again = await make("b");
    const subscriber = await again.subscriber("in", STRING);
    await publisher.publish({ data: "again" });
    equal(await subscriber.get(60), { data: "again" });
  },

  async "resumed session connects when the other robot is back"(make, rce) {
    const { a, b, publisher } = await pair(make, STRING);
    await b.close();
    const events = a.events();
    breakSocket(a, 1000); // ends the session
    equal((await event(events, "error")).error instanceof rce.NotFound, true);
    breakSocket(a);
    equal((await event(events, "reconnected")).resumed, true);
    const again = await make("b");
    const subscriber = await again.subscriber("in", STRING);
    await publisher.publish({ data: "again" });
    equal(await subscriber.get(60), { data: "again" });
  },

  async "connection to a removed interface is gone"(make) {
    const { a, subscriber } = await pair(make, STRING);
    const events = a.events();
    await subscriber.close();
    equal((await event(events, "connection")).state, "gone");
  },

  async "commands issued while offline are executed"(make) {
    const [a, b] = await Promise.all([make("a"), make("b")]);
    const subscriber = await b.subscriber("in", STRING);
    breakSocket(a);
    const publisher = await a.publisher("out", STRING, { to: `${b.name}/in` });
    await publisher.publish({ data: "x" }, 60);
    equal(await subscriber.get(60), { data: "x" });
  },

  async "no message is delivered twice across reconnections"(make) {
    const { a, publisher, subscriber } = await pair(make, STRING, { depth: 10_000 });
    let number = 0;
    for (let round = 0; round < 3; round += 1) {
      const events = a.events();
      let back = false;
      breakSocket(a);
      event(events, "reconnected").then(() => { back = true; });
      while (!back) {
        await publisher.publish({ data: String(number) }, 60);
        number += 1;
        await new Promise((resolve) => { setTimeout(resolve, 0); });
      }
    }
    await publisher.publish({ data: "last" }, 60);
    const received = [];
    for (let data = ""; data !== "last"; { data } = await subscriber.get(60)) if (data) received.push(Number(data));
    equal(received, [...new Set(received)].sort((one, other) => one - other));
  },

  async "name is free after close"(make) {
    for (let round = 0; round < 3; round += 1) {
      const a = await make("a");
      await a.publisher("out", STRING);
      await a.close();
    }
  },

  async "name in use is rejected"(make, rce) {
    await make("a");
    await throws(rce.AlreadyExists, make("a"));
  },

  async "refused robots get the reason"(make, rce) {
    await throws(rce.Unauthorized, make("b", { password: "wrong" }));
    await throws(rce.InvalidRequest, make("c-d"), "robotID");
    await throws(rce.InvalidRequest, make("e", { key: "rce_x" }), "either a password or an API key");
  },

  async "close flushes queued messages and ends readers"(make, rce) {
    const { a, publisher, subscriber } = await pair(make, STRING, { depth: 100 });
    const own = await a.subscriber("own", STRING);
    for (let count = 0; count < 20; count += 1) await publisher.publish({ data: "x".repeat(100_000) });
    await a.close();
    for await (const message of own) throw new Error(`got ${message}`);
    for (let count = 0; count < 20; count += 1) await subscriber.get(60);
    await throws(rce.Unavailable, a.connect("x/y", "y/z"));
  },

  async "environment is created used and destroyed"(make, rce, tag) {
    const a = await make("a");
    const events = a.events();
    const environment = a.environment(`${tag}_land`, { size: 1 });
    await environment.create();
    try {
      await throws(rce.AlreadyExists, environment.create());
      await environment.create({ existOk: true });
      await throws(rce.AlreadyExists, a.environment(a.name).create({ existOk: true }));
      await environment.setParameter("rate", 10);
      await environment.deleteParameter("rate");
      await throws(rce.NotFound, environment.deleteParameter("rate"));
      await environment.addNode("echo", "rce_demo", "echo.py");
      const subscriber = await environment.subscriber("/heard", STRING);
      const publisher = await environment.publisher("/say", STRING);
      const echo = async (data) => {
        let answer = null;
        for (let tries = 0; answer?.data !== data && tries < 60; tries += 1) { // until the node is running
          await publisher.publish({ data });
          answer = await subscriber.get(0.5).catch(() => null);
        }
        equal(answer, { data });
      };
      await echo("hello");
      equal((await event(events, "environment")).containerTag, `${tag}_land`);
      breakSocket(a, 1000); // ends the session
      equal((await event(events, "reconnected")).resumed, false);
      await echo("again");
      await environment.removeNode("echo");
    } finally {
      await environment.destroy();
    }
  },
};
