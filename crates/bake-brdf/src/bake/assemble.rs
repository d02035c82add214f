//! From a solver's answer to a table: shares of light per cell become f·cos θo per steradian.

use super::cells::cell_shares;
use super::halfway::{self, Reading, Row};
use super::reading::Missed;
use super::{BakeError, Bands, Grid, Observer, Request};
use crate::bake::sampling::Sampling;
use crate::effects::{Effect, EffectSet};
use crate::options::{SolverChoice, Target};
use crate::spectra::{self, Colours};
use crate::tally::CellShares;
use lut_io::axis::ExitAxis;
use lut_io::both_sides::BothSides;
use lut_io::dispersion::{Band, Dispersion};
use lut_io::measure;
use lut_io::solver::{Doubling, Estimator, Interpolation, NoLobe, Solver, SolverSettings, Walk};
use lut_io::table::{
    Accuracy, AzimuthMode, Component, ComponentAccuracy, IncidenceSummary, Lobe, Meta, Parts, SCHEMA,
    SummaryErrors, SurfaceModel, Table,
};
use rayon::prelude::*;
use transport::doubling::{self, Lobe as SolvedLobe, Solution};
use transport::{Normals, Transport};

/// Who writes tables.
pub(super) const WRITER: &str = concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION"));

/// What a solver knows of one incidence.
pub(super) struct Incidence {
    pub(super) summary: IncidenceSummary,
    /// In the order of [`Component::ALL`].
    pub(super) components: [CellShares; 3],
    /// Error of the solver.
    pub(super) missed: Missed,
    /// Its statistical part.
    pub(super) noise: f64,
}

/// The lobe at one wavelength, solved.
pub(super) struct Solved {
    /// What the metadata say of it; colours come later.
    pub(super) band: Band,
    /// In the order of [`Component::ALL`].
    pub(super) lobes: [Lobe; 3],
}

/// What passes, and what becomes of light from below.
pub(super) struct SecondSide {
    pub(super) section: BothSides,
    /// Stored values, in the order of [`lut_io::both_sides::Passage::ALL`].
    pub(super) passages: [Vec<f32>; 3],
}

/// The table of a finished walk.
pub(super) fn walk_table(
    request: &Request,
    bands: &Bands,
    sampling: &Sampling,
    colours: &Colours,
) -> Result<Table, BakeError> {
    let solved = bands.all_nm().enumerate().map(|(band, nm)| {
        let request = request.at_wavelength(nm);
        Ok(walked(&request, &request.transport()?, sampling, band))
    });
    let solved = solved.collect::<Result<_, BakeError>>()?;
    table(request, solved, None, bands, colours)
}

/// The table of the lobes at all wavelengths, the recipe's own first, with its second side and its colours.
///
/// # Errors
/// Lobes or colours that do not make a valid table.
pub(super) fn table(
    request: &Request,
    solved: Vec<Solved>,
    sides: Option<SecondSide>,
    bands: &Bands,
    colours: &Colours,
) -> Result<Table, BakeError> {
    let mut solved = solved.into_iter();
    let own = solved.next().ok_or_else(|| BakeError::Input("no wavelength was solved".to_owned()))?;
    let (further, lobes) = further_bands(request, solved, colours)?;
    let dispersion = (!further.is_empty()).then(|| Dispersion {
        interpolation_percent: bands.interpolation_percent,
        rgb_weights: bands.rgb_weights(),
        bands: further,
    });
    // Thicknesses matter to colours alone: irregularity is held if a colour is.
    let held = |effect: &Effect| match effect {
        Effect::Coherent | Effect::Emission => colours.effects().contains(*effect),
        Effect::Irregularity => colours.effects() != EffectSet::NONE,
        _ => true,
    };
    let (both_sides, passages) = sides.map(|sides| (sides.section, sides.passages)).unzip();
    let solver = own.band.solver_settings.solver();
    let choice = match solver {
        Solver::Walk => SolverChoice::Walk,
        Solver::Doubling => SolverChoice::Doubling,
    };
    let exit_axis = request.exit_axis();
    let meta = Meta {
        schema: SCHEMA.to_owned(),
        writer: WRITER.to_owned(),
        recipe: request.recipe.to_json(),
        seed: request.options.seed,
        solver,
        solver_settings: own.band.solver_settings,
        azimuth: match exit_axis {
            ExitAxis::Plane { .. } => AzimuthMode::Decay,
            ExitAxis::Space { .. } => AzimuthMode::Space,
        },
        wavelength_nm: own.band.wavelength_nm,
        accuracy: own.band.accuracy,
        exit_axis,
        surface_model: own.band.surface_model,
        effects: request.effects.iter().filter(held).collect::<EffectSet>().names(),
        per_incidence: own.band.per_incidence,
        both_sides,
        compact: None,
        content_hash: Some(request.content_hash(choice)),
        dispersion,
        reciprocal: None,
        spectra: colours.section(),
        spectra_missing: colours.missing_section(),
    };
    Table::new(Parts { meta, lobes: own.lobes, passages, bands: lobes }).map_err(super::invalid)
}

