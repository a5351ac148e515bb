// The client library of RCE for pages and for Node: a robot at the platform. No dependencies; see docs/javascript.md.

import { Environment } from "./environment.js";
import { AlreadyExists, InvalidRequest } from "./errors.js";
import { Publisher, ServiceClient, ServiceProvider, Subscriber } from "./interfaces.js";
import { Session } from "./session.js";
import { Stream } from "./stream.js";

export * from "./errors.js";
export { Environment, Publisher, ServiceClient, ServiceProvider, Stream, Subscriber };

const EVENTS = 1000; // that one reader may leave unread

export class Robot {
  #session;
  #interfaces = new Map();
  #declared = { interfaces: new Map(), connections: new Map() };
  #readers = new Set();

  /** `url` is that of the Master's entry. `timeout` is for each command, in seconds, as all times. One whose name begins
   * with `@` is a guest: it takes part in the data of `owner`, and what it makes goes with it. */
  constructor(url, { user, robot, owner = "", key = "", password = "", timeout = 60, WebSocket = globalThis.WebSocket }) {
    if (!key === !password) throw new InvalidRequest("give a password or a key, one of the two", { field: "password" });
    if (!WebSocket) throw new InvalidRequest("there is no WebSocket: use Node 22 or later, or give a class of your own");
    this.name = robot;
    this.#session = new Session({ url, user, robot, owner, key, password, timeout, WebSocket }, this);
  }

  /** Connect. Unauthorized, Forbidden, Unavailable, InvalidRequest, AlreadyExists (for a name in use). */
  open() {
    return this.#session.open();
  }

  /** Send what is queued and leave. Environments stay until they are destroyed. */
  close() {
    return this.#session.close();
  }

  get isGuest() {
    return this.name.startsWith("@");
  }

  /** null while the robot is not connected. */
  get connection() {
    return this.#session.connection;
  }

  get connected() {
    return this.connection !== null;
  }

  get features() {
    return this.connection?.features ?? new Set();
  }

  /** What happens from now on: objects by their `topic`; see rce.d.ts. Every call gives a stream of its own. */
  events() {
    const stream = new Stream(EVENTS);
    this.#readers.add(stream);
    return stream;
  }

  environment(tag, options = {}) {
    return new Environment(this, tag, options);
  }

  // --- commands: each ends when it is carried out, or with the error that says why not

  async createEnvironment(tag, options = {}, { existOk = false } = {}) {
    try {
      await this.configure(["CC", { containerTag: tag, containerData: options }]);
    } catch (error) {
      if (!existOk || !(error instanceof AlreadyExists)) throw error;
    }
  }

  destroyEnvironment(tag) {
    return this.configure(["DC", { containerTag: tag }]);
  }

  addNode(environment, tag, pkg, exe, { args, name, namespace } = {}) {
    return this.configure(["addNodes", { containerTag: environment, nodeTag: tag, pkg, exe, args, name, namespace }]);
  }

  removeNode(environment, tag) {
    return this.configure(["removeNodes", { containerTag: environment, nodeTag: tag }]);
  }

  setParameter(environment, name, value, { node } = {}) {
    return this.configure(["setParam", { containerTag: environment, name, value, nodeTag: node }]);
  }

  deleteParameter(environment, name, { node } = {}) {
    return this.configure(["deleteParam", { containerTag: environment, name, nodeTag: node }]);
  }

  addInterface(endpoint, tag, interfaceType, typeName, { addr, qos, format } = {}) {
    return this.configure(["addInterfaces", {
      endpointTag: endpoint, interfaceTag: tag, interfaceType, className: typeName, addr, qos, format }]);
  }

  removeInterface(endpoint, tag) {
    if (endpoint === this.name) {
      this.#interfaces.get(tag)?.ended(null);
      this.#interfaces.delete(tag);
    }
    return this.configure(["removeInterfaces", { endpointTag: endpoint, interfaceTag: tag }]);
  }

  connect(a, b) {
    return this.configure(["connect", { tagA: a, tagB: b }]);
  }

  disconnect(a, b) {
    return this.configure(["disconnect", { tagA: a, tagB: b }]);
  }

