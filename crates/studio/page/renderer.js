/**
 * Renders pearls progressively: passes of a path tracer add samples to films of single precision, as much at a time as a frame
 * allows.
 *
 * @import {Pearl} from "nacre/pearl.js"
 * @import {Lights, Shape} from "nacre/scenes.js"
 * @import {Mesh} from "nacre/mesh.js"
 * @import {Environment} from "nacre/environment.js"
 * @import {Values} from "nacre/gl.js"
 *
 * @typedef {object} World what all pictures share
 * @property {Shape} shape
 * @property {Lights} lights
 * @property {{eye: number[], target: number[], spread: number}} view
 * @property {number} grain of the pearl, where the picture does not say
 * @property {number[]} floor its colour
 * @property {number} vertices at most, of a path
 *
 * @typedef {{pearl: Pearl, area: number[], clip: number[], grain: number}} Slot a picture: where it lies in the canvas (corner and
 * size, from below), what of it is shown, and its grain
 */

import { Program, Target, finished, prepare, texture } from "nacre/gl.js";
import { ADD, DIRECT, MEET, PATHS_WIDTH, SAMPLE, SHOW, WEIGH } from "nacre/glsl/trace.js";
import { packMesh } from "nacre/mesh.js";
import { forget } from "nacre/probe.js";
import { cameraAxes, harnessScene } from "nacre/scenes.js";
import { PACKED_WIDTH } from "nacre/table.js";

/** Milliseconds that one piece of work may take, so that the page answers. */
const PIECE_MS = 24;
/** Samples after which a picture rests. */
const ENOUGH = 4096;
/** Milliseconds without a change after which a finer resolution is rendered, and that one pass of it may take. */
const SETTLED_MS = 140;
const SETTLED_PASS_MS = 500;
/** Samples at that resolution before the full one, where the processor is too slow for it; and those of a finer resolution from which it is
 * shown in place of a coarser one. */
const SETTLED_SAMPLES = 48;
const SHOWN_SAMPLES = 16;
const MOST_RECTANGLES = 8;
const MOST_SPHERES = 32;
/** Rows of paths that are traced at once. */
const PATHS_HEIGHT = 192;
const MOST_PATHS = PATHS_WIDTH * PATHS_HEIGHT;
/** Paths below which a piece of work is mostly overhead. */
const LEAST_PATHS = 12_000;

/** A film and its twin: a pass reads one and writes the other. */
class Film {
  /**
   * @param {WebGL2RenderingContext} gl
   * @param {number} width
   * @param {number} height
   */
  constructor(gl, width, height) {
    this.width = width;
    this.height = height;
    this.front = new Target(gl, width, height);
    this.back = new Target(gl, width, height);
    this.front.clear();
    /** What is shown of it. @type {Target | null} */
    this.shown = null;
    this.passes = 0;
    /** Change of the picture that it shows. */
    this.stamp = -1;
    /** Rows of the current pass that are done. */
    this.rows = 0;
    this.samples = 0;
  }

  delete() {
    for (const target of [this.front, this.back, this.shown]) target?.delete();
  }
}

export class Renderer {
  /**
   * @param {WebGL2RenderingContext} gl
   */
  constructor(gl) {
    this.gl = gl;
    /** @type {World | null} */
    this.world = null;
    /** @type {Slot[]} */
    this.slots = [];
    /** @type {{slot: Slot, film: Film, next: Film | null}[]} */
    this.pictures = [];
    /** @type {Map<string, Program>} */
    this.programs = new Map();
    /** @type {Object<string, WebGLTexture>} */
    this.textures = {};
    /** @type {Mesh | null} */
    this.mesh = null;
    this.triangleStart = 0;
    /** @type {Environment | null} */
    this.environment = null;
    this.exposure = 1;
    this.background = [0, 0, 0];
    /** Of the canvas beside pictures, in sRGB. */
    this.surround = [0, 0, 0];
    /** Pixels a millisecond, as measured. */
    this.rate = 400;
    this.changed = 0;
    this.stamp = 0;
    this.busy = false;
    this.resting = true;
    /** @type {Promise<unknown>} */
    this.queue = Promise.resolve();
    /** Called after each displayed picture. */
    this.onframe = () => {};
    /** @type {(error: unknown) => void} */
    this.onerror = (error) => { throw error; };
    this.frameMs = 0;
    this.empty = texture(gl, 4, 1, 1, null);
    /** @type {Object<string, Target> | null} */
    this.pool = null;
    this.waiting = false;
    /** Whether the canvas stays as it is: scripts that render on their own leave no time to it. */
    this.paused = false;
    /** The change whose first picture was displayed, and the milliseconds from one to the other. */
    this.firstOf = -1;
    this.latency = 0;
    this.batch = 1;
  }

