// Files that the user drops on a page or chooses: an area for both, and the files of dropped directories.

import { attempt, h } from "./dom.js";

/** Return an area for files. `use` gets [{path, file}, …]; with `directory` the button chooses a directory. */
export function dropArea(text, button, use, { directory = false, accept = "" } = {}) {
  const input = h("input", { type: "file", hidden: true, multiple: true, webkitdirectory: directory, accept, "aria-label": button });
  const element = h("div.drop", h("p", text), h("button", { type: "button", onclick: () => input.click() }, button), input);
  input.onchange = () => {
    const files = [...input.files].map((file) => ({ path: file.webkitRelativePath || file.name, file }));
    input.value = "";
    if (files.length) attempt(() => use(files));
  };
  const over = (event) => { event.preventDefault(); element.classList.toggle("over", event.type === "dragover"); };
  element.ondragover = element.ondragleave = over;
  element.ondrop = (event) => {
    over(event);
    const found = [...event.dataTransfer.items].filter((each) => each.kind === "file").map((each) => {
      const entry = each.webkitGetAsEntry(); // now: after the event there is nothing left
      const file = each.getAsFile();
      return entry ? read(entry) : [{ path: file.name, file }];
    });
    attempt(async () => use((await Promise.all(found)).flat()));
  };
  return element;
}

/** Return the files below an entry of the file system, by paths that begin with its name. */
async function read(entry) {
  const path = entry.fullPath.slice(1);
  if (entry.isFile) return [{ path, file: await new Promise((found, failed) => { entry.file(found, failed); }) }];
  const reader = entry.createReader();
  const children = [];
  for (;;) { // readEntries returns a part at a time
    const some = await new Promise((found, failed) => { reader.readEntries(found, failed); });
    if (!some.length) break;
    children.push(...some);
  }
  return (await Promise.all(children.map(read))).flat();
}
