// Publishers, subscribers, service clients and providers of a robot, made by the methods of Robot and Environment.

import { ConversionError, NotConnected, RceError, TimedOut, Unavailable, within } from "./errors.js";
import { Stream } from "./stream.js";
import { attach, detach, encode, floats, freshId } from "./values.js";

export const CONNECT_TIMEOUT = 10; // seconds
export const TOPIC_ID = "nil"; // msgID of topic messages, as the original's clients send it

/** Base of all interfaces of a robot. */
export class Interface {
  #open = false;
  #met = false; // it has had a peer
  #status = false;
  #waiting = [];
  #ended = null;

  constructor(robot, tag, typeName) {
    this.robot = robot;
    this.tag = tag;
    this.typeName = typeName;
  }

  /** True while the robot is online and the interface has a peer that is online too. */
  get connected() {
    return this.#open;
  }

  /** True once the interface has had a peer, which may be gone again. */
  get wasConnected() {
    return this.#met;
  }

  /** Wait for a peer. Rejects with NotConnected after `timeout` seconds. */
  async waitConnected(timeout = CONNECT_TIMEOUT) {
    if (!this.#open && !this.#ended) {
      const opened = new Promise((resolve) => { this.#waiting.push(resolve); });
      await within(opened, timeout, () => new NotConnected(
        `${this.robot.name}/${this.tag} has had no peer for ${timeout} s: connect it to an existing interface`));
    }
    if (this.#ended) throw this.#ended;
  }

  /** Remove the interface and its connections. */
  async close() {
    await this.robot.removeInterface(this.robot.name, this.tag);
  }

  /** The connection, or null while nothing can be sent. */
  get connection() {
    return this.#open && !this.#ended ? this.robot.connection : null;
  }

  /** Queue a message; returns how many older ones were dropped for it. For `options` see `Connection.put`. */
  send(msgId, value, options = {}) {
    const blobs = new Map();
    const data = { iTag: this.tag, type: this.typeName, msgID: msgId, ...detach({ msg: value }, blobs) };
    return this.robot.connection.put(this.tag, encode({ type: "DM", data }), blobs, options);
  }

  /** Send a message about a goal, with `msg` as its value; nothing while the robot is offline. */
  report(id, phase, more = {}) {
    if (!this.robot.connected) return;
    const blobs = new Map();
    const data = { iTag: this.tag, type: this.typeName, msgID: id, phase, ...detach(more, blobs) };
    this.robot.connection.put(this.tag, encode({ type: "DM", data }), blobs);
  }

  /** True when nothing is sent or received any more. */
  get ended() {
    return this.#ended !== null;
  }

  // Called by the robot.

  /** Handle the platform's report about the peer. */
  setStatus(connected) {
    this.#status = connected;
    this.#changed(this.#status);
  }

  /** Handle the loss of the robot's socket. */
  disconnected() {
    this.#changed(false);
  }

  /** Finish for good. */
  end(error) {
    this.#ended = error ?? new Unavailable(`${this.robot.name}/${this.tag} has been closed`);
    this.#changed(true);
    this.#open = false;
  }

  /** Fail the pending call with this msgID; returns false if it is not one of this interface. */
  failCall() {
    return false;
  }

  #changed(open) {
    this.#open = open && (this.robot.connected || this.#ended !== null);
    this.#met ||= this.#open;
    if (this.#open) for (const resolve of this.#waiting.splice(0)) resolve();
  }
}

/** Sends messages. Those that had not reached the platform when the socket broke are lost; none is sent twice. */
export class Publisher extends Interface {
  dropped = 0;
  nextTime = 0; // from which the next message may be sent

  constructor(robot, tag, typeName, { delivery = {} } = {}) {
    super(robot, tag, typeName);
    this.delivery = delivery;
  }

  /** Send a message (an object or bytes) after waiting for a peer, for room in the queue, and for its turn. */
  async publish(value, timeout = CONNECT_TIMEOUT, wait = true) {
    if (!wait) {
      this.offer(value);
      return;
    }
    for (;;) {
      await this.waitConnected(timeout);
      const early = this.nextTime - performance.now();
      const room = this.connection?.room(this.tag);
      if (this.connection && !room && early <= 0) break;
      await (early > 0 ? new Promise((resolve) => { setTimeout(resolve, early); }) : room);
    }
    this.#put(value, Infinity);
  }

  /** Send without waiting, so that at most `keep` messages are queued. Returns false if there is no peer. */
  offer(value, keep = 1) {
    if (!this.connection || performance.now() < this.nextTime) {
      this.dropped += 1;
      return false;
    }
    this.#put(value, keep);
    return true;
  }

  /** Note that a message is sent, for the rate. */
  began() {
    if (this.delivery.rate) this.nextTime = performance.now() + 1000 / this.delivery.rate;
  }

  /** True if a message of this time is not too old. */
  inTime(made) {
    return !this.delivery.maxAge || performance.now() <= made + 1000 * this.delivery.maxAge;
  }

  #put(value, keep) {
    const made = performance.now();
    this.began();
    const mayStart = () => {
      const inTime = this.inTime(made);
      if (!inTime) this.dropped += 1;
      return inTime;
    };
    const givenWay = this.send(TOPIC_ID, value, { keep, priority: this.delivery.priority, mayStart });
    this.dropped += givenWay; // not in one statement, because mayStart may run within the call
  }
}

const LARGE = /^sensor_msgs\/(msg\/)?(Image|CompressedImage|PointCloud2?)$/;

/** Receives messages: `for await`, `get`, or a callback. Keeps the newest `depth` unread messages. */
export class Subscriber extends Interface {
  constructor(robot, tag, typeName, { depth = 0, callback = null } = {}) {
    super(robot, tag, typeName);
    this.stream = new Stream(depth || (LARGE.test(typeName) ? 10 : 1000));
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

  receive(data, blobs) {
    const value = valueOf(data, blobs);
    if (this.callback) this.callback(value);
    else this.stream.put(value);
  }

  end(error) {
    super.end(error);
    this.stream.end(error);
  }
}

/** Calls a service. */
export class ServiceClient extends Interface {
  #calls = new Map(); // {resolve, reject} by msgID

  /**
   * Call the service and return its response. Rejects with the service's error, TimedOut, NotConnected, or Unavailable
   * if the socket broke meanwhile: then it is not known whether the call was executed.
   */
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

  receive(data, blobs) {
    const call = this.#calls.get(data.msgID);
    if (!call) return; // the call has timed out
    if (data.error) call.reject(new RceError(data.error));
    else call.resolve(valueOf(data, blobs));
  }

  failCall(error, msgId) {
    this.#calls.get(msgId)?.reject(error);
    return this.#calls.has(msgId);
  }

  disconnected() {
    super.disconnected();
    this.#failAll(new Unavailable(
      `the socket broke during the call of ${this.tag}: it is not known whether it was executed`));
  }

  end(error) {
    super.end(error);
    this.#failAll(error ?? new Unavailable("the robot has been closed"));
  }

  #failAll(error) {
    for (const call of this.#calls.values()) call.reject(error);
  }
}

/** Answers the calls of a service with the result of `handler` (or its promise), or with the error that it throws. */
export class ServiceProvider extends Interface {
  constructor(robot, tag, typeName, handler) {
    super(robot, tag, typeName);
    this.handler = handler;
  }

  async receive(data, blobs) {
    let answer;
    try {
      answer = { value: await this.handler(valueOf(data, blobs)) };
    } catch (error) {
      answer = { error: error instanceof RceError ? error.message : `${error?.name ?? "Error"}: ${error?.message}` };
    }
    if (!this.robot.connected) return;
    if (!answer.error) return void this.send(data.msgID, answer.value);
    const failure = { iTag: this.tag, type: this.typeName, msgID: data.msgID, error: answer.error };
    this.robot.connection.put(this.tag, encode({ type: "DM", data: failure }));
  }
}

/** The value of a DM, with bytes in place of blobs and floats for NaN and infinities, except in `String` messages. */
export function valueOf(data, blobs) {
  if (!("msg" in data) && !("msg*" in data)) {
    throw new ConversionError(`a message for ${data.iTag} has neither msg nor msg*`);
  }
  const wire = "msg" in data ? { msg: data.msg } : { "msg*": data["msg*"] };
  attach(wire, blobs);
  return (data.type.endsWith("/String") ? wire : floats(wire)).msg;
}
