// Clouds in PLY files as the mapper in three dimensions writes them: binary, little endian.

import { IDENTITY } from "./tf.js";

const SIZES = { char: 1, uchar: 1, short: 2, ushort: 2, int: 4, uint: 4, float: 4, double: 8 };
const READERS = { char: "getInt8", uchar: "getUint8", short: "getInt16", ushort: "getUint16", int: "getInt32", uint: "getUint32", float: "getFloat32", double: "getFloat64" };
const END = "end_header\n";

/** Return `points`, four numbers each: x, y, z and the colour as 65536 r + 256 g + b, and the `matrix` that makes them level. */
export function readPly(buffer) {
  const text = new TextDecoder("latin1").decode(buffer.slice(0, 4096));
  const end = text.indexOf(END);
  const lines = end < 0 ? [] : text.slice(0, end).split("\n").map((line) => line.trim().split(/\s+/));
  if (lines[0]?.[0] !== "ply" || !lines.some(([first, kind]) => first === "format" && kind === "binary_little_endian")) {
    throw new Error("This is not a binary PLY file.");
  }
  const [places, count, step] = layout(lines);
  if (!["x", "y", "z"].every((name) => places[name])) throw new Error("The PLY file has no points.");
  const start = end + END.length;
  if (buffer.byteLength < start + count * step) throw new Error("The PLY file is not complete.");
  const view = new DataView(buffer);
  const read = (name, at) => (places[name] ? view[READERS[places[name].kind]](at + places[name].offset, true) : 160);
  const points = new Float32Array(4 * count);
  for (let index = 0, at = start; index < count; index += 1, at += step) {
    points.set([read("x", at), read("y", at), read("z", at), 65536 * read("red", at) + 256 * read("green", at) + read("blue", at)], 4 * index);
  }
  const level = lines.find(([first, word]) => first === "comment" && word === "level");
  return { points, matrix: level ? columns(level.slice(2).map(Number)) : IDENTITY };
}

/** Return where the properties of vertices are, their number, and the bytes of one. */
function layout(lines) {
  const places = {};
  let [count, offset, inside] = [0, 0, false];
  for (const [first, ...words] of lines) {
    if (first === "element") [inside, count] = words[0] === "vertex" ? [true, Number(words[1])] : [false, count];
    if (first === "property" && inside) {
      if (!SIZES[words[0]]) throw new Error(`The PLY file has vertices with a ${words[0]}.`);
      places[words[1]] = { kind: words[0], offset };
      offset += SIZES[words[0]];
    }
  }
  return [places, count, offset];
}

/** Return a matrix by columns, as WebGL has them, from its 16 numbers by rows. */
function columns(rows) {
  if (rows.length !== 16 || rows.some(Number.isNaN)) throw new Error("The PLY file has no level frame.");
  return new Float32Array(rows.map((_, at) => rows[4 * (at % 4) + Math.floor(at / 4)]));
}
