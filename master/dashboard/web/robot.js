// The guest that this page is where it shows data, with the rights of who is signed in; what it makes goes with it.

import { Robot } from "./rce/rce.js";

/** Subscriptions of one page to topics of an environment of `owner`'s: `add` makes one, `close` ends them all. */
export class Subscriptions {
  #robot;
  #opened;

  constructor(app, owner, environment) {
    const digits = Array.from(crypto.getRandomValues(new Uint8Array(4)), (each) => each.toString(16).padStart(2, "0"));
    this.environment = environment;
    this.#robot = new Robot(location.origin, { user: app.me.user, owner, robot: `@browser_${digits.join("")}`, key: app.key });
    this.#opened = this.#robot.open();
    this.#opened.catch(() => {}); // who adds something hears of it
    app.guest = this.#robot;
  }

  async add(topic, type, options) {
    await this.#opened;
    return this.#robot.environment(this.environment).subscriber(topic, type, options);
  }

  close() {
    this.#robot.close();
  }
}
