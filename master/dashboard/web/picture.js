// Images of a topic on a canvas; images that come while one is decoded are dropped.

import { h } from "./dom.js";

export class Picture {
  #busy = false;
  #times = [];

  constructor() {
    this.element = h("canvas.picture", { role: "img", "aria-label": "Image of the topic", width: 4, height: 3 });
    this.status = h("p.soft", { role: "status" }, "Waiting for an image …");
  }

  /** Show the bytes of an image file, or a CompressedImage, whose data is base64. */
  async take(message) {
    if (this.#busy || document.hidden) return;
    this.#busy = true;
    try {
      const bytes = message instanceof Uint8Array ? message : Uint8Array.from(atob(message.data), (each) => each.charCodeAt(0));
      const bitmap = await createImageBitmap(new Blob([bytes]));
      this.draw(bitmap, bitmap.width, bitmap.height);
    } catch (error) {
      this.status.textContent = `This image cannot be shown: ${error.message}`;
    } finally {
      this.#busy = false;
    }
  }

  /** Show an image, and release it. */
  draw(image, width, height) {
    const { element } = this;
    if (element.width !== width || element.height !== height) [element.width, element.height] = [width, height];
    element.getContext("2d").drawImage(image, 0, 0);
    image.close();
    this.#tell();
  }

  #tell() {
    const now = performance.now();
    this.#times = [...this.#times.filter((each) => each > now - 2000), now];
    this.status.textContent = `${this.element.width} × ${this.element.height}, ${Math.round(this.#times.length / 2)} images a second`;
  }
}
