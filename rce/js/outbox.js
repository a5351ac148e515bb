// Outgoing queues of one socket, one for each interface, served in turns (round robin) so that a large message does not
// delay small ones; those of a higher priority first. A message is an iterator of pieces (strings or bytes).

const RANKS = { high: 0, normal: 1, low: 2 };
const HIGH_WATER = 8; // queued messages at which a source must wait

/** Outgoing queues of one socket. */
export class Outbox {
  #queues = new Map(); // {current, waiting, room, rank} by source, in the order of their turns
  #write;
  #open = true;

  /** `write(piece)` returns true if there is room for another piece. */
  constructor(write) {
    this.#write = write;
  }

  get empty() {
    return this.#queues.size === 0;
  }

  /** Queue a message; at most `keep` of the source wait. Returns how many older ones were dropped for it. */
  put(source, pieces, keep = Infinity, priority = "normal") {
    const queue = this.#queues.get(source) ?? { current: null, waiting: [], room: null, rank: RANKS[priority] };
    this.#queues.set(source, queue);
    queue.waiting.push(pieces);
    this.#pump();
    const dropped = Math.max(0, queue.waiting.length - keep);
    queue.waiting.splice(0, dropped);
    return dropped;
  }

  /** null if the source may send now, else a promise that resolves when its queue is empty. */
  room(source) {
    const queue = this.#queues.get(source);
    if (!queue || queue.waiting.length < HIGH_WATER) return null;
    if (!queue.room) {
      queue.room = {};
      queue.room.promise = new Promise((resolve) => { queue.room.resolve = resolve; });
    }
    return queue.room.promise;
  }

  /** Continue after the socket has room again. */
  resume() {
    this.#open = true;
    this.#pump();
  }

  /** Drop everything, since the socket is closed. */
  clear() {
    this.#open = false;
    for (const queue of this.#queues.values()) queue.room?.resolve();
    this.#queues.clear();
  }

  /** The first queue of the highest priority. */
  #next() {
    let best = null;
    for (const entry of this.#queues) if (!best || entry[1].rank < best[1].rank) best = entry;
    return best;
  }

  #pump() {
    while (this.#open && this.#queues.size) {
      const [source, queue] = this.#next();
      this.#queues.delete(source);
      queue.current ??= queue.waiting.shift();
      const { value, done } = queue.current.next();
      if (done) queue.current = null;
      if (queue.current || queue.waiting.length) this.#queues.set(source, queue); // behind the others
      else queue.room?.resolve();
      if (!done) this.#open = this.#write(value);
    }
  }
}
