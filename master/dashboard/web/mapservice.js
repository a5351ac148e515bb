// Client of the map service: uploads by tus in parts, jobs, and the files of their results.

import { Api, Problem } from "./api.js";

const NAME = "map-service";
const PART = 4 * 1024 * 1024; // bytes of a request
const TUS = { "tus-resumable": "1.0.0" };

/** Return the client of the platform's map service. Throws a Problem if there is none. */
export async function mapService(app) {
  const found = (await app.api.list("/services")).find((each) => each.name === NAME);
  if (!found) throw new Problem(404, { detail: "No map service has joined this platform." });
  return new MapService(app.key, found.url);
}

class MapService {
  constructor(key, url) {
    [this.api, this.url, this.key] = [new Api(key, url), url, key];
  }

  uploads() { return this.api.get("/uploads"); }

  jobs() { return this.api.get("/jobs"); }

  submit(uploads, options, name) { return this.api.post("/jobs", { uploads, options, name }); }

  cancel(job) { return this.api.post(`/jobs/${job}/cancel`); }

  removeJob(job) { return this.api.remove(`/jobs/${job}`); }

  removeUpload(upload) { return this.api.remove(`/uploads/${upload}`); }

  file(job, name) { return this.api.file(`/jobs/${job}/files/${name}`); }

  /** Upload a file, and return its id; `progress` gets the share that is sent, from 0 to 1. */
  async upload(file, progress) {
    const name = btoa(String.fromCharCode(...new TextEncoder().encode(file.name)));
    const made = await this.#send("POST", `${this.url}/uploads`, { "upload-length": String(file.size), "upload-metadata": `filename ${name}` });
    const { id } = await made.json();
    for (let at = 0; at < file.size; at += PART) {
      await this.#send("PATCH", `${this.url}/uploads/${id}`, { "upload-offset": String(at), "content-type": "application/offset+octet-stream" },
        file.slice(at, at + PART));
      progress(Math.min(1, (at + PART) / file.size));
    }
    return id;
  }

  async #send(method, url, headers, body) {
    const answer = await fetch(url, { method, credentials: "omit", body, headers: { authorization: `Bearer ${this.key}`, ...TUS, ...headers } });
    if (!answer.ok) throw new Problem(answer.status, await answer.json().catch(() => ({})));
    return answer;
  }
}
