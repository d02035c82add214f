//! The fit of the analytic distribution ([`crate::compact`]).
//!
//! Of all distributions with the lobe's means of the terms it is the one of largest entropy (Jaynes 1957), and the one that the
//! fit below finds: it minimises the relative entropy Σ weight·(v·ln(v/f) − v + f), which is convex in the coefficients, so that
//! there is one answer and Newton's method finds it. As the constant is among the terms, the fitted lobe keeps the lobe's share
//! of the light.

use crate::file::analytic::Basis;
use crate::model::axis::ExitAxis;
use crate::model::compaction::Term;
use crate::model::measure;
use crate::model::table::{Component, Table};

/// The constant coefficient of a lobe without light: its exponential is 0 in any precision.
const NO_LIGHT: f32 = -1e4;
/// Largest |exponent| during the fit, beside the constant: e⁶⁰ spans what f32 does.
const REACH: f64 = 60.0;
/// Damping of Newton's steps, as a share of the light times the squared order of the coefficient: it leaves the answer where it
/// is, and keeps the coefficients of a lobe that a handful of paths make, whose answer is at infinity, from getting there.
const DAMPING: f64 = 1e-9;
/// A step that gains less than this share of the entropy is the last.
const LAST_GAIN: f64 = 1e-13;
/// Newton steps; a fit of a smooth lobe takes about ten.
const STEPS: usize = 80;

/// The terms up to an order along the columns; along φ up to half of it, fewer the higher the order along the columns.
#[must_use]
pub fn terms(axis: &ExitAxis, order: u16) -> Vec<Term> {
    let across = match axis {
        ExitAxis::Plane { .. } => 1,
        ExitAxis::Space { .. } => order.div_ceil(2).max(1),
    };
    let (columns, rows) = (u32::from(order) + 1, u32::from(across));
    // m/columns + n/rows < 1, in whole numbers.
    let within = |m: u16, n: u16| u32::from(m) * rows + u32::from(n) * columns < columns * rows;
    (0..across).flat_map(|n| (0..=order).map(move |m| Term(m, n))).filter(|t| within(t.0, t.1)).collect()
}

/// Coefficients of one component at every incidence of a table, in f32.
pub(super) fn fit(table: &Table, component: Component, terms: &[Term]) -> Vec<f32> {
    let axis = &table.meta().exit_axis;
    let cells = Cells::new(axis, terms);
    let mut start = Vec::new();
    let mut all = Vec::with_capacity(terms.len() * table.meta().per_incidence.len());
    for (i, summary) in table.meta().per_incidence.iter().enumerate() {
        let theta_i = summary.theta_i_deg.to_radians();
        let weights = measure::reading_weights(axis, theta_i, summary.azimuth_width_deg.to_radians());
        let values = table.at_incidence(&table.lobe(component).value, i);
        if theta_i == 0.0 {
            all.extend(fit_upright(axis, terms, &weights, values));
        } else {
            all.extend(fit_row(&cells, &weights, values, &mut start));
        }
    }
    all
}

/// The terms at the cells of a row.
///
/// Sums over cells are taken along the columns, then along φ. A product of two polynomials is a sum of two,
/// T_a·T_b = ½(T_(a+b) + T_|a−b|): so sums of the polynomials up to twice the orders hold the sums of all products of terms.
struct Cells<'a> {
    terms: &'a [Term],
    /// Up to twice the orders.
    basis: Basis,
}

impl<'a> Cells<'a> {
    fn new(axis: &ExitAxis, terms: &'a [Term]) -> Self {
        let doubled: Vec<Term> = terms.iter().map(|t| Term(2 * t.0, 2 * t.1)).collect();
        Self { terms, basis: Basis::new(axis, &doubled) }
    }

    /// The polynomial at every cell.
    fn exponents(&self, coefficients: &[f64]) -> Vec<f64> {
        let Basis { columns, rows } = &self.basis;
        let orders = columns[0].len().div_ceil(2);
        let along = |row: &Vec<f64>| {
            let mut along = vec![0.0; orders];
            for (term, c) in self.terms.iter().zip(coefficients) {
                along[usize::from(term.0)] += c * row[usize::from(term.1)];
            }
            along
        };
        let mut exponents = Vec::with_capacity(columns.len() * rows.len());
        for row in rows {
            let along = along(row);
            let at = |column: &Vec<f64>| column.iter().zip(&along).map(|(t, c)| t * c).sum::<f64>();
            exponents.extend(columns.iter().map(at));
        }
        exponents
    }

