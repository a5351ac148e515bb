// What there is on the platform, kept up to date by the feed: one WebSocket, a snapshot, then what changed.

const KINDS = ["robots", "environments", "nodes", "parameters", "interfaces", "connections", "groups", "machines"];
const [FIRST, MOST] = [500, 15_000]; // milliseconds until it is tried again
const DENIED = 4401; // the close code of a key that is not good any more

export class Live {
  #socket = null;
  #listeners = new Set();
  #greeting;
  #pause = FIRST;
  #told = false;
  #closed = false;

  /** `user` is whose things are shown, `*` for everybody's. `denied` is called when the key is not good any more. */
  constructor(key, user, denied) {
    this.#greeting = { key, user };
    this.denied = denied;
    this.connected = false;
    this.complete = false; // once all has come that there is
    for (const kind of KINDS) this[kind] = new Map();
    this.#dial();
  }

  /** Show the things of another user. */
  watch(user) {
    this.#greeting.user = user;
    this.complete = false;
    this.#socket?.close();
  }

  get user() {
    return this.#greeting.user;
  }

  /** `listener` is called before the next picture after something changed; returns what ends that. */
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
      this.#pause = Math.min(2 * this.#pause, MOST);
    };
  }

  #take({ snapshot, put = {}, drop = {} }) {
    this.connected = this.complete = true;
    this.#pause = FIRST;
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
