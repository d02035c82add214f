//! The cells of a table, and from a solution by doubling to light by cell: its densities integrated over them.

use lut_io::axis::{ExitAxis, MAX_WIDTH, Stretched};
use transport::Geometry;
use transport::doubling::{Matrix, Solution};

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
    pub(super) fn shares(&self, density: &Matrix) -> Vec<f64> {
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
    let scaled = |density: &Matrix, known: f64| {
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
