//! The decay postulate for evaluation and sampling, in y = |sin(φ/2)|, which keeps its digits for narrow lobes.

use crate::numerics::angles::{INVERSE_TAU, greatest, least, turned};
use crate::numerics::single::{exp, exp_each, ln};

/// D(φ) of [`lut_io::decay`] at concentration x, from y² = sin²(φ/2).
#[inline(always)]
pub(crate) fn decay(x: f32, y2: f32) -> f32 {
    // D = e^{−2xy²}·(1 − e^{−2x(1−y²)})/(1 − e^{−2x}).
    if x < 1e-9 {
        return 1.0 - y2;
    }
    if x > NARROW {
        return narrow_decay(x, y2);
    }
    exp(-2.0 * x * y2) * one_minus_exp(2.0 * x * (1.0 - y2)) / one_minus_exp(2.0 * x)
}

/// Concentrations above which [`narrow_decay`] is exact enough.
pub(crate) const NARROW: f32 = 0.5;

/// [`decay`] short of a common factor: two exponentials. What cancels near 180° is small beside 1 − D.
#[inline(always)]
pub(crate) fn narrow_decay(x: f32, y2: f32) -> f32 {
    let [at, all] = exp_each([-2.0 * x * y2, -2.0 * x]);
    greatest(at - all, 0.0) / (1.0 - all)
}

/// 1 − e^{−z}, z ≥ 0.
#[inline(always)]
fn one_minus_exp(z: f32) -> f32 {
    if z > 0.1 {
        return 1.0 - exp(-z);
    }
    // Five terms: the next one is z⁵/720 of the first.
    z * (1.0 - z / 2.0 * (1.0 - z / 3.0 * (1.0 - z / 4.0 * (1.0 - z / 5.0))))
}

/// Density of φ ∈ (−π, π] that follows D within a bounded factor and inverts in closed form: uniform for x → 0
/// (where both halves of the plane lobe together do not depend on φ), sech² in y with the width of e^{−2xy²} for
/// large x.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Forward {
    /// Share of the sech² part.
    pub(crate) narrow: f32,
    pub(crate) k: f32,
    pub(crate) tanh_k: f32,
}

impl Forward {
    #[inline(always)]
    pub(crate) fn new(x: f32) -> Self {
        // sech²(ky) stays within 9 % of the Gaussian's core for k = 0.8/sd, and sd = 1/(2√x).
        let k = greatest(1.6 * x.sqrt(), 1e-4);
        let e = exp(-2.0 * k);
        Self { narrow: x / (x + 0.25), k, tanh_k: (1.0 - e) / (1.0 + e) }
    }

    /// Density per radian of φ.
    #[inline(always)]
    pub(crate) fn pdf(&self, y2: f32) -> f32 {
        let y = y2.sqrt();
        let e = exp(-2.0 * self.k * y);
        let sech2 = 4.0 * e / ((1.0 + e) * (1.0 + e));
        let cos_half = greatest(1.0 - y2, 0.0).sqrt();
        (1.0 - self.narrow) * INVERSE_TAU as f32
            + self.narrow * 0.25 * cos_half * self.k * sech2 / self.tanh_k
    }

    /// φ ∈ [−π, π], as (cos φ, sin φ).
    #[inline(always)]
    pub(crate) fn sample(&self, u: f64) -> (f64, f64) {
        let [narrow, k, tanh_k] = [self.narrow, self.k, self.tanh_k].map(f64::from);
        // The sign from one half of u, the branch from what is left; both branches are worked out, one is taken.
        let (sign, u) = if u < 0.5 { (1.0, 2.0 * u) } else { (-1.0, 2.0 * u - 1.0) };
        let (wide_cos, wide_sin) = turned(0.5 * ((u - narrow) / greatest(1.0 - narrow, f64::MIN_POSITIVE)));
        // In single precision 1 − t has lost its digits only where less than a part in 1e7 lies beyond.
        let t = least((u / narrow * tanh_k) as f32, 1.0 - f32::EPSILON);
        let y = least(f64::from(0.5 * ln((1.0 + t) / (1.0 - t))) / k, 1.0);
        // y = sin(φ/2).
        let (narrow_cos, narrow_sin) = (1.0 - 2.0 * y * y, 2.0 * y * (1.0 - y * y).sqrt());
        let (cos, sin) = if u < narrow { (narrow_cos, narrow_sin) } else { (wide_cos, wide_sin) };
        (cos, sign * sin)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::TAU;

    #[test]
    fn decay_is_that_of_the_table() {
        for x in [0.0, 1e-12, 1e-6, 4e-3, 6e-3, 0.3, 7.0, 400.0, 1e7] {
            for degrees in [0.0, 1e-3, 1.0, 30.0, 90.0, 150.0, 179.0, 180.0f64] {
                let half = 0.5 * degrees.to_radians();
                let expected = lut_io::decay::decay(x, degrees.to_radians().cos());
                let found = f64::from(decay(x as f32, half.sin().powi(2) as f32));
                // x and y² are rounded to single precision: a part in 1e7 of the exponent.
                assert!((found - expected).abs() < 1e-6, "{x} {degrees}: {found} {expected}");
            }
        }
    }

    #[test]
    fn the_sampling_density_is_that_of_the_samples_and_bounds_the_decay() {
        let n = 20_000;
        for x in [0.0, 0.01, 0.5, 5.0, 300.0, 1e6f64] {
            let forward = Forward::new(x as f32);
            // Distribution function of the stratified samples against the integral of the density.
            for limit in [0.05 / (1.0 + x).sqrt(), 0.5 / (1.0 + x).sqrt(), 1.0 / (1.0 + x).sqrt(), 2.0] {
                let within = (0..n)
                    .filter(|i| {
                        let (cos, sin) = forward.sample((f64::from(*i) + 0.5) / f64::from(n));
                        sin.abs().atan2(cos) < limit
                    })
                    .count() as f64
                    / f64::from(n);
                let m = 4000;
                let integral: f64 = (0..m)
                    .map(|j| (0.5 * limit * (f64::from(j) + 0.5) / f64::from(m)).sin().powi(2))
                    .map(|y2| f64::from(forward.pdf(y2 as f32)))
                    .sum::<f64>()
                    * 2.0
                    * limit
                    / f64::from(m);
                // One stratum on either side, and the midpoint rule.
                assert!((within - integral).abs() < 3e-4, "{x} {limit}: {within} {integral}");
            }
            let mean = TAU * lut_io::decay::mean_decay(x);
            for j in 0..1000 {
                let y2 = (0.5 * std::f64::consts::PI * f64::from(j) / 1000.0).sin().powi(2);
                let [decay, pdf] = [decay(x as f32, y2 as f32), forward.pdf(y2 as f32)].map(f64::from);
                let weight = decay / mean / pdf;
                assert!(weight < 2.001, "{x} {y2}: {weight}");
            }
        }
    }
}
