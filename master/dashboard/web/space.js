// Points in space by WebGL: turned by dragging and arrow keys, moved with Shift, scaled by wheel, plus and minus.

import { h } from "./dom.js";
import { IDENTITY, multiply } from "./tf.js";

const VERTEX = `attribute vec4 point; uniform mat4 view; uniform float size; uniform vec2 range; uniform vec4 colour; varying vec3 shown;
void main() {
  gl_Position = view * vec4(point.xyz, 1.0);
  gl_PointSize = size;
  float value = clamp((point.w - range.x) / max(range.y - range.x, 0.001), 0.0, 1.0);
  vec3 ramp = clamp(vec3(1.5) - abs(vec3(4.0 * value) - vec3(3.0, 2.0, 1.0)), 0.0, 1.0);
  vec3 own = vec3(floor(point.w / 65536.0), mod(floor(point.w / 256.0), 256.0), mod(point.w, 256.0)) / 255.0;
  shown = colour.a > 0.0 ? colour.rgb : colour.a < 0.0 ? own : ramp;
}`;
const FRAGMENT = `precision mediump float; varying vec3 shown;
void main() { gl_FragColor = vec4(shown, 1.0); }`;
const GRID = 10; // metres from the middle
const BY_VALUE = [0, 0, 0, 0]; // colour of points that are coloured by their values
export const OWN = [0, 0, 0, -1]; // colour of points whose values are colours: 65536 r + 256 g + b

export class Space {
  #gl;
  #places = {};
  #layers = new Map(); // name -> {buffer, count, colour, range, matrix, lines}
  #camera = { x: 0, y: 0, z: 0, turn: -0.8, tilt: 0.9, distance: 12 };
  #waiting = false;

  constructor() {
    const element = h("canvas.space", { tabindex: 0, role: "img", "aria-label": "Points; arrow keys turn, with Shift they move, plus and minus scale" });
    this.element = element;
    this.#gl = element.getContext("webgl", { preserveDrawingBuffer: true });
    if (!this.#gl) throw new Error("This browser has no WebGL.");
    this.#program();
    element.onwheel = (event) => { event.preventDefault(); this.#zoom(event.deltaY < 0 ? 0.85 : 1 / 0.85); };
    element.onpointerdown = (event) => element.setPointerCapture(event.pointerId);
    element.onpointermove = (event) => event.buttons && this.#drag(event.movementX, event.movementY, event.shiftKey || event.buttons > 1);
    element.onkeydown = (event) => {
      const step = { ArrowLeft: [-30, 0], ArrowRight: [30, 0], ArrowUp: [0, -30], ArrowDown: [0, 30] }[event.key];
      if (step) this.#drag(...step, event.shiftKey);
      else if (event.key === "+") this.#zoom(0.85);
      else if (event.key === "-") this.#zoom(1 / 0.85);
      else return;
      event.preventDefault();
    };
    this.size = new ResizeObserver(() => this.#draw());
    this.size.observe(element);
    const lines = [];
    for (let at = -GRID; at <= GRID; at += 1) lines.push(at, -GRID, 0, 0, at, GRID, 0, 0, -GRID, at, 0, 0, GRID, at, 0, 0);
    this.set("grid", new Float32Array(lines), { colour: [0.5, 0.55, 0.6, 1], lines: true });
  }

  /** Show points, four numbers each: x, y, z in metres, and the value for the colour; `matrix` leads to the fixed frame. */
  set(name, points, { colour = BY_VALUE, matrix = IDENTITY, lines = false } = {}) {
    const gl = this.#gl;
    const buffer = this.#layers.get(name)?.buffer ?? gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, points, gl.DYNAMIC_DRAW);
    let [low, high] = [Infinity, -Infinity];
    for (let at = 3; at < points.length; at += 4) [low, high] = [Math.min(low, points[at]), Math.max(high, points[at])];
    this.#layers.set(name, { buffer, count: points.length / 4, colour, range: [low, high], matrix, lines });
    this.#draw();
  }

  /** Look at a point, metres in the fixed frame, from a distance. */
  look(x, y, z, distance) {
    this.#camera = { ...this.#camera, x, y, z, distance: Math.min(500, Math.max(0.5, distance)) };
    this.#draw();
  }

  stop() {
    this.size.disconnect();
    this.#gl.getExtension("WEBGL_lose_context")?.loseContext(); // browsers keep only some contexts
  }

  #program() {
    const gl = this.#gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || "WebGL does not work here.");
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    this.#places = Object.fromEntries(["view", "size", "range", "colour"].map((name) => [name, gl.getUniformLocation(program, name)]));
    gl.enableVertexAttribArray(0);
  }

  #drag(right, down, moves) {
    const camera = this.#camera;
    if (moves) {
      const scale = camera.distance / 500;
      camera.x -= scale * (right * Math.cos(camera.turn) + down * Math.sin(camera.turn));
      camera.y -= scale * (right * Math.sin(camera.turn) - down * Math.cos(camera.turn));
    } else {
      camera.turn -= right / 150;
      camera.tilt = Math.min(1.57, Math.max(0.05, camera.tilt + down / 150));
    }
    this.#draw();
  }

  #zoom(factor) {
    this.#camera.distance = Math.min(500, Math.max(0.5, this.#camera.distance * factor));
    this.#draw();
  }

  #draw() {
    if (this.#waiting) return;
    this.#waiting = true;
    requestAnimationFrame(() => { this.#waiting = false; this.#render(); });
  }

  #render() {
    const [gl, { element }] = [this.#gl, this];
    const [width, height] = [element.clientWidth, element.clientHeight].map((each) => Math.round(each * devicePixelRatio));
    if (!width || gl.isContextLost()) return;
    if (element.width !== width || element.height !== height) [element.width, element.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(0.07, 0.09, 0.12, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const seen = multiply(perspective(width / height), looking(this.#camera));
    for (const { buffer, count, colour, range, matrix, lines } of this.#layers.values()) {
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.vertexAttribPointer(0, 4, gl.FLOAT, false, 0, 0);
      gl.uniformMatrix4fv(this.#places.view, false, multiply(seen, matrix));
      gl.uniform4fv(this.#places.colour, colour);
      gl.uniform2fv(this.#places.range, range);
      gl.uniform1f(this.#places.size, 3 * devicePixelRatio);
      gl.drawArrays(lines ? gl.LINES : gl.POINTS, 0, count);
    }
  }
}

function perspective(aspect, near = 0.1, far = 1000) {
  const scale = 1.6;
  return new Float32Array([scale / aspect, 0, 0, 0, 0, scale, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, (2 * far * near) / (near - far), 0]);
}

/** Return the matrix of a camera that looks from `distance` at a point; `tilt` is the angle above the horizon. */
function looking({ x, y, z, turn, tilt, distance }) {
  const [ct, st, cp, sp] = [Math.cos(turn), Math.sin(turn), Math.cos(tilt), Math.sin(tilt)];
  const right = [ct, st, 0];
  const back = [st * cp, -ct * cp, sp];
  const up = [-st * sp, ct * sp, cp];
  const along = (axis) => -(axis[0] * x + axis[1] * y + axis[2] * z);
  return new Float32Array([right[0], up[0], back[0], 0, right[1], up[1], back[1], 0, right[2], up[2], back[2], 0,
    along(right), along(up), along(back) - distance, 1]);
}
