//! What reading a table between its incidences adds to the error.
//!
//! Where doubling costs next to nothing beside the bake, it solves the lobe half-way between incidences and the
//! error is *measured* there. Else it is *estimated* from second differences of the table's own rows.

use super::cells::cell_shares;
use crate::prices;
use crate::recipe::Recipe;
use lut_io::axis::ExitAxis;
use lut_io::measure;
use lut_io::monotone::Monotone;
use lut_io::solver::Interpolation;
use rayon::prelude::*;
use transport::doubling::{Cost, Settings, Solution};
use transport::{Geometry, Transport};

/// Intervals looked at: the widest of this many equal parts of the range of incidences.
const PARTS: usize = 8;
/// Total variation of the auxiliary solution of a walk.
const AUXILIARY_SHARE: f64 = 5e-3;
/// An auxiliary solution may cost this share of the walk it belongs to, or so many seconds of one core if that is more: a ratio of
/// counts that no clock enters.
const AFFORDABLE: f64 = 0.1;
const NEGLIGIBLE: f64 = 0.2;
/// The error of reading half-way between two incidences, worst interval.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Halfway {
    /// Total variation, as a share of the reflected light.
    pub share: f64,
    /// How it is known: by solutions in the intervals of [`intervals`], or from the rows.
    pub by: Interpolation,
}

/// All the light of one incidence, as a table of it is read.
pub(super) struct Row {
    theta_i: f64,
    /// f·cos θo of interior and surface: the reader keeps the albedo of each.
    values: [Vec<f64>; 2],
    /// w of the decay postulate, radians.
    width: f64,
    /// Solid angle that each cell stands for, for this w.
    weights: Vec<f64>,
    /// Statistical part of the row's total variation.
    noise: f64,
}

impl Row {
    /// From the shares of the incident light by cell.
    pub(super) fn new(
        theta_i: f64,
        width: f64,
        extents: &[f64],
        weights: Vec<f64>,
        [interior, surface]: [&[f64]; 2],
        noise: f64,
    ) -> Self {
        let values = [interior, surface].map(|share| {
            let factors = measure::value_factors(share, extents, &weights);
            share.iter().zip(&factors).map(|(share, factor)| share * factor).collect()
        });
        Self { theta_i, values, width, weights, noise }
    }

    /// The row of a doubling solution.
    pub(super) fn solved(recipe: &Recipe, axis: &ExitAxis, solution: &Solution, incidence: usize) -> Self {
        let lobe = &solution.lobes[incidence];
        let width = recipe.azimuth.decay_width_deg(lobe.sd.to_degrees()).to_radians();
        let [interior, surface, _] = cell_shares(axis, solution, incidence);
        let extents = measure::cell_extents(axis, lobe.theta_i);
        let weights = measure::reading_weights(axis, lobe.theta_i, width);
        Self::new(lobe.theta_i, width, &extents, weights, [&interior, &surface], 0.0)
    }

    fn integral(&self, values: &[f64]) -> f64 {
        integral(&self.weights, values)
    }

    /// Share of the incident light in interior and surface.
    fn albedos(&self) -> [f64; 2] {
        [self.integral(&self.values[0]), self.integral(&self.values[1])]
    }

    /// Total variation between this row and what is read at its θi from its two neighbours: their values mixed at equal
    /// position, each component scaled to the albedo that is read there.
    fn missed_by(&self, axis: &ExitAxis, before: &Self, after: &Self, read_albedos: [f64; 2]) -> f64 {
        let t = (self.theta_i - before.theta_i) / (after.theta_i - before.theta_i);
        // The reader's own w decides what it divides by.
        let weights =
            measure::reading_weights(axis, self.theta_i, (1.0 - t) * before.width + t * after.width);
        let mut difference = vec![0.0; self.weights.len()];
        for (component, here) in self.values.iter().enumerate() {
            let (before, after) = (&before.values[component], &after.values[component]);
            let read: Vec<f64> = before.iter().zip(after).map(|(a, b)| (1.0 - t) * a + t * b).collect();
            let scale = read_albedos[component] / integral(&weights, &read).max(f64::MIN_POSITIVE);
            for ((sum, read), here) in difference.iter_mut().zip(&read).zip(here) {
                *sum += scale * read - here;
            }
        }
        let size: Vec<f64> = difference.iter().map(|d| d.abs()).collect();
        0.5 * self.integral(&size) / self.albedos().iter().sum::<f64>().max(f64::MIN_POSITIVE)
    }

