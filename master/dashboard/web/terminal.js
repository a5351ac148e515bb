// Terminal in an environment, as `rce env shell` opens it: xterm.js in front of a terminal node.

import { Api } from "./api.js";
import { Receiving, Sending, frames, fromCdr, toCdr } from "./terminalstream.js";
import { Guest } from "./robot.js";

const MESSAGE = "std_msgs/UInt8MultiArray";
const QUEUE = 1000; // messages
const QOS = { reliability: "reliable", durability: "volatile", depth: QUEUE };
const [TICK, KEEPALIVE] = [250, 2000]; // milliseconds
const status = document.getElementById("status");
const [owner, environment] = location.hash.slice(1).split("/");

begin().catch((error) => { status.textContent = error.message; });

async function begin() {
  const key = sessionStorage.getItem("rce.key"); // of the tab's sign-in
  if (!key) throw new Error("Sign in at the dashboard first, then come back in the same tab.");
  if (!environment) throw new Error("Open the terminal from the page of an environment.");
  document.getElementById("back").href = `./#/environments/${owner}/${environment}`;
  document.getElementById("title").textContent = `Terminal in ${environment}`;
  const me = await new Api(key).get("/whoami");
  const guest = new Guest({ me, key }, owner, environment);
  addEventListener("pagehide", () => guest.close());
  const { robot, environment: place } = await guest.opened();
  const prefix = `/rce_shell/${robot.name.slice(1)}`;
  await place.addNode(`${robot.name}.shell`, "rce_shell", "shell", { args: prefix });
  const input = await place.publisher(`${prefix}/input`, MESSAGE, { raw: true, qos: QOS });
  await input.waitConnected();
  await talk(place, input, `${prefix}/output`);
}

/** Connect the keyboard and the screen with the node's topics, until its program ends. */
async function talk(place, input, topic) {
  const screen = new Terminal({ screenReaderMode: true, cursorBlink: true, fontSize: 14 });
  const fit = new FitAddon.FitAddon();
  screen.loadAddon(fit);
  screen.open(document.getElementById("terminal"));
  fit.fit();
  const send = (frame) => input.offer(toCdr(frame), QUEUE);
  const [outgoing, incoming] = [new Sending(send), new Receiving()];
  let [ready, ended, beat] = [false, false, 0];
  const end = (code) => {
    ended = true;
    clearInterval(timer);
    send(frames.hangUp());
    status.textContent = `ended with status ${code}; reload the page for another one`;
  };
  const take = (message) => {
    const frame = fromCdr(message);
    const [kind, content] = [String.fromCharCode(frame[0]), frame.subarray(1)];
    if (kind === "r") {
      ready = true;
      status.textContent = "connected";
    } else if (kind === "t") outgoing.acknowledged(content);
    else if (kind === "d") {
      screen.write(incoming.receive(content));
      send(incoming.acknowledgement());
    } else if (kind === "x" && !ended) {
      const { code, end: last } = frames.readExit(content);
      if (incoming.end === last) end(code);
    }
  };
  const timer = setInterval(() => {
    if (!ready) return void send(frames.open(screen.rows, screen.cols));
    outgoing.tick();
    if ((beat += TICK) % KEEPALIVE === 0) send(frames.keepAlive());
  }, TICK);
  screen.onData((text) => ended || outgoing.write(new TextEncoder().encode(text)));
  screen.onResize(({ rows, cols }) => ready && send(frames.size(rows, cols)));
  new ResizeObserver(() => fit.fit()).observe(document.getElementById("terminal"));
  await place.subscriber(topic, MESSAGE, { raw: true, qos: QOS, depth: QUEUE, callback: take });
  screen.focus();
}
