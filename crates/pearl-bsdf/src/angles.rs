//! Elementary functions where evaluation spends its time: without branches that random directions would mispredict, and no more
//! exact than positions between cells need (a part in 1e12).

use crate::Direction;
use std::f64::consts::{FRAC_PI_2, LN_2};

/// A direction above the horizon in polar form.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Polar {
    pub(crate) theta: f64,
    pub(crate) sin: f64,
    pub(crate) cos: f64,
    /// cos and sin of the azimuth; (1, 0) at the pole.
    pub(crate) azimuth: (f64, f64),
}

impl Polar {
    #[inline]
    pub(crate) fn of(w: Direction) -> Self {
        let radius = (w[0] * w[0] + w[1] * w[1]).sqrt();
        let azimuth = if radius > 1e-150 { (w[0] / radius, w[1] / radius) } else { (1.0, 0.0) };
        let sin = radius.min(1.0);
        Self { theta: angle(sin, w[2]), sin, cos: w[2], azimuth }
    }

    /// At an azimuth of 0.
    pub(crate) fn at(theta: f64) -> Self {
        let (sin, cos) = theta.sin_cos();
        Self { theta, sin, cos, azimuth: (1.0, 0.0) }
    }
}

/// sin²(φ/2), φ from the mirror direction of one direction to the other: a quarter of the squared chord between the two azimuths.
#[inline]
pub(crate) fn half_azimuth2(a: &Polar, b: &Polar) -> f64 {
    let (x, y) = (a.azimuth.0 + b.azimuth.0, a.azimuth.1 + b.azimuth.1);
    (0.25 * (x * x + y * y)).min(1.0)
}

/// The angle in [0, π/2] of a sine and a cosine, from whichever of the two keeps its digits.
#[inline]
pub(crate) fn angle(sin: f64, cos: f64) -> f64 {
    let small = sin.min(cos);
    let arc = small * arcsine_ratio(small * small);
    if sin < cos { arc } else { FRAC_PI_2 - arc }
}

/// asin(√z)/√z on [0, ½]: Chebyshev fit of 14 terms, relative error 2.4e-13.
#[inline]
fn arcsine_ratio(z: f64) -> f64 {
    #[rustfmt::skip]
    const C: [f64; 14] = [
        0.999_999_999_999_875_96, 0.166_666_666_763_795_42, 0.074_999_987_448_317_532, 0.044_643_492_767_207_059,
        0.030_365_242_418_799_673, 0.022_633_340_660_315_889, 0.014_727_559_012_250_292, 0.031_697_852_031_714_081,
        -0.070_832_117_797_899_672, 0.274_459_989_116_207_97, -0.572_111_570_773_520_62, 0.842_441_681_087_869_62,
        -0.712_753_744_300_545_15, 0.295_651_258_219_081_56,
    ];
    // Estrin's scheme: short chains.
    let (z2, z4) = (z * z, z * z * z * z);
    let four = |k: usize| (C[k] + C[k + 1] * z) + (C[k + 2] + C[k + 3] * z) * z2;
    (four(0) + four(4) * z4) + (four(8) + (C[12] + C[13] * z) * z4) * (z4 * z4)
}

/// ln x of a normal number, absolute error 1e-12.
#[inline]
pub(crate) fn ln(x: f64) -> f64 {
    // x = 2^e·m, m from √½ to √2, and ln m = 2 artanh((m − 1)/(m + 1)).
    let bits = x.to_bits();
    let exponent = (bits.wrapping_sub(0x3FE6_A09E_667F_3BCD) as i64) >> 52;
    let m = f64::from_bits(bits.wrapping_sub((exponent as u64) << 52));
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let z2 = z * z;
    let low = (2.0 + z * (2.0 / 3.0)) + (2.0 / 5.0 + z * (2.0 / 7.0)) * z2;
    let high = (2.0 / 9.0 + z * (2.0 / 11.0)) + (2.0 / 13.0) * z2;
    exponent as f64 * LN_2 + s * (low + high * (z2 * z2))
}

/// asinh of x ≥ 0 to an absolute error of 1e-12, which is all that a position needs.
#[inline]
pub(crate) fn asinh(x: f64) -> f64 {
    ln(x + (1.0 + x * x).sqrt())
}

/// cot(θ + d) from sin θ, cos θ and |d| ≤ π/6, by Padé's [5/4] of the tangent.
#[inline]
pub(crate) fn cotangent(sin: f64, cos: f64, d: f64) -> f64 {
    let z = d * d;
    let (over, under) = (d * (945.0 + z * (z - 105.0)), 945.0 + z * (15.0 * z - 420.0));
    (cos * under - sin * over) / (sin * under + cos * over)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn they_are_the_functions_of_the_standard_library_to_a_part_in_a_million_millions() {
        for i in 0..=4000 {
            let theta = FRAC_PI_2 * f64::from(i) / 4000.0;
            let found = angle(theta.sin(), theta.cos());
            assert!((found - theta).abs() <= 4e-13 * theta, "{theta}: {found}");
            let small = 1e-9 * theta;
            assert!((angle(small.sin(), small.cos()) - small).abs() <= 4e-13 * small);
            let x = 1.0 + 1e-6 * f64::from(i).powi(4);
            assert!((ln(x) - x.ln()).abs() < 2e-12, "{x}: {}", ln(x));
            let d = 0.52 * (f64::from(i) / 2000.0 - 1.0);
            let sum = 0.9 + d;
            assert!((cotangent(0.9_f64.sin(), 0.9_f64.cos(), d) * sum.tan() - 1.0).abs() < 1e-8, "{d}");
        }
        assert_eq!(ln(1.0), 0.0);
    }
}
