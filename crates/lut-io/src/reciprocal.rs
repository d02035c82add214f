//! Reciprocal tables: f(θi → θo) = f(θo → θi) at any pair of directions, exactly.
//!
//! Write F = f·cos θi·cos θo; of a table it is v(θi → θo)·cos θi, v the stored f·cos θo. Facets that are met unweighted, the
//! azimuth postulate with its width by θi, and reading between cells all leave F(a → b) and F(b → a) different.
//!
//! A table with the section [`KEY`] is read *at the larger of its two angles*: F(a, b) = v(larger → smaller)·cos larger. So it is
//! reciprocal by construction, between its nodes too, and finite at grazing. [`symmetrised`] makes such a table of any other: the
//! symmetric kernel r(a)·r(b)·√(v(a → b)·v(b → a))·cos a·cos b, the geometric mean of both ways, with the one curve r that leaves
//! every directional albedo as it was (the symmetric scaling of Sinkhorn 1967: of all reciprocal kernels with these albedos it
//! is the one nearest to both ways in relative entropy).

use crate::axis::ExitAxis;
use crate::compact::KEY as COMPACT;
use crate::decay;
use crate::dispersion;
use crate::error::FieldError;
use crate::lobe::{Interpolant, Row};
use crate::measure;
use crate::table::{Component, IncidenceSummary, Lobe, Meta, Table};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Key of the section in the metadata.
pub const KEY: &str = "reciprocal";
/// 90° is taken for this: at 90° itself no light arrives, and the ways there and back have no common measure.
const GRAZING_DEG: f64 = 89.9;
/// Most rounds of the scaling, and the relative error of the albedo that ends it.
const ROUNDS: usize = 2000;
const SCALED: f64 = 1e-10;

/// What making a table reciprocal changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// Largest total variation between the table before and after, per cent of the reflected light.
    pub moved_percent: f64,
    /// Largest relative difference between the reflected light as read at the larger angle and its albedo, per cent.
    pub albedo_percent: f64,
    /// Light of the interior lobe as read, less its albedo, at [`STEPS`] equal steps of θi from 0 to 90°.
    pub interior_gain: Vec<f64>,
    /// The same of the rehit lobe.
    pub rehit_gain: Vec<f64>,
}

impl Section {
    /// Light of interior and rehit as read, less their albedos, at θi (radians): linear between the steps.
    #[must_use]
    pub fn gain(&self, theta_i: f64) -> [f64; 2] {
        let step = (theta_i / FRAC_PI_2).clamp(0.0, 1.0) * STEPS as f64;
        let k = (step as usize).min(STEPS - 1);
        let t = step - k as f64;
        [&self.interior_gain, &self.rehit_gain].map(|gain| gain[k] * (1.0 - t) + gain[k + 1] * t)
    }
}

/// Steps of θi at which a table says how much light is read: a quarter of a degree each.
pub const STEPS: usize = 360;

/// Whether a table is read as a reciprocal one.
#[must_use]
pub fn is_reciprocal(meta: &Meta) -> bool {
    meta.extra.contains_key(KEY)
}

/// The section of metadata, if they have one.
///
/// # Errors
/// It is there and is not valid.
pub fn section(meta: &Meta) -> Result<Option<Section>, FieldError> {
    let Some(value) = meta.extra.get(KEY) else { return Ok(None) };
    let section: Section =
        serde_json::from_value(value.clone()).map_err(|error| FieldError::new(KEY, error.to_string()))?;
    for (name, gain) in [("interior_gain", &section.interior_gain), ("rehit_gain", &section.rehit_gain)] {
        if gain.len() != STEPS + 1 || gain.iter().any(|share| !(-1.0..=1.0).contains(share)) {
            let problem = format!("{name}: expected {} numbers from -1 to 1", STEPS + 1);
            return Err(FieldError::new(KEY, problem));
        }
    }
    let widths: Vec<f64> = meta.per_incidence.iter().map(|s| s.azimuth_width_deg).collect();
    match widths.iter().find(|width| **width != widths[0]) {
        None => Ok(Some(section)),
        Some(other) => {
            let problem =
                format!("needs one azimuth_width_deg at all incidences, found {} and {other}", widths[0]);
            Err(FieldError::new(KEY, problem))
        }
    }
}

