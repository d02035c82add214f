//! Reciprocal tables: f(θi → θo) = f(θo → θi) at any pair of directions, exactly.
//!
//! Write F = f·cos θi·cos θo; of a table it is v(θi → θo)·cos θi, v the stored f·cos θo. Facets that are met unweighted, the
//! azimuth postulate with its width by θi, and reading between cells all leave F(a → b) and F(b → a) different.
//!
//! A table with the section [`reciprocal`] is read at the larger of its two angles. [`symmetrised`] makes such a table of any
//! other, with the symmetric kernel r(a)·r(b)·√(v(a → b)·v(b → a))·cos a·cos b, the geometric mean of both ways, with the one curve r that leaves
//! every directional albedo as it was (the symmetric scaling of Sinkhorn 1967: of all reciprocal kernels with these albedos it
//! is the one nearest to both ways in relative entropy).

use crate::error::FieldError;
use crate::model::axis::ExitAxis;
use crate::model::both_sides;
use crate::model::compaction;
use crate::model::decay;
use crate::model::dispersion;
use crate::model::measure;
use crate::model::reciprocal::{self, Reciprocal, STEPS};
use crate::model::table::{Component, IncidenceSummary, Lobe, Parts, Table};
use crate::ops::diff;
use crate::ops::moments::Moments;
use crate::read::lobe::{Interpolant, Row, bracket};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// 90° is taken for this: at 90° itself no light arrives, and the ways there and back have no common measure.
const GRAZING_DEG: f64 = 89.9;
/// Most rounds of the scaling, and the relative error of the albedo that ends it.
const ROUNDS: usize = 2000;
const SCALED: f64 = 1e-10;

/// The reciprocal table nearest to a table.
///
/// Albedos, the ledger and counts stay; values, standard errors (each in proportion) and the moments of the exit angle are those
/// of the new lobes. In decay tables the azimuth width becomes one for all incidences: the mean of theirs, weighted by the light
/// that each sends back under an even sky. It is another bake than the table's: its `content_hash` says so.
///
/// # Errors
/// A table that holds light from below, or is compact, or reciprocal already.
pub fn symmetrised(table: &Table) -> Result<Table, FieldError> {
    let meta = table.meta();
    for (key, there, what) in [
        (both_sides::KEY, meta.both_sides.is_some(), "light from below has no reciprocal form here"),
        (
            compaction::KEY,
            meta.compact.is_some(),
            "a compact table is not made reciprocal: make the table so, then fit it",
        ),
        (reciprocal::KEY, meta.reciprocal.is_some(), "is there already"),
    ] {
        if there {
            return Err(FieldError::new(key, what));
        }
    }
    if !table.bands().is_empty() {
        return Err(several_bands());
    }
    let before = Interpolant::new(table.clone());
    let lobe = Interpolant::new(with_one_width(table)?);
    let mut parts = lobe.table().clone().into_parts();
    parts.lobes =
        Component::ALL.map(|component| with_values(table.lobe(component), scaled_kernel(&lobe, component)));
    let mut parts = with_moments(&Table::new(parts)?);
    parts.meta.reciprocal = Some(Reciprocal {
        moved_percent: 0.0,
        albedo_percent: 0.0,
        interior_gain: vec![0.0; STEPS + 1],
        rehit_gain: vec![0.0; STEPS + 1],
    });
    let read = Interpolant::new(Table::new(parts)?);
    let light: Vec<[f64; 3]> = (0..=STEPS)
        .into_par_iter()
        .map(|k| light_as_read(&read, FRAC_PI_2 * k as f64 / STEPS as f64))
        .collect();
    let section = Reciprocal {
        moved_percent: diff::diff(&before, &read).worst_total_variation_percent,
        albedo_percent: 100.0 * light.iter().map(|[_, _, all]| (all - 1.0).abs()).fold(0.0, f64::max),
        interior_gain: light.iter().map(|[interior, ..]| *interior).collect(),
        rehit_gain: light.iter().map(|[_, rehit, _]| *rehit).collect(),
    };
    let mut parts = read.table().clone().into_parts();
    parts.meta.reciprocal = Some(section);
    if let Some(hash) = &mut parts.meta.content_hash {
        hash.push_str("-reciprocal");
    }
    Table::new(parts)
}

/// Why a table of several bands is refused; also for those who know before the bake.
#[must_use]
pub fn several_bands() -> FieldError {
    let problem = "a table of several bands is not made reciprocal; bake without the effect dispersion";
    FieldError::new(dispersion::KEY, problem)
}

