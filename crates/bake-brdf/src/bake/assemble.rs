//! From tallies to a table: shares of light per cell become f·cos θo per steradian.

use super::{Request, Target};
use crate::bake::sampling::Sampling;
use crate::recipe::Recipe;
use crate::tally::{CellShares, Tally};
use crate::transport::{Normals, Transport};
use lut_io::axis::ExitAxis;
use lut_io::measure;
use lut_io::table::{
    Accuracy, AzimuthMode, Component, IncidenceSummary, Lobe, Meta, SCHEMA, Solver, SurfaceModel, Table,
};

/// The table of a finished walk.
pub(super) fn walk_table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    sampling: &Sampling,
) -> Table {
    let mut table = Table {
        meta: meta(request, transport, axis, sampling),
        interior: Lobe::default(),
        surface: Lobe::default(),
        rehit: Lobe::default(),
    };
    for (tally, summary) in sampling.tallies().iter().zip(&table.meta.per_incidence) {
        let theta_i = summary.theta_i_deg.to_radians();
        let extents = measure::cell_extents(axis, theta_i);
        let weights = measure::reading_weights(axis, theta_i, summary.azimuth_width_deg.to_radians());
        for (lobe, component) in [
            (&mut table.interior, Component::Interior),
            (&mut table.surface, Component::Surface),
            (&mut table.rehit, Component::Rehit),
        ] {
            let mut shares = tally.component(component);
            if theta_i == 0.0 {
                symmetrise(axis, &extents, &mut shares);
            }
            push_row(lobe, &shares, &extents, &weights);
        }
    }
    table.meta.accuracy = accuracy(request.target, axis, sampling.tallies(), &table.meta.per_incidence);
    table
}

fn meta(request: &Request, transport: &Transport, axis: &ExitAxis, sampling: &Sampling) -> Meta {
    let summary = |(tally, &theta_i_deg): (&Tally, &f64)| {
        let mut summary = tally.summary(theta_i_deg);
        if matches!(axis, ExitAxis::Plane { .. }) {
            summary.azimuth_width_deg = azimuth_width_deg(&request.recipe, &summary);
        }
        summary
    };
    Meta {
        schema: SCHEMA.to_owned(),
        writer: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
        recipe: request.recipe.to_json(),
        seed: request.seed,
        solver: Solver::Walk,
        solver_settings: serde_json::json!({
            "estimator": "analog",
            "precision": sampling.precision(),
            "event_cap": request.event_cap,
            "crossings": sampling.tallies().iter().map(|tally| tally.crossings).sum::<u64>(),
        }),
        azimuth: match axis {
            ExitAxis::Plane { .. } => AzimuthMode::Decay,
            ExitAxis::Space { .. } => AzimuthMode::Walk,
        },
        wavelength_nm: request.recipe.light.wavelength_nm,
        accuracy: Accuracy::default(),
        exit_axis: *axis,
        surface_model: SurfaceModel {
            n_ambient: transport.indices[0],
            n_first: transport.indices[1],
            slope_sd: transport.facets.slope_sd,
            normals: match transport.facets.normals {
                Normals::Unweighted => "unweighted".to_owned(),
                Normals::Visible => "visible".to_owned(),
            },
        },
        effects: effects(transport, axis),
        per_incidence: sampling.tallies().iter().zip(&request.incident_deg).map(summary).collect(),
        extra: serde_json::Map::new(),
    }
}

fn effects(transport: &Transport, axis: &ExitAxis) -> Vec<String> {
    let mut effects = vec!["surface".to_owned(), "blur".to_owned()];
    effects.push(match axis {
        ExitAxis::Plane { .. } => "azimuth:decay".to_owned(),
        ExitAxis::Space { .. } => "azimuth:walk".to_owned(),
    });
    if transport.absorbs() {
        effects.push("absorption".to_owned());
    }
    effects
}

/// w of the decay postulate: the recipe's, or the standard deviation of the plane lobe at this θi.
fn azimuth_width_deg(recipe: &Recipe, summary: &IncidenceSummary) -> f64 {
    // A lobe without spread (σ = 0, or no light at all) still needs a width to divide by.
    const NARROWEST_DEG: f64 = 1e-4;
    recipe.azimuth.width_deg.unwrap_or(summary.sd_theta_o_deg).max(NARROWEST_DEG)
}

