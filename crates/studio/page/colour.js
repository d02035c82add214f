/** Colour: linear sRGB, CIE Lab (D65), and the colour difference CIEDE2000. */

const WHITE = [0.95047, 1, 1.08883];

/** @param {number} x of linear sRGB */
export function encode(x) {
  const c = Math.min(Math.max(x, 0), 1);
  return c <= 0.0031308 ? 12.92 * c : 1.055 * c ** (1 / 2.4) - 0.055;
}

/** @param {number} x of sRGB */
export function decode(x) {
  return x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4;
}

/** @param {number[]} rgb linear */
export function toHex(rgb) {
  return `#${rgb.map((x) => Math.round(255 * encode(x)).toString(16).padStart(2, "0")).join("")}`;
}

/** @param {string} hex */
export function fromHex(hex) {
  return [1, 3, 5].map((at) => decode(parseInt(hex.slice(at, at + 2), 16) / 255));
}

/** @param {number[]} rgb linear */
export function lab([r, g, b]) {
  const xyz = [
    0.4124564 * r + 0.3575761 * g + 0.1804375 * b,
    0.2126729 * r + 0.7151522 * g + 0.072175 * b,
    0.0193339 * r + 0.119192 * g + 0.9503041 * b,
  ];
  const [x, y, z] = xyz.map((value, k) => {
    const t = value / WHITE[k];
    return t > 216 / 24389 ? Math.cbrt(t) : (24389 / 27 * t + 16) / 116;
  });
  return [116 * y - 16, 500 * (x - y), 200 * (y - z)];
}

/**
 * CIEDE2000 (Sharma, Wu and Dalal 2005).
 * @param {number[]} one Lab
 * @param {number[]} other Lab
 */
export function deltaE(one, other) {
  const rad = Math.PI / 180;
  const chroma = (Math.hypot(one[1], one[2]) + Math.hypot(other[1], other[2])) / 2;
  const g = 0.5 * (1 - Math.sqrt(chroma ** 7 / (chroma ** 7 + 25 ** 7)));
  const polar = (/** @type {number[]} */ [l, a, b]) => {
    const wide = (1 + g) * a;
    const c = Math.hypot(wide, b);
    return [l, c, c === 0 ? 0 : (Math.atan2(b, wide) / rad + 360) % 360];
  };
  const [[l1, c1, h1], [l2, c2, h2]] = [polar(one), polar(other)];
  let dh = h2 - h1;
  if (c1 * c2 === 0) dh = 0;
  else if (dh > 180) dh -= 360;
  else if (dh < -180) dh += 360;
  const dH = 2 * Math.sqrt(c1 * c2) * Math.sin((dh / 2) * rad);
  const [l, c] = [(l1 + l2) / 2, (c1 + c2) / 2];
  let h = h1 + h2;
  if (c1 * c2 !== 0) h = Math.abs(h1 - h2) <= 180 ? h / 2 : h < 360 ? (h + 360) / 2 : (h - 360) / 2;
  const cos = (/** @type {number} */ degrees) => Math.cos(degrees * rad);
  const t = 1 - 0.17 * cos(h - 30) + 0.24 * cos(2 * h) + 0.32 * cos(3 * h + 6) - 0.2 * cos(4 * h - 63);
  const sl = 1 + (0.015 * (l - 50) ** 2) / Math.sqrt(20 + (l - 50) ** 2);
  const sc = 1 + 0.045 * c;
  const sh = 1 + 0.015 * c * t;
  const turn = -2 * Math.sqrt(c ** 7 / (c ** 7 + 25 ** 7)) * Math.sin(60 * Math.exp(-(((h - 275) / 25) ** 2)) * rad);
  const [x, y, z] = [(l2 - l1) / sl, (c2 - c1) / sc, dH / sh];
  return Math.sqrt(x * x + y * y + z * z + turn * y * z);
}
