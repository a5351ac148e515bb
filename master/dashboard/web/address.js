// The query of the address: by what a page is filtered survives a reload, and can be sent to others.

/** Change values of the query; empty ones are removed. The page stays as it is. */
export function remember(changes) {
  const [path, query = ""] = location.hash.slice(1).split("?");
  const all = new URLSearchParams(query);
  for (const [name, value] of Object.entries(changes)) {
    if (value) all.set(name, value);
    else all.delete(name);
  }
  history.replaceState(null, "", `#${path || "/"}${all.size ? `?${all}` : ""}`);
}
