/**
 * Shapes, lights and cameras. The first four scenes are those of the comparison harness (tools/compare/scenes.py).
 *
 * @typedef {object} Camera
 * @property {number[]} target
 * @property {number} distance
 * @property {number} azimuth degrees, from the front
 * @property {number} elevation degrees
 * @property {number} spread tangent of half the field of view, of the shorter side
 *
 * @typedef {object} Rectangle
 * @property {number[]} corner
 * @property {number[]} u
 * @property {number[]} v
 * @property {number[]} radiance
 * @property {boolean} [seen] by the camera
 *
 * @typedef {object} Lights
 * @property {Rectangle[]} rectangles
 * @property {{kind: number, zenith?: number[], horizon?: number[], seen?: boolean, turn?: number}} sky kinds as in glsl/scene.js
 * @property {number[]} [point] position and intensity
 *
 * @typedef {object} Shape
 * @property {0 | 1 | 2} kind spheres, the harness's sheet, a mesh
 * @property {number[][]} [spheres]
 * @property {boolean} floor
 * @property {boolean} occluding
 */

const HARNESS_CAMERA = { eye: [0, -6, 1.5], target: [0, 0, 0], spread: 0.185 };
const UNIT_SPHERE = [[0, 0, 0, 1]];
/** @type {Object<string, Lights>} */
const HARNESS_LIGHTS = {
  environment: { rectangles: [], sky: { kind: 1 } },
  area: { rectangles: [{ corner: [-2.6, -3, 2.2], u: [1.6, 0, 0], v: [0, 1.1, 1.1], radiance: [9, 9, 9] }], sky: { kind: 0 } },
  point: { rectangles: [], sky: { kind: 0 }, point: [-2, -4, 3, 45] },
};

/** What the harness calls a scene: direct light, no shadows. */
export const HARNESS = /** @type {const} */ (["sphere-environment", "sheet-environment", "sphere-area", "sphere-point"]);

/**
 * @param {string} name
 * @returns {{shape: Shape, lights: Lights, view: {eye: number[], target: number[], spread: number}}}
 */
export function harnessScene(name) {
  if (!(/** @type {readonly string[]} */ (HARNESS).includes(name))) throw new Error(`scene: ${name} is not known; expected one of ${HARNESS.join(", ")}`);
  const [kind, light] = name.split("-");
  const shape = /** @type {Shape} */ (kind === "sphere"
    ? { kind: 0, spheres: UNIT_SPHERE, floor: false, occluding: false }
    : { kind: 1, floor: false, occluding: false });
  return { shape, lights: HARNESS_LIGHTS[light], view: HARNESS_CAMERA };
}

/**
 * The pearls of a strand: a curve on the ground, the largest pearl in front.
 * @returns {number[][]}
 */
function strand() {
  const pearls = [];
  const count = 15;
  const middle = (count - 1) / 2;
  let angle = 0;
  const place = (/** @type {number} */ a, /** @type {number} */ r) => [1.75 * Math.sin(a), 0.75 - 1.35 * Math.cos(a), -1 + r, r];
  const radius = (/** @type {number} */ k) => 0.36 - 0.016 * k;
  pearls.push(place(0, radius(0)));
  for (let k = 1; k <= middle; k++) {
    const before = place(angle, radius(k - 1));
    // Onwards until it just does not touch the one before.
    while (Math.hypot(...place(angle, radius(k)).slice(0, 3).map((x, i) => x - before[i])) < radius(k) + radius(k - 1) + 0.006) angle += 0.002;
    const [x, y, z, r] = place(angle, radius(k));
    pearls.push([x, y, z, r], [-x, y, z, r]);
  }
  return pearls;
}

/** @type {Object<string, {title: string, shape: Shape, camera: Camera}>} */
export const SHAPES = {
  pearl: {
    title: "Pearl", shape: { kind: 0, spheres: UNIT_SPHERE, floor: true, occluding: true },
    camera: { target: [0, 0, -0.12], distance: 7, azimuth: 0, elevation: 14, spread: 0.205 },
  },
  strand: {
    title: "Strand", shape: { kind: 0, spheres: strand(), floor: true, occluding: true },
    camera: { target: [0, 0.15, -0.75], distance: 7.2, azimuth: 0, elevation: 32, spread: 0.285 },
  },
  sheet: {
    title: "Folded sheet", shape: { kind: 2, floor: true, occluding: true },
    camera: { target: [0, 0, -0.6], distance: 7, azimuth: 0, elevation: 38, spread: 0.26 },
  },
  mesh: {
    title: "Your OBJ", shape: { kind: 2, floor: true, occluding: true },
    camera: { target: [0, 0, -0.15], distance: 7, azimuth: 0, elevation: 16, spread: 0.24 },
  },
};

