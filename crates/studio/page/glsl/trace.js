/**
 * The path tracer, in small programs that hand paths on through textures: meet (rays), sample (lights and exits), weigh (both
 * against each other, by the balance heuristic), add (to a film, whose alpha counts samples). One large program takes some
 * drivers minutes to compile.
 *
 * A path's place in the textures: paths of one pixel lie side by side, `uLanes` of them; pixels follow row by row from
 * `uFirst` on.
 */
import { NUMERICS, RANDOM } from "nacre/glsl/numerics.js";
import { PEARL } from "nacre/glsl/pearl.js";
import { COMMON, SCENE } from "nacre/glsl/scene.js";

/** Paths in a row of the textures. */
export const PATHS_WIDTH = 1024;

const PATHS = `
uniform ivec2 uFirst;                // pixel of the first path
uniform ivec2 uPicture;              // width and height
uniform int uLanes;                  // paths of a pixel
uniform uint uSeed;
uniform int uVertex;                 // its number on the path
uniform sampler2D uFilm;

ivec2 path() { return ivec2(gl_FragCoord.xy); }
ivec2 pixelOf(ivec2 at) {
  int index = (at.y * ${PATHS_WIDTH} + at.x) / uLanes;
  return uFirst + ivec2(index % uPicture.x, index / uPicture.x);
}
Random randomAt(ivec2 at, ivec2 pixel, int dimension) {
  int lane = (at.y * ${PATHS_WIDTH} + at.x) % uLanes;
  Random random = randomOf(uvec2(pixel), uint(texelFetch(uFilm, pixel, 0).a) + uint(lane), uSeed);
  random.dimension = uint(dimension);
  return random;
}
`;

/** Rays to what they meet: light that a path finds, and its next vertex. */
export const MEET = `${NUMERICS}${RANDOM}${COMMON}${SCENE}${PATHS}
uniform vec3 uEye, uForward, uRight, uUp;
uniform bool uLast;                  // beyond the last vertex a path finds light alone
uniform float uMost;                 // light of a path beyond its first vertex
uniform sampler2D uAt, uFound;       // where paths are, and light that they found
uniform sampler2D uAhead, uThroughput, uShadowLight, uShadow;
layout(location = 0) out vec4 oAt;      // position, and what it is
layout(location = 1) out vec4 oNormal;
layout(location = 2) out vec4 oCame;    // direction in which it was reached
layout(location = 3) out vec4 oFound;

void main() {
  ivec2 at = path(), pixel = pixelOf(at);
  oAt = vec4(0.0); oNormal = vec4(0.0); oCame = vec4(0.0); oFound = vec4(0.0);
  if (pixel.y >= uPicture.y) return;
  vec3 o, d, throughput = vec3(1.0), found = vec3(0.0);
  float pdf = 0.0;
  bool alive = true;
  if (uVertex == 0) {
    Random random = randomAt(at, pixel, 0);
    float x = next(random), y = next(random);
    vec2 p = 2.0 * (vec2(pixel) + vec2(x, y)) / vec2(uPicture) - 1.0;
    o = uEye;
    d = normalize(uForward + p.x * uRight + p.y * uUp);
  } else {
    vec4 ahead = texelFetch(uAhead, at, 0), carried = texelFetch(uThroughput, at, 0), shadow = texelFetch(uShadow, at, 0);
    o = texelFetch(uAt, at, 0).xyz;
    found = texelFetch(uFound, at, 0).rgb;
    vec3 light = texelFetch(uShadowLight, at, 0).rgb;
    if (light.r + light.g + light.b > 0.0 && (!uOccluding || meet(o, shadow.xyz, shadow.w, true, NO_LAMPS).kind == NOTHING)) {
      found += uVertex > 1 ? min(light, vec3(uMost)) : light;
    }
    d = ahead.xyz;
    pdf = ahead.w;
    throughput = carried.rgb;
    alive = carried.a > 0.0;
  }
  if (alive) {
    Hit hit = meet(o, d, FAR, uVertex == 0 || uOccluding, uVertex == 0 ? SEEN_LAMPS : ALL_LAMPS);
    if (hit.kind == NOTHING || hit.kind == LAMP) {
      vec3 light = hit.kind == LAMP ? hit.radiance : sky(d);
      if (uVertex == 0) {
        if (hit.kind == LAMP || uSkySeen) found += light;
      } else {
        light *= throughput * (pdf / (pdf + lightDensity(d, hit)));
        found += uVertex > 1 ? min(light, vec3(uMost)) : light;
      }
    } else if (!uLast) {
      vec3 p = o + hit.t * d, n = hit.normal;
      if (hit.kind == PEARL) n = grained(n, p);
#if SHAPE != 1
      if (dot(n, d) > -1e-3) n = hit.normal;
      if (dot(n, d) > -1e-3) n = hit.outside;
#endif
      if (dot(n, d) < 0.0) {
        oAt = vec4(p + 1e-4 * hit.outside, float(hit.kind));
        oNormal = vec4(n, 0.0);
        oCame = vec4(d, 0.0);
      }
    }
  }
  oFound = vec4(found, 1.0);
}`;

