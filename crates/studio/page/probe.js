/**
 * Asks the shaders' pearl directly: values and densities of pairs of directions, and sampled exit directions. For plots and tests.
 *
 * @import {Pearl} from "nacre/pearl.js"
 */

import { Program, Target, texture } from "nacre/gl.js";
import { NUMERICS, RANDOM } from "nacre/glsl/numerics.js";
import { PEARL } from "nacre/glsl/pearl.js";

const EVALUATE = `${NUMERICS}${PEARL}
uniform sampler2D uWi, uWo;
layout(location = 0) out vec4 oDiffuse;
layout(location = 1) out vec4 oIncoherent;
layout(location = 2) out vec4 oMirror;
layout(location = 3) out vec4 oBlur;
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  Value v = evaluate(viewedFrom(texelFetch(uWi, at, 0).xyz), texelFetch(uWo, at, 0).xyz);
  oDiffuse = vec4(v.diffuse, v.pdf);
  oIncoherent = vec4(v.incoherent, 0.0);
  oMirror = vec4(v.mirror, 0.0);
  oBlur = vec4(v.blur, 0.0);
}`;

const SAMPLE = `${NUMERICS}${RANDOM}${PEARL}
uniform vec3 uView;
uniform uint uSeed;
layout(location = 0) out vec4 oExit;
layout(location = 1) out vec4 oValue;
void main() {
  Random random = randomOf(uvec2(gl_FragCoord.xy), 0u, uSeed);
  random.dimension = 8u;
  float select = next(random), u = next(random), v = next(random);
  Viewed viewed = viewedFrom(uView);
  vec3 wo = sampleExit(viewed, select, u, v);
  Value value = evaluate(viewed, wo.z > 0.0 ? normalize(wo) : vec3(0.0, 0.0, 1.0));
  oExit = vec4(wo, wo.z > 0.0 ? value.pdf : 0.0);
  oValue = vec4(shownOf(value), 0.0);
}`;

/**
 * Programs by what they are compiled for; a context that was lost has none.
 * @type {WeakMap<WebGL2RenderingContext, Map<string, Program>>}
 */
const programs = new WeakMap();

/** @param {WebGL2RenderingContext} gl */
export function forget(gl) {
  programs.delete(gl);
}

/**
 * @param {Pearl} pearl
 * @param {string} source
 */
function programOf(pearl, source) {
  const { gl, macros } = pearl;
  const known = programs.get(gl) ?? new Map();
  programs.set(gl, known);
  const key = JSON.stringify(macros) + source.length;
  const found = known.get(key) ?? new Program(gl, source, macros);
  known.set(key, found);
  return found;
}

/**
 * Components and densities of pairs of directions.
 * @param {Pearl} pearl
 * @param {ArrayLike<number>} wi three numbers a direction
 * @param {ArrayLike<number>} wo
 * @returns {Promise<{diffuse: number[][], incoherent: number[][], mirror: number[][], blur: number[][], pdf: number[]}>}
 */
export async function evaluate(pearl, wi, wo) {
  const { gl } = pearl;
  const count = wi.length / 3;
  const width = Math.min(count, 1024);
  const height = Math.ceil(count / width);
  const upload = (/** @type {ArrayLike<number>} */ w) => {
    const data = new Float32Array(4 * width * height);
    for (let i = 0; i < width * height; i++) for (let k = 0; k < 3; k++) data[4 * i + k] = w[3 * Math.min(i, count - 1) + k];
    return texture(gl, 4, width, height, data);
  };
  const asked = { uWi: upload(wi), uWo: upload(wo) };
  const target = new Target(gl, width, height, 4);
  target.clear();
  programOf(pearl, EVALUATE).draw(pearl.values, { ...pearl.textures, ...asked });
  const [diffuse, incoherent, mirror, blur] = await Promise.all([0, 1, 2, 3].map((which) => target.read(0, 0, width, height, which)));
  target.delete();
  for (const made of Object.values(asked)) gl.deleteTexture(made);
  const rows = (/** @type {Float32Array} */ data) => Array.from({ length: count }, (_, i) => [data[4 * i], data[4 * i + 1], data[4 * i + 2]]);
  return {
    diffuse: rows(diffuse), incoherent: rows(incoherent), mirror: rows(mirror), blur: rows(blur),
    pdf: Array.from({ length: count }, (_, i) => diffuse[4 * i + 3]),
  };
}

/**
 * Exit directions of one direction to the viewer.
 * @param {Pearl} pearl
 * @param {number[]} wi
 * @param {number} side as many as its square
 * @param {number} seed
 * @returns {Promise<{exits: Float32Array, values: Float32Array}>} (x, y, z, density), and (r, g, b, –), 4 numbers a sample
 */
export async function sample(pearl, wi, side, seed) {
  const target = new Target(pearl.gl, side, side, 2);
  target.clear();
  programOf(pearl, SAMPLE).draw({ ...pearl.values, uView: wi, uSeed: seed }, pearl.textures);
  const [exits, values] = await Promise.all([target.read(), target.read(0, 0, side, side, 1)]);
  target.delete();
  return { exits, values };
}
