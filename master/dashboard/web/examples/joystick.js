// Drives a robot and shows its camera: a complete example of rce.js in a page.

import { Api } from "../api.js";
import { Picture } from "../picture.js";
import { Robot } from "../rce/rce.js";

const [FORWARD, TURN] = [0.5, 1.5]; // maximum, metres and radians per second
const PERIOD = 100; // milliseconds between commands while the stick is held
const [form, status, stick] = ["form", "status", "stick"].map((id) => document.getElementById(id));
const picture = new Picture();
document.getElementById("camera").append(picture.status, picture.element);

let velocity = null; // the publisher
let held = { forward: 0, turn: 0 }; // each from -1 to 1

const key = sessionStorage.getItem("rce.key"); // of the tab's sign-in
const wanted = new URLSearchParams(location.search).get("environment");
if (wanted) form.environment.value = wanted;
let user = ""; // who has signed in
begin().catch((error) => { status.textContent = error.message; });

async function begin() {
  if (!key) {
    form.hidden = true;
    status.textContent = "Sign in at the dashboard first, then come back in the same tab.";
    return;
  }
  const api = new Api(key);
  ({ user } = await api.get("/whoami"));
  if (wanted) document.getElementById("back").href = `../#/environments/${user}/${wanted}`;
  for (const each of await api.list("/environments")) {
    document.getElementById("environments").append(new Option(each.containerTag, each.containerTag));
  }
}

form.onsubmit = async (event) => {
  event.preventDefault();
  const { environment: tag, velocity: topic, camera } = Object.fromEntries(new FormData(form));
  status.textContent = "connecting …";
  try {
    const robot = new Robot(location.origin, { user, key, robot: "joystick" });
    await robot.open();
    const environment = robot.environment(tag);
    velocity = await environment.publisher(topic, "geometry_msgs/Twist");
    await environment.subscriber(camera, "sensor_msgs/Image", { format: "jpeg", depth: 1, callback: (image) => picture.take(image) });
    status.textContent = `drives ${tag}`;
    form.hidden = true;
    for await (const happened of robot.events()) status.textContent = happened.topic === "reconnected" ? `drives ${tag}` : happened.topic;
  } catch (error) {
    status.textContent = error.message;
  }
};

function hold(forward, turn) {
  const still = held.forward === 0 && held.turn === 0 && forward === 0 && turn === 0;
  held = { forward, turn };
  stick.firstElementChild.style.transform = `translate(${-turn * 97}%, ${-forward * 97}%)`;
  if (!still) send();
}

function send() {
  const twist = { linear: { x: held.forward * FORWARD }, angular: { z: held.turn * TURN } };
  document.getElementById("velocity").textContent = `${twist.linear.x.toFixed(2)} m/s, ${twist.angular.z.toFixed(2)} rad/s`;
  velocity?.offer(twist); // a newer command replaces one that waits
}

setInterval(() => (held.forward || held.turn) && send(), PERIOD); // robots stop by themselves without commands

const clamp = (value) => Math.max(-1, Math.min(1, value));
stick.onpointerdown = (event) => { stick.setPointerCapture(event.pointerId); stick.onpointermove(event); };
stick.onpointermove = (event) => {
  if (!stick.hasPointerCapture(event.pointerId)) return;
  const { left, top, width, height } = stick.getBoundingClientRect();
  hold(clamp(1 - (2 * (event.clientY - top)) / height), clamp(1 - (2 * (event.clientX - left)) / width));
};
stick.onpointerup = stick.onpointercancel = () => hold(0, 0);

const KEYS = { ArrowUp: ["forward", 1], ArrowDown: ["forward", -1], ArrowLeft: ["turn", 1], ArrowRight: ["turn", -1] };
stick.onkeydown = (event) => {
  const [axis, value] = KEYS[event.key] ?? [];
  if (!axis) return;
  event.preventDefault();
  hold(axis === "forward" ? value : held.forward, axis === "turn" ? value : held.turn);
};
stick.onkeyup = (event) => {
  const [axis] = KEYS[event.key] ?? [];
  if (axis) hold(axis === "forward" ? 0 : held.forward, axis === "turn" ? 0 : held.turn);
};
stick.onblur = () => hold(0, 0);
