// State of the platform, kept up to date by the live feed: one WebSocket with a snapshot, then changes.

const KINDS = ["robots", "environments", "nodes", "parameters", "recorders", "interfaces", "connections", "groups", "machines"];
const [MIN_RETRY, MAX_RETRY] = [500, 15_000]; // milliseconds between attempts to connect
const DENIED = 4401; // close code for a key that is wrong or revoked

export class Live {
  #socket = null;
  #listeners = new Set();
  #greeting;
  #pause = MIN_RETRY;
  #told = false;
  #closed = false;

  /** `user` is the owner of the resources shown, `*` for all. `denied` is called when the key is refused. */
  constructor(key, user, denied) {
    this.#greeting = { key, user };
    this.denied = denied;
    this.connected = false;
    this.complete = false; // true after the first snapshot
    for (const kind of KINDS) this[kind] = new Map();
    this.#dial();
  }

  /** Show the resources of another user. */
  watch(user) {
    this.#greeting.user = user;
    this.complete = false;
    this.#socket?.close();
  }

  get user() {
    return this.#greeting.user;
  }

  /** Call `listener` before the next frame after a change; returns a function that ends this. */
  on(listener) {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  }

  close() {
    this.#closed = true;
    this.#listeners.clear();
    this.#socket?.close();
  }

  #dial() {
    const socket = new WebSocket(new URL("/api/v1/live", location.href).href.replace(/^http/, "ws"));
    this.#socket = socket;
    socket.onopen = () => socket.send(JSON.stringify(this.#greeting));
    socket.onmessage = ({ data }) => this.#take(JSON.parse(data));
    socket.onclose = ({ code }) => {
      this.connected = false;
      this.#changed();
      if (this.#closed) return;
      if (code === DENIED) return void this.denied();
      setTimeout(() => this.#closed || this.#dial(), this.#pause);
      this.#pause = Math.min(2 * this.#pause, MAX_RETRY);
    };
  }

  #take({ snapshot, put = {}, drop = {} }) {
    this.connected = this.complete = true;
    this.#pause = MIN_RETRY;
    if (snapshot) for (const kind of KINDS) this[kind].clear();
    for (const kind of KINDS) {
      for (const key of drop[kind] ?? []) this[kind].delete(key);
      for (const [key, view] of Object.entries(put[kind] ?? {})) this[kind].set(key, view);
    }
    this.#changed();
  }

  #changed() {
    if (this.#told) return;
    this.#told = true;
    requestAnimationFrame(() => {
      this.#told = false;
      for (const listener of this.#listeners) listener();
    });
  }
}
