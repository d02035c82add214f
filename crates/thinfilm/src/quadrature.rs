//! Gauss–Legendre rules, and one of Gauss and Kronrod.

use std::f64::consts::PI;

/// A Gauss–Legendre rule on [−1, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// Where the integrand is read, ascending.
    pub nodes: Vec<f64>,
    /// What each value counts; they sum to 2.
    pub weights: Vec<f64>,
}

/// Roots found at a time.
const ROOTS: usize = 8;

/// The n-point rule, exact for polynomials of degree 2n − 1: Newton's iteration on Pₙ from Tricomi's estimate of its roots
/// (Press et al., *Numerical Recipes*, §4.6).
///
/// ```
/// let rule = thinfilm::quadrature::gauss_legendre(5);
/// let integral: f64 = rule.nodes.iter().zip(&rule.weights).map(|(x, w)| w * x.exp()).sum();
/// assert!((integral - 2.0 * 1f64.sinh()).abs() < 1e-8);
/// ```
#[must_use]
pub fn gauss_legendre(n: usize) -> Rule {
    let mut nodes = vec![0.0; n];
    let mut weights = vec![0.0; n];
    let half = n.div_ceil(2);
    // Roots side by side: each is a chain of divisions that wait for each other.
    for first in (0..half).step_by(ROOTS) {
        let mut x: [f64; ROOTS] =
            std::array::from_fn(|lane| (PI * ((first + lane) as f64 + 0.75) / (n as f64 + 0.5)).cos());
        let (mut slope, mut found) = ([1.0; ROOTS], [false; ROOTS]);
        for _ in 0..8 {
            let (mut p, mut before) = ([1.0; ROOTS], [0.0; ROOTS]);
            for k in 0..n {
                let k = k as f64;
                for lane in 0..ROOTS {
                    let next = ((2.0 * k + 1.0) * x[lane] * p[lane] - k * before[lane]) / (k + 1.0);
                    before[lane] = p[lane];
                    p[lane] = next;
                }
            }
            for lane in 0..ROOTS {
                if found[lane] {
                    continue;
                }
                slope[lane] = n as f64 * (x[lane] * p[lane] - before[lane]) / (x[lane] * x[lane] - 1.0);
                let step = p[lane] / slope[lane];
                x[lane] -= step;
                found[lane] = step.abs() < 1e-16;
            }
            if found == [true; ROOTS] {
                break;
            }
        }
        for (i, (x, slope)) in (first..half).zip(x.into_iter().zip(slope)) {
            let weight = 2.0 / ((1.0 - x * x) * slope * slope);
            nodes[i] = -x;
            weights[i] = weight;
            nodes[n - 1 - i] = x;
            weights[n - 1 - i] = weight;
        }
    }
    if n % 2 == 1 {
        nodes[n / 2] = 0.0;
    }
    Rule { nodes, weights }
}

/// Nodes x ≥ 0, Kronrod's 15 weights and Gauss's 7 (0 where he has no node): exact to degree 22 and 13 (A. S. Kronrod, 1964).
pub(crate) const GAUSS_KRONROD_15: [[f64; 3]; 8] = [
    [0.0, 0.209_482_141_084_727_83, 0.417_959_183_673_469_39],
    [0.207_784_955_007_898_47, 0.204_432_940_075_298_89, 0.0],
    [0.405_845_151_377_397_17, 0.190_350_578_064_785_41, 0.381_830_050_505_118_94],
    [0.586_087_235_467_691_13, 0.169_004_726_639_267_9, 0.0],
    [0.741_531_185_599_394_44, 0.140_653_259_715_525_92, 0.279_705_391_489_276_67],
    [0.864_864_423_359_769_07, 0.104_790_010_322_250_18, 0.0],
    [0.949_107_912_342_758_52, 0.063_092_092_629_978_553, 0.129_484_966_168_869_69],
    [0.991_455_371_120_812_64, 0.022_935_322_010_529_225, 0.0],
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kronrods_rule_is_exact_to_degree_22_and_gausss_to_13() {
        for degree in (0..=22).step_by(2) {
            let exact = 2.0 / f64::from(degree + 1);
            let sum = |column: usize| -> f64 {
                let term = |row: &[f64; 3]| {
                    row[column] * row[0].powi(degree) * if row[0] == 0.0 { 1.0 } else { 2.0 }
                };
                GAUSS_KRONROD_15.iter().map(term).sum()
            };
            assert!((sum(1) - exact).abs() < 1e-15, "{degree}: {}", sum(1));
            assert!(degree > 13 || (sum(2) - exact).abs() < 1e-15, "{degree}: {}", sum(2));
        }
    }

    #[test]
    fn the_rule_is_exact_for_polynomials_of_degree_2n_minus_1() {
        for n in [1, 2, 3, 7, 48, 64, 129] {
            let rule = gauss_legendre(n);
            let degree = 2 * n as i32 - 2;
            let integral = |odd: i32| -> f64 {
                let terms = rule.nodes.iter().zip(&rule.weights);
                terms.map(|(x, w)| w * (x.powi(degree) + x.powi(degree + odd))).sum()
            };
            let exact = 2.0 / f64::from(degree + 1);
            // Rounding of n terms.
            assert!((integral(1) - exact).abs() < 1e-13, "n = {n}: {} against {exact}", integral(1));
        }
    }
}
