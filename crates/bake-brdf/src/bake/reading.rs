//! What reading a table misses: between its rows, and between its cells.
//!
//! A renderer reads interior and re-hits from the cells and has the single reflection in closed form. A program that reads the stored
//! `surface` instead misses more; that is kept apart.

use super::cells::cell_shares;
use crate::recipe::Azimuth;
use crate::three_digits;
use lut_io::axis::{ExitAxis, Stretched};
use lut_io::monotone::Monotone;
use lut_io::table::Component;
use lut_io::{decay, measure};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use transport::doubling::{Solution, component_scale};

/// Positions at which a lobe is sampled to read between rows: one φ and many signed exit angles (plane), φ and θo (space).
const PLANE_SAMPLES: [usize; 2] = [1, 192];
const SPACE_SAMPLES: [usize; 2] = [24, 64];
/// Samples of a cell and dimension where reading between cells is looked at: of a bend that is even they find an eighth too much.
const SUB_SAMPLES: usize = 2;
/// Points over which decays of two widths are compared.
const AZIMUTHS: usize = 16;

/// Total variation that something adds, as a share of the light that comes back.
///
/// A component's is a share of its [`component_scale`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Missed {
    /// Of all light, with the single reflection in closed form.
    pub(super) all: f64,
    /// In the order of [`Component::ALL`]; `surface` as it is stored.
    pub(super) components: [f64; 3],
}

impl Missed {
    /// What a table is judged by: all light, and what renderers read of it.
    pub(super) fn worst(&self) -> f64 {
        self.all
            .max(self.components[Component::Interior as usize])
            .max(self.components[Component::Rehit as usize])
    }

    pub(super) fn max(self, other: Self) -> Self {
        let pairs = [0, 1, 2].map(|c: usize| self.components[c].max(other.components[c]));
        Self { all: self.all.max(other.all), components: pairs }
    }

    /// To three digits: more than they are good for, and they hide in which order a machine's matrix products add.
    pub(super) fn rounded(self) -> Self {
        Self { all: three_digits(self.all), components: self.components.map(three_digits) }
    }
}

/// A lobe at positions of its exit axis.
pub(super) struct Sample {
    pub(super) theta_i: f64,
    /// w of the decay postulate, radians; 0 in space.
    width: f64,
    /// Share of the incident light, in the order of [`Component::ALL`].
    pub(super) shares: [f64; 3],
    /// f·cos θo at the positions, likewise.
    values: [Vec<f64>; 3],
    /// Solid angle that each position stands for.
    weights: Vec<f64>,
}

impl Sample {
    /// The lobe of a solution at one of its incidences.
    pub(super) fn new(axis: &ExitAxis, azimuth: Azimuth, solution: &Solution, incidence: usize) -> Self {
        let samples = match axis {
            ExitAxis::Plane { .. } => PLANE_SAMPLES,
            ExitAxis::Space { .. } => SPACE_SAMPLES,
        };
        Self::at(axis, azimuth, solution, incidence, samples)
    }

    fn at(
        axis: &ExitAxis,
        azimuth: Azimuth,
        solution: &Solution,
        incidence: usize,
        [across, along]: [usize; 2],
    ) -> Self {
        let lobe = &solution.lobes[incidence];
        let (angles, steps) = midpoints(&axis.columns_at(lobe.theta_i), along);
        let (azimuths, weights, width) = match axis.phi_at(lobe.theta_i) {
            None => {
                let width = azimuth.decay_width_deg(lobe.sd.to_degrees()).to_radians();
                (vec![0.0], plane_weights(lobe.theta_i, width, &angles, &steps), width)
            }
            Some(phi) => {
                let (azimuths, sectors) = midpoints(&phi, across);
                let weights = sectors.iter().flat_map(|sector| {
                    angles.iter().zip(&steps).map(move |(theta, step)| 2.0 * theta.sin() * step * sector)
                });
                (azimuths, weights.collect(), 0.0)
            }
        };
        // Scaled to the light that the solution knows without samples.
        let scaled = |density: &[f64], known: f64| -> Vec<f64> {
            let values: Vec<f64> = density.iter().map(|value| value.max(0.0)).collect();
            let sum = integral(&weights, &values);
            let scale = if sum > 0.0 { known.max(0.0) / sum } else { 0.0 };
            values.into_iter().map(|value| value * scale).collect()
        };
        let [interior, rehit, single] = match axis {
            ExitAxis::Plane { .. } => {
                let [interior, rehit] = solution.along(incidence, &angles);
                let lobe = solution.single_reflection(incidence);
                [interior, rehit, angles.iter().map(|s| lobe.plane(*s)).collect()]
            }
            ExitAxis::Space { .. } => {
                let basis = solution.basis(&angles, &azimuths);
                let parts = [Solution::interior, Solution::rehit, Solution::single];
                // Columns of a matrix lie one behind the other.
                parts.map(|part| part(solution, incidence, &basis).values().to_vec())
            }
        };
        let interior = scaled(&interior, lobe.albedo - lobe.surface);
        let rehit = scaled(&rehit, lobe.rehit);
        let single = scaled(&single, lobe.surface - lobe.rehit);
        let surface = single.iter().zip(&rehit).map(|(single, rehit)| single + rehit).collect();
        let shares = [lobe.albedo - lobe.surface, lobe.surface, lobe.rehit].map(|share| share.max(0.0));
        Self { theta_i: lobe.theta_i, width, shares, values: [interior, surface, rehit], weights }
    }

