// Client library of RCE for pages and Node: a robot that is connected to a platform. No dependencies; see
// docs/javascript.md.

import { Environment } from "./environment.js";
import { AlreadyExists, InvalidRequest, NotFound, Unavailable } from "./errors.js";
import { ActionClient, ActionServer, Goal } from "./actions.js";
import { Publisher, ServiceClient, ServiceProvider, Subscriber } from "./interfaces.js";
import { Service } from "./service.js";
import { ClientSession } from "./session.js";
import { StoringPublisher } from "./stored.js";
import { Stream } from "./stream.js";

export * from "./errors.js";
export { ActionClient, ActionServer, Environment, Goal, Publisher, Service, ServiceClient, ServiceProvider, Stream,
  Subscriber };

const EARLY = 1000; // newest messages and statuses that are kept for the interfaces of a service
const EVENT_BACKLOG = 1000; // unread events that one reader may have

/** Robot that is connected to a platform. */
export class Robot {
  #session;
  #interfaces = new Map();
  #declared = { interfaces: new Map(), counterparts: new Map(), connections: new Map(), services: new Map() };
  #early = new Map(); // what came for interfaces that the platform makes, by the prefix of their tags
  #readers = new Set();

  /**
   * `url` is that of the Master's entry; those of several Masters are separated by commas. `timeout` is that of each
   * command, in seconds like all times. A robot whose name begins with `@` is a guest: it takes part in the data of
   * `owner`, and what it makes is removed with it.
   */
  constructor(url, { user, robot, owner = "", key = "", password = "", timeout = 60, WebSocket = globalThis.WebSocket }) {
    if (!key === !password) throw new InvalidRequest("give either a password or an API key", { field: "password" });
    if (!WebSocket) {
      throw new InvalidRequest("this JavaScript has no WebSocket: use Node 22 or later, or pass a WebSocket class");
    }
    this.name = robot;
    this.#session = new ClientSession({ url, user, robot, owner, key, password, timeout, WebSocket }, this);
  }

  /** Connect. Rejects with Unauthorized, Forbidden, Unavailable, InvalidRequest, or AlreadyExists (name in use). */
  open() {
    return this.#session.open();
  }

  /** Send the queued messages and leave. Environments stay until they are destroyed. */
  close() {
    return this.#session.close();
  }

  /** True for a guest, whose name begins with `@`. */
  get isGuest() {
    return this.name.startsWith("@");
  }

  /** The open connection, or null while the robot is offline. */
  get connection() {
    return this.#session.connection;
  }

  /** True while the robot is online. */
  get connected() {
    return this.connection !== null;
  }

  /** Set of the protocol features that the server granted; empty while offline. */
  get features() {
    return this.connection?.features ?? new Set();
  }

  /**
   * A new stream of the events from now on: objects, distinguished by their `topic`; see rce.d.ts. It ends with its
   * `end`, and when a `for await` loop over it is left.
   */
  events() {
    const stream = new Stream(EVENT_BACKLOG, () => stream.end());
    this.#readers.add(stream);
    return stream;
  }

  /** A handle of an environment, which may exist already; nothing is sent. */
  environment(tag, options = {}) {
    return new Environment(this, tag, options);
  }

  // --- commands: each resolves when it has been executed, or rejects with the error

  async createEnvironment(tag, options = {}, { existOk = false } = {}) {
    try {
      await this.configure(["CC", { containerTag: tag, containerData: options }]);
    } catch (error) {
      if (!existOk || !(error instanceof AlreadyExists) || error.fields?.kind === "robot") throw error;
    }
  }

  destroyEnvironment(tag) {
    return this.configure(["DC", { containerTag: tag }]);
  }

