// Transforms between frames, as /tf and /tf_static publish them. Matrices are 4x4, by columns, as WebGL takes them.

const MAX_DEPTH = 100; // of the tree; a cycle would have no root

/** Return the product of two matrices. */
export function multiply(a, b) {
  const made = new Float32Array(16);
  for (let column = 0; column < 4; column += 1) {
    for (let row = 0; row < 4; row += 1) {
      for (let at = 0; at < 4; at += 1) made[4 * column + row] += a[4 * at + row] * b[4 * column + at];
    }
  }
  return made;
}

export const IDENTITY = new Float32Array([1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]);

/** Return the matrix of a translation [x, y, z] in metres and a rotation, the quaternion [x, y, z, w]. */
export function rigid([tx, ty, tz], [x, y, z, w]) {
  return new Float32Array([
    1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w), 0,
    2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w), 0,
    2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y), 0,
    tx, ty, tz, 1]);
}

/** The newest transform of each frame to its parent. */
export class Transforms {
  #parents = new Map(); // child -> {parent, matrix}

  put({ parent, child, translation, rotation }) {
    this.#parents.set(plain(child), { parent: plain(parent), matrix: rigid(translation, rotation) });
  }

  /** Return {root, matrix}: the frame at the root of the tree of `frame`, and the matrix from `frame` to it. */
  toRoot(frame) {
    let [root, matrix] = [plain(frame), IDENTITY];
    for (let depth = 0; depth < MAX_DEPTH && this.#parents.has(root); depth += 1) {
      const up = this.#parents.get(root);
      [root, matrix] = [up.parent, multiply(up.matrix, matrix)];
    }
    return { root, matrix };
  }
}

const plain = (frame) => frame.replace(/^\//, "");
