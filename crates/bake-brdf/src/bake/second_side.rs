//! Light in single directions, and the second side: what [`crate::options::Sides::Both`] adds to a table, and the table of smooth interfaces.

use super::Request;
use super::assemble::{Incidence, SecondSide, Solved, solved, stored_row, summary, symmetrise};
use super::cells::{CellRule, light};
use super::halfway;
use super::reading::Missed;
use crate::tally::{CellShares, Cells};
use lut_io::axis::ExitAxis;
use lut_io::both_sides::{BothSides, FromBelow, Passage, PerPassage};
use lut_io::measure;
use lut_io::solver::{ClosedForm, SolverSettings};
use lut_io::table::SummaryErrors;
use rayon::prelude::*;
use transport::Transport;
use transport::doubling::{ErrorEstimate, Lobe as SolvedLobe, Solution};

/// The second side of a solution.
pub(super) fn of(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    solution: &Solution,
    below: &Solution,
) -> SecondSide {
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
        let side = if passage == Passage::Transmitted { solution } else { below };
        let cells = rule.of(side);
        if passage != Passage::BelowReflected {
            return light(side.transmitted_shares(i, &cells).values());
        }
        let mut tabulated = side.interior_shares(i, &cells);
        tabulated += &side.rehit_shares(i, &cells);
        let single = rule.single_shares(side.single_reflection(i));
        light(tabulated.values()).iter().zip(single).map(|(share, single)| share + single).collect()
    };
    second_side(request, transport, axis, [&solution.lobes, &below.lobes], &accuracy, &rows)
}

/// Transmission and light from below.
///
/// `lobes` are the totals from above and from below; `accuracy` and `rows` give the estimated errors and the shares of
/// light by cell of one incidence and passage, whose smooth counterpart leaves at the angle that `rows` is told.
fn second_side(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    [above, below]: [&[SolvedLobe]; 2],
    accuracy: &dyn Fn(usize) -> PerPassage,
    rows: &(dyn Fn(Passage, usize, f64) -> Vec<f64> + Sync),
) -> SecondSide {
    let n = &transport.indices;
    // Solutions may hold further angles behind those of the request.
    let below = &below[..request.grid.incident_deg.len()];
    let from_below = below.iter().zip(&request.grid.incident_deg).enumerate();
    let mut section = BothSides {
        n_ambient: n[0],
        n_substrate: n[n.len() - 1],
        from_below: from_below
            .map(|(i, (lobe, &theta_i_deg))| FromBelow {
                theta_i_deg,
                reflected: lobe.albedo.max(0.0),
                transmitted: lobe.transmitted.max(0.0),
                absorbed: lobe.absorbed.max(0.0),
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
                passage_row(request, axis, specular, light, rows(passage, i, specular))
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
    SecondSide { section, passages }
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
        ExitAxis::Plane { .. } => request.recipe.azimuth.decay_width_deg(spread_deg(axis, specular, &share)),
        ExitAxis::Space { .. } => 0.0,
    };
    let extents = measure::cell_extents(axis, specular);
    let weights = measure::reading_weights(axis, specular, width.to_radians());
    let cells = share.len();
    let mut shares = CellShares { share, std_error: vec![0.0; cells], count: vec![0; cells] };
    if specular == 0.0 {
        symmetrise(axis, &extents, &mut shares);
    }
    (stored_row(&shares, &extents, &weights).value, width)
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

/// Smooth interfaces (σ = 0): all light in the cell of the mirror direction, without error.
pub(super) fn smooth(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    lobes: &[SolvedLobe],
    below: Option<&[SolvedLobe]>,
) -> (Solved, Option<SecondSide>) {
    let beam = |theta: f64, light: f64| {
        let direction = [libm::sin(theta) as f32, 0.0, libm::cos(theta) as f32];
        let (_, cell) = Cells::new(axis, theta).locate(direction);
        let mut share = vec![0.0; axis.cells()];
        share[cell] = light.max(0.0);
        share
    };
    let incidences: Vec<Incidence> = lobes
        .iter()
        .zip(&request.grid.incident_deg)
        .map(|(lobe, &theta_i_deg)| {
            let components = [lobe.albedo - lobe.surface, lobe.surface, 0.0].map(|light| CellShares {
                share: beam(lobe.theta_i, light),
                std_error: vec![0.0; axis.cells()],
                count: vec![0; axis.cells()],
            });
            let summary = summary(lobe, theta_i_deg, SummaryErrors::default(), 0.0);
            Incidence { summary, components, missed: Missed::default(), noise: 0.0 }
        })
        .collect();
    let settings =
        |interpolation| SolverSettings::Smooth { closed_form: ClosedForm::SmoothInterfaces, interpolation };
    let above = solved(request, transport, axis, settings, incidences, |rows| halfway::estimated(axis, rows));
    let below = below.map(|below| {
        let exact = |_| PerPassage::default();
        let rows = |_, _, specular| beam(specular, 1.0); // the totals follow
        second_side(request, transport, axis, [lobes, below], &exact, &rows)
    });
    (above, below)
}
