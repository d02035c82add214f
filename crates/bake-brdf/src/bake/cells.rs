//! The cells of a table, and from a solution by doubling to light by cell: its densities integrated over them.

use lut_io::axis::{ExitAxis, MAX_WIDTH, Stretched};
use transport::Geometry;
use transport::doubling::{Azimuth, Matrix, SingleReflection, Solution};

/// Columns of a plane table: cells of 0.07 σ-widths at the lobe's centre keep the reading error near 5e-4.
const PLANE_CELLS: usize = 128;
/// Columns of a space table.
const SPACE_THETA_CELLS: usize = 64;
/// φ cells of a space table.
const SPACE_PHI_CELLS: usize = 32;
/// Narrowest stretch width, radians: directions are stored in f32, whose angles are good to 6e-8.
const NARROWEST: f64 = 1e-6;

/// The exit cells of a table for this geometry and facet slope (radians).
#[must_use]
pub fn exit_axis(geometry: Geometry, slope_sd: f64) -> ExitAxis {
    // Twice the slope is the width of a single reflection, the narrowest thing in the lobe.
    let width = (2.0 * slope_sd).clamp(NARROWEST, MAX_WIDTH);
    match geometry {
        Geometry::Plane => ExitAxis::Plane { cells: PLANE_CELLS, width },
        Geometry::Space => {
            ExitAxis::Space { theta_cells: SPACE_THETA_CELLS, phi_cells: SPACE_PHI_CELLS, width }
        }
    }
}

/// A Gauss rule over the cells around one lobe, three points a cell on the columns (two where they are many) and two on φ, where lobes are
/// smoother.
pub(super) struct CellRule {
    pub(super) angles: Vec<f64>,
    pub(super) azimuths: Vec<f64>,
    weights: Vec<f64>,
    azimuth_weights: Vec<f64>,
    columns: usize,
    rows: usize,
    /// Edges of the φ cells; none in the plane.
    sectors: Vec<f64>,
}

