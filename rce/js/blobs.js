// Binary frames that carry blobs, split into parts so that small frames can overtake them, and their reassembly.

import { InvalidRequest, LimitExceeded, TimedOut } from "./errors.js";
import { references } from "./values.js";

const PART = 256 * 1024;
const HEAD = 40; // id of 32 hex digits, offset (4 bytes), total (4 bytes)
const MAX_PENDING = 64; // incomplete frames, and incomplete blobs
const MAX_AGE = 60_000; // milliseconds for which they may be incomplete

/** Yield the binary frames of blobs, a Map of Uint8Array by id. */
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

/** Joins the text and binary frames of one connection, in whichever order they arrive. */
export class Assembler {
  #frames = new Set(); // {data, ids, touched}
  #blobs = new Map(); // {bytes, filled, touched} by id
  #complete;
  #failed;

  /** `complete(data, blobs)` is called with each complete DM, `failed(error)` for one whose blobs did not arrive. */
  constructor(complete, failed) {
    this.#complete = complete;
    this.#failed = failed;
  }

  /** Add the `data` of a DM; `text` is the frame that it was decoded from. */
  addFrame(data, text) {
    const ids = text.includes('*"') ? references(data) : new Set();
    if (!ids.size) return this.#complete(data, new Map());
    this.#settle({ data, ids, touched: performance.now() });
    this.#sweep();
  }

  /** Add a binary frame. Throws InvalidRequest if it is malformed or out of order. */
  addBlob(buffer) {
    const id = buffer.byteLength < HEAD ? "" : String.fromCharCode(...new Uint8Array(buffer, 0, 32));
    if (!/^[0-9a-fA-F]{32}$/.test(id)) throw new InvalidRequest("a binary frame begins with an id of 32 hex digits");
    const head = new DataView(buffer);
    const [offset, total] = [head.getUint32(32), head.getUint32(36)];
    const part = new Uint8Array(buffer, HEAD);
    const blob = offset ? this.#blobs.get(id) : { bytes: null, filled: 0, total };
    if (!blob) return; // the rest of a blob that was dropped
    if (blob.filled !== offset || offset + part.length > total) {
      this.#blobs.delete(id);
      throw new InvalidRequest(`blob ${id}: the part at ${offset} does not continue the earlier parts`);
    }
    if (part.length === total) blob.bytes = part; // the whole blob: no copy
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

  /** Drop frames and blobs that are too old or too many. */
  #sweep() {
    const oldest = performance.now() - MAX_AGE;
    for (const [id, blob] of this.#blobs) {
      if (blob.touched < oldest || this.#blobs.size > MAX_PENDING) this.#blobs.delete(id);
    }
    for (const frame of this.#frames) {
      const isArriving = [...frame.ids].some((id) => this.#blobs.get(id)?.touched >= oldest);
      if (frame.touched < oldest && !isArriving) {
        this.#frames.delete(frame);
        this.#failed(new TimedOut(`the blobs of a message for ${frame.data.iTag} did not arrive`));
      } else if (this.#frames.size > MAX_PENDING) {
        this.#frames.delete(frame);
        this.#failed(new LimitExceeded(`more than ${MAX_PENDING} messages are waiting for their blobs`));
      }
    }
  }
}
