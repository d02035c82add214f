//! Elementary functions where evaluation spends its time: without branches that random directions would mispredict, and as exact as
//! angles in narrow lobes need (a part in 1e12). What is read with them takes those of [`crate::numerics::single`].

use crate::Direction;
use std::f64::consts::{FRAC_PI_2, TAU};

/// 1/2π.
pub(crate) const INVERSE_TAU: f64 = 1.0 / TAU;

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
    /// Of one direction, or of two at little more than the price of one.
    #[inline(always)]
    pub(crate) fn of<const N: usize>(w: [Direction; N]) -> [Self; N] {
        let mut polar = [Self { theta: 0.0, sin: 0.0, cos: 0.0, azimuth: (1.0, 0.0) }; N];
        let (mut square, mut radius) = ([0.0; N], [0.0; N]);
        for (square, w) in square.iter_mut().zip(&w) {
            *square = w[0] * w[0] + w[1] * w[1];
        }
        for (radius, square) in radius.iter_mut().zip(&square) {
            *radius = square.sqrt();
        }
        for (((polar, w), radius), square) in polar.iter_mut().zip(&w).zip(radius).zip(square) {
            let inverse = 1.0 / radius;
            if radius > 1e-150 {
                polar.azimuth = (w[0] * inverse, w[1] * inverse);
            }
            polar.sin = least(radius, 1.0);
            polar.cos = w[2];
            polar.theta = angle(least(square, 1.0), w[2]);
        }
        polar
    }

    /// At an azimuth of 0.
    pub(crate) fn at(theta: f64) -> Self {
        let (sin, cos) = theta.sin_cos();
        Self { theta, sin, cos, azimuth: (1.0, 0.0) }
    }
}

/// sin²(φ/2), φ from the mirror direction of one direction to the other, by the cosines and sines of their azimuths: a quarter of
/// the squared chord between the two.
#[inline(always)]
pub(crate) fn half_azimuth2(a: (f64, f64), b: (f64, f64)) -> f64 {
    let (x, y) = (a.0 + b.0, a.1 + b.1);
    least(0.25 * (x * x + y * y), 1.0)
}

/// The smaller of two numbers that are not NaN, in one instruction.
#[inline(always)]
pub(crate) fn least<T: PartialOrd>(a: T, b: T) -> T {
    if a < b { a } else { b }
}

/// The larger of two numbers that are not NaN, in one instruction; `b` for a NaN in `a`.
#[inline(always)]
pub(crate) fn greatest<T: PartialOrd>(a: T, b: T) -> T {
    if a > b { a } else { b }
}

/// The angle in [0, π/2] of the square of a sine and of a cosine, by half of it: nothing cancels and nothing branches.
#[inline(always)]
pub(crate) fn angle(sin2: f64, cos: f64) -> f64 {
    // sin²(θ/2) = sin²θ/(2(1 + cos θ)).
    let half2 = sin2 * (0.5 / (1.0 + cos));
    2.0 * half2.sqrt() * arcsine_ratio(half2)
}

/// (cos 2πu, sin 2πu) of |u| < 2²⁰, absolute error 1e-15.
#[inline(always)]
pub(crate) fn turned(u: f64) -> (f64, f64) {
    // Quarter turns, and what is left: at most an eighth of a turn.
    let rounded = 4.0 * u + ROUNDER;
    let r = (4.0 * u - (rounded - ROUNDER)) * FRAC_PI_2;
    let z = r * r;
    let (z2, z4) = (z * z, z * z * z * z);
    let sin = (1.0 + z * (-1.0 / 6.0)) + (1.0 / 120.0 + z * (-1.0 / 5040.0)) * z2;
    let sin = r
        * (sin
            + ((1.0 / 362_880.0 + z * (-1.0 / 39_916_800.0))
                + (1.0 / 6_227_020_800.0 + z * (-1.0 / 1_307_674_368_000.0)) * z2)
                * z4);
    let cos = (1.0 + z * (-1.0 / 2.0)) + (1.0 / 24.0 + z * (-1.0 / 720.0)) * z2;
    let cos = cos
        + ((1.0 / 40_320.0 + z * (-1.0 / 3_628_800.0))
            + (1.0 / 479_001_600.0 + z * (-1.0 / 87_178_291_200.0)) * z2)
            * z4;
    let quarters = rounded.to_bits();
    let (a, b) = if quarters & 1 == 0 { (cos, sin) } else { (sin, cos) };
    let negated = |x: f64, negative: u64| f64::from_bits(x.to_bits() ^ (negative << 63));
    (negated(a, (quarters ^ (quarters >> 1)) & 1), negated(b, (quarters >> 1) & 1))
}

/// 1.5·2^52: added to a smaller number, rounds it to a whole one.
const ROUNDER: f64 = 6_755_399_441_055_744.0;

/// asin(√z)/√z on [0, ½]: Chebyshev fit of 14 terms, relative error 2.4e-13.
#[inline(always)]
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

/// a + t·(b − a), four at a time.
#[inline(always)]
pub(crate) fn between(a: &[f32; 4], b: &[f32; 4], t: f32) -> [f32; 4] {
    let mut mixed = *a;
    for (mixed, b) in mixed.iter_mut().zip(b) {
        *mixed += t * (b - *mixed);
    }
    mixed
}

/// cot(θ + d) from sin θ, cos θ and |d| ≤ π/6, by Padé's [5/4] of the tangent.
#[inline(always)]
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
            let found = angle(theta.sin().powi(2), theta.cos());
            assert!((found - theta).abs() <= 4e-13 * theta, "{theta}: {found}");
            let small = 1e-9 * theta;
            assert!((angle(small.sin().powi(2), small.cos()) - small).abs() <= 4e-13 * small);
            let d = 0.52 * (f64::from(i) / 2000.0 - 1.0);
            let sum = 0.9 + d;
            let turns = 1e-3 * f64::from(i) - 2.0;
            let (cos, sin) = turned(turns);
            let (sine, cosine) = (TAU * turns).sin_cos();
            // TAU·turns itself is rounded.
            assert!((cos - cosine).abs() < 4e-15 && (sin - sine).abs() < 4e-15, "{turns}: {cos} {sin}");
            assert!((cotangent(0.9_f64.sin(), 0.9_f64.cos(), d) * sum.tan() - 1.0).abs() < 1e-8, "{d}");
        }
    }
}
