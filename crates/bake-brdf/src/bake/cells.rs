//! The cells of a table, and from a solution by doubling to light by cell: its densities integrated over them.

use lut_io::axis::{ExitAxis, MAX_WIDTH, Stretched};
use transport::Geometry;
use transport::doubling::{Azimuth, Cells, SingleReflection, Solution};

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

/// Cells around one lobe: a Gauss rule along their columns, three points a cell (two where they are many), and edges in φ.
pub(super) struct CellRule {
    angles: Vec<f64>,
    weights: Vec<f64>,
    columns: usize,
    rows: usize,
    /// Edges of the φ cells; none in the plane.
    sectors: Vec<f64>,
}

impl CellRule {
    /// The rule over the cells of a row whose lobe is centred at `specular` (radians).
    pub(super) fn new(axis: &ExitAxis, specular: f64) -> Self {
        let columns = axis.columns_at(specular);
        let fine = columns.cells >= FINE_COLUMNS;
        let (angles, mut weights) = if fine { gauss(&columns, &GAUSS_2) } else { gauss(&columns, &GAUSS_3) };
        let phi = axis.phi_at(specular);
        if phi.is_some() {
            for (weight, angle) in weights.iter_mut().zip(&angles) {
                *weight *= angle.sin();
            }
        }
        let sectors = phi.map(|phi| phi.edges()).unwrap_or_default();
        let rows = axis.rows_per_incidence();
        Self { angles, weights, columns: columns.cells, rows, sectors }
    }

    /// These cells, as a solution integrates over them.
    pub(super) fn of(&self, solution: &Solution) -> Cells {
        solution.cells(&self.angles, &self.weights, self.columns, &self.sectors)
    }

    /// Integrals over the cells of a plane of a density at the points of their rule.
    fn by_column(&self, density: impl Iterator<Item = f64>) -> Vec<f64> {
        let values: Vec<f64> = density.zip(&self.weights).map(|(density, weight)| density * weight).collect();
        values.chunks_exact(self.angles.len() / self.columns).map(|cell| cell.iter().sum()).collect()
    }

    /// Integral of the single reflection over each cell. In space its ridge in φ may be narrower than a cell near the horizon: cells
    /// are divided there.
    pub(super) fn single_shares(&self, lobe: &SingleReflection) -> Vec<f64> {
        if self.sectors.is_empty() {
            return self.by_column(self.angles.iter().map(|s| lobe.plane(*s)));
        }
        let columns = self.columns;
        let mut shares = vec![0.0; self.rows * columns];
        let points = self.angles.len() / columns;
        let widths = || self.sectors.windows(2).map(|edges| (edges[0], edges[1] - edges[0]));
        let few: Vec<_> = widths().map(|(from, step)| spread(&GAUSS_2, from, step)).collect();
        let whole: Vec<_> = widths().map(|(from, step)| spread(&GAUSS_3, from, step)).collect();
        for (k, (theta, weight)) in self.angles.iter().zip(&self.weights).enumerate() {
            let (sd, exit) = (lobe.azimuth_sd(*theta), theta.sin_cos());
            if lobe.slope(exit) > STEEPEST {
                continue;
            }
            for (row, edges) in self.sectors.windows(2).enumerate() {
                let end = edges[1].min(WIDEST_RIDGE * sd);
                if end <= edges[0] {
                    break;
                }
                let parts = ((end - edges[0]) / sd).ceil().max(1.0) as usize;
                let step = (end - edges[0]) / parts as f64;
                let over = |azimuths: &[Azimuth; 3]| mean(&GAUSS_3, azimuths, lobe, exit);
                let over_parts = match parts == 1 && end == edges[1] {
                    true if step <= NARROW * sd => mean(&GAUSS_2, &few[row], lobe, exit),
                    true => over(&whole[row]),
                    false => {
                        let part = |part| over(&spread(&GAUSS_3, edges[0] + part as f64 * step, step));
                        (0..parts).map(part).sum()
                    }
                };
                // Both mirror halves.
                let around = 2.0 * step * over_parts;
                shares[row * columns + k / points] += weight * around;
            }
        }
        shares
    }
}

