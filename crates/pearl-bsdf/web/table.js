/**
 * The prepared arrays of a table (docs/ARRAYS.md), checked, and packed into the textures that the shaders read.
 *
 * @import {Arrays} from "nacre/npz.js"
 *
 * @typedef {object} Look
 * @property {number} depth share of incoherent interference in the base
 * @property {number} brightness strength of the lobes
 * @property {number} coherence how much of the coherent colours the lobes show
 * @property {number[]} body_rgb body colour, linear sRGB
 * @property {number[]} tint_rgb factor of the interference colours, linear sRGB
 * @property {number} thickness scale of all thicknesses
 *
 * @typedef {object} Table
 * @property {Arrays} arrays
 * @property {boolean} space rows are tabulated over the azimuth
 * @property {boolean} reciprocal
 * @property {boolean} visible
 * @property {number} cellWidth
 * @property {number} capRadius
 * @property {number} bands
 * @property {number} incidences
 * @property {number} rows
 * @property {number} columns
 * @property {number} spans
 * @property {number} steps of a span
 * @property {number} nodes of every curve over one angle
 * @property {[number, number] | null} scales of all thicknesses that it knows, where thickness is a control
 * @property {boolean} spectral whether it has colours by wavelength
 * @property {Look} look that of the recipe
 */

/** The meaning of the arrays that this page knows. */
const VERSION = 1;
/** Bands that the shaders have room for. */
export const MOST_BANDS = 16;
/** Texels in a row of the packed textures. */
export const PACKED_WIDTH = 2048;

/**
 * Whether arrays have colours over the wavelength; those of a coarse bake have them at one alone.
 * @param {Arrays} arrays
 */
export const hasSpectra = (arrays) => (arrays.channel_nm?.data.length ?? 0) > 1;

/**
 * Checks arrays and names their sizes.
 * @param {Arrays} arrays
 * @returns {Table}
 */
export function makeTable(arrays) {
  const number = (/** @type {string} */ name) => {
    const found = arrays[name];
    if (!found) throw new Error(`the array ${name} is missing`);
    return found.data[0];
  };
  if (number("version") !== VERSION) throw new Error(`version of the arrays: ${number("version")}; this page reads ${VERSION}`);
  const cells = arrays.cells;
  if (!cells || cells.shape.length !== 5 || cells.shape[4] !== 4) throw new Error("the array cells is missing, or has another shape");
  const nodes = arrays.mean_weight.shape[0];
  for (const [name, array] of Object.entries(arrays)) {
    if (/^(emission|modulation|albedo|rest)_/.test(name)) arrays[name] = resampled(array, nodes);
  }
  const [bands, incidences, rows, columns] = cells.shape;
  const [, spans, points] = arrays.span_curves.shape;
  if (bands > MOST_BANDS) throw new Error(`${bands} bands; this page has room for ${MOST_BANDS}`);
  return {
    arrays, bands, incidences, rows, columns, spans, steps: points - 1,
    space: number("space") > 0, reciprocal: number("reciprocal") > 0, visible: number("visible") > 0,
    nodes, spectral: hasSpectra(arrays),
    scales: arrays.scale ? [arrays.scale.data[0], arrays.scale.data[arrays.scale.data.length - 1]] : null,
    cellWidth: number("cell_width"), capRadius: number("cap_radius"),
    look: {
      depth: number("depth"), brightness: number("brightness"), coherence: number("coherence"),
      body_rgb: [...arrays.body_rgb.data], tint_rgb: [1, 1, 1], thickness: 1,
    },
  };
}

/**
 * Curves at another number of nodes.
 * @param {import("nacre/npz.js").NamedArray} curves
 * @param {number} nodes
 */
