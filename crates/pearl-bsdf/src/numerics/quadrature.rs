//! Gauss–Legendre rules and smooth curves through few nodes, for what is computed once when a table is loaded.

/// Nodes and weights of the n-point Gauss–Legendre rule on [−1, 1].
pub(crate) fn gauss_legendre(n: usize) -> Vec<(f64, f64)> {
    let rule = thinfilm::quadrature::gauss_legendre(n);
    rule.nodes.into_iter().zip(rule.weights).collect()
}

/// Cubic spline through equidistant nodes 0, 1, 2, …, read at x in units of the step: of a curve that is even about its first
/// node (flat there), natural at the last.
pub(crate) struct Spline {
    y: Vec<f64>,
    second: Vec<f64>,
}

impl Spline {
    /// Through at least two values.
    pub(crate) fn new(y: Vec<f64>) -> Self {
        let n = y.len();
        let mut second = vec![0.0; n];
        let mut upper = vec![0.0; n];
        // Tridiagonal system m[i−1] + 4 m[i] + m[i+1] = 6(y[i−1] − 2y[i] + y[i+1]), 2m[0] + m[1] = 6(y[1] − y[0]) at the flat
        // end, m = 0 at the other (Thomas).
        upper[0] = 0.5;
        second[0] = 3.0 * (y[1] - y[0]);
        for i in 1..n - 1 {
            let pivot = 4.0 - upper[i - 1];
            upper[i] = 1.0 / pivot;
            second[i] = (6.0 * (y[i - 1] - 2.0 * y[i] + y[i + 1]) - second[i - 1]) / pivot;
        }
        for i in (0..n - 1).rev() {
            second[i] -= upper[i] * second[i + 1];
        }
        Self { y, second }
    }

    /// The value at x, in steps from the first node; clamped to the ends.
    pub(crate) fn at(&self, x: f64) -> f64 {
        let i = (x.max(0.0) as usize).min(self.y.len() - 2);
        let b = (x - i as f64).clamp(0.0, 1.0);
        let a = 1.0 - b;
        let bend = (a * a * a - a) * self.second[i] + (b * b * b - b) * self.second[i + 1];
        a * self.y[i] + b * self.y[i + 1] + bend / 6.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_spline_follows_a_smooth_curve() {
        let spline = Spline::new((0..=90).map(|i| f64::from(i).to_radians().cos()).collect());
        let worst = (0..800)
            .map(|i| 0.1 * f64::from(i))
            .map(|x| (spline.at(x) - x.to_radians().cos()).abs())
            .fold(0.0, f64::max);
        // h⁴/384 is 2e-10 for one-degree steps; what the natural end misses falls by 0.27 a step, ten steps here.
        assert!(worst < 1e-9, "{worst}");
    }
}
