// Session of a robot: reconnects whenever the socket breaks and carries its commands across connections.
//
// A command whose socket breaks before the answer is sent again on the next connection. If the answer to the repetition
// says that the work was done already, the command has succeeded. So a command ends with its own result, with TimedOut,
// or with the error by which the platform refused the robot.

import { Connection } from "./connection.js";
import { entries } from "./entries.js";
import { AlreadyExists, Forbidden, InvalidRequest, NotConnected, NotFound, RceError, TimedOut, Unauthorized, Unavailable,
  UnknownType, refusal, within } from "./errors.js";
import { encode } from "./values.js";

const VERSION = "20130902";
const FEATURES = "ack,events,parts,resume";
const COMMANDS = " commands"; // their source in the outbox; a tag cannot contain a space
const MAY_COME_BACK = [NotFound, UnknownType, TimedOut]; // errors of declarations whose peer or environment is away
const FINAL = [Unauthorized, Forbidden, NotFound]; // refusals that no further attempt resolves
const [MIN_DELAY, MAX_DELAY] = [0.1, 10]; // seconds between attempts to reconnect; the first attempt is immediate
const ATTEMPT = 3; // seconds, and five round trips, of an attempt while the session may be resumed
const RESUME_DELAY = 0.4; // seconds between these attempts at most
const LISTS = { connect: "CX", disconnect: "CX" };
const REMOVALS = new Set([
  "DC", "removeNodes", "removeInterfaces", "deleteParam", "removeRecorders", "leaveServices", "disconnect"]);

/** Session that lasts from `open` until `close`, or until the platform refuses the robot. */
export class ClientSession {
  connection = null;
  #listener;
  #options;
  #requests = new Map(); // by the id of their frame
  #lastId = 0;
  #token = "";
  #endpoint = "";
  #unrestored = new Set(); // declarations of the session that are not answered yet, or that are to be repeated
  #roundTrip = 0; // seconds, of the last connection
  #resumable = 0; // time until which the platform keeps the session
  #state = "new"; // then "open", "ended"
  #error = new Unavailable("the robot is not connected: call open() first");

  /**
   * `options`: url, user, robot, owner, key or password, timeout, WebSocket. `listener` is the robot, with the methods
   * messageReceived, statusReceived, errorReceived, disconnected, reconnected, declarations and ended.
   */
  constructor(options, listener) {
    this.#options = options;
    this.#listener = listener;
  }

