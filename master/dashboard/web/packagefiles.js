// Selection of the files of a directory that make up its ROS packages, as `rce package push` selects them.

const INSTALLED = /^(share|lib|local|python)\//; // of an install space; headers and set-up scripts are not needed
const EXCLUDED = /(^|\/)(\.[^/]*|__pycache__|node_modules)(\/|$)/;
const NEEDS_BUILD = /(^|\/)(setup\.py|setup\.cfg|pyproject\.toml|Cargo\.toml|[^/]+\.(c|cc|cpp|cxx|pyx|rs|msg|srv|action))$/;
const TOO_LARGE = 500e6; // bytes that a page should keep in memory

/** Return {name, files: [{path, bytes, executable}, …]} of the files [{path, file}, …] of one directory.
 * Throws an Error if they are no packages that run as they are. */
export async function packageFiles(given) {
  const kept = given.filter(({ path }) => !EXCLUDED.test(path));
  const [top] = kept[0]?.path.split("/") ?? [""];
  const inside = kept.filter(({ path }) => path.startsWith(`${top}/`)).map(({ path, file }) => ({ path: path.slice(top.length + 1), file }));
  if (kept.reduce((sum, { file }) => sum + file.size, 0) > TOO_LARGE) throw new Error("This is much for a browser: use rce package push.");
  if (inside.some(({ path }) => path === "package.xml")) return sources(inside, [""]);
  if (inside.some(({ path }) => /^share\/[^/]+\/package\.xml$/.test(path))) {
    return { name: plain(top), files: await Promise.all(inside.filter(({ path }) => INSTALLED.test(path)).map(({ path, file }) => content(path, file))) };
  }
  const roots = inside.filter(({ path }) => /^[^/]+\/package\.xml$/.test(path)).map(({ path }) => path.slice(0, -"package.xml".length));
  if (!roots.length) throw new Error(`${top || "This"} is no ROS package: it has no package.xml, and no directory with one.`);
  const found = await sources(inside, roots);
  return { ...found, name: roots.length > 1 ? plain(top) : found.name };
}

async function sources(inside, roots) {
  const all = [];
  let name = "";
  for (const root of roots) {
    const own = inside.filter(({ path }) => path.startsWith(root));
    const built = own.find(({ path }) => NEEDS_BUILD.test(path));
    if (built) throw new Error(`${built.path} has to be built before it can run: push this package with rce package push, which says how.`);
    const manifest = own.find(({ path }) => path === `${root}package.xml`);
    const xml = new DOMParser().parseFromString(await manifest.file.text(), "text/xml");
    name = xml.querySelector("package > name")?.textContent.trim() ?? "";
    if (!name) throw new Error(`${root}package.xml has no name.`);
    const own_ = name;
    all.push(...await Promise.all(own.map(({ path, file }) => content(`${own_}/${path.slice(root.length)}`, file))));
  }
  return { name, files: all };
}

/** Return a file of the archive. Browsers do not tell which files are executable: those that name their interpreter are. */
async function content(path, file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  const executable = (bytes[0] === 0x23 && bytes[1] === 0x21) || (bytes[0] === 0x7f && bytes[1] === 0x45 && bytes[2] === 0x4c);
  return { path, bytes, executable };
}

const plain = (name) => name.replace(/[^A-Za-z0-9_]/g, "_").replace(/^[^A-Za-z]+/, "") || "packages";
