// Notices of events: nodes that die, environments that are lost, limits, machines.

import { h, notice } from "./dom.js";
import { tell } from "./forms.js";

const RETRY = 5000; // milliseconds until the stream is opened again
const WORDS = {
  "node.died": (event, what) => `Node ${what} ended${event.status === null ? "" : ` with status ${event.status}`}.`,
  "recorder.ended": (event, what) => `Recorder ${what} ended: ${event.text}`,
  "environment.failed": (event, what) => `Environment ${what} did not start: ${event.text}`,
  "environment.lost": (event, what) => `Environment ${what} is lost: ${event.text}`,
  "limit.reached": (event) => event.text,
  "machine.left": (event, what) => `Machine ${what} is away. ${event.text}`,
};

/** Follow the events of the user whom the feed shows, until `signal`. */
export async function followEvents(app, signal) {
  let after = ""; // the last event
  while (!signal.aborted) {
    try {
      for await (const event of app.api.follow("/events", { after }, signal)) {
        after = event.id;
        tellOf(app, event);
      }
    } catch (error) {
      if (signal.aborted || (error.status >= 400 && error.status < 500)) return; // not allowed, which will not change
    }
    await new Promise((resolve) => { setTimeout(resolve, RETRY); });
  }
}

function tellOf(app, event) {
  const words = WORDS[event.type];
  if (!words) return;
  const what = event.user === app.me.user ? event.object.replace(/^[^/]*\//, "") : event.object;
  const lines = event.lines ?? [];
  const more = lines.length > 0 && h("button.small", { onclick: () => tell(what, h("pre.log", lines.join("\n"))) }, "Output");
  notice(words({ status: null, text: "", ...event }, what), true, more);
}
