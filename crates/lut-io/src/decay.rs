//! The azimuth postulate ("decay"): how far a plane lobe reaches out of the plane of incidence.
//!
//! D(φ) = [E(φ) − E(180°)] / [1 − E(180°)], E(φ) = exp((cos φ − 1)·sin θi·sin θo / w²). D falls from 1 at
//! φ = 0 to 0 at 180°; where sin θi·sin θo → 0 it tends to (1 + cos φ)/2 and f no longer depends on φ as the
//! plane density is then even. From the plane density p(s | θi) with total A:
//! f cos θo = A·g/∫g dω, g = p(+θo)·D + p(−θo)·(1 − D).

use std::f64::consts::TAU;

/// The concentration x = sin θi·sin θo / w² of the decay.
#[must_use]
pub fn concentration(theta_i: f64, theta_o: f64, width: f64) -> f64 {
    theta_i.sin() * theta_o.sin().abs() / (width * width)
}

/// D(φ) for a concentration x ≥ 0.
#[must_use]
pub fn decay(x: f64, cos_phi: f64) -> f64 {
    // E(φ) − E(180°) = e^{−2x}·expm1((1 + cos φ)·x); the ratio of expm1s keeps its digits as x → 0.
    let reach = 0.5 * (1.0 + cos_phi);
    if x < 1e-300 {
        return reach;
    }
    // Divided through by e^{2x}, so that nothing overflows for a narrow lobe.
    let decayed = (-2.0 * x * (1.0 - reach)).exp();
    decayed * (-(-2.0 * x * reach).exp_m1()) / -(-2.0 * x).exp_m1()
}

/// Mean of D over all azimuths, (e^{−x}I₀(x) − e^{−2x}) / (1 − e^{−2x}).
#[must_use]
pub fn mean_decay(x: f64) -> f64 {
    if x < 1e-9 {
        return 0.5;
    }
    let e2 = (-2.0 * x).exp();
    // e^{-x}I0(x) - e^{-2x} cancels for small x: there, e^{-2x}(e^{x}I0(x) - 1) by its series.
    if x < 0.1 {
        // e^x I0(x) = Σ binom(2n, n)/(2^n n!) x^n (generating function of the central binomials).
        let (mut term, mut sum) = (1.0, 0.0);
        for n in 1..24 {
            let n = f64::from(n);
            term *= x * (2.0 * n - 1.0) / (n * n);
            sum += term;
        }
        return e2 * sum / -(-2.0 * x).exp_m1();
    }
    (scaled_bessel_i0(x) - e2) / (1.0 - e2)
}

/// e^{−x}·I₀(x) by the trapezoidal rule on its integral, which converges exponentially for a periodic
/// integrand; the number of nodes follows the width 1/√x of the peak. Relative error below 1e-14.
#[must_use]
pub fn scaled_bessel_i0(x: f64) -> f64 {
    if x > 700.0 {
        // Asymptotic series (Abramowitz & Stegun 9.7.1), terms (1·9·25…)/(n!(8x)^n).
        let (mut term, mut sum) = (1.0, 1.0);
        for n in 1..9 {
            let n = f64::from(n);
            term *= (2.0 * n - 1.0).powi(2) / (n * 8.0 * x);
            sum += term;
        }
        return sum / (TAU * x).sqrt();
    }
    let nodes = 32 + 8 * (x.sqrt() as usize + 1);
    let sum: f64 = (0..nodes).map(|i| (x * ((TAU * i as f64 / nodes as f64).cos() - 1.0)).exp()).sum();
    sum / nodes as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn decay_falls_from_one_to_zero_and_equals_its_definition() {
        for x in [1e-12, 1e-3, 0.7, 30.0, 400.0] {
            assert!((decay(x, 1.0) - 1.0).abs() < 1e-14 && decay(x, -1.0).abs() < 1e-14, "{x}");
            let values: Vec<f64> = (0..=180).map(|d| decay(x, f64::from(d).to_radians().cos())).collect();
            assert!(values.windows(2).all(|v| v[1] <= v[0] + 1e-15), "{x}");
        }
        for (x, cos_phi) in [(0.7, 0.3), (5.0, -0.2), (30.0, 0.9)] {
            let e = |c: f64| (x * (c - 1.0)).exp();
            let naive = (e(cos_phi) - e(-1.0)) / (1.0 - e(-1.0));
            assert!((decay(x, cos_phi) - naive).abs() < 1e-14);
        }
        assert!(decay(1e9, 0.5) == 0.0 && decay(0.0, 0.0) == 0.5);
    }

    #[test]
    fn mean_decay_is_the_mean_of_decay() {
        for x in [0.0, 1e-12, 1e-6, 0.01, 0.0999, 0.1001, 1.0, 17.0, 300.0, 699.0, 701.0, 5e3] {
            let n = 20_000;
            let mean =
                (0..n).map(|i| decay(x, (PI * (f64::from(i) + 0.5) / f64::from(n)).cos())).sum::<f64>()
                    / f64::from(n);
            assert!((mean_decay(x) / mean - 1.0).abs() < 1e-9, "{x}: {} {mean}", mean_decay(x));
        }
    }
}