/// The reciprocal table nearest to a table.
///
/// Albedos, the ledger and counts stay; values, standard errors (each in proportion) and the moments of the exit angle are those
/// of the new lobes. In decay tables the azimuth width becomes one for all incidences: the mean of theirs, weighted by the light
/// that each sends back under an even sky.
///
/// # Errors
/// A table that holds light from below, or is compact, or reciprocal already.
pub fn symmetrised(table: &Table) -> Result<Table, FieldError> {
    for (key, what) in [
        (crate::both_sides::KEY, "light from below has no reciprocal form here"),
        (COMPACT, "a compact table is not made reciprocal: make the table so, then fit it"),
        (KEY, "is there already"),
    ] {
        if table.meta.extra.contains_key(key) {
            return Err(FieldError::new(key, what));
        }
    }
    if !table.bands.is_empty() {
        return Err(several_bands());
    }
    let before = Interpolant::new(table.clone());
    let even = with_one_width(table);
    let lobe = Interpolant::new(even);
    let mut symmetric = lobe.table().clone();
    for component in Component::ALL {
        let values = scaled_kernel(&lobe, component);
        let target = match component {
            Component::Interior => &mut symmetric.interior,
            Component::Surface => &mut symmetric.surface,
            Component::Rehit => &mut symmetric.rehit,
        };
        *target = with_values(target, table.lobe(component), values);
    }
    restate_moments(&mut symmetric);
    let unread = Section {
        moved_percent: 0.0,
        albedo_percent: 0.0,
        interior_gain: vec![0.0; STEPS + 1],
        rehit_gain: vec![0.0; STEPS + 1],
    };
    store(&mut symmetric.meta, &unread)?;
    let read = Interpolant::new(symmetric);
    let light: Vec<[f64; 3]> = (0..=STEPS)
        .into_par_iter()
        .map(|k| light_as_read(&read, FRAC_PI_2 * k as f64 / STEPS as f64))
        .collect();
    let section = Section {
        moved_percent: crate::diff::diff(&before, &read).worst_total_variation_percent,
        albedo_percent: 100.0 * light.iter().map(|[_, _, all]| (all - 1.0).abs()).fold(0.0, f64::max),
        interior_gain: light.iter().map(|[interior, ..]| *interior).collect(),
        rehit_gain: light.iter().map(|[_, rehit, _]| *rehit).collect(),
    };
    let mut symmetric = read.table().clone();
    store(&mut symmetric.meta, &section)?;
    symmetric.validate()?;
    Ok(symmetric)
}

/// Why a table of several bands is refused; also for those who know before the bake.
#[must_use]
pub fn several_bands() -> FieldError {
    let problem = "a table of several bands is not made reciprocal; bake without the effect dispersion";
    FieldError::new(dispersion::KEY, problem)
}

fn store(meta: &mut Meta, section: &Section) -> Result<(), FieldError> {
    let value = serde_json::to_value(section).map_err(|error| FieldError::new(KEY, error.to_string()))?;
    meta.extra.insert(KEY.to_owned(), value);
    Ok(())
}