/**
 * A square light that looks at the origin's pearl.
 * @param {number} azimuth degrees, 0 from the front, 90 from the right
 * @param {number} elevation degrees
 * @param {number} distance
 * @param {number} width
 * @param {number} height
 * @param {number} radiance
 * @returns {Rectangle}
 */
function facing(azimuth, elevation, distance, width, height, radiance) {
  const [a, e] = [azimuth, elevation].map((x) => (x * Math.PI) / 180);
  const out = [Math.sin(a) * Math.cos(e), -Math.cos(a) * Math.cos(e), Math.sin(e)];
  const right = [Math.cos(a), Math.sin(a), 0];
  const up = [-Math.sin(a) * Math.sin(e), Math.cos(a) * Math.sin(e), Math.cos(e)];
  return {
    corner: out.map((x, k) => distance * x - (width / 2) * right[k] - (height / 2) * up[k] - (k === 2 ? 0.1 : 0)),
    u: right.map((x) => width * x), v: up.map((x) => height * x), radiance: [radiance, radiance, radiance],
  };
}

/**
 * The four panes of a window.
 * @param {number} azimuth
 * @param {number} elevation
 */
function panes(azimuth, elevation) {
  const whole = facing(azimuth, elevation, 5, 2.7, 3.4, 4.2);
  return [0, 1, 2, 3].map((k) => {
    const [x, y] = [k & 1, k >> 1];
    const at = [x ? 0.53 : 0, y ? 0.53 : 0];
    return {
      ...whole, corner: whole.corner.map((c, i) => c + at[0] * whole.u[i] + at[1] * whole.v[i]),
      u: whole.u.map((c) => 0.47 * c), v: whole.v.map((c) => 0.47 * c),
    };
  });
}

/** Lights by name, for a direction of the key light in degrees. @type {Object<string, {title: string, lights: (azimuth: number, elevation: number) => Lights}>} */
export const LIGHTS = {
  studio: {
    title: "Studio windows",
    lights: (azimuth, elevation) => ({
      rectangles: [...panes(azimuth, elevation), facing(azimuth + 105, Math.min(elevation, 28), 6, 0.8, 3.6, 2.4), facing(azimuth + 180, 55, 6, 3.2, 1.6, 1.2)],
      sky: { kind: 2, zenith: [0.5, 0.51, 0.53], horizon: [0.3, 0.3, 0.31] },
    }),
  },
  lamp: {
    title: "One lamp",
    lights: (azimuth, elevation) => ({
      rectangles: [facing(azimuth, elevation, 4.6, 0.55, 0.55, 150)],
      sky: { kind: 2, zenith: [0.06, 0.065, 0.075], horizon: [0.045, 0.045, 0.05] },
    }),
  },
  aurora: {
    title: "Diffuse table (aurora)",
    lights: (azimuth, elevation) => ({
      rectangles: [
        { corner: [-7, -6, -1.002], u: [14, 0, 0], v: [0, 14, 0], radiance: [0.62, 0.62, 0.62], seen: true },
        facing(azimuth, elevation, 5.5, 1.6, 1.6, 5),
      ],
      sky: { kind: 2, zenith: [0.12, 0.125, 0.135], horizon: [0.62, 0.62, 0.62], seen: true },
    }),
  },
  sky: { title: "Soft sky", lights: () => ({ rectangles: [], sky: { kind: 1, seen: false } }) },
  map: { title: "Your HDR or EXR", lights: (azimuth) => ({ rectangles: [], sky: { kind: 3, seen: true, turn: azimuth } }) },
};

/**
 * The eye and the axes of the picture.
 * @param {{eye: number[], target: number[], spread: number}} view
 * @param {number} width
 * @param {number} height
 */
export function cameraAxes({ eye, target, spread }, width, height) {
  const unit = (/** @type {number[]} */ v) => v.map((x) => x / Math.hypot(...v));
  const cross = (/** @type {number[]} */ a, /** @type {number[]} */ b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
  const forward = unit(target.map((x, k) => x - eye[k]));
  const right = unit(cross(forward, [0, 0, 1]));
  const up = cross(right, forward);
  // What fits the shorter side is always seen.
  const short = Math.min(width, height);
  return { eye, forward, right: right.map((x) => (x * spread * width) / short), up: up.map((x) => (x * spread * height) / short) };
}

/**
 * The view of a camera that turns about its target.
 * @param {Camera} camera
 */
export function viewOf({ target, distance, azimuth, elevation, spread }) {
  const [a, e] = [azimuth, elevation].map((x) => (x * Math.PI) / 180);
  const out = [Math.sin(a) * Math.cos(e), -Math.cos(a) * Math.cos(e), Math.sin(e)];
  return { eye: target.map((x, k) => x + distance * out[k]), target, spread };
}
