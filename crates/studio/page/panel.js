/**
 * The panel of controls.
 *
 * @import {Page} from "nacre/page.js"
 * @import {Control} from "nacre/controls.js"
 * @import {Recipe} from "nacre/server.js"
 */

import { fromHex, toHex } from "nacre/colour.js";
import { choice, colour, direction, element, number, segments, switches } from "nacre/controls.js";
import { LIGHTS, SHAPES } from "nacre/scenes.js";
import { DEFAULT_SCALES } from "nacre/pearls.js";
import { RANGES, START } from "nacre/state.js";

/**
 * A part of the panel that opens and closes.
 * @param {string} title
 * @param {boolean} open
 * @param {...(Node | string)} children
 */
function part(title, open, ...children) {
  const summary = element("summary", {}, title);
  const made = element("details", open ? { open: true } : {}, summary, element("div", { class: "body" }, ...children));
  return Object.assign(made, { summary });
}

/**
 * Builds the panel; gives back what shows the present state.
 * @param {Page} page
 * @param {HTMLElement} into
 * @returns {() => void}
 */
export function buildPanel(page, into) {
  /** @type {Control[]} */
  const controls = [];
  /** @template {Control} T @param {T} made @returns {T} */
  const add = (made) => { controls.push(made); return made; };
  const side = () => page.state[page.state.side];
  const share = (/** @type {"depth" | "brightness" | "coherence" | "grain"} */ key, /** @type {string} */ label, /** @type {string} */ hint) => add(number({
    label, hint, min: 0, max: 1, step: 0.01, get: () => side()[key], set: (value) => page.change({ [key]: value }, key), initial: () => page.initial()[key],
  }));
  const paint = (/** @type {"body_rgb" | "tint_rgb"} */ key, /** @type {string} */ label, /** @type {string} */ hint) => add(colour({
    label, hint, get: () => toHex(side()[key]), set: (hex) => page.change({ [key]: fromHex(hex) }, key), initial: () => toHex(page.initial()[key]),
  }));
  const global = (/** @type {"light_azimuth_deg" | "light_elevation_deg" | "exposure_ev"} */ key, /** @type {string} */ label, /** @type {string} */ unit, /** @type {number} */ step, slider = false) => add(number({
    label, unit, step, min: RANGES[key][0], max: RANGES[key][1], slider, get: () => page.state[key], set: (value) => page.change({ [key]: value }, key), initial: () => START[key],
  }));

  const which = element("small");
  const look = part("Look", true,
    share("depth", "Depth", "How much of the body's light is interference from inside the nacre"),
    share("brightness", "Brightness", "Strength of the reflecting lobes; the rest feeds the body"),
    share("coherence", "Coherence", "How much of the coherent interference colours the reflections show"),
    share("grain", "Grain", "Height of the surface's fine bumps"),
    paint("body_rgb", "Body colour", "Colour of the nucleus and the body under the nacre"),
    paint("tint_rgb", "Interference tint", "Factor of all interference colours; white leaves the physics alone"),
    add(switches({
      label: "Components", options: [["diffuse", "Diffuse"], ["incoherent", "Incoherent"], ["mirror", "Mirror"], ["blur", "Blur"]],
      get: () => page.state.components, set: (components) => page.change({ components }, "components"),
    })));
  look.summary.append(which);
  const scales = () => {
    const { min, max } = { ...DEFAULT_SCALES, ...side().recipe?.look?.thickness };
    return page.pearls.of[page.state.side]?.table.scales ?? (side().recipe?.look?.thickness ? [min, max] : null);
  };
  const thickness = add(number({
    label: "Thickness", unit: "×", min: DEFAULT_SCALES.min, max: DEFAULT_SCALES.max, step: 0.005, hint: "Scale of all layers' thicknesses: the cause of the interference colour",
    get: () => side().thickness, initial: () => 1,
    set: (value) => {
      const [low, high] = scales() ?? [1, 1];
      page.change({ thickness: Math.min(Math.max(value, low), high) }, "thickness");
    },
  }));
  // Where a table holds the colours of one thickness alone.
  const fixed = element("div", { class: "control fixed" },
    element("span", { class: "name" }, "Thickness"),
    page.server ? element("button", {
      type: "button", class: "button", title: "Bakes the colours of all thicknesses from 0.7 to 1.4 times the recipe's",
      click: () => page.change({ recipe: { ...side().recipe, look: { ...side().recipe?.look, thickness: DEFAULT_SCALES } } }, "thickness as a control"),
    }, "Make it a control") : element("small", {}, "fixed in this table"));
  for (const made of [thickness, fixed]) look.querySelector(".body")?.insertBefore(made, look.querySelector(".colour"));

  const floor = add(segments({
    label: "Backdrop", options: [["light", "Light"], ["grey", "Grey"], ["dark", "Dark"]], get: () => page.state.backdrop, set: (backdrop) => page.change({ backdrop }, "backdrop"),
  }));
  const scene = part("Scene and light", true,
    add(choice({
      label: "Shape", options: () => Object.entries(SHAPES).filter(([name]) => name !== "mesh" || page.hasMesh).map(([name, { title }]) => [name, title]),
      get: () => page.state.scene, set: (name) => page.change({ scene: name }, "scene"),
    })),
    add(choice({
      label: "Light", options: () => Object.entries(LIGHTS).filter(([name]) => name !== "map" || page.hasMap).map(([name, { title }]) => [name, title]),
      get: () => page.state.light, set: (light) => page.change({ light }, "light"),
    })),
    element("div", { class: "light" },
      add(direction({
        get: () => [page.state.light_azimuth_deg, page.state.light_elevation_deg],
        set: (azimuth, elevation) => page.change({ light_azimuth_deg: azimuth, light_elevation_deg: elevation }, "light direction"),
      })),
      element("div", {}, global("light_azimuth_deg", "Azimuth", "°", 1), global("light_elevation_deg", "Elevation", "°", 1))),
    global("exposure_ev", "Exposure", "EV", 0.1, true), floor,
    element("div", { class: "row" },
      element("button", { type: "button", class: "button", click: () => page.open() }, "Open file …"),
      element("button", { type: "button", class: "button", click: () => page.change({ camera_azimuth_deg: 0, camera_elevation_deg: 0, zoom: 1 }, "camera") }, "Reset view")),
    element("p", {}, "Opens or takes by dropping: OBJ shapes, HDR and EXR surroundings, prepared arrays (.npz)" + (page.server ? ", recipes (.json)." : ".")));

  into.replaceChildren(look, scene);
  const baked = element("small", { role: "status" });
  const refused = element("p", { class: "error", role: "alert" });
  if (page.server) {
    const made = buildPhysics(page, add);
    made.summary.append(baked);
    made.querySelector(".body")?.prepend(refused);
    into.insertBefore(made, scene);
  }
  return () => {
    which.textContent = page.state.view === "split" ? `of ${page.state.side.toUpperCase()}` : "";
    thickness.hidden = !scales();
    fixed.hidden = !thickness.hidden;
    /** @type {HTMLButtonElement | null} */ (fixed.querySelector("button"))?.toggleAttribute("disabled", !side().recipe);
    floor.hidden = ["aurora", "map"].includes(page.state.light);
    const { text, failed } = page.bakeLine;
    baked.textContent = failed ? "not baked" : text;
    baked.classList.toggle("error", failed);
    refused.textContent = text;
    refused.hidden = !failed;
    for (const each of controls) each.update();
  };
}