/// The points of a rule between two azimuths.
fn spread<const N: usize>(rule: &[(f64, f64); N], from: f64, step: f64) -> [Azimuth; N] {
    rule.map(|(t, _)| Azimuth::new(from + t * step))
}

/// The mean of a single reflection over the points of a rule.
fn mean<const N: usize>(
    rule: &[(f64, f64); N],
    azimuths: &[Azimuth; N],
    lobe: &SingleReflection,
    exit: (f64, f64),
) -> f64 {
    azimuths.iter().zip(rule).map(|(azimuth, (_, weight))| weight * lobe.towards(exit, *azimuth)).sum()
}

/// Standard deviations of φ up to which two points are as good as three.
const NARROW: f64 = 0.3;
/// Columns from which two points a cell are as good as three of fewer.
const FINE_COLUMNS: usize = 200;
/// Slopes beyond so many standard deviations reflect no light: e⁻⁴⁰ of what the flattest does.
const STEEPEST: f64 = 9.0;
/// Standard deviations of φ beyond which a single reflection holds no light.
const WIDEST_RIDGE: f64 = 9.0;

/// Light by cell. Truncated series may dip below zero where there is next to none.
pub(super) fn light(shares: &[f64]) -> Vec<f64> {
    shares.iter().map(|share| share.max(0.0)).collect()
}

/// Share of the incident light in each cell, by component, scaled to the share that the solution knows without cells: where a
/// truncated series dips below zero the dips are cut off, which leaves 3 % too much of a faint part (the re-hits of σ = 25° at 1 %
/// accuracy).
pub(crate) fn cell_shares(axis: &ExitAxis, solution: &Solution, incidence: usize) -> [Vec<f64>; 3] {
    let lobe = &solution.lobes[incidence];
    let rule = CellRule::new(axis, lobe.theta_i);
    let scaled = |mut shares: Vec<f64>, known: f64| {
        let integrated: f64 = shares.iter().sum();
        // Less than rounding has no sign, and no shape.
        if integrated > 0.0 && known > FAINTEST {
            shares.iter_mut().for_each(|share| *share *= known / integrated);
        }
        shares
    };
    let [interior, rehit] = match axis {
        ExitAxis::Plane { .. } => {
            let densities = solution.along(incidence, &rule.angles);
            densities.map(|density| light(&rule.by_column(density.into_iter())))
        }
        ExitAxis::Space { .. } => {
            let cells = rule.of(solution);
            let parts =
                [solution.interior_shares(incidence, &cells), solution.rehit_shares(incidence, &cells)];
            parts.map(|part| light(part.values()))
        }
    };
    let interior = scaled(interior, lobe.albedo - lobe.surface);
    let rehit = scaled(rehit, lobe.rehit);
    let single = scaled(rule.single_shares(solution.single_reflection(incidence)), lobe.surface - lobe.rehit);
    let surface = single.iter().zip(&rehit).map(|(single, rehit)| single + rehit).collect();
    [interior, surface, rehit]
}

/// Share of the incident light below which a part of it is rounding.
const FAINTEST: f64 = 1e-13;

/// Points and weights of a Gauss rule repeated in every cell of an axis.
fn gauss<const N: usize>(axis: &Stretched, rule: &[(f64, f64); N]) -> (Vec<f64>, Vec<f64>) {
    let points = axis.by_steps(1.0, rule.map(|(t, _)| t));
    let weighted = |cell: usize| {
        let points = points(cell);
        std::array::from_fn::<_, N, _>(|k| (points[k].0, rule[k].1 * points[k].1))
    };
    (0..axis.cells).flat_map(weighted).unzip()
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
        for (points, weights) in [gauss(&axis, &GAUSS_2), gauss(&axis, &GAUSS_3)] {
            let length: f64 = weights.iter().sum();
            let integral: f64 = points.iter().zip(&weights).map(|(s, w)| w * s.cos()).sum();
            // Two points a cell leave 1e-8 on a cosine.
            assert!((length / std::f64::consts::PI - 1.0).abs() < 1e-6 && (integral - 2.0).abs() < 1e-6);
        }
        assert_eq!(axis.hi, FRAC_PI_2);
    }
}