const VERTEX = `
uniform sampler2D uAt, uNormal, uCame;
uniform vec3 uFloorAlbedo;
`;

/** A direction to a light, and an exit direction. */
export const SAMPLE = `${NUMERICS}${RANDOM}${COMMON}${PEARL}${SCENE}${PATHS}${VERTEX}
layout(location = 0) out vec4 oExit;     // in the frame of the surface; and whether there is one
layout(location = 1) out vec4 oShadow;   // direction to the light, and how far it is
layout(location = 2) out vec4 oLight;    // its radiance, and density (0: a point light)

void main() {
  ivec2 at = path(), pixel = pixelOf(at);
  oExit = vec4(0.0); oShadow = vec4(0.0); oLight = vec4(0.0);
  vec4 place = texelFetch(uAt, at, 0);
  int kind = int(place.w);
  if (kind == NOTHING) return;
  vec3 n = texelFetch(uNormal, at, 0).xyz, d = texelFetch(uCame, at, 0).xyz, x, y;
  Random random = randomAt(at, pixel, 2 + 6 * uVertex);
  float select = next(random), u = next(random), v = next(random);
  float pick = next(random), s = next(random), t = next(random);
  Lit lit = sampleLight(place.xyz, pick, s, t);
  if (lit.far > 0.0 && (lit.point || lit.pdf > 0.0)) {
    oShadow = vec4(lit.d, lit.far);
    oLight = vec4(lit.radiance, lit.point ? 0.0 : lit.pdf);
  }
  if (kind == PEARL) {
    frameOf(n, x, y);
    oExit.xyz = sampleExit(viewedFrom(normalize(vec3(-dot(d, x), -dot(d, y), -dot(d, n)))), select, u, v);
  } else {
    oExit.xyz = vec3(sqrt(u) * turned(2.0 * PI * v), root(1.0 - u));
  }
  oExit.w = float(oExit.z > 0.0);
}`;

/** The surface's answers to both. */
export const WEIGH = `${NUMERICS}${RANDOM}${COMMON}${PEARL}${PATHS}${VERTEX}
uniform sampler2D uExit, uShadow, uLight, uBefore;
layout(location = 0) out vec4 oAhead;          // the next ray, and its density
layout(location = 1) out vec4 oThroughput;     // and whether the path goes on
layout(location = 2) out vec4 oShadowLight;

void main() {
  ivec2 at = path(), pixel = pixelOf(at);
  oAhead = vec4(0.0); oThroughput = vec4(0.0); oShadowLight = vec4(0.0);
  int kind = int(texelFetch(uAt, at, 0).w);
  if (kind == NOTHING) return;
  vec3 n = texelFetch(uNormal, at, 0).xyz, d = texelFetch(uCame, at, 0).xyz, x, y;
  frameOf(n, x, y);
  vec3 throughput = uVertex == 0 ? vec3(1.0) : texelFetch(uBefore, at, 0).rgb;
  vec4 exit = texelFetch(uExit, at, 0), shadow = texelFetch(uShadow, at, 0), light = texelFetch(uLight, at, 0);
  Viewed viewed;
  if (kind == PEARL) viewed = viewedFrom(normalize(vec3(-dot(d, x), -dot(d, y), -dot(d, n))));
  int way = 0;
  do {
    vec3 wo = way == 0 ? vec3(dot(shadow.xyz, x), dot(shadow.xyz, y), dot(shadow.xyz, n)) : exit.xyz;
    if (wo.z <= 0.0 || (way == 0 && shadow.w <= 0.0)) continue;
    wo = normalize(wo);
    vec3 value = uFloorAlbedo * (wo.z / PI);
    float density = wo.z / PI;
    if (kind == PEARL) {
      Value all = evaluate(viewed, wo);
      value = shownOf(all);
      density = all.pdf;
    }
    if (way == 0) {
      // A number that is none must not stay in the film.
      vec3 found = throughput * value * light.rgb * (light.a > 0.0 ? 1.0 / (light.a + density) : 1.0);
      if (all(lessThan(found, vec3(1e30)))) oShadowLight = vec4(found, 1.0);
    } else if (density > 0.0) {
      vec3 next = throughput * value / density;
      if (all(lessThan(next, vec3(1e30)))) {
        oAhead = vec4(wo.x * x + wo.y * y + wo.z * n, density);
        oThroughput = vec4(next, 1.0);
      }
    }
  } while (++way < 2);
  float most = max(oThroughput.x, max(oThroughput.y, oThroughput.z));
  if (uVertex > 0 && most < 0.5 && most > 0.0) {
    // Russian roulette.
    Random random = randomAt(at, pixel, 100 + uVertex);
    float kept = max(2.0 * most, 0.05);
    oThroughput = next(random) < kept ? vec4(oThroughput.rgb / kept, 1.0) : vec4(0.0);
  }
  if (most <= 0.0) oThroughput = vec4(0.0);
}`;

