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
    /// Terms of the sine and cosine of a tilt: see [`TiltSinCos`](super::draws::TiltSinCos).
    const TILT_TERMS: usize;

    fn from_f64(value: f64) -> Self;
    fn from_f32(value: f32) -> Self;
    fn to_f64(self) -> f64;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    /// a·b + c, rounded once. Without the instruction (`FUSED` false) the same value, computed in more steps.
    fn fma<const FUSED: bool>(self, b: Self, c: Self) -> Self;
}

macro_rules! real {
    ($float:ident, $tilt_terms:literal, $unfused:expr) => {
        impl Real for $float {
            const ZERO: Self = 0.0;
            const ONE: Self = 1.0;
            const TILT_TERMS: usize = $tilt_terms;

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

real!(f32, 3, fma_by_f64);
real!(f64, 7, f64::mul_add);

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
