// Handle of an environment, through which one robot uses its topics and services.

import { AlreadyExists } from "./errors.js";

/** Environment as one robot uses it; made by Robot.environment. */
export class Environment {
  constructor(robot, tag, options) {
    this.robot = robot;
    this.tag = tag;
    this.options = options;
  }

  /** Start the environment with its options; with `existOk` an existing one of that name is accepted. */
  create({ existOk = false } = {}) {
    return this.robot.createEnvironment(this.tag, this.options, { existOk });
  }

  /** Stop the environment and remove everything in it. */
  destroy() {
    return this.robot.destroyEnvironment(this.tag);
  }

  /** See Robot.addNode. */
  addNode(tag, pkg, exe, options) {
    return this.robot.addNode(this.tag, tag, pkg, exe, options);
  }

  /** Stop a node. */
  removeNode(tag) {
    return this.robot.removeNode(this.tag, tag);
  }

  /** See Robot.setParameter. */
  setParameter(name, value, options) {
    return this.robot.setParameter(this.tag, name, value, options);
  }

  /** Remove a parameter. */
  deleteParameter(name, options) {
    return this.robot.deleteParameter(this.tag, name, options);
  }

  /** See Robot.addRecorder. */
  addRecorder(tag, options) {
    return this.robot.addRecorder(this.tag, tag, options);
  }

  /** End a recorder; its recordings are kept. */
  removeRecorder(tag) {
    return this.robot.removeRecorder(this.tag, tag);
  }

  /** Publish on a topic of the environment. */
  async publisher(topic, typeName, options = {}) {
    const to = await this.#interface(topic, "pub", "PublisherInterface", typeName, options.qos);
    return this.robot.publisher(this.#ownTag(to), typeName, { ...options, to });
  }

  /** Subscribe to a topic of the environment. */
  async subscriber(topic, typeName, options = {}) {
    const to = await this.#interface(topic, "sub", "SubscriberInterface", typeName, options.qos);
    return this.robot.subscriber(this.#ownTag(to), typeName, { ...options, to });
  }

  /** Return a client of a service that a node of the environment offers. */
  async serviceClient(service, typeName, options = {}) {
    const to = await this.#interface(service, "call", "ServiceClientInterface", typeName);
    return this.robot.serviceClient(this.#ownTag(to), typeName, { ...options, to });
  }

  /** Offer a service to the nodes of the environment. */
  async serviceProvider(service, typeName, handler, options = {}) {
    const to = await this.#interface(service, "serve", "ServiceProviderInterface", typeName);
    return this.robot.serviceProvider(this.#ownTag(to), typeName, handler, { ...options, to });
  }

  /** Return a client of an action that a node of the environment offers. */
  async actionClient(action, typeName, options = {}) {
    const to = await this.#interface(action, "ask", "ActionClientInterface", typeName);
    return this.robot.actionClient(this.#ownTag(to), typeName, { ...options, to });
  }

  /** Offer an action to the nodes of the environment. */
  async actionServer(action, typeName, handler, options = {}) {
    const to = await this.#interface(action, "act", "ActionProviderInterface", typeName);
    return this.robot.actionServer(this.#ownTag(to), typeName, handler, { ...options, to });
  }

  /** Add the environment's interface for a topic, service or action unless it exists; returns `endpoint/interface`. */
  async #interface(address, verb, interfaceType, typeName, qos) {
    const tag = `${this.#prefix}${verb}_${address.replace(/[^A-Za-z0-9_]+/g, "_").replace(/^_+|_+$/g, "")}`;
    try {
      await this.robot.addInterface(this.tag, tag, interfaceType, typeName, { addr: address, qos });
    } catch (error) {
      if (!(error instanceof AlreadyExists)) throw error; // if its type differs, connecting fails
    }
    return `${this.tag}/${tag}`;
  }

  /** Prefix of the names of what a guest makes in an environment. */
  get #prefix() {
    return this.robot.isGuest ? `${this.robot.name}.` : "";
  }

  /** Tag of the robot's interface that is connected to `to`. */
  #ownTag(to) {
    return to.replace(this.#prefix, "").replace("/", "_");
  }
}