/** All of it at once for a point light alone, which no sampled direction can hit: one sample a pixel, into the film. */
export const DIRECT = `${NUMERICS}${RANDOM}${COMMON}${PEARL}${SCENE}${PATHS}
uniform vec3 uEye, uForward, uRight, uUp;
layout(location = 0) out vec4 oFilm;

void main() {
  ivec2 pixel = path();
  vec4 film = texelFetch(uFilm, pixel, 0);
  Random random = randomOf(uvec2(pixel), uint(film.a), uSeed);
  float s = next(random), t = next(random);
  vec2 p = 2.0 * (vec2(pixel) + vec2(s, t)) / vec2(uPicture) - 1.0;
  vec3 d = normalize(uForward + p.x * uRight + p.y * uUp), x, y;
  oFilm = film + vec4(0.0, 0.0, 0.0, 1.0);
  Hit hit = meet(uEye, d, FAR, true, NO_LAMPS);
  if (hit.kind != PEARL) return;
  vec3 at = uEye + hit.t * d, n = grained(hit.normal, at), to = uPoint.xyz - at;
  float far2 = dot(to, to);
  to *= inversesqrt(far2);
  if (dot(n, d) >= 0.0 || dot(n, to) <= 0.0) return;
  frameOf(n, x, y);
  Value value = evaluate(viewedFrom(normalize(vec3(-dot(d, x), -dot(d, y), -dot(d, n)))), normalize(vec3(dot(to, x), dot(to, y), dot(to, n))));
  vec3 light = shownOf(value) * (uPoint.w / far2);
  if (all(lessThan(light, vec3(1e30)))) oFilm.rgb += light;
}`;

/** Paths to a film. */
export const ADD = `
uniform sampler2D uFilm, uFound;
uniform ivec2 uFirst, uPicture;
uniform int uLanes;
layout(location = 0) out vec4 oFilm;
void main() {
  ivec2 pixel = ivec2(gl_FragCoord.xy);
  int index = ((pixel.y - uFirst.y) * uPicture.x + pixel.x) * uLanes;
  vec3 sum = vec3(0.0);
  for (int lane = 0; lane < uLanes; lane++) {
    int i = index + lane;
    sum += texelFetch(uFound, ivec2(i % ${PATHS_WIDTH}, i / ${PATHS_WIDTH}), 0).rgb;
  }
  oFilm = texelFetch(uFilm, pixel, 0) + vec4(sum, float(uLanes));
}`;

/** Light up to which a film is shown as it is: brighter light nears white without a change of hue. */
const SHOULDER = "0.6";

/** What is shown of a film, pixel by pixel: its mean, exposed, in sRGB. */
export const SHOW = `
uniform sampler2D uFilm;
uniform float uExposure;
uniform vec3 uBackground;
layout(location = 0) out vec4 oColour;

void main() {
  vec4 film = texelFetch(uFilm, ivec2(gl_FragCoord.xy), 0);
  vec3 light = max((film.a > 0.0 ? film.rgb / film.a : uBackground) * uExposure, 0.0);
  float most = max(light.r, max(light.g, light.b));
  if (most > ${SHOULDER}) light *= (1.0 - (1.0 - ${SHOULDER}) * exp((${SHOULDER} - most) / (1.0 - ${SHOULDER}))) / most;
  vec3 colour = mix(12.92 * light, 1.055 * pow(light, vec3(1.0 / 2.4)) - 0.055, step(0.0031308, light));
  oColour = vec4(colour, 1.0);
}`;