impl CellRule {
    /// The rule over the cells of a row whose lobe is centred at `specular` (radians).
    pub(super) fn new(axis: &ExitAxis, specular: f64) -> Self {
        let columns = axis.columns_at(specular);
        let rule: &[(f64, f64)] = if columns.cells < FINE_COLUMNS { &GAUSS_3 } else { &GAUSS_2 };
        let (angles, mut weights) = gauss(&columns, rule);
        let phi = axis.phi_at(specular);
        let sectors = phi.iter().flat_map(|phi| (0..=phi.cells).map(|edge| phi.at(edge as f64))).collect();
        let (azimuths, azimuth_weights) = match &phi {
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
        Self { angles, azimuths, weights, azimuth_weights, columns: columns.cells, rows, sectors }
    }

    /// Integral of a density (rows angles, columns azimuths) over each cell.
    pub(super) fn shares(&self, density: &Matrix) -> Vec<f64> {
        let columns = self.columns;
        let per_column = self.angles.len() / columns;
        let per_row = self.azimuths.len() / self.rows;
        let mut shares = Vec::with_capacity(self.rows * columns);
        for row in 0..self.rows {
            for column in 0..columns {
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

    /// Integral of the single reflection over each cell. In space its ridge in φ may be narrower than a cell near the horizon: cells
    /// are divided there.
    pub(super) fn single_shares(&self, lobe: &SingleReflection) -> Vec<f64> {
        if self.sectors.is_empty() {
            return self.shares(&Matrix::from_fn(self.angles.len(), 1, |k, _| lobe.plane(self.angles[k])));
        }
        let columns = self.columns;
        let mut shares = vec![0.0; self.rows * columns];
        let points = self.angles.len() / columns;
        let spread = |from: f64, step: f64| GAUSS_3.map(|(t, _)| Azimuth::new(from + t * step));
        let whole: Vec<_> =
            self.sectors.windows(2).map(|edges| spread(edges[0], edges[1] - edges[0])).collect();
        for (k, (theta, weight)) in self.angles.iter().zip(&self.weights).enumerate() {
            let (sd, exit) = (lobe.azimuth_sd(*theta), theta.sin_cos());
            for (row, edges) in self.sectors.windows(2).enumerate() {
                let end = edges[1].min(WIDEST_RIDGE * sd);
                if end <= edges[0] {
                    break;
                }
                let parts = ((end - edges[0]) / sd).ceil().max(1.0) as usize;
                let step = (end - edges[0]) / parts as f64;
                let over = |azimuths: &[Azimuth; 3]| -> f64 {
                    let values = azimuths.iter().map(|azimuth| lobe.towards(exit, *azimuth));
                    values.zip(&GAUSS_3).map(|(value, (_, weight))| weight * value).sum()
                };
                let over_parts = if parts == 1 && end == edges[1] {
                    over(&whole[row])
                } else {
                    (0..parts).map(|part| over(&spread(edges[0] + part as f64 * step, step))).sum()
                };
                // Both mirror halves.
                let around = 2.0 * step * over_parts;
                shares[row * columns + k / points] += weight * around;
            }
        }
        shares
    }
}

/// Columns from which two points a cell are as good as three of fewer.
const FINE_COLUMNS: usize = 200;
/// Standard deviations of φ beyond which a single reflection holds no light.
const WIDEST_RIDGE: f64 = 9.0;

/// Share of the incident light in each cell, by component, scaled to the share that the solution knows without cells: where a
/// truncated series dips below zero the dips are cut off, which leaves 3 % too much of a faint part (the re-hits of σ = 25° at 1 %
/// accuracy).
pub(crate) fn cell_shares(axis: &ExitAxis, solution: &Solution, incidence: usize) -> [Vec<f64>; 3] {
    let lobe = &solution.lobes[incidence];
    let rule = CellRule::new(axis, lobe.theta_i);
    let basis = solution.basis(&rule.angles, &rule.azimuths);
    let scaled = |mut shares: Vec<f64>, known: f64| {
        let integrated: f64 = shares.iter().sum();
        // Less than rounding has no sign, and no shape.
        if integrated > 0.0 && known > FAINTEST {
            shares.iter_mut().for_each(|share| *share *= known / integrated);
        }
        shares
    };
    let interior = scaled(rule.shares(&solution.interior(incidence, &basis)), lobe.albedo - lobe.surface);
    let rehit = scaled(rule.shares(&solution.rehit(incidence, &basis)), lobe.rehit);
    let single = scaled(rule.single_shares(solution.single_reflection(incidence)), lobe.surface - lobe.rehit);
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

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;
    use transport::Transport;
    use transport::doubling::{self, Settings};

    /// Against cells cut into 4 × 200 parts.
    #[test]
    fn the_single_reflection_keeps_its_ridge_at_grazing_incidence() {
        let transport = Transport::paper();
        let axis = exit_axis(Geometry::Space, transport.facets.slope_sd);
        let settings = Settings { nodes: 24, modes: 2, reach: 5.0, density: 0.5, both_sides: false };
        for degrees in [85.0_f64, 90.0] {
            let theta_i = degrees.to_radians();
            let solution = doubling::solve(&transport, Geometry::Space, &[theta_i], &settings).unwrap();
            let rule = CellRule::new(&axis, theta_i);
            let lobe = solution.single_reflection(0);
            let found = rule.single_shares(lobe);
            let (thetas, phis) = (axis.columns_at(theta_i).edges(), axis.phi_at(theta_i).unwrap().edges());
            let fine = |edges: &[f64], parts: usize, part: usize| {
                let (cell, part) = (part / parts, part % parts);
                let step = (edges[cell + 1] - edges[cell]) / parts as f64;
                GAUSS_3.map(|(t, weight)| (edges[cell] + (part as f64 + t) * step, weight * step))
            };
            let columns = thetas.len() - 1;
            let mut truth = vec![0.0; found.len()];
            for row in 0..200 * (phis.len() - 1) {
                for column in 0..4 * columns {
                    for (theta, dtheta) in fine(&thetas, 4, column) {
                        for (phi, dphi) in fine(&phis, 200, row) {
                            truth[row / 200 * columns + column / 4] +=
                                2.0 * theta.sin() * dtheta * dphi * lobe.space(theta, phi);
                        }
                    }
                }
            }
            let apart: f64 = found.iter().zip(&truth).map(|(a, b)| (a - b).abs()).sum();
            let light: f64 = truth.iter().sum();
            assert!(0.5 * apart < 2e-4 * light, "{degrees}°: {}", 0.5 * apart / light);
        }
    }

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