/// A decay table with one azimuth width, every lobe keeping its share; other tables as they are.
fn with_one_width(table: &Table) -> Result<Table, FieldError> {
    let mut parts = table.clone().into_parts();
    let axis = parts.meta.exit_axis;
    if matches!(axis, ExitAxis::Space { .. }) {
        return Table::new(parts);
    }
    let summaries = &mut parts.meta.per_incidence;
    let light = |s: &IncidenceSummary| {
        let theta = s.theta_i_deg.to_radians();
        // Also where the only incidences are 0 and 90°.
        (s.albedo * theta.sin() * theta.cos()).max(1e-12)
    };
    let total: f64 = summaries.iter().map(light).sum();
    let mean_deg = summaries.iter().map(|s| light(s) * s.azimuth_width_deg).sum::<f64>() / total;
    let first_deg = summaries[0].azimuth_width_deg;
    let width_deg =
        if summaries.iter().all(|s| s.azimuth_width_deg == first_deg) { first_deg } else { mean_deg };
    let cells = axis.cells();
    for (i, summary) in summaries.iter_mut().enumerate() {
        summary.azimuth_width_deg = width_deg;
        let weights =
            measure::reading_weights(&axis, summary.theta_i_deg.to_radians(), width_deg.to_radians());
        for (component, lobe) in Component::ALL.into_iter().zip(&mut parts.lobes) {
            let row = &mut lobe.value[i * cells..(i + 1) * cells];
            let integral: f64 = weights.iter().zip(&*row).map(|(w, v)| w * f64::from(*v)).sum();
            if integral > 0.0 {
                let scale = summary.share(component) / integral;
                row.iter_mut().for_each(|v| *v = (f64::from(*v) * scale) as f32);
            }
        }
    }
    Table::new(parts)
}

/// Rows of the scaled symmetric kernel of one component, f·cos θo.
fn scaled_kernel(lobe: &Interpolant, component: Component) -> Vec<f64> {
    let table = lobe.table();
    let axis = &table.meta().exit_axis;
    let theta = table.theta_i();
    let rows: Vec<KernelRow> = table
        .meta()
        .per_incidence
        .iter()
        .map(|summary| KernelRow::new(lobe, component, axis, summary, &theta))
        .collect();
    // ln r at the incidences; linear in θ between them.
    let mut ln_r = vec![0.0; theta.len()];
    for _ in 0..ROUNDS {
        let mut worst = 0f64;
        let steps: Vec<f64> = rows
            .iter()
            .zip(&ln_r)
            .map(|(row, own)| {
                let integral = row.integral(*own, &ln_r);
                if !(integral > 0.0 && row.share > 0.0) {
                    return 0.0;
                }
                let off = (row.share / integral).ln();
                worst = worst.max(off.abs());
                // Both ends of a pair take up half of what is missing.
                0.5 * off
            })
            .collect();
        ln_r.iter_mut().zip(steps).for_each(|(r, step)| *r += step);
        if worst < SCALED {
            break;
        }
    }
    rows.iter()
        .zip(&ln_r)
        .flat_map(|(row, own)| {
            let values = row.values(*own, &ln_r);
            let integral = row.integral(*own, &ln_r);
            // What the last round left.
            let scale = if integral > 0.0 { row.share / integral } else { 1.0 };
            let mut values: Vec<f64> = values.map(move |v| v * scale).collect();
            if row.normal {
                average_around(&mut values, &row.weights, axis.columns());
            }
            values
        })
        .collect()
}

/// Gives every column its mean over the azimuth: light along the normal has no azimuth.
fn average_around(values: &mut [f64], weights: &[f64], columns: usize) {
    for column in 0..columns {
        let cells = || (column..weights.len()).step_by(columns);
        let light: f64 = cells().map(|k| weights[k] * values[k]).sum();
        let solid: f64 = cells().map(|k| weights[k]).sum();
        cells().for_each(|k| values[k] = light / solid);
    }
}

/// One row of the symmetric kernel before it is scaled.
struct KernelRow {
    /// √(v(a → b)·v(b → a))·cos b of every cell.
    kernel: Vec<f64>,
    weights: Vec<f64>,
    /// Where b lies among the incidences, every cell.
    at: Vec<(usize, f64)>,
    share: f64,
    /// Whether θi is 0.
    normal: bool,
}

impl KernelRow {
    fn new(
        lobe: &Interpolant,
        component: Component,
        axis: &ExitAxis,
        summary: &IncidenceSummary,
        nodes: &[f64],
    ) -> Self {
        let theta_i = summary.theta_i_deg.to_radians();
        let read_at = theta_i.min(GRAZING_DEG.to_radians());
        let there = lobe.row(theta_i);
        let columns = there.columns().centres();
        let azimuths = there.phi().map_or_else(|| vec![0.0], |phi| phi.centres());
        let backs: Vec<_> = columns.iter().map(|s| lobe.row(s.abs())).collect();
        let (mut kernel, mut at) = (Vec::new(), Vec::new());
        for phi in &azimuths {
            for (s, back) in columns.iter().zip(&backs) {
                // In decay tables the plane of incidence is all there is: φ = 0 ahead, 180° back.
                let phi = if *s < 0.0 { PI } else { *phi };
                let (v, u) = (there.eval(component, s.abs(), phi), back.eval(component, read_at, phi));
                kernel.push((v * u).max(0.0).sqrt() * s.cos());
                at.push(bracket(nodes, s.abs()));
            }
        }
        let weights = measure::reading_weights(axis, theta_i, summary.azimuth_width_deg.to_radians());
        Self { kernel, weights, at, share: summary.share(component), normal: theta_i == 0.0 }
    }