  // ---- What is rendered ---------------------------------------------------------------------------------------------

  /** @param {Mesh} mesh */
  setMesh(mesh) {
    this.mesh = mesh;
    const { texels, triangleStart } = packMesh(mesh);
    if (this.textures.uMesh) this.gl.deleteTexture(this.textures.uMesh);
    this.textures.uMesh = texture(this.gl, 4, PACKED_WIDTH, texels.length / 4 / PACKED_WIDTH, texels);
    this.triangleStart = triangleStart;
  }

  /** @param {Environment} environment */
  setEnvironment(environment) {
    this.environment = environment;
    for (const name of ["uMap", "uMapRows"]) if (this.textures[name]) this.gl.deleteTexture(this.textures[name]);
    this.textures.uMap = texture(this.gl, 4, environment.width, environment.height, environment.texels);
    this.textures.uMapRows = texture(this.gl, 1, environment.height, 1, environment.rows);
  }

  /**
   * The pictures of the canvas.
   * @param {Slot[]} slots
   * @param {boolean} displayOnly whether they are what they were, shown otherwise
   */
  setSlots(slots, displayOnly) {
    if (displayOnly && slots.length === this.pictures.length) {
      this.slots = slots;
      this.pictures.forEach((picture, k) => (picture.slot = slots[k]));
      this.redraw();
      return;
    }
    this.slots = slots;
    this.invalidate();
  }

  /** Starts the pictures anew: something that they show has changed. */
  invalidate() {
    this.stamp++;
    this.changed = performance.now();
    this.wake();
  }

  /** Shows what there is in a canvas of another size, until it is rendered in that size. */
  stretch() {
    if (this.slots.length !== this.pictures.length) return;
    this.pictures.forEach((picture, k) => (picture.slot = this.slots[k]));
    this.redraw();
  }

  /** Draws the canvas again without rendering anew. */
  redraw() {
    if (!this.gl.isContextLost()) this.display();
  }

  /**
   * After a lost context came back: everything is written again.
   * @param {Pearl[]} pearls
   */
  restore(pearls) {
    const { gl } = this;
    prepare(gl);
    forget(gl);
    this.programs.clear();
    this.pool = null;
    this.pictures = [];
    this.textures = {};
    this.empty = texture(gl, 4, 1, 1, null);
    for (const pearl of pearls) pearl.upload();
    if (this.mesh) this.setMesh(this.mesh);
    if (this.environment) this.setEnvironment(this.environment);
    this.invalidate();
  }

  // ---- Passes -------------------------------------------------------------------------------------------------------

  /**
   * @param {string} source
   * @param {Object<string, number>} macros
   */
  program(source, macros = {}) {
    const key = source.length + JSON.stringify(macros);
    const program = this.programs.get(key) ?? new Program(this.gl, source, macros);
    this.programs.set(key, program);
    return program;
  }

  /**
   * The programs that trace paths to a pearl in a world.
   * @param {Pearl} pearl
   * @param {World} world
   */
  tracerOf(pearl, { shape, lights }) {
    const scene = { SHAPE: shape.kind, SKY: lights.sky.kind };
    return {
      meet: this.program(MEET, scene), sample: this.program(SAMPLE, { ...pearl.macros, ...scene }),
      weigh: this.program(WEIGH, pearl.macros), add: this.program(ADD),
    };
  }

