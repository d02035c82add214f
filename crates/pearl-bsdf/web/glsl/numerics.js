/**
 * Functions of one number. GLSL promises no more than 2⁻¹¹ for sines and little for arc functions; lobes a few degrees wide need
 * single precision.
 */
export const NUMERICS = `
const float PI = 3.14159265358979;
const float HALF_PI = 1.57079632679490;
const float TINY = 1e-30;
const float BELOW_ONE = 0.99999994;

float root(float x) { return sqrt(max(x, 0.0)); }
float square(float x) { return x * x; }

// asin(x) for 0 ≤ x ≤ 1: Chebyshev fit of (asin x − x)/x³ over x² ≤ ¼; error 3e-8.
float arcSine(float x) {
  bool high = x > 0.5;
  float y = high ? root(0.5 - 0.5 * x) : x;
  float z = y * y;
  float p = 0.16666666 + z * (0.07500095 + z * (0.0445994 + z * (0.03110068 + z * (0.01714918 + z * 0.03369093))));
  float a = y + y * z * p;
  return high ? HALF_PI - 2.0 * a : a;
}

// (cos x, sin x), |x| ≤ 2π.
vec2 turned(float x) {
  float quarter = floor(x / HALF_PI + 0.5);
  float r = (x - quarter * 1.5707964) + quarter * 4.3711388e-8;
  float z = r * r;
  float s = r + r * z * (-0.166666667 + z * (8.33333187e-3 + z * (-1.98400867e-4 + z * 2.72499208e-6)));
  float c = 1.0 - 0.5 * z + z * z * (4.16666667e-2 + z * (-1.38888877e-3 + z * (2.48005938e-5 - z * 2.73003684e-7)));
  int q = int(quarter) & 3;
  return q == 0 ? vec2(c, s) : q == 1 ? vec2(-s, c) : q == 2 ? vec2(-c, -s) : vec2(s, -c);
}

float arSinh(float x) { return log(x + sqrt(x * x + 1.0)); }
float hypSine(float x) { float e = exp(x); return 0.5 * (e - 1.0 / e); }

// P(X > x) of the standard normal distribution (as pearl-bsdf, \`numerics::normal\`).
float upperTail(float x) {
  float a = abs(x);
  float t = 4.0 / (4.0 + a);
  float s = 2.0 * t - 1.0;
  float q = -1.3002766e-7;
  q = q * s - 2.0359914e-8; q = q * s + 1.2836628e-6; q = q * s + 1.3492963e-8; q = q * s - 8.6143437e-6;
  q = q * s - 3.5745244e-7; q = q * s + 5.7686147e-5; q = q * s + 3.3285190e-5; q = q * s - 4.0767898e-4;
  q = q * s - 8.6991095e-4; q = q * s + 1.8850432e-3; q = q * s + 1.5099142e-2; q = q * s + 4.6630464e-2;
  q = q * s + 9.6784350e-2; q = q * s + 1.5197416e-1; q = q * s + 1.8882128e-1;
  float tail = exp(-0.5 * a * a) * t * q;
  return x < 0.0 ? 1.0 - tail : tail;
}

float cubic(vec4 c, float x) { return c.x + x * (c.y + x * (c.z + x * c.w)); }

// x of P(X > x) = tail: Wichura's algorithm AS 241 (Applied Statistics 37, 1988), PPND7.
float ofUpperTail(float tail) {
  float q = 0.5 - tail;
  if (abs(q) <= 0.425) {
    float r = 0.180625 - q * q;
    return q * cubic(vec4(3.3871327179, 50.434271938, 159.29113202, 59.10937472), r)
             / cubic(vec4(1.0, 17.895169469, 78.757757664, 67.1875636), r);
  }
  float r = sqrt(-log(max(min(tail, 1.0 - tail), 1.2e-38)));
  float x = r <= 5.0
    ? cubic(vec4(1.4234372777, 2.75681539, 1.3067284816, 0.17023821103), r - 1.6)
      / cubic(vec4(1.0, 0.7370016425, 0.12021132975, 0.0), r - 1.6)
    : cubic(vec4(6.657905115, 3.081226386, 0.42868294337, 0.017337203997), r - 5.0)
      / cubic(vec4(1.0, 0.24197894225, 0.012258202635, 0.0), r - 5.0);
  return q < 0.0 ? -x : x;
}
`;

/** Random numbers: a sequence that fills the unit cube evenly for the first vertex of a path, PCG beyond. */
export const RANDOM = `
uint hashed(uint x) {
  x = x * 747796405u + 2891336453u;
  x = ((x >> ((x >> 28u) + 4u)) ^ x) * 277803737u;
  return (x >> 22u) ^ x;
}

struct Random { uint state; uint number; uint dimension; };

Random randomOf(uvec2 pixel, uint number, uint seed) {
  return Random(hashed(pixel.x ^ hashed(pixel.y ^ hashed(seed))), number, 0u);
}

// Powers of the root of x⁹ = x + 1 (Roberts, The unreasonable effectiveness of quasirandom sequences), in units of 2⁻³², made odd.
const uint STEPS[8] = uint[8](3958238937u, 3647910313u, 3361911661u, 3098335501u, 2855423889u, 2631556713u, 2425240877u, 2235100341u);

float next(inout Random r) {
  uint k = r.dimension++;
  uint x = hashed(r.state + 0x9e3779b9u * (k + 1u));
  // One shift for each pixel and dimension; beyond the eighth, a hash of the number too.
  x = k < 8u ? x + r.number * STEPS[k] : hashed(x ^ hashed(r.number + 0x85ebca6bu * k));
  return float(x >> 8u) * 5.9604645e-8;
}
`;
