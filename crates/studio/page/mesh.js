/**
 * Triangle meshes: Wavefront OBJ, a folded sheet, and the tree of boxes that the shaders walk.
 *
 * @typedef {object} Mesh
 * @property {Float32Array} corners nine numbers a triangle
 * @property {Float32Array} normals nine numbers a triangle
 */

import { PACKED_WIDTH } from "nacre/table.js";

const MOST_TRIANGLES = 400_000;

/**
 * Reads the shapes of an OBJ file: vertices, normals and faces; the rest is passed over. The mesh is moved and scaled to
 * stand on the ground in the unit sphere.
 * @param {string} text
 * @returns {Mesh}
 */
export function readObj(text) {
  /** @type {number[][]} */
  const positions = [];
  /** @type {number[][]} */
  const directions = [];
  /** @type {{at: number, normal: number}[][]} */
  const triangles = [];
  text.split("\n").forEach((line, number) => {
    const [kind, ...rest] = line.trim().split(/\s+/);
    if (kind === "v") positions.push(rest.slice(0, 3).map(Number));
    else if (kind === "vn") directions.push(rest.slice(0, 3).map(Number));
    else if (kind === "f") {
      const corners = rest.map((word) => {
        const [at, , normal] = word.split("/");
        const index = (/** @type {string | undefined} */ given, /** @type {number} */ count) => {
          const value = Number(given || NaN);
          return value < 0 ? count + value : value - 1;
        };
        return { at: index(at, positions.length), normal: index(normal, directions.length) };
      });
      if (corners.some(({ at }) => !positions[at])) throw new Error(`line ${number + 1}: a face names a vertex that is not there`);
      for (let k = 2; k < corners.length; k++) triangles.push([corners[0], corners[k - 1], corners[k]]);
    }
  });
  if (triangles.length === 0) throw new Error("it has no faces");
  if (triangles.length > MOST_TRIANGLES) throw new Error(`it has ${triangles.length} triangles; this page takes ${MOST_TRIANGLES}`);
  if (positions.flat().some((x) => !Number.isFinite(x))) throw new Error("a vertex is not three numbers");
  const low = [0, 1, 2].map((k) => positions.reduce((least, p) => Math.min(least, p[k]), Infinity));
  const high = [0, 1, 2].map((k) => positions.reduce((most, p) => Math.max(most, p[k]), -Infinity));
  const scale = 2 / Math.max(...high.map((x, k) => x - low[k]), 1e-9);
  // OBJ files have y upwards, as a rule; here it is z.
  const turned = (/** @type {number[]} */ p) => [p[0], -p[2], p[1]];
  const placed = positions.map((p) => turned(p.map((x, k) => (x - (k === 1 ? low[k] : (low[k] + high[k]) / 2)) * scale))).map(([x, y, z]) => [x, y, z - 1]);
  return smooth(placed, directions.map(turned), triangles);
}

/**
 * @param {number[][]} positions
 * @param {number[][]} directions
 * @param {{at: number, normal: number}[][]} triangles
 * @returns {Mesh}
 */
function smooth(positions, directions, triangles) {
  const mean = positions.map(() => [0, 0, 0]);
  for (const triangle of triangles) {
    const [a, b, c] = triangle.map(({ at }) => positions[at]);
    const [u, v] = [b, c].map((p) => p.map((x, k) => x - a[k]));
    const area = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
    for (const { at } of triangle) area.forEach((x, k) => (mean[at][k] += x));
  }
  const unit = (/** @type {number[]} */ n) => {
    const length = Math.hypot(...n);
    return length > 0 ? n.map((x) => x / length) : [0, 0, 1];
  };
  return {
    corners: new Float32Array(triangles.flat().flatMap(({ at }) => positions[at])),
    normals: new Float32Array(triangles.flat().flatMap(({ at, normal }) => unit(directions[normal] ?? mean[at]))),
  };
}

/**
 * A sheet of cloth-like folds that lies on the ground.
 * @param {number} side squares along an edge
 * @returns {Mesh}
 */
