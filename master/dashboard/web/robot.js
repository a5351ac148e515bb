// The robot that this page is where it shows data: an ordinary one, with the rights of who is signed in.

import { Robot } from "./rce/rce.js";

/** The page's robot, connected; made when it is asked for first. */
export function ownRobot(app) {
  app.robot ??= (async () => {
    const name = `browser_${Array.from(crypto.getRandomValues(new Uint8Array(4)), (each) => each.toString(16).padStart(2, "0")).join("")}`;
    const robot = new Robot(location.origin, { user: app.me.user, robot: name, key: app.key });
    await robot.open();
    return robot;
  })();
  app.robot.catch(() => { app.robot = null; });
  return app.robot;
}

/** Subscriptions of one page: `add` makes one, `close` ends them all, also those that are still being made. */
export class Subscriptions {
  #made = [];
  #closed = false;

  constructor(app, environment) {
    this.app = app;
    this.environment = environment;
  }

  async add(topic, type, options) {
    const robot = await ownRobot(this.app);
    const subscriber = await robot.environment(this.environment).subscriber(topic, type, options);
    if (this.#closed) await subscriber.close();
    else this.#made.push(subscriber);
    return subscriber;
  }

  close() {
    this.#closed = true;
    for (const each of this.#made.splice(0)) each.close().catch(() => {}); // it may be gone with its environment
  }
}
