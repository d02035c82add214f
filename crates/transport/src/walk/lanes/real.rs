//! The two precisions of the lanes.

use std::fmt::Debug;
use std::hint::select_unpredictable;
use std::ops::{Add, Div, Mul, Neg, Sub};

/// A floating-point type the lanes can walk in. Only operations that IEEE 754 rounds correctly, so that every
/// SIMD level gives the same bits.
pub(crate) trait Real:
    Copy
    + Debug
    + PartialOrd
    + Send
    + Sync
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
{
    const ZERO: Self;
    const ONE: Self;
    /// Terms of sin α/α and of cos α in powers of α², for |α| ≤ 0.27: as many as the precision can see, so that a normal has
    /// unit length to rounding. See [`tilt_sin_cos`](super::draws::tilt_sin_cos).
    const TILT_SIN: &'static [f64];
    const TILT_COS: &'static [f64];

    fn from_f64(value: f64) -> Self;
    fn from_f32(value: f32) -> Self;
    fn to_f64(self) -> f64;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    /// a·b + c, rounded once. Without the instruction (`FUSED` false) the same value, computed in more steps.
    fn fma<const FUSED: bool>(self, b: Self, c: Self) -> Self;
}

macro_rules! real {
    ($float:ident, $tilt:expr, $unfused:expr) => {
        impl Real for $float {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const TILT_SIN: &'static [f64] = $tilt[0];
            const TILT_COS: &'static [f64] = $tilt[1];

            #[inline(always)]
            fn from_f64(value: f64) -> Self {
                value as Self
            }
            #[inline(always)]
            fn from_f32(value: f32) -> Self {
                Self::from(value)
            }
            #[inline(always)]
            fn to_f64(self) -> f64 {
                f64::from(self)
            }
            #[inline(always)]
            fn sqrt(self) -> Self {
                self.sqrt()
            }
            #[inline(always)]
            fn abs(self) -> Self {
                self.abs()
            }
            #[inline(always)]
            fn fma<const FUSED: bool>(self, b: Self, c: Self) -> Self {
                if FUSED { self.mul_add(b, c) } else { $unfused(self, b, c) }
            }
        }
    };
}

/// Minimax: |error| < 4·10⁻¹⁰ and 2·10⁻⁸, half the last place of an f32.
const NARROW_TILT: [&[f64]; 2] = [
    &[9.999_999_916_104e-1, -1.666_657_457_094e-1, 8.308_054_673_418e-3],
    &[9.999_999_832_286e-1, -4.999_958_571_152e-1, 4.151_503_033_840e-2],
];
/// Taylor, 1/n! with changing signs: the next term is below 10⁻¹⁸.
const WIDE_TILT: [&[f64]; 2] = {
    const SERIES: [[f64; 7]; 2] = {
        let (mut sin, mut cos) = ([0.0; 7], [0.0; 7]);
        let (mut factorial, mut k) = (1.0, 0);
        while k < 7 {
            let n = 2.0 * k as f64;
            cos[k] = if k % 2 == 0 { 1.0 / factorial } else { -1.0 / factorial };
            sin[k] = cos[k] / (n + 1.0);
            factorial *= (n + 1.0) * (n + 2.0);
            k += 1;
        }
        [sin, cos]
    };
    [&SERIES[0], &SERIES[1]]
};

real!(f32, NARROW_TILT, fma_by_f64);
real!(f64, WIDE_TILT, f64::mul_add);

/// a·b + c rounded once, from f64 operations: the product is exact in f64; the sum is rounded *to odd*, which makes the
/// second rounding, to f32, correct (Boldo & Melquiond 2008, "Emulation of a FMA and correctly rounded sums: proved
/// algorithms using rounding to odd"). Free of branches, so that it vectorises; for finite arguments.
#[inline(always)]
fn fma_by_f64(a: f32, b: f32, c: f32) -> f32 {
    let (product, c) = (f64::from(a) * f64::from(b), f64::from(c));
    let sum = product + c;
    // Knuth's exact error of the sum.
    let tail = sum - product;
    let error = (product - (sum - tail)) + (c - tail);
    let bits = sum.to_bits();
    let outwards = (error > 0.0) == (sum > 0.0);
    let step = select_unpredictable(outwards, 1, u64::MAX);
    let to_odd = select_unpredictable((error != 0.0) & (bits & 1 == 0), step, 0);
    f64::from_bits(bits.wrapping_add(to_odd)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::rngs::SmallRng;
    use rand::{RngExt, SeedableRng};

    /// Half of the cases have a sum that cancels or lies near the middle of two f32s.
    #[test]
    fn fma_by_f64_is_the_fused_operation() {
        let mut random = SmallRng::seed_from_u64(1);
        for case in 0..2_000_000 {
            let mut float = || {
                let exponent = random.random_range(-30..30);
                (random.random::<f32>() * 2.0 - 1.0) * 2.0_f32.powi(exponent)
            };
            let (a, b, mut c) = (float(), float(), float());
            if case % 2 == 0 {
                c = -a * b * (1.0 + c.signum() * 2.0_f32.powi(-random.random_range(0..30)));
            }
            assert_eq!(fma_by_f64(a, b, c).to_bits(), a.mul_add(b, c).to_bits(), "{a:e} {b:e} {c:e}");
        }
        // The exact sum lies just beside the middle of two f32s; rounding it to f64 first would lose the side.
        let (a, b, c) = (1.0 + 2.0_f32.powi(-12), 1.0 + 2.0_f32.powi(-12), 2.0_f32.powi(-80));
        assert_eq!(fma_by_f64(a, b, c), a.mul_add(b, c));
        assert_eq!(fma_by_f64(a, b, -c), a.mul_add(b, -c));
    }
}
