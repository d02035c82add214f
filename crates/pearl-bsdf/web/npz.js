/**
 * Reads NumPy archives (`.npz`): a ZIP file of named arrays, stored or deflated.
 *
 * @typedef {{shape: number[], data: Float32Array}} NamedArray
 * @typedef {Object<string, NamedArray>} Arrays
 */

const END_OF_DIRECTORY = 0x06054b50;
const DIRECTORY_ENTRY = 0x02014b50;

/**
 * The bytes of a deflated or gzipped stream.
 * @param {Uint8Array} bytes
 * @param {CompressionFormat} format
 */
export async function inflate(bytes, format) {
  const stream = new Blob([/** @type {BlobPart} */ (bytes)]).stream().pipeThrough(new DecompressionStream(format));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/**
 * Files of a ZIP archive by name.
 * @param {Uint8Array} bytes
 * @returns {Promise<Map<string, Uint8Array>>}
 */
export async function unzip(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let end = bytes.length - 22;
  while (end >= 0 && view.getUint32(end, true) !== END_OF_DIRECTORY) end--;
  if (end < 0) throw new Error("not a ZIP archive: it has no directory");
  const files = new Map();
  let at = view.getUint32(end + 16, true);
  for (let left = view.getUint16(end + 10, true); left > 0; left--) {
    if (view.getUint32(at, true) !== DIRECTORY_ENTRY) throw new Error("the directory of the ZIP archive is damaged");
    const method = view.getUint16(at + 10, true);
    const size = view.getUint32(at + 20, true);
    const [name, extra, comment] = [28, 30, 32].map((offset) => view.getUint16(at + offset, true));
    const local = view.getUint32(at + 42, true);
    const key = new TextDecoder().decode(bytes.subarray(at + 46, at + 46 + name));
    const start = local + 30 + view.getUint16(local + 26, true) + view.getUint16(local + 28, true);
    const packed = bytes.subarray(start, start + size);
    if (method !== 0 && method !== 8) throw new Error(`${key}: compressed by method ${method}; expected 0 or 8`);
    files.set(key, method === 8 ? await inflate(packed, "deflate-raw") : packed);
    at += 46 + name + extra + comment;
  }
  return files;
}

/**
 * Half-precision numbers as single ones.
 * @param {Uint16Array} halves
 */
export function widen(halves) {
  const wide = new Float32Array(halves.length);
  for (let i = 0; i < halves.length; i++) {
    const half = halves[i];
    const sign = half & 0x8000 ? -1 : 1;
    const exponent = (half >> 10) & 31;
    const fraction = half & 1023;
    if (exponent === 0) wide[i] = sign * fraction * 2 ** -24;
    else if (exponent === 31) wide[i] = fraction ? NaN : sign * Infinity;
    else wide[i] = sign * (1 + fraction / 1024) * 2 ** (exponent - 15);
  }
  return wide;
}

/**
 * One array in NumPy's format.
 * @param {string} name
 * @param {Uint8Array} bytes
 * @returns {NamedArray}
 */
function npy(name, bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  if (bytes[0] !== 0x93) throw new Error(`${name}: not a NumPy array`);
  const [length, start] = bytes[6] === 1 ? [view.getUint16(8, true), 10] : [view.getUint32(8, true), 12];
  const header = new TextDecoder("latin1").decode(bytes.subarray(start, start + length));
  const kind = /'descr':\s*'([^']+)'/.exec(header)?.[1];
  const listed = /'shape':\s*\(([^)]*)\)/.exec(header)?.[1];
  if (listed === undefined || /'fortran_order':\s*True/.test(header)) throw new Error(`${name}: its header is not understood`);
  const shape = listed.split(",").filter((text) => text.trim()).map(Number);
  const count = shape.reduce((a, b) => a * b, 1);
  const wide = { "<f4": 4, "<f2": 2 }[kind ?? ""];
  if (!wide) throw new Error(`${name}: holds ${kind}; expected '<f4' or '<f2'`);
  if (start + length + count * wide > bytes.length) throw new Error(`${name}: ends too early`);
  // A copy: the numbers in the file need not be aligned.
  const body = bytes.slice(start + length, start + length + count * wide);
  return { shape, data: wide === 4 ? new Float32Array(body.buffer) : widen(new Uint16Array(body.buffer)) };
}

/**
 * The arrays of an archive by name.
 * @param {ArrayBuffer | Uint8Array} file
 * @returns {Promise<Arrays>}
 */
export async function readNpz(file) {
  const bytes = file instanceof Uint8Array ? file : new Uint8Array(file);
  /** @type {Arrays} */
  const arrays = {};
  for (const [name, body] of await unzip(bytes)) {
    if (name.endsWith(".npy")) arrays[name.slice(0, -4)] = npy(name, body);
  }
  return arrays;
}
