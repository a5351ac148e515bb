// The robot's ends of topics and services. Made by `Robot` and `Environment`, which add and connect them.

import { ConversionError, NotConnected, RceError, TimedOut, Unavailable, within } from "./errors.js";
import { Stream } from "./stream.js";
import { attach, detach, encode, floats, freshId } from "./values.js";

const CONNECT_TIMEOUT = 10; // seconds
const TOPIC_ID = "nil"; // the msgID of topics, by convention

/** One interface of a robot. */
class Interface {
  #open = false;
  #status = false;
  #waiting = [];
  #ended = null;

  constructor(robot, tag, typeName) {
    this.robot = robot;
    this.tag = tag;
    this.typeName = typeName;
  }

  /** Whether it has a peer, at a platform that can be reached. */
  get connected() {
    return this.#open;
  }

  /** Wait for a peer. NotConnected after `timeout` seconds. */
  async waitConnected(timeout = CONNECT_TIMEOUT) {
    if (!this.#open && !this.#ended) {
      const opened = new Promise((resolve) => { this.#waiting.push(resolve); });
      await within(opened, timeout, () => new NotConnected(
        `${this.robot.name}/${this.tag} has had no peer for ${timeout} s: connect it to an interface that exists`));
    }
    if (this.#ended) throw this.#ended;
  }

  /** Remove the interface and its connections. */
  async close() {
    await this.robot.removeInterface(this.robot.name, this.tag);
  }

  /** The connection, if a message would have its way now. */
  get connection() {
    return this.#open && !this.#ended ? this.robot.connection : null;
  }

  send(msgId, value, keep = Infinity) {
    const blobs = new Map();
    const data = { iTag: this.tag, type: this.typeName, msgID: msgId, ...detach({ msg: value }, blobs) };
    return this.robot.connection.put(this.tag, encode({ type: "DM", data }), blobs, keep);
  }

  // What the robot tells its interfaces.

  status(connected) {
    this.#status = connected;
    this.#changed(this.#status);
  }

  lost() {
    this.#changed(false);
  }

  ended(error) {
    this.#ended = error ?? new Unavailable(`${this.robot.name}/${this.tag} has been closed`);
    this.#changed(true);
    this.#open = false;
  }

  /** Whether the call of this id was one of this interface's, which then fails. */
  failed() {
    return false;
  }

  #changed(open) {
    this.#open = open && (this.robot.connected || this.#ended !== null);
    if (this.#open) for (const resolve of this.#waiting.splice(0)) resolve();
  }
}

/** Sends messages of a topic. What had not arrived when the socket broke is lost, never sent twice. */
export class Publisher extends Interface {
  dropped = 0;

  /** Send a message, an object or bytes; waits for a peer and for room in the queue. NotConnected, InvalidRequest. */
  async publish(value, timeout = CONNECT_TIMEOUT) {
    for (;;) {
      await this.waitConnected(timeout);
      const room = this.connection?.room(this.tag);
      if (this.connection && !room) break;
      await room;
    }
    this.send(TOPIC_ID, value);
  }

  /** Send without waiting, at most `keep` of this interface wait. False if it was dropped because there is no peer. */
  offer(value, keep = 1) {
    if (!this.connection) {
      this.dropped += 1;
      return false;
    }
    this.dropped += this.send(TOPIC_ID, value, keep);
    return true;
  }
}

/** Receives messages of a topic: `for await`, `get`, or a callback. Keeps the newest `depth` that were not taken. */
export class Subscriber extends Interface {
  constructor(robot, tag, typeName, { depth = 10, callback = null } = {}) {
    super(robot, tag, typeName);
    this.stream = new Stream(depth);
    this.callback = callback;
  }

  get dropped() {
    return this.stream.dropped;
  }

  get(timeout) {
    return this.stream.get(timeout);
  }

  [Symbol.asyncIterator]() {
    return this.stream[Symbol.asyncIterator]();
  }

  received(data, blobs) {
    const value = valueOf(data, blobs);
    if (this.callback) this.callback(value);
    else this.stream.put(value);
  }

  ended(error) {
    super.ended(error);
    this.stream.end(error);
  }
}

/** Calls a service. */
export class ServiceClient extends Interface {
  #calls = new Map(); // {resolve, reject} by msgID

  /** The response to `request`. Rejects with what the service answered, TimedOut, NotConnected, or Unavailable if the
   * socket broke meanwhile: then it is not known whether the call was carried out. */
  async call(request, timeout = CONNECT_TIMEOUT) {
    await this.waitConnected(timeout);
    if (!this.connection) throw new Unavailable(`the socket broke before ${this.tag} was called`);
    const id = freshId();
    const response = new Promise((resolve, reject) => { this.#calls.set(id, { resolve, reject }); });
    try {
      this.send(id, request);
      return await within(response, timeout, () => new TimedOut(
        `service ${this.tag} (${this.typeName}) did not answer within ${timeout} s`));
    } finally {
      this.#calls.delete(id);
    }
  }

  received(data, blobs) {
    const call = this.#calls.get(data.msgID);
    if (!call) return; // too late: its caller has given up
    if (data.error) call.reject(new RceError(data.error));
    else call.resolve(valueOf(data, blobs));
  }

  failed(error, msgId) {
    this.#calls.get(msgId)?.reject(error);
    return this.#calls.has(msgId);
  }

  lost() {
    super.lost();
    this.#fail(new Unavailable(`the socket broke while ${this.tag} was called: whether that was done is not known`));
  }

  ended(error) {
    super.ended(error);
    this.#fail(error ?? new Unavailable("the robot has been closed"));
  }

  #fail(error) {
    for (const call of this.#calls.values()) call.reject(error);
  }
}

/** Answers the calls of a service with what `handler` returns (a promise too), or with the error that it throws. */
export class ServiceProvider extends Interface {
  constructor(robot, tag, typeName, handler) {
    super(robot, tag, typeName);
    this.handler = handler;
  }

  async received(data, blobs) {
    let answer;
    try {
      answer = { value: await this.handler(valueOf(data, blobs)) };
    } catch (error) {
      answer = { error: error instanceof RceError ? error.message : `${error?.name ?? "Error"}: ${error?.message}` };
    }
    if (!this.robot.connected) return;
    if (!answer.error) return void this.send(data.msgID, answer.value);
    const refused = { iTag: this.tag, type: this.typeName, msgID: data.msgID, error: answer.error };
    this.robot.connection.put(this.tag, encode({ type: "DM", data: refused }));
  }
}

/** The value of a DM: bytes where it is or has a blob; only in a `String` message "NaN" stays a string. */
function valueOf(data, blobs) {
  if (!("msg" in data) && !("msg*" in data)) throw new ConversionError(`a message of ${data.iTag} came without a value`);
  const wire = "msg" in data ? { msg: data.msg } : { "msg*": data["msg*"] };
  attach(wire, blobs);
  return (data.type.endsWith("/String") ? wire : floats(wire)).msg;
}
