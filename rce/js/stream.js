// Bounded queue that keeps the newest items, read with `for await` or `get`.

import { TimedOut, Unavailable } from "./errors.js";

/** Queue of items in the order of their arrival; each item goes to one reader. */
export class Stream {
  #items = [];
  #readers = [];
  #depth;
  #end = null; // {error} after the end
  #left;

  /** `left` is called when a `for await` loop is left before the end. */
  constructor(depth, left = () => {}) {
    this.#depth = depth;
    this.#left = left;
    this.dropped = 0;
  }

  /** True after `end`. */
  get ended() {
    return this.#end !== null;
  }

  /** Add an item; the oldest is dropped if more than the depth are unread. */
  put(item) {
    if (this.#end) return;
    const reader = this.#readers.shift();
    if (reader) return reader.resolve({ value: item, done: false });
    this.#items.push(item);
    if (this.#items.length > this.#depth) {
      this.#items.shift();
      this.dropped += 1;
    }
  }

  /** End the stream: readers get the remaining items, then `error` or the end of the iteration. */
  end(error = null) {
    this.#end ??= { error };
    for (const reader of this.#readers.splice(0)) this.#finish(reader);
  }

  /** The next item. Rejects with TimedOut after `timeout` seconds, and after the end with its error or Unavailable. */
  async get(timeout = Infinity) {
    const reader = this.#read();
    let timer;
    if (timeout < Infinity) {
      timer = setTimeout(() => {
        this.#readers = this.#readers.filter((each) => each !== reader);
        reader.reject(new TimedOut(`nothing arrived within ${timeout} s`));
      }, timeout * 1000);
    }
    const { value, done } = await reader.promise.finally(() => clearTimeout(timer));
    if (done) throw new Unavailable("nothing more will arrive: the stream has been closed");
    return value;
  }

  [Symbol.asyncIterator]() {
    return {
      next: () => this.#read().promise,
      return: async () => {
        this.#left();
        return { value: undefined, done: true };
      },
    };
  }

  #read() {
    const reader = {};
    reader.promise = new Promise((resolve, reject) => Object.assign(reader, { resolve, reject }));
    if (this.#items.length) reader.resolve({ value: this.#items.shift(), done: false });
    else if (this.#end) this.#finish(reader);
    else this.#readers.push(reader);
    return reader;
  }

  #finish(reader) {
    if (this.#end.error) reader.reject(this.#end.error);
    else reader.resolve({ value: undefined, done: true });
  }
}
