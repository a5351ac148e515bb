// Entries of a platform: one, or those of several Masters, of which one leads.

/** Return the URLs in a text that separates them by commas. */
export function entries(urls) {
  const found = String(urls).split(",").map((url) => url.trim()).filter(Boolean);
  return found.length ? found : [String(urls)];
}
