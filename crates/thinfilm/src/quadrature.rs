//! Gauss–Legendre rules.

use std::f64::consts::PI;

/// A Gauss–Legendre rule on [−1, 1].
#[derive(Clone, Debug, PartialEq)]
pub struct Rule {
    /// Where the integrand is read, ascending.
    pub nodes: Vec<f64>,
    /// What each value counts; they sum to 2.
    pub weights: Vec<f64>,
}

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
    for i in 0..n.div_ceil(2) {
        let mut x = (PI * (i as f64 + 0.75) / (n as f64 + 0.5)).cos();
        let mut slope = 1.0;
        for _ in 0..8 {
            let (mut p, mut before) = (1.0, 0.0);
            for k in 0..n {
                let k = k as f64;
                let next = ((2.0 * k + 1.0) * x * p - k * before) / (k + 1.0);
                before = p;
                p = next;
            }
            slope = n as f64 * (x * p - before) / (x * x - 1.0);
            let step = p / slope;
            x -= step;
            if step.abs() < 1e-16 {
                break;
            }
        }
        let weight = 2.0 / ((1.0 - x * x) * slope * slope);
        nodes[i] = -x;
        weights[i] = weight;
        nodes[n - 1 - i] = x;
        weights[n - 1 - i] = weight;
    }
    if n % 2 == 1 {
        nodes[n / 2] = 0.0;
    }
    Rule { nodes, weights }
}

#[cfg(test)]
mod tests {
    use super::*;

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
