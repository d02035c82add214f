/**
 * The page as one object: its state, what the state makes of the picture, and what others may call.
 *
 * @import {Server, Recipe} from "nacre/server.js"
 * @import {Side, State} from "nacre/state.js"
 * @import {World} from "nacre/renderer.js"
 */

import { readEnvironment } from "nacre/environment.js";
import { contextOf } from "nacre/gl.js";
import { COMPONENTS } from "nacre/look.js";
import { foldedSheet, readObj } from "nacre/mesh.js";
import { readNpz } from "nacre/npz.js";
import { Pearls, lookOf } from "nacre/pearls.js";
import { Renderer } from "nacre/renderer.js";
import { LIGHTS, SHAPES, viewOf } from "nacre/scenes.js";
import { hasSpectra } from "nacre/table.js";
import { History, START, changed, fromHash, toHash } from "nacre/state.js";

/** Colours of the backdrop. @type {Object<string, number[]>} */
const BACKDROPS = { light: [0.78, 0.77, 0.76], grey: [0.36, 0.36, 0.365], dark: [0.035, 0.036, 0.038] };
/** Vertices of a path: light between pearls and the ground is followed as far. */
const VERTICES = 3;
/** Largest number of pixels of the canvas. */
const MOST_PIXELS = 3_000_000;
/** Names that a state may hold. */
const CHOICES = { side: ["a", "b"], view: ["single", "split", "sheet"], scene: Object.keys(SHAPES), light: Object.keys(LIGHTS), backdrop: Object.keys(BACKDROPS) };
/** Changes of these start no picture anew. */
const DISPLAY_ONLY = ["divider", "exposure_ev", "side"];

