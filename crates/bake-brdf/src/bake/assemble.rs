//! From a solver's answer to a table: shares of light per cell become f·cos θo per steradian.

use super::{Request, Target};
use crate::bake::sampling::Sampling;
use crate::effects::{Effect, EffectSet};
use crate::recipe::Recipe;
use crate::tally::{CellShares, Cells, Tally};
use faer::Mat;
use lut_io::Flaw;
use lut_io::axis::{ExitAxis, Stretched};
use lut_io::both_sides::{BothSides, FromBelow, Passage, PerPassage};
use lut_io::measure;
use lut_io::table::{
    Accuracy, AzimuthMode, Component, IncidenceSummary, Lobe, Meta, SCHEMA, Solver, SummaryErrors,
    SurfaceModel, Table,
};
use rayon::prelude::*;
use transport::doubling::{ErrorEstimate, Lobe as SolvedLobe, Solution};
use transport::{Normals, Transport};

/// What a solver knows of one incidence.
struct Incidence {
    summary: IncidenceSummary,
    /// In the order of [`Component::ALL`].
    components: [CellShares; 3],
}

/// The table of a finished walk.
pub(super) fn walk_table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    sampling: &Sampling,
) -> Table {
    let incidences =
        sampling.tallies().iter().zip(&request.incident_deg).map(|(tally, &theta_i_deg)| Incidence {
            summary: tally.summary(theta_i_deg),
            components: Component::ALL.map(|component| tally.component(component)),
        });
    let crossings: u64 = sampling.tallies().iter().map(|tally| tally.crossings).sum();
    let settings = serde_json::json!({
        "estimator": "analog",
        "precision": sampling.precision(),
        "event_cap": request.event_cap,
        "crossings": crossings,
    });
    let noise: Vec<f64> = sampling.tallies().iter().map(Tally::total_variation_error).collect();
    table(request, transport, axis, (Solver::Walk, settings), incidences.collect(), &noise)
}

/// The table of a doubling solution.
///
/// # Errors
/// The second side of the solution does not make a valid section.
pub(super) fn doubling_table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    solution: &Solution,
) -> Result<Table, Flaw> {
    let incidences: Vec<Incidence> = (0..solution.lobes.len())
        .map(|i| {
            let summary = doubling_summary(solution, i, request.incident_deg[i]);
            // The estimate is a total variation: spread over the cells in proportion to their light.
            let relative = 2.0 * summary.accuracy_percent / 100.0;
            let components = cell_shares(axis, solution, i).map(|share| CellShares {
                std_error: share.iter().map(|share| relative * share).collect(),
                count: vec![0; share.len()],
                share,
            });
            Incidence { summary, components }
        })
        .collect();
    let settings = serde_json::json!({
        "nodes": solution.settings.nodes,
        "modes": solution.settings.modes,
        "reach": solution.settings.reach,
        "density": solution.settings.density,
    });
    let noise = vec![0.0; incidences.len()];
    let mut table = table(request, transport, axis, (Solver::Doubling, settings), incidences, &noise);
    if let Some(below) = &solution.from_below {
        let accuracy = |i: usize| {
            let percent = |errors: fn(&ErrorEstimate) -> &Vec<f64>, side: &Solution| {
                side.error.as_ref().map_or(0.0, |error| 100.0 * errors(error)[i])
            };
            PerPassage {
                transmitted: percent(|error| &error.transmitted, solution),
                below_reflected: percent(|error| &error.total_variation, below),
                below_transmitted: percent(|error| &error.transmitted, below),
            }
        };
        let rows = |passage: Passage, i: usize, specular: f64| {
            let rule = CellRule::new(axis, specular);
            let lobe = |side: &Solution, reflected: bool| {
                let basis = side.basis(&rule.angles, &rule.azimuths);
                if reflected {
                    side.interior(i, &basis) + side.rehit(i, &basis) + side.single(i, &basis)
                } else {
                    side.transmitted(i, &basis)
                }
            };
            rule.shares(&match passage {
                Passage::Transmitted => lobe(solution, false),
                Passage::BelowReflected => lobe(below, true),
                Passage::BelowTransmitted => lobe(below, false),
            })
        };
        add_both_sides(&mut table, request, transport, [&solution.lobes, &below.lobes], &accuracy, &rows)?;
    }
    Ok(table)
}

