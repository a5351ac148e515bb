// The last minutes of one figure, as a line.

import { h, svg } from "./dom.js";

const MOST = 150; // points: five minutes, as the feed measures every two seconds

export class Chart {
  #points = [];
  #line = svg("polyline");
  #value = h("span.figure", "–");
  #limit = h("span.soft");

  constructor(name, words) {
    this.words = words;
    const picture = svg("svg.chart", { viewBox: `0 0 ${MOST} 100`, preserveAspectRatio: "none", "aria-hidden": "true" }, this.#line);
    this.element = h("section.panel", h("div.head", h("h2", name), this.#value, this.#limit), picture);
  }

  /** `limit` is what may be used; 0: not known. */
  add(value, limit) {
    this.#points.push(value);
    if (this.#points.length > MOST) this.#points.shift();
    const top = Math.max(...this.#points, limit && value > limit / 3 ? limit : 0) * 1.1 || 1;
    const start = MOST - this.#points.length;
    this.#line.setAttribute("points", this.#points.map((each, index) => `${start + index},${99 - (98 * each) / top}`).join(" "));
    this.#value.textContent = this.words(value);
    this.#limit.textContent = limit ? `of ${this.words(limit)}` : "";
  }
}
