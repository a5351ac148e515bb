// The binary frames that carry blobs, in parts so that small frames go between them, and how they are joined again.

import { InvalidRequest, LimitExceeded, TimedOut } from "./errors.js";
import { references } from "./values.js";

const PART = 256 * 1024;
const HEAD = 40; // an id of 32 hex digits, offset 4, total 4
const MOST = 64; // frames or blobs that may be unfinished
const AGE = 60_000; // milliseconds for which they may be

/** The binary frames of these blobs, a Map of Uint8Array by id. */
export function* binaryFrames(blobs) {
  for (const [id, bytes] of blobs) {
    for (let offset = 0; offset === 0 || offset < bytes.length; offset += PART) {
      const part = bytes.subarray(offset, offset + PART);
      const frame = new Uint8Array(HEAD + part.length);
      for (let index = 0; index < 32; index += 1) frame[index] = id.charCodeAt(index);
      const head = new DataView(frame.buffer);
      head.setUint32(32, offset);
      head.setUint32(36, bytes.length);
      frame.set(part, HEAD);
      yield frame;
    }
  }
}

/** Joins the text and binary frames of one connection, whichever come first. `failed` hears of what never was whole. */
export class Assembler {
  #frames = new Set(); // {data, ids, touched}
  #blobs = new Map(); // {bytes, filled, touched} by id
  #complete;
  #failed;

  /** `complete(data, blobs)` is called with each DM whose blobs are all there. */
  constructor(complete, failed) {
    this.#complete = complete;
    this.#failed = failed;
  }

  /** Take the `data` of a DM; `text` is what it was decoded from. */
  frame(data, text) {
    const ids = text.includes('*"') ? references(data) : new Set();
    if (!ids.size) return this.#complete(data, new Map());
    this.#settle({ data, ids, touched: performance.now() });
    this.#sweep();
  }

  /** Take a binary frame. InvalidRequest when it is malformed or out of order. */
  blob(buffer) {
    const id = buffer.byteLength < HEAD ? "" : String.fromCharCode(...new Uint8Array(buffer, 0, 32));
    if (!/^[0-9a-fA-F]{32}$/.test(id)) throw new InvalidRequest("a binary frame begins with an id of 32 hex digits");
    const head = new DataView(buffer);
    const [offset, total] = [head.getUint32(32), head.getUint32(36)];
    const part = new Uint8Array(buffer, HEAD);
    const blob = offset ? this.#blobs.get(id) : { bytes: null, filled: 0, total };
    if (!blob) return; // of a frame that was given up
    if (blob.filled !== offset || offset + part.length > total) {
      this.#blobs.delete(id);
      throw new InvalidRequest(`blob ${id}: the part at ${offset} does not continue what has come`);
    }
    if (part.length === total) blob.bytes = part; // all of it: not copied
    else (blob.bytes ??= new Uint8Array(total)).set(part, offset);
    blob.filled += part.length;
    blob.touched = performance.now();
    this.#blobs.set(id, blob);
    if (blob.filled < total) return;
    for (const frame of this.#frames) if (frame.ids.has(id)) this.#settle(frame);
    this.#sweep();
  }

  #settle(frame) {
    const blobs = [...frame.ids].map((id) => this.#blobs.get(id));
    if (!blobs.every((blob) => blob && blob.filled === blob.total)) {
      this.#frames.add(frame);
      return;
    }
    this.#frames.delete(frame);
    const whole = new Map([...frame.ids].map((id) => [id, this.#blobs.get(id).bytes]));
    for (const id of frame.ids) this.#blobs.delete(id);
    this.#complete(frame.data, whole);
  }

  /** Give up what is too old or too much. */
  #sweep() {
    const oldest = performance.now() - AGE;
    for (const [id, blob] of this.#blobs) {
      if (blob.touched < oldest || this.#blobs.size > MOST) this.#blobs.delete(id);
    }
    for (const frame of this.#frames) {
      const waits = [...frame.ids].some((id) => this.#blobs.get(id)?.touched >= oldest);
      if (frame.touched < oldest && !waits) {
        this.#frames.delete(frame);
        this.#failed(new TimedOut(`a message of ${frame.data.iTag} never got its blobs`));
      } else if (this.#frames.size > MOST) {
        this.#frames.delete(frame);
        this.#failed(new LimitExceeded(`more than ${MOST} messages wait for their blobs`));
      }
    }
  }
}