  /** Textures that hand paths on. */
  get paths() {
    if (!this.pool) {
      const make = (/** @type {number} */ count) => new Target(this.gl, PATHS_WIDTH, PATHS_HEIGHT, count);
      this.pool = { at: make(4), before: make(4), samples: make(3), weighed: make(3), earlier: make(3) };
    }
    return this.pool;
  }

  /**
   * Uniforms of a world, and of a picture of it.
   * @param {World} world
   * @param {number} width
   * @param {number} height
   * @returns {Values}
   */
  valuesOf(world, width, height) {
    const { shape, lights, view, grain, floor, vertices } = world;
    const camera = cameraAxes(view, width, height);
    const spheres = new Float32Array(4 * MOST_SPHERES);
    spheres.set((shape.spheres ?? []).slice(0, MOST_SPHERES).flat());
    const rectangles = lights.rectangles.slice(0, MOST_RECTANGLES);
    const list = (/** @type {(r: import("nacre/scenes.js").Rectangle) => number[]} */ of, /** @type {number} */ size) => {
      const flat = new Float32Array(size * MOST_RECTANGLES);
      flat.set(rectangles.flatMap(of));
      return flat;
    };
    const sum = (/** @type {number[]} */ v) => v.reduce((a, b) => a + b, 0);
    const powers = rectangles.map(({ u, v, radiance }) => Math.sqrt(sum(radiance) * Math.hypot(...u) * Math.hypot(...v)));
    const lit = { sky: lights.sky.kind === 1 || lights.sky.kind === 3 ? 1 : 0, point: lights.point ? 1 : 0, rectangles: rectangles.length ? 1 : 0 };
    const all = lit.sky + lit.point + lit.rectangles || 1;
    const turn = ((lights.sky.turn ?? 0) * Math.PI) / 180;
    return {
      uSize: [width, height], uEye: camera.eye, uForward: camera.forward, uRight: camera.right, uUp: camera.up,
      uSpheres: spheres, uSphereCount: (shape.spheres ?? []).length, uTriangleStart: this.triangleStart,
      uFloor: shape.floor, uFloorAlbedo: floor, uOccluding: shape.occluding, uGrain: grain,
      uRectangleCount: rectangles.length, uCorner: list((r) => r.corner, 3), uEdgeU: list((r) => r.u, 3), uEdgeV: list((r) => r.v, 3),
      uRadiance: list((r) => [...r.radiance, r.seen ? 1 : 0], 4),
      uPick: (() => { const flat = new Float32Array(MOST_RECTANGLES); flat.set(powers.map((p) => p / sum(powers) / all)); return flat; })(),
      uPoint: lights.point ?? [0, 0, 0, 0], uPointPick: lit.point / all, uSkyPick: lit.sky / all,
      uZenith: lights.sky.zenith ?? [0, 0, 0], uHorizon: lights.sky.horizon ?? [0, 0, 0], uSkySeen: Boolean(lights.sky.seen),
      uMapTurn: [Math.cos(turn), Math.sin(turn)], uVertices: vertices, uMost: shape.occluding ? 3 : 1e30,
    };
  }

