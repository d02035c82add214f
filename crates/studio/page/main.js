/**
 * Starts the page, and gives scripts `window.nacre`.
 *
 * @import {Pearl} from "nacre/pearl.js"
 */

import { choice, element, number, segments } from "nacre/controls.js";
import { Unsupported } from "nacre/gl.js";
import { buildMenu } from "nacre/menu.js";
import { readNpz } from "nacre/npz.js";
import { Page } from "nacre/page.js";
import { buildPanel } from "nacre/panel.js";
import { factsOf, plotLobe, plotSpectra } from "nacre/plots.js";
import { Server } from "nacre/server.js";
import { listen } from "nacre/stage.js";

/** @param {string} id */
const find = (id) => /** @type {HTMLElement} */ (document.getElementById(id));

/** Says something on the stage: a fault until it is gone, plain words for a while. */
function notice(/** @type {string} */ text, plain = false) {
  const made = find("notice");
  made.textContent = text;
  made.classList.toggle("plain", plain);
  made.hidden = !text;
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(() => { made.hidden = true; }, plain ? 3500 : 12_000);
}
/** @type {ReturnType<typeof setTimeout> | undefined} */
let noticeTimer;

/** The arrays that this file carries; null without. */
async function carried() {
  const script = document.getElementById("nacre-data");
  if (!script) return null;
  const text = (script.textContent ?? "").trim();
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return readNpz(bytes);
}

