/**
 * The pearl "@name@" as a material for three.js (WebGLRenderer), exported by nacre: its whole table, evaluated in single
 * precision for every light.
 *
 *     import { pearlMaterial } from "./pearl.js";
 *     const material = await pearlMaterial({ depth: 0.7 });
 *     scene.add(new THREE.Mesh(new THREE.SphereGeometry(1, 128, 64), material));
 *
 * It is a MeshStandardMaterial whose light is the pearl's: shadows, normal and bump maps, fog, tone mapping and the rest are
 * three's. Point, spot and directional lights are exact. `scene.environment` (or `envMap`) and RectAreaLight are sums over
 * `material.samples` directions or points. Ambient light is exact for light from everywhere; hemisphere lights and light
 * probes are taken as the irradiance at the normal, from everywhere.
 */
import * as THREE from "three";
import { readNpz } from "nacre/npz.js";
import { PACKED_WIDTH, makeTable, pack } from "nacre/table.js";
import { ALL_SHOWN, paint } from "nacre/look.js";
import { NUMERICS } from "nacre/glsl/numerics.js";
import { PEARL } from "nacre/glsl/pearl.js";

/** Directions to the surroundings, and points of a rectangular light. */
const SAMPLES = 128;
/** Roughness² of three's prefiltered maps over the radius of what a direction stands for. */
const BLUR = "0.5";

const LIGHTS = `
Viewed pearlView;
vec3 pearlX, pearlY, pearlZ;
bool pearlSeen;

vec3 pearlLocal(vec3 d) { return vec3(dot(d, pearlX), dot(d, pearlY), dot(d, pearlZ)); }

void pearlStart(vec3 n, vec3 view) {
  pearlZ = n;
  pearlX = normalize(abs(n.x) > 0.5 ? vec3(-n.z, 0.0, n.x) : vec3(0.0, n.z, -n.y));
  pearlY = cross(n, pearlX);
  vec3 wi = pearlLocal(view);
  pearlSeen = wi.z > 0.0;
  pearlView = viewedFrom(pearlSeen ? normalize(wi) : vec3(0.0, 0.0, 1.0));
}

// f·cos θ of light from a direction.
vec3 pearlFrom(vec3 d) {
  vec3 wo = pearlLocal(d);
  return pearlSeen && wo.z > 0.0 ? shownOf(evaluate(pearlView, normalize(wo))) : vec3(0.0);
}

// Roberts' sequence: multiples of inverse powers of the root of x³ = x + 1, in units of 2⁻³².
vec2 pearlPoint(int k) { return vec2((2147483648u + uvec2(3242174889u, 2447445414u) * uint(k)) >> 8u) * 5.9604645e-8; }

void RE_Direct_Pearl(const in IncidentLight light, const in vec3 position, const in vec3 n, const in vec3 view,
    const in vec3 coat, const in PhysicalMaterial material, inout ReflectedLight reflected) {
  reflected.directDiffuse += light.color * pearlFrom(light.direction);
}

#if NUM_RECT_AREA_LIGHTS > 0
void RE_Direct_RectArea_Pearl(const in RectAreaLight light, const in vec3 position, const in vec3 n, const in vec3 view,
    const in vec3 coat, const in PhysicalMaterial material, inout ReflectedLight reflected) {
  vec3 across = cross(light.halfHeight, light.halfWidth), sum = vec3(0.0);
  // It shines to one side.
  if (dot(across, position - light.position) <= 0.0) return;
  for (int k = 0; k < PEARL_SAMPLES; k++) {
    vec2 at = 2.0 * pearlPoint(k) - 1.0;
    vec3 to = light.position + at.x * light.halfWidth + at.y * light.halfHeight - position;
    float far2 = dot(to, to);
    sum += pearlFrom(to * inversesqrt(far2)) * abs(dot(to, across)) / (far2 * sqrt(far2));
  }
  reflected.directDiffuse += light.color * sum * (4.0 / float(PEARL_SAMPLES));
}
#endif

void RE_IndirectDiffuse_Pearl(const in vec3 irradiance, const in vec3 position, const in vec3 n, const in vec3 view,
    const in vec3 coat, const in PhysicalMaterial material, inout ReflectedLight reflected) {
  if (!pearlSeen) return;
  vec3 albedo = vec3(0.0), light = vec3(0.0);
#ifndef USE_ENVMAP
  if (irradiance == vec3(0.0)) return;
#endif
  for (int k = 0; k < PEARL_SAMPLES; k++) {
    // Each part of the pearl has directions one after another, which are as even as all of them.
    vec2 at = pearlPoint(k);
    vec3 wo = sampleExit(pearlView, (float(k) + 0.5) / float(PEARL_SAMPLES), at.x, at.y);
    if (wo.z <= 0.0) continue;
    wo = normalize(wo);
    Value value = evaluate(pearlView, wo);
    if (value.pdf <= 0.0) continue;
    vec3 weight = shownOf(value) / (value.pdf * float(PEARL_SAMPLES));
    albedo += weight;
#ifdef USE_ENVMAP
    // Blurred over the solid angle that the direction stands for (Křivánek and Colbert 2008).
    float radius = inversesqrt(PI * value.pdf * float(PEARL_SAMPLES));
    vec3 d = wo.x * pearlX + wo.y * pearlY + wo.z * pearlZ;
    light += weight * getIBLRadiance(d, d, min(sqrt(PEARL_BLUR * radius), 1.0));
#endif
  }
  reflected.indirectDiffuse += irradiance * RECIPROCAL_PI * albedo + light;
}

void RE_IndirectSpecular_Pearl(const in vec3 radiance, const in vec3 irradiance, const in vec3 coatRadiance, const in vec3 position,
    const in vec3 n, const in vec3 view, const in vec3 coat, const in PhysicalMaterial material, inout ReflectedLight reflected) {}

#undef RE_Direct
#undef RE_Direct_RectArea
#undef RE_IndirectDiffuse
#undef RE_IndirectSpecular
#define RE_Direct RE_Direct_Pearl
#define RE_Direct_RectArea RE_Direct_RectArea_Pearl
#define RE_IndirectDiffuse RE_IndirectDiffuse_Pearl
#define RE_IndirectSpecular RE_IndirectSpecular_Pearl
`;