/** Choices of a medium's index beside the library's: a number, and what a recipe says in another way. */
const [PLAIN, OWN] = ["", "own"];

/**
 * The physics of a recipe: what it is baked of.
 * @param {Page} page
 * @param {<T extends Control>(made: T) => T} add
 */
function buildPhysics(page, add) {
  const recipe = () => page.state[page.state.side].recipe ?? {};
  const read = (/** @type {string} */ path) => path.split(".").reduce((/** @type {any} */ at, key) => at?.[key], recipe());
  const write = (/** @type {Object<string, unknown>} */ values) => {
    const next = structuredClone(recipe());
    for (const [path, value] of Object.entries(values)) {
      const keys = path.split(".");
      const last = /** @type {string} */ (keys.pop());
      let at = next;
      for (const key of keys) at = at[key] ??= {};
      at[last] = value;
    }
    page.change({ recipe: next }, Object.keys(values).join());
  };
  const field = (/** @type {string} */ path, /** @type {string} */ label, /** @type {string} */ unit, /** @type {number} */ min, /** @type {number} */ max, /** @type {number} */ step, /** @type {number} */ fallback, slider = false) => add(number({
    label, unit, min, max, step, slider,
    get: () => { const value = read(path); return typeof value === "number" ? value : fallback; },
    set: (value) => { if (value !== read(path)) write({ [path]: value }); },
    initial: () => { const value = path.split(".").reduce((/** @type {any} */ at, key) => at?.[key], page.initialRecipe()); return typeof value === "number" ? value : fallback; },
  }));
  const medium = (/** @type {string} */ name, /** @type {string} */ title, /** @type {boolean} */ layered) => {
    const at = `stack.${name}`;
    /** The library's material that the index is of; null of a number or another. */
    const material = () => {
      const n = read(`${at}.n`);
      if (typeof n !== "object" || n === null) return null;
      return page.materials.find((known) => known.name === n.material || JSON.stringify(known.n) === JSON.stringify(n)) ?? null;
    };
    const which = () => (typeof read(`${at}.n`) === "object" ? material()?.name ?? OWN : PLAIN);
    const index = field(`${at}.n`, "Index n", "", 0.05, 4, 0.001, 1.5);
    const absorption = field(`${at}.k`, "Absorption k", "", 0, 10, 0.0001, 0);
    const numbers = element("div", { class: "pair" }, index, ...(name === "ambient" ? [] : [absorption]));
    const source = element("p", {});
    const shown = add(Object.assign(element("div", { hidden: true }), { update: () => {
      const chosen = which();
      const known = material();
      numbers.hidden = chosen !== PLAIN;
      source.hidden = chosen === PLAIN;
      source.textContent = known ? `${known.source}; ${known.from_nm} to ${known.to_nm} nm` : "Its index depends on the wavelength, as the recipe says.";
    } }));
    return [
      element("h4", {}, title),
      ...(layered ? [field(`${at}.thickness_nm`, "Thickness", "nm", 1, 1000, 1, 100, true), field(`${at}.thickness_sd_nm`, "Spread of thickness", "nm", 0, 100, 0.1, 0)] : []),
      add(choice({
        label: "Material", name: `Material of ${title.toLowerCase()}`,
        options: () => [[PLAIN, "Constant index"], ...(which() === OWN ? [/** @type {[string, string]} */ ([OWN, "The recipe's own"])] : []), ...page.materials.map((known) => /** @type {[string, string]} */ ([known.name, known.name]))],
        get: which,
        set: (chosen) => {
          // Back to a number: the one that it had in the middle of the visible range.
          const [n, k] = material()?.index ?? [1.5, 0];
          write(chosen === PLAIN ? { [`${at}.n`]: Number(n.toFixed(4)), ...(k > 0 ? { [`${at}.k`]: Number(k.toFixed(4)) } : {}) } : { [`${at}.n`]: { material: chosen } });
        },
      })),
      numbers, source, shown,
    ];
  };
  const sources = element("dl", { class: "sources" });
  const cited = element("details", { class: "cited" }, element("summary", {}, "Sources of these numbers"), sources);
  const citing = add(Object.assign(element("div", { hidden: true }), { update: () => {
    const first = page.initialRecipe();
    const entries = Object.entries(/** @type {Object<string, string>} */ (first.sources ?? {}));
    cited.hidden = entries.length === 0;
    const before = (/** @type {string} */ path) => path.split(".").reduce((/** @type {any} */ value, key) => value?.[key], first);
    const changed = (/** @type {string} */ path) => path !== "look" && JSON.stringify(before(path)) !== JSON.stringify(read(path));
    sources.replaceChildren(...entries.flatMap(([path, text]) => [
      element("dt", {}, path.replace(/^(stack|facets)\./, "").replace(/_(nm|deg)$/, "").replace(/[._]/g, " ")),
      element("dd", changed(path) ? { class: "changed", title: "You have changed this number" } : {}, text),
    ]));
  } }));
  const explicit = element("p", {}, "The recipe lists its layers one by one: change them in the file.");
  const layered = element("div", { class: "body", style: "padding:0" },
    ...medium("aragonite", "Aragonite", true), ...medium("conchiolin", "Conchiolin", true),
    element("h4", {}, "Stack"), field("stack.layers", "Layers", "", 1, 2000, 1, 500),
    add(segments({ label: "Layers are counted in", options: [["layers", "Layers"], ["pairs", "Pairs"]], get: () => read("stack.count") ?? "layers", set: (count) => write({ "stack.count": count }) })));
  const listed = add(Object.assign(element("div"), { update: () => {
    const is = Boolean(read("stack.explicit"));
    layered.hidden = is;
    explicit.hidden = !is;
  } }));
  listed.hidden = true;
  return part("Physics", true, listed, explicit, layered,
    ...medium("ambient", "Ambient", false), ...medium("substrate", "Substrate", false), element("h4", {}, "Facets"),
    field("facets.slope_sd_deg", "Facets' slope σ", "°", 0.3, 15, 0.05, 2, true),
    add(segments({ label: "Azimuth", options: [["decay", "Decay (paper)"], ["space", "In space"]], get: () => read("azimuth.mode") ?? "decay", set: (mode) => write({ "azimuth.mode": mode }) })), cited, citing);
}
