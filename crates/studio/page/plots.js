/**
 * Plots of what a pearl does at one angle: its lobe in the plane of incidence (the paper's Fig. 6), its interference colours over
 * the wavelength, and where its light goes.
 *
 * @import {Pearl} from "nacre/pearl.js"
 */

import { baseColour, scaleAt, shares } from "nacre/look.js";
import { evaluate } from "nacre/probe.js";

const LUMINANCE = [0.2126, 0.7152, 0.0722];
/** Exit angles of a lobe's plot, and how many of them from one error bar to the next. */
const STEPS = 180;
const BARS = 5;

/** @param {number[]} rgb */
const luminance = (rgb) => rgb.reduce((sum, x, k) => sum + x * LUMINANCE[k], 0);

/**
 * Place of an angle among the nodes of curves.
 * @param {number} degrees
 * @param {number} nodes
 * @returns {[number, number, number]} node, how far beyond it, and the number of nodes
 */
function place(degrees, nodes) {
  const x = (nodes - 1) * Math.sqrt(1 - Math.sqrt(Math.max(Math.cos((degrees * Math.PI) / 180), 0)));
  const node = Math.min(Math.floor(x), nodes - 2);
  return [node, x - node, nodes];
}

/**
 * @param {ArrayLike<number>} curves
 * @param {number} which
 * @param {[number, number, number]} at
 */
function read(curves, which, [node, t, nodes]) {
  const i = which * nodes + node;
  return curves[i] + t * (curves[i + 1] - curves[i]);
}

/** @typedef {{lobe: {angle: number[], blur: number[], mirror: number[], base: number[], error: ((angle: number) => number) | null}, spectra: {nm: number[], modulation: number[], emission: number[]} | null, ledger: {name: string, share: number}[], degrees: number}} Facts */

/**
 * What the plots show.
 * @param {Pearl} pearl
 * @param {number} degrees incidence
 * @returns {Promise<Facts>}
 */
export async function factsOf(pearl, degrees) {
  const { table, look } = pearl;
  const theta = (Math.min(degrees, 89.5) * Math.PI) / 180;
  const angle = Array.from({ length: STEPS }, (_, k) => ((k + 0.5) / STEPS - 0.5) * 180);
  const wi = angle.flatMap(() => [-Math.sin(theta), 0, Math.cos(theta)]);
  const wo = angle.flatMap((s) => [Math.sin((s * Math.PI) / 180), 0, Math.cos((s * Math.PI) / 180)]);
  const found = await evaluate(pearl, wi, wo);
  const lobe = {
    angle, blur: found.blur.map(luminance), mirror: found.mirror.map(luminance),
    base: found.diffuse.map((rgb, k) => luminance(rgb) + luminance(found.incoherent[k])), error: errorsOf(table, theta),
  };
  const at = place(degrees, table.nodes);
  const { albedo_plain, albedo_rgb } = table.arrays;
  const spectra = table.spectral ? spectraOf(pearl, at) : null;
  const of = shares(table, 0, look);
  const channel = [0, 1, 2].map((c) => {
    const limit = read(of.limit, c, at);
    const lobes = [0, 1, 2].map((part) => {
      const plain = read(albedo_plain.data, part, at);
      return look.brightness * limit * (plain + look.coherence * (of.tint[c] * read(albedo_rgb.data, 3 * c + part, at) - plain));
    });
    const rest = read(of.rest, c, at);
    const base = baseColour(look, of.body[c], read(of.emission, c, at)).map((x) => x * rest * (of.base[c] > 0 ? 1 : 0));
    return [lobes[2] + lobes[1], lobes[0], base[1], base[0], Math.max(1 - lobes[0] - lobes[1] - lobes[2] - base[0] - base[1], 0)];
  });
  const names = ["Mirror", "Blur", "Incoherent", "Diffuse", "Absorbed"];
  const ledger = names.map((name, k) => ({ name, share: luminance(channel.map((row) => row[k])) }));
  return { lobe, spectra, ledger, degrees };
}

/**
 * Standard errors of the interior lobe in the plane of incidence, as shares of it by the exit angle in degrees; null where a table
 * does not say.
 * @param {import("nacre/table.js").Table} table
 * @param {number} theta incidence
 */
