//! The azimuth postulate ("decay"): how far a plane lobe reaches out of the plane of incidence.
//!
//! D(φ) = [E(φ) − E(180°)] / [1 − E(180°)], E(φ) = exp((cos φ − 1)·sin θi·sin θo / w²). D falls from 1 at
//! φ = 0 to 0 at 180°; where sin θi·sin θo → 0 it tends to (1 + cos φ)/2 and f no longer depends on φ as the
//! plane density is then even. From the plane density p(s | θi) with total A:
//! f cos θo = A·g/∫g dω, g = p(+θo)·D + p(−θo)·(1 − D).

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

/// [`decay`] at several azimuths; as a share of 1, not of itself, it is exact to rounding.
#[must_use]
pub fn decays<const N: usize>(x: f64, cos_phi: [f64; N]) -> [f64; N] {
    // Below, the difference of the exponentials would lose digits.
    const LEAST: f64 = 0.1;
    if x < LEAST {
        return cos_phi.map(|cos_phi| decay(x, cos_phi));
    }
    let end = (-2.0 * x).exp();
    let scale = 1.0 / (1.0 - end);
    cos_phi.map(|cos_phi| (((cos_phi - 1.0) * x).exp() - end) * scale)
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
    without_end(scaled_bessel_i0(x), x)
}

/// [`mean_decay`] of several concentrations at once, which share the arithmetic of their series (to rounding the same values).
pub(crate) fn mean_decays<const N: usize>(x: [f64; N]) -> [f64; N] {
    let all = |from: f64, to: f64| x.iter().all(|x| (from..to).contains(x));
    if all(NEAR, f64::INFINITY) {
        let bessel = chebyshev(&I0_FAR, x.map(|x| 16.0 / x - 1.0));
        return std::array::from_fn(|k| without_end(bessel[k] / x[k].sqrt(), x[k]));
    }
    if all(0.1, NEAR) {
        let bessel = chebyshev(&I0_NEAR, x.map(|x| 0.25 * x - 1.0));
        return std::array::from_fn(|k| without_end(bessel[k], x[k]));
    }
    x.map(mean_decay)
}

/// (e^{−x}I₀(x) − e^{−2x}) / (1 − e^{−2x}) from its first term.
fn without_end(bessel: f64, x: f64) -> f64 {
    if x > 20.0 {
        return bessel; // e^{−2x} is less than half an ulp of it
    }
    let e2 = (-2.0 * x).exp();
    (bessel - e2) / (1.0 - e2)
}

/// e^{−x}·I₀(x), x ≥ 0, relative error below 1e-15.
///
/// Chebyshev series on [0, 8] and, for √x·e^{−x}·I₀(x), in 16/x − 1 beyond (the split of Clenshaw 1962 and of
/// Cephes' `i0e`); the coefficients were computed to 40 digits from I₀ itself.
#[must_use]
pub fn scaled_bessel_i0(x: f64) -> f64 {
    if x <= NEAR {
        return chebyshev(&I0_NEAR, [0.25 * x - 1.0])[0];
    }
    chebyshev(&I0_FAR, [16.0 / x - 1.0])[0] / x.sqrt()
}

/// ½c₀ + Σ cₙTₙ(y) by Clenshaw's recurrence.
fn chebyshev<const N: usize>(coefficients: &[f64], y: [f64; N]) -> [f64; N] {
    let (mut b1, mut b2) = ([0.0; N], [0.0; N]);
    for &c in coefficients[1..].iter().rev() {
        let next = std::array::from_fn(|k| 2.0 * y[k] * b1[k] - b2[k] + c);
        (b1, b2) = (next, b1);
    }
    std::array::from_fn(|k| y[k] * b1[k] - b2[k] + 0.5 * coefficients[0])
}

/// Where the one series of the Bessel function ends and the other begins.
const NEAR: f64 = 8.0;

#[rustfmt::skip]
const I0_NEAR: [f64; 30] = [
    0.676795274409476085,
    -0.304682672343198399,
    0.171620901522208775,
    -0.0949010970480476444,
    0.0493052842396707085,
    -0.0237374148058994688,
    0.0105464603945949983,
    -0.00432430999505057594,
    0.0016394756169413358,
    -0.000576375574538582366,
    0.000188502885095841656,
    -0.000057541950100821037,
    0.0000164484480707288971,
    -4.41673835845875056e-6,
    1.11738753912010372e-6,
    -2.67079385394061173e-7,
    6.04699502254191895e-8,
    -1.30002500998624804e-8,
    2.65982372468238665e-9,
    -5.18979560163526291e-10,
    9.67580903537323691e-11,
    -1.72682629144155571e-11,
    2.95505266312963983e-12,
    -4.85644678311192946e-13,
    7.67618549860493562e-14,
    -1.16853328779934517e-14,
    1.71539128555513303e-15,
    -2.43127984654795469e-16,
    3.3307945188222381e-17,
    -4.41534164647933938e-18,
];

#[rustfmt::skip]
const I0_FAR: [f64; 25] = [
    0.804490411014108832,
    0.00336911647825569409,
    0.0000688975834691682398,
    2.89137052083475648e-6,
    2.04891858946906374e-7,
    2.26666899049817806e-8,
    3.39623202570838635e-9,
    4.94060238822496959e-10,
    1.18891471078464383e-11,
    -3.14991652796324136e-11,
    -1.32158118404477131e-11,
    -1.79417853150680612e-12,
    7.18012445138366623e-13,
    3.8527783827421427e-13,
    1.54008621752140983e-14,
    -4.15056934728722209e-14,
    -9.55484669882830765e-15,
    3.81168066935262242e-15,
    1.77256013305652638e-15,
    -3.42548561967721913e-16,
    -2.82762398051658348e-16,
    3.46122286769746109e-17,
    4.46562142029676e-17,
    -4.83050448594418207e-18,
    -7.23318048788475395e-18,
];

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
    fn several_decays_are_each_by_itself() {
        let cosines = [-1.0, -0.99, -0.3, 0.0, 0.6, 0.999, 1.0];
        for x in [0.0, 1e-6, 0.099, 0.1, 0.7, 30.0, 4e4] {
            for (found, cosine) in decays(x, cosines).into_iter().zip(cosines) {
                let expected = decay(x, cosine);
                assert!((found - expected).abs() <= 4e-15, "{x} {cosine}: {found} {expected}");
            }
        }
    }

    #[test]
    fn several_mean_decays_are_each_by_itself() {
        let x = [0.0, 1e-10, 0.05, 0.1, 0.5, 7.9, 8.0, 8.1, 19.0, 20.5, 700.0];
        for triple in x.windows(3) {
            let triple = [triple[0], triple[1], triple[2]];
            for (found, expected) in mean_decays(triple).into_iter().zip(triple.map(mean_decay)) {
                assert!(
                    (found - expected).abs() <= 4.0 * f64::EPSILON * expected,
                    "{triple:?}: {found} {expected}"
                );
            }
        }
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
