// The guest robot through which a page receives data, with the rights of the signed-in user; its interfaces go with it.

import { Robot } from "./rce/rce.js";

/** Subscriptions of one page to topics of an owner's environment: `add` makes one, `close` ends all. */
export class Subscriptions {
  #robot;
  #opened;

  constructor(app, owner, environment) {
    const digits = Array.from(crypto.getRandomValues(new Uint8Array(4)), (each) => each.toString(16).padStart(2, "0"));
    this.environment = environment;
    this.#robot = new Robot(location.origin, { user: app.me.user, owner, robot: `@browser_${digits.join("")}`, key: app.key });
    this.#opened = this.#robot.open();
    this.#opened.catch(() => {}); // `add` reports the error
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