  /**
   * Adds samples to rows of a film.
   * @param {Film} film
   * @param {Pearl} pearl
   * @param {World} world
   * @param {number} rows
   * @param {number} samples
   * @param {number} seed
   * @returns {number} paths that were traced
   */
  trace(film, pearl, world, rows, samples, seed) {
    const { gl, paths } = this;
    const { meet, sample, weigh, add } = this.tracerOf(pearl, world);
    const fitting = Math.floor(MOST_PATHS / samples / film.width);
    const [from, to] = [film.rows, Math.min(film.rows + Math.max(1, Math.min(rows, fitting)), film.height)];
    const count = (to - from) * film.width * samples;
    const values = {
      ...pearl.values, ...this.valuesOf(world, film.width, film.height), uFirst: [0, from], uPicture: [film.width, film.height], uLanes: samples,
      uSeed: seed,
    };
    const unused = this.empty;
    const textures = {
      ...pearl.textures, uMesh: this.textures.uMesh ?? unused, uMap: this.textures.uMap ?? unused, uMapRows: this.textures.uMapRows ?? unused,
      uFilm: film.front.textures[0],
    };
    if (samples === 1 && world.vertices === 1 && !world.shape.occluding && world.lights.point && world.lights.rectangles.length === 0 && world.lights.sky.kind === 0) {
      film.back.bind();
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(0, from, film.width, to - from);
      this.program(DIRECT, { ...pearl.macros, SHAPE: world.shape.kind, SKY: 0 }).draw(values, textures);
      return this.advance(film, to, samples);
    }
    const into = (/** @type {Target} */ target) => {
      target.bind();
      gl.viewport(0, 0, PATHS_WIDTH, Math.ceil(count / PATHS_WIDTH));
    };
    for (let vertex = 0; vertex <= world.vertices; vertex++) {
      [paths.at, paths.before] = [paths.before, paths.at];
      into(paths.at);
      meet.draw({ ...values, uVertex: vertex, uLast: vertex === world.vertices }, {
        ...textures, uAt: paths.before.textures[0], uFound: paths.before.textures[3], uAhead: paths.weighed.textures[0],
        uThroughput: paths.weighed.textures[1], uShadowLight: paths.weighed.textures[2], uShadow: paths.samples.textures[1],
      });
      if (vertex === world.vertices) break;
      const [uAt, uNormal, uCame] = paths.at.textures;
      into(paths.samples);
      sample.draw({ ...values, uVertex: vertex }, { ...textures, uAt, uNormal, uCame });
      [paths.weighed, paths.earlier] = [paths.earlier, paths.weighed];
      into(paths.weighed);
      const [uExit, uShadow, uLight] = paths.samples.textures;
      weigh.draw({ ...values, uVertex: vertex }, { ...textures, uAt, uNormal, uCame, uExit, uShadow, uLight, uBefore: paths.earlier.textures[1] });
    }
    film.back.bind();
    gl.enable(gl.SCISSOR_TEST);
    gl.scissor(0, from, film.width, to - from);
    add.draw(values, { uFilm: film.front.textures[0], uFound: paths.at.textures[3] });
    return this.advance(film, to, samples);
  }

  /**
   * Rows of a film are done up to one.
   * @param {Film} film
   * @param {number} to
   * @param {number} samples
   * @returns {number} paths that were traced
   */
  advance(film, to, samples) {
    const count = (to - film.rows) * film.width * samples;
    this.gl.disable(this.gl.SCISSOR_TEST);
    film.rows = to;
    if (to === film.height) {
      [film.front, film.back] = [film.back, film.front];
      film.rows = 0;
      film.passes++;
      film.samples += samples;
    }
    return count;
  }