/// A decay table with one azimuth width, every lobe keeping its share; other tables as they are.
fn with_one_width(table: &Table) -> Table {
    let mut even = table.clone();
    if matches!(table.meta.exit_axis, ExitAxis::Space { .. }) {
        return even;
    }
    let light = |s: &IncidenceSummary| {
        let theta = s.theta_i_deg.to_radians();
        // Also where the only incidences are 0 and 90°.
        (s.albedo * theta.sin() * theta.cos()).max(1e-12)
    };
    let total: f64 = table.meta.per_incidence.iter().map(light).sum();
    let width_deg =
        table.meta.per_incidence.iter().map(|s| light(s) * s.azimuth_width_deg).sum::<f64>() / total;
    let same = table
        .meta
        .per_incidence
        .iter()
        .all(|s| s.azimuth_width_deg == table.meta.per_incidence[0].azimuth_width_deg);
    let width_deg = if same { table.meta.per_incidence[0].azimuth_width_deg } else { width_deg };
    let cells = table.meta.exit_axis.cells();
    for i in 0..even.meta.per_incidence.len() {
        even.meta.per_incidence[i].azimuth_width_deg = width_deg;
        let summary = even.meta.per_incidence[i].clone();
        let theta_i = summary.theta_i_deg.to_radians();
        let weights = measure::reading_weights(&table.meta.exit_axis, theta_i, width_deg.to_radians());
        for (component, lobe) in
            Component::ALL.into_iter().zip([&mut even.interior, &mut even.surface, &mut even.rehit])
        {
            let row = &mut lobe.value[i * cells..(i + 1) * cells];
            let integral: f64 = weights.iter().zip(&*row).map(|(w, v)| w * f64::from(*v)).sum();
            if integral > 0.0 {
                let scale = summary.share(component) / integral;
                row.iter_mut().for_each(|v| *v = (f64::from(*v) * scale) as f32);
            }
        }
    }
    even
}

/// Rows of the scaled symmetric kernel of one component, f·cos θo.
fn scaled_kernel(lobe: &Interpolant, component: Component) -> Vec<f64> {
    let table = lobe.table();
    let axis = &table.meta.exit_axis;
    let theta = table.theta_i();
    let rows: Vec<KernelRow> = table
        .meta
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

/// The node at or before x, and how far x is towards the next; clamped.
fn bracket(nodes: &[f64], x: f64) -> (usize, f64) {
    let above = nodes.partition_point(|node| *node <= x);
    match above {
        0 => (0, 0.0),
        above if above == nodes.len() => (above - 1, 0.0),
        above => (above - 1, (x - nodes[above - 1]) / (nodes[above] - nodes[above - 1])),
    }
}

/// A lobe with new values; standard errors stay the same share of them.
fn with_values(even: &Lobe, original: &Lobe, values: Vec<f64>) -> Lobe {
    let value: Vec<f32> = values.into_iter().map(|v| v as f32).collect();
    let std_error = original.std_error.iter().zip(&original.value).zip(&value).map(|((error, old), new)| {
        // A cell that was empty has no share to keep.
        if *old > 0.0 { error * (new / old) } else { *error }
    });
    Lobe { std_error: std_error.collect(), count: even.count.clone(), value }
}

/// Mean, standard deviation and skewness of the exit angle of all reflected light, from the cells.
fn restate_moments(table: &mut Table) {
    let axis = table.meta.exit_axis;
    let cells = axis.cells();
    for i in 0..table.meta.per_incidence.len() {
        let summary = &mut table.meta.per_incidence[i];
        let theta_i = summary.theta_i_deg.to_radians();
        let angles = axis.columns_at(theta_i).centres();
        // In decay tables the moments are those of the plane walk, whose density is value over angle.
        let extents = measure::cell_extents(&axis, theta_i);
        let light: Vec<(f64, f64)> = (0..cells)
            .map(|k| {
                let value = f64::from(table.interior.value[i * cells + k])
                    + f64::from(table.surface.value[i * cells + k]);
                (angles[k % angles.len()], value * extents[k])
            })
            .collect();
        let total: f64 = light.iter().map(|(_, mass)| mass).sum();
        if total <= 0.0 {
            continue;
        }
        let mean = light.iter().map(|(angle, mass)| angle * mass).sum::<f64>() / total;
        let moment =
            |n: i32| light.iter().map(|(angle, mass)| (angle - mean).powi(n) * mass).sum::<f64>() / total;
        let sd = moment(2).sqrt();
        summary.mean_theta_o_deg = mean.to_degrees();
        summary.sd_theta_o_deg = sd.to_degrees();
        summary.skew_theta_o = if sd > 0.0 { moment(3) / sd.powi(3) } else { 0.0 };
    }
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