    /// [`Self::missed_by`] less the noise of the three rows.
    fn bent_by(&self, axis: &ExitAxis, before: &Self, after: &Self) -> f64 {
        let t = (self.theta_i - before.theta_i) / (after.theta_i - before.theta_i);
        let noise2 = ((1.0 - t) * before.noise).powi(2) + (t * after.noise).powi(2) + self.noise.powi(2);
        (self.missed_by(axis, before, after, self.albedos()).powi(2) - noise2).max(0.0).sqrt()
    }
}

fn integral(weights: &[f64], values: &[f64]) -> f64 {
    weights.iter().zip(values).map(|(weight, value)| weight * value).sum()
}

/// From second differences: each inner row is predicted from its two neighbours. What that misses by is the error of
/// linear interpolation over the double interval; over a single one it is a quarter. Towards either end it may go on
/// growing as it did in the last step (lobes change fastest at grazing incidence).
pub(super) fn estimated(axis: &ExitAxis, rows: &[Row]) -> Halfway {
    let bends: Vec<f64> = rows.windows(3).map(|three| three[1].bent_by(axis, &three[0], &three[2])).collect();
    let beyond = |last: Option<&f64>, before: Option<&f64>| match (last, before) {
        (Some(&last), Some(&before)) if before > 0.0 => last * (last / before).clamp(1.0, 4.0),
        (Some(&last), _) => last,
        _ => 0.0,
    };
    let ends = [beyond(bends.last(), bends.iter().rev().nth(1)), beyond(bends.first(), bends.get(1))];
    let share = 0.25 * bends.iter().chain(&ends).copied().fold(0.0, f64::max);
    Halfway { share: share.min(1.0), by: Interpolation::Estimated }
}

/// Intervals (by the index of their first incidence) to look at: the last, and the widest of each part of the range.
pub(super) fn intervals(theta_i: &[f64]) -> Vec<usize> {
    let count = theta_i.len().saturating_sub(1);
    let width = |i: usize| theta_i[i + 1] - theta_i[i];
    let mut chosen: Vec<usize> = (0..PARTS.min(count))
        .filter_map(|part| {
            let parts = PARTS.min(count);
            (part * count / parts..(part + 1) * count / parts).max_by(|&a, &b| width(a).total_cmp(&width(b)))
        })
        .chain(count.checked_sub(1))
        .collect();
    chosen.dedup();
    chosen
}

/// The middles of [`intervals`].
pub(super) fn middles(theta_i: &[f64], intervals: &[usize]) -> Vec<f64> {
    intervals.iter().map(|&i| 0.5 * (theta_i[i] + theta_i[i + 1])).collect()
}

/// Measured in some `intervals` of the rows, whose middles are solved.
pub(super) fn measured(axis: &ExitAxis, rows: &[Row], intervals: &[usize], middles: &[Row]) -> Halfway {
    let nodes: Vec<f64> = rows.iter().map(|row| row.theta_i).collect();
    let albedos = [0, 1].map(|component| {
        Monotone::new(nodes.clone(), rows.iter().map(|row| row.albedos()[component]).collect())
    });
    let missed = intervals.iter().zip(middles).map(|(&i, middle)| {
        let read = [0, 1].map(|component: usize| albedos[component].at(middle.theta_i));
        middle.missed_by(axis, &rows[i], &rows[i + 1], read)
    });
    let worst = missed.fold(0.0, f64::max);
    // Three digits are more than it is good for, and hide in which order a machine's matrix products add.
    let share = format!("{worst:.2e}").parse().unwrap_or(worst);
    Halfway { share, by: Interpolation::Measured }
}

/// An auxiliary doubling solution beside a walk.
pub(super) struct Auxiliary {
    /// Indices of the incidences before and after the middles, each once.
    nodes: Vec<usize>,
    intervals: Vec<usize>,
    /// Of those, then of the middles, radians.
    theta_i: Vec<f64>,
    pub(super) settings: Settings,
    /// What solving it costs.
    pub(super) cost: Cost,
}