    /// Σ v·T_m·T_2n over the cells, by n, then m.
    fn sums(&self, values: &[f64]) -> Vec<f64> {
        let Basis { columns, rows } = &self.basis;
        let orders = columns[0].len();
        let mut sums = vec![0.0; orders * rows[0].len()];
        for (row, values) in rows.iter().zip(values.chunks_exact(columns.len())) {
            let mut along = vec![0.0; orders];
            for (column, value) in columns.iter().zip(values) {
                along.iter_mut().zip(column).for_each(|(sum, t)| *sum += value * t);
            }
            for (sums, t) in sums.chunks_exact_mut(orders).zip(row) {
                sums.iter_mut().zip(&along).for_each(|(sum, along)| *sum += t * along);
            }
        }
        sums
    }

    /// Σ v·term of each term.
    fn first(&self, values: &[f64]) -> Vec<f64> {
        let (sums, orders) = (self.sums(values), self.basis.columns[0].len());
        self.terms.iter().map(|t| sums[usize::from(t.1) * orders + usize::from(t.0)]).collect()
    }

    /// Σ v·term·term of each pair, the lower half of a square.
    fn second(&self, values: &[f64]) -> Vec<f64> {
        let (sums, orders, n) = (self.sums(values), self.basis.columns[0].len(), self.terms.len());
        let mut products = vec![0.0; n * n];
        for (i, a) in self.terms.iter().enumerate() {
            for (k, b) in self.terms[..=i].iter().enumerate() {
                let [m, across] = [[a.0 + b.0, a.0.abs_diff(b.0)], [a.1 + b.1, a.1.abs_diff(b.1)]];
                let at = |m: u16, n: u16| sums[usize::from(n) * orders + usize::from(m)];
                products[i * n + k] = 0.25 * across.iter().map(|&n| at(m[0], n) + at(m[1], n)).sum::<f64>();
            }
        }
        products
    }
}

/// At normal incidence nothing distinguishes an azimuth: only terms that do not either (in decay tables those even in the exit
/// angle) have coefficients.
fn fit_upright(axis: &ExitAxis, terms: &[Term], weights: &[f64], values: &[f32]) -> Vec<f32> {
    let round = |t: &Term| match axis {
        ExitAxis::Plane { .. } => t.0.is_multiple_of(2),
        ExitAxis::Space { .. } => t.1 == 0,
    };
    let kept: Vec<Term> = terms.iter().copied().filter(round).collect();
    let mut found = fit_row(&Cells::new(axis, &kept), weights, values, &mut Vec::new()).into_iter();
    terms.iter().map(|t| if round(t) { found.next().unwrap_or(0.0) } else { 0.0 }).collect()
}

/// Coefficients of one row of cells; `start` holds those of the row before, shifted to a peak of 1, and takes these.
fn fit_row(cells: &Cells<'_>, weights: &[f64], values: &[f32], start: &mut Vec<f64>) -> Vec<f32> {
    let terms = cells.terms.len();
    let peak = f64::from(values.iter().copied().fold(0.0, f32::max));
    let mass: f64 = weights.iter().zip(values).map(|(w, v)| w * f64::from(*v)).sum();
    if peak <= 0.0 || mass <= 0.0 {
        let mut none = vec![0.0; terms];
        none[0] = NO_LIGHT;
        return none;
    }
    let total: f64 = weights.iter().sum();
    let target: Vec<f64> = values.iter().map(|v| f64::from(*v) / peak).collect();
    let flat = || {
        let mut flat = vec![0.0; terms];
        flat[0] = (mass / (peak * total)).ln();
        flat
    };
    let damping = |t: &Term| DAMPING * mass / peak * (f64::from(t.0).powi(2) + f64::from(2 * t.1).powi(2));
    let damping: Vec<f64> = cells.terms.iter().map(damping).collect();
    let problem = Problem { cells, weights, target: &target, damping: &damping };
    let first = if start.len() == terms { start.clone() } else { flat() };
    let mut best = problem.solve(first);
    if !best.0.is_finite() {
        best = problem.solve(flat());
    }
    start.clone_from(&best.1);
    let mut c: Vec<f32> = best.1.into_iter().map(|c| c as f32).collect();
    c[0] += peak.ln() as f32;
    // What rounding to f32 moved.
    let coefficients: Vec<f64> = c.iter().map(|c| f64::from(*c)).collect();
    let kept: f64 =
        cells.exponents(&coefficients).iter().zip(weights).map(|(exponent, w)| w * exponent.exp()).sum();
    if kept > 0.0 && kept.is_finite() {
        c[0] += (mass / kept).ln() as f32;
    }
    c
}

