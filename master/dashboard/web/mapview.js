// Map on a canvas: moved by dragging and arrow keys, scaled by wheel, plus and minus; follows the robot on request.

import { h } from "./dom.js";

export class MapPicture {
  #map = null;
  #cells = new OffscreenCanvas(1, 1);
  #pose = null;
  #trail = [];
  #path = [];
  #view = null; // {x, y, scale}: point of the map in the middle, pixels per metre; null: the whole map
  #drawn = false;

  constructor() {
    const element = h("canvas.map", { tabindex: 0, role: "img", "aria-label": "Map; arrow keys move it, plus and minus scale it" });
    this.element = element;
    element.onwheel = (event) => { event.preventDefault(); this.#zoom(event.deltaY < 0 ? 1.2 : 1 / 1.2); };
    element.onpointerdown = (event) => element.setPointerCapture(event.pointerId);
    element.onpointermove = (event) => event.buttons && this.#move(-event.movementX, event.movementY);
    element.onkeydown = (event) => {
      const step = { ArrowLeft: [-40, 0], ArrowRight: [40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40] }[event.key];
      if (step) this.#move(...step);
      else if (event.key === "+") this.#zoom(1.2);
      else if (event.key === "-") this.#zoom(1 / 1.2);
      else return;
      event.preventDefault();
    };
    this.size = new ResizeObserver(() => this.#draw());
    this.size.observe(element);
    this.scheme = matchMedia("(prefers-color-scheme: dark)");
    this.recolour = () => { this.#paint(0, 0, this.#map?.width ?? 0, this.#map?.height ?? 0); this.#draw(); };
    this.scheme.addEventListener("change", this.recolour);
  }

  stop() {
    this.size.disconnect();
    this.scheme.removeEventListener("change", this.recolour);
  }

  map(map) {
    this.#map = map;
    [this.#cells.width, this.#cells.height] = [Math.max(1, map.width), Math.max(1, map.height)];
    this.#paint(0, 0, map.width, map.height);
    this.#draw();
  }

  /** Replace a part of the map. */
  update({ x, y, width, height, cells }) {
    const map = this.#map;
    if (!map || x < 0 || y < 0 || x + width > map.width || y + height > map.height) return;
    for (let row = 0; row < height; row += 1) {
      map.cells.set(cells.subarray(row * width, (row + 1) * width), (y + row) * map.width + x);
    }
    this.#paint(x, y, width, height);
    this.#draw();
  }

  pose(pose) {
    const last = this.#trail.at(-1);
    if (!last || Math.hypot(last.x - pose.x, last.y - pose.y) > 0.05) this.#trail.push(pose);
    this.#pose = pose;
    this.#draw();
  }

  /** Set the trajectory, which replaces earlier poses. */
  path(poses) {
    this.#path = poses;
    this.#trail = poses.slice(-1);
    this.#pose ??= poses.at(-1) ?? null;
    this.#draw();
  }

  fit() {
    this.#view = null;
    this.#draw();
  }

  #paint(x, y, width, height) {
    if (!width || !height) return;
    const context = this.#cells.getContext("2d");
    const [unknown, free, wall] = ["--unknown", "--free", "--wall"].map((name) => colour(this.element, name));
    const image = context.createImageData(width, height);
    for (let row = 0; row < height; row += 1) {
      for (let column = 0; column < width; column += 1) {
        const value = this.#map.cells[(y + row) * this.#map.width + x + column];
        const at = 4 * (row * width + column);
        for (let part = 0; part < 3; part += 1) {
          image.data[at + part] = value < 0 ? unknown[part] : free[part] + ((wall[part] - free[part]) * value) / 100;
        }
        image.data[at + 3] = 255;
      }
    }
    context.putImageData(image, x, y);
  }

  #whole() {
    const { clientWidth, clientHeight } = this.element;
    const { resolution, width, height, origin } = this.#map;
    const [w, t] = [width * resolution, height * resolution];
    return { x: origin.x + w / 2, y: origin.y + t / 2, scale: 0.96 * Math.min(clientWidth / w, clientHeight / t) };
  }

  #move(right, up) {
    if (!this.#map) return;
    this.#view ??= this.#whole();
    this.#view.x += right / this.#view.scale;
    this.#view.y += up / this.#view.scale;
    this.#draw();
  }

  #zoom(factor) {
    if (!this.#map) return;
    this.#view ??= this.#whole();
    this.#view.scale *= factor;
    this.#draw();
  }

  #draw() {
    if (this.#drawn) return;
    this.#drawn = true;
    requestAnimationFrame(() => { this.#drawn = false; this.#render(); });
  }

  #render() {
    const { element } = this;
    const density = window.devicePixelRatio || 1;
    const [width, height] = [element.clientWidth * density, element.clientHeight * density].map(Math.round);
    if (element.width !== width || element.height !== height) [element.width, element.height] = [width, height];
    const context = element.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    if (!this.#map?.width) return;
    const { x, y, scale } = this.#view ?? this.#whole();
    const pixels = scale * density;
    context.setTransform(pixels, 0, 0, -pixels, width / 2 - x * pixels, height / 2 + y * pixels); // metres, y axis up
    const { origin, resolution } = this.#map;
    context.save();
    context.translate(origin.x, origin.y);
    context.rotate(origin.angle);
    context.imageSmoothingEnabled = false;
    context.drawImage(this.#cells, 0, 0, this.#map.width * resolution, this.#map.height * resolution);
    context.restore();
    this.#way(context, 1 / scale);
  }

  /** Draw the trajectory and the trail; `dot` is the size of a pixel in metres. */
  #way(context, dot) {
    const accent = getComputedStyle(this.element).getPropertyValue("--accent");
    const points = [...this.#path, ...this.#trail];
    context.lineWidth = 2 * dot;
    context.lineJoin = "round";
    context.strokeStyle = "#d9480f";
    context.beginPath();
    for (const { x, y } of points) context.lineTo(x, y);
    context.stroke();
    if (!this.#pose) return;
    context.save();
    context.translate(this.#pose.x, this.#pose.y);
    context.rotate(this.#pose.angle);
    context.scale(dot, dot);
    context.fillStyle = accent;
    context.strokeStyle = "#fff";
    context.lineWidth = 2;
    context.beginPath();
    for (const [x, y] of [[13, 0], [-9, 8], [-5, 0], [-9, -8]]) context.lineTo(x, y);
    context.closePath();
    context.fill();
    context.stroke();
    context.restore();
  }
}

/** Return a colour of the style sheet, `#rgb` or `#rrggbb`, as three numbers. */
function colour(element, name) {
  const digits = getComputedStyle(element).getPropertyValue(name).trim().slice(1);
  const pairs = digits.length === 3 ? [...digits].map((digit) => digit + digit) : digits.match(/../g) ?? ["80", "80", "80"];
  return pairs.map((pair) => parseInt(pair, 16));
}