  /** Draws the films into the canvas. */
  display() {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.disable(gl.SCISSOR_TEST);
    gl.clearColor(this.surround[0], this.surround[1], this.surround[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    for (const { slot: { area: [x, y, width, height], clip }, film } of this.pictures) {
      film.shown ??= new Target(gl, film.width, film.height, 1, true);
      film.shown.bind();
      this.program(SHOW).draw({ uExposure: this.exposure, uBackground: this.background }, { uFilm: film.front.textures[0] });
      gl.bindFramebuffer(gl.DRAW_FRAMEBUFFER, null);
      gl.enable(gl.SCISSOR_TEST);
      gl.scissor(clip[0], clip[1], clip[2], clip[3]);
      gl.blitFramebuffer(0, 0, film.width, film.height, x, y, x + width, y + height, gl.COLOR_BUFFER_BIT, gl.LINEAR);
      gl.disable(gl.SCISSOR_TEST);
    }
    this.onframe();
  }

  // ---- Progress -----------------------------------------------------------------------------------------------------

  wake() {
    this.resting = false;
    if (this.busy || this.paused || !this.world || this.slots.length === 0) return;
    this.busy = true;
    const run = async () => {
      try {
        await this.refine();
      } catch (error) {
        this.onerror(error);
      } finally {
        this.busy = false;
      }
    };
    this.queue = this.queue.then(run);
  }

  /** Renders until the pictures have samples enough; follows changes. */
  async refine() {
    const { gl } = this;
    let stamp = -1;
    /** Scale of the resolution. */
    let scale = 1;
    let shown = performance.now();
    for (;;) {
      if (gl.isContextLost() || !this.world || this.waiting || this.paused) return;
      const world = this.world;
      const pixels = this.slots.reduce((all, { area }) => all + area[2] * area[3], 0);
      // The scale at which a pass takes so long.
      const scaleFor = (/** @type {number} */ ms) => {
        const found = Math.sqrt(Math.max(ms * this.rate, LEAST_PATHS) / pixels);
        return found > 0.8 ? 1 : found;
      };
      if (stamp !== this.stamp) {
        if (this.slots.length === 0) return;
        const programs = this.slots.flatMap(({ pearl }) => Object.values(this.tracerOf(pearl, world)));
        if (!programs.every((program) => program.ready)) {
          await nextFrame();
          continue;
        }
        stamp = this.stamp;
        scale = scaleFor(1.3 * PIECE_MS);
        this.start(scale);
      } else if (scale < 1 && performance.now() - this.changed > SETTLED_MS) {
        const finer = scaleFor(SETTLED_PASS_MS);
        const enough = this.pictures.every(({ film, next }) => !next && film.samples >= SETTLED_SAMPLES);
        if (enough || finer > 1.6 * scale) {
          scale = enough ? 1 : finer;
          this.start(scale);
        }
      }
      const picture = this.pictures.reduce((a, b) => ((b.next ?? b.film).samples < (a.next ?? a.film).samples ? b : a));
      const film = picture.next ?? picture.film;
      if (film.samples >= ENOUGH && scale === 1) {
        this.resting = true;
        this.display();
        return;
      }
      const begun = performance.now();
      const piece = Math.min(Math.max(this.rate * PIECE_MS, LEAST_PATHS), MOST_PATHS);
      const rows = Math.max(1, Math.ceil(piece / film.width));
      const samples = film.passes > 1 && rows > film.height ? Math.max(1, Math.min(8, Math.floor(piece / film.width / film.height))) : 1;
      const done = this.trace(film, picture.slot.pearl, { ...world, grain: picture.slot.grain }, rows, film.rows === 0 ? (this.batch = samples) : this.batch, 1);
      await finished(gl);
      const took = Math.max(performance.now() - begun, 0.2);
      this.rate += 0.3 * (Math.min(done / took, 2e6) - this.rate);
      this.frameMs = took;
      const { next } = picture;
      // What is coarse but smooth stays until the finer one is; what shows another state goes at once.
      if (next && next.passes > 0 && (next.stamp !== picture.film.stamp || next.samples >= Math.min(SHOWN_SAMPLES, picture.film.samples))) {
        picture.film.delete();
        picture.film = next;
        picture.next = null;
      }
      if (stamp === this.stamp && film.rows === 0 && (film.samples < 4 || performance.now() - shown > 40)) {
        this.display();
        shown = performance.now();
        if (this.firstOf !== stamp) {
          this.firstOf = stamp;
          this.latency = shown - this.changed;
        }
        await nextFrame();
      }
    }
  }

  /**
   * New films; the old ones are shown until the first pass is done.
   * @param {number} scale of the resolution
   */
  start(scale) {
    const old = this.pictures;
    this.pictures = this.slots.map((slot, k) => {
      const [, , width, height] = slot.area.map((x) => Math.max(1, Math.round(x * scale)));
      const film = new Film(this.gl, width, height);
      film.stamp = this.stamp;
      const before = old[k];
      before?.next?.delete();
      return before ? { slot, film: before.film, next: film } : { slot, film, next: null };
    });
    for (const { film } of old.slice(this.slots.length)) film.delete();
  }

  /**
   * Runs work of its own between pictures.
   * @template T
   * @param {() => Promise<T>} work
   * @returns {Promise<T>}
   */
  async alone(work) {
    this.waiting = true;
    const done = this.queue.then(work);
    this.queue = done.then(() => {}, () => {});
    try {
      return await done;
    } finally {
      this.waiting = false;
      if (!this.resting) {
        this.stamp++;
        this.queue.then(() => this.wake());
      }
    }
  }

  /**
   * Light of a picture, linear, top row first.
   * @param {World} world
   * @param {Pearl} pearl
   * @param {number} width
   * @param {number} height
   * @param {number} samples
   * @param {number} seed
   * @returns {Promise<Float32Array>}
   */
  picture(world, pearl, width, height, samples, seed) {
    return this.alone(async () => {
      const film = new Film(this.gl, width, height);
      let lanes = 1;
      while (film.samples < samples) {
        if (pearl.deleted) throw new Error("the pearl was baked anew while it was rendered");
        // As many paths at once as there is room for: no piece is so long that a driver gives up.
        if (film.rows === 0) lanes = Math.max(1, Math.min(Math.floor(MOST_PATHS / (width * height)), samples - film.samples));
        this.trace(film, pearl, world, height, lanes, seed);
        await finished(this.gl);
        if (this.gl.isContextLost()) throw new Error("the graphics processor was lost while it rendered");
      }
      const sums = await film.front.read();
      film.delete();
      const pixels = new Float32Array(4 * width * height);
      for (let y = 0; y < height; y++) {
        for (let x = 0; x < width; x++) {
          const [from, to] = [4 * ((height - 1 - y) * width + x), 4 * (y * width + x)];
          for (let k = 0; k < 3; k++) pixels[to + k] = sums[from + k] / sums[from + 3];
          pixels[to + 3] = 1;
        }
      }
      return pixels;
    });
  }

  /**
   * A scene of the comparison harness.
   * @param {string} name
   * @param {Pearl} pearl
   * @param {number} width
   * @param {number} height
   * @param {number} samples
   * @param {number} seed
   */
  harness(name, pearl, width, height, samples, seed) {
    const scene = harnessScene(name);
    const largest = Number(this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE));
    const whole = (/** @type {string} */ what, /** @type {number} */ value, /** @type {number} */ least, /** @type {number} */ most) => {
      if (!Number.isInteger(value) || value < least || value > most) throw new Error(`${what}: ${value} is not valid; expected a whole number from ${least} to ${most}`);
    };
    whole("width", width, 1, largest);
    whole("height", height, 1, largest);
    whole("samples", samples, 1, 1e9);
    whole("seed", seed, 0, 2 ** 32 - 1);
    return this.picture({ ...scene, grain: 0, floor: [0, 0, 0], vertices: 1 }, pearl, width, height, samples, seed);
  }

  /**
   * Mean light of a square of a shown picture, and its number of samples a pixel.
   * @param {number} which picture
   * @param {number} x of the canvas, from the left
   * @param {number} y from the bottom
   * @param {number} radius
   */
  async read(which, x, y, radius) {
    const picture = this.pictures[which];
    if (!picture || this.gl.isContextLost()) return null;
    const { film, slot } = picture;
    const [px, py] = [((x - slot.area[0]) / slot.area[2]) * film.width, ((y - slot.area[1]) / slot.area[3]) * film.height];
    const reach = Math.max(0, Math.round((radius / slot.area[2]) * film.width));
    const [x0, y0] = [Math.round(px) - reach, Math.round(py) - reach].map((v, k) => Math.max(0, Math.min(v, (k ? film.height : film.width) - 1)));
    const [width, height] = [Math.min(2 * reach + 1, film.width - x0), Math.min(2 * reach + 1, film.height - y0)];
    const sums = await film.front.read(x0, y0, width, height);
    const total = [0, 0, 0, 0];
    sums.forEach((value, k) => (total[k & 3] += value));
    return total[3] > 0 ? total.slice(0, 3).map((value) => value / total[3]) : null;
  }
}

/** @returns {Promise<void>} */
function nextFrame() {
  return new Promise((resolve) => {
    if (document.hidden) setTimeout(resolve, 100);
    else requestAnimationFrame(() => resolve());
  });
}
