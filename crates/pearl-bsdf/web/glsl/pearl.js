/**
 * The pearl in GLSL: evaluation, density and sampling over the prepared arrays (docs/ARRAYS.md §3 and §5), in the plugin's steps
 * (crates/python/nacre/mitsuba/lobes.py): grazing angles are carried as elevations, so that they keep their digits.
 *
 * Macros: SPACE, RECIPROCAL, VISIBLE (0 or 1), BANDS (a number).
 *
 * Loops that run at least once have their condition at the end: where it comes first, SwiftShader runs the body once more.
 */
export const PEARL = `
uniform highp sampler2D uRecords;  // spans, azimuth widths, span curves, cells
uniform highp sampler2D uPairs;    // cumulative and guide; totals
uniform highp sampler2D uCurves;   // what the controls make of the colours
uniform ivec4 uRecordStart;        // of spans, widths, span curves, cells
uniform ivec4 uPairStart;          // of rows' cumulative, rows' totals, totals; (none)
uniform ivec4 uGrid;               // incidences, rows, columns, spans
uniform int uSteps;                // of a span
uniform int uNodes;                // of a curve
uniform vec2 uAxis;                // cell width, cap radius
uniform vec2 uFacets[BANDS];       // slope_sd, index_ratio
uniform vec3 uBase[BANDS];         // share of the band over π(1 − A_avg)
uniform vec3 uBody;
uniform float uDepth;
uniform vec4 uShown;               // diffuse, incoherent, mirror, blur

const float POLE = 1e-7;
// Of cells and of span curves: pairs (interior, rehit) of each band, then what is sampled by the first; two in a texel.
const int TEXELS = BANDS / 2 + 1;
const int LAST = BANDS / 2;

vec4 record(int i) { return texelFetch(uRecords, ivec2(i & 2047, i >> 11), 0); }
vec2 pair(int i) { return texelFetch(uPairs, ivec2(i & 2047, i >> 11), 0).xy; }
vec2 sampledOf(vec4 last) { return BANDS % 2 == 1 ? last.zw : last.xy; }

// ---- Directions -------------------------------------------------------------------------------------------------------------

struct Polar {
  float c, s;        // cosine and sine of the angle to the normal
  float theta;
  float elevation;   // π/2 − θ, with its own digits
  vec2 plane;        // x and y, (1, 0) at the pole
  float inverse;     // 1/length of them
};

Polar polarOf(vec3 w) {
  float radius = length(w.xy);
  bool steep = w.z > 0.7;
  float s = steep ? min(radius, 1.0) : root(1.0 - w.z * w.z);
  float angle = arcSine(min(steep ? s : w.z, 1.0));
  bool pole = radius < 1e-18;
  return Polar(w.z, s, steep ? angle : HALF_PI - angle, steep ? HALF_PI - angle : angle,
               pole ? vec2(1.0, 0.0) : w.xy, pole ? 1.0 : 1.0 / radius);
}

struct Facing {
  float y2;       // sin²(φ/2), φ from the mirror direction of wi
  vec2 slopes2;   // squared slopes of the half vector along and across wi's azimuth
  float z, c;     // z of the half vector, cos θd
};

Facing facingOf(Polar i, Polar o) {
  float scale = i.inverse * o.inverse;
  float sinPhi = scale * (i.plane.x * o.plane.y - i.plane.y * o.plane.x);
  float cosPhi = -scale * dot(i.plane, o.plane);
  float y2 = cosPhi > 0.0 ? sinPhi * sinPhi / (2.0 * (1.0 + cosPhi)) : 0.5 * (1.0 - cosPhi);
  y2 = min(y2, 1.0);
  // sin θi − sin θo from whichever keeps its digits.
  float gap = min(i.c, o.c) > 0.7 ? i.s - o.s : (o.c - i.c) * (o.c + i.c) / max(i.s + o.s, 0.1);
  vec2 plane = vec2(2.0 * o.s * y2 + gap, o.s * sinPhi);
  float up = i.c + o.c;
  float reach = sqrt(up * up + dot(plane, plane));
  vec2 slopes = plane / max(up, TINY);
  return Facing(y2, slopes * slopes, min(up / max(reach, TINY), 1.0), min(0.5 * reach, 1.0));
}

// ---- Curves over one angle --------------------------------------------------------------------------------------------------

struct Place { int node; float t; };

Place placeOf(float c, float s2) {
  float x = float(uNodes - 1) * sqrt(max(s2, 0.0) / ((1.0 + c) * (1.0 + sqrt(c))));
  int node = min(int(x), uNodes - 2);
  return Place(node, x - float(node));
}
Place placeOf(Polar p) { return placeOf(p.c, p.s * p.s); }
Place placeOf(float c) { return placeOf(c, (1.0 - c) * (1.0 + c)); }

vec4 curve(int row, Place at) {
  return mix(texelFetch(uCurves, ivec2(at.node, row), 0), texelFetch(uCurves, ivec2(at.node + 1, row), 0), at.t);
}

struct Rest { vec3 base, limit; float mirror; };

// What the lobes leave, where they leave something; else their limit less 1, in the same numbers.
Rest restOf(int row, Place at) {
  vec4 a = texelFetch(uCurves, ivec2(at.node, row), 0), b = texelFetch(uCurves, ivec2(at.node + 1, row), 0);
  vec4 left = mix(max(a, 0.0), max(b, 0.0), at.t);
  return Rest(left.rgb, 1.0 + mix(min(a.rgb, 0.0), min(b.rgb, 0.0), at.t), left.a);
}

// ---- The tabulated lobes ----------------------------------------------------------------------------------------------------

struct Incidence {
  Polar polar;
  int span;
  float t;            // how far θi is from the first to the second of the incidences that are mixed
  ivec2 nodes;
  float room;         // above the centre of the columns: its elevation
  vec2 gain;          // of positions below and above the centre
};

Incidence incidenceOf(Polar polar) {
  int low = 0, high = uGrid.w - 1;
  do {
    int middle = (low + high + 1) >> 1;
    if (record(uRecordStart.x + middle).x <= polar.theta) low = middle; else high = middle - 1;
  } while (low < high);
  vec4 span = record(uRecordStart.x + low);
  float t = clamp((polar.theta - span.x) * span.y, 0.0, 1.0);
  float w = uAxis.x;
#if SPACE
  float below = polar.theta;
#else
  float below = polar.theta + HALF_PI;
#endif
  float above = polar.elevation;
  float shift = w * w * (1.0 / (sqrt(below * below + w * w) + below) - 1.0 / (sqrt(above * above + w * w) + above));
  float side = 0.5 * float(uGrid.z);
  float room = above - shift;
  vec2 gain = side / vec2(arSinh((below + shift) / w), arSinh(room / w));
  return Incidence(polar, low, t, ivec2(span.zw), room, gain);
}

// Of two bands, interior and rehit as read over their albedo; or their shares in the cap.
vec4 along(int texel, Incidence at) {
  float step = at.t * float(uSteps);
  int i = min(int(step), uSteps - 1);
  int first = uRecordStart.z + (at.span * (uSteps + 1) + i) * TEXELS + texel;
  return mix(record(first), record(first + TEXELS), step - float(i));
}

// Position of a column relative to the first, in cells, and positions per radian there.
vec2 columnAt(Incidence at, float offset) {
  float size = abs(offset) / uAxis.x;
  float hypotenuse = sqrt(size * size + 1.0);
  float gain = offset >= 0.0 ? at.gain.y : at.gain.x;
  float stretched = gain * log(size + hypotenuse);
  return vec2(0.5 * float(uGrid.z) + (offset >= 0.0 ? stretched : -stretched), gain / (uAxis.x * hypotenuse));
}

float offsetOf(Incidence at, float position) {
  float d = position - 0.5 * float(uGrid.z);
  return uAxis.x * hypSine(d / (d >= 0.0 ? at.gain.y : at.gain.x));
}

struct Cell { int index; float t; };

Cell cellOf(float position, int cells) {
  float x = clamp(position - 0.5, 0.0, float(cells - 1));
  int index = min(int(x), cells - 2);
  return Cell(index, x - float(index));
}

int texelOf(int texel, int node, int row, int column) {
  return uRecordStart.w + ((node * uGrid.y + row) * uGrid.z + column) * TEXELS + texel;
}

// Between two cells and two incidences.
vec4 cellsAt(int texel, Incidence at, int row, Cell cell) {
  int near = texelOf(texel, at.nodes.x, row, cell.index), far = texelOf(texel, at.nodes.y, row, cell.index);
  return mix(mix(record(near), record(near + TEXELS), cell.t), mix(record(far), record(far + TEXELS), cell.t), at.t);
}

#if SPACE
float phiWidth(Incidence at) { vec2 e = turned(max(at.room, 1e-7)); return uAxis.x * e.y / e.x; }
#else
// Of two bands, how narrow the azimuths are.
vec2 concentration(int texel, Incidence at) {
  vec4 widths = record(uRecordStart.y + at.span * ((BANDS + 1) / 2) + texel);
  vec2 width = mix(widths.xz, widths.yw, at.t);
  return at.polar.s / (width * width);
}

// 1 − e^{−z}
float oneMinusExp(float z) {
  return z > 0.05 ? 1.0 - exp(-z) : z * (1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0))));
}

float decay(float x, float y2) {
  if (x < 1e-9) return 1.0 - y2;
  return exp(-min(2.0 * x * y2, 80.0)) * oneMinusExp(2.0 * x * (1.0 - y2)) / oneMinusExp(2.0 * x);
}

// Density of the azimuths that are sampled forwards: its sech² part, k and tanh k.
vec3 forwardOf(float x) {
  float k = max(1.6 * sqrt(x), 1e-4);
  return vec3(x / (x + 0.25), k, oneMinusExp(2.0 * k) / (1.0 + exp(-2.0 * k)));
}

float forwardDensity(vec3 f, float y2) {
  float e = exp(-min(2.0 * f.y * sqrt(y2), 80.0));
  return (1.0 - f.x) / (2.0 * PI) + f.x * 0.25 * root(1.0 - y2) * f.y * 4.0 * e / (square(1.0 + e) * f.z);
}

float forwardSample(vec3 f, float u) {
  bool negative = u >= 0.5;
  u = negative ? 2.0 * u - 1.0 : 2.0 * u;
  float t = clamp(u / max(f.x, TINY), 0.0, 1.0) * f.z;
  t = min(t, BELOW_ONE);
  float y = min(0.5 * log((1.0 + t) / (1.0 - t)) / f.y, 1.0);
  float phi = u >= f.x ? PI * min((u - f.x) / max(1.0 - f.x, TINY), 1.0) : 2.0 * arcSine(y);
  return negative ? -phi : phi;
}
#endif

// Where an exit direction lies in the table: the same for all bands.
struct Exit {
  Polar polar;
  float y2;
#if SPACE
  Cell column, row;
  float perAngles;         // positions per θo and φ
#else
  Cell ahead, back;
  vec2 perAngle;
#endif
};

Exit exitOf(Incidence at, Polar polar, float y2) {
  bool steep = min(at.polar.c, polar.c) > 0.7;
  float gap = steep ? polar.theta - at.polar.theta : at.polar.elevation - polar.elevation;
  // θo less the centre of the columns.
  vec2 ahead = columnAt(at, gap - (at.polar.elevation - at.room));
#if SPACE
  float width = phiWidth(at);
  float size = 2.0 * arcSine(min(sqrt(y2), 1.0)) / width;
  float hypotenuse = sqrt(size * size + 1.0), gain = float(uGrid.y) / arSinh(PI / width);
  return Exit(polar, y2, cellOf(ahead.x, uGrid.z), cellOf(gain * log(size + hypotenuse), uGrid.y), ahead.y * gain / (width * hypotenuse));
#else
  vec2 back = columnAt(at, -polar.theta - (HALF_PI - at.room));
  return Exit(polar, y2, cellOf(ahead.x, uGrid.z), cellOf(back.x, uGrid.z), vec2(ahead.y, back.y));
#endif
}

#if SPACE
vec4 cellsAt(int texel, Incidence at, Exit e) {
  return mix(cellsAt(texel, at, e.row.index, e.column), cellsAt(texel, at, e.row.index + 1, e.column), e.row.t);
}
#endif

// Of two bands, interior and rehit without colour, f·cos θo in 1/sr.
vec4 lightOf(int texel, Incidence at, Exit e) {
#if SPACE
  vec4 light = cellsAt(texel, at, e);
#else
  vec2 x = concentration(texel, at) * e.polar.s;
  vec2 share = vec2(decay(x.x, e.y2), decay(x.y, e.y2));
  vec4 light = mix(cellsAt(texel, at, 0, e.back), cellsAt(texel, at, 0, e.ahead), share.xxyy);
#endif
  return light / along(texel, at);
}

// Densities of interior and rehit per steradian.
vec2 densityOf(Incidence at, Exit e) {
#if SPACE
  vec2 density = sampledOf(cellsAt(LAST, at, e)) * (0.5 * e.perAngles);
#else
  float x = concentration(0, at).x * e.polar.s;
  vec2 ahead = sampledOf(cellsAt(LAST, at, 0, e.ahead)), back = sampledOf(cellsAt(LAST, at, 0, e.back));
  vec2 density = ahead * (e.perAngle.x * forwardDensity(forwardOf(x), e.y2)) + back * (e.perAngle.y / (2.0 * PI));
#endif
  return density / max(e.polar.s, POLE);
}

vec2 totals(Incidence at) {
  int first = uPairStart.z, second = first + uGrid.x;
  return mix(vec2(pair(first + at.nodes.x).x, pair(second + at.nodes.x).x),
             vec2(pair(first + at.nodes.y).x, pair(second + at.nodes.y).x), at.t);
}

// ---- The single reflection --------------------------------------------------------------------------------------------------

float slopeDensity(Facing f, float sigma) {
  return exp(-min((f.slopes2.x + f.slopes2.y) / (2.0 * sigma * sigma), 80.0)) / (2.0 * PI * sigma * sigma);
}

float fresnel(float c, float ratio) {
  float c2 = 1.0 - (1.0 - c * c) / (ratio * ratio);
  if (c2 <= 0.0) return 1.0;
  float t = sqrt(c2);
  float s = (c - ratio * t) / (c + ratio * t), p = (ratio * c - t) / (ratio * c + t);
  return 0.5 * (s * s + p * p);
}

float single(Facing f, vec2 facets) {
  float z = max(f.z, 1e-6);
  float light = 0.25 * slopeDensity(f, facets.x) * fresnel(f.c, facets.y) / (z * z * z);
#if VISIBLE
  return light / z;
#else
  return light / max(f.c, 1e-6);
#endif
}

// Where along the plane of incidence facets reflect above the horizon, at a slope across it whose square is q2.
vec2 slopeLimits(Polar i, float q2) {
  float chord = root(1.0 - q2 * i.c * i.c);
  return vec2(-(i.s + chord) / max(i.c, TINY), i.c * (1.0 - q2) / max(i.s + chord, TINY));
}

float singleDensity(Polar i, Facing f) {
  float sigma = uFacets[0].x, z = max(f.z, 1e-6);
  vec2 p = slopeLimits(i, f.slopes2.y) / sigma;
  float kept = (1.0 - 2.0 * upperTail(1.0 / (max(i.c, TINY) * sigma))) * (upperTail(p.x) - upperTail(p.y));
  return kept > 1e-12 ? slopeDensity(f, sigma) / (kept * 4.0 * max(f.c, 1e-6) * z * z * z) : 0.0;
}

// ---- All of it --------------------------------------------------------------------------------------------------------------

// What depends on the direction to the viewer alone.
struct Viewed {
  Incidence at;
  Place place;
  vec2 inCap;         // shares of the sampled light in it
  vec2 totals;
  vec4 chances;       // interior, rehit, single, base
};

Viewed viewedFrom(vec3 wi) {
  Polar polar = polarOf(wi);
  Incidence at = incidenceOf(polar);
  Place place = placeOf(polar);
  vec2 sums = totals(at);
  vec4 chances = curve(0, place);
  chances.xy *= step(vec2(TINY), sums);
  return Viewed(at, place, sampledOf(along(LAST, at)), sums, chances);
}

struct Value {
  vec3 diffuse, incoherent, mirror, blur;   // f·cos θo
  float pdf;
};

Value evaluate(Viewed v, vec3 wo) {
  Polar i = v.at.polar, o = polarOf(wo);
  Facing f = facingOf(i, o);
  Exit e = exitOf(v.at, o, f.y2);
  Place atO = placeOf(o), atD = placeOf(f.c);
  Incidence at = v.at;
  Exit there = e;
  float turnedRound = 1.0;
#if RECIPROCAL
  // The lobes are read at the larger of the two angles.
  if (o.c < i.c) { at = incidenceOf(o); there = exitOf(at, i, f.y2); turnedRound = o.c / i.c; }
#endif
  vec3 emission = curve(1, v.place).rgb;
  vec3 coloured = uDepth * emission;
  vec3 body = uBody / max(uBody * (1.0 - uDepth + coloured), vec3(1.0));
  Value value = Value(vec3(0.0), vec3(0.0), vec3(0.0), vec3(0.0), 0.0);
  vec3 base = vec3(0.0);
  int band = 0;
  do {
    vec4 light = turnedRound * lightOf(band / 2, at, there);
    int end = min(band + 2, BANDS);
    do {
      Rest rest = restOf(3 + 2 * band, v.place), restO = restOf(3 + 2 * band, atO);
      float reflected = single(f, uFacets[band]) * rest.mirror;
#if RECIPROCAL
      reflected *= restO.mirror * o.c;
#endif
      base += uBase[band] * rest.base * restO.base;
      vec3 colour = curve(2 + 2 * band, atD).rgb * rest.limit;
      value.mirror += colour * (reflected + light.y);
      value.blur += colour * light.x;
      light = light.zwxy;
    } while (++band < end);
  } while (band < BANDS);
  base *= body * o.c;
  value.diffuse = max(base * (1.0 - uDepth), 0.0);
  value.incoherent = max(base * coloured, 0.0);
  value.mirror = max(value.mirror, 0.0);
  value.blur = max(value.blur, 0.0);
  vec2 density = densityOf(v.at, e) / max(v.totals, TINY);
  float cap = uAxis.y;
  if (o.s < turned(cap).y) density = v.inCap / (4.0 * PI * square(turned(0.5 * cap).y));
  value.pdf = dot(v.chances, vec4(density, singleDensity(i, f), o.c / PI));
  return value;
}

vec3 shownOf(Value v) {
  return uShown.x * v.diffuse + uShown.y * v.incoherent + uShown.z * v.mirror + uShown.w * v.blur;
}

// ---- Sampling ---------------------------------------------------------------------------------------------------------------

float densityOfCell(int cell, int lobe) { vec2 r = sampledOf(record(cell)); return lobe == 0 ? r.x : r.y; }

// The position where the integral of a piecewise linear density reaches a share of its total. \`from\`: of the cumulative;
// densities: of the cells of a row (rows == false), or of the rows' totals.
float positionOf(int from, int densities, bool rows, int count, float share, float total, int lobe) {
  float target = share * total;
  int k = int(pair(from + min(int(share * float(count)), count - 1)).y);
  float before = k > 0 ? pair(from + k - 1).x : 0.0;
  for (int n = 0; n < 4096 && k < count; n++) {
    float reached = pair(from + k).x;
    if (reached > target) break;
    before = reached;
    k++;
  }
  int low = max(k - 1, 0), high = min(k, count - 1);
  float a = rows ? pair(densities + low).x : densityOfCell(densities + low * TEXELS, lobe);
  float b = rows ? pair(densities + high).x : densityOfCell(densities + high * TEXELS, lobe);
  float rest = max(target - before, 0.0);
  float t = 2.0 * rest / max(a + root(a * a + 2.0 * (b - a) * rest), TINY);
  return (k == 0 ? 0.0 : float(k) - 0.5) + min(t, 1.0);
}

// Chooses the second of two by the chance of the first; u becomes what is left of it.
bool second(inout float u, float first) {
  bool is = u >= first;
  u = clamp(is ? (u - first) / max(1.0 - first, TINY) : u / max(first, TINY), 0.0, BELOW_ONE);
  return is;
}

// (cos θo, sin θo, φ) of interior (0) or rehit (1).
vec3 sampleLobe(int lobe, Incidence at, float select, float u, float v) {
  int totalAt = uPairStart.z + lobe * uGrid.x;
  float near = (1.0 - at.t) * pair(totalAt + at.nodes.x).x, far = at.t * pair(totalAt + at.nodes.y).x;
  int node = second(select, near / max(near + far, TINY)) ? at.nodes.y : at.nodes.x;
  int row = (lobe * uGrid.x + node) * uGrid.y, inTable = 0;
  float cap = uAxis.y, phi = 0.0, area = select, turn = v;
#if SPACE
  float side = v < 0.5 ? 1.0 : -1.0;
  v = v < 0.5 ? 2.0 * v : 2.0 * v - 1.0;
  float around = positionOf(uPairStart.x + row, uPairStart.y + row, true, uGrid.y, v, pair(totalAt + node).x, lobe);
  float width = phiWidth(at);
  phi = side * min(width * hypSine(around * arSinh(PI / width) / float(uGrid.y)), PI);
  Cell cell = cellOf(around, uGrid.y);
  near = (1.0 - cell.t) * pair(uPairStart.y + row + cell.index).x;
  far = cell.t * pair(uPairStart.y + row + cell.index + 1).x;
  inTable = cell.index + (second(select, near / max(near + far, TINY)) ? 1 : 0);
#endif
  int cumulative = (row + inTable) * uGrid.z, cells = texelOf(LAST, node, inTable, 0);
  float total = pair(uPairStart.y + row + inTable).x;
  float position = positionOf(cumulative, cells, false, uGrid.z, u, total, lobe);
#if SPACE
  // A share of the row's part within the cap.
  float edgeAt = columnAt(at, cap - HALF_PI + at.room).x;
  Cell edge = cellOf(edgeAt, uGrid.z);
  float a = densityOfCell(cells + edge.index * TEXELS, lobe), b = densityOfCell(cells + (edge.index + 1) * TEXELS, lobe);
  float within = edgeAt < 0.5 ? edgeAt * a : pair(cumulative + edge.index).x + edge.t * (a + 0.5 * edge.t * (b - a));
  area = clamp(u * total / max(within, TINY), 0.0, 1.0);
  turn = select;
#endif
  // Elevation of the exit angle: from 0 at the forward horizon; in decay tables to π at the other.
  float elevation = clamp(at.room - offsetOf(at, position), 0.0, SPACE == 1 ? HALF_PI : PI);
  vec2 exit = turned(elevation).yx;
#if !SPACE
  phi = exit.y >= 0.0 ? forwardSample(forwardOf(concentration(0, at).x * max(exit.y, 0.0)), v) : PI * (2.0 * v - 1.0);
  exit.y = abs(exit.y);
#endif
  if (exit.y < turned(cap).y && exit.x > 0.0) {
    float chord2 = square(turned(0.5 * cap).y) * area;
    exit = vec2(1.0 - 2.0 * chord2, 2.0 * sqrt(chord2 * (1.0 - chord2)));
    phi = PI * (2.0 * turn - 1.0);
  }
  return vec3(exit, phi);
}

float truncatedNormal(vec2 limits, float u) {
  float x = ofUpperTail(clamp(mix(upperTail(limits.x), upperTail(limits.y), u), 1e-37, BELOW_ONE));
  return clamp(x, limits.x, limits.y);
}

// An exit direction from three uniform numbers; its z is not above 0 where none is found.
vec3 sampleExit(Viewed v, float select, float u1, float u2) {
  Polar i = v.at.polar;
  vec2 azimuth = i.plane * i.inverse;
  vec4 chances = v.chances;
  select *= chances.x + chances.y + chances.z + chances.w;
  int part = 0;
  float chance = chances.x;
  if (select >= chance) {
    select -= chance; chance = chances.y; part = 1;
    if (select >= chance) {
      select -= chance; chance = chances.z; part = 2;
      if (select >= chance) { select -= chance; chance = chances.w; part = 3; }
    }
  }
  if (chance <= 0.0) return vec3(0.0);
  select = min(select / chance, BELOW_ONE);
  if (part < 2) {
    vec3 e = sampleLobe(part, v.at, select, u1, u2);
    vec2 phi = turned(e.z);
    return vec3(e.y * (-phi.x * azimuth.x - phi.y * azimuth.y), e.y * (-phi.x * azimuth.y + phi.y * azimuth.x), e.x);
  }
  if (part == 2) {
    float sigma = uFacets[0].x, reach = 1.0 / (max(i.c, TINY) * sigma);
    float q = sigma * truncatedNormal(vec2(-reach, reach), u1);
    vec2 limits = slopeLimits(i, q * q);
    if (limits.y <= limits.x) return vec3(0.0);
    float p = sigma * truncatedNormal(limits / sigma, u2);
    float z = inversesqrt(1.0 + p * p + q * q);
    vec3 m = z * vec3(q * azimuth.y - p * azimuth.x, -p * azimuth.y - q * azimuth.x, 1.0);
    vec3 wi = vec3(i.s * azimuth, i.c);
    return 2.0 * dot(wi, m) * m - wi;
  }
  vec2 phi = turned(2.0 * PI * u2);
  return vec3(sqrt(u1) * phi, root(1.0 - u1));
}
`;
