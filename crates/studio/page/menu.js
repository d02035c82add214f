/**
 * The menu that hands over: pictures, recipes, tables, arrays, and text for other programs.
 *
 * @import {Page} from "nacre/page.js"
 */

import { element } from "nacre/controls.js";
import { writeExr } from "nacre/exr.js";
import { scaledRecipe } from "nacre/pearls.js";
import { blenderSnippet, mitsubaSnippet, pythonSnippet } from "nacre/snippets.js";

/**
 * @param {Blob} blob
 * @param {string} name
 */
function download(blob, name) {
  const url = URL.createObjectURL(blob);
  const link = element("a", { href: url, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}

/** Formats of which thickness is a control: they hold the recipe's own, the snippets say which one is shown. */
const SCALABLE = ["table", "arrays"];

/**
 * The recipe of a side with its look.
 * @param {Page} page
 * @param {boolean} asShown whether with the thicknesses that are shown, in place of its own
 */
export function recipeOf(page, asShown) {
  const side = page.state[page.state.side];
  const { depth, brightness, coherence, grain, body_rgb, thickness } = side;
  const scaled = scaledRecipe(side.recipe ?? {}, asShown ? thickness : 1);
  return { ...scaled, schema: "pearl-recipe/1", look: { ...scaled.look, depth, brightness, coherence, grain, body_rgb } };
}

/**
 * Pixels of the first picture, linear, top row first.
 * @param {Page} page
 */
async function pixelsOf(page) {
  const { film } = page.renderer.pictures[0];
  const sums = await film.front.read();
  const { width, height } = film;
  const pixels = new Float32Array(4 * width * height);
  for (let y = 0; y < height; y++) {
    for (let x = 0; x < width; x++) {
      const [from, to] = [4 * ((height - 1 - y) * width + x), 4 * (y * width + x)];
      for (let k = 0; k < 3; k++) pixels[to + k] = sums[from + k] / Math.max(sums[from + 3], 1);
      pixels[to + 3] = 1;
    }
  }
  return { pixels, width, height };
}

/**
 * Fills the menu and opens and closes it.
 * @param {Page} page
 * @param {HTMLElement} button
 * @param {HTMLElement} menu
 */
export function buildMenu(page, button, menu) {
  const name = () => page.state[page.state.side].name || "pearl";
  const item = (/** @type {string} */ text, /** @type {string} */ note, /** @type {() => Promise<void> | void} */ act, /** @type {string | undefined} */ title = undefined) => element("button", {
    type: "button", role: "menuitem", title, click: async () => {
      close();
      try {
        await act();
      } catch (error) {
        page.onnotice(error instanceof Error ? error.message : String(error));
      }
    },
  }, text, element("small", {}, note));
  const copy = async (/** @type {string} */ text, /** @type {string} */ what) => {
    await navigator.clipboard.writeText(text);
    page.onnotice(`Copied: ${what}`, true);
  };
  const file = () => `${name()}.exr`;
  const side = () => page.state[page.state.side];
  const exported = (/** @type {string} */ format, /** @type {string} */ text, /** @type {string} */ ending, /** @type {string} */ title) => item(text, ending, async () => {
    page.onnotice("The file is made …", true);
    const { blob, name: given } = await /** @type {import("nacre/server.js").Server} */ (page.server).export(side().recipe ? recipeOf(page, !SCALABLE.includes(format)) : "current", format);
    download(blob, given ?? `${name()}${ending}`);
  }, title);
  // Filled as it opens: what the server exports is known by then.
  const fill = () => menu.replaceChildren(
    element("h3", {}, "Picture"),
    item("As it is shown", ".png", async () => {
      page.renderer.redraw();
      const blob = await new Promise((resolve) => page.canvas.toBlob(resolve, "image/png"));
      if (blob) download(blob, `${name()}.png`);
    }),
    item("Linear light", ".exr", async () => {
      const { pixels, width, height } = await pixelsOf(page);
      download(new Blob([writeExr(pixels, width, height)], { type: "image/x-exr" }), `${name()}-picture.exr`);
    }),
    element("h3", {}, "Pearl"),
    ...(page.server ? [
      item("Recipe", ".json", () => download(new Blob([JSON.stringify(recipeOf(page, true), null, 2)], { type: "application/json" }), `${name()}.json`)),
      exported("table", "Table", ".exr", "The table that the plugin and the tools read"),
      element("h3", {}, "Other programs"),
      ...page.formats.map((format) => exported(format.name, format.description.replace(/ *\(\.\w+\)/, ""), `.${format.ending}`, `lut export --to ${format.name}`)),
      element("h3", {}, "Page"),
    ] : []),
    item("State of this page", ".json", () => download(new Blob([JSON.stringify(page.state, null, 2)], { type: "application/json" }), `${name()}-state.json`)),
    element("h3", {}, "Copy"),
    item("Mitsuba scene", "XML", () => copy(mitsubaSnippet(side(), file()), "the Mitsuba BSDF")),
    item("Python", "nacre", () => copy(pythonSnippet(side(), file()), "the Python lines")),
    item("Blender", "shell", () => copy(blenderSnippet(file()), "the command for Blender")),
    item("Link to this state", "URL", () => copy(location.href, "the link")),
  );
  function close() {
    menu.hidden = true;
    button.setAttribute("aria-expanded", "false");
  }
  button.addEventListener("click", (event) => {
    event.stopPropagation();
    if (menu.hidden) fill();
    menu.hidden = !menu.hidden;
    button.setAttribute("aria-expanded", String(!menu.hidden));
    if (!menu.hidden) /** @type {HTMLElement | null} */ (menu.querySelector("button"))?.focus();
  });
  menu.addEventListener("keydown", (event) => {
    const items = [...menu.querySelectorAll("button")];
    const at = items.indexOf(/** @type {HTMLButtonElement} */ (document.activeElement));
    const way = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    if (way) {
      event.preventDefault();
      items[(at + way + items.length) % items.length].focus();
    }
    if (event.key === "Escape") {
      close();
      button.focus();
    }
  });
  document.addEventListener("pointerdown", (event) => {
    if (!menu.hidden && !menu.contains(/** @type {Node} */ (event.target)) && event.target !== button) close();
  });
}
