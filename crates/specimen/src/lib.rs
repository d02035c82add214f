//! Made-up tables with Gaussian lobes and closed-form albedos: what tests read, damage and compare.

use lut_io::axis::ExitAxis;
use lut_io::measure;
use lut_io::solver::{Estimator, Interpolation, Precision, Solver, SolverSettings, Walk};
use lut_io::table::{
    Accuracy, AzimuthMode, IncidenceSummary, Lobe, Meta, Normals, Parts, SCHEMA, SummaryErrors, SurfaceModel,
    Table,
};
use std::f64::consts::FRAC_PI_2;

/// Paths that a made-up table claims to rest on.
pub const PATHS: u64 = 1_000_000;

/// Share of the light that the interior returns.
#[must_use]
pub fn interior_albedo(theta_i: f64) -> f64 {
    0.34 * (1.0 - 0.8 * (theta_i / FRAC_PI_2).powi(4))
}

/// Share of the light that interface 0 returns.
#[must_use]
pub fn surface_albedo(theta_i: f64) -> f64 {
    0.044 + 0.85 * (theta_i / FRAC_PI_2).powi(6)
}

/// Share of the light that interface 0 returns after more than one hit.
#[must_use]
pub fn rehit_albedo(theta_i: f64) -> f64 {
    0.05 * (theta_i / FRAC_PI_2).powi(10)
}

/// A decay table.
#[must_use]
pub fn plane(theta_i_deg: &[f64], cells: usize) -> Table {
    table(theta_i_deg, ExitAxis::Plane { cells, width: 4f64.to_radians() })
}

/// A space table.
#[must_use]
pub fn space(theta_i_deg: &[f64], theta_cells: usize, phi_cells: usize) -> Table {
    table(theta_i_deg, ExitAxis::Space { theta_cells, phi_cells, width: 4f64.to_radians() })
}

/// A table with the given axis of stretch width w; lobes of 2.25 w (interior), w (surface) and 1.5 w (rehit) around
/// the mirror direction, and an azimuth width of 2 w.
#[must_use]
pub fn table(theta_i_deg: &[f64], axis: ExitAxis) -> Table {
    let mut parts = Parts { meta: meta(axis), lobes: Default::default(), passages: None, bands: Vec::new() };
    for degrees in theta_i_deg {
        let theta_i = degrees.to_radians();
        let width = if matches!(axis, ExitAxis::Plane { .. }) { 2.0 * axis.width() } else { 0.0 };
        let weights = measure::reading_weights(&axis, theta_i, width);
        let add = |lobe: &mut Lobe, albedo: f64, widths: f64| {
            let shares = shares(&axis, theta_i, widths * axis.width(), albedo);
            let factors = measure::value_factors(&shares, &measure::cell_extents(&axis, theta_i), &weights);
            for (share, factor) in shares.iter().zip(factors) {
                lobe.value.push((share * factor) as f32);
                let count = (share * PATHS as f64).round();
                let error = match count {
                    0.0 => (share * (1.0 - share) / PATHS as f64).sqrt(),
                    _ => share * (1.0 / count - 1.0 / PATHS as f64).sqrt(),
                };
                lobe.std_error.push((error * factor) as f32);
                lobe.count.push(count as f32);
            }
        };
        let [interior, surface, rehit] = &mut parts.lobes;
        add(interior, interior_albedo(theta_i), 2.25);
        add(surface, surface_albedo(theta_i), 1.0);
        add(rehit, rehit_albedo(theta_i), 1.5);
        parts.meta.per_incidence.push(summary(*degrees, width));
    }
    made(parts)
}

/// The table of these parts; panics where they make none.
#[must_use]
pub fn made(parts: Parts) -> Table {
    Table::new(parts).expect("a valid table")
}

/// Another table: this one with its parts changed; panics where they make none.
#[must_use]
pub fn changed(table: &Table, change: impl FnOnce(&mut Parts)) -> Table {
    let mut parts = table.clone().into_parts();
    change(&mut parts);
    made(parts)
}

