/**
 * The two pearls that are compared, and those that were put aside: their tables, and bakes that make them.
 *
 * @import {Arrays} from "nacre/npz.js"
 * @import {Recipe, Server} from "nacre/server.js"
 * @import {Side} from "nacre/state.js"
 * @import {Shown} from "nacre/look.js"
 * @import {Table} from "nacre/table.js"
 */

import { Pearl } from "nacre/pearl.js";
import { Overtaken } from "nacre/server.js";
import { makeTable } from "nacre/table.js";

/** Fine tables that are kept for going back. */
const KEPT = 12;

/** Scales of a recipe that makes thickness a control and names none, as bakes have them. */
export const DEFAULT_SCALES = { min: 0.7, max: 1.4 };

/**
 * What of a recipe is baked: all but its look, its name and its sources; and whether thickness is a control.
 * @param {Recipe} recipe
 */
function physics(recipe) {
  const { look, name, sources, ...rest } = recipe;
  return JSON.stringify([rest, look?.thickness ?? null]);
}

/**
 * A recipe with all thicknesses and their spreads times a number.
 * @param {Recipe} recipe
 * @param {number} scale
 * @returns {Recipe}
 */
export function scaledRecipe(recipe, scale) {
  if (scale === 1) return recipe;
  const next = structuredClone(recipe);
  const { stack = {} } = next;
  const layers = [stack.aragonite, stack.conchiolin, ...(stack.explicit ?? [])];
  for (const layer of layers) {
    for (const key of ["thickness_nm", "thickness_sd_nm"]) {
      if (typeof layer?.[key] === "number") layer[key] *= scale;
    }
  }
  return next;
}

/**
 * The look of a recipe, as a side has it.
 * @param {Recipe} recipe
 * @returns {Partial<Side>}
 */
export function lookOf(recipe) {
  const { depth, brightness, coherence, grain, body_rgb } = recipe.look ?? {};
  const given = { depth, brightness, coherence, grain, body_rgb };
  return Object.fromEntries(Object.entries(given).filter(([, value]) => value !== undefined));
}

export class Pearls {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {Server | null} server
   */
  constructor(gl, server) {
    this.gl = gl;
    this.server = server;
    /** @type {{a: Pearl | null, b: Pearl | null}} */
    this.of = { a: null, b: null };
    /** What each side's table was baked of. */
    this.physics = { a: "", b: "" };
    /** @type {{pearl: Pearl, name: string, stars: number, side: Side}[]} */
    this.tray = [];
    /** @type {Map<string, Table>} */
    this.known = new Map();
    /** Called with what a bake does: a line, and whether it is an error. */
    this.onbake = (/** @type {string} */ line, /** @type {boolean} */ failed) => { void line; void failed; };
    /** Called when a side has another table. */
    this.onchange = () => {};
    /** @type {Promise<void> | null} */
    this.baking = null;
    /** What is being baked. */
    this.wanted = { a: "", b: "" };
    /** Milliseconds from asking to the first and to the last table. */
    this.latency = { first: 0, last: 0 };
  }

  /**
   * Takes a table for a side.
   * @param {"a" | "b"} side
   * @param {Table} table
   * @param {string} [key] what it was baked of
   */
  take(side, table, key = "") {
    const before = this.of[side];
    const shared = before === this.of[side === "a" ? "b" : "a"] || this.tray.some(({ pearl }) => pearl === before);
    if (before && !shared) before.delete();
    this.of[side] = new Pearl(this.gl, table);
    this.physics[side] = key;
    this.wanted[side] = key;
  }

  /**
   * A pearl of its own for B, of A's table.
   */
  split() {
    if (this.of.a && !this.of.b) this.take("b", this.of.a.table, this.physics.a);
  }

  /**
   * Paints a side.
   * @param {"a" | "b"} side
   * @param {Side} look
   * @param {Shown} shown
   */
  paint(side, look, shown) {
    const pearl = this.of[side];
    if (!pearl) return;
    const { scales } = pearl.table;
    const thickness = scales ? Math.min(Math.max(look.thickness, scales[0]), scales[1]) : 1;
    pearl.paint({ ...look, thickness }, shown);
  }

  /**
   * Takes arrays that were given.
   * @param {"a" | "b"} side
   * @param {Arrays} arrays
   * @param {Recipe | null} recipe
   */
  give(side, arrays, recipe) {
    this.take(side, makeTable(arrays), recipe ? physics(recipe) : "");
  }

  /**
   * Sees to it that a side has the table of its recipe: at once if it is known, else coarse, then fine.
   * @param {"a" | "b"} side
   * @param {Recipe | null} recipe
   * @param {number} thickness scale of all thicknesses that is shown
   * @returns {Promise<void>} resolves with the fine table
   */
  follow(side, recipe, thickness) {
    if (!recipe || !this.server) return Promise.resolve();
    const key = physics(recipe);
    if (key === this.wanted[side]) return this.baking ?? Promise.resolve();
    const known = this.known.get(key);
    this.wanted[side] = key;
    if (known) {
      this.take(side, known, key);
      this.onchange();
      this.onbake("", false);
      return Promise.resolve();
    }
    this.baking = this.bake(side, recipe, key, thickness);
    return this.baking;
  }

  /**
   * @param {"a" | "b"} side
   * @param {Recipe} recipe
   * @param {string} key
   * @param {number} thickness
   */
  async bake(side, recipe, key, thickness) {
    const server = /** @type {Server} */ (this.server);
    const begun = performance.now();
    try {
      for (const quality of /** @type {const} */ (["coarse", "fine"])) {
        this.onbake(quality === "coarse" ? "Baking …" : "Refining …", false);
        // A coarse table holds one thickness: the one that is shown.
        const { arrays, seconds } = await server.bake(quality === "coarse" ? scaledRecipe(recipe, thickness) : recipe, quality);
        if (this.wanted[side] !== key) return;
        const table = makeTable(arrays);
        this.take(side, table, key);
        this.latency[quality === "coarse" ? "first" : "last"] = performance.now() - begun;
        if (quality === "fine") {
          this.known.set(key, table);
          if (this.known.size > KEPT) this.known.delete(this.known.keys().next().value ?? "");
          this.onbake(`Baked in ${seconds.toFixed(seconds < 1 ? 2 : 1)} s`, false);
        }
        this.onchange();
      }
    } catch (error) {
      if (this.wanted[side] !== key) return;
      this.wanted[side] = this.physics[side];
      if (error instanceof Overtaken) return;
      this.onbake(error instanceof Error ? error.message : String(error), true);
      throw error;
    }
  }

  /** All pearls that there are. */
  get all() {
    return [this.of.a, this.of.b, ...this.tray.map(({ pearl }) => pearl)].filter((pearl) => pearl !== null);
  }
}