    fn values<'s>(&'s self, own: f64, ln_r: &'s [f64]) -> impl Iterator<Item = f64> + 's {
        self.kernel.iter().zip(&self.at).map(move |(kernel, (i, t))| {
            let next = (i + 1).min(ln_r.len() - 1);
            kernel * (own + ln_r[*i] * (1.0 - t) + ln_r[next] * t).exp()
        })
    }

    fn integral(&self, own: f64, ln_r: &[f64]) -> f64 {
        self.values(own, ln_r).zip(&self.weights).map(|(v, w)| v * w).sum()
    }
}

/// A lobe with new values; standard errors stay the same share of them.
fn with_values(lobe: &Lobe, values: Vec<f64>) -> Lobe {
    let value: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
    let std_error = lobe.std_error.iter().zip(&lobe.value).zip(&value).map(|((error, old), new)| {
        // A cell that was empty has no share to keep.
        if *old > 0.0 { error * (new / old) } else { *error }
    });
    Lobe { std_error: std_error.collect(), count: lobe.count.clone(), value }
}

/// The table with the moments of the exit angle that its cells have.
fn with_moments(table: &Table) -> Parts {
    let mut parts = table.clone().into_parts();
    for (i, summary) in parts.meta.per_incidence.iter_mut().enumerate() {
        if let Some(Moments { moments: [mean, sd, skew], .. }) = Moments::of_cells(table, i, 0.0) {
            summary.mean_theta_o_deg = mean.to_degrees();
            summary.sd_theta_o_deg = sd.to_degrees();
            summary.skew_theta_o = skew;
        }
    }
    parts
}

/// Light as read at the larger angle less its albedo, at one θi: of interior and of rehit, and all light over all albedo.
fn light_as_read(lobe: &Interpolant, theta_i: f64) -> [f64; 3] {
    // At 90° itself no light arrives.
    let theta_i = theta_i.min(GRAZING_DEG.to_radians());
    let table = lobe.table();
    let own = lobe.row(theta_i);
    // Values are smooth between the centres and edges of the row's own cells, from which other rows differ little.
    let mut nodes: Vec<f64> =
        (0..=2 * own.columns().cells).map(|half| own.columns().at(0.5 * half as f64).abs()).collect();
    nodes.extend([0.0, theta_i]);
    nodes.sort_by(f64::total_cmp);
    let mut light = [0.0; 2];
    for (theta_o, weight) in nodes.windows(2).flat_map(|ends| rule(ends[0], ends[1])) {
        let swap = theta_o > theta_i;
        let larger = if swap { lobe.row(theta_o) } else { own.clone() };
        let (at, taken_over) = if swap { (theta_i, theta_o.cos() / theta_i.cos()) } else { (theta_o, 1.0) };
        for (light, component) in light.iter_mut().zip([Component::Interior, Component::Rehit]) {
            let around = larger.correction(component) * around(&larger, &table.lobe(component).value, at);
            *light += weight * theta_o.sin() * around * taken_over;
        }
    }
    let albedo = [Component::Interior, Component::Rehit].map(|component| lobe.albedo(component, theta_i));
    let gain = [light[0] - albedo[0], light[1] - albedo[1]];
    let all = lobe.albedo(Component::Interior, theta_i) + lobe.albedo(Component::Surface, theta_i);
    [gain[0], gain[1], if all > 0.0 { 1.0 + (gain[0] + gain[1]) / all } else { 1.0 }]
}

/// Integral over the azimuth of a channel as a row is read, at one exit angle.
fn around(row: &Row<'_>, samples: &[f32], theta_o: f64) -> f64 {
    let Some(phi) = row.phi() else {
        let mean = decay::mean_decay(decay::concentration(row.theta_i(), theta_o, row.azimuth_width()));
        let (ahead, back) = (row.read(samples, theta_o, 0.0), row.read(samples, theta_o, PI));
        return TAU * (ahead * mean + back * (1.0 - mean));
    };
    let along = row.columns().position(theta_o);
    // Linear in φ position between centres: two points a half cell are plenty.
    (0..2 * phi.cells)
        .flat_map(|half| rule(0.5 * half as f64, 0.5 * (half + 1) as f64))
        .map(|(position, weight)| {
            2.0 * weight * phi.slope(position) * row.at_position(samples, position, along)
        })
        .sum()
}

/// Points and weights of the two-point Gauss–Legendre rule between two ends.
fn rule(from: f64, to: f64) -> [(f64, f64); 2] {
    let (middle, half) = (0.5 * (from + to), 0.5 * (to - from));
    let reach = half / 3f64.sqrt();
    [(middle - reach, half), (middle + reach, half)]
}
