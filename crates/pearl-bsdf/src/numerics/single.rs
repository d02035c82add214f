//! Elementary functions in single precision, where a part in a million is enough: positions between cells, and all that is read
//! there or multiplies it. Twice as many fit into a vector as of double precision, and roots and quotients take less time.

use crate::numerics::angles::{greatest, least};
use std::f32::consts::{LN_2, LOG2_E};

/// 1.5·2^23: added to a smaller number, rounds it to a whole one.
const ROUNDER: f32 = 12_582_912.0;

/// ln x of a normal number, error 2e-7 of it or of 1.
#[inline(always)]
pub(crate) fn ln(x: f32) -> f32 {
    // x = 2^e·m, m from √½ to √2, and ln m = 2 artanh((m − 1)/(m + 1)).
    const SQRT_HALF: i32 = 0x3F35_04F3;
    let shifted = x.to_bits().cast_signed().wrapping_sub(SQRT_HALF);
    let exponent = (shifted >> 23) as f32;
    let m = f32::from_bits((shifted & 0x007F_FFFF).wrapping_add(SQRT_HALF).cast_unsigned());
    let s = (m - 1.0) / (m + 1.0);
    let z = s * s;
    let series = (2.0 + z * (2.0 / 3.0)) + (2.0 / 5.0 + z * (2.0 / 7.0)) * (z * z);
    exponent * LN_2 + s * series
}

/// eˣ of x ≤ 0, relative error 3e-7; 0 below −87.
#[inline(always)]
pub(crate) fn exp(x: f32) -> f32 {
    // ln 2 in two parts, the first with zeros at its end.
    const HIGH: f32 = 0.693_359_375;
    const LOW: f32 = -2.121_944_4e-4;
    let bounded = greatest(x, -87.25);
    let rounded = bounded * LOG2_E + ROUNDER;
    let twos = rounded - ROUNDER;
    let r = (bounded - twos * HIGH) - twos * LOW;
    let r2 = r * r;
    let low = (1.0 + r) + (1.0 / 2.0 + r * (1.0 / 6.0)) * r2;
    let power = low + ((1.0 / 24.0 + r * (1.0 / 120.0)) + r2 * (1.0 / 720.0)) * (r2 * r2);
    let scale = f32::from_bits(rounded.to_bits().wrapping_add(127) << 23);
    if x < -87.0 { 0.0 } else { power * scale }
}

/// [`exp`] of each x, two for little more than the price of one.
#[inline(always)]
pub(crate) fn exp_each<const N: usize>(mut x: [f32; N]) -> [f32; N] {
    for x in &mut x {
        *x = exp(*x);
    }
    x
}

/// asinh of each x ≥ 0, error 2e-7 of it or of 1.
#[inline(always)]
pub(crate) fn asinh<const N: usize>(x: [f32; N]) -> [f32; N] {
    asinh_and_root(x).0
}

/// asinh |x| of each x, error 2e-7 of it or of 1, and √(1 + x²).
#[inline(always)]
pub(crate) fn asinh_and_root<const N: usize>(x: [f32; N]) -> ([f32; N], [f32; N]) {
    let (mut arc, mut root) = ([0.0; N], [0.0; N]);
    for (root, x) in root.iter_mut().zip(&x) {
        *root = (1.0 + x * x).sqrt();
    }
    for ((arc, root), x) in arc.iter_mut().zip(&root).zip(&x) {
        *arc = ln(x.abs() + root);
    }
    (arc, root)
}

/// The first of two numbers where the sign of x is +, the second where it is −; without a branch, which random angles would mispredict.
#[inline(always)]
pub(crate) fn of_sign(x: f32, [plus, minus]: [f32; 2]) -> f32 {
    let negative = (x.to_bits().cast_signed() >> 31).cast_unsigned();
    f32::from_bits((plus.to_bits() & !negative) | (minus.to_bits() & negative))
}

/// A count of less than 2³¹, in two instructions.
#[inline(always)]
pub(crate) const fn whole(count: usize) -> f32 {
    count as i32 as f32
}

/// The angle in [0, π/2] of the square of a sine and of a cosine, as [`crate::numerics::angles::angle`].
#[inline(always)]
pub(crate) fn angle(sin2: f32, cos: f32) -> f32 {
    let half2 = sin2 * (0.5 / (1.0 + cos));
    2.0 * half2.sqrt() * arcsine_ratio(half2)
}

/// asin(√z)/√z on [0, ½]: Chebyshev fit of 7 terms.
#[inline(always)]
fn arcsine_ratio(z: f32) -> f32 {
    #[rustfmt::skip]
    const C: [f32; 7] = [
        1.000000094, 0.166649005, 0.075538159, 0.038599960, 0.061749367, -0.056474037, 0.101885297,
    ];
    let (z2, z4) = (z * z, z * z * z * z);
    let pair = |k: usize| C[k] + C[k + 1] * z;
    (pair(0) + pair(2) * z2) + (pair(4) + C[6] * z2) * z4
}

/// Between which nodes x lies in a table of equal steps, and how far from the first of them to the second: x is the number of
/// the node and the fraction together. 0 ≤ x < 2²², `last` is the last step; exactly at a node, either side of it may be named.
#[inline(always)]
pub(crate) fn step_of(x: f32, last: f32) -> (usize, f32) {
    // The addition rounds to a whole number and leaves it in the lowest bits: fewer instructions than a saturating cast.
    let rounded = least(x - 0.5, last) + ROUNDER;
    ((rounded.to_bits() & 0x3F_FFFF) as usize, x - (rounded - ROUNDER))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn they_are_the_functions_of_the_standard_library_to_a_part_in_millions() {
        for i in 0..=4000 {
            let x = (1.0 + 1e-6 * f64::from(i).powi(4)) as f32;
            let expected = f64::from(x).ln();
            assert!((f64::from(ln(x)) - expected).abs() < 2e-7 * (1.0 + expected), "{x}: {}", ln(x));
            let [arc] = asinh([x - 1.0]);
            let expected = f64::from(x - 1.0).asinh();
            assert!((f64::from(arc) - expected).abs() < 2e-7 * (1.0 + expected), "{x}: {arc}");
            let y = (-0.0054 * f64::from(i) * (1.0 + 1e-3 * f64::from(i))) as f32;
            assert!(
                (f64::from(exp(y)) / f64::from(y).exp() - 1.0).abs() < 3e-7 || y < -87.0,
                "{y}: {}",
                exp(y)
            );
            let theta = FRAC_PI_2 * f64::from(i) / 4000.0;
            let found = f64::from(angle(theta.sin().powi(2) as f32, theta.cos() as f32));
            assert!((found - theta).abs() <= 4e-7 * theta, "{theta}: {found}");
            let (node, fraction) = step_of(1e-3 * i as f32, 3.0);
            let whole = node as f32 + fraction;
            assert!((whole - 1e-3 * i as f32).abs() < 1e-6 && (0.0..=1.0).contains(&fraction), "{i}");
        }
        assert_eq!((ln(1.0), exp(0.0), exp(-87.5), exp(f32::NEG_INFINITY)), (0.0, 1.0, 0.0, 0.0));
    }
}
