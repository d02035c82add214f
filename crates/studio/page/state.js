/**
 * What a page shows, as one JSON object: `nacre.state()` gives it, `nacre.set()` takes it, the address keeps it, and undo goes back
 * in it.
 *
 * @typedef {object} Side one of the two pearls that are compared
 * @property {number} depth
 * @property {number} brightness
 * @property {number} coherence
 * @property {number} grain
 * @property {number} thickness scale of all thicknesses
 * @property {number[]} body_rgb
 * @property {number[]} tint_rgb
 * @property {string} name of its table
 * @property {Object<string, any> | null} recipe that it is baked of, where there is a server
 *
 * @typedef {object} State
 * @property {Side} a
 * @property {Side} b
 * @property {"a" | "b"} side that the controls change
 * @property {"single" | "split" | "sheet"} view
 * @property {number} divider
 * @property {string[]} components that are shown
 * @property {string} scene
 * @property {string} light
 * @property {number} light_azimuth_deg
 * @property {number} light_elevation_deg
 * @property {number} exposure_ev
 * @property {string} backdrop
 * @property {number} camera_azimuth_deg
 * @property {number} camera_elevation_deg
 * @property {number} zoom
 */

/** What a side has before a table is there. @type {Side} */
export const PLAIN_SIDE = { depth: 0.5, brightness: 1, coherence: 0.5, grain: 0, thickness: 1, body_rgb: [0.8, 0.78, 0.75], tint_rgb: [1, 1, 1], name: "", recipe: null };

/** @type {State} */
export const START = {
  a: PLAIN_SIDE, b: PLAIN_SIDE, side: "a", view: "single", divider: 0.5, components: ["diffuse", "incoherent", "mirror", "blur"],
  scene: "pearl", light: "studio", light_azimuth_deg: -38, light_elevation_deg: 42, exposure_ev: 0, backdrop: "grey",
  camera_azimuth_deg: 0, camera_elevation_deg: 0, zoom: 1,
};

/** Ranges of the numbers. @type {Object<string, [number, number]>} */
export const RANGES = {
  depth: [0, 1], brightness: [0, 1], coherence: [0, 1], grain: [0, 1], thickness: [0.25, 4], divider: [0, 1],
  light_azimuth_deg: [-180, 180], light_elevation_deg: [-10, 90], exposure_ev: [-4, 4],
  camera_azimuth_deg: [-180, 180], camera_elevation_deg: [-60, 60], zoom: [0.5, 4],
};

const SIDE_KEYS = Object.keys(PLAIN_SIDE);

/**
 * Checks one value and gives it back as it is kept.
 * @param {string} key
 * @param {unknown} value
 * @param {Object<string, readonly string[]>} choices
 */
function checked(key, value, choices) {
  const range = RANGES[key];
  if (range) {
    if (!(typeof value === "number" && value >= range[0] && value <= range[1])) {
      throw new Error(`${key}: ${JSON.stringify(value)} is not valid; expected a number from ${range[0]} to ${range[1]}`);
    }
    return value;
  }
  if (key.endsWith("_rgb")) {
    const list = Array.isArray(value) ? value : [];
    if (list.length !== 3 || list.some((x) => !(typeof x === "number" && x >= 0 && x <= 1))) {
      throw new Error(`${key}: ${JSON.stringify(value)} is not valid; expected three numbers from 0 to 1`);
    }
    return list;
  }
  if (key === "components") {
    const list = Array.isArray(value) ? value.map(String) : [];
    if (list.some((name) => !START.components.includes(name))) throw new Error(`components: expected some of ${START.components.join(", ")}`);
    return START.components.filter((name) => list.includes(name));
  }
  if (key === "name") return String(value);
  if (key === "recipe") {
    if (value !== null && (typeof value !== "object" || Array.isArray(value))) throw new Error("recipe: expected an object, or null");
    return value;
  }
  const known = choices[key];
  if (!known?.includes(String(value))) throw new Error(`${key}: ${String(value)} is not known${known ? `; expected one of ${known.join(", ")}` : ""}`);
  return String(value);
}

/**
 * A state with changes. Keys of a side stand for the side that the controls change.
 * @param {State} state
 * @param {Object<string, unknown>} changes
 * @param {Object<string, readonly string[]>} choices what the keys that are names may be
 * @returns {State}
 */
export function changed(state, changes, choices) {
  const next = { ...state, a: { ...state.a }, b: { ...state.b } };
  if (changes.side !== undefined) next.side = /** @type {"a" | "b"} */ (checked("side", changes.side, choices));
  for (const [key, value] of Object.entries(changes)) {
    if (key === "a" || key === "b") {
      for (const [inner, own] of Object.entries(/** @type {object} */ (value ?? {}))) {
        if (!SIDE_KEYS.includes(inner)) throw new Error(`${key}.${inner} is not known`);
        Object.assign(next[key], { [inner]: checked(inner, own, choices) });
      }
    } else if (SIDE_KEYS.includes(key)) Object.assign(next[next.side], { [key]: checked(key, value, choices) });
    else if (key in START) Object.assign(next, { [key]: checked(key, value, choices) });
    else throw new Error(`${key} is not known`);
  }
  return next;
}

/**
 * A state as text of an address: what differs from the start.
 * @param {State} state
 * @param {State} start
 */
export function toHash(state, start) {
  /** @type {Object<string, unknown>} */
  const different = {};
  for (const [key, value] of Object.entries(state)) {
    const before = /** @type {Object<string, unknown>} */ (/** @type {unknown} */ (start))[key];
    if (JSON.stringify(value) !== JSON.stringify(before)) different[key] = value;
  }
  return Object.keys(different).length ? `#s=${encodeURIComponent(JSON.stringify(different))}` : "#";
}

/**
 * What an address holds; throws where that is no JSON.
 * @param {string} hash
 */
export function fromHash(hash) {
  const text = /[#&]s=([^&]*)/.exec(hash)?.[1];
  return /** @type {Object<string, unknown>} */ (text ? JSON.parse(decodeURIComponent(text)) : {});
}

/** States to go back to; changes that follow each other quickly are one step. */
export class History {
  /** @param {State} state */
  constructor(state) {
    this.states = [state];
    this.at = 0;
    this.last = 0;
    this.what = "";
  }

  /**
   * @param {State} state
   * @param {string} what was changed
   */
  push(state, what) {
    const now = Date.now();
    const joined = what === this.what && now - this.last < 700 && this.at > 0;
    this.states.length = this.at + (joined ? 0 : 1);
    this.states.push(state);
    if (this.states.length > 200) this.states.shift();
    this.at = this.states.length - 1;
    this.last = now;
    this.what = what;
  }

  /** @param {-1 | 1} way */
  go(way) {
    this.at = Math.min(Math.max(this.at + way, 0), this.states.length - 1);
    this.what = "";
    return this.states[this.at];
  }

  get canUndo() { return this.at > 0; }
  get canRedo() { return this.at < this.states.length - 1; }
}
