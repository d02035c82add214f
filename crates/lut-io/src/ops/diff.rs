//! How far two tables are apart, and whether their stored errors explain it.

use crate::model::axis::ExitAxis;
use crate::model::measure;
use crate::model::table::{Component, Table};
use crate::read::lobe::{Interpolant, Row};
use serde::Serialize;
use statrs::distribution::{ChiSquared, ContinuousCDF as _, Normal};

/// Family-wise significance: tables from the same walk with other seeds are called different once in a thousand.
pub const SIGNIFICANCE: f64 = 1e-3;
/// Fewest paths a cell needs in both tables to enter the chi² test, whose terms must be nearly normal.
pub const MIN_COUNT: f32 = 25.0;

/// Two tables compared at the incidences of the first that lie within those of the second.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Whether every stored number is the same.
    pub identical: bool,
    /// Whether the difference is more than the stored errors explain ([`SIGNIFICANCE`], all tests together), or,
    /// where neither table has statistical errors, more than their accuracies.
    pub significant: bool,
    /// Number of tests behind `significant`.
    pub tests: usize,
    /// Smallest p of them; `None` without tests.
    pub smallest_p: Option<f64>,
    /// Largest total variation, per cent of the reflected light, and its incidence.
    pub worst_total_variation_percent: f64,
    /// Incidence of the largest total variation, degrees.
    pub worst_theta_i_deg: f64,
    /// One entry an incidence.
    pub per_incidence: Vec<IncidenceDifference>,
}

/// Two tables at one incidence.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct IncidenceDifference {
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// Half the integral of |f cos θo − f' cos θo| over the hemisphere, per cent of the reflected light.
    pub total_variation_percent: f64,
    /// Difference of the summaries, first minus second.
    pub shares: Vec<ShareDifference>,
    /// chi² of the interior's and the surface's cells; only where both tables store this incidence on the same axis.
    pub lobes: Vec<LobeDifference>,
}

/// One number of the summaries compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ShareDifference {
    /// Field of the summary.
    pub field: &'static str,
    /// First minus second.
    pub difference: f64,
    /// In standard errors; `None` where both errors are zero, or the second table has no such incidence.
    pub z: Option<f64>,
}

/// The cells of one component compared.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LobeDifference {
    /// Name of the component.
    pub component: &'static str,
    /// Σ (a − b)²/(σa² + σb²) over cells with at least [`MIN_COUNT`] paths in both.
    pub chi2: f64,
    /// Number of those cells.
    pub cells: usize,
    /// Probability of a larger chi² between equal tables.
    pub p: f64,
}

/// Compares two valid tables.
#[must_use]
pub fn diff(a: &Interpolant, b: &Interpolant) -> Difference {
    let (first, last) = range(b.table());
    let mut per_incidence = Vec::new();
    for (i, summary) in a.table().meta().per_incidence.iter().enumerate() {
        if (first..=last).contains(&summary.theta_i_deg) {
            per_incidence.push(at_incidence(a, b, i));
        }
    }
    let tests: Vec<f64> = per_incidence.iter().flat_map(p_values).collect();
    let smallest_p = tests.iter().copied().reduce(f64::min);
    let worst =
        per_incidence.iter().max_by(|x, y| x.total_variation_percent.total_cmp(&y.total_variation_percent));
    let identical = same_bits(a.table(), b.table());
    // Bonferroni: the smallest of n p-values against SIGNIFICANCE/n.
    let unexplained = match smallest_p {
        Some(p) => p * (tests.len() as f64) < SIGNIFICANCE,
        None => beyond_accuracies(a.table(), b.table(), &per_incidence),
    };
    Difference {
        identical,
        significant: !identical && unexplained,
        tests: tests.len(),
        smallest_p,
        worst_total_variation_percent: worst.map_or(0.0, |w| w.total_variation_percent),
        worst_theta_i_deg: worst.map_or(0.0, |w| w.theta_i_deg),
        per_incidence,
    }
}

fn range(table: &Table) -> (f64, f64) {
    let per_incidence = &table.meta().per_incidence;
    (per_incidence[0].theta_i_deg, per_incidence[per_incidence.len() - 1].theta_i_deg)
}

fn same_bits(a: &Table, b: &Table) -> bool {
    a.meta().exit_axis == b.meta().exit_axis
        && a.meta().per_incidence == b.meta().per_incidence
        && Component::ALL.into_iter().all(|component| a.lobe(component) == b.lobe(component))
}

fn p_values(at: &IncidenceDifference) -> Vec<f64> {
    let two_sided = |z: f64| Normal::standard().sf(z.abs()) * 2.0;
    let shares = at.shares.iter().filter_map(|share| share.z).map(two_sided);
    shares.chain(at.lobes.iter().map(|lobe| lobe.p)).collect()
}

fn beyond_accuracies(a: &Table, b: &Table, per_incidence: &[IncidenceDifference]) -> bool {
    let allowed = a.meta().accuracy.reached_percent + b.meta().accuracy.reached_percent;
    per_incidence.iter().any(|at| at.total_variation_percent > allowed)
}