  /** Connect for the first time; may be called again after a failure. */
  async open() {
    if (this.#state !== "new") throw new InvalidRequest("this robot has been opened before: make a new one");
    this.#state = "open";
    try {
      this.#adopt(await this.#connect());
    } catch (error) {
      this.#state = "new";
      throw error;
    }
  }

  /** Send the queued frames and end the session; pending commands reject with Unavailable. */
  async close() {
    if (this.#state !== "open") return;
    await this.connection?.flush();
    const connection = this.connection;
    this.#end(null);
    await connection?.close();
  }

  /**
   * Send a command, `[list, item]`, wait until it has been executed, and return the acknowledgement. Commands are sent in
   * the order of calls.
   */
  async execute(command) {
    if (this.#state !== "open") throw this.#error;
    return this.#outcome(this.#submit(command, false));
  }

  // --- called by the connection

  messageReceived(data, blobs) {
    this.#listener.messageReceived(data, blobs);
  }

  statusReceived(data, id) {
    if (data.topic === "ack") {
      if (!this.connection?.answer(id, null)) this.#requests.get(id)?.resolve(data);
    } else if (data.topic !== "session") this.#listener.statusReceived(data);
  }

  failureReceived(frame) {
    const error = frame.error ? RceError.of(frame.error) : new RceError(String(frame.data));
    if (this.connection?.answer(frame.id, error) && error instanceof NotConnected) return; // it is sent again
    const request = this.#requests.get(frame.id);
    if (!request) this.#listener.errorReceived(error);
    else if ((request.restores || request.attempts > 1) && alreadyDone(request.command, error)) request.resolve();
    else request.reject(error);
  }

  frameInvalid(error) {
    this.#listener.errorReceived(error);
  }

  connectionClosed(reason, connection) {
    if (this.#state !== "open" || connection !== this.connection) return;
    this.connection = null;
    this.#roundTrip = connection.roundTrip;
    this.#resumable = performance.now() + 1000 * (connection.session.grace ?? 0);
    for (const [id, request] of this.#requests) {
      if (request.restores) { // the next connection determines anew which declarations are missing
        this.#requests.delete(id);
        request.resolve();
      }
    }
    this.#listener.disconnected(reason);
    this.#reconnect();
  }

  // --- commands

  #submit(command, restores) {
    const request = { id: (this.#lastId += 1), command, restores, attempts: 0 };
    request.done = new Promise((resolve, reject) => Object.assign(request, { resolve, reject }));
    request.done.catch(() => {}); // reported by #outcome
    this.#requests.set(request.id, request);
    this.#send(request);
    return request;
  }

  async #outcome(request) {
    const seconds = this.#options.timeout;
    const timeout = () => new TimedOut(`${request.command[0]} was not answered within ${seconds} s`);
    try {
      return await within(request.done, seconds, timeout);
    } finally {
      this.#requests.delete(request.id);
    }
  }

  #send(request) {
    if (!this.connection) return;
    request.attempts += 1;
    const [list, item] = request.command;
    const frame = list === "CC" || list === "DC"
      ? { type: list, data: item } : { type: LISTS[list] ?? "CN", data: { [list]: [item] } };
    this.connection.put(COMMANDS, encode({ ...frame, id: request.id }));
  }

  // --- connections

  /** Connect to the endpoint that may still hold the session, else to the one that the entry assigns. */
  async #connect() {
    const { WebSocket, user, robot, owner } = this.#options;
    const query = { userID: user, robotID: robot, ...(owner && { owner }), ...(await this.#secret()), features: FEATURES,
      refuse: "close" };
    if (this.#token) {
      try {
        const seconds = ATTEMPT + 5 * this.#roundTrip;
        return await Connection.open(WebSocket, this.#endpoint, { ...query, resume: this.#token }, this, seconds);
      } catch (error) {
        if (!(error instanceof Unavailable || error instanceof InvalidRequest)) throw error;
      }
      if (this.#state !== "open") throw this.#error;
      query.resume = this.#token;
    }
    return Connection.open(WebSocket, await this.#locate(), query, this);
  }

  /** Ask the Master's entry for an endpoint; of several Masters, the one that leads answers. */
  async #locate() {
    const asked = entries(this.#options.url).map((url) => this.#locateAt(url));
    try {
      return await Promise.any(asked);
    } catch ({ errors }) {
      throw errors.find((error) => !(error instanceof Unavailable)) ?? errors[0];
    }
  }

  async #locateAt(entry) {
    const url = new URL(entry, globalThis.location?.href);
    url.search = new URLSearchParams({ userID: this.#options.user, version: VERSION });
    let answer;
    try {
      answer = await fetch(url, { credentials: "omit", cache: "no-store", signal: AbortSignal.timeout(10_000) });
    } catch (error) {
      throw new Unavailable(`cannot reach ${url.origin}: ${error.message}`);
    }
    if (answer.status === 404) throw new Unavailable(`${url.origin} has no entry of an RCE platform at ${url.pathname}`);
    if (!answer.ok) throw refusal(answer.status, await answer.text());
    const endpoint = (await answer.json().catch(() => ({}))).url;
    if (!endpoint) {
      throw new Unavailable(`${url.origin} is not the entry of an RCE platform: its answer contains no url`);
    }
    return endpoint;
  }

  async #secret() {
    const { key, password } = this.#options;
    if (key) return { key };
    if (!globalThis.crypto?.subtle) {
      throw new InvalidRequest("a password can be used only on pages from https or localhost: use an API key");
    }
    const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", new TextEncoder().encode(password)));
    return { password: Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("") };
  }

  #adopt(connection) {
    if (this.#state !== "open") {
      connection.close();
      throw this.#error;
    }
    this.#token = connection.session.token ?? "";
    this.#endpoint = connection.endpoint;
    this.connection = connection;
  }

  /** Retry until a connection is made or the platform refuses the robot. */
  async #reconnect() {
    let delay = 0;
    while (this.#state === "open") {
      try {
        this.#adopt(await this.#connect());
        const { resumed, interfaces } = this.connection.session;
        this.#listener.reconnected(Boolean(resumed), interfaces ?? {});
        this.#restore(Boolean(resumed));
        return;
      } catch (error) {
        if (FINAL.some((kind) => error instanceof kind) || !(error instanceof RceError)) {
          this.#end(error);
          return;
        }
      }
      if (performance.now() < this.#resumable) delay = Math.min(delay, RESUME_DELAY);
      const pause = delay * (0.5 + Math.random() / 2); // jitter: many robots must not reconnect at the same moment
      await new Promise((resolve) => { setTimeout(resolve, pause * 1000); });
      delay = Math.min(2 * delay || MIN_DELAY, MAX_DELAY);
    }
  }

  /** Declare again what the platform no longer has, then repeat the pending commands, all in their order. */
  #restore(resumed) {
    const pending = [...this.#requests.values()];
    const declarations = this.#listener.declarations();
    const missing = resumed ? declarations.filter((command) => this.#unrestored.has(command)) : declarations;
    this.#unrestored = new Set(missing);
    for (const command of missing) this.#redeclare(this.#submit(command, true));
    for (const request of pending) this.#send(request);
  }

  /** Wait for the answer to a declaration; repeat it while what it needs, as the peer, is not back yet. */
  async #redeclare(request) {
    const { connection } = this;
    let [delay, reported] = [MIN_DELAY, false];
    for (;;) {
      let error = null;
      await this.#outcome(request).catch((reason) => { error = reason; });
      if (this.connection !== connection) return; // it is declared on the next connection
      const isAway = error instanceof Unavailable;
      if (error && !isAway) {
        if (!reported) this.#listener.errorReceived(error);
        reported = true;
      }
      if (!isAway && !MAY_COME_BACK.some((kind) => error instanceof kind)) {
        this.#unrestored.delete(request.command);
        return;
      }
      await new Promise((resolve) => { setTimeout(resolve, delay * 1000); });
      delay = Math.min(2 * delay, MAX_DELAY);
      if (this.connection !== connection || !this.#listener.declarations().includes(request.command)) return;
      request = this.#submit(request.command, true);
    }
  }

  #end(error) {
    if (this.#state === "ended") return;
    this.#state = "ended";
    this.connection = null;
    this.#error = error ?? new Unavailable("the robot has been closed");
    for (const request of this.#requests.values()) request.reject(this.#error);
    this.#listener.ended(error);
  }
}

/** True if `error`, the answer to a repeated command, means that an earlier attempt was executed. */
function alreadyDone([list], error) {
  if (list === "useServices") return false; // the platform answers it again, with the interfaces
  return error instanceof (REMOVALS.has(list) ? NotFound : AlreadyExists);
}
