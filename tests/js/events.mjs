// Reads the events of a robot until the platform refuses the robot for good.

import { equal } from "node:assert/strict";

import { NotFound, Robot } from "../../rce/js/rce.js";

const [url, user, password] = process.argv.slice(2);
let isRemoved = false;
let socket = null;

/** A socket that the platform refuses once the robot's owner was removed. */
class Socket extends WebSocket {
  constructor(address) {
    if (isRemoved) {
      return {
        set onclose(handle) {
          setTimeout(() => handle({ code: 4404, reason: "there is no user ann" }), 0);
        },
        close() {},
      };
    }
    super(address);
    socket = this;
  }
}

const robot = new Robot(url, { user, robot: "r2d2", password, WebSocket: Socket });
await robot.open();

const left = robot.events();
setTimeout(() => robot.errorReceived(new NotFound("an error of the session")), 0);
for await (const event of left) {
  equal(event.topic, "error");
  break;
}
equal(left.ended, true, "the loop was left");

const ended = robot.events();
ended.end();
equal(await ended.get(60).catch((error) => error.code), "unavailable");
const events = robot.events();
isRemoved = true;
socket.close(3000);
equal((await events.get(60)).topic, "disconnected");
const error = await events.get(60).catch((reason) => reason);
equal(error instanceof NotFound, true, String(error));
console.log("done");