impl Auxiliary {
    /// How many incidences it solves.
    pub(super) fn incidences(&self) -> usize {
        self.theta_i.len()
    }

    /// The auxiliary solution of a walk of so many crossings, if it costs little beside it.
    pub(super) fn of(
        transport: &Transport,
        geometry: Geometry,
        theta_i: &[f64],
        crossings: f64,
    ) -> Option<Self> {
        if super::walk_only(transport).is_some() {
            return None;
        }
        let intervals = intervals(theta_i);
        let mut nodes: Vec<usize> = intervals.iter().flat_map(|&i| [i, i + 1]).collect();
        nodes.dedup();
        let middles = middles(theta_i, &intervals);
        let incidences: Vec<f64> = nodes.iter().map(|&i| theta_i[i]).chain(middles).collect();
        let settings = Settings::for_accuracy(transport, geometry, AUXILIARY_SHARE);
        if incidences.is_empty() || settings.check(transport, geometry, &incidences).is_err() {
            return None;
        }
        let cost = settings.cost(transport, geometry, incidences.len());
        let affordable = cost.seconds <= (AFFORDABLE * prices::CROSSING * crossings).max(NEGLIGIBLE);
        affordable.then_some(Self { nodes, intervals, theta_i: incidences, settings, cost })
    }
}

/// Measured by an auxiliary doubling solution, where that costs little beside a walk of so many crossings.
pub(super) fn beside_walk(
    recipe: &Recipe,
    transport: &Transport,
    geometry: Geometry,
    axis: &ExitAxis,
    theta_i: &[f64],
    crossings: u64,
) -> Option<Halfway> {
    let auxiliary = Auxiliary::of(transport, geometry, theta_i, crossings as f64)?;
    let Auxiliary { nodes, intervals, theta_i, settings, .. } = &auxiliary;
    let solution = transport::doubling::solve(transport, geometry, theta_i, settings).ok()?;
    let rows: Vec<Row> =
        (0..theta_i.len()).into_par_iter().map(|i| Row::solved(recipe, axis, &solution, i)).collect();
    let (rows, middles) = rows.split_at(nodes.len());
    let intervals: Vec<usize> =
        intervals.iter().filter_map(|i| nodes.iter().position(|node| node == i)).collect();
    Some(measured(axis, rows, &intervals, middles))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_are_the_widest_of_each_part_and_the_last() {
        let even: Vec<f64> = (0..=90).map(f64::from).collect();
        let chosen = intervals(&even);
        assert_eq!((chosen.len(), chosen.last()), (8, Some(&89)));
        assert_eq!(intervals(&[0.0, 1.0, 5.0, 6.0]), [0, 1, 2]);
        assert_eq!(intervals(&[0.0]), [0_usize; 0]);
        assert_eq!(intervals(&[]), [0_usize; 0]);
        let mut uneven = even;
        uneven.remove(40); // the interval from 39 to 41 is the widest
        assert!(intervals(&uneven).contains(&39));
    }

    #[test]
    fn a_lobe_that_bends_evenly_misses_a_quarter_half_way() {
        // Space, where w does not enter; so near to normal incidence all axes are alike. Shares bend in θi by a little, so
        // that values bend alike; their sum does not.
        let axis = ExitAxis::Space { theta_cells: 2, phi_cells: 1, width: 0.3 };
        let at = |x: f64| {
            let bend = 1e-4 * x * x;
            let (extents, weights) =
                (measure::cell_extents(&axis, 1e-9 * x), measure::reading_weights(&axis, 1e-9 * x, 0.0));
            Row::new(1e-9 * x, 0.0, &extents, weights, [&[0.3 + bend, 0.7 - bend], &[0.0; 2]], 0.0)
        };
        let rows = [at(0.0), at(1.0), at(2.0), at(3.0)];
        let truth = at(1.5).missed_by(&axis, &rows[1], &rows[2], [1.0, 0.0]);
        let found = estimated(&axis, &rows).share;
        assert!(truth > 1e-6 && (found / truth - 1.0).abs() < 1e-2, "{truth} {found}");
    }
}
