// The guest robot through which a page receives data, with the rights of the signed-in user; its interfaces go with it.

import { Robot } from "./rce/rce.js";

/** Guest of one page in an owner's environment; `close` ends all that it does there. */
export class Guest {
  #robot;
  #opened;
  #made = new Map();

  constructor(app, owner, environment) {
    const digits = Array.from(crypto.getRandomValues(new Uint8Array(4)), (each) => each.toString(16).padStart(2, "0"));
    this.environment = environment;
    this.#robot = new Robot(location.origin, { user: app.me.user, owner, robot: `@browser_${digits.join("")}`, key: app.key });
    this.#opened = this.#robot.open();
    this.#opened.catch(() => {}); // the first use reports the error
    app.guest = this.#robot;
  }

  /** Return the robot and its handle of the environment, when it is connected. */
  async opened() {
    await this.#opened;
    return { robot: this.#robot, environment: this.#robot.environment(this.environment) };
  }

  async subscribe(topic, type, options) {
    await this.#opened;
    return this.#robot.environment(this.environment).subscriber(topic, type, options);
  }

  /** Call a function with the first error about a message. */
  async onError(use) {
    for await (const event of this.#robot.events()) {
      if (event.topic === "error") return use(event.error);
    }
    return undefined;
  }

  async publish(topic, type, message) {
    const publisher = await this.#once(topic, (environment) => environment.publisher(topic, type));
    await publisher.publish(message);
  }

  async call(service, type, request) {
    const client = await this.#once(service, (environment) => environment.serviceClient(service, type));
    return client.call(request);
  }

  /** Return an accepted goal of an action; it is canceled if the page goes. */
  async sendGoal(action, type, goal) {
    const client = await this.#once(action, (environment) => environment.actionClient(action, type));
    return client.sendGoal(goal, { cancelIfLost: true });
  }

  close() {
    this.#robot.close();
  }

  async #once(name, make) {
    await this.#opened;
    if (!this.#made.has(name)) this.#made.set(name, await make(this.#robot.environment(this.environment)));
    return this.#made.get(name);
  }
}