/// Adds transmission and light from below to a table.
///
/// `lobes` are the totals from above and from below; `accuracy` and `rows` give the estimated errors and the shares of
/// light by cell of one incidence and passage, whose smooth counterpart leaves at the angle that `rows` is told.
fn add_both_sides(
    table: &mut Table,
    request: &Request,
    transport: &Transport,
    [above, below]: [&[SolvedLobe]; 2],
    accuracy: &dyn Fn(usize) -> PerPassage,
    rows: &(dyn Fn(Passage, usize, f64) -> Vec<f64> + Sync),
) -> Result<(), Flaw> {
    let axis = table.meta.exit_axis;
    let n = &transport.indices;
    let from_below = below.iter().zip(&request.incident_deg).enumerate();
    let mut section = BothSides {
        n_ambient: n[0],
        n_substrate: n[n.len() - 1],
        from_below: from_below
            .map(|(i, (lobe, &theta_i_deg))| FromBelow {
                theta_i_deg,
                reflected: lobe.albedo,
                transmitted: lobe.transmitted,
                absorbed: lobe.absorbed,
                azimuth_width_deg: PerPassage::default(),
                accuracy_percent: accuracy(i),
            })
            .collect(),
    };
    let passages = Passage::ALL.map(|passage| {
        let each: Vec<(Vec<f32>, f64)> = (0..below.len())
            .into_par_iter()
            .map(|i| {
                let light = match passage {
                    Passage::Transmitted => above[i].transmitted,
                    Passage::BelowReflected => below[i].albedo,
                    Passage::BelowTransmitted => below[i].transmitted,
                };
                let specular = section.specular(passage, below[i].theta_i);
                passage_row(request, &axis, specular, light, rows(passage, i, specular))
            })
            .collect();
        for ((_, width), below) in each.iter().zip(&mut section.from_below) {
            let widths = &mut below.azimuth_width_deg;
            match passage {
                Passage::Transmitted => widths.transmitted = *width,
                Passage::BelowReflected => widths.below_reflected = *width,
                Passage::BelowTransmitted => widths.below_transmitted = *width,
            }
        }
        each.into_iter().flat_map(|(values, _)| values).collect()
    });
    section.store(&mut table.meta)?;
    table.passages = Some(passages);
    Ok(())
}

/// Stored values of one passage at one incidence, and the width of its azimuth postulate (degrees).
fn passage_row(
    request: &Request,
    axis: &ExitAxis,
    specular: f64,
    light: f64,
    mut share: Vec<f64>,
) -> (Vec<f32>, f64) {
    let found: f64 = share.iter().sum();
    if found > 0.0 {
        share.iter_mut().for_each(|share| *share *= light.max(0.0) / found);
    }
    let width = match axis {
        ExitAxis::Plane { .. } => {
            request.recipe.azimuth.width_deg.unwrap_or(spread_deg(axis, specular, &share))
        }
        ExitAxis::Space { .. } => 0.0,
    };
    let width = if matches!(axis, ExitAxis::Plane { .. }) { width.max(NARROWEST_DEG) } else { width };
    let extents = measure::cell_extents(axis, specular);
    let weights = measure::reading_weights(axis, specular, width.to_radians());
    let cells = share.len();
    let mut shares = CellShares { share, std_error: vec![0.0; cells], count: vec![0; cells] };
    if specular == 0.0 {
        symmetrise(axis, &extents, &mut shares);
    }
    let mut lobe = Lobe::default();
    push_row(&mut lobe, &shares, &extents, &weights);
    (lobe.value, width)
}

/// Standard deviation of the signed exit angle over the cells, degrees.
fn spread_deg(axis: &ExitAxis, specular: f64, share: &[f64]) -> f64 {
    let centres = axis.columns_at(specular).centres();
    let mean_of = |value: &dyn Fn(f64) -> f64| {
        let light: f64 = share.iter().sum();
        share.iter().zip(&centres).map(|(share, s)| share * value(*s)).sum::<f64>()
            / light.max(f64::MIN_POSITIVE)
    };
    let mean = mean_of(&|s| s);
    mean_of(&|s| (s - mean).powi(2)).sqrt().to_degrees()
}

