//! From a solver's answer to a table: shares of light per cell become f·cos θo per steradian.

use super::halfway::{self, Halfway, Row};
use super::{BakeError, Bands, Lobes, Request, SolverChoice, Target, content_hash};
use crate::bake::sampling::Sampling;
use crate::tally::CellShares;
use faer::Mat;
use lut_io::axis::{ExitAxis, Stretched};
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
pub(super) fn walk_tables(request: &Request, lobes: &Lobes, sampling: &Sampling) -> Result<Table, BakeError> {
    let table = |band: usize, request: &Request| {
        walk_table(request, &lobes.transports[band], &lobes.axis, sampling, band)
    };
    let further = lobes.bands.further_nm.iter().zip(1..);
    let further = further.map(|(nm, band)| table(band, &request.at_wavelength(*nm))).collect();
    joined(table(0, request), further, &lobes.bands)
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
        tallies.iter().zip(&request.incident_deg).enumerate().map(|(i, (tally, &theta_i_deg))| {
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
        ("event_cap", request.event_cap.into()),
        ("crossings", crossings.into()),
    ]);
    if let Target::Time(budget) = request.target {
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
    let stored = request.incident_deg.len();
    let incidences: Vec<Incidence> = (0..stored)
        .into_par_iter()
        .map(|i| {
            let summary = doubling_summary(solution, i, request.incident_deg[i]);
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
    let incidences = request.incident_deg.iter().map(|&theta_i_deg| Incidence {
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

/// A Gauss rule over the cells around one lobe, three points a cell on the columns and two on φ, where lobes are
/// smoother.
pub(super) struct CellRule {
    pub(super) angles: Vec<f64>,
    pub(super) azimuths: Vec<f64>,
    weights: Vec<f64>,
    azimuth_weights: Vec<f64>,
    columns: usize,
    rows: usize,
}

impl CellRule {
    /// The rule over the cells of a row whose lobe is centred at `specular` (radians).
    pub(super) fn new(axis: &ExitAxis, specular: f64) -> Self {
        let columns = axis.columns_at(specular);
        let (angles, mut weights) = gauss(&columns, &GAUSS_3);
        let (azimuths, azimuth_weights) = match &axis.phi_at(specular) {
            None => (vec![0.0], vec![1.0]),
            Some(phi) => {
                for (weight, angle) in weights.iter_mut().zip(&angles) {
                    *weight *= angle.sin();
                }
                // Both mirror halves.
                let (azimuths, weights) = gauss(phi, &GAUSS_2);
                (azimuths, weights.iter().map(|w| 2.0 * w).collect())
            }
        };
        let rows = axis.rows_per_incidence();
        Self { angles, azimuths, weights, azimuth_weights, columns: columns.cells, rows }
    }

    /// Integral of a density (rows angles, columns azimuths) over each cell.
    pub(super) fn shares(&self, density: &Mat<f64>) -> Vec<f64> {
        let per_column = self.angles.len() / self.columns;
        let per_row = self.azimuths.len() / self.rows;
        let mut shares = Vec::with_capacity(self.rows * self.columns);
        for row in 0..self.rows {
            for column in 0..self.columns {
                let mut share = 0.0;
                for f in row * per_row..(row + 1) * per_row {
                    for k in column * per_column..(column + 1) * per_column {
                        share += self.weights[k] * self.azimuth_weights[f] * density[(k, f)];
                    }
                }
                // Truncated series may dip below zero where there is next to no light.
                shares.push(share.max(0.0));
            }
        }
        shares
    }
}

/// Share of the incident light in each cell, by component, scaled to the share that the solution knows without cells.
///
/// The single reflection: at θi = 90° its ridge in φ (2pq for slopes p, q) is narrower than any cell near the horizon, and
/// the rule within cells misses 3 % of it. The others: where a truncated series dips below zero the dips are cut
/// off, which leaves 3 % too much of a faint part (the re-hits of σ = 25° at 1 % accuracy).
pub(crate) fn cell_shares(axis: &ExitAxis, solution: &Solution, incidence: usize) -> [Vec<f64>; 3] {
    let lobe = &solution.lobes[incidence];
    let rule = CellRule::new(axis, lobe.theta_i);
    let basis = solution.basis(&rule.angles, &rule.azimuths);
    let scaled = |density: &Mat<f64>, known: f64| {
        let mut shares = rule.shares(density);
        let integrated: f64 = shares.iter().sum();
        // Less than rounding has no sign, and no shape.
        if integrated > 0.0 && known > FAINTEST {
            shares.iter_mut().for_each(|share| *share *= known / integrated);
        }
        shares
    };
    let interior = scaled(&solution.interior(incidence, &basis), lobe.albedo - lobe.surface);
    let rehit = scaled(&solution.rehit(incidence, &basis), lobe.rehit);
    let single = scaled(&solution.single(incidence, &basis), lobe.surface - lobe.rehit);
    let surface = single.iter().zip(&rehit).map(|(single, rehit)| single + rehit).collect();
    [interior, surface, rehit]
}

/// Share of the incident light below which a part of it is rounding.
const FAINTEST: f64 = 1e-13;

/// Points and weights of a Gauss rule repeated in every cell of an axis.
fn gauss(axis: &Stretched, rule: &[(f64, f64)]) -> (Vec<f64>, Vec<f64>) {
    (0..axis.cells)
        .flat_map(|cell| rule.iter().map(move |&(t, weight)| (cell as f64 + t, weight)))
        .map(|(position, weight)| (axis.at(position), weight * axis.slope(position)))
        .unzip()
}

/// Gauss–Legendre rules on [0, 1].
const GAUSS_3: [(f64, f64); 3] =
    [(0.112_701_665_379_258_31, 5.0 / 18.0), (0.5, 8.0 / 18.0), (0.887_298_334_620_741_7, 5.0 / 18.0)];
const GAUSS_2: [(f64, f64); 2] = [(0.211_324_865_405_187_1, 0.5), (0.788_675_134_594_812_9, 0.5)];

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
            summary.azimuth_width_deg =
                azimuth_width_deg(request.recipe.azimuth.width_deg, summary.sd_theta_o_deg);
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
    let accuracy = accuracy(request.target, halfway, &summaries);
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
        seed: request.seed,
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
        extra: [("content_hash".to_owned(), serde_json::Value::String(content_hash(request, by)))]
            .into_iter()
            .collect(),
    }
}

/// w of the decay postulate: the recipe's, or the standard deviation of the plane lobe at this θi.
pub(super) fn azimuth_width_deg(fixed: Option<f64>, sd_theta_o_deg: f64) -> f64 {
    // A lobe without spread (σ = 0, or no light at all) still needs a width to divide by.
    const NARROWEST_DEG: f64 = 1e-4;
    fixed.unwrap_or(sd_theta_o_deg).max(NARROWEST_DEG)
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn the_gauss_rules_integrate_cells() {
        let axis = ExitAxis::Plane { cells: 128, width: 0.07 }.columns_at(0.6);
        for rule in [&GAUSS_2[..], &GAUSS_3] {
            let (points, weights) = gauss(&axis, rule);
            let length: f64 = weights.iter().sum();
            let integral: f64 = points.iter().zip(&weights).map(|(s, w)| w * s.cos()).sum();
            // Two points a cell leave 1e-8 on a cosine.
            assert!((length / std::f64::consts::PI - 1.0).abs() < 1e-6 && (integral - 2.0).abs() < 1e-6);
        }
        assert_eq!(axis.hi, FRAC_PI_2);
    }
}
