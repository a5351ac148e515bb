// Client of the knowledge service for pages and Node: recipes, objects and environments that robots share. See
// docs/knowledge.md for the fields of entries, versions and changes.

import { entries } from "./entries.js";
import { RceError, Unavailable } from "./errors.js";

const PREFIX = "knowledge-service";

/** Client of one platform's knowledge service. Its methods reject with the errors of `errors.js`. */
export class Knowledge {
  #urls;
  #key;
  #base = null;

  /** `url` is that of the platform's entry, or those of its Masters separated by commas; `key` an API key. */
  constructor(url, { key }) {
    [this.#urls, this.#key] = [entries(url).map((each) => each.replace(/\/*$/, "/")), key];
  }

  /** Add an entry: kind, class, id, and optionally owl, description, public, shared, location. */
  add(entry) { return this.#json("POST", "/entries", entry); }

  get(kind, uid) { return this.#json("GET", path(kind, uid)); }

  /** Change an entry of yours: owl, description, public, shared, location; what is absent stays. */
  change(kind, uid, fields) { return this.#json("PATCH", path(kind, uid), fields); }

  async remove(kind, uid) { await this.#ask("DELETE", path(kind, uid)); }

  rate(kind, uid, rating) { return this.#json("POST", `${path(kind, uid)}/rating`, { rating }); }

  /** Return the OWL text of a version, by default of the newest. */
  async owl(kind, uid, version) {
    return (await this.#ask("GET", `${path(kind, uid)}/owl${query({ version })}`)).text();
  }

  /** Return all versions, the newest first. */
  versions(kind, uid) { return this.#json("GET", `${path(kind, uid)}/versions`); }

  /** Add or replace a file of an entry of yours; `content` is a Blob or bytes. */
  async putFile(kind, uid, name, content) {
    const headers = { "content-type": "application/octet-stream" };
    return (await this.#ask("PUT", file(kind, uid, name), { body: content, headers })).json();
  }

  /** Return a file of a version as a Blob. */
  async file(kind, uid, name, version) {
    return (await this.#ask("GET", file(kind, uid, name) + query({ version }))).blob();
  }

  /** Yield the entries that fit: kind, prefix, text, class, author, latitude, longitude, radius. */
  async* search(wanted = {}) {
    let after = "";
    do {
      const page = await this.#json("GET", `/entries${query({ ...wanted, after })}`);
      yield* page.items;
      after = page.next;
    } while (after);
  }

  /** Answer a query: {variables, rows}, or {answer} of ASK; `language` is sparql or serql. */
  query(text, language = "sparql") { return this.#json("POST", "/query", { query: text, language }); }

  /** Yield changes as they happen: kind, uid, prefix, class, after; until `signal` or the connection ends. */
  async* changes(wanted = {}, signal = undefined) {
    const answer = await this.#ask("GET", `/changes${query(wanted)}`, { signal });
    const reader = answer.body.pipeThrough(new TextDecoderStream()).getReader();
    let rest = "";
    for (;;) {
      const { value, done } = await reader.read();
      if (done) return;
      const events = (rest + value).split("\n\n");
      rest = events.pop();
      for (const event of events) {
        const data = event.split("\n").find((line) => line.startsWith("data: "));
        if (data) yield JSON.parse(data.slice(6));
      }
    }
  }

  async #json(method, resource, body) {
    const sent = body === undefined ? {} : { body: JSON.stringify(body), headers: { "content-type": "application/json" } };
    return (await this.#ask(method, resource, sent)).json();
  }

  async #ask(method, resource, { body, headers = {}, signal } = {}) {
    // Credentials do not follow redirects to another port, so the service's own address is needed.
    this.#base ??= (await this.#locate()).url.replace(/\/openapi\.json$/, "");
    return send(this.#base + resource, { method, body, signal, headers: { ...headers, authorization: `Bearer ${this.#key}` } });
  }

  /** Ask the Master that leads: it redirects to the service. */
  async #locate() {
    const asked = this.#urls.map((url) => send(`${url}${PREFIX}/openapi.json`));
    return Promise.any(asked).catch(({ errors }) => { throw errors[0]; });
  }
}

async function send(url, options = {}) {
  const answer = await fetch(url, { credentials: "omit", ...options }).catch((error) => {
    throw error.name === "AbortError" ? error : new Unavailable(`cannot reach ${url}: ${error.cause?.message ?? error.message}`);
  });
  if (answer.ok) return answer;
  const problem = await answer.json().catch(() => ({}));
  if (!problem.code) throw new Unavailable(`the knowledge service answered with HTTP status ${answer.status}`);
  throw RceError.of({ message: problem.detail, code: problem.code, field: problem.field, fields: problem.fields });
}

const path = (kind, uid) => `/entries/${kind}/${encodeURIComponent(uid)}`;
const file = (kind, uid, name) => `${path(kind, uid)}/files/${encodeURIComponent(name)}`;

function query(values) {
  const given = Object.entries(values).filter(([, value]) => value !== undefined && value !== null && value !== "");
  return given.length ? `?${new URLSearchParams(given)}` : "";
}