/// The table of smooth interfaces (σ = 0): all light in the cell of the mirror direction, without error.
pub(super) fn smooth_table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    lobes: &[SolvedLobe],
    below: Option<&[SolvedLobe]>,
) -> Result<Table, Flaw> {
    let beam = |theta: f64, light: f64| {
        let direction = [libm::sin(theta) as f32, 0.0, libm::cos(theta) as f32];
        let (_, cell) = Cells::new(axis, theta).locate(direction);
        let mut share = vec![0.0; axis.cells()];
        share[cell] = light.max(0.0);
        share
    };
    let incidences: Vec<Incidence> = lobes
        .iter()
        .zip(&request.incident_deg)
        .map(|(lobe, &theta_i_deg)| {
            let components = [lobe.albedo - lobe.surface, lobe.surface, 0.0].map(|light| CellShares {
                share: beam(lobe.theta_i, light),
                std_error: vec![0.0; axis.cells()],
                count: vec![0; axis.cells()],
            });
            Incidence { summary: summary(lobe, theta_i_deg, SummaryErrors::default(), 0.0), components }
        })
        .collect();
    let settings = serde_json::json!({ "closed_form": "smooth interfaces" });
    let noise = vec![0.0; incidences.len()];
    let mut table = table(request, transport, axis, (Solver::Doubling, settings), incidences, &noise);
    if let Some(below) = below {
        let exact = |_| PerPassage::default();
        let rows = |_, _, specular| beam(specular, 1.0); // the totals follow
        add_both_sides(&mut table, request, transport, [lobes, below], &exact, &rows)?;
    }
    Ok(table)
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
    });
    let noise = vec![0.0; request.incident_deg.len()];
    let solver = (Solver::Doubling, serde_json::json!({ "lobe": "none" }));
    table(request, transport, axis, solver, incidences.collect(), &noise)
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