function resampled(curves, nodes) {
  const own = curves.shape[curves.shape.length - 1];
  if (own === nodes) return curves;
  const count = curves.data.length / own;
  const data = new Float32Array(count * nodes);
  for (let curve = 0; curve < count; curve++) {
    for (let k = 0; k < nodes; k++) {
      const x = (k * (own - 1)) / (nodes - 1);
      const low = Math.min(Math.floor(x), own - 2);
      const [a, b] = [curves.data[curve * own + low], curves.data[curve * own + low + 1]];
      data[curve * nodes + k] = a + (x - low) * (b - a);
    }
  }
  return { shape: [...curves.shape.slice(0, -1), nodes], data };
}

/**
 * Where the parts of the packed textures begin, in texels.
 * @typedef {{spans: number, widths: number, along: number, cells: number, rowCumulative: number, rowTotal: number, total: number}} Offsets
 */

/**
 * The numbers that the shaders gather: records (spans, widths, span curves, cells), and pairs for sampling the
 * first band (cumulative and guide; totals).
 * @param {Table} table
 * @returns {{records: Float32Array, pairs: Float32Array, offsets: Offsets}}
 */
export function pack(table) {
  const { arrays, bands, incidences, rows, columns, spans, steps } = table;
  // Two bands lie in a texel.
  const [texels, widthTexels] = [Math.floor(bands / 2) + 1, Math.ceil(bands / 2)];
  const offsets = { spans: 0, widths: spans, along: spans + widthTexels * spans, cells: 0, rowCumulative: 0, rowTotal: 0, total: 0 };
  offsets.cells = offsets.along + texels * spans * (steps + 1);
  const records = new Float32Array(4 * padded(offsets.cells + texels * incidences * rows * columns));
  for (let span = 0; span < spans; span++) {
    const start = arrays.span_start.data[span];
    records.set([start, 1 / (arrays.span_start.data[span + 1] - start), ...arrays.span_node.data.subarray(2 * span, 2 * span + 2)], 4 * span);
  }
  const copy = (/** @type {Float32Array} */ data, /** @type {number} */ from, /** @type {number} */ to) => {
    records[to] = data[from];
    records[to + 1] = data[from + 1];
  };
  for (let band = 0; band < bands; band++) {
    for (let span = 0; span < spans; span++) {
      copy(arrays.azimuth_width.data, 2 * (band * spans + span), 4 * (offsets.widths + widthTexels * span) + 2 * band);
    }
  }
  // Interior and rehit of each band, then what is sampled by the first.
  const interleave = (/** @type {Float32Array} */ data, /** @type {number} */ at) => {
    const count = data.length / 4 / bands;
    for (let i = 0; i < count; i++) {
      const to = 4 * (at + texels * i);
      for (let band = 0; band < bands; band++) copy(data, 4 * (band * count + i), to + 2 * band);
      copy(data, 4 * i + 2, to + 2 * bands);
    }
  };
  interleave(arrays.span_curves.data, offsets.along);
  interleave(arrays.cells.data, offsets.cells);

  const inRows = 2 * incidences * rows;
  offsets.rowCumulative = inRows * columns;
  offsets.rowTotal = offsets.rowCumulative + inRows;
  offsets.total = offsets.rowTotal + inRows;
  const pairs = new Float32Array(2 * padded(offsets.total + 2 * incidences));
  const put = (/** @type {string} */ first, /** @type {string | null} */ second, /** @type {number} */ from, /** @type {number} */ count) => {
    for (let i = 0; i < count; i++) {
      pairs[2 * (from + i)] = arrays[first].data[i];
      if (second) pairs[2 * (from + i) + 1] = arrays[second].data[i];
    }
  };
  put("cumulative", "guide", 0, inRows * columns);
  put("row_cumulative", "row_guide", offsets.rowCumulative, inRows);
  put("row_total", null, offsets.rowTotal, inRows);
  put("total", null, offsets.total, 2 * incidences);
  return { records, pairs, offsets };
}

/** @param {number} count */
function padded(count) {
  return Math.ceil(count / PACKED_WIDTH) * PACKED_WIDTH;
}