export class Page {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {Server | null} server
   */
  constructor(canvas, server) {
    this.canvas = canvas;
    this.server = server;
    this.gl = contextOf(canvas);
    this.renderer = new Renderer(this.gl);
    this.pearls = new Pearls(this.gl, server);
    /** @type {State} */
    this.start = START;
    /** @type {State} */
    this.state = START;
    this.history = new History(START);
    this.hasMesh = false;
    this.hasMap = false;
    this.meshOf = "";
    this.bakeLine = { text: "", failed: false };
    /** @type {{name: string, recipe: Recipe, source?: string}[]} */
    this.recipes = [];
    /** Materials that recipes may name. @type {import("nacre/server.js").Material[]} */
    this.materials = [];
    /** What the server exports. @type {import("nacre/server.js").Format[]} */
    this.formats = [];
    /** Called when anything that the controls show has changed. */
    this.onupdate = () => {};
    this.onnotice = (/** @type {string} */ text, plain = false) => { void text; void plain; };
    this.open = () => {};
    this.pearls.onchange = () => { this.apply(); this.onupdate(); };
    this.pearls.onbake = (text, failed) => { this.bakeLine = { text, failed }; this.onupdate(); };
    this.renderer.onerror = (error) => this.onnotice(error instanceof Error ? error.message : String(error));
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => this.restore());
  }

  /** Everything anew after the graphics processor was lost. */
  restore() {
    this.renderer.restore(this.pearls.all);
    this.apply();
  }

  // ---- State ----------------------------------------------------------------------------------------------------------

  /**
   * Takes the first table.
   * @param {import("nacre/npz.js").Arrays} arrays
   * @param {Recipe | null} recipe
   * @param {string} name
   */
  begin(arrays, recipe, name) {
    // A table without colours by wavelength is coarse: its recipe is baked to the end.
    this.pearls.give("a", arrays, hasSpectra(arrays) ? recipe : null);
    const table = /** @type {import("nacre/pearl.js").Pearl} */ (this.pearls.of.a).table;
    const { depth, brightness, coherence, body_rgb } = table.look;
    const side = { ...START.a, depth, brightness, coherence, body_rgb, ...(recipe ? lookOf(recipe) : {}), name, recipe };
    this.start = { ...START, a: side, b: { ...side } };
    this.state = this.start;
    try {
      this.state = changed(this.start, fromHash(location.hash), CHOICES);
    } catch (error) {
      this.onnotice(`The address holds a state that is not valid: ${/** @type {Error} */ (error).message}`);
    }
    if (this.state.scene === "mesh") this.state = { ...this.state, scene: "pearl" };
    if (this.state.light === "map") this.state = { ...this.state, light: "studio" };
    if (this.state.view === "sheet") this.state = { ...this.state, view: "single" };
    this.history = new History(this.state);
    this.follow();
    this.apply();
    this.onupdate();
  }

  /**
   * Changes the state.
   * @param {Object<string, unknown>} changes as `nacre.set` takes them
   * @param {string} [what] joins changes of one kind to one step of undo
   */
  change(changes, what = Object.keys(changes).join()) {
    const next = changed(this.state, changes, CHOICES);
    const keys = Object.keys(changes);
    // The other pearl starts as this one.
    if (next.view === "split" && this.state.view !== "split" && !this.pearls.of.b) next.b = { ...next.a, ...(/** @type {object} */ (changes.b ?? {})) };
    this.state = next;
    this.history.push(next, what);
    this.settle(keys.every((key) => DISPLAY_ONLY.includes(key)));
  }

  /** @param {-1 | 1} way */
  travel(way) {
    this.state = this.history.go(way);
    this.settle(false);
  }

  /** @param {boolean} displayOnly */
  settle(displayOnly) {
    this.follow();
    this.apply(displayOnly);
    this.onupdate();
    clearTimeout(this.addressTimer);
    this.addressTimer = setTimeout(() => history.replaceState(null, "", toHash(this.state, this.start)), 300);
  }

  /** The side as its recipe or table has it: what reset goes back to. @returns {Side} */
  initial() {
    const side = this.state[this.state.side];
    const recipe = this.recipes.find(({ name }) => name === side.name)?.recipe;
    return recipe ? { ...START.a, ...lookOf(recipe) } : this.start[this.state.side];
  }

  /** @returns {Recipe} */
  initialRecipe() {
    const side = this.state[this.state.side];
    return this.recipes.find(({ name }) => name === side.name)?.recipe ?? this.start[this.state.side].recipe ?? {};
  }

  /** Bakes what the recipes of the sides ask for. */
  follow() {
    if (this.state.view === "split" || this.state.side === "b") this.pearls.split();
    for (const side of /** @type {const} */ (["a", "b"])) {
      if (this.pearls.of[side]) this.pearls.follow(side, this.state[side].recipe, this.state[side].thickness).catch(() => {});
    }
  }

  /**
   * Takes a recipe and its look for the side that the controls change.
   * @param {Recipe | string} given
   */
  async setRecipe(given) {
    const found = typeof given === "string" ? this.recipes.find(({ name }) => name === given)?.recipe : given;
    if (!found) throw new Error(`recipe: ${String(given)} is not known`);
    if (!this.server) throw new Error("This page has no server that bakes: start it with `pearl studio`.");
    const { side } = this.state;
    this.change({ ...lookOf(found), tint_rgb: [1, 1, 1], thickness: 1, name: found.name ?? "recipe", recipe: found }, "recipe");
    const asked = this.state;
    try {
      await this.pearls.follow(side, found, 1);
    } catch (error) {
      // What cannot be baked is not shown either.
      if (this.state === asked) this.travel(-1);
      throw error;
    }
  }

  // ---- Picture --------------------------------------------------------------------------------------------------------

  /** @returns {World} */
  world() {
    const { state } = this;
    const { shape, camera } = SHAPES[state.scene];
    const lights = LIGHTS[state.light].lights(state.light_azimuth_deg, state.light_elevation_deg);
    const grounded = !["aurora", "map"].includes(state.light);
    return {
      shape: { ...shape, floor: shape.floor && grounded }, lights, floor: BACKDROPS[state.backdrop], vertices: VERTICES, grain: 0,
      view: viewOf({
        ...camera, azimuth: camera.azimuth + state.camera_azimuth_deg, elevation: Math.min(Math.max(camera.elevation + state.camera_elevation_deg, -8), 88),
        spread: camera.spread / state.zoom,
      }),
    };
  }

  /**
   * Makes the picture that of the state.
   * @param {boolean} [displayOnly]
   */
  apply(displayOnly = false) {
    const { state, renderer, pearls } = this;
    renderer.exposure = 2 ** state.exposure_ev;
    renderer.surround = (getComputedStyle(/** @type {HTMLElement} */ (this.canvas.parentElement)).backgroundColor.match(/[\d.]+/g) ?? []).slice(0, 3).map((x) => Number(x) / 255);
    const shown = /** @type {import("nacre/look.js").Shown} */ (Object.fromEntries(COMPONENTS.map((name) => [name, state.components.includes(name)])));
    if (!displayOnly) {
      for (const side of /** @type {const} */ (["a", "b"])) pearls.paint(side, state[side], shown);
      if (SHAPES[state.scene].shape.kind === 2 && state.scene === "sheet" && this.meshOf !== "sheet") {
        renderer.setMesh(foldedSheet());
        this.meshOf = "sheet";
      } else if (state.scene === "mesh" && this.meshOf !== "mesh" && this.mesh) {
        renderer.setMesh(this.mesh);
        this.meshOf = "mesh";
      }
      renderer.world = this.world();
    }
    renderer.setSlots(this.slots(), displayOnly);
  }

  /** Pictures of the canvas. @returns {import("nacre/renderer.js").Slot[]} */
  slots() {
    const { state, pearls } = this;
    const { width, height } = this.canvas;
    const whole = [0, 0, width, height];
    const { a, b } = pearls.of;
    if (!a || !width || !height) return [];
    if (state.view === "sheet") {
      const tiles = [{ pearl: a, grain: state.a.grain }, ...pearls.tray.map(({ pearl, side }) => ({ pearl, grain: side.grain }))];
      const framed = (/** @type {number[]} */ [x, y, w, h]) => [x + 1, y + 1, w - 2, h - 2];
      return this.tiles(tiles.length).map((area, k) => ({ pearl: tiles[k].pearl, area, clip: framed(area), grain: tiles[k].grain }));
    }
    if (state.view === "split" && b) {
      const at = Math.round(width * state.divider);
      return [
        { pearl: a, area: whole, clip: [0, 0, at, height], grain: state.a.grain },
        { pearl: b, area: whole, clip: [at, 0, width - at, height], grain: state.b.grain },
      ];
    }
    const side = state.side === "b" && b ? "b" : "a";
    return [{ pearl: side === "b" && b ? b : a, area: whole, clip: whole, grain: state[side].grain }];
  }

  /**
   * Places of so many pictures, bottom left corners and sizes.
   * @param {number} count
   */
  tiles(count) {
    const { width, height } = this.canvas;
    // As large as they can be, few places left empty.
    const worth = (/** @type {number} */ columns) => {
      const rows = Math.ceil(count / columns);
      return Math.min(width / columns, height / rows) * Math.sqrt(count / (columns * rows));
    };
    const columns = Array.from({ length: count }, (_, k) => k + 1).reduce((best, other) => (worth(other) > worth(best) ? other : best));
    const rows = Math.ceil(count / columns);
    return Array.from({ length: count }, (_, k) => {
      const [x, y] = [k % columns, Math.floor(k / columns)];
      const empty = y === rows - 1 ? rows * columns - count : 0;
      const [left, right] = [x, x + 1].map((at) => Math.round((width * (at + empty / 2)) / columns));
      const [top, bottom] = [y, y + 1].map((at) => Math.round((height * at) / rows));
      return [left, height - bottom, right - left, bottom - top];
    });
  }

  /** Follows the size of the stage. */
  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    const ratio = Math.min(devicePixelRatio, Math.sqrt(MOST_PIXELS / Math.max(clientWidth * clientHeight, 1)));
    const [width, height] = [clientWidth, clientHeight].map((x) => Math.max(1, Math.round(x * ratio)));
    if (width === this.canvas.width && height === this.canvas.height) return;
    this.canvas.width = width;
    this.canvas.height = height;
    this.apply();
    this.renderer.stretch();
  }

  /**
   * Puts the pearl that the controls change aside, on the sheet.
   */
  keep() {
    const { side } = this.state;
    const pearl = this.pearls.of[side];
    if (!pearl) return;
    const look = { ...this.state[side] };
    const own = new (/** @type {any} */ (pearl.constructor))(this.gl, pearl.table);
    own.paint(pearl.look, pearl.shown);
    const name = look.name || "pearl";
    const taken = (/** @type {string} */ other) => this.pearls.tray.some((entry) => entry.name === other);
    let count = 1;
    while (taken(count > 1 ? `${name} ${count}` : name)) count++;
    this.pearls.tray.push({ pearl: own, name: count > 1 ? `${name} ${count}` : name, stars: 0, side: look });
    this.onnotice(`On the sheet: ${this.pearls.tray.length + 1} pearls. “Sheet” shows them under one light.`, true);
    this.apply();
    this.onupdate();
  }

  // ---- Files ----------------------------------------------------------------------------------------------------------

  /**
   * Takes a file that was opened or dropped.
   * @param {File} file
   */
  async take(file) {
    try {
      if (/\.obj$/i.test(file.name)) {
        this.mesh = readObj(await file.text());
        this.hasMesh = true;
        this.meshOf = "";
        this.change({ scene: "mesh" }, "scene");
      } else if (/\.(hdr|exr)$/i.test(file.name)) {
        this.renderer.setEnvironment(await readEnvironment(file.name, await file.arrayBuffer()));
        this.hasMap = true;
        this.change({ light: "map" }, "light");
      } else if (/\.npz$/i.test(file.name)) {
        const arrays = await readNpz(await file.arrayBuffer());
        const name = file.name.replace(/\.npz$/i, "");
        if (!this.pearls.of.a) return this.begin(arrays, null, name);
        this.pearls.give(this.state.side, arrays, null);
        const { depth, brightness, coherence, body_rgb } = /** @type {import("nacre/pearl.js").Pearl} */ (this.pearls.of[this.state.side]).table.look;
        this.change({ depth, brightness, coherence, body_rgb, thickness: 1, name, recipe: null }, "table");
      } else if (/\.json$/i.test(file.name)) {
        await this.setRecipe(JSON.parse(await file.text()));
      } else {
        throw new Error("expected an .obj, .hdr, .exr, .npz or .json file");
      }
    } catch (error) {
      this.onnotice(`${file.name}: ${error instanceof Error ? error.message : String(error)}`);
    }
  }
}