  addNode(environment, tag, pkg, exe, { args, name, namespace, existOk, restart, launch } = {}) {
    const node = { containerTag: environment, nodeTag: tag, pkg, exe, args, name, namespace, existOk, restart, launch };
    return this.configure(["addNodes", node]);
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

  addRecorder(environment, tag, { topics, maxSize, maxDuration, existOk } = {}) {
    return this.configure(["addRecorders", { containerTag: environment, recorderTag: tag, topics, maxSize, maxDuration, existOk }]);
  }

  removeRecorder(environment, tag) {
    return this.configure(["removeRecorders", { containerTag: environment, recorderTag: tag }]);
  }

  addInterface(endpoint, tag, interfaceType, typeName, { addr, qos, format, delivery, codec } = {}) {
    return this.configure(["addInterfaces", {
      endpointTag: endpoint, interfaceTag: tag, interfaceType, className: typeName, addr, qos, format, delivery, codec }]);
  }

  removeInterface(endpoint, tag) {
    if (endpoint === this.name) {
      this.#interfaces.get(tag)?.end(null);
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

  /**
   * Execute several commands, `[list, item]` with the names of the protocol, without waiting for one before the next is
   * sent. A failed one does not stop the others; then rejects with the first error, whose `item` (`commands[2]`) names
   * the command.
   */
  async configure(...commands) {
    const outcomes = await Promise.allSettled(commands.map((command) => this.#session.execute(command)));
    let first = null;
    outcomes.forEach(({ reason }, index) => {
      if (!reason) return this.#record(commands[index]);
      if (reason instanceof AlreadyExists) this.#recordExisting(commands[index]);
      if (commands.length > 1) reason.item = `commands[${index}]`;
      first ??= reason;
    });
    if (first) throw first;
  }

  /** Use a service of the catalogue, which is started if needed; `tag` begins the names of the robot's interfaces. */
  async service(name, { tag = name.slice(name.lastIndexOf("/") + 1), raw = false } = {}) {
    if (this.#declared.services.has(tag)) throw new AlreadyExists(`this robot uses a service as ${tag}: give another tag`);
    const [command, prefix] = [["useServices", { service: name, containerTag: tag, raw }], `${tag}_`];
    const early = [];
    this.#early.set(prefix, early);
    try {
      const { services } = await this.#session.execute(command);
      if (!services) throw new Unavailable("this platform has no catalogue of services: it is older than this client");
      this.#declared.services.set(tag, command);
      const service = new Service(this, services[0]);
      for (const each of service.interfaces.values()) {
        this.#interfaces.set(each.tag, each);
        each.setStatus(true);
      }
      return service;
    } finally {
      this.#early.delete(prefix);
      for (const again of early) again();
    }
  }

  /** Use a service no longer; see `Service.leave`. */
  async leaveService(service) {
    for (const { tag } of service.interfaces.values()) {
      this.#interfaces.get(tag)?.end(null);
      this.#interfaces.delete(tag);
    }
    this.#declared.services.delete(service.tag);
    await this.#session.execute(["leaveServices", { containerTag: service.tag }]).catch((error) => {
      if (!(error instanceof NotFound)) throw error;
    });
  }

  // --- interfaces; `to` is the `endpoint/interface` to connect to

  async publisher(tag, typeName, options = {}) {
    const { offline = "drop" } = options;
    if (!["drop", "newest", "store"].includes(offline)) {
      throw new InvalidRequest(`offline: ${JSON.stringify(offline)}: write drop, newest or store`);
    }
    const Kind = offline === "drop" ? Publisher : StoringPublisher;
    return this.#add(new Kind(this, tag, typeName, options), "Subscriber", options);
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

  actionClient(tag, typeName, options = {}) {
    return this.#add(new ActionClient(this, tag, typeName), "ActionProvider", options);
  }

  actionServer(tag, typeName, handler, options = {}) {
    return this.#add(new ActionServer(this, tag, typeName, handler, options.accept), "ActionClient", options);
  }

  /** Add the interface and connect it to `to`; remove it again if that fails. */
  async #add(added, kind, { to = "", raw = false, format, qos, delivery, codec }) {
    const { tag, typeName } = added;
    if (this.#interfaces.has(tag)) throw new AlreadyExists(`${this.name}/${tag} exists already: close it first`);
    this.#interfaces.set(tag, added);
    try {
      const interfaceType = kind + (raw ? "Forwarder" : "Converter");
      await this.addInterface(this.name, tag, interfaceType, typeName, { qos, format, delivery, codec });
    } catch (error) {
      this.#interfaces.delete(tag);
      added.end(null);
      throw error;
    }
    if (to) {
      try {
        await this.connect(to, `${this.name}/${tag}`);
        if (!added.wasConnected) await added.waitConnected(); // its peer may have gone before the acknowledgement
      } catch (error) {
        await added.close();
        throw error;
      }
    }
    return added;
  }

  // --- called by the session

  messageReceived(data, blobs) {
    if (!this.#interfaces.has(data.iTag)) this.#keep(data.iTag, () => this.messageReceived(data, blobs));
    return this.#interfaces.get(data.iTag)?.receive(data, blobs);
  }

  statusReceived(status) {
    if (status.topic === "iu") {
      if (!this.#interfaces.has(status.iTag)) this.#keep(status.iTag, () => this.statusReceived(status));
      this.#interfaces.get(status.iTag)?.setStatus(status.status);
      return;
    }
    if (status.topic === "connection" && status.state === "gone") {
      this.#declared.connections.delete(pairOf(status));
    }
    this.#publish(status);
  }

  errorReceived(error) {
    const msgId = error.fields?.msgID;
    const interfaces = [...this.#interfaces.values()];
    if (msgId !== undefined && interfaces.some((each) => each.failCall(error, msgId))) return;
    this.#publish({ topic: "error", error });
  }

  disconnected(reason) {
    for (const each of this.#interfaces.values()) each.disconnected();
    this.#publish({ topic: "disconnected", reason });
  }

  reconnected(resumed, statuses) {
    for (const each of this.#interfaces.values()) each.setStatus(Boolean(statuses[each.tag]));
    this.#publish({ topic: "reconnected", resumed });
  }

  declarations() {
    const { interfaces, counterparts, connections, services } = this.#declared;
    const connected = new Set([...connections.values()].flatMap(([, { tagA, tagB }]) => [tagA, tagB]));
    const added = [...counterparts].filter(([tag]) => connected.has(tag)).map(([, command]) => command);
    return [...interfaces.values(), ...added, ...connections.values(), ...services.values()];
  }

  ended(error) {
    for (const each of this.#interfaces.values()) each.end(error);
    for (const reader of this.#readers) reader.end(error);
  }

  #keep(tag, again) {
    for (const [prefix, early] of this.#early) {
      if (tag.startsWith(prefix)) early.push(again);
      if (early.length > EARLY) early.shift();
    }
  }

  #publish(event) {
    for (const reader of this.#readers) {
      if (reader.ended) this.#readers.delete(reader);
      else reader.put(event);
    }
  }

  /**
   * Record what belongs to this robot after a command was executed, so that a new session can restore it: its own
   * interfaces, those that it is connected with in environments, and its connections.
   */
  #record(command) {
    const [list, item] = command;
    const { interfaces, counterparts, connections } = this.#declared;
    const forget = (isRemoved) => {
      for (const of of [interfaces, counterparts]) for (const tag of of.keys()) if (isRemoved(tag)) of.delete(tag);
      for (const [pair, [, { tagA, tagB }]] of connections) {
        if (isRemoved(tagA) || isRemoved(tagB)) connections.delete(pair);
      }
    };
    if (list === "addInterfaces") {
      (this.#isOwn(item) ? interfaces : counterparts).set(`${item.endpointTag}/${item.interfaceTag}`, command);
    } else if (list === "removeInterfaces") forget((tag) => tag === `${item.endpointTag}/${item.interfaceTag}`);
    else if (list === "DC") forget((tag) => tag.startsWith(`${item.containerTag}/`));
    else if (list === "disconnect") connections.delete(pairOf(item));
    else if (list === "connect" && [item.tagA, item.tagB].some((tag) => tag.startsWith(`${this.name}/`))) {
      connections.set(pairOf(item), command);
    }
  }

  /** Record an interface of an environment that could not be added because it exists. */
  #recordExisting([list, item]) {
    if (list === "addInterfaces" && !this.#isOwn(item)) this.#record([list, item]);
  }

  /** Whether an interface ends with the robot: its own and, for a guest, its own in environments. */
  #isOwn({ endpointTag, interfaceTag }) {
    return endpointTag === this.name || (this.isGuest && interfaceTag.startsWith(`${this.name}.`));
  }
}

/** Key of a connection, whatever the order of its ends. */
function pairOf({ tagA, tagB }) {
  return [tagA, tagB].sort().join(" ");
}