  /** Carry out many commands, `[list, item]` in the protocol's words, without waiting for one before the next is sent.
   * All are tried; then the first error is thrown, and its `item` (`commands[2]`) says which it was. */
  async configure(...commands) {
    const outcomes = await Promise.allSettled(commands.map((command) => this.#session.carryOut(command)));
    let first = null;
    outcomes.forEach(({ reason }, index) => {
      if (!reason) return this.#note(commands[index]);
      if (commands.length > 1) reason.item = `commands[${index}]`;
      first ??= reason;
    });
    if (first) throw first;
  }

  // --- the robot's ends of topics and services; `to` is the `endpoint/interface` that is connected at once

  publisher(tag, typeName, options = {}) {
    return this.#add(new Publisher(this, tag, typeName), "Subscriber", options);
  }

  subscriber(tag, typeName, options = {}) {
    return this.#add(new Subscriber(this, tag, typeName, options), "Publisher", options);
  }

  serviceClient(tag, typeName, options = {}) {
    return this.#add(new ServiceClient(this, tag, typeName), "ServiceProvider", options);
  }

  serviceProvider(tag, typeName, handler, options = {}) {
    return this.#add(new ServiceProvider(this, tag, typeName, handler), "ServiceClient", options);
  }

  /** Add the interface and connect it; when that fails it is as if it had never been. */
  async #add(made, kind, { to = "", raw = false, format, qos }) {
    const { tag, typeName } = made;
    if (this.#interfaces.has(tag)) throw new AlreadyExists(`${this.name}/${tag} exists already: close it first`);
    this.#interfaces.set(tag, made);
    try {
      await this.addInterface(this.name, tag, kind + (raw ? "Forwarder" : "Converter"), typeName, { qos, format });
    } catch (error) {
      this.#interfaces.delete(tag);
      made.ended(null);
      throw error;
    }
    if (to) {
      try {
        await this.connect(to, `${this.name}/${tag}`);
        await made.waitConnected();
      } catch (error) {
        await made.close();
        throw error;
      }
    }
    return made;
  }

  // --- what the session tells

  received(data, blobs) {
    return this.#interfaces.get(data.iTag)?.received(data, blobs);
  }

  status(status) {
    if (status.topic === "iu") this.#interfaces.get(status.iTag)?.status(status.status);
    else this.#tell(status);
  }

  failed(error) {
    const call = error.fields?.msgID;
    if (call !== undefined && [...this.#interfaces.values()].some((each) => each.failed(error, call))) return;
    this.#tell({ topic: "error", error });
  }

  lost(reason) {
    for (const each of this.#interfaces.values()) each.lost();
    this.#tell({ topic: "disconnected", reason });
  }

  back(resumed, statuses) {
    for (const each of this.#interfaces.values()) each.status(Boolean(statuses[each.tag]));
    this.#tell({ topic: "reconnected", resumed });
  }

  declared() {
    const { interfaces, connections } = this.#declared;
    return [...interfaces.values(), ...connections.values()];
  }

  ended(error) {
    for (const each of this.#interfaces.values()) each.ended(error);
    for (const reader of this.#readers) reader.end(error);
  }

  #tell(event) {
    for (const reader of this.#readers) reader.put(event);
  }

  /** Take account of a command that was carried out: what is this robot's own is declared again when it must be. */
  #note(command) {
    const [list, item] = command;
    const { interfaces, connections } = this.#declared;
    const forget = (gone) => {
      for (const tag of interfaces.keys()) if (gone(tag)) interfaces.delete(tag);
      for (const [pair, [, { tagA, tagB }]] of connections) if (gone(tagA) || gone(tagB)) connections.delete(pair);
    };
    const pair = () => [item.tagA, item.tagB].sort().join(" ");
    const own = () => item.endpointTag === this.name || (this.isGuest && item.interfaceTag.startsWith(`${this.name}.`));
    if (list === "addInterfaces" && own()) interfaces.set(`${item.endpointTag}/${item.interfaceTag}`, command);
    else if (list === "removeInterfaces") forget((tag) => tag === `${item.endpointTag}/${item.interfaceTag}`);
    else if (list === "DC") forget((tag) => tag.startsWith(`${item.containerTag}/`));
    else if (list === "disconnect") connections.delete(pair());
    else if (list === "connect" && [item.tagA, item.tagB].some((tag) => tag.startsWith(`${this.name}/`))) {
      connections.set(pair(), command);
    }
  }
}
