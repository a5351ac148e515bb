// WebSocket connection to a Robot endpoint. Outgoing frames go through an outbox that takes turns between the
// interfaces; incoming text frames are joined with their blobs.

import { Assembler, binaryFrames } from "./blobs.js";
import { InternalError, RceError, Unavailable, refusal, within } from "./errors.js";
import { LineWatch } from "./line.js";
import { Outbox } from "./outbox.js";
import { decode } from "./values.js";

const OPEN_TIMEOUT = 10; // seconds
const FLUSH_TIMEOUT = 5;
const CLOSE_TIMEOUT = 2;
const WRITE_LIMIT = 64 * 1024; // bytes that may be buffered in the socket, where small frames cannot overtake them
const POLL_INTERVAL = 4; // milliseconds; WebSocket has no event for room in its buffer
const DEAD = 3000; // close code that keeps the session for a reconnection
const PROBE = '{"type":"CX","id":"probe","data":{}}'; // a command that does nothing, and is acknowledged
const REFUSED = 4000; // plus the HTTP status: close codes of a refusal, since scripts cannot read the status itself

/** Open WebSocket with its session. */
export class Connection {
  #socket;
  #outbox = new Outbox((piece) => this.#send(piece));
  #assembler;
  #listener;
  #resolveClosed;
  #expected = new Map(); // functions that take the answers to data messages, by frame id
  #watch = null;
  #closed = new Promise((resolve) => { this.#resolveClosed = resolve; });

  /**
   * Open the WebSocket and wait for the session status. `listener` has the methods messageReceived, statusReceived,
   * failureReceived, frameInvalid and connectionClosed; `seconds` is the time for the session status.
   */
  static async open(WebSocket, endpoint, query, listener, seconds = OPEN_TIMEOUT) {
    const url = new URL(endpoint);
    for (const [name, value] of Object.entries(query)) url.searchParams.set(name, value);
    let socket;
    try {
      socket = new WebSocket(url.href);
    } catch (error) {
      throw new Unavailable(`cannot open ${endpoint}: ${error.message}`);
    }
    const connection = new Connection(socket, endpoint, listener);
    const timeout = () => new Unavailable(`${endpoint} sent no session status within ${seconds} s`);
    try {
      await within(connection.#receiveSession(), seconds, timeout);
    } catch (error) {
      socket.close();
      throw error;
    }
    if (connection.features.has("ack")) connection.#watchLine();
    return connection;
  }

  constructor(socket, endpoint, listener) {
    this.endpoint = endpoint;
    this.session = null;
    this.#socket = socket;
    this.#listener = listener;
    socket.binaryType = "arraybuffer";
    this.#assembler = new Assembler(
      (data, blobs) => listener.messageReceived(data, blobs), (error) => listener.frameInvalid(error));
  }

  /** Set of the protocol features that the server granted. */
  get features() {
    return new Set(this.session.features);
  }

  /**
   * Queue a text frame with its blobs; at most `keep` messages of the source wait. `mayStart` is called when its turn
   * comes, and returns false to drop it. Returns how many older ones were dropped for it.
   */
  put(source, text, blobs = new Map(), { keep = Infinity, priority = "normal", mayStart = () => true } = {}) {
    return this.#outbox.put(source, pieces(text, blobs, mayStart), keep, priority);
  }

  /** Have `answered` called with the answer to a data message: null, or the error. */
  expect(id, answered) {
    this.#expected.set(id, answered);
  }

  /** Pass on the answer to a data message; returns false if no such message is expected to be answered. */
  answer(id, error) {
    const answered = this.#expected.get(id);
    this.#expected.delete(id);
    answered?.(error);
    return Boolean(answered);
  }

  /** null if the source may send now, else a promise that resolves when its queue is empty. */
  room(source) {
    return this.#outbox.room(source);
  }

  /** Wait until the queued frames have been sent, for FLUSH_TIMEOUT at most. */
  async flush() {
    const end = performance.now() + FLUSH_TIMEOUT * 1000;
    while ((!this.#outbox.empty || this.#socket.bufferedAmount) && performance.now() < end && this.#isOpen) {
      await new Promise((resolve) => { setTimeout(resolve, POLL_INTERVAL); });
    }
  }

  /** Close the socket; code 1000 ends the session, another code (3000 to 4999) keeps it for a reconnection. */
  async close(code = 1000, reason = "") {
    this.#socket.close(code, reason);
    await Promise.race([this.#closed, new Promise((resolve) => { setTimeout(resolve, CLOSE_TIMEOUT * 1000); })]);
  }

  get #isOpen() {
    return this.#socket.readyState === 1;
  }

  #receiveSession() {
    return new Promise((resolve, reject) => {
      this.#socket.onclose = ({ code, reason }) => {
        reject(code > REFUSED ? refusal(code - REFUSED, reason) : new Unavailable(
          `cannot reach ${this.endpoint}${reason ? `: ${reason}` : ""}`));
      };
      this.#socket.onerror = () => {}; // the close event that follows has the reason
      this.#socket.onmessage = ({ data }) => {
        const frame = typeof data === "string" ? JSON.parse(data) : {};
        if (frame.type !== "ST" || frame.data.topic !== "session") {
          reject(new Unavailable(`the first frame of ${this.endpoint} is not a session status`));
          return;
        }
        this.session = frame.data;
        this.#socket.onmessage = (event) => this.#handle(event.data);
        this.#socket.onclose = (event) => this.#handleClose(event);
        resolve();
      };
    });
  }

  #watchLine() {
    const probe = () => {
      this.expect("probe", () => this.#watch.answered());
      this.put(" probe", PROBE, new Map(), { priority: "high" });
    };
    this.#watch = new LineWatch(probe, () => {
      this.#socket.onclose = this.#socket.onmessage = null; // the closing handshake would take a minute
      this.#socket.close(DEAD, "the line is dead");
      this.#handleClose({ reason: "the line is dead" });
    });
  }

  /** Seconds of a round trip on this line, 0 if not known. */
  get roundTrip() {
    return this.#watch?.roundTrip ?? 0;
  }

  #handleClose({ code, reason }) {
    this.#watch?.stop();
    this.#outbox.clear();
    this.#resolveClosed();
    this.#listener.connectionClosed(reason || `code ${code}`, this);
  }

  #send(piece) {
    if (!this.#isOpen) return false;
    this.#socket.send(piece);
    this.#watch?.sent(piece.length ?? piece.byteLength);
    if (this.#socket.bufferedAmount <= WRITE_LIMIT) return true;
    this.#waitForRoom();
    return false;
  }

  #waitForRoom() {
    setTimeout(() => {
      if (!this.#isOpen) return;
      if (this.#socket.bufferedAmount > WRITE_LIMIT) this.#waitForRoom();
      else this.#outbox.resume();
    }, POLL_INTERVAL);
  }

  #handle(payload) {
    this.#watch?.heard();
    try {
      if (typeof payload === "string") this.#handleText(payload);
      else this.#assembler.addBlob(payload);
    } catch (error) {
      this.#listener.frameInvalid(
        error instanceof RceError ? error : new InternalError(`the client failed: ${error.stack}`));
    }
  }

  #handleText(payload) {
    const frame = decode(payload);
    if (frame.type === "DM") this.#assembler.addFrame(frame.data, payload);
    else if (frame.type === "ST") this.#listener.statusReceived(frame.data, frame.id);
    else if (frame.type === "ER") this.#listener.failureReceived(frame);
  }
}

function* pieces(text, blobs, mayStart) {
  if (!mayStart()) return;
  yield text;
  yield* binaryFrames(blobs);
}
