// Client of the Master's HTTP API: JSON with an API key, problems as errors, logs as streams.

const BASE = "/api/v1"; // at the Master
const PAUSES = [200, 1000]; // milliseconds before a request is sent again

export class Problem extends Error {
  constructor(status, { detail, title, code = "error", field = "" }) {
    super(detail || title || `the server answered with status ${status}`);
    Object.assign(this, { status, code, field });
  }
}

export class Api {
  /** `base` is the URL below which the paths are. */
  constructor(key, base = BASE) {
    [this.key, this.base] = [key, base];
  }

  get(path, query) {
    return call("GET", this.base + path, `Bearer ${this.key}`, { query });
  }

  post(path, body, query) {
    return call("POST", this.base + path, `Bearer ${this.key}`, { body, query });
  }

  put(path, body, query) {
    return call("PUT", this.base + path, `Bearer ${this.key}`, { body, query });
  }

  patch(path, body, query) {
    return call("PATCH", this.base + path, `Bearer ${this.key}`, { body, query });
  }

  remove(path, query) {
    return call("DELETE", this.base + path, `Bearer ${this.key}`, { query });
  }

  /** Return the bytes of a file. */
  async file(path, query) {
    const answer = await ask("GET", this.base + path, `Bearer ${this.key}`, { query, accept: "*/*" });
    return answer.blob();
  }

  /** Return a stream of the bytes of a file. */
  async stream(path, query) {
    return (await ask("GET", this.base + path, `Bearer ${this.key}`, { query, accept: "*/*" })).body;
  }

  /** Send bytes to the path of a ticket. */
  async upload(path, token, content) {
    const headers = { authorization: `Bearer ${token}`, "content-type": "application/x-tar" };
    const answer = await fetch(path, { method: "PUT", headers, credentials: "omit", body: content });
    if (!answer.ok) throw new Problem(answer.status, await answer.json().catch(() => ({})));
  }

  /** Return all items of a list, fetched page by page. */
  async list(path, query = {}) {
    const items = [];
    let after = "";
    do {
      const page = await this.get(path, { limit: 1000, ...query, after });
      items.push(...page.items);
      after = page.next;
    } while (after);
    return items;
  }

  /** Yield the data of server-sent events, until `signal` or the server ends them. */
  async* follow(path, query, signal) {
    const answer = await ask("GET", this.base + path, `Bearer ${this.key}`, { query, signal, accept: "text/event-stream" });
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      const events = (rest + value).split(/\r?\n\r?\n/);
      rest = events.pop();
      for (const event of events) {
        const data = event.split(/\r?\n/).filter((line) => line.startsWith("data:")).map((line) => line.slice(5).trim());
        if (data.length) yield JSON.parse(data.join("\n"));
      }
    }
  }
}

/** Return a `post` that authenticates with user and password. */
export function withPassword(user, password) {
  const pair = new TextEncoder().encode(`${user}:${password}`);
  return (path, body, query) => call("POST", BASE + path, `Basic ${btoa(String.fromCharCode(...pair))}`, { body, query });
}

async function call(method, path, authorization, options) {
  const answer = await ask(method, path, authorization, options);
  return answer.status === 204 ? null : answer.json();
}

async function ask(method, address, authorization, { body, query = {}, signal, accept = "application/json" }) {
  const url = new URL(address, location.origin);
  for (const [name, value] of Object.entries(query)) if (value !== "" && value !== undefined) url.searchParams.set(name, value);
  const headers = { authorization, accept };
  if (body !== undefined) headers["content-type"] = "application/json";
  if (method === "POST") headers["idempotency-key"] = Array.from(crypto.getRandomValues(new Uint32Array(4))).join("-");
  // Without `omit` the browser would open its own password dialog after a 401.
  const options = { method, headers, signal, credentials: "omit", body: body && JSON.stringify(body) };
  const answer = await send(url, options, method === "DELETE" ? [] : PAUSES);
  if (!answer.ok) throw new Problem(answer.status, await answer.json().catch(() => ({})));
  return answer;
}

/** Send a request, again after each of the pauses if there is no answer. The server must tolerate repetition. */
async function send(url, options, [pause, ...pauses]) {
  try {
    return await fetch(url, options);
  } catch (error) {
    if (error.name === "AbortError") throw error;
    if (pause === undefined) {
      throw new Problem(0, { detail: "the Master cannot be reached at present", code: "unavailable" });
    }
  }
  await new Promise((resolve) => { setTimeout(resolve, pause); });
  return send(url, options, pauses);
}
