//! From a solver's answer to a table: shares of light per cell become f·cos θo per steradian.

use super::cells::cell_shares;
use super::halfway::{self, Halfway, Row};
use super::{BakeError, Bands, Request};
use crate::bake::sampling::Sampling;
use crate::options::{SolverChoice, Target};
use crate::tally::CellShares;
use lut_io::axis::ExitAxis;
use lut_io::measure;
use lut_io::table::{
    Accuracy, AzimuthMode, Component, IncidenceSummary, Lobe, Meta, SCHEMA, Solver, SummaryErrors,
    SurfaceModel, Table,
};
use rayon::prelude::*;
use transport::doubling::{ErrorEstimate, Lobe as SolvedLobe, Solution};
use transport::{Normals, Transport};

/// What a solver knows of one incidence.
pub(super) struct Incidence {
    pub(super) summary: IncidenceSummary,
    /// In the order of [`Component::ALL`].
    pub(super) components: [CellShares; 3],
    /// Statistical part of the total variation.
    pub(super) noise: f64,
}

/// The table of a finished walk, with those of its further bands.
pub(super) fn walk_tables(request: &Request, bands: &Bands, sampling: &Sampling) -> Result<Table, BakeError> {
    let table = |(nm, band)| {
        let request = request.at_wavelength(nm);
        Ok(walk_table(&request, &request.transport()?, &request.exit_axis(), sampling, band))
    };
    let mut tables = bands.all_nm().zip(0..).map(table).collect::<Result<Vec<_>, BakeError>>()?;
    let further = tables.split_off(1);
    joined(tables.remove(0), further, bands)
}

/// The table of the recipe's wavelength with those of its further bands.
pub(super) fn joined(mut table: Table, further: Vec<Table>, bands: &Bands) -> Result<Table, BakeError> {
    if !further.is_empty() {
        let added = table.add_bands(further, bands.rgb_weights(), bands.interpolation_percent);
        added.map_err(super::invalid)?;
    }
    Ok(table)
}

fn walk_table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    sampling: &Sampling,
    band: usize,
) -> Table {
    let tallies = sampling.band_tallies(band);
    let incidences =
        tallies.iter().zip(&request.options.incident_deg).enumerate().map(|(i, (tally, &theta_i_deg))| {
            let spread = sampling.spread(band * tallies.len() + i);
            Incidence {
                summary: IncidenceSummary {
                    accuracy_percent: 100.0 * tally.total_variation_bound(spread, tallies.len()),
                    ..tally.summary(theta_i_deg)
                },
                components: Component::ALL.map(|component| tally.component(component)),
                noise: tally.total_variation_error(spread),
            }
        });
    let crossings: u64 = tallies.iter().map(|tally| tally.crossings).sum();
    let mut settings = settings([
        ("estimator", "analog".into()),
        ("precision", sampling.precision().into()),
        ("event_cap", request.options.event_cap.into()),
        ("crossings", crossings.into()),
    ]);
    if let Target::Time(budget) = request.options.target {
        settings.insert("time_budget_seconds".to_owned(), budget.as_secs_f64().into());
    }
    let halfway = |rows: &[Row]| {
        halfway::beside_walk(
            &request.recipe,
            transport,
            request.geometry(),
            axis,
            &request.theta_i(),
            crossings,
        )
        .unwrap_or_else(|| halfway::estimated(axis, rows))
    };
    table(request, transport, axis, (Solver::Walk, settings), incidences.collect(), halfway)
}

