// Messages as JavaScript values: objects as JSON, bytes (Uint8Array) as blobs beside it, and the numbers that JSON or
// JavaScript does not have: NaN, infinities, and integers beyond 2^53, which are BigInt.

import { InvalidRequest } from "./errors.js";

const NOT_FINITE = new Map([["NaN", NaN], ["Infinity", Infinity], ["-Infinity", -Infinity]]);
const LARGE = /[:[,]-?\d{16,}[,\]}]/;
const ID = /^[0-9a-fA-F]{32}$/;

/** 32 random hex digits. (`crypto.randomUUID` is only there on pages that came by https.) */
export function freshId() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** JSON of a frame. InvalidRequest for what has no JSON. */
export function encode(value) {
  try {
    return JSON.stringify(value, (_, item) => {
      if (typeof item === "number" && !Number.isFinite(item)) return String(item); // so the platform takes them
      if (typeof item === "bigint") return large(item);
      return ArrayBuffer.isView(item) ? Array.from(item) : item;
    });
  } catch (error) {
    throw new InvalidRequest(`this cannot be sent as JSON: ${error.message}`);
  }
}

function large(number) {
  if (Number.isSafeInteger(Number(number))) return Number(number);
  if (!JSON.rawJSON) throw new Error("this JavaScript has no JSON.rawJSON, which integers beyond 2^53 need");
  return JSON.rawJSON(String(number));
}

/** Parsed JSON; integers beyond 2^53 as BigInt where this JavaScript can tell them. */
export function decode(text) {
  if (!LARGE.test(text)) return JSON.parse(text);
  return JSON.parse(text, (_, value, context) =>
    typeof value === "number" && !Number.isSafeInteger(value) && /^-?\d+$/.test(context?.source ?? "")
      ? BigInt(context.source) : value);
}

/** Strings of the names of NaN and infinities as these. Changes `value` in place. */
export function floats(value) {
  for (const [key, item] of Object.entries(value ?? {})) {
    if (typeof item === "string") value[key] = NOT_FINITE.has(item) ? NOT_FINITE.get(item) : item;
    else if (item && typeof item === "object" && !ArrayBuffer.isView(item)) floats(item);
  }
  return value;
}

const isBytes = (value) => value instanceof Uint8Array || value instanceof ArrayBuffer;

/** `value` with fresh ids in place of its bytes (`key` becomes `key*`); the bytes go into `blobs`, a Map by id. */
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

/** The ids of all blobs that this value refers to, each once. */
export function references(value, found = new Set()) {
  for (const [key, item] of Object.entries(value ?? {})) {
    if (key.endsWith("*") && !Array.isArray(value)) {
      for (const id of [item].flat()) if (ID.test(id)) found.add(id);
    } else if (item && typeof item === "object") references(item, found);
  }
  return found;
}

/** Put the blobs where decoded JSON refers to them: `key*` becomes `key`. Changes `value` in place. */
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
