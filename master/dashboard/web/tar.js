// Archives of packages, in the one form that the platform takes: rce.packages.archive describes it. Free of the DOM.

const BLOCK = 512;
const [NAME, PREFIX] = [100, 155]; // bytes

/** Return the archive of files {path, bytes, executable}. Throws an Error if a path does not fit. */
export function archive(files) {
  const sorted = [...files].sort((a, b) => (a.path < b.path ? -1 : 1));
  const blocks = sorted.map((each) => BLOCK + Math.ceil(each.bytes.length / BLOCK) * BLOCK);
  const all = new Uint8Array(blocks.reduce((sum, size) => sum + size, 2 * BLOCK));
  let at = 0;
  sorted.forEach((each, index) => {
    all.set(header(each), at);
    all.set(each.bytes, at + BLOCK);
    at += blocks[index];
  });
  return all;
}

function header({ path, bytes, executable }) {
  const block = new Uint8Array(BLOCK);
  const put = (text, at) => block.set(new TextEncoder().encode(text), at);
  const number = (value, digits) => `${value.toString(8).padStart(digits, "0")}\0`;
  const [prefix, name] = parts(path);
  put(name, 0);
  put(number(executable ? 0o755 : 0o644, 7) + number(0, 7) + number(0, 7) + number(bytes.length, 11) + number(0, 11), 100);
  put("        0", 148);
  put("ustar\x0000", 257);
  put(prefix, 345);
  const sum = block.reduce((total, each) => total + each, 0);
  put(`${number(sum, 6)} `, 148);
  return block;
}

/** Return the two parts in which the header has a path. */
function parts(path) {
  if (!/^[\x20-\x7e]+$/.test(path)) throw new Error(`${path}: names of files must be plain characters`);
  if (path.length <= NAME) return ["", path];
  const cut = path.lastIndexOf("/", PREFIX);
  if (cut < 0 || path.length - cut - 1 > NAME) throw new Error(`${path}: this path is too long for an archive`);
  return [path.slice(0, cut), path.slice(cut + 1)];
}