/// The table of a doubling solution: of the request's incidences, then of the middles of some `intervals` between them.
pub(super) fn doubling_table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    solution: &Solution,
    intervals: &[usize],
) -> Table {
    let stored = request.options.incident_deg.len();
    let incidences: Vec<Incidence> = (0..stored)
        .into_par_iter()
        .map(|i| {
            let summary = doubling_summary(solution, i, request.options.incident_deg[i]);
            // The estimate is a total variation: spread over the cells in proportion to their light.
            let relative = 2.0 * summary.accuracy_percent / 100.0;
            let components = cell_shares(axis, solution, i).map(|share| CellShares {
                std_error: share.iter().map(|share| relative * share).collect(),
                count: vec![0; share.len()],
                share,
            });
            Incidence { summary, components, noise: 0.0 }
        })
        .collect();
    let settings = settings([
        ("nodes", solution.settings.nodes.into()),
        ("modes", solution.settings.modes.into()),
        ("reach", solution.settings.reach.into()),
        ("density", solution.settings.density.into()),
    ]);
    let halfway = |rows: &[Row]| {
        let middles: Vec<Row> = (stored..solution.lobes.len())
            .into_par_iter()
            .map(|i| Row::solved(&request.recipe, axis, solution, i))
            .collect();
        halfway::measured(axis, rows, intervals, &middles)
    };
    table(request, transport, axis, (Solver::Doubling, settings), incidences, halfway)
}

pub(super) fn settings<const N: usize>(
    entries: [(&str, serde_json::Value); N],
) -> serde_json::Map<String, serde_json::Value> {
    entries.into_iter().map(|(key, value)| (key.to_owned(), value)).collect()
}

/// The table of a pearl that shows no lobe.
pub(super) fn lobeless_table(request: &Request, transport: &Transport, axis: &ExitAxis) -> Table {
    let incidences = request.options.incident_deg.iter().map(|&theta_i_deg| Incidence {
        summary: IncidenceSummary { theta_i_deg, transmitted: 1.0, ..IncidenceSummary::default() },
        components: Component::ALL.map(|_| CellShares {
            share: vec![0.0; axis.cells()],
            std_error: vec![0.0; axis.cells()],
            count: vec![0; axis.cells()],
        }),
        noise: 0.0,
    });
    let solver = (Solver::Doubling, settings([("lobe", "none".into())]));
    table(request, transport, axis, solver, incidences.collect(), |rows| halfway::estimated(axis, rows))
}

fn doubling_summary(solution: &Solution, i: usize, theta_i_deg: f64) -> IncidenceSummary {
    let error = solution.error.clone().unwrap_or_else(|| ErrorEstimate {
        total_variation: vec![0.0; solution.lobes.len()],
        transmitted: Vec::new(),
        albedo: 0.0,
        mean: 0.0,
        sd: 0.0,
        skew: 0.0,
    });
    let std_error = SummaryErrors {
        albedo: error.albedo,
        transmitted: error.albedo,
        absorbed: error.albedo,
        truncated: 0.0,
        surface: error.albedo,
        mean_theta_o_deg: error.mean.to_degrees(),
        sd_theta_o_deg: error.sd.to_degrees(),
        skew_theta_o: error.skew,
    };
    summary(&solution.lobes[i], theta_i_deg, std_error, 100.0 * error.total_variation[i])
}

/// Where nothing gets through, or nothing stays, sums of roundings end as often below zero as above; where facets beyond the
/// critical angle leave next to nothing to get through, by up to some 1e-11.
fn not_below_none(share: f64) -> f64 {
    const ROUNDING: f64 = 1e-9;
    if (-ROUNDING..0.0).contains(&share) { 0.0 } else { share }
}

pub(super) fn summary(
    lobe: &SolvedLobe,
    theta_i_deg: f64,
    std_error: SummaryErrors,
    accuracy_percent: f64,
) -> IncidenceSummary {
    IncidenceSummary {
        theta_i_deg,
        albedo: lobe.albedo,
        transmitted: not_below_none(lobe.transmitted),
        absorbed: not_below_none(lobe.absorbed),
        truncated: 0.0,
        surface: lobe.surface,
        rehit: lobe.rehit,
        mean_theta_o_deg: lobe.mean.to_degrees(),
        sd_theta_o_deg: lobe.sd.to_degrees(),
        skew_theta_o: lobe.skew,
        std_error,
        paths: 0,
        azimuth_width_deg: 0.0,
        accuracy_percent,
    }
}

