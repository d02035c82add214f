/**
 * The stage: what the pointer does on the picture, and what the page says of the place under it.
 *
 * @import {Page} from "nacre/page.js"
 */

import { deltaE, lab, toHex } from "nacre/colour.js";
import { element } from "nacre/controls.js";
import { cameraAxes } from "nacre/scenes.js";

/** Milliseconds between two readings under the pointer. */
const READING_MS = 90;

/**
 * The angle of incidence at a point of the picture, in degrees; null beside the pearl.
 * @param {Page} page
 * @param {number} x of the picture, from −1 to 1
 * @param {number} y
 * @param {number} width
 * @param {number} height
 */
export function incidenceAt(page, x, y, width, height) {
  const { shape, view } = page.world();
  const { eye, forward, right, up } = cameraAxes(view, width, height);
  const ray = forward.map((v, k) => v + x * right[k] + y * up[k]);
  const length = Math.hypot(...ray);
  const d = ray.map((v) => v / length);
  const dot = (/** @type {number[]} */ a, /** @type {number[]} */ b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  let nearest = Infinity;
  let cosine = NaN;
  for (const [cx, cy, cz, r] of shape.spheres ?? []) {
    const from = [eye[0] - cx, eye[1] - cy, eye[2] - cz];
    const b = dot(from, d);
    const rest = b * b - dot(from, from) + r * r;
    const t = -b - Math.sqrt(rest);
    if (rest > 0 && t > 0 && t < nearest) {
      nearest = t;
      cosine = -dot(from.map((v, k) => (v + t * d[k]) / r), d);
    }
  }
  const mesh = shape.kind === 2 ? page.renderer.mesh : null;
  if (mesh) {
    const { corners, normals } = mesh;
    for (let i = 0; i < corners.length; i += 9) {
      const [ux, uy, uz] = [corners[i + 3] - corners[i], corners[i + 4] - corners[i + 1], corners[i + 5] - corners[i + 2]];
      const [vx, vy, vz] = [corners[i + 6] - corners[i], corners[i + 7] - corners[i + 1], corners[i + 8] - corners[i + 2]];
      const [px, py, pz] = [d[1] * vz - d[2] * vy, d[2] * vx - d[0] * vz, d[0] * vy - d[1] * vx];
      const determinant = ux * px + uy * py + uz * pz;
      if (Math.abs(determinant) < 1e-12) continue;
      const [sx, sy, sz] = [eye[0] - corners[i], eye[1] - corners[i + 1], eye[2] - corners[i + 2]];
      const a = (sx * px + sy * py + sz * pz) / determinant;
      if (a < 0 || a > 1) continue;
      const [qx, qy, qz] = [sy * uz - sz * uy, sz * ux - sx * uz, sx * uy - sy * ux];
      const b = (d[0] * qx + d[1] * qy + d[2] * qz) / determinant;
      if (b < 0 || a + b > 1) continue;
      const t = (vx * qx + vy * qy + vz * qz) / determinant;
      if (t > 0 && t < nearest) {
        nearest = t;
        const n = [0, 1, 2].map((k) => (1 - a - b) * normals[i + k] + a * normals[i + 3 + k] + b * normals[i + 6 + k]);
        cosine = Math.abs(dot(n, d)) / Math.hypot(...n);
      }
    }
  }
  return Number.isFinite(cosine) ? (Math.acos(Math.min(Math.max(cosine, 0), 1)) * 180) / Math.PI : null;
}

/**
 * Listens on the stage. What is given back reads what is under the pointer again.
 * @param {Page} page
 * @param {{stage: HTMLElement, divider: HTMLElement, readout: HTMLElement, onangle: (degrees: number) => void}} parts
 * @returns {() => void}
 */
export function listen(page, { stage, divider, readout, onangle }) {
  const { canvas } = page;
  /** @type {Map<number, PointerEvent>} */
  const down = new Map();
  let pinch = 0;
  let reading = false;
  let last = 0;
  /** Where the pointer rests on the picture. @type {PointerEvent | null} */
  let over = null;

  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    down.set(event.pointerId, event);
    canvas.classList.add("dragging");
    pinch = 0;
  });
  canvas.addEventListener("pointermove", (event) => {
    over = event;
    const before = down.get(event.pointerId);
    if (!before) {
      void read(event, true);
      return;
    }
    down.set(event.pointerId, event);
    const [dx, dy] = [event.clientX - before.clientX, event.clientY - before.clientY];
    const { state } = page;
    if (down.size === 2) {
      const [one, two] = [...down.values()];
      const apart = Math.hypot(one.clientX - two.clientX, one.clientY - two.clientY);
      if (pinch > 0) zoom(apart / pinch);
      pinch = apart;
    } else if (event.shiftKey) {
      page.change({
        light_azimuth_deg: wrapped(state.light_azimuth_deg + dx * 0.5), light_elevation_deg: Math.min(Math.max(state.light_elevation_deg - dy * 0.4, -10), 90),
      }, "light direction");
    } else {
      page.change({
        camera_azimuth_deg: wrapped(state.camera_azimuth_deg - dx * 0.4), camera_elevation_deg: Math.min(Math.max(state.camera_elevation_deg + dy * 0.3, -60), 60),
      }, "camera");
    }
  });
  const up = (/** @type {PointerEvent} */ event) => {
    down.delete(event.pointerId);
    canvas.classList.toggle("dragging", down.size > 0);
  };
  canvas.addEventListener("pointerup", up);
  canvas.addEventListener("pointercancel", up);
  canvas.addEventListener("pointerleave", () => {
    over = null;
    readout.hidden = true;
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-event.deltaY * 0.0012));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    const { state } = page;
    const step = event.shiftKey ? 15 : 4;
    const way = { ArrowLeft: [step, 0], ArrowRight: [-step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] }[event.key];
    if (way) {
      event.preventDefault();
      page.change({ camera_azimuth_deg: wrapped(state.camera_azimuth_deg + way[0]), camera_elevation_deg: Math.min(Math.max(state.camera_elevation_deg + way[1], -60), 60) }, "camera");
    }
    if (event.key === "+" || event.key === "=") zoom(1.1);
    if (event.key === "-") zoom(1 / 1.1);
  });
  function zoom(/** @type {number} */ by) {
    page.change({ zoom: Math.min(Math.max(page.state.zoom * by, 0.5), 4) }, "camera");
  }

  divider.addEventListener("pointerdown", (event) => divider.setPointerCapture(event.pointerId));
  divider.addEventListener("pointermove", (event) => {
    if (!divider.hasPointerCapture(event.pointerId)) return;
    const box = stage.getBoundingClientRect();
    page.change({ divider: Math.min(Math.max((event.clientX - box.left) / box.width, 0), 1) }, "divider");
  });
  divider.addEventListener("keydown", (event) => {
    const way = { ArrowLeft: -0.02, ArrowRight: 0.02 }[event.key];
    if (!way) return;
    event.preventDefault();
    page.change({ divider: Math.min(Math.max(page.state.divider + way, 0), 1) }, "divider");
  });

  const readable = () => over !== null && page.state.view !== "sheet";
  /**
   * Reads colours under the pointer.
   * @param {PointerEvent} event
   * @param {boolean} moved whether the angle is to follow
   */
  async function read(event, moved) {
    const now = performance.now();
    if (reading || now - last < READING_MS || !readable()) return;
    last = now;
    const box = canvas.getBoundingClientRect();
    const [x, y] = [(event.clientX - box.left) / box.width, 1 - (event.clientY - box.top) / box.height];
    const degrees = incidenceAt(page, 2 * x - 1, 2 * y - 1, canvas.width, canvas.height);
    if (degrees === null) {
      readout.hidden = true;
      return;
    }
    reading = true;
    if (moved) onangle(degrees);
    const found = [];
    for (let k = 0; k < page.slots().length; k++) found.push(await page.renderer.read(k, x * canvas.width, y * canvas.height, 3 * (canvas.width / box.width)));
    reading = false;
    if (!readable()) return;
    const colours = found.filter((rgb) => rgb !== null).map((rgb) => rgb.map((v) => v * page.renderer.exposure));
    if (colours.length === 0) return;
    const labs = colours.map(lab);
    const line = (/** @type {number[]} */ rgb, /** @type {number[]} */ of) => [
      element("span", { class: "patch", style: `background:${toHex(rgb)}` }), of.map((v) => v.toFixed(1).replace("-", "−")).join("  "),
    ];
    const rows = [element("b", {}, "Incidence"), element("span", {}, `${degrees.toFixed(0)}°`)];
    labs.forEach((of, k) => rows.push(element("b", {}, labs.length > 1 ? `Lab ${"AB"[k]}` : "Lab"), element("span", {}, ...line(colours[k], of))));
    if (labs.length > 1) rows.push(element("b", {}, "ΔE00"), element("span", {}, deltaE(labs[0], labs[1]).toFixed(2)));
    readout.replaceChildren(...rows);
    readout.hidden = false;
  }
  return () => { if (over) void read(over, false); };
}

/** @param {number} degrees */
function wrapped(degrees) {
  return ((((degrees + 180) % 360) + 360) % 360) - 180;
}
