// An environment of the platform, with the ends of its topics and services that one robot uses.

import { AlreadyExists } from "./errors.js";

export class Environment {
  constructor(robot, tag, options) {
    this.robot = robot;
    this.tag = tag;
    this.options = options;
  }

  /** Start it with its options; with `existOk` one of that name that is there already will do. */
  create({ existOk = false } = {}) {
    return this.robot.createEnvironment(this.tag, this.options, { existOk });
  }

  /** Stop the environment with all that is in it. */
  destroy() {
    return this.robot.destroyEnvironment(this.tag);
  }

  addNode(tag, pkg, exe, options) {
    return this.robot.addNode(this.tag, tag, pkg, exe, options);
  }

  removeNode(tag) {
    return this.robot.removeNode(this.tag, tag);
  }

  setParameter(name, value, options) {
    return this.robot.setParameter(this.tag, name, value, options);
  }

  deleteParameter(name, options) {
    return this.robot.deleteParameter(this.tag, name, options);
  }

  /** The robot publishes on a topic of the environment. */
  async publisher(topic, typeName, options = {}) {
    const to = await this.#interface(topic, "pub", "PublisherInterface", typeName, options.qos);
    return this.robot.publisher(this.#ownTag(to), typeName, { ...options, to });
  }

  /** The robot receives what is published on a topic of the environment. */
  async subscriber(topic, typeName, options = {}) {
    const to = await this.#interface(topic, "sub", "SubscriberInterface", typeName, options.qos);
    return this.robot.subscriber(this.#ownTag(to), typeName, { ...options, to });
  }

  /** The robot calls a service of the environment. */
  async serviceClient(service, typeName, options = {}) {
    const to = await this.#interface(service, "call", "ServiceClientInterface", typeName);
    return this.robot.serviceClient(this.#ownTag(to), typeName, { ...options, to });
  }

  /** The robot offers a service to the nodes of the environment. */
  async serviceProvider(service, typeName, handler, options = {}) {
    const to = await this.#interface(service, "serve", "ServiceProviderInterface", typeName);
    return this.robot.serviceProvider(this.#ownTag(to), typeName, handler, { ...options, to });
  }

  /** The `endpoint/interface` for an address of the environment, added unless it is there. */
  async #interface(address, verb, interfaceType, typeName, qos) {
    const tag = `${this.#begin}${verb}_${address.replace(/[^A-Za-z0-9_]+/g, "_").replace(/^_+|_+$/g, "")}`;
    try {
      await this.robot.addInterface(this.tag, tag, interfaceType, typeName, { addr: address, qos });
    } catch (error) {
      if (!(error instanceof AlreadyExists)) throw error; // another robot's; of another type, connecting it fails
    }
    return `${this.tag}/${tag}`;
  }

  /** What a guest makes here has names that begin with its own. */
  get #begin() {
    return this.robot.isGuest ? `${this.robot.name}.` : "";
  }

  /** The tag of the robot's end. */
  #ownTag(to) {
    return to.replace(this.#begin, "").replace("/", "_");
  }
}
