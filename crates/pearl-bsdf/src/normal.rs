//! Tails of the standard normal distribution, and the other way.

use crate::angles::ln;
use crate::single::exp;

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

/// x of P(X > x) = tail, 0 < tail < 1: Wichura's algorithm AS 241 (Applied Statistics 37, 1988), PPND16.
#[inline]
pub(crate) fn of_upper_tail(tail: f64) -> f64 {
    #[rustfmt::skip]
    const CENTRE: [[f64; 8]; 2] = [
        [3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3, 1.3731693765509461125e4,
         4.5921953931549871457e4, 6.7265770927008700853e4, 3.3430575583588128105e4, 2.5090809287301226727e3],
        [1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3,
         2.1213794301586595867e4, 3.9307895800092710610e4, 2.8729085735721942674e4, 5.2264952788528545610e3],
    ];
    #[rustfmt::skip]
    const NEAR: [[f64; 8]; 2] = [
        [1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0, 3.64784832476320460504e0,
         1.27045825245236838258e0, 2.41780725177450611770e-1, 2.27238449892691845833e-2, 7.74545014278341407640e-4],
        [1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1,
         1.48103976427480074590e-1, 1.51986665636164571966e-2, 5.47593808499534494600e-4, 1.05075007164441684324e-9],
    ];
    #[rustfmt::skip]
    const FAR: [[f64; 8]; 2] = [
        [6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0, 2.96560571828504891230e-1,
         2.65321895265761230930e-2, 1.24266094738807843860e-3, 2.71155556874348757815e-5, 2.01033439929228813265e-7],
        [1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2,
         7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7, 2.04426310338993978564e-15],
    ];
    let q = 0.5 - tail;
    if q.abs() <= 0.425 {
        return q * ratio(&CENTRE, 0.180_625 - q * q);
    }
    let r = (-ln(if q > 0.0 { tail } else { 1.0 - tail })).sqrt();
    let x = if r <= 5.0 { ratio(&NEAR, r - 1.6) } else { ratio(&FAR, r - 5.0) };
    x.copysign(q)
}

/// Ratio of two polynomials.
#[inline(always)]
fn ratio([over, under]: &[[f64; 8]; 2], x: f64) -> f64 {
    let (x2, x4) = (x * x, x * x * x * x);
    let of = |c: &[f64; 8]| {
        let four = |k: usize| (c[k] + c[k + 1] * x) + (c[k + 2] + c[k + 3] * x) * x2;
        four(0) + four(4) * x4
    };
    of(over) / of(under)
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
            // ln keeps 1e-12, and the tail above moves x by its relative error over x.
            assert!(
                (of_upper_tail(expected) - x).abs() < 1e-11 * (1.0 + x),
                "{x}: {}",
                of_upper_tail(expected)
            );
            if x < 5.0 {
                // What 1 − tail has lost is more beyond.
                assert!((of_upper_tail(1.0 - expected) + x).abs() < 1e-9, "-{x}");
            }
        }
        assert_eq!(upper_tail(14.0), 0.0);
        assert!(of_upper_tail(f64::MIN_POSITIVE).is_finite() && of_upper_tail(1.0 - 1e-16).is_finite());
    }
}
