// Line chart of the last minutes of one figure.

import { h, svg } from "./dom.js";

const MAX_POINTS = 150; // points: 7.5 minutes, as the feed measures every three seconds

export class Chart {
  #points = [];
  #line = svg("polyline");
  #value = h("span.figure", "–");
  #limit = h("span.soft");

  constructor(name, words) {
    this.words = words;
    const picture = svg("svg.chart", { viewBox: `0 0 ${MAX_POINTS} 100`, preserveAspectRatio: "none", "aria-hidden": "true" }, this.#line);
    this.element = h("section.panel", h("div.head", h("h2", name), this.#value, this.#limit), picture);
  }

  /** Add a value; `limit` is the most that may be used, 0 if unknown. */
  add(value, limit) {
    this.#points.push(value);
    if (this.#points.length > MAX_POINTS) this.#points.shift();
    const top = Math.max(...this.#points, limit && value > limit / 3 ? limit : 0) * 1.1 || 1;
    const start = MAX_POINTS - this.#points.length;
    this.#line.setAttribute("points", this.#points.map((each, index) => `${start + index},${99 - (98 * each) / top}`).join(" "));
    this.#value.textContent = this.words(value);
    this.#limit.textContent = limit ? `of ${this.words(limit)}` : "";
  }
}