/// One lobe to be fitted.
struct Problem<'a> {
    cells: &'a Cells<'a>,
    weights: &'a [f64],
    /// Values over their peak.
    target: &'a [f64],
    /// Added to the curvature of each coefficient; none to the constant's.
    damping: &'a [f64],
}

impl Problem<'_> {
    /// Newton's method with halved steps; the relative entropy reached (short of a constant), and the coefficients.
    fn solve(&self, mut c: Vec<f64>) -> (f64, Vec<f64>) {
        let mut now = self.at(&c);
        for _ in 0..STEPS {
            let (gradient, mut curvature) = self.derivatives(&now.fitted);
            let Some(step) = solve_positive(&mut curvature, &gradient) else { break };
            let slope: f64 = step.iter().zip(&gradient).map(|(s, g)| s * g).sum();
            let mut length = 1.0;
            let next = loop {
                let next: Vec<f64> = c.iter().zip(&step).map(|(c, s)| c - length * s).collect();
                let there = self.at(&next);
                if there.entropy <= now.entropy - 1e-4 * length * slope {
                    break Some((next, there));
                }
                length *= 0.5;
                if length < 1e-8 {
                    break None;
                }
            };
            let Some((next, there)) = next else { break };
            let gained = now.entropy - there.entropy;
            (c, now) = (next, there);
            if gained < LAST_GAIN * now.entropy.abs() {
                break;
            }
        }
        (now.entropy, c)
    }

    fn at(&self, c: &[f64]) -> Fitted {
        let mut exponents = self.cells.exponents(c);
        exponents.iter_mut().for_each(|exponent| *exponent = exponent.clamp(-REACH, REACH));
        let fitted: Vec<f64> = exponents.iter().map(|exponent| exponent.exp()).collect();
        let cells = exponents.iter().zip(&fitted).zip(self.weights.iter().zip(self.target));
        let entropy = cells.map(|((exponent, f), (w, v))| w * (f - v * exponent)).sum();
        Fitted { fitted, entropy }
    }

    fn derivatives(&self, fitted: &[f64]) -> (Vec<f64>, Vec<f64>) {
        let cells = || fitted.iter().zip(self.weights.iter().zip(self.target));
        let residual: Vec<f64> = cells().map(|(f, (w, v))| w * (f - v)).collect();
        let weight: Vec<f64> = cells().map(|(f, (w, _))| w * f).collect();
        let mut curvature = self.cells.second(&weight);
        let n = self.damping.len();
        self.damping.iter().enumerate().for_each(|(k, damping)| curvature[k * n + k] += damping);
        (self.cells.first(&residual), curvature)
    }
}

/// A lobe of some coefficients.
struct Fitted {
    /// By cell.
    fitted: Vec<f64>,
    /// Σ weight·(f − v·ln f): the relative entropy short of what does not depend on the coefficients.
    entropy: f64,
}

