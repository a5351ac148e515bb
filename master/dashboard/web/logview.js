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
  #filter = h("input", { type: "search", placeholder: "Lines with …", "aria-label": "Lines with", size: 14 });
  #lines = [];
  #text = h("pre.log", { tabindex: 0, role: "log", "aria-label": "Output" });

  /** `chosen(name)` is called when the user chooses whose output to see. */
  constructor(app, path, who, chosen) {
    Object.assign(this, { element: h("section.panel", h("div.head", h("h2", "Output"), this.#select, this.#filter), this.#text) });
    [this.#app, this.#path, this.#who] = [app, path, who];
    this.#select.onchange = () => { chosen(this.#select.value); this.select(this.#select.value); };
  }

  /** Show only lines with this text; `changed` is called when the user sets another one. */
  filter(text, changed) {
    this.#filter.value = text;
    this.#filter.oninput = () => {
      changed(this.#filter.value.trim());
      this.#text.textContent = "";
      this.#show(this.#lines);
    };
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
    this.#lines = [];
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
    this.#lines = [...this.#lines, ...lines].slice(-LINES);
    this.#show(lines);
  }

  #show(lines) {
    const words = this.#filter.value.trim().toLowerCase();
    const pre = this.#text;
    const atEnd = pre.scrollHeight - pre.scrollTop - pre.clientHeight < 30;
    pre.append(...lines.filter((line) => line.toLowerCase().includes(words)).map((line) => `${line}\n`));
    while (pre.childNodes.length > LINES) pre.firstChild.remove();
    if (atEnd) pre.scrollTop = pre.scrollHeight;
  }
}
