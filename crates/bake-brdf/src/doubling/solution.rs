//! What a solution holds, and how it is read.

use faer::Mat;

use super::ModeResult;
use super::grid::Grid;
use super::kernel::Column;
use super::facets::Fate;
use super::star::times;
use crate::transport::{Geometry, Transport};

/// The answer for one incidence.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lobe {
    /// Angle of incidence, radians.
    pub theta_i: f64,
    /// Share of the light that leaves the top.
    pub albedo: f64,
    /// Share that passes the last interface.
    pub transmitted: f64,
    /// Share lost to absorption.
    pub absorbed: f64,
    /// Share reflected by interface 0 alone, before anything entered.
    pub surface: f64,
    /// The part of `surface` that met interface 0 more than once.
    pub rehit: f64,
    /// Mean exit angle of all that leaves the top, radians (plane: signed s; space: θo ≥ 0).
    pub mean: f64,
    /// Its standard deviation, radians.
    pub sd: f64,
    /// Its skewness; 0 where the distribution is symmetric.
    pub skew: f64,
}

/// Lobes of all incidences.
pub struct Solution {
    grid: Grid,
    /// One per incidence, in the order asked.
    pub lobes: Vec<Lobe>,
    /// \[incidence\]: node densities, rows nodes, columns modes.
    interior: Vec<Mat<f64>>,
    rehit: Vec<Mat<f64>>,
    transmitted: Vec<Mat<f64>>,
}

/// Basis functions at the directions of one grid: turns a lobe's coefficients into values by two small products.
pub struct Basis {
    rows: [Mat<f64>; 2],
    columns: [Mat<f64>; 2],
}

impl Solution {
    pub(super) fn assemble(
        transport: &Transport,
        theta_i: &[f64],
        grid: Grid,
        incident: &[Column],
        modes: Vec<ModeResult>,
    ) -> Self {
        let powers: Vec<Vec<f64>> = (0..4).map(|k| grid.power_weights(k)).collect();
        let mut lobes = Vec::with_capacity(theta_i.len());
        let densities = |pick: fn(&ModeResult) -> &Mat<f64>, i: usize| {
            Mat::from_fn(grid.len(), modes.len(), |j, m| pick(&modes[m])[(j, i)] * grid.density_factor(j, m))
        };
        for (i, &theta) in theta_i.iter().enumerate() {
            let mut raw = incident[i].reflected_powers;
            let single: f64 = incident[i].deposit(Fate::Reflected).map_or(0.0, |deposit| deposit.col(0).sum());
            raw[0] = single;
            for (k, moment) in raw.iter_mut().enumerate() {
                let mode = if grid.geometry == Geometry::Plane { &modes[k % 2] } else { &modes[0] };
                *moment += (0..grid.len()).map(|j| powers[k][j] * (mode.interior[(j, i)] + mode.rehit[(j, i)])).sum::<f64>();
            }
            let rehit = modes[0].rehit.col(i).sum();
            let transmitted = modes[0].transmitted.col(i).sum();
            let albedo = single + rehit + modes[0].interior.col(i).sum();
            let (mean, sd, skew) = central(raw);
            lobes.push(Lobe {
                theta_i: theta,
                albedo,
                transmitted,
                absorbed: if transport.absorbs() { 1.0 - albedo - transmitted } else { 0.0 },
                surface: single + rehit,
                rehit,
                mean,
                sd,
                skew,
            });
        }
        let collect = |pick: fn(&ModeResult) -> &Mat<f64>| (0..theta_i.len()).map(|i| densities(pick, i)).collect();
        let (interior, rehit, transmitted) = (collect(|m| &m.interior), collect(|m| &m.rehit), collect(|m| &m.transmitted));
        Self { lobes, interior, rehit, transmitted, grid }
    }

    /// Basis functions at the product grid θ × φ (radians; plane: `theta` holds signed s, `phi` is ignored).
    #[must_use]
    pub fn basis(&self, theta: &[f64], phi: &[f64]) -> Basis {
        let n = self.grid.len();
        let mut rows = [Mat::zeros(theta.len(), n), Mat::zeros(theta.len(), n)];
        for (k, &angle) in theta.iter().enumerate() {
            let sign = if angle < 0.0 { -1.0 } else { 1.0 };
            let [even, odd] = self.grid.cardinals(angle.abs());
            for j in 0..n {
                rows[0][(k, j)] = even[j];
                rows[1][(k, j)] = sign * odd[j];
            }
        }
        let count = self.interior.first().map_or(0, Mat::ncols);
        let columns = [0, 1].map(|parity| {
            let modes = (count + 1 - parity) / 2;
            match self.grid.geometry {
                Geometry::Plane => Mat::full(1, 1, 1.0),
                Geometry::Space => Mat::from_fn(modes, phi.len(), |k, f| ((2 * k + parity) as f64 * phi[f]).cos()),
            }
        });
        Basis { rows, columns }
    }

    /// Density of the interior of one incidence: rows θ, columns φ. Plane: per radian of s; space: f·cos θo, 1/sr.
    #[must_use]
    pub fn interior(&self, incidence: usize, basis: &Basis) -> Mat<f64> {
        evaluate(&self.interior[incidence], basis)
    }

    /// Density of the transmitted light.
    #[must_use]
    pub fn transmitted(&self, incidence: usize, basis: &Basis) -> Mat<f64> {
        evaluate(&self.transmitted[incidence], basis)
    }

    /// Density of the rehit light from the interior's modes alone.
    #[must_use]
    pub fn rehit(&self, incidence: usize, basis: &Basis) -> Mat<f64> {
        evaluate(&self.rehit[incidence], basis)
    }
}

fn evaluate(coefficients: &Mat<f64>, basis: &Basis) -> Mat<f64> {
    let parity = |p: usize| {
        let modes = basis.columns[p].nrows();
        let picked = Mat::from_fn(coefficients.nrows(), modes, |j, k| coefficients[(j, 2 * k + p)]);
        times(times(basis.rows[p].as_ref(), picked.as_ref()).as_ref(), basis.columns[p].as_ref())
    };
    parity(0) + parity(1)
}

/// Mean, standard deviation and skewness from Σ pθᵏ.
fn central(raw: [f64; 4]) -> (f64, f64, f64) {
    if raw[0] <= 0.0 {
        return (0.0, 0.0, 0.0);
    }
    let [_, m1, m2, m3] = raw.map(|moment| moment / raw[0]);
    let variance = (m2 - m1 * m1).max(0.0);
    let sd = variance.sqrt();
    let third = m3 - 3.0 * m1 * m2 + 2.0 * m1 * m1 * m1;
    (m1, sd, if sd > 0.0 { third / (variance * sd) } else { 0.0 })
}