    /// All light.
    fn all(&self) -> f64 {
        (self.shares[0] + self.shares[1]).max(f64::MIN_POSITIVE)
    }

    /// What is missed where this lobe is read from two others, each component scaled to the share that is read there.
    pub(super) fn missed_by(&self, axis: &ExitAxis, before: &Self, after: &Self, read: [f64; 3]) -> Missed {
        let t = (self.theta_i - before.theta_i) / (after.theta_i - before.theta_i);
        let width = (1.0 - t) * before.width + t * after.width;
        let plane = matches!(axis, ExitAxis::Plane { .. }).then(|| {
            // The reader's own w decides what it divides by, and how the light is spread over azimuths.
            let (angles, steps) = midpoints(&axis.columns_at(self.theta_i), self.weights.len());
            let spreads = [width, self.width].map(|width| spread(self.theta_i, width, &angles));
            (plane_weights(self.theta_i, width, &angles, &steps), spreads)
        });
        let weights = plane.as_ref().map_or(&self.weights, |(weights, _)| weights);
        let light = Component::ALL.map(|component| {
            let pair = before.values[component as usize].iter().zip(&after.values[component as usize]);
            let mixed = pair.map(|(before, after)| (1.0 - t) * before + t * after);
            let mut light: Vec<f64> = mixed.zip(weights).map(|(mixed, weight)| mixed * weight).collect();
            let scale = read[component as usize] / light.iter().sum::<f64>().max(f64::MIN_POSITIVE);
            light.iter_mut().for_each(|light| *light *= scale);
            light
        });
        self.missed(&light, plane.as_ref().map(|(_, spreads)| spreads))
    }

    /// The total variation of light that is read at the positions, where light may be spread otherwise over azimuths (spreads of what is
    /// read, and of what is there).
    fn missed(&self, read: &[Vec<f64>; 3], spreads: Option<&[Vec<[f64; AZIMUTHS]>; 2]>) -> Missed {
        let here = self.values.each_ref().map(|values| -> Vec<f64> {
            values.iter().zip(&self.weights).map(|(value, weight)| value * weight).collect()
        });
        let apart = |read: &[f64], here: &[f64]| -> f64 {
            let at = |k: usize| match spreads {
                None => (read[k] - here[k]).abs(),
                Some([of_read, of_here]) => {
                    let around = of_read[k].iter().zip(&of_here[k]).zip(&AROUND);
                    around.map(|((a, b), share)| share * (read[k] * a - here[k] * b).abs()).sum()
                }
            };
            0.5 * (0..read.len()).map(at).sum::<f64>()
        };
        let tabulated = |light: &[Vec<f64>; 3]| -> Vec<f64> {
            let [interior, _, rehit] = light;
            interior.iter().zip(rehit).map(|(interior, rehit)| interior + rehit).collect()
        };
        let all = self.all();
        let component = |c: usize| apart(&read[c], &here[c]) / component_scale(self.shares[c], all);
        Missed { all: apart(&tabulated(read), &tabulated(&here)) / all, components: [0, 1, 2].map(component) }
    }
}

