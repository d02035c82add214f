/**
 * What the controls make of the colours of a table: the curves of docs/ARRAYS.md §3 and the chances of §5. All of it
 * depends on one angle only, so that a control moves by writing a few thousand numbers.
 *
 * @import {Look, Table} from "nacre/table.js"
 *
 * @typedef {{diffuse: boolean, incoherent: boolean, mirror: boolean, blur: boolean}} Shown
 *
 * @typedef {object} Shares curves of one band, [channel · nodes + node] where not said otherwise
 * @property {Float32Array} modulation M over θd
 * @property {Float64Array} limit of the lobes
 * @property {Float64Array} rest 1 − A
 * @property {Float64Array} emission tint·Ê
 * @property {Float64Array} base by channel: 1/(π(1 − A_avg)), 0 where nothing is left
 * @property {Float64Array} body by channel
 * @property {Float64Array} tint by channel
 */

/** Components in the order of the shaders. */
export const COMPONENTS = /** @type {const} */ (["diffuse", "incoherent", "mirror", "blur"]);

/** @type {Shown} */
export const ALL_SHOWN = { diffuse: true, incoherent: true, mirror: true, blur: true };

/**
 * M, 1 − A and Ê of one band in red, green and blue, of a stack `thickness` times as thick as the recipe's.
 * @param {Table} table
 * @param {number} band
 * @param {number} thickness
 */
function colours({ arrays, bands, nodes }, band, thickness) {
  const size = 3 * nodes;
  const part = (/** @type {Float32Array} */ data, /** @type {number} */ at) => data.subarray(at * size, (at + 1) * size);
  if (thickness === 1 || !arrays.scale) {
    return { modulation: part(arrays.modulation_rgb.data, band), rest: part(arrays.rest_rgb.data, band), emission: arrays.emission_rgb.data };
  }
  const [k, t] = scaleAt(arrays.scale.data, thickness);
  const between = (/** @type {string} */ name, /** @type {(k: number) => number} */ place) => {
    const [low, high] = [k, k + 1].map((at) => part(arrays[name].data, place(at)));
    return low.map((x, i) => x + t * (high[i] - x));
  };
  return {
    modulation: between("modulation_rgb_scaled", (at) => at * bands + band), rest: between("rest_rgb_scaled", (at) => at * bands + band),
    emission: between("emission_rgb_scaled", (at) => at),
  };
}

/**
 * Where a thickness lies among the scales, in its logarithm.
 * @param {Float32Array} scales
 * @param {number} thickness
 * @returns {[number, number]}
 */
export function scaleAt(scales, thickness) {
  let k = 0;
  while (k < scales.length - 2 && scales[k + 1] <= thickness) k++;
  const [low, high] = [scales[k], scales[k + 1]].map(Math.log);
  return [k, Math.min(Math.max((Math.log(thickness) - low) / (high - low), 0), 1)];
}

/**
 * @param {Table} table
 * @param {number} band
 * @param {Look} look
 * @returns {Shares} in red, green and blue
 */
export function shares(table, band, look) {
  const { arrays, nodes } = table;
  const reflectance = arrays.reflectance_rgb;
  const channels = 3;
  const plain = arrays.rest_plain.data.subarray(band * nodes, (band + 1) * nodes);
  const { modulation, rest: coloured, emission: emitted } = colours(table, band, look.thickness);
  const weight = arrays.mean_weight.data;
  const { brightness, coherence } = look;
  const made = {
    modulation, limit: new Float64Array(channels * nodes), rest: new Float64Array(channels * nodes), emission: new Float64Array(channels * nodes),
    base: new Float64Array(channels), body: new Float64Array(channels), tint: new Float64Array(channels),
  };
  for (let c = 0; c < channels; c++) {
    const of = (/** @type {number[]} */ rgb) => rgb.reduce((sum, value, k) => sum + value * reflectance.data[3 * c + k], 0);
    const tint = (made.tint[c] = of(look.tint_rgb));
    made.body[c] = of(look.body_rgb);
    const from = c * nodes;
    let least = 1;
    for (let k = 0; k < nodes; k++) {
      const modulated = 1 + tint * (coloured[from + k] - 1);
      const rest = 1 + brightness * (plain[k] + coherence * (modulated - plain[k]) - 1);
      made.rest[c * nodes + k] = rest;
      made.limit[c * nodes + k] = 1 / Math.max(1 - rest, 1);
      least = Math.min(least, made.limit[c * nodes + k]);
    }
    let mean = 0;
    for (let k = 0; k < nodes; k++) {
      const i = c * nodes + k;
      if (table.reciprocal) made.limit[i] = least;
      made.rest[i] = Math.max(1 - (1 - made.rest[i]) * made.limit[i], 0);
      mean += made.rest[i] * weight[k];
      made.emission[i] = tint * emitted[i];
    }
    made.base[c] = mean > 1e-12 ? 1 / (Math.PI * mean) : 0;
  }
  return made;
}

