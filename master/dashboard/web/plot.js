// Plot of the numbers in the messages of a topic over the last seconds.

import { h } from "./dom.js";

const SECONDS = 30;
const MAX_POINTS = 3000; // of a line
const COLOURS = ["#2457d6", "#d9480f", "#197a42", "#8a2be2", "#b8860b", "#c2255c"];
const MARGIN = { left: 58, right: 8, top: 8, bottom: 20 };

/** Return the numbers in a message by their paths: `pose.position.x`, `ranges[3]`. */
export function numbers(message, most = 60) {
  const found = new Map();
  const visit = (value, path) => {
    if (found.size >= most) return;
    if (typeof value === "number" || typeof value === "boolean") found.set(path, Number(value));
    else if (Array.isArray(value)) value.slice(0, 8).forEach((each, index) => visit(each, `${path}[${index}]`));
    else if (value && typeof value === "object" && !(value instanceof Uint8Array)) {
      for (const [key, each] of Object.entries(value)) visit(each, path ? `${path}.${key}` : key);
    }
  };
  visit(message, "");
  return found;
}

export class Plot {
  #lines = new Map(); // path -> [[seconds, value], …]
  #timer;

  constructor() {
    this.fields = h("div.fields");
    this.element = h("canvas.plot", { role: "img", "aria-label": "Plot of the chosen fields" });
    this.fields.onchange = () => {
      const chosen = [...this.fields.querySelectorAll("input:checked")].map((each) => each.value);
      this.#lines = new Map(chosen.map((path) => [path, this.#lines.get(path) ?? []]));
      this.#draw();
    };
    this.#timer = setInterval(() => document.hidden || this.#draw(), 200);
  }

  /** Add the numbers of a message; the first message makes the choice of fields. */
  add(message) {
    const found = numbers(message);
    if (!this.fields.children.length) {
      this.fields.append(...[...found.keys()].map((path) => h("label.inline", h("input", { type: "checkbox", value: path }), path)));
      if (!found.size) this.fields.append(h("span.soft", "This message has no numbers."));
    }
    const now = performance.now() / 1000;
    for (const [path, points] of this.#lines) {
      if (!found.has(path)) continue;
      points.push([now, found.get(path)]);
      while (points.length > MAX_POINTS || points[0][0] < now - SECONDS) points.shift();
    }
  }

  stop() {
    clearInterval(this.#timer);
  }

  #draw() {
    const { element } = this;
    const box = element.getBoundingClientRect();
    if (!box.width) return;
    const [width, height] = [Math.round(box.width * devicePixelRatio), Math.round(box.height * devicePixelRatio)];
    if (element.width !== width || element.height !== height) [element.width, element.height] = [width, height];
    const pen = element.getContext("2d");
    pen.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    pen.clearRect(0, 0, box.width, box.height);
    const style = getComputedStyle(element);
    const values = [...this.#lines.values()].flat().map(([, value]) => value).filter(Number.isFinite);
    const [low, high] = limits(values);
    const now = performance.now() / 1000;
    const area = { x: MARGIN.left, y: MARGIN.top, width: box.width - MARGIN.left - MARGIN.right, height: box.height - MARGIN.top - MARGIN.bottom };
    const x = (seconds) => area.x + area.width * (1 + (seconds - now) / SECONDS);
    const y = (value) => area.y + area.height * (1 - (value - low) / (high - low));
    pen.font = "11px system-ui, sans-serif";
    [pen.fillStyle, pen.strokeStyle] = [style.color, style.borderColor];
    pen.textAlign = "right";
    for (let step = 0; step <= 4; step += 1) {
      const value = low + ((high - low) * step) / 4;
      pen.fillText(Number(value.toPrecision(4)), area.x - 6, y(value) + 4);
      pen.strokeRect(area.x, y(value), area.width, 0);
    }
    pen.textAlign = "center";
    for (let ago = 0; ago <= SECONDS; ago += 10) pen.fillText(ago ? `−${ago} s` : "now", Math.min(x(now - ago), box.width - 14), box.height - 5);
    [...this.#lines].forEach(([path, points], index) => {
      pen.strokeStyle = pen.fillStyle = COLOURS[index % COLOURS.length];
      pen.lineWidth = 2;
      pen.beginPath();
      for (const [seconds, value] of points) if (Number.isFinite(value)) pen.lineTo(x(seconds), y(value));
      pen.stroke();
      pen.textAlign = "left";
      pen.fillText(path, area.x + 8, area.y + 14 + 15 * index);
    });
  }
}

function limits(values) {
  if (!values.length) return [0, 1];
  const [low, high] = [values.reduce((a, b) => Math.min(a, b)), values.reduce((a, b) => Math.max(a, b))];
  const room = (high - low) * 0.05 || Math.abs(high) * 0.05 || 1;
  return [low - room, high + room];
}
