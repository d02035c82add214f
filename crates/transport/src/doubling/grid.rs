//! Angular grids: Gauss–Legendre rules and the polynomial bases that value functions live in.

use std::f64::consts::{FRAC_PI_2, PI};
use std::sync::OnceLock;

use pulp::Arch;
use thinfilm::quadrature::{Rule, gauss_legendre};

use super::matrix::Matrix;
use crate::Geometry;

/// Largest rule that [`segment_rule`] keeps.
pub(super) const LARGEST_SEGMENT_RULE: usize = 160;

/// A shared rule for a segment of the facet integral, 1 ≤ n ≤ [`LARGEST_SEGMENT_RULE`].
pub(super) fn segment_rule(n: usize) -> &'static Rule {
    static RULES: [OnceLock<Rule>; LARGEST_SEGMENT_RULE + 1] =
        [const { OnceLock::new() }; LARGEST_SEGMENT_RULE + 1];
    let n = n.clamp(1, LARGEST_SEGMENT_RULE);
    RULES[n].get_or_init(|| gauss_legendre(n))
}

/// The nodes of one hemisphere of directions, the same in every medium, and the basis of value functions on it.
///
/// A value function v(ω) is expanded in *modes*. Space: v = Σ_m v_m(θ) cos mφ and mode m is sinᵖθ times a
/// polynomial in μ = cos θ of degree < N, p = m mod 2. Plane: mode 0 is the even part of v(s), a polynomial in s²
/// of degree < N, and mode 1 the odd part, s times such a polynomial. So m mod 2 is the parity in both.
#[derive(Clone, Debug)]
pub(super) struct Grid {
    pub(super) geometry: Geometry,
    /// θ_j, radians in (0, π/2).
    pub(super) theta: Vec<f64>,
    /// Quadrature weights: in μ on (0, 1) (space), in θ on (0, π/2) (plane).
    pub(super) weights: Vec<f64>,
    /// \[parity\]: cardinal functions from Legendre moments, ℓ_j = Σ_n to_nodes\[j, n\]·P_n.
    to_nodes: [Matrix; 2],
    /// Nodes of the rule on [−1, 1] with their barycentric weights: the cardinal functions point by point.
    barycentric: Vec<(f64, f64)>,
}

impl Grid {
    pub(super) fn new(geometry: Geometry, nodes: usize) -> Self {
        match geometry {
            Geometry::Plane => Self::plane(nodes),
            Geometry::Space => Self::space(nodes),
        }
    }

    fn space(n: usize) -> Self {
        let rule = gauss_legendre(n);
        let mu: Vec<f64> = rule.nodes.iter().map(|t| 0.5 * (t + 1.0)).collect();
        let theta: Vec<f64> = mu.iter().map(|mu| mu.acos()).collect();
        let sines: Vec<f64> = mu.iter().map(|mu| ((1.0 - mu) * (1.0 + mu)).sqrt()).collect();
        let mut to_nodes = [Matrix::zeros(n, n), Matrix::zeros(n, n)];
        for j in 0..n {
            legendre(rule.nodes[j], n, |k, p| {
                let cardinal = 0.5 * rule.weights[j] * (2 * k + 1) as f64 * p;
                to_nodes[0][(j, k)] = cardinal;
                to_nodes[1][(j, k)] = cardinal / sines[j];
            });
        }
        let weights: Vec<f64> = rule.weights.iter().map(|w| 0.5 * w).collect();
        close(&mut to_nodes[0], &weights, 1);
        Self { geometry: Geometry::Space, theta, weights, to_nodes, barycentric: barycentric(&rule) }
    }

    fn plane(n: usize) -> Self {
        let rule = gauss_legendre(2 * n);
        let mut to_nodes = [Matrix::zeros(n, n), Matrix::zeros(n, n)];
        for j in 0..n {
            legendre(rule.nodes[n + j], 2 * n, |k, p| {
                to_nodes[k % 2][(j, k / 2)] = rule.weights[n + j] * (2 * k + 1) as f64 * p;
            });
        }
        let theta: Vec<f64> = rule.nodes[n..].iter().map(|t| FRAC_PI_2 * t).collect();
        let weights: Vec<f64> = rule.weights[n..].iter().map(|w| FRAC_PI_2 * w).collect();
        close(&mut to_nodes[0], &rule.weights[n..], 1);
        Self { geometry: Geometry::Plane, theta, weights, to_nodes, barycentric: barycentric(&rule) }
    }