fn at_incidence(a: &Interpolant, b: &Interpolant, i: usize) -> IncidenceDifference {
    let summary = &a.table().meta().per_incidence[i];
    let theta_i = summary.theta_i_deg.to_radians();
    let (row_a, row_b) = (a.row(theta_i), b.row(theta_i));
    let other = b.table().meta().per_incidence.iter().position(|s| s.theta_i_deg == summary.theta_i_deg);
    let comparable = a.table().meta().exit_axis == b.table().meta().exit_axis;
    let lobes = match other {
        Some(j) if comparable => lobes(a.table(), b.table(), i, j),
        _ => Vec::new(),
    };
    IncidenceDifference {
        theta_i_deg: summary.theta_i_deg,
        total_variation_percent: total_variation_percent(a, b, &row_a, &row_b),
        shares: shares(a, b, i, other),
        lobes,
    }
}

fn shares(a: &Interpolant, b: &Interpolant, i: usize, other: Option<usize>) -> Vec<ShareDifference> {
    let first = &a.table().meta().per_incidence[i];
    let Some(second) = other.map(|j| &b.table().meta().per_incidence[j]) else {
        let theta_i = first.theta_i_deg.to_radians();
        let albedo = b.albedo(Component::Interior, theta_i) + b.albedo(Component::Surface, theta_i);
        let difference = first.albedo - albedo;
        return vec![ShareDifference { field: "albedo", difference, z: None }];
    };
    let (ea, eb) = (&first.std_error, &second.std_error);
    let pairs = [
        ("albedo", first.albedo - second.albedo, ea.albedo, eb.albedo),
        ("transmitted", first.transmitted - second.transmitted, ea.transmitted, eb.transmitted),
        ("absorbed", first.absorbed - second.absorbed, ea.absorbed, eb.absorbed),
        ("surface", first.surface - second.surface, ea.surface, eb.surface),
    ];
    pairs
        .into_iter()
        .map(|(field, difference, ea, eb)| {
            let error = ea.hypot(eb);
            ShareDifference { field, difference, z: (error > 0.0).then(|| difference / error) }
        })
        .collect()
}

/// By the cells and weights of a space table if there is one, which know φ, else by those of the first table.
fn total_variation_percent(a: &Interpolant, b: &Interpolant, row_a: &Row<'_>, row_b: &Row<'_>) -> f64 {
    let space = |lobe: &Interpolant| matches!(lobe.table().meta().exit_axis, ExitAxis::Space { .. });
    let (grid, row) = if !space(a) && space(b) { (b, row_b) } else { (a, row_a) };
    let weights =
        measure::reading_weights(&grid.table().meta().exit_axis, row.theta_i(), row.azimuth_width());
    let columns = row.columns().centres();
    let azimuths = row.phi().map_or_else(|| vec![0.0], |phi| phi.centres());
    let (mut difference, mut reflected) = (0.0, 0.0);
    for (k, weight) in weights.iter().enumerate() {
        let (s, phi) = (columns[k % columns.len()], azimuths[k / columns.len()]);
        let phi = if s < 0.0 { std::f64::consts::PI } else { phi };
        let total = |row: &Row<'_>| {
            row.eval(Component::Interior, s.abs(), phi) + row.eval(Component::Surface, s.abs(), phi)
        };
        let (x, y) = (total(row_a), total(row_b));
        difference += 0.5 * weight * (x - y).abs();
        reflected += 0.5 * weight * (x + y);
    }
    if reflected > 0.0 { 100.0 * difference / reflected } else { 0.0 }
}

fn lobes(a: &Table, b: &Table, i: usize, j: usize) -> Vec<LobeDifference> {
    let cells = independent_cells(a, i);
    let mut lobes = Vec::new();
    for component in [Component::Interior, Component::Surface] {
        let (x, y) = (a.lobe(component), b.lobe(component));
        let (va, vb) = (a.at_incidence(&x.value, i), b.at_incidence(&y.value, j));
        let (ea, eb) = (a.at_incidence(&x.std_error, i), b.at_incidence(&y.std_error, j));
        let (na, nb) = (a.at_incidence(&x.count, i), b.at_incidence(&y.count, j));
        let (mut chi2, mut counted) = (0.0, 0usize);
        for k in cells.clone() {
            let variance = f64::from(ea[k]).powi(2) + f64::from(eb[k]).powi(2);
            // A table of the doubling solver counts no paths and has no statistical error: it is the truth here.
            let enough = |n: f32, error: f32| n >= MIN_COUNT || (n == 0.0 && error == 0.0);
            if variance > 0.0 && enough(na[k], ea[k]) && enough(nb[k], eb[k]) {
                chi2 += (f64::from(va[k]) - f64::from(vb[k])).powi(2) / variance;
                counted += 1;
            }
        }
        // With a single cell left there is nothing that the albedo test does not say.
        if counted > 1 {
            let p = ChiSquared::new(counted as f64).map_or(1.0, |chi| chi.sf(chi2));
            lobes.push(LobeDifference { component: component.name(), chi2, cells: counted, p });
        }
    }
    lobes
}

/// Cells that carry their own counts: at θi = 0 the bake stores each side (or each azimuth) as their common mean.
pub(crate) fn independent_cells(table: &Table, i: usize) -> std::ops::Range<usize> {
    let cells = table.meta().exit_axis.cells();
    if table.meta().per_incidence[i].theta_i_deg != 0.0 {
        return 0..cells;
    }
    match table.meta().exit_axis {
        ExitAxis::Plane { cells, .. } => 0..cells / 2,
        ExitAxis::Space { theta_cells, .. } => {
            let values = table.at_incidence(&table.lobe(Component::Interior).value, i);
            let repeated = values.chunks_exact(theta_cells).all(|row| row == &values[..theta_cells]);
            if repeated { 0..theta_cells } else { 0..cells }
        }
    }
}
