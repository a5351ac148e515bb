// Definitions of ROS types: the message that has the default value in each field, to start a form with.

const NUMBERS = /^(byte|char|u?int(8|16|32|64)|float(32|64))$/;
const FIELD = /^\s*([\w/]+)(?:<=\d+)?(\[(?:<=)?(\d*)\])?\s+([a-z]\w*)(?:\s+([^#]*))?/i;

/** Return the messages that a definition begins with: one of a message, request and response of a service. */
export function templates(texts, name, sort) {
  const text = texts[full(name, sort)] ?? "";
  return text.split(/^---.*$/m).map((part) => fields(texts, part, name.split("/")[0]));
}

function fields(texts, text, pkg) {
  const made = {};
  for (const line of text.split("\n")) {
    const found = FIELD.exec(line.replace(/#.*/, ""));
    if (!found || /^\s*[\w/<=]+\s+\w+\s*=/.test(line)) continue; // blank, or a constant
    const [, type, array, length, field, given = ""] = found;
    if (given.trim()) made[field] = literal(given.trim());
    else if (array) made[field] = array.includes("<=") || !length ? [] : Array.from({ length: Number(length) }, () => value(texts, type, pkg));
    else made[field] = value(texts, type, pkg);
  }
  return made;
}

function value(texts, type, pkg) {
  if (type === "bool") return false;
  if (NUMBERS.test(type)) return 0;
  if (/^w?string$/.test(type)) return "";
  const name = type.includes("/") ? type : type === "Header" ? "std_msgs/Header" : `${pkg}/${type}`;
  return fields(texts, texts[full(name, "msg")] ?? "", name.split("/")[0]);
}

function literal(text) {
  const word = text.toLowerCase();
  try {
    return JSON.parse(["true", "false"].includes(word) ? word : text.replace(/^'(.*)'$/, '"$1"'));
  } catch {
    return text;
  }
}

/** Return the name under which `texts` has a type: `std_msgs/msg/String`. */
function full(name, sort) {
  const [pkg, ...rest] = name.split("/");
  return `${pkg}/${rest.length > 1 ? rest[0] : sort}/${rest.at(-1)}`;
}