fn summary(
    lobe: &SolvedLobe,
    theta_i_deg: f64,
    std_error: SummaryErrors,
    accuracy_percent: f64,
) -> IncidenceSummary {
    IncidenceSummary {
        theta_i_deg,
        albedo: lobe.albedo,
        transmitted: lobe.transmitted,
        absorbed: lobe.absorbed,
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
struct CellRule {
    angles: Vec<f64>,
    azimuths: Vec<f64>,
    weights: Vec<f64>,
    azimuth_weights: Vec<f64>,
    columns: usize,
    rows: usize,
}

impl CellRule {
    /// The rule over the cells of a row whose lobe is centred at `specular` (radians).
    fn new(axis: &ExitAxis, specular: f64) -> Self {
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
    fn shares(&self, density: &Mat<f64>) -> Vec<f64> {
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

/// Share of the incident light in each cell, by component.
pub(crate) fn cell_shares(axis: &ExitAxis, solution: &Solution, incidence: usize) -> [Vec<f64>; 3] {
    let rule = CellRule::new(axis, solution.lobes[incidence].theta_i);
    let basis = solution.basis(&rule.angles, &rule.azimuths);
    let interior = rule.shares(&solution.interior(incidence, &basis));
    let rehit = rule.shares(&solution.rehit(incidence, &basis));
    let single = rule.shares(&solution.single(incidence, &basis));
    let surface = single.iter().zip(&rehit).map(|(single, rehit)| single + rehit).collect();
    [interior, surface, rehit]
}

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

/// `noise` is the statistical part of each row's total variation.
fn table(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    solver: (Solver, serde_json::Value),
    mut incidences: Vec<Incidence>,
    noise: &[f64],
) -> Table {
    let mut lobes = [const { Lobe { value: Vec::new(), std_error: Vec::new(), count: Vec::new() } }; 3];
    let mut rows = Vec::new();
    for (incidence, &noise) in incidences.iter_mut().zip(noise) {
        let summary = &mut incidence.summary;
        if matches!(axis, ExitAxis::Plane { .. }) {
            summary.azimuth_width_deg = azimuth_width_deg(&request.recipe, summary);
        }
        let theta_i = summary.theta_i_deg.to_radians();
        let extents = measure::cell_extents(axis, theta_i);
        let weights = measure::reading_weights(axis, theta_i, summary.azimuth_width_deg.to_radians());
        for (lobe, shares) in lobes.iter_mut().zip(&mut incidence.components) {
            if theta_i == 0.0 {
                symmetrise(axis, &extents, shares);
            }
            push_row(lobe, shares, &extents, &weights);
        }
        let [interior, _, rehit] = &incidence.components;
        let read = interior.share.iter().zip(&rehit.share).map(|(a, b)| a + b).collect();
        rows.push(Row { theta_i, share: read, albedo: summary.albedo, extents, noise });
    }
    let summaries: Vec<IncidenceSummary> =
        incidences.into_iter().map(|incidence| incidence.summary).collect();
    let accuracy = accuracy(request.target, &rows, &summaries);
    let [interior, surface, rehit] = lobes;
    Table {
        meta: meta(request, transport, axis, solver, summaries, accuracy),
        interior,
        surface,
        rehit,
        passages: None,
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
    Meta {
        schema: SCHEMA.to_owned(),
        writer: concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned(),
        recipe: request.recipe.to_json(),
        seed: request.seed,
        solver,
        solver_settings,
        azimuth: match axis {
            ExitAxis::Plane { .. } => AzimuthMode::Decay,
            ExitAxis::Space { .. } => AzimuthMode::Walk,
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
        effects: held(request),
        per_incidence,
        extra: serde_json::Map::new(),
    }
}

/// Names of the effects that a table of this request holds: interference colours only once they are stored.
fn held(request: &Request) -> Vec<String> {
    let colours = [Effect::Coherent, Effect::Illuminant, Effect::Irregularity];
    colours.into_iter().fold(request.effects, EffectSet::without).names()
}

/// A lobe without spread (σ = 0, or no light at all) still needs a width to divide by.
const NARROWEST_DEG: f64 = 1e-4;

/// w of the decay postulate: the recipe's, or the standard deviation of the plane lobe at this θi.
fn azimuth_width_deg(recipe: &Recipe, summary: &IncidenceSummary) -> f64 {
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

fn accuracy(target: Target, rows: &[Row], summaries: &[IncidenceSummary]) -> Accuracy {
    let worst = summaries.iter().max_by(|a, b| a.accuracy_percent.total_cmp(&b.accuracy_percent));
    Accuracy {
        asked_percent: match target {
            Target::AccuracyPercent(percent) => Some(percent),
            Target::Paths(_) | Target::Time(_) => None,
        },
        reached_percent: worst.map_or(0.0, |summary| summary.accuracy_percent),
        worst_theta_i_deg: worst.map_or(0.0, |summary| summary.theta_i_deg),
        interpolation_percent: 100.0 * interpolation_error(rows),
    }
}

/// The light at one incidence that is read from the table between incidences: interior and rehit. (A BSDF has the
/// single reflection in closed form.)
struct Row {
    theta_i: f64,
    share: Vec<f64>,
    albedo: f64,
    extents: Vec<f64>,
    /// Statistical part of the row's total variation.
    noise: f64,
}

impl Row {
    /// Density of each cell: share per extent.
    fn density(&self) -> Vec<f64> {
        self.share.iter().zip(&self.extents).map(|(share, extent)| share / extent).collect()
    }
}

/// Error of reading half-way between two incidences, as total variation, worst interval.
///
/// Each inner row is predicted from its two neighbours. What that misses by, less the noise of the three rows, is
/// the error of linear interpolation over the double interval; over a single one it is a quarter.
fn interpolation_error(rows: &[Row]) -> f64 {
    let missed = rows.windows(3).map(|three| {
        let [before, here, after] = three else { return 0.0 };
        let t = (here.theta_i - before.theta_i) / (after.theta_i - before.theta_i);
        let predicted: Vec<f64> =
            before.density().iter().zip(after.density()).map(|(a, b)| (1.0 - t) * a + t * b).collect();
        // The reader restores the share.
        let read: f64 = predicted.iter().zip(&here.extents).map(|(p, e)| p * e).sum();
        let scale = here.share.iter().sum::<f64>() / read.max(f64::MIN_POSITIVE);
        let difference: f64 = (predicted.iter().zip(here.density()).zip(&here.extents))
            .map(|((p, h), e)| (scale * p - h).abs() * e)
            .sum::<f64>()
            / here.albedo.max(f64::MIN_POSITIVE);
        let noise2 = ((1.0 - t) * before.noise).powi(2) + (t * after.noise).powi(2) + here.noise.powi(2);
        ((0.5 * difference).powi(2) - noise2).max(0.0).sqrt()
    });
    0.25 * missed.fold(0.0, f64::max)
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