export function foldedSheet(side = 96) {
  const height = (/** @type {number} */ x, /** @type {number} */ y) =>
    0.2 * Math.sin(2.6 * x + 0.8 * Math.sin(2.1 * y)) + 0.13 * Math.sin(2.1 * y + 0.4) + 0.05 * Math.cos(3.4 * y - 1.3 * x);
  const positions = [];
  for (let j = 0; j <= side; j++) {
    for (let i = 0; i <= side; i++) {
      const [x, y] = [3.2 * (i / side - 0.5), 2.6 * (j / side - 0.5)];
      positions.push([x, y, -0.62 + height(x, y) + 0.16 * y]);
    }
  }
  const triangles = [];
  for (let j = 0; j < side; j++) {
    for (let i = 0; i < side; i++) {
      const a = j * (side + 1) + i;
      for (const three of [[a, a + 1, a + side + 2], [a, a + side + 2, a + side + 1]]) triangles.push(three.map((at) => ({ at, normal: -1 })));
    }
  }
  return smooth(positions, [], triangles);
}

/**
 * The mesh as texels: nodes (low corner and what it holds, high corner and how many triangles), then triangles (a corner, two
 * edges, three normals).
 * @param {Mesh} mesh
 * @returns {{texels: Float32Array, triangleStart: number}}
 */
export function packMesh(mesh) {
  const count = mesh.corners.length / 9;
  const boxes = new Float32Array(6 * count);
  const middles = new Float32Array(3 * count);
  for (let i = 0; i < count; i++) {
    for (let k = 0; k < 3; k++) {
      const [a, b, c] = [0, 3, 6].map((corner) => mesh.corners[9 * i + corner + k]);
      boxes[6 * i + k] = Math.min(a, b, c);
      boxes[6 * i + 3 + k] = Math.max(a, b, c);
      middles[3 * i + k] = (a + b + c) / 3;
    }
  }
  const order = Uint32Array.from({ length: count }, (_, i) => i);
  /** @type {number[][]} */
  const nodes = [];
  const build = (/** @type {number} */ from, /** @type {number} */ to) => {
    const low = [Infinity, Infinity, Infinity];
    const high = [-Infinity, -Infinity, -Infinity];
    const least = [...low];
    const most = [...high];
    for (let i = from; i < to; i++) {
      for (let k = 0; k < 3; k++) {
        low[k] = Math.min(low[k], boxes[6 * order[i] + k]);
        high[k] = Math.max(high[k], boxes[6 * order[i] + 3 + k]);
        least[k] = Math.min(least[k], middles[3 * order[i] + k]);
        most[k] = Math.max(most[k], middles[3 * order[i] + k]);
      }
    }
    const node = [...low, from, ...high, to - from];
    nodes.push(node);
    const extent = most.map((x, k) => x - least[k]);
    const axis = extent.indexOf(Math.max(...extent));
    if (to - from <= 4 || extent[axis] <= 0) return;
    // Halves of as many triangles: at most log₂ of their number deep.
    order.subarray(from, to).sort((a, b) => middles[3 * a + axis] - middles[3 * b + axis]);
    const middle = (from + to) >> 1;
    node[7] = 0;
    build(from, middle);
    node[3] = nodes.length * 4 + axis;
    build(middle, to);
  };
  build(0, count);
  const triangleStart = 2 * nodes.length;
  const texels = new Float32Array(4 * Math.ceil((triangleStart + 6 * count) / PACKED_WIDTH) * PACKED_WIDTH);
  nodes.forEach((node, i) => texels.set(node, 8 * i));
  order.forEach((triangle, i) => {
    const corner = (/** @type {number} */ which) => mesh.corners.subarray(9 * triangle + 3 * which, 9 * triangle + 3 * which + 3);
    const edge = (/** @type {number} */ which) => corner(which).map((x, k) => x - corner(0)[k]);
    const parts = [corner(0), edge(1), edge(2), ...[0, 1, 2].map((which) => mesh.normals.subarray(9 * triangle + 3 * which, 9 * triangle + 3 * which + 3))];
    parts.forEach((part, k) => texels.set(part, 4 * (triangleStart + 6 * i + k)));
  });
  return { texels, triangleStart };
}
