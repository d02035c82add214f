/**
 * OpenEXR: writes pictures of 32-bit floats without compression; reads scan lines of half or single precision, uncompressed or ZIP.
 */

import { inflate, widen } from "nacre/npz.js";

/**
 * @param {Float32Array} pixels RGBA, top row first
 * @param {number} width
 * @param {number} height
 */
export function writeExr(pixels, width, height) {
  const channels = ["B", "G", "R"];
  const order = [2, 1, 0];
  const text = new TextEncoder();
  /** @type {Uint8Array[]} */
  const parts = [];
  const bytes = (/** @type {number[]} */ list) => Uint8Array.from(list);
  const number = (/** @type {number} */ value) => new Uint8Array(new Int32Array([value]).buffer);
  const float = (/** @type {number} */ value) => new Uint8Array(new Float32Array([value]).buffer);
  const named = (/** @type {string} */ name) => text.encode(`${name}\0`);
  const join = (/** @type {Uint8Array[]} */ list) => {
    const all = new Uint8Array(list.reduce((sum, part) => sum + part.length, 0));
    let at = 0;
    for (const part of list) { all.set(part, at); at += part.length; }
    return all;
  };
  const attribute = (/** @type {string} */ name, /** @type {string} */ type, /** @type {Uint8Array} */ value) => parts.push(named(name), named(type), number(value.length), value);
  const window = join([number(0), number(0), number(width - 1), number(height - 1)]);
  parts.push(bytes([0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0]));
  attribute("channels", "chlist", join([...channels.flatMap((name) => [named(name), number(2), bytes([0, 0, 0, 0]), number(1), number(1)]), bytes([0])]));
  attribute("compression", "compression", bytes([0]));
  attribute("dataWindow", "box2i", window);
  attribute("displayWindow", "box2i", window);
  attribute("lineOrder", "lineOrder", bytes([0]));
  attribute("pixelAspectRatio", "float", float(1));
  attribute("screenWindowCenter", "v2f", join([float(0), float(0)]));
  attribute("screenWindowWidth", "float", float(1));
  parts.push(bytes([0]));
  const header = join(parts);
  const line = 8 + 4 * channels.length * width;
  const file = new Uint8Array(header.length + 8 * height + line * height);
  const view = new DataView(file.buffer);
  file.set(header);
  for (let y = 0; y < height; y++) {
    const start = header.length + 8 * height + y * line;
    view.setBigUint64(header.length + 8 * y, BigInt(start), true);
    view.setInt32(start, y, true);
    view.setInt32(start + 4, line - 8, true);
    order.forEach((channel, k) => {
      for (let x = 0; x < width; x++) view.setFloat32(start + 8 + 4 * (k * width + x), pixels[4 * (y * width + x) + channel], true);
    });
  }
  return file;
}

/**
 * Undoes what EXR does to bytes before it deflates them.
 * @param {Uint8Array} bytes
 */
function restored(bytes) {
  for (let i = 1; i < bytes.length; i++) bytes[i] = (bytes[i - 1] + bytes[i] - 128) & 255;
  const out = new Uint8Array(bytes.length);
  const half = (bytes.length + 1) >> 1;
  for (let i = 0; i < bytes.length; i++) out[i] = bytes[(i & 1 ? half : 0) + (i >> 1)];
  return out;
}

/**
 * Reads R, G and B of a picture.
 * @param {ArrayBuffer} file
 * @returns {Promise<{width: number, height: number, rgb: Float32Array}>} top row first
 */
export async function readExr(file) {
  const bytes = new Uint8Array(file);
  const view = new DataView(file);
  if (view.getUint32(0, true) !== 0x01312f76) throw new Error("not an OpenEXR file");
  if (view.getUint32(4, true) & 0x1a00) throw new Error("tiles, deep pixels and several parts are not read: save it as scan lines");
  let at = 8;
  const word = () => {
    const end = bytes.indexOf(0, at);
    if (end < 0) throw new Error("its header ends too early");
    const found = new TextDecoder("latin1").decode(bytes.subarray(at, end));
    at = end + 1;
    return found;
  };
  /** @type {{name: string, type: number}[]} */
  const channels = [];
  let compression = 0;
  let [left, top, right, bottom] = [0, 0, -1, -1];
  for (let name = word(); name; name = word()) {
    word();
    const size = view.getInt32(at, true);
    const next = at + 4 + size;
    at += 4;
    if (name === "compression") compression = bytes[at];
    if (name === "dataWindow") [left, top, right, bottom] = [0, 4, 8, 12].map((k) => view.getInt32(at + k, true));
    if (name === "channels") {
      for (let channel = word(); channel; channel = word()) {
        channels.push({ name: channel, type: view.getInt32(at, true) });
        at += 16;
      }
    }
    at = next;
  }
  const [width, height] = [right - left + 1, bottom - top + 1];
  if (!(width > 0 && height > 0 && width * height <= 2 ** 26)) throw new Error(`${width} × ${height} pixels; expected up to 67 million`);
  if (![0, 2, 3].includes(compression)) throw new Error("it is compressed by a method that is not read: save it with ZIP compression, or with none");
  const lines = compression === 3 ? 16 : 1;
  const row = channels.reduce((sum, { type }) => sum + (type === 1 ? 2 : 4) * width, 0);
  const rgb = new Float32Array(3 * width * height);
  const chunks = Math.ceil(height / lines);
  for (let chunk = 0; chunk < chunks; chunk++) {
    const start = Number(view.getBigUint64(at + 8 * chunk, true));
    const y0 = view.getInt32(start, true) - top;
    const size = view.getInt32(start + 4, true);
    const count = Math.min(lines, height - y0);
    let data = bytes.slice(start + 8, start + 8 + size);
    if (compression !== 0 && size < row * count) data = restored(await inflate(data, "deflate"));
    for (let y = 0; y < count; y++) {
      let from = y * row;
      for (const { name, type } of channels) {
        const wide = type === 1 ? 2 : 4;
        const part = data.slice(from, from + wide * width);
        const numbers = type === 1 ? widen(new Uint16Array(part.buffer)) : new Float32Array(part.buffer);
        const k = "RGB".indexOf(name);
        const targets = name === "Y" ? [0, 1, 2] : k < 0 ? [] : [k];
        for (const target of targets) for (let x = 0; x < width; x++) rgb[3 * ((y0 + y) * width + x) + target] = numbers[x];
        from += wide * width;
      }
    }
  }
  return { width, height, rgb };
}