/**
 * ρ(1 − depth) and ρ·depth·tint·Ê, lowered together where they exceed 1.
 * @param {Look} look
 * @param {number} body
 * @param {number} emission
 */
export function baseColour(look, body, emission) {
  const plain = 1 - look.depth;
  const coloured = look.depth * emission;
  const lowered = body / Math.max(body * (plain + coloured), 1);
  return [lowered * plain, lowered * coloured];
}

/**
 * Chances to sample interior, rehit, single reflection and base, by node: albedos of what is shown.
 * @param {Table} table
 * @param {Look} look
 * @param {Shown} shown
 * @param {Shares} of those of the first band in rgb
 */
export function chances(table, look, shown, of) {
  const { albedo_plain: plain, albedo_rgb: coloured } = table.arrays;
  const { nodes } = table;
  const channels = 3;
  const found = new Float64Array(4 * nodes);
  const keep = [shown.blur, shown.mirror, shown.mirror];
  for (let k = 0; k < nodes; k++) {
    let sum = 0;
    for (let c = 0; c < channels; c++) {
      const at = c * nodes + k;
      for (let lobe = 0; lobe < 3; lobe++) {
        const tinted = of.tint[c] * coloured.data[(c * 3 + lobe) * nodes + k];
        const albedo = look.brightness * (plain.data[lobe * nodes + k] + look.coherence * (tinted - plain.data[lobe * nodes + k]));
        if (keep[lobe]) found[4 * k + lobe] += Math.max(albedo, 0) * of.limit[at];
      }
      const [diffuse, incoherent] = baseColour(look, of.body[c], of.emission[at]);
      const seen = (shown.diffuse ? diffuse : 0) + (shown.incoherent ? incoherent : 0);
      if (of.base[c] > 0) found[4 * k + 3] += seen * of.rest[at];
    }
    for (let part = 0; part < 4; part++) sum += found[4 * k + part];
    for (let part = 0; part < 4; part++) found[4 * k + part] /= Math.max(sum, 1e-30);
  }
  return found;
}

/** Rows of the texture of curves that each band has, after the two common ones: chances, and tint·Ê. */
export const COMMON_ROWS = 2;
export const BAND_ROWS = 2;

/**
 * The texture of curves, RGBA, one row a curve: chances; tint·Ê; then of each band its share times the colour of the lobes over θd, and
 * what is left for the base (1 − A; and the factor of the single reflection). Where the lobes are limited nothing is left, and their
 * limit less 1 stands there: it is negative. The limit of reciprocal tables is one number, which the colour has.
 * @param {Table} table
 * @param {Look} look
 * @param {Shown} shown
 * @returns {{curves: Float32Array, base: Float32Array, body: number[]}} and by band its share over π(1 − A_avg)
 */
export function paint(table, look, shown) {
  const { nodes } = table;
  const curves = new Float32Array(4 * nodes * (COMMON_ROWS + BAND_ROWS * table.bands));
  const base = new Float32Array(3 * table.bands);
  let body = [0, 0, 0];
  for (let band = 0; band < table.bands; band++) {
    const of = shares(table, band, look);
    const weight = table.arrays.rgb_weights.data.subarray(3 * band, 3 * band + 3);
    base.set(of.base.map((value, c) => weight[c] * value), 3 * band);
    if (band === 0) {
      // Samples are those of the recipe's thicknesses.
      curves.set(chances(table, look, shown, look.thickness === 1 ? of : shares(table, 0, { ...look, thickness: 1 })));
      body = [...of.body];
      for (let k = 0; k < nodes; k++) for (let c = 0; c < 3; c++) curves[4 * (nodes + k) + c] = of.emission[c * nodes + k];
    }
    const from = 4 * nodes * (COMMON_ROWS + BAND_ROWS * band);
    for (let k = 0; k < nodes; k++) {
      curves[from + 4 * (nodes + k) + 3] = table.arrays.mirror.data[band * nodes + k];
      for (let c = 0; c < 3; c++) {
        const at = c * nodes + k;
        const limit = of.limit[at];
        const colour = look.brightness * (1 + look.coherence * (of.tint[c] * of.modulation[at] - 1));
        curves[from + 4 * k + c] = weight[c] * colour * (table.reciprocal ? limit : 1);
        curves[from + 4 * (nodes + k) + c] = table.reciprocal || limit === 1 ? of.rest[at] : limit - 1;
      }
    }
  }
  return { curves, base, body };
}