/// Share of the light in each cell: Gaussian in s in the plane, in the chord to the mirror direction in space.
fn shares(axis: &ExitAxis, theta_i: f64, sd: f64, albedo: f64) -> Vec<f64> {
    let extents = measure::cell_extents(axis, theta_i);
    let columns = axis.columns_at(theta_i).centres();
    let gauss = |r2: f64| (-0.5 * r2 / (sd * sd)).exp();
    let mut shares: Vec<f64> = match axis.phi_at(theta_i) {
        None => columns.iter().map(|s| gauss((s - theta_i).powi(2)) * s.cos()).collect(),
        Some(phi) => {
            let chord2 = |t: f64, p: f64| {
                let cos = t.cos() * theta_i.cos() + t.sin() * theta_i.sin() * p.cos();
                2.0 * (1.0 - cos)
            };
            phi.centres()
                .iter()
                .flat_map(|p| columns.iter().map(move |t| (*t, *p)))
                .map(|(t, p)| gauss(chord2(t, p)) * t.cos())
                .collect()
        }
    };
    for (share, extent) in shares.iter_mut().zip(extents) {
        *share *= extent;
    }
    let total: f64 = shares.iter().sum();
    shares.iter().map(|share| share / total * albedo).collect()
}

fn summary(theta_i_deg: f64, width: f64) -> IncidenceSummary {
    let theta_i = theta_i_deg.to_radians();
    let albedo = interior_albedo(theta_i) + surface_albedo(theta_i);
    let error = (albedo * (1.0 - albedo) / PATHS as f64).sqrt();
    IncidenceSummary {
        theta_i_deg,
        albedo,
        transmitted: 1.0 - albedo,
        absorbed: 0.0,
        truncated: 0.0,
        surface: surface_albedo(theta_i),
        rehit: rehit_albedo(theta_i),
        mean_theta_o_deg: theta_i_deg,
        sd_theta_o_deg: 8.5,
        skew_theta_o: 0.1,
        std_error: SummaryErrors {
            albedo: error,
            transmitted: error,
            surface: error,
            mean_theta_o_deg: 0.01,
            sd_theta_o_deg: 0.01,
            skew_theta_o: 0.004,
            ..SummaryErrors::default()
        },
        paths: PATHS,
        azimuth_width_deg: width.to_degrees(),
        accuracy_percent: 0.9,
    }
}

fn meta(exit_axis: ExitAxis) -> Meta {
    Meta {
        schema: SCHEMA.to_owned(),
        writer: "specimen 0.1.0".to_owned(),
        recipe: serde_json::json!({"schema": "pearl-recipe/1", "name": "specimen"}),
        seed: 7,
        solver: Solver::Walk,
        solver_settings: SolverSettings::Walk(Walk {
            crossings: 40 * PATHS,
            estimator: Estimator::Analog,
            event_cap: 10_000_000,
            interpolation: Interpolation::Estimated,
            precision: Precision::F32,
            time_budget_seconds: None,
        }),
        azimuth: match exit_axis {
            ExitAxis::Plane { .. } => AzimuthMode::Decay,
            ExitAxis::Space { .. } => AzimuthMode::Space,
        },
        wavelength_nm: 550.0,
        accuracy: Accuracy {
            asked_percent: Some(1.0),
            reached_percent: 0.9,
            worst_theta_i_deg: 0.0,
            solver_percent: 0.8,
            rows_percent: 0.1,
            cells_percent: Some(0.05),
            components: None,
        },
        exit_axis,
        surface_model: SurfaceModel {
            n_ambient: 1.0,
            n_first: 1.53,
            slope_sd: 2f64.to_radians(),
            normals: Normals::Unweighted,
        },
        effects: vec!["surface".to_owned(), "blur".to_owned()],
        per_incidence: Vec::new(),
        both_sides: None,
        compact: None,
        content_hash: None,
        dispersion: None,
        reciprocal: None,
        spectra: None,
        spectra_missing: None,
    }
}
