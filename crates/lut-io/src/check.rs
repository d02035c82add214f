//! What must hold of a table, tried on the table itself.

use crate::axis::ExitAxis;
use crate::lobe::Interpolant;
use crate::measure;
use crate::table::{Component, Table};
use serde::Serialize;

/// Largest |reflected + transmitted + absorbed + truncated − 1|.
pub const ENERGY_TOLERANCE: f64 = 1e-12;
/// Largest relative difference between a lobe's hemispherical integral and its albedo.
pub const INTEGRAL_TOLERANCE: f64 = 1e-3;
/// Largest difference between two azimuths at θi = 0, as a share of the peak: the bake makes them equal, what is
/// left is the rounding of f32.
pub const AZIMUTH_TOLERANCE: f64 = 1e-6;

/// One property tried at every incidence; `worst` is the largest departure found.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// Name of the property.
    pub check: &'static str,
    /// What was compared.
    pub what: &'static str,
    /// Whether the table has the property; `None` for what is measured for information only.
    pub pass: Option<bool>,
    /// Largest departure.
    pub worst: f64,
    /// Incidence where it was found, degrees.
    pub worst_theta_i_deg: f64,
    /// Largest departure that passes; `None` for information.
    pub tolerance: Option<f64>,
}

/// Departures at several incidences, of which the largest counts.
struct Worst {
    departure: f64,
    theta_i_deg: f64,
}

impl Worst {
    const fn new() -> Self {
        Self { departure: 0.0, theta_i_deg: 0.0 }
    }

    fn note(&mut self, departure: f64, theta_i_deg: f64) {
        // A NaN is the worst of all, and stays.
        if departure > self.departure || departure.is_nan() {
            *self = Self { departure, theta_i_deg };
        }
    }

    fn judged(self, check: &'static str, what: &'static str, tolerance: f64) -> Finding {
        let pass = Some(self.departure <= tolerance);
        Finding { pass, tolerance: Some(tolerance), ..self.told(check, what) }
    }

    fn told(self, check: &'static str, what: &'static str) -> Finding {
        let (worst, worst_theta_i_deg) = (self.departure, self.theta_i_deg);
        Finding { check, what, pass: None, worst, worst_theta_i_deg, tolerance: None }
    }
}

/// Tries everything on a valid table.
#[must_use]
pub fn check(lobe: &Interpolant) -> Vec<Finding> {
    let table = lobe.table();
    let mut findings = vec![energy(table), ledger(table), positivity(table), integral_at_nodes(table)];
    findings.push(integral_between_nodes(lobe));
    findings.push(counts(table));
    findings.extend(azimuth_at_normal_incidence(table));
    findings.push(reciprocity(lobe));
    findings.push(roughness(table));
    findings
}

fn energy(table: &Table) -> Finding {
    let mut worst = Worst::new();
    for s in &table.meta.per_incidence {
        let sum = s.albedo + s.transmitted + s.absorbed + s.truncated;
        worst.note((sum - 1.0).abs(), s.theta_i_deg);
    }
    worst.judged("energy", "|albedo + transmitted + absorbed + truncated - 1|", ENERGY_TOLERANCE)
}

fn ledger(table: &Table) -> Finding {
    let mut worst = Worst::new();
    for s in &table.meta.per_incidence {
        worst.note((s.surface - s.albedo).max(s.rehit - s.surface).max(0.0), s.theta_i_deg);
    }
    worst.judged("ledger", "excess of rehit over surface, or of surface over albedo", ENERGY_TOLERANCE)
}

fn positivity(table: &Table) -> Finding {
    let mut worst = Worst::new();
    for (i, s) in table.meta.per_incidence.iter().enumerate() {
        for component in Component::ALL {
            let lobe = table.lobe(component);
            for samples in [&lobe.value, &lobe.std_error, &lobe.count] {
                for sample in incidence(table, samples, i) {
                    worst.note(f64::from(-*sample), s.theta_i_deg);
                }
            }
        }
    }
    worst.judged("positivity", "most negative value, standard error or count", 0.0)
}

fn integral_at_nodes(table: &Table) -> Finding {
    let axis = &table.meta.exit_axis;
    let mut worst = Worst::new();
    for (i, s) in table.meta.per_incidence.iter().enumerate() {
        let theta_i = s.theta_i_deg.to_radians();
        let weights = measure::reading_weights(axis, theta_i, s.azimuth_width_deg.to_radians());
        for component in Component::ALL {
            let values = incidence(table, &table.lobe(component).value, i);
            let integral: f64 = weights.iter().zip(values).map(|(w, v)| w * f64::from(*v)).sum();
            worst.note(relative(integral, s.share(component)), s.theta_i_deg);
        }
    }
    worst.judged("integral", "hemispherical integral of a stored lobe against its albedo", INTEGRAL_TOLERANCE)
}