    pub(super) fn len(&self) -> usize {
        self.theta.len()
    }

    /// Degree bound of the Legendre polynomials in the argument of [`Grid::argument`].
    pub(super) fn polynomials(&self) -> usize {
        match self.geometry {
            Geometry::Plane => 2 * self.len(),
            Geometry::Space => self.len(),
        }
    }

    /// See [`Grid`]: node values of a mode from its Legendre moments.
    pub(super) fn to_nodes(&self, mode: usize) -> &Matrix {
        &self.to_nodes[mode % 2]
    }

    /// Legendre argument of a direction: space from μ, plane from the signed angle.
    pub(super) fn argument(&self, theta: f64) -> f64 {
        match self.geometry {
            Geometry::Plane => theta / FRAC_PI_2,
            Geometry::Space => 2.0 * theta.cos() - 1.0,
        }
    }

    /// The basis functions of both parities, one row for each polar angle θ ≥ 0 (plane: signed s): `rows[p][(k, j)]` is
    /// (s/s_j)ᵖ·ℓ_j(θ_k).
    pub(super) fn cardinals(&self, theta: &[f64]) -> [Matrix; 2] {
        let all = self.cardinals_at(&theta.iter().map(|&theta| self.argument(theta)).collect::<Vec<f64>>());
        let n = self.len();
        if self.geometry == Geometry::Space {
            let sines: Vec<f64> = theta.iter().map(|theta| theta.sin()).collect();
            let mut odd = all.clone();
            for (j, node) in self.theta.iter().enumerate() {
                let inverse = 1.0 / node.sin();
                let column = odd.column_mut(j).iter_mut().zip(&sines);
                column.for_each(|(value, sine)| *value *= sine * inverse);
            }
            return [all, odd];
        }
        // Node j and its mirror image.
        let pair = |sign: f64| {
            let mut rows = Matrix::zeros(theta.len(), n);
            for j in 0..n {
                let pairs = all.column(n + j).iter().zip(all.column(n - 1 - j));
                rows.column_mut(j).iter_mut().zip(pairs).for_each(|(row, (a, b))| *row = a + sign * b);
            }
            rows
        };
        [pair(1.0), pair(-1.0)]
    }

    /// All cardinal functions of the rule at each t (rows), by the barycentric formula: as many operations as nodes, and stable
    /// where t comes near one of them (Berrut & Trefethen, SIAM Review 46, 2004, 501).
    fn cardinals_at(&self, t: &[f64]) -> Matrix {
        let mut all = Matrix::zeros(t.len(), self.barycentric.len());
        let mut sums = vec![0.0; t.len()];
        for (j, (node, weight)) in self.barycentric.iter().enumerate() {
            for ((value, sum), t) in all.column_mut(j).iter_mut().zip(&mut sums).zip(t) {
                *value = weight / (t - node);
                *sum += *value;
            }
        }
        let scale: Vec<f64> = sums.iter().map(|sum| 1.0 / sum).collect();
        for j in 0..self.barycentric.len() {
            all.column_mut(j).iter_mut().zip(&scale).for_each(|(value, scale)| *value *= scale);
        }
        // On a node the formula is ∞/∞.
        for (row, _) in sums.iter().enumerate().filter(|(_, sum)| !sum.is_finite()) {
            for (j, (node, _)) in self.barycentric.iter().enumerate() {
                all[(row, j)] = if *node == t[row] { 1.0 } else { 0.0 };
            }
        }
        all
    }

    /// Plane: some functions at signed angles, from their coefficients in both parities (columns), by the barycentric formula itself.
    pub(super) fn interpolated<const F: usize>(&self, s: &[f64], functions: [&Matrix; F]) -> [Vec<f64>; F] {
        assert_eq!(self.geometry, Geometry::Plane, "signed angles are those of a plane");
        // At each node of the rule on [−1, 1].
        let n = self.len();
        let at_node = |function: &Matrix, k: usize| match k.checked_sub(n) {
            Some(j) => function[(j, 0)] + function[(j, 1)],
            None => function[(n - 1 - k, 0)] - function[(n - 1 - k, 1)],
        };
        let nodes: Vec<(f64, f64, [f64; F])> = (0..2 * n)
            .zip(&self.barycentric)
            .map(|(k, (node, weight))| (*node, *weight, functions.map(|function| at_node(function, k))))
            .collect();
        let arguments: Vec<f64> = s.iter().map(|s| self.argument(*s)).collect();
        let mut values = functions.map(|_| Vec::with_capacity(s.len()));
        Arch::new().dispatch(|| {
            for chunk in arguments.chunks(TOGETHER) {
                // Beyond all nodes, where it does no harm.
                let mut t = [2.0; TOGETHER];
                t[..chunk.len()].copy_from_slice(chunk);
                let sums = barycentric_sums(&t, &nodes);
                for (values, sums) in values.iter_mut().zip(sums) {
                    values.extend_from_slice(&sums[..chunk.len()]);
                }
            }
        });
        values
    }

