// View of the output of an environment or one of its nodes, as it comes.

import { h, show } from "./dom.js";

const LINES = 2000; // kept in the view

export class LogView {
  #app;
  #path;
  #who;
  #stop = null;
  #names = [];
  #chosen = "";
  #select = h("select", { "aria-label": "Whose output" });
  #text = h("pre.log", { tabindex: 0, role: "log", "aria-label": "Output" });

  constructor(app, path, who) {
    Object.assign(this, { element: h("section.panel", h("div.head", h("h2", "Output"), this.#select), this.#text) });
    [this.#app, this.#path, this.#who] = [app, path, who];
    this.#select.onchange = () => this.select(this.#select.value);
  }

  /** Set the nodes to choose from, beside the environment itself; nodes that are gone stay in the list. */
  nodes(names) {
    this.#names = [...new Set([...names, ...this.#names, this.#chosen])].filter(Boolean).sort();
    show(this.#select, h("option", { value: "" }, "the environment"), this.#names.map((name) => h("option", { value: name }, name)));
    this.#select.value = this.#chosen;
  }

  async select(name) {
    this.stop();
    this.#chosen = name;
    this.nodes([]);
    this.#text.textContent = "";
    const stop = this.#stop = new AbortController();
    const path = name ? `${this.#path}/nodes/${name}/log` : `${this.#path}/log`;
    while (!stop.signal.aborted) {
      try {
        for await (const { lines } of this.#app.api.follow(path, { ...this.#who, follow: "true", lines: 500 }, stop.signal)) this.#add(lines);
        return;
      } catch (error) {
        if (stop.signal.aborted) return;
        this.#add([`— ${error.message} —`]);
        if (error.status) return; // the server's error is shown already
      }
      await new Promise((resolve) => { setTimeout(resolve, 3000); });
    }
  }

  stop() {
    this.#stop?.abort();
  }

  #add(lines) {
    const pre = this.#text;
    const atEnd = pre.scrollHeight - pre.scrollTop - pre.clientHeight < 30;
    pre.append(...lines.map((line) => `${line}\n`));
    while (pre.childNodes.length > LINES) pre.firstChild.remove();
    if (atEnd) pre.scrollTop = pre.scrollHeight;
  }
}