fn integral_between_nodes(lobe: &Interpolant) -> Finding {
    let mut worst = Worst::new();
    for pair in lobe.table().meta.per_incidence.windows(2) {
        // Not a simple fraction: corrections are known at quarters, and must hold between them too.
        let theta_deg = pair[0].theta_i_deg + 0.437 * (pair[1].theta_i_deg - pair[0].theta_i_deg);
        let theta_i = theta_deg.to_radians();
        let integrals = lobe.row(theta_i).integrals();
        for component in Component::ALL {
            worst.note(relative(integrals[component as usize], lobe.albedo(component, theta_i)), theta_deg);
        }
    }
    worst.judged(
        "integral_between",
        "the same between incidences, as read, against the interpolated albedo",
        INTEGRAL_TOLERANCE,
    )
}

/// |a/b − 1|; shares below 1e-12 are no light at all.
fn relative(integral: f64, albedo: f64) -> f64 {
    (integral - albedo).abs() / albedo.max(1e-12)
}

fn counts(table: &Table) -> Finding {
    let mut worst = Worst::new();
    for (i, s) in table.meta.per_incidence.iter().enumerate() {
        let counted = |component| -> f64 {
            incidence(table, &table.lobe(component).count, i).iter().map(|c| f64::from(*c)).sum()
        };
        let counted = counted(Component::Interior) + counted(Component::Surface);
        worst.note((counted - s.paths as f64).max(0.0) / s.paths.max(1) as f64, s.theta_i_deg);
    }
    // f32 counts above 2^24 are rounded by 6e-8 each.
    worst.judged("counts", "paths counted in cells beyond the paths walked, as a share", 1e-6)
}

fn azimuth_at_normal_incidence(table: &Table) -> Option<Finding> {
    let at = table.meta.per_incidence.iter().position(|s| s.theta_i_deg == 0.0)?;
    let mut worst = Worst::new();
    for component in Component::ALL {
        let values = incidence(table, &table.lobe(component).value, at);
        let peak = values.iter().copied().fold(0.0, f32::max);
        let against: Vec<f32> = match table.meta.exit_axis {
            ExitAxis::Plane { .. } => values.iter().rev().copied().collect(),
            ExitAxis::Space { theta_cells, .. } => {
                values[..theta_cells].iter().copied().cycle().take(values.len()).collect()
            }
        };
        for (value, other) in values.iter().zip(against) {
            if peak > 0.0 {
                worst.note(f64::from((value - other).abs()) / f64::from(peak), 0.0);
            }
        }
    }
    Some(worst.judged(
        "azimuth",
        "difference between azimuths at normal incidence, share of the peak",
        AZIMUTH_TOLERANCE,
    ))
}

/// Σ|f(a→b) − f(b→a)|·cos·cos / Σ(…) in the plane of incidence over pairs of the table's incidences.
fn reciprocity(lobe: &Interpolant) -> Finding {
    let theta_i = lobe.table().theta_i();
    let total = |a: f64, b: f64| {
        let row = lobe.row(a);
        row.eval(Component::Interior, b, 0.0) + row.eval(Component::Surface, b, 0.0)
    };
    let mut worst = Worst::new();
    for a in &theta_i {
        let (mut difference, mut sum) = (0.0, 0.0);
        for b in theta_i.iter().filter(|b| **b < 1.5) {
            let (forth, back) = (total(*a, *b) * a.cos(), total(*b, *a) * b.cos());
            difference += (forth - back).abs();
            sum += forth + back;
        }
        if sum > 0.0 && *a < 1.5 {
            worst.note(difference / sum, a.to_degrees());
        }
    }
    worst.told(
        "reciprocity",
        "defect in the plane of incidence, share of the light (unweighted facets have one)",
    )
}

/// Median of |second difference| over its standard error, worst incidence: about 0.67 for pure noise, large where
/// cells are too coarse for the lobe.
fn roughness(table: &Table) -> Finding {
    let columns = table.meta.exit_axis.columns();
    let mut worst = Worst::new();
    for (i, s) in table.meta.per_incidence.iter().enumerate() {
        let values = incidence(table, &table.interior.value, i);
        let errors = incidence(table, &table.interior.std_error, i);
        let mut scores = Vec::new();
        for (v, e) in values.chunks_exact(columns).zip(errors.chunks_exact(columns)) {
            for (v, e) in v.windows(3).zip(e.windows(3)) {
                let bend = f64::from(v[0]) - 2.0 * f64::from(v[1]) + f64::from(v[2]);
                let error =
                    (f64::from(e[0]).powi(2) + 4.0 * f64::from(e[1]).powi(2) + f64::from(e[2]).powi(2))
                        .sqrt();
                if error > 0.0 {
                    scores.push((bend / error).abs());
                }
            }
        }
        scores.sort_by(f64::total_cmp);
        worst.note(scores.get(scores.len() / 2).copied().unwrap_or(0.0), s.theta_i_deg);
    }
    worst.told("roughness", "median |second difference| of the interior in standard errors (0.67 is noise)")
}

/// The part of a channel that belongs to incidence i.
pub(crate) fn incidence<'s>(table: &Table, samples: &'s [f32], i: usize) -> &'s [f32] {
    let cells = table.meta.exit_axis.cells();
    &samples[i * cells..(i + 1) * cells]
}