    /// Factor that turns the deposit at node j of a mode into the density there: per radian of s (plane), per
    /// steradian (space).
    pub(super) fn density_factor(&self, j: usize, mode: usize) -> f64 {
        match (self.geometry, mode) {
            (Geometry::Plane, _) => 0.5 / self.weights[j],
            (Geometry::Space, 0) => 0.5 / (PI * self.weights[j]),
            (Geometry::Space, _) => 1.0 / (PI * self.weights[j]),
        }
    }

    /// ∫ θᵏ against the density that a mode-0 (plane: parity k mod 2) deposit stands for: weights on the deposit.
    ///
    /// In the plane θᵏ is in the basis. In space θ(μ) has a square root at μ = 1, so it is integrated against the
    /// interpolant on a finer grid instead of being read at the nodes.
    pub(super) fn power_weights(&self, power: i32) -> Vec<f64> {
        let n = self.len();
        if self.geometry == Geometry::Plane {
            return self.theta.iter().map(|t| t.powi(power)).collect();
        }
        let fine = gauss_legendre(2 * n + 24);
        let theta: Vec<f64> = fine.nodes.iter().map(|t| 0.5 * FRAC_PI_2 * (t + 1.0)).collect();
        let [even, _] = self.cardinals(&theta);
        (0..n)
            .map(|j| {
                let terms = theta.iter().zip(&fine.weights).zip(even.column(j));
                let integral: f64 = terms
                    .map(|((theta, w), l)| 0.5 * FRAC_PI_2 * w * theta.sin() * theta.powi(power) * l)
                    .sum();
                integral / self.weights[j]
            })
            .collect()
    }
}

/// Arguments that [`barycentric_sums`] has in registers.
const TOGETHER: usize = 16;

/// Functions at some arguments, from nodes, barycentric weights and values there.
#[inline(always)]
fn barycentric_sums<const F: usize>(
    t: &[f64; TOGETHER],
    nodes: &[(f64, f64, [f64; F])],
) -> [[f64; TOGETHER]; F] {
    let (mut ones, mut sums) = ([0.0; TOGETHER], [[0.0; TOGETHER]; F]);
    for (node, weight, values) in nodes {
        for k in 0..TOGETHER {
            let share = weight / (t[k] - node);
            ones[k] += share;
            for f in 0..F {
                sums[f][k] += share * values[f];
            }
        }
    }
    for k in 0..TOGETHER {
        // On a node the formula is ∞/∞.
        let on = if ones[k].is_finite() { None } else { nodes.iter().find(|(node, ..)| *node == t[k]) };
        for f in 0..F {
            sums[f][k] = on.map_or(sums[f][k] / ones[k], |(.., values)| values[f]);
        }
    }
    sums
}

/// Nodes and barycentric weights (−1)ᵏ√((1 − t²)w) of a Gauss–Legendre rule (Wang & Xiang, Math. Comp. 81, 2012, 861).
fn barycentric(rule: &Rule) -> Vec<(f64, f64)> {
    let sign = |k: usize| if k.is_multiple_of(2) { 1.0 } else { -1.0 };
    let pairs = rule.nodes.iter().zip(&rule.weights).enumerate();
    pairs.map(|(k, (t, w))| (*t, sign(k) * ((1.0 - t) * (1.0 + t) * w).sqrt())).collect()
}

/// Takes the rounding out of Σ_j to_nodes\[j, n\] = 0 for n ≥ `first`, which would cost n² ulps of energy at grazing and
/// at the pole, where all P_n are ±1.
fn close(to_nodes: &mut Matrix, weights: &[f64], first: usize) {
    for k in first..to_nodes.columns() {
        for _ in 0..2 {
            let excess: f64 = to_nodes.column(k).iter().sum();
            for (value, w) in to_nodes.column_mut(k).iter_mut().zip(weights) {
                *value -= w * excess;
            }
        }
    }
}