/// The table and its error half-way between incidences, which `halfway` knows or finds from the table's rows.
pub(super) fn table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    solver: (Solver, serde_json::Map<String, serde_json::Value>),
    mut incidences: Vec<Incidence>,
    halfway: impl FnOnce(&[Row]) -> Halfway,
) -> Table {
    let mut lobes = [const { Lobe { value: Vec::new(), std_error: Vec::new(), count: Vec::new() } }; 3];
    let mut rows = Vec::new();
    for incidence in &mut incidences {
        let summary = &mut incidence.summary;
        if matches!(axis, ExitAxis::Plane { .. }) {
            summary.azimuth_width_deg = request.recipe.azimuth.decay_width_deg(summary.sd_theta_o_deg);
        }
        let theta_i = summary.theta_i_deg.to_radians();
        let extents = measure::cell_extents(axis, theta_i);
        let width = summary.azimuth_width_deg.to_radians();
        let weights = measure::reading_weights(axis, theta_i, width);
        for (lobe, shares) in lobes.iter_mut().zip(&mut incidence.components) {
            if theta_i == 0.0 {
                symmetrise(axis, &extents, shares);
            }
            push_row(lobe, shares, &extents, &weights);
        }
        let [interior, surface, _] = &incidence.components;
        let shares: [&[f64]; 2] = [&interior.share, &surface.share];
        rows.push(Row::new(theta_i, width, &extents, weights, shares, incidence.noise));
    }
    let summaries: Vec<IncidenceSummary> =
        incidences.into_iter().map(|incidence| incidence.summary).collect();
    let halfway = halfway(&rows);
    let accuracy = accuracy(request.options.target, halfway, &summaries);
    let (solver, mut settings) = solver;
    settings.insert("interpolation".to_owned(), serde_json::json!(halfway.by));
    let solver = (solver, settings.into());
    let [interior, surface, rehit] = lobes;
    Table {
        meta: meta(request, transport, axis, solver, summaries, accuracy),
        interior,
        surface,
        rehit,
        passages: None,
        bands: Vec::new(),
    }
}

fn meta(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    (solver, solver_settings): (Solver, serde_json::Value),
    per_incidence: Vec<IncidenceSummary>,
    accuracy: Accuracy,
) -> Meta {
    let by = match solver {
        Solver::Walk => SolverChoice::Walk,
        Solver::Doubling => SolverChoice::Doubling,
    };
    Meta {
        schema: SCHEMA.to_owned(),
        writer: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
        recipe: request.recipe.to_json(),
        seed: request.options.seed,
        solver,
        solver_settings,
        azimuth: match axis {
            ExitAxis::Plane { .. } => AzimuthMode::Decay,
            ExitAxis::Space { .. } => AzimuthMode::Space,
        },
        wavelength_nm: request.recipe.light.wavelength_nm,
        accuracy,
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
        // Set when the colours are in.
        effects: Vec::new(),
        per_incidence,
        extra: [("content_hash".to_owned(), serde_json::Value::String(request.content_hash(by)))]
            .into_iter()
            .collect(),
    }
}

/// Stored values, errors and counts of one component at one incidence.
pub(super) fn push_row(lobe: &mut Lobe, shares: &CellShares, extents: &[f64], weights: &[f64]) {
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
pub(super) fn symmetrise(axis: &ExitAxis, extents: &[f64], shares: &mut CellShares) {
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

fn accuracy(target: Target, halfway: Halfway, summaries: &[IncidenceSummary]) -> Accuracy {
    let worst = summaries.iter().max_by(|a, b| a.accuracy_percent.total_cmp(&b.accuracy_percent));
    Accuracy {
        asked_percent: match target {
            Target::AccuracyPercent(percent) => Some(percent),
            Target::Paths(_) | Target::Time(_) => None,
        },
        reached_percent: worst.map_or(0.0, |summary| summary.accuracy_percent),
        worst_theta_i_deg: worst.map_or(0.0, |summary| summary.theta_i_deg),
        interpolation_percent: 100.0 * halfway.share,
    }
}
