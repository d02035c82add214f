//! Made-up tables with Gaussian lobes and closed-form albedos: what tests read, damage and compare.
//!
//! ```
//! let table = specimen::plane(&[0.0, 30.0, 60.0], 60);
//! let lobe = lut_io::lobe::Interpolant::new(table);
//! let theta_i = 30_f64.to_radians();
//! let albedo = lobe.albedo(lut_io::table::Component::Interior, theta_i);
//! assert!((albedo - specimen::interior_albedo(theta_i)).abs() < 1e-6);
//! ```
//!
//! [`plane`], [`space`] and [`table()`] make tables, [`changed`] makes another of one. Parts that make no table panic: a test's input is
//! the test's own. Never published, and without features.

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
    let first = theta_i_deg.first().copied().unwrap_or_default();
    let mut parts =
        Parts { meta: meta(axis, first), lobes: Default::default(), passages: None, bands: Vec::new() };
    for degrees in theta_i_deg {
        let theta_i = degrees.to_radians();
        let width = if matches!(axis, ExitAxis::Plane { .. }) { 2.0 * axis.width() } else { 0.0 };
        let weights = measure::reading_weights(&axis, theta_i, width);
        let extents = measure::cell_extents(&axis, theta_i);
        let add = |lobe: &mut Lobe, albedo: f64, widths: f64| {
            let light = Light::new(&axis, theta_i, widths * axis.width(), albedo);
            let factors = measure::value_factors(&light.shares, &extents, &weights);
            for ((share, factor), count) in light.shares.iter().zip(factors).zip(counts(&light.shares)) {
                let error = match count {
                    0.0 => (share * (1.0 - share) / PATHS as f64).sqrt(),
                    _ => share * (1.0 / count - 1.0 / PATHS as f64).sqrt(),
                };
                lobe.value.push((share * factor) as f32);
                lobe.std_error.push((error * factor) as f32);
                lobe.count.push(count as f32);
            }
            light
        };
        let [interior, surface, rehit] = &mut parts.lobes;
        let inside = add(interior, interior_albedo(theta_i), 2.25);
        let outside = add(surface, surface_albedo(theta_i), 1.0);
        add(rehit, rehit_albedo(theta_i), 1.5);
        parts.meta.per_incidence.push(summary(*degrees, width, moments(&inside, &outside)));
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

/// Where the light of one incidence is: Gaussian in s in the plane, in the chord to the mirror direction in space.
struct Light {
    /// Share of the light in each cell.
    shares: Vec<f64>,
    /// Sums over the light of powers 0 to 3 of the exit angle.
    powers: [f64; 4],
}

impl Light {
    /// Parts of a cell, along each of its axes, by which the Gaussian is summed.
    const PARTS: usize = 6;

    fn new(axis: &ExitAxis, theta_i: f64, sd: f64, albedo: f64) -> Self {
        let parts = |edges: &[f64]| -> Vec<Vec<[f64; 2]>> {
            let of = |edge: &[f64]| {
                let size = (edge[1] - edge[0]) / Self::PARTS as f64;
                (0..Self::PARTS).map(|part| [edge[0] + (part as f64 + 0.5) * size, size]).collect()
            };
            edges.windows(2).map(of).collect()
        };
        let gauss = |r2: f64| (-0.5 * r2 / (sd * sd)).exp();
        // Light per radian of the exit angle, and of the azimuth in space.
        let in_plane = matches!(axis, ExitAxis::Plane { .. });
        let density = |t: f64, p: f64| match in_plane {
            true => gauss((t - theta_i).powi(2)) * t.cos(),
            false => {
                let cos = t.cos() * theta_i.cos() + t.sin() * theta_i.sin() * p.cos();
                gauss(2.0 * (1.0 - cos)) * t.cos() * t.sin()
            }
        };
        let columns = parts(&axis.columns_at(theta_i).edges());
        // Without azimuth there is one part, of no size of its own.
        let rows = axis.phi_at(theta_i).map_or_else(|| vec![vec![[0.0, 1.0]]], |phi| parts(&phi.edges()));
        let (mut shares, mut powers) = (Vec::new(), [0.0; 4]);
        for row in &rows {
            for column in &columns {
                let mut share = 0.0;
                for [t, t_size] in column {
                    let light = t_size * row.iter().map(|[p, size]| density(*t, *p) * size).sum::<f64>();
                    share += light;
                    for (power, sum) in powers.iter_mut().enumerate() {
                        *sum += light * t.powi(power as i32);
                    }
                }
                shares.push(share);
            }
        }
        let scale = albedo / powers[0];
        Self {
            shares: shares.iter().map(|share| share * scale).collect(),
            powers: powers.map(|sum| sum * scale),
        }
    }
}

/// Mean and standard deviation of the exit angle, radians, and its skewness, of the light of both.
fn moments(interior: &Light, surface: &Light) -> [f64; 3] {
    let of = |power: usize| {
        (interior.powers[power] + surface.powers[power]) / (interior.powers[0] + surface.powers[0])
    };
    let mean = of(1);
    let variance = of(2) - mean * mean;
    let third = of(3) - 3.0 * mean * of(2) + 2.0 * mean.powi(3);
    [mean, variance.sqrt(), third / variance.powf(1.5)]
}

/// Paths of each cell, whole numbers that add up to the paths of the component to within one.
fn counts(shares: &[f64]) -> Vec<f64> {
    let mut sum = 0.0;
    let step = |share: &f64| {
        let before: f64 = f64::round(sum * PATHS as f64);
        sum += share;
        (sum * PATHS as f64).round() - before
    };
    shares.iter().map(step).collect()
}

fn summary(theta_i_deg: f64, width: f64, [mean, sd, skew]: [f64; 3]) -> IncidenceSummary {
    let theta_i = theta_i_deg.to_radians();
    let albedo = interior_albedo(theta_i) + surface_albedo(theta_i);
    let binomial = |share: f64| (share * (1.0 - share) / PATHS as f64).sqrt();
    let per_path = 1.0 / (albedo * PATHS as f64).sqrt();
    IncidenceSummary {
        theta_i_deg,
        albedo,
        transmitted: 1.0 - albedo,
        absorbed: 0.0,
        truncated: 0.0,
        surface: surface_albedo(theta_i),
        rehit: rehit_albedo(theta_i),
        mean_theta_o_deg: mean.to_degrees(),
        sd_theta_o_deg: sd.to_degrees(),
        skew_theta_o: skew,
        std_error: SummaryErrors {
            albedo: binomial(albedo),
            transmitted: binomial(albedo),
            surface: binomial(surface_albedo(theta_i)),
            mean_theta_o_deg: sd.to_degrees() * per_path,
            sd_theta_o_deg: sd.to_degrees() * per_path,
            skew_theta_o: 2.5 * per_path,
            ..SummaryErrors::default()
        },
        paths: PATHS,
        azimuth_width_deg: width.to_degrees(),
        accuracy_percent: 0.9,
    }
}

fn meta(exit_axis: ExitAxis, worst_theta_i_deg: f64) -> Meta {
    Meta {
        schema: SCHEMA.to_owned(),
        writer: "specimen 0.1.0".to_owned(),
        recipe: serde_json::json!({"schema": "specimen/1", "name": "specimen"}),
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
            reached_percent: f64::hypot(0.9, 0.05),
            worst_theta_i_deg,
            solver_percent: 0.9,
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