/// The bands beside the table's own, and their lobes.
fn further_bands(
    request: &Request,
    solved: impl Iterator<Item = Solved>,
    colours: &Colours,
) -> Result<(Vec<Band>, Vec<[Lobe; 3]>), BakeError> {
    let wanted = request.wanted_colours();
    let with_colour = |Solved { mut band, lobes }: Solved| {
        if let Some(coherent) = &colours.spectra.coherent {
            let (nm, angles) = (band.wavelength_nm, &coherent.theta_deg);
            band.incoherent = Some(spectra::incoherent(&request.recipe, wanted, nm, angles)?);
        }
        Ok((band, lobes))
    };
    solved.map(with_colour).collect()
}

fn walked(request: &Request, transport: &Transport, sampling: &Sampling, band: usize) -> Solved {
    let axis = &request.exit_axis();
    let tallies = sampling.band_tallies(band);
    let incidences =
        tallies.iter().zip(&request.grid.incident_deg).enumerate().map(|(i, (tally, &theta_i_deg))| {
            let spread = sampling.spread(band * tallies.len() + i);
            let bound = tally.total_variation_bound(spread, tallies.len());
            Incidence {
                summary: IncidenceSummary { accuracy_percent: 100.0 * bound, ..tally.summary(theta_i_deg) },
                components: Component::ALL.map(|component| tally.component(component)),
                // Components are counted like all light.
                missed: Missed { all: bound, components: [bound; 3] },
                noise: tally.total_variation_error(spread),
            }
        });
    let crossings: u64 = tallies.iter().map(|tally| tally.crossings).sum();
    let settings = |interpolation| {
        SolverSettings::Walk(Walk {
            crossings,
            estimator: Estimator::Analog,
            event_cap: request.options.event_cap,
            interpolation,
            precision: sampling.precision(),
            time_budget_seconds: match request.options.target {
                Target::Time(budget) => Some(budget.as_secs_f64()),
                Target::AccuracyPercent(_) | Target::Paths(_) => None,
            },
        })
    };
    let reading = |rows: &[Row]| {
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
    solved(request, transport, axis, settings, incidences.collect(), reading)
}

/// The lobe of a doubling solution: of the request's incidences, then of the middles between them.
pub(super) fn doubled(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    solution: &Solution,
    observer: &Observer<'_>,
) -> Result<Solved, BakeError> {
    let stored = request.grid.incident_deg.len();
    let incidences: Vec<Incidence> = (0..stored)
        .into_par_iter()
        .map(|i| {
            observer.go_on()?;
            let mut summary = doubling_summary(solution, i, request.grid.incident_deg[i]);
            let missed = solver_part(solution, i);
            let [interior, surface, rehit] = cell_shares(axis, solution, i);
            if rehit.iter().all(|share| *share == 0.0) {
                // Less than the solver resolves.
                summary.rehit = 0.0;
            }
            let components =
                [(Component::Interior, interior), (Component::Surface, surface), (Component::Rehit, rehit)]
                    .map(|(component, share)| {
                        let own: f64 = share.iter().sum();
                        // The estimate is a total variation: spread over the cells in proportion to their light.
                        let scale = doubling::component_scale(own, summary.albedo);
                        let light = missed.components[component as usize] * scale;
                        let relative = 2.0 * light / own.max(f64::MIN_POSITIVE);
                        CellShares {
                            std_error: share.iter().map(|share| relative * share).collect(),
                            count: vec![0; share.len()],
                            share,
                        }
                    });
            Ok(Incidence { summary, components, missed, noise: 0.0 })
        })
        .collect::<Result<_, BakeError>>()?;
    let doubling::Settings { nodes, modes, reach, density, .. } = solution.settings;
    let Grid { refinements, raised, .. } = request.grid;
    let settings = |interpolation| {
        SolverSettings::Doubling(Doubling {
            density,
            interpolation,
            modes,
            nodes,
            reach,
            refinements,
            raised,
        })
    };
    observer.go_on()?;
    let reading = |_: &[Row]| halfway::measured(&request.recipe, axis, solution, stored);
    let mut solved = solved(request, transport, axis, settings, incidences, reading);
    let errors = solved.lobes.iter_mut().flat_map(|lobe| &mut lobe.std_error);
    errors.for_each(|error| *error = coarse(*error));
    Ok(solved)
}

/// The lobe of a pearl that shows none.
pub(super) fn dark(request: &Request, transport: &Transport, axis: &ExitAxis) -> Solved {
    let incidences = request.grid.incident_deg.iter().map(|&theta_i_deg| Incidence {
        summary: IncidenceSummary { theta_i_deg, transmitted: 1.0, ..IncidenceSummary::default() },
        components: Component::ALL.map(|_| CellShares {
            share: vec![0.0; axis.cells()],
            std_error: vec![0.0; axis.cells()],
            count: vec![0; axis.cells()],
        }),
        missed: Missed::default(),
        noise: 0.0,
    });
    let settings = |interpolation| SolverSettings::Dark { interpolation, lobe: NoLobe::None };
    solved(request, transport, axis, settings, incidences.collect(), |rows| halfway::estimated(axis, rows))
}

/// The solver's part of the error of one incidence.
fn solver_part(solution: &Solution, i: usize) -> Missed {
    let Some(error) = &solution.error else { return Missed::default() };
    let [interior, rehit] = [0, 1].map(|k: usize| error.components[k][i]);
    let lobe = &solution.lobes[i];
    // The single reflection is exact: what the surface is off by is the re-hits'.
    let surface = rehit * (lobe.rehit.max(0.0) / lobe.surface.max(f64::MIN_POSITIVE)).sqrt();
    Missed { all: error.total_variation[i], components: [interior, surface, rehit] }
}

fn doubling_summary(solution: &Solution, i: usize, theta_i_deg: f64) -> IncidenceSummary {
    let error = solution.error.clone().unwrap_or_default();
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
    let accuracy = error.total_variation.get(i).copied().unwrap_or_default();
    summary(&solution.lobes[i], theta_i_deg, std_error, 100.0 * accuracy)
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

/// The lobe of these incidences, and its error half-way between them, which `halfway` knows or finds from the rows.
pub(super) fn solved(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    settings: impl FnOnce(Interpolation) -> SolverSettings,
    mut incidences: Vec<Incidence>,
    reading: impl FnOnce(&[Row]) -> Reading,
) -> Solved {
    let row = |incidence: &mut Incidence| {
        let summary = &mut incidence.summary;
        if matches!(axis, ExitAxis::Plane { .. }) {
            summary.azimuth_width_deg = request.recipe.azimuth.decay_width_deg(summary.sd_theta_o_deg);
        }
        let theta_i = summary.theta_i_deg.to_radians();
        let extents = measure::cell_extents(axis, theta_i);
        let width = summary.azimuth_width_deg.to_radians();
        let weights = measure::reading_weights(axis, theta_i, width);
        let stored = incidence.components.each_mut().map(|shares| {
            if theta_i == 0.0 {
                symmetrise(axis, &extents, shares);
            }
            stored_row(shares, &extents, &weights)
        });
        let [interior, surface, _] = &incidence.components;
        let shares: [&[f64]; 2] = [&interior.share, &surface.share];
        (stored, Row::new(theta_i, width, &extents, weights, shares, incidence.noise))
    };
    let (stored, rows): (Vec<[Lobe; 3]>, Vec<Row>) = incidences.par_iter_mut().map(row).unzip();
    let mut lobes: [Lobe; 3] = Default::default();
    for row in stored {
        for (lobe, row) in lobes.iter_mut().zip(row) {
            append(lobe, row);
        }
    }
    let solved_to = incidences.iter().map(|incidence| incidence.missed).fold(Missed::default(), Missed::max);
    let per_incidence: Vec<IncidenceSummary> =
        incidences.into_iter().map(|incidence| incidence.summary).collect();
    let reading = reading(&rows);
    let solver_settings = settings(reading.by());
    let band = Band {
        wavelength_nm: request.recipe.light.wavelength_nm,
        accuracy: accuracy(
            request.options.target,
            solved_to,
            reading,
            solver_settings.solver(),
            &per_incidence,
        ),
        solver_settings,
        surface_model: surface_model(transport),
        incoherent: None,
        per_incidence,
    };
    Solved { band, lobes }
}

/// Interface 0 for the closed form.
pub(super) fn surface_model(transport: &Transport) -> SurfaceModel {
    SurfaceModel {
        n_ambient: transport.indices[0],
        n_first: transport.indices[1],
        slope_sd: transport.facets.slope_sd,
        normals: match transport.facets.normals {
            Normals::Unweighted => lut_io::table::Normals::Unweighted,
            Normals::Visible => lut_io::table::Normals::Visible,
        },
    }
}

/// Stored values, errors and counts of one component at one incidence.
pub(super) fn stored_row(shares: &CellShares, extents: &[f64], weights: &[f64]) -> Lobe {
    let factors = measure::value_factors(&shares.share, extents, weights);
    let scaled = |values: &[f64]| -> Vec<f32> {
        values.iter().zip(&factors).map(|(value, factor)| (value * factor) as f32).collect()
    };
    Lobe {
        value: scaled(&shares.share),
        std_error: scaled(&shares.std_error),
        count: shares.count.iter().map(|&count| count as f32).collect(),
    }
}

/// Adds the row of a further incidence to a component.
pub(super) fn append(lobe: &mut Lobe, row: Lobe) {
    lobe.value.extend(row.value);
    lobe.std_error.extend(row.std_error);
    lobe.count.extend(row.count);
}

/// An estimated error to eight binary digits: more than it is good for, and quicker to compress than all of them.
fn coarse(error: f32) -> f32 {
    const DROPPED: u32 = 16;
    f32::from_bits((error.to_bits() + (1 << (DROPPED - 1))) & !((1 << DROPPED) - 1))
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

fn accuracy(
    target: Target,
    solved_to: Missed,
    reading: Reading,
    solver: Solver,
    summaries: &[IncidenceSummary],
) -> Accuracy {
    let worst = summaries.iter().max_by(|a, b| a.accuracy_percent.total_cmp(&b.accuracy_percent));
    let (rows, cells) = match reading {
        Reading::Measured { rows, cells } => (rows, Some(cells)),
        Reading::Estimated(share) => (Missed { all: share, components: [0.0; 3] }, None),
    };
    let between_cells = cells.unwrap_or_default();
    let read = |solver_part: f64, rows: f64, cells: f64| match solver {
        Solver::Doubling => solver_part + rows + cells,
        // Noise has no sign: at a row, and half-way between two, whose noise is halved in the square.
        Solver::Walk => {
            f64::max(solver_part.hypot(cells), (solver_part / std::f64::consts::SQRT_2).hypot(rows + cells))
        }
    };
    let component = |component: Component| {
        let of = |missed: &Missed| missed.components[component as usize];
        100.0 * read(of(&solved_to), of(&rows), of(&between_cells))
    };
    Accuracy {
        asked_percent: match target {
            Target::AccuracyPercent(percent) => Some(percent),
            Target::Paths(_) | Target::Time(_) => None,
        },
        reached_percent: 100.0 * read(solved_to.all, rows.all, between_cells.all),
        worst_theta_i_deg: worst.map_or(0.0, |summary| summary.theta_i_deg),
        solver_percent: 100.0 * solved_to.all,
        rows_percent: 100.0 * rows.all,
        cells_percent: cells.map(|cells| 100.0 * cells.all),
        components: cells.map(|_| ComponentAccuracy {
            interior_percent: component(Component::Interior),
            rehit_percent: component(Component::Rehit),
            surface_percent: component(Component::Surface),
        }),
    }
}