/// Stored values, errors and counts of one component at one incidence.
fn push_row(lobe: &mut Lobe, shares: &CellShares, extents: &[f64], weights: &[f64]) {
    let factors = measure::value_factors(&shares.share, extents, weights);
    let scaled = |values: &[f64]| -> Vec<f32> {
        values.iter().zip(&factors).map(|(value, factor)| (value * factor) as f32).collect()
    };
    lobe.value.extend(scaled(&shares.share));
    lobe.std_error.extend(scaled(&shares.std_error));
    lobe.count.extend(shares.count.iter().map(|&count| count as f32));
}

/// At normal incidence nothing distinguishes an azimuth: averages over the cells that differ by it alone, and
/// keeps each cell's own count. Averaging n independent shares divides the error of their sum by n.
fn symmetrise(axis: &ExitAxis, extents: &[f64], shares: &mut CellShares) {
    let columns = axis.columns();
    let rows = axis.rows_per_incidence();
    let groups: Vec<Vec<usize>> = match axis {
        ExitAxis::Plane { .. } => (0..columns / 2).map(|k| vec![k, columns - 1 - k]).collect(),
        ExitAxis::Space { .. } => {
            (0..columns).map(|k| (0..rows).map(|row| row * columns + k).collect()).collect()
        }
    };
    for group in groups {
        let share: f64 = group.iter().map(|&k| shares.share[k]).sum();
        let error = group.iter().map(|&k| shares.std_error[k].powi(2)).sum::<f64>().sqrt();
        let extent: f64 = group.iter().map(|&k| extents[k]).sum();
        for &k in &group {
            shares.share[k] = share * extents[k] / extent;
            shares.std_error[k] = error * extents[k] / extent;
        }
    }
}

fn accuracy(target: Target, axis: &ExitAxis, tallies: &[Tally], summaries: &[IncidenceSummary]) -> Accuracy {
    let worst = summaries.iter().max_by(|a, b| a.accuracy_percent.total_cmp(&b.accuracy_percent));
    Accuracy {
        asked_percent: match target {
            Target::AccuracyPercent(percent) => Some(percent),
            Target::Paths(_) | Target::Time(_) => None,
        },
        reached_percent: worst.map_or(0.0, |summary| summary.accuracy_percent),
        worst_theta_i_deg: worst.map_or(0.0, |summary| summary.theta_i_deg),
        interpolation_percent: 100.0 * interpolation_error(axis, tallies, summaries),
    }
}

/// Error of reading half-way between two incidences, as total variation, worst interval.
///
/// Each inner row is predicted from its two neighbours. What that misses by, less the noise of the three rows, is
/// the error of linear interpolation over the double interval; over a single one it is a quarter.
fn interpolation_error(axis: &ExitAxis, tallies: &[Tally], summaries: &[IncidenceSummary]) -> f64 {
    let rows: Vec<(f64, Vec<f64>, Vec<f64>, f64)> = tallies
        .iter()
        .zip(summaries)
        .map(|(tally, summary)| {
            let theta_i = summary.theta_i_deg.to_radians();
            let extents = measure::cell_extents(axis, theta_i);
            let share = tally.reflected_shares();
            let total: f64 = share.iter().sum();
            let density =
                share.iter().zip(&extents).map(|(s, e)| s / e / total.max(f64::MIN_POSITIVE)).collect();
            (theta_i, density, extents, tally.total_variation_error())
        })
        .collect();
    let missed = rows.windows(3).map(|three| {
        let [(a, before, _, noise_a), (b, here, extents, noise_b), (c, after, _, noise_c)] = three else {
            return 0.0;
        };
        let t = (b - a) / (c - a);
        let predicted: Vec<f64> = before.iter().zip(after).map(|(x, y)| (1.0 - t) * x + t * y).collect();
        // A probability again, as the reader restores the albedo.
        let mass: f64 = predicted.iter().zip(extents).map(|(p, e)| p * e).sum();
        let difference: f64 =
            predicted.iter().zip(here).zip(extents).map(|((p, h), e)| (p / mass - h).abs() * e).sum();
        let noise2 = ((1.0 - t) * noise_a).powi(2) + (t * noise_c).powi(2) + noise_b.powi(2);
        ((0.5 * difference).powi(2) - noise2).max(0.0).sqrt()
    });
    0.25 * missed.fold(0.0, f64::max)
}