/// Solves A·x = b for a symmetric positive matrix given by its lower half (Cholesky, in place); `None` where it is not positive.
fn solve_positive(a: &mut [f64], b: &[f64]) -> Option<Vec<f64>> {
    let n = b.len();
    for j in 0..n {
        for i in j..n {
            let sum: f64 = (0..j).map(|k| a[i * n + k] * a[j * n + k]).sum();
            let rest = a[i * n + j] - sum;
            if i == j {
                if !(rest > 0.0 && rest.is_finite()) {
                    return None;
                }
                a[i * n + j] = rest.sqrt();
            } else {
                a[i * n + j] = rest / a[j * n + j];
            }
        }
    }
    let mut x = b.to_vec();
    for i in 0..n {
        let sum: f64 = (0..i).map(|k| a[i * n + k] * x[k]).sum();
        x[i] = (x[i] - sum) / a[i * n + i];
    }
    for i in (0..n).rev() {
        let sum: f64 = (i + 1..n).map(|k| a[k * n + i] * x[k]).sum();
        x[i] = (x[i] - sum) / a[i * n + i];
    }
    Some(x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::analytic::values;

    const PLANE: ExitAxis = ExitAxis::Plane { cells: 96, width: 0.07 };
    const SPACE: ExitAxis = ExitAxis::Space { theta_cells: 48, phi_cells: 16, width: 0.07 };

    #[test]
    fn the_fit_finds_a_distribution_of_its_own_kind_again() {
        for axis in [PLANE, SPACE] {
            let terms = terms(&axis, 6);
            let coefficients: Vec<f32> =
                (0..terms.len()).map(|k| if k == 0 { 1.25 } else { 0.8 / (k * k) as f32 - 0.1 }).collect();
            let lobe = values(&axis, &terms, &coefficients);
            let weights = measure::reading_weights(&axis, 0.6, 0.15);
            let cells = Cells::new(&axis, &terms);
            let found = fit_row(&cells, &weights, &lobe, &mut Vec::new());
            for (found, true_value) in found.iter().zip(&coefficients) {
                // The lobe is rounded to f32.
                assert!((found - true_value).abs() < 2e-5, "{found} for {true_value}");
            }
        }
    }

    #[test]
    fn the_fit_keeps_the_share_of_the_light() {
        let terms = terms(&PLANE, 8);
        let cells = Cells::new(&PLANE, &terms);
        let weights = measure::reading_weights(&PLANE, 1.1, 0.15);
        // A lobe with a corner, which no polynomial follows.
        let lobe: Vec<f32> = (0..96).map(|k| (-0.2 * (k as f32 - 50.0).abs()).exp()).collect();
        let fitted = values(&PLANE, &terms, &fit_row(&cells, &weights, &lobe, &mut Vec::new()));
        let share = |lobe: &[f32]| -> f64 { weights.iter().zip(lobe).map(|(w, v)| w * f64::from(*v)).sum() };
        assert!((share(&fitted) / share(&lobe) - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_lobe_of_a_few_cells_keeps_its_light_too() {
        let terms = terms(&PLANE, 15);
        let cells = Cells::new(&PLANE, &terms);
        let weights = measure::reading_weights(&PLANE, 1.4, 0.15);
        for lit in [&[50usize][..], &[0, 95], &[30, 31, 80]] {
            let mut lobe = [0f32; 96];
            lit.iter().for_each(|k| lobe[*k] = 3e-4);
            let coefficients = fit_row(&cells, &weights, &lobe, &mut Vec::new());
            let fitted = values(&PLANE, &terms, &coefficients);
            let share =
                |lobe: &[f32]| -> f64 { weights.iter().zip(lobe).map(|(w, v)| w * f64::from(*v)).sum() };
            let lost = (share(&fitted) / share(&lobe) - 1.0).abs();
            // The constant is the last to be rounded to f32; it is large where a polynomial has to fall steeply.
            let rounding = f64::from(coefficients[0].abs() * f32::EPSILON);
            assert!(lost < rounding + 1e-6, "{lit:?}: {lost:e}, rounding {rounding:e}");
        }
    }

    #[test]
    fn a_dark_lobe_stays_dark() {
        let axis = ExitAxis::Plane { cells: 4, width: 0.07 };
        let none = fit_row(&Cells::new(&axis, &[Term(0, 0)]), &[1.0; 4], &[0.0; 4], &mut Vec::new());
        assert_eq!(values(&axis, &[Term(0, 0)], &none), [0.0; 4]);
    }

    #[test]
    fn terms_count_as_documented() {
        assert_eq!(terms(&PLANE, 15).len(), 16);
        assert_eq!(terms(&SPACE, 15).len(), 72);
        assert_eq!(terms(&PLANE, 0), [Term(0, 0)]);
    }
}
