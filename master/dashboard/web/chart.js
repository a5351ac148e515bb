// Line chart of the last minutes of one figure, with its scale.

import { h, svg } from "./dom.js";

const MAX_POINTS = 150; // points: 7.5 minutes, as the feed measures every three seconds
const MINUTES = [5, 2.5, 0];
const STEPS = [1, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10];

/** Return the smallest round number that is not below `value`; `thousand` is the factor from a unit to the next. */
function above(value, thousand) {
  const unit = thousand ** Math.max(0, Math.floor(Math.log(value) / Math.log(thousand)));
  const power = unit * 10 ** Math.floor(Math.log10(value / unit));
  return STEPS.map((step) => step * power).find((each) => each >= value * 0.999) ?? 10 * power;
}

export class Chart {
  #points = [];
  #line = svg("polyline");
  #value = h("span.figure", "–");
  #limit = h("span.soft");
  #scale = [h("span"), h("span"), h("span")];

  constructor(name, words, thousand = 1000) {
    this.words = words;
    this.thousand = thousand;
    const grid = [1, 50, 99].map((y) => svg("line", { x1: 0, x2: MAX_POINTS, y1: y, y2: y }));
    const picture = svg("svg", { viewBox: `0 0 ${MAX_POINTS} 100`, preserveAspectRatio: "none", "aria-hidden": "true" }, grid, this.#line);
    const times = h("div.times", MINUTES.map((ago) => h("span", ago ? `${ago} min ago` : "now")));
    this.element = h("section.panel", h("div.head", h("h2", name), this.#value, this.#limit),
      h("div.chart", h("div.scale", this.#scale), picture, times));
  }

  /** Add a value; `limit` is the most that may be used, 0 if unknown. */
  add(value, limit) {
    this.#points.push(value);
    if (this.#points.length > MAX_POINTS) this.#points.shift();
    const top = above(Math.max(...this.#points, limit && value > limit / 3 ? limit : 0) || 1, this.thousand);
    const start = MAX_POINTS - this.#points.length;
    this.#line.setAttribute("points", this.#points.map((each, index) => `${start + index},${99 - (98 * each) / top}`).join(" "));
    this.#value.textContent = this.words(value);
    this.#limit.textContent = limit ? `of ${this.words(limit)}` : "";
    this.#scale.forEach((each, index) => { each.textContent = this.words((top * (2 - index)) / 2); });
  }
}