function errorsOf({ arrays }, theta) {
  const { error_incidence: incidence, error_lobe: lobe } = arrays;
  if (!incidence || !lobe) return null;
  const [rows, columns] = lobe.shape;
  let row = 0;
  while (row < rows - 2 && incidence.data[row + 1] <= theta) row++;
  const between = (/** @type {number} */ at, /** @type {number} */ low, /** @type {number} */ high) => Math.min(Math.max((at - low) / (high - low || 1), 0), 1);
  const t = rows > 1 ? between(theta, incidence.data[row], incidence.data[row + 1]) : 0;
  const read = (/** @type {number} */ at, /** @type {number} */ column) => lobe.data[Math.min(at, rows - 1) * columns + column];
  return (/** @type {number} */ angle) => {
    const x = ((angle + 90) / 180) * (columns - 1);
    const column = Math.min(Math.floor(x), columns - 2);
    const [low, high] = [row, row + 1].map((at) => read(at, column) + (x - column) * (read(at, column + 1) - read(at, column)));
    return low + t * (high - low);
  };
}

/**
 * M and Ê by wavelength at one angle, of the first band.
 * @param {Pearl} pearl
 * @param {[number, number, number]} at
 */
function spectraOf({ table, look }, at) {
  const { channel_nm, modulation_spectral, emission_spectral, emission_mean_scaled, scale } = table.arrays;
  const nm = [...channel_nm.data].map((x) => x * look.thickness);
  let mean = 1;
  if (look.thickness !== 1 && scale) {
    const [k, t] = scaleAt(scale.data, look.thickness);
    const [low, high] = [k, k + 1].map((which) => read(emission_mean_scaled.data, which, at));
    mean = low + t * (high - low);
  }
  return {
    nm, modulation: nm.map((_, k) => read(modulation_spectral.data, k, at)), emission: nm.map((_, k) => read(emission_spectral.data, k, at) / mean),
  };
}

/**
 * Prepares a canvas for its size on the screen.
 * @param {HTMLCanvasElement} canvas
 */
function surface(canvas) {
  const ratio = devicePixelRatio;
  const { clientWidth: width, clientHeight: height } = canvas;
  canvas.width = Math.round(width * ratio);
  canvas.height = Math.round(height * ratio);
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  const style = getComputedStyle(canvas);
  const ink = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
  context.font = `11px ${style.fontFamily}`;
  return { context, width, height, ink };
}

/**
 * Axes: a frame, marks below and at the left.
 * @param {ReturnType<typeof surface>} on
 * @param {{x: [number, number], y: [number, number], marks: number[], levels: number[], unit: string, wide?: number}} axes
 */
function axesOf({ context, width, height, ink }, { x, y, marks, levels, unit }) {
  const [left, right, top, bottom] = [34, width - 8, 8, height - 20];
  const px = (/** @type {number} */ v) => left + ((v - x[0]) / (x[1] - x[0])) * (right - left);
  const py = (/** @type {number} */ v) => bottom - ((v - y[0]) / (y[1] - y[0])) * (bottom - top);
  context.lineWidth = 1;
  context.fillStyle = ink("--faint");
  context.strokeStyle = ink("--rule");
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const level of levels) {
    context.beginPath();
    context.moveTo(left, Math.round(py(level)) + 0.5);
    context.lineTo(right, Math.round(py(level)) + 0.5);
    context.stroke();
    context.fillText(Number(level.toPrecision(3)).toString(), left - 6, py(level));
  }
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  for (const mark of marks) context.fillText(`${mark < 0 ? "−" : ""}${Math.abs(mark)}${unit}`, Math.min(px(mark), right - 10), height - 5);
  return { px, py, left, right, top, bottom };
}

/** @param {number} most */
function levelsTo(most) {
  const step = 10 ** Math.floor(Math.log10(Math.max(most, 1e-9) / 2));
  const wide = most / step > 8 ? 5 * step : most / step > 3 ? 2 * step : step;
  return Array.from({ length: Math.floor(most / wide) + 1 }, (_, k) => k * wide);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number[]} xs
 * @param {number[]} ys
 * @param {string} ink
 * @param {boolean} [dashed]
 */
function line(context, xs, ys, ink, dashed = false) {
  context.strokeStyle = ink;
  context.lineWidth = 1.6;
  context.setLineDash(dashed ? [4, 3] : []);
  context.beginPath();
  xs.forEach((x, k) => context.lineTo(x, ys[k]));
  context.stroke();
  context.setLineDash([]);
}

/**
 * The lobe of one or two pearls.
 * @param {HTMLCanvasElement} canvas
 * @param {Facts[]} facts of A, and of B where it is compared
 */
