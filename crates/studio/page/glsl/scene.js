/**
 * Shapes and lights in GLSL. The shapes and lights of the comparison harness (tools/compare/scenes.py) are here exactly.
 *
 * Macros: SHAPE (0 spheres, 1 the harness's sheet, 2 a mesh), SKY (0 none, 1 the harness's, 2 a gradient, 3 a map).
 */
/** What all programs of a path know. */
export const COMMON = `
const int NOTHING = 0, PEARL = 1, FLOOR = 2, LAMP = 3;

// Two directions across a unit vector.
void frameOf(vec3 n, out vec3 u, out vec3 v) {
  // Duff et al., Building an orthonormal basis, revisited.
  float s = n.z >= 0.0 ? 1.0 : -1.0, a = -1.0 / (s + n.z), b = n.x * n.y * a;
  u = vec3(1.0 + s * n.x * n.x * a, s * b, -s * n.x);
  v = vec3(b, s + n.y * n.y * a, -n.y);
}
`;

export const SCENE = `
const int MOST_SPHERES = 32;
const int MOST_RECTANGLES = 8;
const float FAR = 1e30;

uniform vec4 uSpheres[MOST_SPHERES];
uniform int uSphereCount;
uniform highp sampler2D uMesh;        // nodes, then triangles
uniform int uTriangleStart;
uniform bool uFloor;                  // a cyclorama: ground, curve and wall
uniform bool uOccluding;              // whether shapes cast shadows and reflect each other
uniform float uGrain;

uniform int uRectangleCount;
uniform vec3 uCorner[MOST_RECTANGLES], uEdgeU[MOST_RECTANGLES], uEdgeV[MOST_RECTANGLES];
uniform vec4 uRadiance[MOST_RECTANGLES];  // and whether the camera sees it
uniform float uPick[MOST_RECTANGLES];     // chance to sample it
uniform vec4 uPoint;                      // position and intensity
uniform float uPointPick, uSkyPick;
uniform vec3 uZenith, uHorizon;
uniform bool uSkySeen;                    // by the camera
uniform highp sampler2D uMap;             // radiance, and the integral along a row
uniform highp sampler2D uMapRows;         // integral over the rows
uniform vec2 uMapTurn;                    // cos and sin of its turn about the vertical

struct Hit { int kind; float t; vec3 normal, outside; vec3 radiance; int light; };

// ---- Shapes -----------------------------------------------------------------------------------------------------------------

float noise(vec3 p) {
  vec3 i = floor(p), f = p - i;
  f = f * f * (3.0 - 2.0 * f);
  float sum = 0.0;
  int k = 0;
  do {
    ivec3 corner = ivec3(k & 1, (k >> 1) & 1, k >> 2), c = ivec3(i) + corner;
    vec3 near = mix(1.0 - f, f, vec3(corner));
    sum += near.x * near.y * near.z * float(hashed(uint(c.x) ^ hashed(uint(c.y) ^ hashed(uint(c.z)))) >> 8u) * 5.96e-8;
  } while (++k < 8);
  return sum;
}

// Grain: a bump of the surface, from the size of a pore to that of a dimple.
vec3 grained(vec3 n, vec3 p) {
  if (uGrain <= 0.0) return n;
  vec3 slope = vec3(0.0);
  float at = 0.0, e = 0.02;
  int k = 0;
  do {
    // Two octaves, each there and along three axes.
    vec3 axis = vec3(equal(ivec3(k & 3), ivec3(1, 2, 3)));
    float height = noise(p * (k < 4 ? 9.0 : 38.0) + e * axis);
    if ((k & 3) == 0) at = height;
    slope += axis * ((height - at) / e * (k < 4 ? 0.10 : 0.06));
  } while (++k < 8);
  slope -= n * dot(n, slope);
  return normalize(n - uGrain * slope);
}

#if SHAPE == 1
vec3 sheetNormal(vec3 p) {
  float foldX = 0.57 * cos(2.6 * p.x + 0.8 * sin(2.1 * p.y)) - 0.16 * sin(3.4 * p.y - 1.3 * p.x);
  float foldY = 0.4 * cos(2.1 * p.y) - 0.4 * sin(3.4 * p.y - 1.3 * p.x);
  float bumpX = 0.06 * sin(61.0 * p.x + 3.0 * sin(17.0 * p.y));
  float bumpY = 0.06 * cos(53.0 * p.y + 3.0 * sin(19.0 * p.x));
  return normalize(vec3(-foldX - bumpX, -0.5 - foldY - bumpY, 1.0));
}
#endif

#if SHAPE == 2
vec4 meshAt(int i) { return texelFetch(uMesh, ivec2(i & 2047, i >> 11), 0); }

void meetMesh(vec3 o, vec3 d, bool any, inout Hit hit) {
  vec3 inverse = 1.0 / d;
  int stack[32];
  int depth = 0, node = 0;
  for (int n = 0; n < 4096; n++) {
    vec4 low = meshAt(2 * node), high = meshAt(2 * node + 1);
    vec3 a = (low.xyz - o) * inverse, b = (high.xyz - o) * inverse;
    vec3 enter = min(a, b), leave = max(a, b);
    float near = max(max(enter.x, enter.y), max(enter.z, 0.0)), far = min(min(leave.x, leave.y), min(leave.z, hit.t));
    if (near <= far) {
      int count = int(high.w), first = int(low.w);
      if (count == 0) {
        // The child on the near side first.
        int axis = first & 3, left = node + 1, right = first >> 2;
        bool back = d[axis] < 0.0;
        stack[depth++] = back ? left : right;
        node = back ? right : left;
        continue;
      }
      for (int k = 0; k < count; k++) {
        int at = uTriangleStart + 6 * (first + k);
        vec3 corner = meshAt(at).xyz, u = meshAt(at + 1).xyz, v = meshAt(at + 2).xyz;
        vec3 p = cross(d, v);
        float determinant = dot(u, p);
        if (abs(determinant) < 1e-14) continue;
        vec3 s = o - corner, q = cross(s, u);
        float x = dot(s, p) / determinant, y = dot(d, q) / determinant, t = dot(v, q) / determinant;
        if (x < 0.0 || y < 0.0 || x + y > 1.0 || t < 1e-4 || t >= hit.t) continue;
        hit.kind = PEARL;
        hit.t = t;
        if (any) return;
        vec3 outside = normalize(cross(u, v));
        vec3 normal = normalize((1.0 - x - y) * meshAt(at + 3).xyz + x * meshAt(at + 4).xyz + y * meshAt(at + 5).xyz);
        if (dot(outside, d) > 0.0) { outside = -outside; normal = -normal; }
        hit.outside = outside;
        hit.normal = normal;
      }
    }
    if (depth == 0) return;
    node = stack[--depth];
  }
}
#endif

// The cyclorama: ground z = −1 to y = 3, a quarter of a cylinder of radius 3, a wall at y = 6.
void meetFloor(vec3 o, vec3 d, inout Hit hit) {
  float t = (-1.0 - o.z) / d.z;
  if (d.z < 0.0 && t > 1e-4 && t < hit.t && o.y + t * d.y < 3.0) {
    hit = Hit(FLOOR, t, vec3(0, 0, 1), vec3(0, 0, 1), vec3(0.0), -1);
    return;
  }
  vec2 c = vec2(o.y - 3.0, o.z - 2.0);
  float a = dot(d.yz, d.yz), b = dot(c, d.yz), e = b * b - a * (dot(c, c) - 9.0);
  if (e > 0.0) {
    t = (-b + sqrt(e)) / a;
    vec2 at = c + t * d.yz;
    if (t > 1e-3 && t < hit.t && at.x > 0.0 && at.y < 0.0) {
      vec3 n = vec3(0.0, -at / 3.0);
      hit = Hit(FLOOR, t, n, n, vec3(0.0), -1);
      return;
    }
  }
  t = (6.0 - o.y) / d.y;
  if (d.y > 0.0 && t > 1e-3 && t < hit.t && o.z + t * d.z >= 2.0) hit = Hit(FLOOR, t, vec3(0, -1, 0), vec3(0, -1, 0), vec3(0.0), -1);
}

const int NO_LAMPS = 0, SEEN_LAMPS = 1, ALL_LAMPS = 2;

// What a ray meets first, before \`far\`: all lamps, those that the camera sees, or none.
Hit meet(vec3 o, vec3 d, float far, bool shapes, int lamps) {
  Hit hit = Hit(NOTHING, far, vec3(0.0), vec3(0.0), vec3(0.0), -1);
  if (shapes) {
#if SHAPE == 0
    int k = 0;
    do {
      vec3 c = o - uSpheres[k].xyz;
      float r = uSpheres[k].w, b = dot(c, d);
      // From what is left across the ray: nothing cancels.
      vec3 across = c - b * d;
      float e = r * r - dot(across, across);
      if (e <= 0.0) continue;
      float t = -b - sqrt(e);
      if (t > 1e-3 && t < hit.t) {
        vec3 n = normalize(c + t * d);
        hit = Hit(PEARL, t, n, n, vec3(0.0), k);
      }
    } while (++k < uSphereCount);
#elif SHAPE == 1
    vec3 plane = normalize(vec3(0.0, -0.5, 1.0));
    float t = -dot(o, plane) / dot(d, plane);
    vec3 p = o + t * d;
    if (t > 1e-3 && t < hit.t && abs(p.x) < 1.0 && abs(p.y) < 1.0) hit = Hit(PEARL, t, sheetNormal(p), plane, vec3(0.0), -1);
#else
    meetMesh(o, d, lamps == NO_LAMPS, hit);
#endif
    if (uFloor) meetFloor(o, d, hit);
  }
  if (lamps == NO_LAMPS) return hit;
  for (int k = 0; k < MOST_RECTANGLES; k++) {
    if (k >= uRectangleCount) break;
    if (lamps == SEEN_LAMPS && uRadiance[k].a <= 0.0) continue;
    vec3 n = cross(uEdgeU[k], uEdgeV[k]), from = uCorner[k] - o;
    float facing = dot(d, n);
    float t = dot(from, n) / (abs(facing) > 1e-6 ? facing : 1.0);
    vec3 p = t * d - from;
    float x = dot(p, uEdgeU[k]) / dot(uEdgeU[k], uEdgeU[k]), y = dot(p, uEdgeV[k]) / dot(uEdgeV[k], uEdgeV[k]);
    if (abs(facing) > 1e-6 && t > 1e-4 && t < hit.t && x >= 0.0 && x <= 1.0 && y >= 0.0 && y <= 1.0) {
      hit = Hit(LAMP, t, n, n, uRadiance[k].rgb, k);
    }
  }
  return hit;
}

// ---- Lights -----------------------------------------------------------------------------------------------------------------

#if SKY == 1
const vec3 LAMP_A = normalize(vec3(-1.0, -1.0, 1.0));
const vec3 LAMP_B = normalize(vec3(1.5, -0.5, 0.6));

vec3 sky(vec3 d) { return vec3(0.35 + 0.25 * d.z + 5.0 * exp(30.0 * (dot(d, LAMP_A) - 1.0)) + 2.0 * exp(60.0 * (dot(d, LAMP_B) - 1.0))); }

// Density of a lobe e^{κ(cos − 1)} on the sphere.
float lampDensity(vec3 d, vec3 axis, float k) { return k / (2.0 * PI * (1.0 - exp(-2.0 * k))) * exp(k * (dot(d, axis) - 1.0)); }

float skyDensity(vec3 d) { return 0.6 * lampDensity(d, LAMP_A, 30.0) + 0.4 * lampDensity(d, LAMP_B, 60.0); }

vec3 sampleSky(float u, float v) {
  bool first = u < 0.6;
  u = first ? u / 0.6 : (u - 0.6) / 0.4;
  float k = first ? 30.0 : 60.0, c = 1.0 + log(1.0 - u * (1.0 - exp(-2.0 * k))) / k;
  vec3 axis = first ? LAMP_A : LAMP_B, x, y;
  frameOf(axis, x, y);
  vec2 phi = turned(2.0 * PI * v);
  return normalize(c * axis + root(1.0 - c * c) * (phi.x * x + phi.y * y));
}
#elif SKY == 3
ivec2 mapAt(vec3 d) {
  vec2 e = vec2(uMapTurn.x * d.x + uMapTurn.y * d.y, -uMapTurn.y * d.x + uMapTurn.x * d.y);
  ivec2 size = textureSize(uMap, 0);
  vec2 share = vec2(atan(e.y, e.x) / (2.0 * PI) + 0.5, acos(clamp(d.z, -1.0, 1.0)) / PI);
  return min(ivec2(share * vec2(size)), size - 1);
}

vec3 sky(vec3 d) { return texelFetch(uMap, mapAt(d), 0).rgb; }

float skyDensity(vec3 d) {
  ivec2 size = textureSize(uMap, 0), at = mapAt(d);
  float row = texelFetch(uMapRows, ivec2(at.y, 0), 0).r - (at.y > 0 ? texelFetch(uMapRows, ivec2(at.y - 1, 0), 0).r : 0.0);
  float cell = texelFetch(uMap, at, 0).a - (at.x > 0 ? texelFetch(uMap, at - ivec2(1, 0), 0).a : 0.0);
  return row * cell * float(size.x * size.y) / (2.0 * PI * PI * max(sqrt(1.0 - d.z * d.z), 1e-4));
}

float mapIntegral(bool rows, int x, int y) { return rows ? texelFetch(uMapRows, ivec2(x, 0), 0).r : texelFetch(uMap, ivec2(x, y), 0).a; }

// The first entry of a row of integrals above u, and how far u is through it.
vec2 invert(bool rows, int y, int count, float u) {
  int low = 0, high = count - 1;
  for (int n = 0; n < 14 && low < high; n++) {
    int middle = (low + high) >> 1;
    if (mapIntegral(rows, middle, y) > u) high = middle; else low = middle + 1;
  }
  float above = mapIntegral(rows, low, y), below = low == 0 ? 0.0 : mapIntegral(rows, low - 1, y);
  return vec2(float(low), clamp((u - below) / max(above - below, TINY), 0.0, BELOW_ONE));
}

vec3 sampleSky(float u, float v) {
  ivec2 size = textureSize(uMap, 0);
  vec2 row = invert(true, 0, size.y, v), cell = invert(false, int(row.x), size.x, u);
  vec2 e = turned(2.0 * PI * (cell.x + cell.y) / float(size.x) - PI), polar = turned(PI * (row.x + row.y) / float(size.y));
  return vec3(polar.y * vec2(uMapTurn.x * e.x - uMapTurn.y * e.y, uMapTurn.y * e.x + uMapTurn.x * e.y), polar.x);
}
#else
vec3 sky(vec3 d) { return SKY == 2 ? mix(uHorizon, uZenith, smoothstep(-0.1, 1.0, d.z)) : vec3(0.0); }
float skyDensity(vec3 d) { return 0.0; }
vec3 sampleSky(float u, float v) { return vec3(0, 0, 1); }
#endif

struct Lit { vec3 d; float far; vec3 radiance; float pdf; bool point; };

// A direction to a light from three uniform numbers, its radiance, and its density (of a point light: 1, with its radiance over
// the distance squared).
Lit sampleLight(vec3 p, float pick, float u, float v) {
  if (pick < uSkyPick) {
    vec3 d = sampleSky(u, v);
    return Lit(d, FAR, sky(d), uSkyPick * skyDensity(d), false);
  }
  pick -= uSkyPick;
  if (pick < uPointPick) {
    vec3 to = uPoint.xyz - p;
    float far = length(to);
    return Lit(to / far, far, vec3(uPoint.w / (far * far)) / uPointPick, 1.0, true);
  }
  pick -= uPointPick;
  for (int k = 0; k < MOST_RECTANGLES; k++) {
    if (k >= uRectangleCount) break;
    if (pick < uPick[k]) {
      vec3 to = uCorner[k] + u * uEdgeU[k] + v * uEdgeV[k] - p;
      float far = length(to);
      float facing = abs(dot(to / far, cross(uEdgeU[k], uEdgeV[k])));
      return Lit(to / far, far * (1.0 - 1e-4), uRadiance[k].rgb, uPick[k] * far * far / max(facing, 1e-9), false);
    }
    pick -= uPick[k];
  }
  return Lit(vec3(0, 0, 1), 0.0, vec3(0.0), 0.0, false);
}

// Density with which \`sampleLight\` finds what a ray met.
float lightDensity(vec3 d, Hit hit) {
  if (hit.kind == LAMP) return uPick[hit.light] * hit.t * hit.t / max(abs(dot(d, hit.normal)), 1e-9);
  return uSkyPick > 0.0 ? uSkyPick * skyDensity(d) : 0.0;
}
`;