const START = `
pearlStart(normal, isOrthographic ? vec3(0.0, 0.0, 1.0) : normalize(vViewPosition));
`;

/** @type {Promise<import("nacre/table.js").Table> | undefined} */
let table;

/**
 * The pearl's material.
 * @param {Partial<import("nacre/table.js").Look>} [look] what of the recipe's look is changed: depth, brightness, coherence,
 *   body_rgb, tint_rgb (linear sRGB), thickness
 */
export async function pearlMaterial(look = {}) {
  table ??= readNpz(Uint8Array.from(atob(DATA), (c) => c.charCodeAt(0))).then(makeTable);
  return new PearlMaterial(await table, look);
}

class PearlMaterial extends THREE.MeshStandardMaterial {
  constructor(table, look) {
    super({ roughness: 1, metalness: 0 });
    this.table = table;
    this.samples = SAMPLES;
    this.uniforms = {};
    table.textures ??= texturesOf(table);
    const { slope_sd, index_ratio } = table.arrays;
    const { offsets, records, pairs } = table.textures;
    this.put({
      uRecords: records, uPairs: pairs,
      uRecordStart: [offsets.spans, offsets.widths, offsets.along, offsets.cells],
      uPairStart: [offsets.rowCumulative, offsets.rowTotal, offsets.total, 0],
      uGrid: [table.incidences, table.rows, table.columns, table.spans],
      uSteps: table.steps, uNodes: table.nodes, uAxis: [table.cellWidth, table.capRadius],
      uFacets: [...slope_sd.data].flatMap((sigma, band) => [sigma, index_ratio.data[band]]),
      uShown: [1, 1, 1, 1],
    });
    this.setLook(look);
  }

  /**
   * Changes the look; what is not named stays.
   * @param {Partial<import("nacre/table.js").Look>} changes
   */
  setLook(changes) {
    const { table } = this;
    const unknown = Object.keys(changes).find((name) => !(name in table.look));
    if (unknown) throw new Error(`look: ${unknown} is not known; expected one of ${Object.keys(table.look).join(", ")}`);
    this.look = { ...(this.look ?? table.look), ...changes };
    const { curves, base, body } = paint(table, this.look, ALL_SHOWN);
    if (this.uniforms.uCurves) this.uniforms.uCurves.value.dispose();
    this.put({
      uCurves: textureOf(curves, 4, table.nodes),
      uBase: [...base], uBody: body, uDepth: this.look.depth,
    });
  }

  put(values) {
    for (const [name, value] of Object.entries(values)) {
      if (this.uniforms[name]) this.uniforms[name].value = value;
      else this.uniforms[name] = { value };
    }
  }

  onBeforeCompile(shader) {
    const { space, reciprocal, visible, bands } = this.table;
    const macros = { SPACE: Number(space), RECIPROCAL: Number(reciprocal), VISIBLE: Number(visible), BANDS: bands, PEARL_SAMPLES: this.samples, PEARL_BLUR: BLUR };
    const defines = Object.entries(macros).map(([name, value]) => `#define ${name} ${value}\n`).join("");
    Object.assign(shader.uniforms, this.uniforms);
    const after = (place, text) => {
      if (!shader.fragmentShader.includes(place)) throw new Error(`this version of three.js (${THREE.REVISION}) has no ${place}`);
      shader.fragmentShader = shader.fragmentShader.replace(place, () => `${place}\n${text}`);
    };
    // π is a macro of three's, and a constant of the pearl's.
    after("#include <lights_physical_pars_fragment>", `#undef PI\n${defines}${NUMERICS}${PEARL}${LIGHTS}`);
    after("#include <lights_physical_fragment>", START);
  }

  customProgramCacheKey() {
    const { space, reciprocal, visible, bands } = this.table;
    return `pearl ${[space, reciprocal, visible, bands, this.samples]}`;
  }

  copy(source) {
    super.copy(source);
    this.samples = source.samples;
    this.setLook(source.look);
    return this;
  }

  clone() {
    return new PearlMaterial(this.table, this.look).copy(this);
  }

  dispose() {
    this.uniforms.uCurves.value.dispose();
    super.dispose();
  }
}

function texturesOf(table) {
  const { records, pairs, offsets } = pack(table);
  return { offsets, records: textureOf(records, 4, PACKED_WIDTH), pairs: textureOf(pairs, 2, PACKED_WIDTH) };
}

/** A texture of single precision that is read texel by texel. */
function textureOf(data, channels, width) {
  const format = channels === 4 ? THREE.RGBAFormat : THREE.RGFormat;
  const texture = new THREE.DataTexture(data, width, data.length / channels / width, format, THREE.FloatType);
  texture.needsUpdate = true;
  return texture;
}