export function plotLobe(canvas, facts) {
  const on = surface(canvas);
  const broad = Math.max(...facts.map(({ lobe }) => Math.max(...lobe.blur, ...lobe.base)), 1e-6);
  // A mirror that is far higher would leave nothing to be seen of the rest: it is cut.
  const most = 1.15 * Math.max(broad, Math.min(3 * broad, Math.max(...facts.flatMap(({ lobe }) => [...lobe.mirror]))));
  const { px, py, top, bottom, left, right } = axesOf(on, { x: [-90, 90], y: [0, most], marks: [-90, -45, 0, 45, 90], levels: levelsTo(most), unit: "°" });
  const { context, ink } = on;
  context.save();
  context.beginPath();
  context.rect(left, top - 4, right - left, bottom - top + 4);
  context.clip();
  facts.forEach(({ lobe, degrees }, which) => {
    const xs = lobe.angle.map(px);
    if (which === 0) {
      context.strokeStyle = ink("--faint");
      context.setLineDash([2, 3]);
      context.beginPath();
      context.moveTo(px(degrees), top);
      context.lineTo(px(degrees), bottom);
      context.stroke();
      context.setLineDash([]);
      context.fillStyle = ink("--blur-fill");
      context.beginPath();
      context.moveTo(xs[0], bottom);
      lobe.blur.forEach((v, k) => context.lineTo(xs[k], py(v)));
      context.lineTo(xs[xs.length - 1], bottom);
      context.fill();
    }
    line(context, xs, lobe.base.map(py), ink("--base-ink"), which > 0);
    line(context, xs, lobe.mirror.map(py), ink("--mirror-ink"), which > 0);
    line(context, xs, lobe.blur.map(py), ink("--blur-ink"), which > 0);
    const { error } = lobe;
    if (!error) return;
    context.lineWidth = 1;
    for (let k = BARS >> 1; k < xs.length; k += BARS) {
      const half = error(lobe.angle[k]) * (py(0) - py(lobe.blur[k]));
      if (half < 0.5) continue;
      context.beginPath();
      for (const end of [-half, half]) {
        context.moveTo(xs[k], py(lobe.blur[k]));
        context.lineTo(xs[k], py(lobe.blur[k]) + end);
        context.moveTo(xs[k] - 2, py(lobe.blur[k]) + end);
        context.lineTo(xs[k] + 2, py(lobe.blur[k]) + end);
      }
      context.stroke();
    }
  });
  context.restore();
}

/**
 * M and emission over the wavelength.
 * @param {HTMLCanvasElement} canvas
 * @param {Facts[]} facts
 */
export function plotSpectra(canvas, facts) {
  const on = surface(canvas);
  const seen = facts.flatMap(({ spectra }) => (spectra ? [spectra] : []));
  const most = 1.1 * Math.max(1, ...seen.map((spectra) => Math.max(...spectra.modulation, ...spectra.emission)));
  const { px, py, left, right, bottom } = axesOf(on, { x: [380, 780], y: [0, most], marks: [400, 500, 600, 700], levels: levelsTo(most), unit: "" });
  const { context, ink, height } = on;
  context.fillText("nm", right - 8, height - 5);
  // The colours of the wavelengths, for the eye to find its way.
  const rainbow = context.createLinearGradient(px(380), 0, px(780), 0);
  [[0, "#3b0764"], [0.14, "#3730a3"], [0.27, "#0369a1"], [0.35, "#0f766e"], [0.45, "#3f8f2f"], [0.52, "#a3a012"], [0.57, "#d08a10"], [0.65, "#c2410c"], [0.78, "#991b1b"], [1, "#450a0a"]]
    .forEach(([at, css]) => rainbow.addColorStop(Number(at), String(css)));
  context.fillStyle = rainbow;
  context.fillRect(left, bottom - 0.5, right - left, 2.5);
  context.save();
  context.beginPath();
  context.rect(left, 0, right - left, bottom);
  context.clip();
  if (facts.length > 0 && seen.length === 0) {
    context.fillStyle = ink("--faint");
    context.textAlign = "center";
    context.fillText("not in this table", (left + right) / 2, bottom / 2);
  }
  seen.forEach((spectra, which) => {
    const xs = spectra.nm.map(px);
    line(context, xs, spectra.emission.map(py), ink("--emission-ink"), which > 0);
    line(context, xs, spectra.modulation.map(py), ink("--blur-ink"), which > 0);
  });
  context.restore();
}
