// Publisher whose messages are kept in memory until the platform has them.

import { LimitExceeded, NotConnected, Unavailable } from "./errors.js";
import { CONNECT_TIMEOUT, Publisher, TOPIC_ID } from "./interfaces.js";
import { detach, encode, freshId } from "./values.js";

const MAX_BYTES = 64 * 1024 * 1024; // of the messages that wait, above which the oldest are dropped
const RETRY = 100; // milliseconds until a message is sent again whose peer had just gone

/**
 * Keeps each message until the Robot endpoint has acknowledged it. Messages are sent in their order, and once: what was
 * not acknowledged when the socket broke is sent again, and the endpoint does not deliver what it has already. If that
 * endpoint itself has ended meanwhile, nobody knows whether it had them; then they are dropped, and counted.
 */
export class StoringPublisher extends Publisher {
  #newestOnly;
  #stream = freshId();
  #number = 0;
  #unsent = []; // messages in their order
  #written = new Map(); // messages by number that were written to the present connection, without an answer
  #bytes = 0; // of #unsent
  #sending = null; // the connection in whose queue the first message is
  #timer = null;

  constructor(robot, tag, typeName, options) {
    super(robot, tag, typeName, options);
    this.#newestOnly = options.offline === "newest";
  }

  /** Store a message. With `wait`, wait for a peer first, and then until the platform has the message. */
  async publish(value, timeout = CONNECT_TIMEOUT, wait = true) {
    if (wait || this.ended) await this.waitConnected(timeout);
    if (wait) await new Promise((resolve, reject) => { this.#put(value, { resolve, reject }); });
    else this.#put(value, {});
  }

  /** Store a message. Returns false if the publisher was closed. */
  offer(value) {
    if (!this.ended) this.#put(value, {});
    return !this.ended;
  }

  #put(value, settle) {
    const blobs = new Map();
    const body = encode(detach({ msg: value }, blobs));
    const bytes = body.length + [...blobs.values()].reduce((sum, blob) => sum + blob.byteLength, 0);
    const number = this.#number += 1;
    const message = { number, made: performance.now(), body, blobs, bytes, incarnation: "", ...settle };
    if (this.#newestOnly) while (this.#unsent.length) this.#dropFirst("a newer message took its place");
    this.#unsent.push(message);
    this.#bytes += bytes;
    while (this.#bytes > MAX_BYTES && this.#unsent.length > 1) this.#dropFirst("too many messages wait");
    this.#sendNext();
  }

  setStatus(connected) {
    super.setStatus(connected);
    this.#sendNext();
  }

  disconnected() {
    super.disconnected();
    this.#sending = null;
    this.#takeBack([...this.#written.values()]);
  }

  end(error) {
    super.end(error);
    clearTimeout(this.#timer);
    const reason = error ?? new Unavailable(`${this.tag} was closed before the platform had the message`);
    for (const message of [...this.#written.values(), ...this.#unsent]) message.reject?.(reason);
    this.#written.clear();
    this.#unsent = [];
  }

  /** Put messages that were written back to the front, in their order. */
  #takeBack(messages) {
    for (const message of messages) {
      this.#written.delete(message.number);
      this.#bytes += message.bytes;
    }
    this.#unsent = [...messages, ...this.#unsent].sort((one, other) => one.number - other.number);
  }

  #dropFirst(why) {
    this.#drop(this.#unsent[0], why);
    this.#bytes -= this.#unsent.shift().bytes;
  }

  #drop(message, why) {
    this.dropped += 1;
    message.reject?.(new LimitExceeded(`a message of ${this.tag} was dropped: ${why}`));
  }

  /** Queue the first message; the others wait here. */
  #sendNext() {
    const { connection } = this;
    if (!connection || this.#sending === connection) return;
    const { incarnation = "" } = connection.session;
    while (this.#unsent[0]?.incarnation && this.#unsent[0].incarnation !== incarnation) {
      this.#dropFirst("it is not known whether it arrived, since the Robot endpoint has ended");
    }
    if (!this.#unsent.length) return;
    const early = this.nextTime - performance.now();
    if (early > 0) {
      this.#sendLater(early);
      return;
    }
    const [message] = this.#unsent;
    const id = `${this.tag}/${message.number}`;
    this.#sending = connection;
    this.began();
    connection.put(this.tag, this.#frame(message, id), message.blobs, {
      priority: this.delivery.priority, mayStart: () => this.#begin(connection, message, id) });
  }

  #sendLater(milliseconds) {
    this.#timer ??= setTimeout(() => {
      this.#timer = null;
      this.#sendNext();
    }, milliseconds);
  }

  #frame({ number, body }, id) {
    const head = JSON.stringify({ iTag: this.tag, type: this.typeName, msgID: TOPIC_ID, stream: this.#stream, number });
    return `{"type":"DM","id":${JSON.stringify(id)},"data":${head.slice(0, -1)},${body.slice(1)}}`;
  }

  /** Take note that a message is written now; returns false to drop it. */
  #begin(connection, message, id) {
    this.#sending = null;
    queueMicrotask(() => this.#sendNext());
    if (this.#unsent[0] !== message) return false; // it gave way
    if (!this.inTime(message.made)) {
      this.#dropFirst("it is too old");
      return false;
    }
    this.#unsent.shift();
    this.#bytes -= message.bytes;
    this.#written.set(message.number, message);
    message.incarnation = connection.session.incarnation ?? "";
    connection.expect(id, (error) => this.#answered(message, error));
    return true;
  }

  #answered(message, error) {
    if (!this.#written.has(message.number)) return;
    if (error instanceof NotConnected) { // the peer had just gone
      this.#takeBack([message]);
      this.#sendLater(RETRY);
      return;
    }
    this.#written.delete(message.number);
    if (error) message.reject?.(error);
    else message.resolve?.();
  }
}
