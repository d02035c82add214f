//! What reading a table between its incidences adds to the error.
//!
//! Where doubling costs next to nothing beside the bake, it solves the lobe half-way between incidences and the
//! error is *measured* there. Else it is *estimated* from second differences of the table's own rows.

use super::placing;
use super::reading::{self, Missed, integral};
use crate::prices;
use crate::recipe::Recipe;
use lut_io::axis::ExitAxis;
use lut_io::measure;
use lut_io::solver::Interpolation;
use transport::doubling::{Cost, Settings, Solution};
use transport::{Geometry, Transport};

/// Total variation of the auxiliary solution of a walk.
const AUXILIARY_SHARE: f64 = 5e-3;
/// An auxiliary solution may cost this share of the walk it belongs to, or so many seconds of one core if that is more: a ratio of
/// counts that no clock enters.
const AFFORDABLE: f64 = 0.1;
const NEGLIGIBLE: f64 = 0.2;

/// What reading a table adds to the error of its rows, at worst.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reading {
    /// By a solution of the rows' incidences and of the middles between them.
    Measured {
        /// Between rows.
        rows: Missed,
        /// Between cells.
        cells: Missed,
    },
    /// All light, read between rows, by the rows alone.
    Estimated(f64),
}

impl Reading {
    pub(super) const fn by(&self) -> Interpolation {
        match self {
            Self::Measured { .. } => Interpolation::Measured,
            Self::Estimated(_) => Interpolation::Estimated,
        }
    }
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

/// From second differences: each inner row is predicted from its two neighbours. What that misses by is the error of
/// linear interpolation over the double interval; over a single one it is a quarter. Towards either end it may go on
/// growing as it did in the last step (lobes change fastest at grazing incidence).
pub(super) fn estimated(axis: &ExitAxis, rows: &[Row]) -> Reading {
    let bends: Vec<f64> = rows.windows(3).map(|three| three[1].bent_by(axis, &three[0], &three[2])).collect();
    let beyond = |last: Option<&f64>, before: Option<&f64>| match (last, before) {
        (Some(&last), Some(&before)) if before > 0.0 => last * (last / before).clamp(1.0, 4.0),
        (Some(&last), _) => last,
        _ => 0.0,
    };
    let ends = [beyond(bends.last(), bends.iter().rev().nth(1)), beyond(bends.first(), bends.get(1))];
    let share = 0.25 * bends.iter().chain(&ends).copied().fold(0.0, f64::max);
    Reading::Estimated(share.min(1.0))
}

/// An auxiliary doubling solution beside a walk.
pub(super) struct Auxiliary {
    /// The incidences of the walk and the middles between them, radians.
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
        let theta_i = reading::with_middles(theta_i);
        let settings = Settings::for_accuracy(transport, geometry, AUXILIARY_SHARE);
        if settings.check(transport, geometry, &theta_i).is_err() {
            return None;
        }
        let cost = settings.cost(transport, geometry, theta_i.len());
        let affordable = cost.seconds <= (AFFORDABLE * prices::CROSSING * crossings).max(NEGLIGIBLE);
        affordable.then_some(Self { theta_i, settings, cost })
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
) -> Option<Reading> {
    let auxiliary = Auxiliary::of(transport, geometry, theta_i, crossings as f64)?;
    let solution =
        transport::doubling::solve(transport, geometry, &auxiliary.theta_i, &auxiliary.settings).ok()?;
    Some(measured(recipe, axis, &solution, theta_i.len()))
}

/// Measured from a solution of the rows' incidences and of the middles between them.
pub(super) fn measured(recipe: &Recipe, axis: &ExitAxis, solution: &Solution, rows: usize) -> Reading {
    let [rows, cells] = placing::missed(axis, recipe.azimuth, solution, rows);
    Reading::Measured { rows, cells }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let Reading::Estimated(found) = estimated(&axis, &rows) else { panic!("from the rows alone") };
        assert!(truth > 1e-6 && (found / truth - 1.0).abs() < 1e-2, "{truth} {found}");
    }
}
