// A robot's session: connected again whenever the socket breaks, and the commands that are under way on it.
//
// A command whose socket broke before its answer came is sent again on the next one; when the answer then says that the
// work was done already, it counts as done. So a command ends with its result, with TimedOut, or with why the robot is
// not let in any more.

import { Connection } from "./connection.js";
import { AlreadyExists, Forbidden, InvalidRequest, NotFound, RceError, TimedOut, Unauthorized, Unavailable, refusal,
  within } from "./errors.js";
import { encode } from "./values.js";

const VERSION = "20130902";
const FEATURES = "ack,events,parts,resume";
const COMMANDS = " commands"; // as a source of the outbox; no tag has a blank
const [MIN_DELAY, MAX_DELAY] = [0.1, 10]; // seconds between attempts to reconnect, after a first one at once
const LISTS = { connect: "CX", disconnect: "CX" };
const UNDOING = new Set(["DC", "removeNodes", "removeInterfaces", "deleteParam", "disconnect"]);

export class Session {
  connection = null;
  #listener;
  #options;
  #requests = new Map(); // by the id of their frame
  #lastId = 0;
  #token = "";
  #endpoint = "";
  #state = "new"; // then "open", "ended"
  #error = new Unavailable("the robot is not connected");

  /** `options`: url, user, robot, owner, key or password, timeout, WebSocket. `listener` is the robot. */
  constructor(options, listener) {
    this.#options = options;
    this.#listener = listener;
  }

  async open() {
    if (this.#state !== "new") throw new InvalidRequest("this robot has been opened before: make a new one");
    this.#state = "open";
    try {
      this.#begin(await this.#connect());
    } catch (error) {
      this.#state = "new";
      throw error;
    }
  }

  async close() {
    if (this.#state !== "open") return;
    await this.connection?.flush();
    const connection = this.connection;
    this.#end(null);
    await connection?.close();
  }

  /** Send a command, `[list, item]`, and wait for its end. Commands leave in the order of these calls. */
  async carryOut(command) {
    if (this.#state !== "open") throw this.#error;
    await this.#outcome(this.#submit(command, false));
  }

  // --- what the connection tells

  message(data, blobs) {
    this.#listener.received(data, blobs);
  }

  status(data, id) {
    if (data.topic === "ack") this.#requests.get(id)?.resolve();
    else if (data.topic !== "session") this.#listener.status(data);
  }

  failure(frame) {
    const error = frame.error ? RceError.of(frame.error) : new RceError(String(frame.data));
    const request = this.#requests.get(frame.id);
    if (!request) this.#listener.failed(error);
    else if ((request.restores || request.attempts > 1) && repetitionDone(request.command, error)) request.resolve();
    else request.reject(error);
  }

  fault(error) {
    this.#listener.failed(error);
  }

  closed(reason, connection) {
    if (this.#state !== "open" || connection !== this.connection) return;
    this.connection = null;
    for (const [id, request] of this.#requests) {
      if (request.restores) { // what is missing then is found out anew
        this.#requests.delete(id);
        request.resolve();
      }
    }
    this.#listener.lost(reason);
    this.#comeBack();
  }

  // --- commands

  #submit(command, restores) {
    const request = { id: (this.#lastId += 1), command, restores, attempts: 0 };
    request.done = new Promise((resolve, reject) => Object.assign(request, { resolve, reject }));
    request.done.catch(() => {}); // whoever waits for it hears of it
    this.#requests.set(request.id, request);
    this.#send(request);
    return request;
  }

  async #outcome(request) {
    const seconds = this.#options.timeout;
    const late = () => new TimedOut(`${request.command[0]} was not answered within ${seconds} s`);
    try {
      await within(request.done, seconds, late);
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

  /** The endpoint that may still hold the session, else the one that the entry names. */
  async #connect() {
    const { WebSocket, user, robot, owner } = this.#options;
    const query = { userID: user, robotID: robot, ...(owner && { owner }), ...(await this.#secret()), features: FEATURES,
      refuse: "close" };
    if (this.#token) {
      try {
        return await Connection.open(WebSocket, this.#endpoint, { ...query, resume: this.#token }, this);
      } catch (error) {
        if (!(error instanceof Unavailable || error instanceof InvalidRequest)) throw error;
      }
      query.resume = this.#token;
    }
    return Connection.open(WebSocket, await this.#locate(), query, this);
  }

  async #locate() {
    const url = new URL(this.#options.url, globalThis.location?.href);
    url.search = new URLSearchParams({ userID: this.#options.user, version: VERSION });
    let answer;
    try {
      answer = await fetch(url, { credentials: "omit", cache: "no-store", signal: AbortSignal.timeout(10_000) });
    } catch (error) {
      throw new Unavailable(`cannot reach ${url.origin}: ${error.message}`);
    }
    if (!answer.ok) throw refusal(answer.status, await answer.text());
    const endpoint = (await answer.json().catch(() => ({}))).url;
    if (!endpoint) throw new Unavailable(`${url.origin} is not the entry of a platform: it answered no url`);
    return endpoint;
  }

  async #secret() {
    const { key, password } = this.#options;
    if (key) return { key };
    if (!globalThis.crypto?.subtle) {
      throw new InvalidRequest("a password needs a page that came by https or from localhost: use an API key");
    }
    const hash = new Uint8Array(await crypto.subtle.digest("SHA-256", new TextEncoder().encode(password)));
    return { password: Array.from(hash, (byte) => byte.toString(16).padStart(2, "0")).join("") };
  }

  #begin(connection) {
    if (this.#state !== "open") {
      connection.close();
      throw this.#error;
    }
    this.#token = connection.session.token ?? "";
    this.#endpoint = connection.endpoint;
    this.connection = connection;
  }

  /** A new connection, however long that takes; to try again does not help where the robot is not let in any more. */
  async #comeBack() {
    let delay = 0;
    while (this.#state === "open") {
      try {
        this.#begin(await this.#connect());
        const { resumed, interfaces } = this.connection.session;
        this.#listener.back(Boolean(resumed), interfaces ?? {});
        this.#restore(Boolean(resumed));
        return;
      } catch (error) {
        if (error instanceof Unauthorized || error instanceof Forbidden || !(error instanceof RceError)) {
          this.#end(error);
          return;
        }
      }
      const pause = delay * (0.5 + Math.random() / 2); // so that many robots do not come at once
      await new Promise((resolve) => { setTimeout(resolve, pause * 1000); });
      delay = Math.min(2 * delay || MIN_DELAY, MAX_DELAY);
    }
  }

  /** Declare again what is gone, then repeat the commands under way, all in their order. */
  #restore(resumed) {
    const underWay = [...this.#requests.values()];
    if (!resumed) for (const command of this.#listener.declared()) this.#redeclare(this.#submit(command, true));
    for (const request of underWay) this.#send(request);
  }

  async #redeclare(request) {
    let delay = MIN_DELAY;
    while (this.connection) {
      try {
        return await this.#outcome(request);
      } catch (error) {
        if (!(error instanceof Unavailable)) return this.#listener.failed(error);
      }
      await new Promise((resolve) => { setTimeout(resolve, delay * 1000); });
      delay = Math.min(2 * delay, MAX_DELAY);
      if (this.connection) request = this.#submit(request.command, true);
    }
    return undefined;
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

/** Whether `error`, the answer to a command sent twice, says that the first one was carried out. */
function repetitionDone([list], error) {
  return error instanceof (UNDOING.has(list) ? NotFound : AlreadyExists);
}
