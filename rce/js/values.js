// Conversion between JavaScript values and frames: objects as JSON, bytes (Uint8Array) as blobs, NaN and infinities,
// and integers beyond 2^53 as BigInt.

import { InvalidRequest } from "./errors.js";

const NOT_FINITE = new Map([["NaN", NaN], ["Infinity", Infinity], ["-Infinity", -Infinity]]);
const LARGE = /[:[,]-?\d{16,}[,\]}]/;
const ID = /^[0-9a-fA-F]{32}$/;

/** 32 random hex digits. (`crypto.randomUUID` exists only on pages from https.) */
export function freshId() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** Encode a value as JSON. Throws InvalidRequest for a value without JSON representation. */
export function encode(value) {
  try {
    return JSON.stringify(value, (_, item) => {
      if (typeof item === "number" && !Number.isFinite(item)) return String(item); // the form that the platform accepts
      if (typeof item === "bigint") return large(item);
      return ArrayBuffer.isView(item) ? Array.from(item) : item;
    });
  } catch (error) {
    throw new InvalidRequest(`the value cannot be sent as JSON: ${error.message}`);
  }
}

function large(number) {
  if (Number.isSafeInteger(Number(number))) return Number(number);
  if (!JSON.rawJSON) throw new Error("this JavaScript has no JSON.rawJSON, which integers beyond 2^53 need");
  return JSON.rawJSON(String(number));
}

/** Parse JSON; integers beyond 2^53 become BigInt if this JavaScript engine supports it. */
export function decode(text) {
  if (!LARGE.test(text)) return JSON.parse(text);
  return JSON.parse(text, (_, value, context) =>
    typeof value === "number" && !Number.isSafeInteger(value) && /^-?\d+$/.test(context?.source ?? "")
      ? BigInt(context.source) : value);
}

/** Replace strings that name NaN or infinities by these numbers, in place. */
export function floats(value) {
  for (const [key, item] of Object.entries(value ?? {})) {
    if (typeof item === "string") value[key] = NOT_FINITE.has(item) ? NOT_FINITE.get(item) : item;
    else if (item && typeof item === "object" && !ArrayBuffer.isView(item)) floats(item);
  }
  return value;
}

const isBytes = (value) => value instanceof Uint8Array || value instanceof ArrayBuffer;

/** Return `value` with new ids in place of its bytes (`key` becomes `key*`), and add the bytes to `blobs` by id. */
export function detach(value, blobs) {
  if (Array.isArray(value)) {
    return typeof value[0] === "object" ? value.map((item) => detach(item, blobs)) : value;
  }
  if (!value || typeof value !== "object" || ArrayBuffer.isView(value)) return value;
  const keep = (bytes) => {
    const id = freshId();
    blobs.set(id, bytes instanceof Uint8Array ? bytes : new Uint8Array(bytes));
    return id;
  };
  const result = {};
  for (const [key, item] of Object.entries(value)) {
    if (isBytes(item)) result[`${key}*`] = keep(item);
    else if (Array.isArray(item) && item.length && item.every(isBytes)) result[`${key}*`] = item.map(keep);
    else result[key] = detach(item, blobs);
  }
  return result;
}

/** The set of ids of all blobs to which a value refers. */
export function references(value, found = new Set()) {
  for (const [key, item] of Object.entries(value ?? {})) {
    if (key.endsWith("*") && !Array.isArray(value)) {
      for (const id of [item].flat()) if (ID.test(id)) found.add(id);
    } else if (item && typeof item === "object") references(item, found);
  }
  return found;
}

/** Replace references by the blobs, in place: `key*` becomes `key`. */
export function attach(value, blobs) {
  for (const [key, item] of Object.entries(value ?? {})) {
    const ids = [item].flat();
    if (key.endsWith("*") && ids.every((id) => blobs.has(id))) {
      delete value[key];
      value[key.slice(0, -1)] = Array.isArray(item) ? ids.map((id) => blobs.get(id)) : blobs.get(item);
    } else if (item && typeof item === "object") attach(item, blobs);
  }
  return value;
}