/// What reading between the cells of an axis misses at one incidence of a solution.
pub(super) fn between_cells(
    axis: &ExitAxis,
    azimuth: Azimuth,
    solution: &Solution,
    incidence: usize,
) -> Missed {
    let (columns, rows) = (axis.columns(), axis.rows_per_incidence());
    let samples_of = [if rows == 1 { 1 } else { SUB_SAMPLES * rows }, SUB_SAMPLES * columns];
    let fine = Sample::at(axis, azimuth, solution, incidence, samples_of);
    let extents = measure::cell_extents(axis, fine.theta_i);
    let weights = measure::reading_weights(axis, fine.theta_i, fine.width);
    let shares = cell_shares(axis, solution, incidence);
    let [across, along] = [[samples_of[0], rows], [samples_of[1], columns]].map(between);
    let read = [0, 1, 2].map(|c: usize| {
        let factors = measure::value_factors(&shares[c], &extents, &weights);
        let values: Vec<f64> = shares[c].iter().zip(&factors).map(|(share, factor)| share * factor).collect();
        let mut weights = fine.weights.iter();
        let mut read = Vec::with_capacity(fine.weights.len());
        for (row, u) in &across {
            let at = |row: usize, column: usize, t: f64| {
                let near = row * columns + column;
                (1.0 - t) * values[near] + t * values[near + 1]
            };
            for ((column, t), weight) in along.iter().zip(&mut weights) {
                let near = at(*row, *column, *t);
                let value = if *u == 0.0 { near } else { (1.0 - u) * near + u * at(row + 1, *column, *t) };
                read.push(weight * value);
            }
        }
        read
    });
    fine.missed(&read, None)
}

/// Between which cells each of as many even samples is read, linearly, and how far from the first to the second.
fn between([samples, cells]: [usize; 2]) -> Vec<(usize, f64)> {
    let place = |k: usize| {
        let from_first = (k as f64 + 0.5) * cells as f64 / samples as f64 - 0.5;
        let from_first = from_first.clamp(0.0, (cells - 1) as f64);
        let cell = (from_first as usize).min(cells.saturating_sub(2));
        (cell, from_first - cell as f64)
    };
    (0..samples).map(place).collect()
}

/// What reading between nodes misses at an incidence between two.
pub(super) struct Look {
    pub(super) theta_i: f64,
    /// How bent the lobes are there: an interval of length h misses κh²/4 half-way.
    pub(super) kappa: f64,
    /// Far enough from either node for κ to be known well.
    pub(super) central: bool,
    pub(super) missed: Missed,
}

/// What reading between nodes misses at other lobes.
pub(super) fn between_rows(axis: &ExitAxis, nodes: &[&Sample], looks: &[&Sample]) -> Vec<Look> {
    // Close to a node next to nothing is missed, and next to nothing is learnt of the bend.
    const LEAST: f64 = 0.5;
    const CENTRAL: f64 = 0.75;
    let angles: Vec<f64> = nodes.iter().map(|sample| sample.theta_i).collect();
    let curves = [0, 1, 2].map(|component| {
        Monotone::new(angles.clone(), nodes.iter().map(|sample| sample.shares[component]).collect())
    });
    let look = |here: &&Sample| {
        let i = interval(&angles, here.theta_i);
        let read = [0, 1, 2].map(|component: usize| curves[component].at(here.theta_i));
        let missed = here.missed_by(axis, nodes[i], nodes[i + 1], read);
        let length = angles[i + 1] - angles[i];
        let t = (here.theta_i - angles[i]) / length;
        let arch = 4.0 * t * (1.0 - t);
        let kappa = 4.0 * missed.worst() / (length * length * arch.max(LEAST));
        Look { theta_i: here.theta_i, kappa, central: arch >= CENTRAL, missed }
    };
    looks.par_iter().map(look).collect()
}

/// The interval between nodes, by its lower one, in which an angle is.
pub(super) fn interval(nodes: &[f64], angle: f64) -> usize {
    nodes.partition_point(|node| *node <= angle).clamp(1, nodes.len() - 1) - 1
}

/// How far into an interval that ends at the horizon further looks are taken: components that vanish there fall faster than what is
/// read, and most of their own light is missed where they become faint.
const BESIDE_HORIZON: [f64; 3] = [0.8, 0.95, 0.99];

/// Incidences, and behind them the middles between them; last of all, some beside the horizon where they reach it.
pub(super) fn with_middles(theta_i: &[f64]) -> Vec<f64> {
    let within = |pair: &[f64], t: f64| (1.0 - t) * pair[0] + t * pair[1];
    let middles = theta_i.windows(2).map(|pair| within(pair, 0.5));
    let last = theta_i.windows(2).last().filter(|pair| pair[1] > FRAC_PI_2 - 1e-9);
    let beside = last.into_iter().flat_map(|pair| BESIDE_HORIZON.map(|t| within(pair, t)));
    theta_i.iter().copied().chain(middles).chain(beside).collect()
}

