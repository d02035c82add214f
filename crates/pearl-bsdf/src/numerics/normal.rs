//! Tails of the standard normal distribution, and the other way.

use crate::numerics::angles::{greatest, least};
use crate::numerics::single::{exp, ln};

/// P(X > x), relative error 2e-6 for x ≥ 0 until it is 0 at x > 13.
#[inline(always)]
pub(crate) fn upper_tail(x: f32) -> f32 {
    let tail = tail_of_positive(x.abs());
    if x < 0.0 { 1.0 - tail } else { tail }
}

/// e^{−x²/2}·t·Q(t), t = 4/(4 + x): Chebyshev fit of Q over t ∈ (0, 1] in s = 2t − 1.
#[inline(always)]
fn tail_of_positive(x: f32) -> f32 {
    #[rustfmt::skip]
    const C: [f32; 16] = [
        0.188_821_282_603_430_67, 0.151_974_160_487_153_87, 0.096_784_350_252_257_956,
        0.046_630_464_772_160_575, 0.015_099_142_273_130_485, 0.001_885_043_236_624_356_1,
        -0.000_869_910_949_653_966_25, -0.000_407_678_984_572_861_68, 3.328_518_998_715_153e-05,
        5.768_614_667_934_915_7e-05, -3.574_524_419_357_724_9e-07, -8.614_343_722_060_087_5e-06,
        1.349_296_259_113_865_7e-08, 1.283_662_843_793_240_5e-06, -2.035_991_355_294_743_9e-08,
        -1.300_276_625_179_619_1e-07,
    ];
    let t = 4.0 / (4.0 + x);
    let s = 2.0 * t - 1.0;
    // Estrin's scheme: short chains.
    let (s2, s4) = (s * s, s * s * s * s);
    let four = |k: usize| (C[k] + C[k + 1] * s) + (C[k + 2] + C[k + 3] * s) * s2;
    let q = (four(0) + four(4) * s4) + (four(8) + four(12) * s4) * (s4 * s4);
    exp(-0.5 * x * x) * t * q
}

/// x of P(X > x) = tail, 0 < tail < 1: Wichura's algorithm AS 241 (Applied Statistics 37, 1988), PPND7, relative error 3e-7.
#[inline(always)]
pub(crate) fn of_upper_tail(tail: f64) -> f32 {
    #[rustfmt::skip]
    const CENTRE: [[f32; 4]; 2] = [
        [3.387_132_717_9, 50.434_271_938, 159.291_132_02, 59.109_374_72],
        [1.0, 17.895_169_469, 78.757_757_664, 67.187_563_6],
    ];
    #[rustfmt::skip]
    const NEAR: [[f32; 4]; 2] = [
        [1.423_437_277_7, 2.756_815_39, 1.306_728_481_6, 0.170_238_211_03],
        [1.0, 0.737_001_642_5, 0.120_211_329_75, 0.0],
    ];
    #[rustfmt::skip]
    const FAR: [[f32; 4]; 2] = [
        [6.657_905_115, 3.081_226_386, 0.428_682_943_37, 0.017_337_203_997],
        [1.0, 0.241_978_942_25, 0.012_258_202_635, 0.0],
    ];
    // All three are worked out, one is taken: no branch that random numbers would mispredict.
    let (q, smaller) = ((0.5 - tail) as f32, least(tail, 1.0 - tail) as f32);
    let r = (-ln(greatest(smaller, f32::MIN_POSITIVE))).sqrt();
    let centre = cubics(&CENTRE, 0.180_625 - q * q);
    let near = cubics(&NEAR, r - 1.6);
    let far = cubics(&FAR, r - 5.0);
    let tails = if r <= 5.0 { near } else { far };
    let (over, under) =
        if q.abs() <= 0.425 { (q * centre.0, centre.1) } else { (tails.0.copysign(q), tails.1) };
    over / under
}

/// Two polynomials of third degree.
#[inline(always)]
fn cubics([a, b]: &[[f32; 4]; 2], x: f32) -> (f32, f32) {
    let x2 = x * x;
    ((a[0] + a[1] * x) + (a[2] + a[3] * x) * x2, (b[0] + b[1] * x) + (b[2] + b[3] * x) * x2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tails_are_those_of_the_error_function_and_undone_by_their_inverse() {
        for i in 0..=3700 {
            let x = 0.01 * f64::from(i);
            let expected = 0.5 * libm::erfc(x * std::f64::consts::FRAC_1_SQRT_2);
            let single = x as f32;
            let expected_single = 0.5 * libm::erfc(f64::from(single) * std::f64::consts::FRAC_1_SQRT_2);
            let [tail, rest] = [upper_tail(single), upper_tail(-single)].map(f64::from);
            // From 13 on e^{−x²/2} is below what single precision holds.
            assert!((tail / expected_single - 1.0).abs() < 4e-6 || x > 13.0, "{x}: {tail}");
            assert!((rest - (1.0 - expected_single)).abs() < 2e-7, "-{x}");
            let found = f64::from(of_upper_tail(expected));
            // From 12.92 on the tail is below the least normal number.
            assert!((found - x).abs() < 4e-7 * (0.01 + x) || x > 12.92, "{x}: {found}");
            if x < 5.0 {
                // What 1 − tail has lost is more beyond.
                let found = f64::from(of_upper_tail(1.0 - expected));
                assert!((found + x).abs() < 4e-7 * (0.01 + x), "-{x}: {found}");
            }
        }
        assert_eq!(upper_tail(14.0), 0.0);
        assert!(of_upper_tail(f64::MIN_POSITIVE).is_finite() && of_upper_tail(1.0 - 1e-16).is_finite());
    }
}
