// The protocol of rce.protocol.terminal: byte streams in chunks with offsets over topics that may lose messages. Free of the DOM.

const CHUNK = 16 * 1024;
const [RETRANSMIT_MIN, RETRANSMIT_MAX] = [1000, 8000]; // milliseconds without progress until bytes are sent again
const HEADER = 16; // bytes of a std_msgs/UInt8MultiArray before its data

function frame(letter, size) {
  const bytes = new Uint8Array(1 + size);
  bytes[0] = letter.charCodeAt(0);
  return [bytes, new DataView(bytes.buffer, 1)];
}

function sized(letter, ...numbers) {
  const [bytes, view] = frame(letter, 2 * numbers.length);
  numbers.forEach((each, index) => view.setUint16(2 * index, each, true));
  return bytes;
}

function offset(letter, value, more = 0) {
  const [bytes, view] = frame(letter, 8 + more);
  view.setBigUint64(0, BigInt(value), true);
  return bytes;
}

const view = (content) => new DataView(content.buffer, content.byteOffset, content.byteLength);

export const frames = {
  open: (rows, columns) => new TextEncoder().encode(`o${JSON.stringify({ rows, columns, term: "xterm-256color", command: "" })}`),
  size: (rows, columns) => sized("s", rows, columns),
  keepAlive: () => sized("h"),
  hangUp: () => sized("b"),
  /** Return the status of the program and the offset of the end of its output. */
  readExit: (content) => ({ code: view(content).getInt32(0, true), end: Number(view(content).getBigUint64(4, true)) }),
};

/** Bytes to the other side, sent again until they are acknowledged. */
export class Sending {
  #base = 0;
  #waiting = new Uint8Array();
  #pause = RETRANSMIT_MIN;
  #progress = 0;

  constructor(send, clock = () => performance.now()) {
    [this.send, this.clock] = [send, clock];
  }

  write(data) {
    if (!this.#waiting.length) this.#progress = this.clock();
    const start = this.#waiting.length;
    const all = new Uint8Array(start + data.length);
    all.set(this.#waiting);
    all.set(data, start);
    this.#waiting = all;
    this.#sendFrom(start);
  }

  acknowledged(content) {
    const total = Number(view(content).getBigUint64(0, true));
    if (total <= this.#base) return;
    this.#waiting = this.#waiting.slice(total - this.#base);
    [this.#base, this.#progress, this.#pause] = [total, this.clock(), RETRANSMIT_MIN];
  }

  /** Send again what was not acknowledged in time. */
  tick() {
    if (!this.#waiting.length || this.clock() - this.#progress <= this.#pause) return;
    this.#progress = this.clock();
    this.#pause = Math.min(2 * this.#pause, RETRANSMIT_MAX);
    this.#sendFrom(0);
  }

  #sendFrom(start) {
    for (let at = start; at < this.#waiting.length; at += CHUNK) {
      const part = this.#waiting.subarray(at, at + CHUNK);
      const bytes = offset("d", this.#base + at, part.length);
      bytes.set(part, 9);
      this.send(bytes);
    }
  }
}

/** Bytes from the other side, without duplicates. */
export class Receiving {
  end = 0;

  receive(content) {
    const known = this.end - Number(view(content).getBigUint64(0, true));
    const fresh = known < 0 ? new Uint8Array() : content.slice(8 + known);
    this.end += fresh.length;
    return fresh;
  }

  acknowledgement() {
    return offset("t", this.end);
  }
}

export function toCdr(data) {
  const message = new Uint8Array(HEADER + data.length);
  message[1] = 1; // little-endian
  new DataView(message.buffer).setUint32(12, data.length, true);
  message.set(data, HEADER);
  return message;
}

export function fromCdr(message) {
  return message.subarray(HEADER, HEADER + view(message).getUint32(12, true));
}