/// The positions of samples along an axis, and dx of each.
fn midpoints(axis: &Stretched, count: usize) -> (Vec<f64>, Vec<f64>) {
    let step = axis.cells as f64 / count as f64;
    let middle = axis.by_steps(step, [0.5]);
    (0..count)
        .map(|k| {
            let [(x, slope)] = middle(k);
            (x, slope * step)
        })
        .unzip()
}

pub(super) fn integral(weights: &[f64], values: &[f64]) -> f64 {
    weights.iter().zip(values).map(|(weight, value)| weight * value).sum()
}

/// ∫ dω of the decay postulate behind each step of the signed exit angle.
fn plane_weights(theta_i: f64, width: f64, angles: &[f64], steps: &[f64]) -> Vec<f64> {
    let weights = angles.iter().zip(steps).map(|(s, step)| {
        let mean = decay::mean_decay(decay::concentration(theta_i, *s, width));
        TAU * s.sin().abs() * if *s >= 0.0 { mean } else { 1.0 - mean } * step
    });
    weights.collect()
}

/// How a decay spreads the light of each signed exit angle over azimuths π·u³, relative to the same everywhere.
fn spread(theta_i: f64, width: f64, angles: &[f64]) -> Vec<[f64; AZIMUTHS]> {
    let cosines: [f64; AZIMUTHS] =
        std::array::from_fn(|k| (PI * ((k as f64 + 0.5) / AZIMUTHS as f64).powi(3)).cos());
    let at = |s: &f64| {
        let x = decay::concentration(theta_i, *s, width);
        let side = |decay: f64| if *s >= 0.0 { decay } else { 1.0 - decay };
        let shape = decay::decays(x, cosines).map(side);
        let mean: f64 = shape.iter().zip(&AROUND).map(|(shape, share)| shape * share).sum();
        shape.map(|shape| shape / mean.max(f64::MIN_POSITIVE))
    };
    angles.iter().map(at).collect()
}

/// Shares of the azimuths of [`spread`]: 3u² du.
const AROUND: [f64; AZIMUTHS] = {
    let mut shares = [0.0; AZIMUTHS];
    let mut k = 0;
    while k < AZIMUTHS {
        let (from, to) = (k as f64 / AZIMUTHS as f64, (k + 1) as f64 / AZIMUTHS as f64);
        shares[k] = to * to * to - from * from * from;
        k += 1;
    }
    shares
};

#[cfg(test)]
mod tests {
    use super::super::request::Request;
    use super::*;
    use crate::options::Options;
    use crate::recipe::Recipe;
    use transport::doubling;

    #[test]
    fn looks_beside_the_horizon_find_nearly_all_that_a_vanishing_component_misses() {
        let recipe = r#"{"stack":{"layers":12},"facets":{"slope_sd_deg":5,"normals":"visible"}}"#;
        let recipe = Recipe::from_json(recipe).unwrap();
        let request =
            Request::new(recipe, Options { incident_deg: Some(vec![0.0]), ..Options::default() }).unwrap();
        let (transport, axis) = (request.transport().unwrap(), request.exit_axis());
        for from_deg in [83.3_f64, 89.02] {
            let rows = [from_deg.to_radians(), FRAC_PI_2];
            let steps = (1..40).map(|k| rows[0] + (rows[1] - rows[0]) * f64::from(k) / 40.0);
            let worst = |theta_i: &[f64]| {
                let solution =
                    doubling::solve_to(&transport, request.geometry(), theta_i, 1e-4, false).unwrap();
                let samples: Vec<Sample> = (0..theta_i.len())
                    .map(|i| Sample::new(&axis, request.recipe.azimuth, &solution, i))
                    .collect();
                let samples: Vec<&Sample> = samples.iter().collect();
                let looks = between_rows(&axis, &samples[..2], &samples[2..]);
                looks.iter().map(|look| look.missed.components[Component::Rehit as usize]).fold(0.0, f64::max)
            };
            let (looked, there) =
                (worst(&with_middles(&rows)), worst(&rows.into_iter().chain(steps).collect::<Vec<_>>()));
            assert!(looked > 0.8 * there, "{from_deg}\u{b0}: {looked} of {there}");
        }
    }

    #[test]
    fn solver_and_tables_judge_components_alike() {
        for (own, all) in [(0.2, 0.5), (1e-3, 0.9), (1e-7, 0.9), (0.0, 0.3)] {
            assert_eq!(component_scale(own, all), measure::component_scale(own, all));
        }
    }
}
