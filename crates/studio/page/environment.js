/**
 * Pictures of surroundings, Radiance HDR or OpenEXR with equal steps of latitude and longitude, and what the shaders sample
 * them by.
 *
 * @typedef {object} Environment
 * @property {number} width
 * @property {number} height
 * @property {Float32Array} texels radiance, and the integral along the row, RGBA, the zenith first
 * @property {Float32Array} rows integral over the rows
 */

import { readExr } from "nacre/exr.js";

/** Larger pictures are averaged down to this width. */
const MOST_WIDTH = 1024;

/**
 * Radiance HDR: run lengths, or plain.
 * @param {ArrayBuffer} file
 */
export function readHdr(file) {
  const bytes = new Uint8Array(file);
  let at = 0;
  const line = () => {
    const end = bytes.indexOf(10, at);
    if (end < 0) throw new Error("its header ends too early");
    const found = new TextDecoder("latin1").decode(bytes.subarray(at, end));
    at = end + 1;
    return found;
  };
  if (!line().startsWith("#?")) throw new Error("not a Radiance HDR file");
  while (line().trim() !== "") { /* formats and exposures */ }
  const size = /^-Y (\d+) \+X (\d+)/.exec(line());
  if (!size) throw new Error("its lines are not from top to bottom (-Y … +X …)");
  const [height, width] = [Number(size[1]), Number(size[2])];
  if (!(width > 0 && height > 0 && width * height <= 2 ** 26)) throw new Error(`${width} × ${height} pixels; expected up to 67 million`);
  const rgb = new Float32Array(3 * width * height);
  const scan = new Uint8Array(4 * width);
  for (let y = 0; y < height; y++) {
    const packed = width >= 8 && width < 32768 && bytes[at] === 2 && bytes[at + 1] === 2 && bytes[at + 2] < 128;
    if (packed) {
      at += 4;
      for (let k = 0; k < 4; k++) {
        for (let x = 0; x < width;) {
          const count = bytes[at++];
          if (!count) throw new Error("it ends too early");
          const run = count > 128 ? count - 128 : count;
          for (let i = 0; i < run && x < width; i++, x++) scan[4 * x + k] = bytes[count > 128 ? at : at + i];
          at += count > 128 ? 1 : run;
        }
      }
    } else {
      scan.set(bytes.subarray(at, at + 4 * width));
      at += 4 * width;
    }
    for (let x = 0; x < width; x++) {
      const scale = scan[4 * x + 3] ? 2 ** (scan[4 * x + 3] - 136) : 0;
      for (let k = 0; k < 3; k++) rgb[3 * (y * width + x) + k] = (scan[4 * x + k] + 0.5) * scale;
    }
  }
  return { width, height, rgb };
}

/**
 * What the shaders read of a picture.
 * @param {{width: number, height: number, rgb: Float32Array}} picture
 * @returns {Environment}
 */
export function environmentOf(picture) {
  const step = Math.max(1, Math.ceil(picture.width / MOST_WIDTH));
  const [width, height] = [Math.floor(picture.width / step), Math.floor(picture.height / step)];
  const texels = new Float32Array(4 * width * height);
  const rows = new Float32Array(height);
  let sum = 0;
  for (let y = 0; y < height; y++) {
    let row = 0;
    for (let x = 0; x < width; x++) {
      const to = 4 * (y * width + x);
      for (let k = 0; k < 3; k++) {
        let mean = 0;
        for (let j = 0; j < step; j++) for (let i = 0; i < step; i++) mean += picture.rgb[3 * ((y * step + j) * picture.width + x * step + i) + k];
        texels[to + k] = Math.min(Math.max(mean / step ** 2 || 0, 0), 1e6);
      }
      row += texels[to] + texels[to + 1] + texels[to + 2] + 1e-9;
      texels[to + 3] = row;
    }
    for (let x = 0; x < width; x++) texels[4 * (y * width + x) + 3] /= row;
    sum += row * Math.sin((Math.PI * (y + 0.5)) / height);
    rows[y] = sum;
  }
  for (let y = 0; y < height; y++) rows[y] /= sum;
  return { width, height, texels, rows };
}

/**
 * @param {string} name
 * @param {ArrayBuffer} file
 */
export async function readEnvironment(name, file) {
  return environmentOf(/\.exr$/i.test(name) ? await readExr(file) : readHdr(file));
}