/// Calls `visit(k, P_k(t))` for k < count.
pub(super) fn legendre(t: f64, count: usize, mut visit: impl FnMut(usize, f64)) {
    let (mut p, mut before) = (1.0, 0.0);
    for k in 0..count {
        visit(k, p);
        let order = k as f64;
        let next = ((2.0 * order + 1.0) * t * p - order * before) / (order + 1.0);
        before = p;
        p = next;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cardinal_functions_interpolate_and_sum_to_one() {
        for geometry in [Geometry::Plane, Geometry::Space] {
            let grid = Grid::new(geometry, 24);
            for theta in [0.0, 0.3, 1.2, 1.57] {
                let [even, _] = grid.cardinals(&[theta]);
                assert!(
                    ((0..24).map(|j| even[(0, j)]).sum::<f64>() - 1.0).abs() < 1e-12,
                    "{geometry:?} {theta}"
                ); // rounding × Lebesgue constant
            }
            let [even, odd] = grid.cardinals(&[grid.theta[5]]);
            for j in 0..24 {
                let expected = f64::from(u8::from(j == 5));
                assert!(
                    (even[(0, j)] - expected).abs() < 1e-11 && (odd[(0, j)] - expected).abs() < 1e-11,
                    "{geometry:?} {j}"
                );
            }
        }
    }

    #[test]
    fn functions_along_a_line_are_the_sums_of_their_cardinal_functions() {
        let grid = Grid::new(Geometry::Plane, 41);
        let coefficients = [1.0, -3.0]
            .map(|f| Matrix::from_fn(41, 2, |j, parity| (f * j as f64 + 0.3 * parity as f64).sin()));
        let mut s: Vec<f64> = (0..45).map(|k| 0.07 * f64::from(k) - 1.55).collect();
        s.extend([grid.theta[0], -grid.theta[7], 0.0, FRAC_PI_2]);
        let found = grid.interpolated(&s, coefficients.each_ref());
        let [even, odd] = grid.cardinals(&s);
        for (found, function) in found.iter().zip(&coefficients) {
            assert_eq!(found.len(), s.len());
            for (k, found) in found.iter().enumerate() {
                let terms = (0..41).map(|j| even[(k, j)] * function[(j, 0)] + odd[(k, j)] * function[(j, 1)]);
                let expected: f64 = terms.sum();
                assert!((found - expected).abs() < 1e-13, "{}: {found} {expected}", s[k]);
            }
        }
    }

    #[test]
    fn cardinal_functions_point_by_point_are_their_legendre_sums() {
        for geometry in [Geometry::Plane, Geometry::Space] {
            let grid = Grid::new(geometry, 96);
            for theta in [1e-9, 0.4, 1.1, FRAC_PI_2 - 3e-7] {
                let rows = grid.cardinals(&[theta]);
                for (parity, row) in rows.iter().enumerate() {
                    for j in 0..96 {
                        let mut sum = 0.0;
                        legendre(grid.argument(theta), grid.polynomials(), |k, p| match geometry {
                            Geometry::Plane if k % 2 == parity => {
                                sum += grid.to_nodes[parity][(j, k / 2)] * p
                            }
                            Geometry::Plane => (),
                            Geometry::Space => sum += grid.to_nodes[parity][(j, k)] * p,
                        });
                        if geometry == Geometry::Space && parity == 1 {
                            sum *= theta.sin();
                        }
                        // Rounding of a sum of up to 192 terms of up to 400.
                        assert!(
                            (sum - row[(0, j)]).abs() < 1e-10,
                            "{geometry:?} {theta} {parity} {j}: {sum}"
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn power_weights_integrate_powers_of_theta_over_a_smooth_density() {
        // Density 1/(2π) per steradian: ∫θ dμ over the hemisphere = ∫θ sin θ dθ = 1, ∫θ² sin θ dθ = π − 2.
        let grid = Grid::new(Geometry::Space, 32);
        for (power, exact) in [(1, 1.0), (2, PI - 2.0)] {
            let weights = grid.power_weights(power);
            let sum: f64 = weights.iter().zip(&grid.weights).map(|(a, w)| a * w).sum();
            assert!((sum - exact).abs() < 1e-12, "power {power}: {sum}");
        }
    }
}