function start() {
  const page = new Page(/** @type {HTMLCanvasElement} */ (find("view")), Server.ofAddress());
  page.onnotice = notice;
  let angle = 35;
  let plotting = false;
  let plotAgain = false;

  // ---- The panel and the bar --------------------------------------------------------------------------------------
  const picker = element("input", { type: "file", multiple: true, accept: ".obj,.hdr,.exr,.npz,.json", hidden: true, change: () => take(picker.files) });
  document.body.append(picker);
  page.open = () => picker.click();
  async function take(/** @type {FileList | null | undefined} */ files) {
    for (const file of files ?? []) await page.take(file);
    picker.value = "";
  }
  const updatePanel = buildPanel(page, find("panel"));
  const preset = choice({
    label: "Pearl",
    options: () => {
      const { name } = page.state[page.state.side];
      const known = page.recipes.map((recipe) => /** @type {[string, string]} */ ([recipe.name, recipe.name]));
      return known.some(([value]) => value === name) ? known : [[name, name || "Pearl"], ...known];
    },
    get: () => page.state[page.state.side].name, set: (name) => { page.setRecipe(name).catch((error) => notice(error.message)); },
  });
  preset.classList.add("quiet");
  find("presets").append(preset);
  const view = segments({
    label: "View", quiet: true, options: [["a", "A"], ["b", "B"], ["split", "A | B"], ["sheet", "Sheet"]],
    get: () => (page.state.view === "single" ? page.state.side : page.state.view),
    set: (value) => page.change(value === "a" || value === "b" ? { view: "single", side: value } : { view: value }, "view"),
  });
  find("views").append(view);
  for (const tag of [...find("tags").children]) {
    const side = tag.classList.contains("a") ? "a" : "b";
    tag.replaceWith(element("button", { type: "button", class: `tag ${side}`, "data-side": side, title: `Controls change ${side.toUpperCase()}`, click: () => page.change({ side }, "side") }, side.toUpperCase()));
  }
  find("undo").addEventListener("click", () => page.travel(-1));
  find("redo").addEventListener("click", () => page.travel(1));
  find("link").addEventListener("click", async () => {
    try {
      await navigator.clipboard.writeText(location.href);
      notice("Copied: a link to this state", true);
    } catch {
      notice("The browser does not let this page copy: the address holds the state.");
    }
  });
  buildMenu(page, find("save"), find("menu"));
  const keep = element("button", { type: "button", class: "icon", title: "Put this pearl on the sheet", "aria-label": "Put this pearl on the sheet", click: () => page.keep() });
  keep.innerHTML = '<svg viewBox="0 0 20 20"><path d="M10 4.5v11M4.5 10h11"/></svg>';
  find("views").append(keep);
  addEventListener("keydown", (event) => {
    const typing = event.target instanceof HTMLInputElement && event.target.type === "text";
    if (typing || !(event.ctrlKey || event.metaKey)) return;
    if (event.key.toLowerCase() === "z") {
      event.preventDefault();
      page.travel(event.shiftKey ? 1 : -1);
    } else if (event.key.toLowerCase() === "y") {
      event.preventDefault();
      page.travel(1);
    }
  });

  // ---- Plots ------------------------------------------------------------------------------------------------------
  const angleControl = number({ label: "Incidence", unit: "°", min: 0, max: 89, step: 1, get: () => angle, set: (value) => { angle = value; void plot(); }, initial: () => 35 });
  find("angle").append(angleControl);
  async function plot() {
    if (plotting) {
      plotAgain = true;
      return;
    }
    plotting = true;
    do {
      plotAgain = false;
      const { a, b } = page.pearls.of;
      const { view: how, side } = page.state;
      const seen = /** @type {Pearl[]} */ ((how === "split" ? [a, b] : [side === "b" ? b : a]).filter(Boolean));
      if (seen.length === 0 || page.gl.isContextLost()) break;
      /** @type {import("nacre/plots.js").Facts[]} */
      const facts = [];
      for (const pearl of seen) if (!pearl.deleted) facts.push(await factsOf(pearl, angle));
      if (facts.length < seen.length) {
        // A bake has put another in its place meanwhile.
        plotAgain = true;
        continue;
      }
      plotLobe(/** @type {HTMLCanvasElement} */ (find("lobe")), facts);
      plotSpectra(/** @type {HTMLCanvasElement} */ (find("spectra")), facts);
      const most = Math.max(...facts.flatMap(({ ledger }) => ledger.map(({ share }) => share)), 0.01);
      find("ledger").replaceChildren(...facts[0].ledger.map(({ name }, k) => {
        const shares = facts.map(({ ledger }) => ledger[k].share);
        const bars = shares.map((value) => element("i", { style: `width:${(100 * value) / most}%` }));
        return element("div", {}, element("span", {}, name), element("span", { class: "bars" }, ...bars), element("span", {}, shares.map((value) => (100 * value).toFixed(facts.length > 1 ? 0 : 1)).join(" | ") + " %"));
      }));
      await new Promise((resolve) => setTimeout(resolve, 60));
    } while (plotAgain);
    plotting = false;
  }
  const read = listen(page, {
    stage: find("stage"), divider: find("divider"), readout: find("readout"),
    onangle: (degrees) => { angle = Math.min(degrees, 89); angleControl.update(); void plot(); },
  });

  // ---- What follows the state -------------------------------------------------------------------------------------
  page.onupdate = () => {
    const { state } = page;
    updatePanel();
    preset.update();
    view.update();
    find("stage").classList.toggle("split", state.view === "split");
    if (state.view === "sheet") find("readout").hidden = true;
    find("divider").hidden = find("tags").hidden = state.view !== "split";
    find("divider").style.left = `${100 * state.divider}%`;
    find("divider").setAttribute("aria-valuenow", String(Math.round(100 * state.divider)));
    for (const tag of document.querySelectorAll(".tag")) tag.classList.toggle("live", /** @type {HTMLElement} */ (tag).dataset.side === state.side);
    /** @type {HTMLButtonElement} */ (find("undo")).disabled = !page.history.canUndo;
    /** @type {HTMLButtonElement} */ (find("redo")).disabled = !page.history.canRedo;
    captions();
    void plot();
  };
  /** Names and ratings of the sheet. */
  function captions() {
    const box = find("captions");
    box.hidden = page.state.view !== "sheet";
    if (box.hidden) return;
    const { width, height } = page.canvas;
    const entries = [{ name: `${page.state.a.name || "Pearl"} (A)`, entry: null }, ...page.pearls.tray.map((entry) => ({ name: entry.name, entry }))];
    box.replaceChildren(...page.tiles(entries.length).map(([x, y, w, h], k) => {
      const { name, entry } = entries[k];
      const style = `left:${(100 * x) / width}%;bottom:${(100 * y) / height}%;width:${(100 * w) / width}%;height:${(100 * h) / height}%`;
      const stars = entry ? element("span", { class: "stars", role: "group", "aria-label": `Rating of ${name}` }, ...[1, 2, 3, 4, 5].map((value) => element("button", {
        type: "button", class: value <= entry.stars ? "on" : "", "aria-label": `${value} of 5`, "aria-pressed": String(value === entry.stars),
        click: () => { entry.stars = entry.stars === value ? 0 : value; captions(); },
      }, "★"))) : "";
      const remove = entry ? element("button", { type: "button", class: "remove", title: "Remove", "aria-label": `Remove ${name}`, click: () => {
        page.pearls.tray.splice(page.pearls.tray.indexOf(entry), 1);
        page.apply();
        captions();
      } }, "×") : "";
      return element("figure", { style }, element("figcaption", {}, name, stars), remove);
    }));
  }
  page.renderer.onframe = () => {
    const { renderer } = page;
    if (renderer.pictures.length === 0) return;
    page.canvas.classList.add("live");
    read();
    const samples = Math.min(...renderer.pictures.map(({ film }) => film.samples));
    const scale = renderer.pictures[0].film.width / renderer.pictures[0].slot.area[2];
    find("status").textContent = `${scale < 0.99 ? "Preview, " : ""}${samples} ${samples === 1 ? "sample" : "samples"} a pixel`;
    /** @type {HTMLElement} */ (find("progress").firstElementChild).style.width = `${Math.min(100, 100 * Math.log2(Math.max(samples, 1)) / 12)}%`;
  };
  new ResizeObserver(() => { page.resize(); captions(); void plot(); }).observe(find("stage"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { page.apply(true); void plot(); });
  addEventListener("hashchange", () => location.reload());

  // ---- Files that are dropped -------------------------------------------------------------------------------------
  const drop = find("drop");
  const say = (/** @type {string} */ text) => { /** @type {HTMLElement} */ (drop.firstElementChild).textContent = text; };
  const waiting = "Drop prepared arrays here: lut export pearl.exr --to arrays -o pearl.npz";
  addEventListener("dragover", (event) => {
    event.preventDefault();
    say("Drop an OBJ, HDR, EXR, NPZ or a recipe");
    drop.hidden = false;
  });
  addEventListener("dragleave", (event) => { if (!event.relatedTarget) { say(waiting); drop.hidden = Boolean(page.pearls.of.a); } });
  addEventListener("drop", (event) => {
    event.preventDefault();
    drop.hidden = true;
    void take(event.dataTransfer?.files);
  });

  // ---- The first table --------------------------------------------------------------------------------------------
  async function load() {
    page.resize();
    const own = await carried();
    if (own) return page.begin(own, null, document.title === "Nacre" ? "pearl" : document.title);
    if (!page.server) {
      say(waiting);
      drop.hidden = false;
      return;
    }
    const state = await page.server.state();
    Object.assign(page, { recipes: state.recipes, materials: state.materials, formats: state.formats });
    page.begin(await page.server.initial(), state.recipe, state.name);
  }
  return { page, loaded: load() };
}

/** @type {Page | null} */
let started = null;
let ready = Promise.resolve();
try {
  const { page, loaded } = start();
  started = page;
  ready = loaded;
  loaded.catch((error) => notice(error.message));
} catch (error) {
  if (!(error instanceof Unsupported)) throw error;
  document.body.replaceChildren(element("main", { class: "unsupported" }, element("span", { class: "mark" }), element("p", {}, error.message)));
  ready = Promise.reject(error);
  ready.catch(() => {});
}

/** The page, or why there is none. */
async function live() {
  await ready;
  if (!started?.pearls.of.a) throw new Error("nacre: there is no table yet");
  return started;
}

Object.assign(window, {
  nacre: {
    ready,
    set: (/** @type {Object<string, unknown>} */ changes) => started?.change(changes),
    setRecipe: async (/** @type {object | string} */ recipe) => (await live()).setRecipe(recipe),
    state: () => structuredClone(started?.state),
    render: async (/** @type {{scene: string, width: number, height: number, samples: number, seed?: number}} */ { scene, width, height, samples, seed = 1 }) => {
      const page = await live();
      const pearl = /** @type {Pearl} */ (page.pearls.of[page.state.side] ?? page.pearls.of.a);
      return { width, height, pixels: await page.renderer.harness(scene, pearl, width, height, samples, seed) };
    },
    page: started,
  },
});
