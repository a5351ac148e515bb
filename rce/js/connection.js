// One WebSocket to a Robot endpoint: frames out in turns between the interfaces, frames in with their blobs.

import { Assembler, binaryFrames } from "./blobs.js";
import { InternalError, RceError, Unavailable, refusal, within } from "./errors.js";
import { Outbox } from "./outbox.js";
import { decode } from "./values.js";

const OPEN_TIMEOUT = 10; // seconds
const FLUSH_TIMEOUT = 5;
const CLOSE_TIMEOUT = 2;
const WRITE_LIMIT = 64 * 1024; // bytes that may wait in the socket: what is there cannot be overtaken
const LOOK_AGAIN = 4; // milliseconds; no event tells that a socket has room again
const REFUSED = 4000; // close codes of a refused robot are this plus the HTTP status: scripts are not told that itself

export class Connection {
  #socket;
  #outbox = new Outbox((piece) => this.#send(piece));
  #assembler;
  #listener;
  #leave;
  #gone = new Promise((resolve) => { this.#leave = resolve; });

  /** Dial and wait for the session status. `listener` has message, status, failure, fault and closed. */
  static async open(WebSocket, endpoint, query, listener) {
    const url = new URL(endpoint);
    for (const [name, value] of Object.entries(query)) url.searchParams.set(name, value);
    let socket;
    try {
      socket = new WebSocket(url.href);
    } catch (error) {
      throw new Unavailable(`cannot open ${endpoint}: ${error.message}`);
    }
    const connection = new Connection(socket, endpoint, listener);
    const late = () => new Unavailable(`${endpoint} did not open a session within ${OPEN_TIMEOUT} s`);
    try {
      await within(connection.#opened(), OPEN_TIMEOUT, late);
    } catch (error) {
      socket.close();
      throw error;
    }
    return connection;
  }

  constructor(socket, endpoint, listener) {
    this.endpoint = endpoint;
    this.session = null;
    this.#socket = socket;
    this.#listener = listener;
    socket.binaryType = "arraybuffer";
    this.#assembler = new Assembler(
      (data, blobs) => listener.message(data, blobs), (error) => listener.fault(error));
  }

  get features() {
    return new Set(this.session.features);
  }

  /** Queue a text frame and the blobs that belong to it; at most `keep` of the source wait. How many were dropped. */
  put(source, text, blobs = new Map(), keep = Infinity) {
    return this.#outbox.put(source, pieces(text, blobs), keep);
  }

  room(source) {
    return this.#outbox.room(source);
  }

  /** Wait until what is queued has been sent, but not for long. */
  async flush() {
    const end = performance.now() + FLUSH_TIMEOUT * 1000;
    while ((!this.#outbox.empty || this.#socket.bufferedAmount) && performance.now() < end && this.#isOpen) {
      await new Promise((resolve) => { setTimeout(resolve, LOOK_AGAIN); });
    }
  }

  /** Close; 1000 says that the robot leaves for good, another code (3000 to 4999) that it comes back. */
  async close(code = 1000, reason = "") {
    this.#socket.close(code, reason);
    await Promise.race([this.#gone, new Promise((resolve) => { setTimeout(resolve, CLOSE_TIMEOUT * 1000); })]);
  }

  get #isOpen() {
    return this.#socket.readyState === 1;
  }

  #opened() {
    return new Promise((resolve, reject) => {
      this.#socket.onclose = ({ code, reason }) => {
        reject(code > REFUSED ? refusal(code - REFUSED, reason) : new Unavailable(
          `cannot reach ${this.endpoint}${reason ? `: ${reason}` : ""}`));
      };
      this.#socket.onerror = () => {}; // the close that follows says more
      this.#socket.onmessage = ({ data }) => {
        const frame = typeof data === "string" ? JSON.parse(data) : {};
        if (frame.type !== "ST" || frame.data.topic !== "session") {
          reject(new Unavailable(`the first frame of ${this.endpoint} is not the session status`));
          return;
        }
        this.session = frame.data;
        this.#socket.onmessage = (event) => this.#take(event.data);
        this.#socket.onclose = (event) => this.#closed(event);
        resolve();
      };
    });
  }

  #closed({ code, reason }) {
    this.#outbox.clear();
    this.#leave();
    this.#listener.closed(reason || `code ${code}`, this);
  }

  #send(piece) {
    if (!this.#isOpen) return false;
    this.#socket.send(piece);
    if (this.#socket.bufferedAmount <= WRITE_LIMIT) return true;
    this.#waitForRoom();
    return false;
  }

  #waitForRoom() {
    setTimeout(() => {
      if (!this.#isOpen) return;
      if (this.#socket.bufferedAmount > WRITE_LIMIT) this.#waitForRoom();
      else this.#outbox.resume();
    }, LOOK_AGAIN);
  }

  #take(payload) {
    try {
      if (typeof payload === "string") this.#text(payload);
      else this.#assembler.blob(payload);
    } catch (error) {
      this.#listener.fault(error instanceof RceError ? error : new InternalError(`the client failed: ${error.stack}`));
    }
  }

  #text(payload) {
    const frame = decode(payload);
    if (frame.type === "DM") this.#assembler.frame(frame.data, payload);
    else if (frame.type === "ST") this.#listener.status(frame.data, frame.id);
    else if (frame.type === "ER") this.#listener.failure(frame);
  }
}

function* pieces(text, blobs) {
  yield text;
  yield* binaryFrames(blobs);
}
