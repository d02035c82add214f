//! What a solution holds, and how it is read.

use rayon::prelude::*;
use std::sync::OnceLock;

use super::facets::Fate;
use super::grid::Grid;
use super::kernel::Column;
use super::matrix::{Matrix, sum};
use super::rehit::RehitLobe;
use super::settings::Settings;
use super::surface::{Azimuth, SingleReflection};
use crate::{Geometry, Transport};

/// The totals of one incidence.
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

/// Transmitted light, as a share of the incident, below which its relative error is of no use to anyone: a lobe fainter
/// than this is judged as if it had it.
pub const FAINT: f64 = 1e-3;

/// What the error of a component is judged by where all reflected light is by itself: √(all light · its own), so that one with a
/// hundredth of the light may be off by ten times as large a share of itself, as if it had been counted. One with less than a ten
/// thousandth is judged as if it had that.
#[must_use]
pub fn component_scale(own: f64, all: f64) -> f64 {
    const FAINTEST: f64 = 1e-4;
    all * (own / all).max(FAINTEST).sqrt()
}

/// Total variation between two Gaussian lobes by the relative difference of their widths, √(2/πe). The azimuth postulate spreads lobes
/// of the plane by their standard deviation, in which light far from the lobe counts by its distance squared.
const BY_WIDTH: f64 = 0.484;

/// Further than so many standard deviations from the mean, light counts in one only as far as two resolutions agree about it. What rings
/// there (no polynomial follows a layer that hardly absorbs into the horizon) is nothing beside the lobe, but its distance squared is not.
const FAR: f64 = 6.0;

/// Where no standard deviation is further off, by the total variation that it makes, all of them are kept as they are.
const STEADY: f64 = 1e-4;

/// How far two resolutions are apart: the solver's own error estimate.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ErrorEstimate {
    /// Estimated total variation of the reflected lobe, as a share of the reflected light, by incidence; in the plane with what the error
    /// of its standard deviation makes of its azimuth.
    pub total_variation: Vec<f64>,
    /// The same of the interior and of what met interface 0 more than once, each as a share of its [`component_scale`].
    pub components: [Vec<f64>; 2],
    /// The same of the transmitted lobe, as a share of the transmitted light (or of [`FAINT`], if that is more); only where
    /// both sides are solved.
    pub transmitted: Vec<f64>,
    /// Largest difference of albedo or transmitted share between the two resolutions.
    pub albedo: f64,
    /// Largest difference of the mean exit angle, radians.
    pub mean: f64,
    /// Largest difference of the standard deviation, radians.
    pub sd: f64,
    /// Largest difference of the skewness.
    pub skew: f64,
}

impl ErrorEstimate {
    /// The worst of all incidences, of the reflected lobe and of its components.
    #[must_use]
    pub fn worst(&self) -> f64 {
        let parts = self.components.iter().flatten().chain(&self.total_variation);
        parts.fold(0.0, |worst, tv| worst.max(*tv))
    }
}

/// One mode's share of the solution, columns by incidence.
pub(super) struct ModeResult {
    pub(super) interior: Matrix,
    pub(super) rehit: Matrix,
    pub(super) transmitted: Matrix,
}

/// Lobes of all incidences.
#[derive(Debug)]
pub struct Solution {
    /// Totals, one per incidence, in the order asked.
    pub lobes: Vec<Lobe>,
    /// The settings that were used.
    pub settings: Settings,
    /// Estimated error, where two resolutions were compared.
    pub error: Option<ErrorEstimate>,
    /// Light from below at the same angles (in the substrate), where [`Settings::both_sides`] asks for it: the solution of
    /// the stack upside down. With it the body can be changed without solving again,
    /// R_total = R + T′(I − R_body R′)⁻¹ R_body T; R′ is its reflected light, T′ its transmitted light.
    pub from_below: Option<Box<Solution>>,
    pub(super) grid: Grid,
    single: Vec<SingleReflection>,
    /// \[incidence\]: node densities, rows nodes, columns modes.
    interior: Vec<Matrix>,
    /// Plane: node densities of both parities.
    rehit: Vec<Matrix>,
    /// Space: the lobe resolved in azimuth, found when it is asked for.
    rehit_lobes: Vec<OnceLock<Option<RehitLobe>>>,
    transport: Transport,
    transmitted: Vec<Matrix>,
    /// Standard deviations as solved: [`Self::compare`] steadies those of the lobes.
    solved_sds: Vec<f64>,
}

/// Basis functions on a product grid of directions: turns a lobe's coefficients into values by two small products.
#[derive(Clone, Debug)]
pub struct Basis {
    theta: Vec<f64>,
    phi: Vec<f64>,
    values: Product,
}

/// What coefficients are multiplied by from either side, by parity.
#[derive(Clone, Debug)]
struct Product {
    rows: [Matrix; 2],
    columns: [Matrix; 2],
}

/// Cells of exit directions: turns a lobe's coefficients into integrals over them.
#[derive(Clone, Debug)]
pub struct Cells {
    theta: Vec<f64>,
    weights: Vec<f64>,
    sectors: Vec<f64>,
    integrals: Product,
}

impl Solution {
    pub(super) fn assemble(
        transport: &Transport,
        theta_i: &[f64],
        settings: Settings,
        grid: Grid,
        incident: &[Column],
        modes: Vec<ModeResult>,
    ) -> Self {
        let single: Vec<SingleReflection> =
            theta_i.iter().map(|&theta| SingleReflection::new(transport, grid.geometry, theta)).collect();
        let lobes = totals(transport, theta_i, &grid, incident, &modes);
        let collect = |pick: fn(&ModeResult) -> &Matrix| {
            (0..theta_i.len())
                .map(|i| {
                    Matrix::from_fn(grid.len(), modes.len(), |j, m| {
                        pick(&modes[m])[(j, i)] * grid.density_factor(j, m)
                    })
                })
                .collect()
        };
        Self {
            rehit_lobes: lobes.iter().map(|_| OnceLock::new()).collect(),
            solved_sds: lobes.iter().map(|lobe| lobe.sd).collect(),
            transport: transport.clone(),
            lobes,
            settings,
            error: None,
            from_below: None,
            single,
            interior: collect(|mode| &mode.interior),
            rehit: collect(|mode| &mode.rehit),
            transmitted: collect(|mode| &mode.transmitted),
            grid,
        }
    }

    /// Plane or space.
    #[must_use]
    pub fn geometry(&self) -> Geometry {
        self.grid.geometry
    }

    /// Basis functions at the product grid θ × φ, radians. Plane: `theta` holds the signed s, and `phi` one ignored
    /// number. Space: θ in \[0, π/2\].
    #[must_use]
    pub fn basis(&self, theta: &[f64], phi: &[f64]) -> Basis {
        let rows = self.grid.cardinals(theta);
        let count = self.settings.modes_in(self.grid.geometry);
        let columns = [0, 1].map(|parity| match self.grid.geometry {
            Geometry::Plane => Matrix::from_fn(1, 1, |_, _| 1.0),
            Geometry::Space => Matrix::from_fn((count + 1 - parity) / 2, phi.len(), |k, f| {
                ((2 * k + parity) as f64 * phi[f]).cos()
            }),
        });
        let phi = if self.grid.geometry == Geometry::Plane { vec![0.0] } else { phi.to_vec() };
        Basis { theta: theta.to_vec(), phi, values: Product { rows, columns } }
    }

    /// Cells of `columns` × the sectors between these edges of φ (radians; both mirror halves count), each integrated along θ by as
    /// many points and weights (dθ, in space with sin θ). Plane: `theta` holds the signed s, and there are no sectors.
    #[must_use]
    pub fn cells(&self, theta: &[f64], weights: &[f64], columns: usize, sectors: &[f64]) -> Cells {
        let points = theta.len() / columns;
        let mut rows = [0, 1].map(|_| Matrix::zeros(columns, self.grid.len()));
        // Some cells at a time: their points' values stay in the cache.
        const TOGETHER: usize = 16;
        for first in (0..columns).step_by(TOGETHER) {
            let cells = first..(first + TOGETHER).min(columns);
            let here = cells.start * points..cells.end * points;
            let values = self.grid.cardinals(&theta[here.clone()]);
            for (rows, values) in rows.iter_mut().zip(&values) {
                for j in 0..values.columns() {
                    let by_cell = weights[here.clone()].chunks(points).zip(values.column(j).chunks(points));
                    let integrals = by_cell.map(|(w, v)| w.iter().zip(v).map(|(w, v)| w * v).sum());
                    rows.column_mut(j)[cells.clone()]
                        .iter_mut()
                        .zip(integrals)
                        .for_each(|(row, integral): (&mut f64, f64)| *row = integral);
                }
            }
        }
        let count = self.settings.modes_in(self.grid.geometry);
        let around = [0, 1].map(|parity| match self.grid.geometry {
            Geometry::Plane => Matrix::from_fn(1, 1, |_, _| 1.0),
            Geometry::Space => {
                let integral = |mode: usize, phi: f64| match mode {
                    0 => phi,
                    _ => (mode as f64 * phi).sin() / mode as f64,
                };
                Matrix::from_fn((count + 1 - parity) / 2, sectors.len().saturating_sub(1), |k, f| {
                    let mode = 2 * k + parity;
                    2.0 * (integral(mode, sectors[f + 1]) - integral(mode, sectors[f]))
                })
            }
        });
        Cells {
            theta: theta.to_vec(),
            weights: weights.to_vec(),
            sectors: sectors.to_vec(),
            integrals: Product { rows, columns: around },
        }
    }

    /// Share of the incident light that entered the stack and leaves through each cell: rows along θ, columns along φ. Truncation
    /// may leave it slightly negative where it is ≈ 0.
    #[must_use]
    pub fn interior_shares(&self, incidence: usize, cells: &Cells) -> Matrix {
        evaluate(&self.interior[incidence], &cells.integrals)
    }

    /// Share that is transmitted through each cell of directions in the substrate.
    #[must_use]
    pub fn transmitted_shares(&self, incidence: usize, cells: &Cells) -> Matrix {
        evaluate(&self.transmitted[incidence], &cells.integrals)
    }

    /// Share that met interface 0 more than once and never entered.
    #[must_use]
    pub fn rehit_shares(&self, incidence: usize, cells: &Cells) -> Matrix {
        let Cells { theta, weights, sectors, integrals } = cells;
        if self.grid.geometry == Geometry::Plane {
            return evaluate(&self.rehit[incidence], integrals);
        }
        let columns = integrals.rows[0].rows();
        match self.rehit_lobe(incidence) {
            Some(lobe) => lobe.shares(theta, weights, columns, sectors),
            None => Matrix::zeros(columns, sectors.len().saturating_sub(1)),
        }
    }

    /// Density of the interior (what entered the stack and came back) of one incidence: rows θ, columns φ. Plane: per
    /// radian of s; space: f·cos θo, 1/sr. Truncation may leave it slightly negative where it is ≈ 0.
    #[must_use]
    pub fn interior(&self, incidence: usize, basis: &Basis) -> Matrix {
        evaluate(&self.interior[incidence], &basis.values)
    }

    /// [`Self::interior`] and [`Self::rehit`] of one incidence at signed exit angles, radians: without basis functions, which serve many.
    ///
    /// # Panics
    /// If the solution is one in space.
    #[must_use]
    pub fn along(&self, incidence: usize, s: &[f64]) -> [Vec<f64>; 2] {
        self.grid.interpolated(s, [&self.interior[incidence], &self.rehit[incidence]])
    }

    /// Density of the transmitted light in the substrate, per radian of signed angle or per steradian.
    #[must_use]
    pub fn transmitted(&self, incidence: usize, basis: &Basis) -> Matrix {
        evaluate(&self.transmitted[incidence], &basis.values)
    }

    /// Density of what met interface 0 more than once and never entered.
    #[must_use]
    pub fn rehit(&self, incidence: usize, basis: &Basis) -> Matrix {
        if self.grid.geometry == Geometry::Plane {
            return evaluate(&self.rehit[incidence], &basis.values);
        }
        match self.rehit_lobe(incidence) {
            Some(lobe) => lobe.values(&basis.theta, &basis.phi),
            None => Matrix::zeros(basis.theta.len(), basis.phi.len()),
        }
    }

    fn rehit_lobe(&self, incidence: usize) -> Option<&RehitLobe> {
        let lobe = self.rehit_lobes[incidence].get_or_init(|| {
            let Lobe { theta_i, rehit, .. } = self.lobes[incidence];
            RehitLobe::new(&self.transport, &self.single[incidence], theta_i, rehit, self.settings.reach)
        });
        lobe.as_ref()
    }

    /// Density of what interface 0 reflected at its first facet: the closed form.
    #[must_use]
    pub fn single(&self, incidence: usize, basis: &Basis) -> Matrix {
        let (lobe, Basis { theta, phi, .. }) = (&self.single[incidence], basis);
        match self.grid.geometry {
            Geometry::Plane => Matrix::from_fn(theta.len(), phi.len(), |k, _| lobe.plane(theta[k])),
            Geometry::Space => {
                let exits: Vec<(f64, f64)> = theta.iter().map(|theta| theta.sin_cos()).collect();
                let around: Vec<Azimuth> = phi.iter().map(|phi| Azimuth::new(*phi)).collect();
                Matrix::from_fn(theta.len(), phi.len(), |k, f| lobe.towards(exits[k], around[f]))
            }
        }
    }

    /// The closed form of one incidence, for any direction.
    #[must_use]
    pub fn single_reflection(&self, incidence: usize) -> &SingleReflection {
        &self.single[incidence]
    }

    /// Compares with a coarser solution of the same problem and stores the estimate of this one's error.
    ///
    /// [`Settings::coarser`] takes 0.8 of the nodes. While lobes are unresolved the error falls faster than
    /// exponentially with them, later like N⁻⁴ at worst (kinks of the kernels at the critical angle): either way at
    /// most two thirds of the difference are left.
    pub(super) fn compare(&mut self, coarse: &Self) {
        let (theta, weights) = self.quadrature();
        let count = if self.grid.geometry == Geometry::Plane { 1 } else { 2 * self.settings.modes + 2 };
        let phi: Vec<f64> =
            (0..count).map(|f| std::f64::consts::PI * (f as f64 + 0.5) / count as f64).collect();
        let (fine_basis, coarse_basis) = (self.basis(&theta, &phi), coarse.basis(&theta, &phi));
        let apart = |difference: &Matrix, light: f64| {
            let sum: f64 = (0..count)
                .map(|f| difference.column(f).iter().zip(&weights).map(|(d, w)| w * d.abs()).sum::<f64>())
                .sum();
            0.5 * sum / count as f64 / light / 1.5
        };
        let minus = |fine: &Matrix, coarse: &Matrix| fine.clone().with(coarse, |a, b| a - b);
        let spread = |[fine, coarse]: [f64; 2]| BY_WIDTH * (fine - coarse).abs() / fine.max(1e-300);
        let solved = |i: usize| [self.solved_sds[i], coarse.solved_sds[i]];
        let is_steady = (0..self.lobes.len()).all(|i| spread(solved(i)) <= STEADY);
        let reflected = |i: usize| {
            let (lobe, all) = (&self.lobes[i], self.lobes[i].albedo.max(1e-300));
            let interior = self.interior(i, &fine_basis);
            let interior_apart = minus(&interior, &coarse.interior(i, &coarse_basis));
            let (rehit_apart, sds, spread) = match self.grid.geometry {
                Geometry::Plane => {
                    let rehit = self.rehit(i, &fine_basis);
                    let rehit_apart = minus(&rehit, &coarse.rehit(i, &coarse_basis));
                    let far = |parts: [&Matrix; 2]| {
                        far_variance(lobe, &theta, &weights, parts).map(|far| far / all)
                    };
                    let sds = if is_steady {
                        solved(i)
                    } else {
                        steadied(solved(i), far([&interior, &rehit]), far([&interior_apart, &rehit_apart]))
                    };
                    (rehit_apart, sds, spread(sds))
                }
                // Re-hits are found incidence by incidence, at no resolution; and no azimuth waits for a standard deviation.
                Geometry::Space => (Matrix::zeros(interior.rows(), interior.columns()), solved(i), 0.0),
            };
            let [own_interior, own_rehit] = [lobe.albedo - lobe.surface, lobe.rehit];
            let part = |difference: &Matrix, own: f64| {
                let scale = component_scale(own, all);
                apart(difference, scale) + spread * own / scale
            };
            let components = [part(&interior_apart, own_interior), part(&rehit_apart, own_rehit)];
            // The single reflection has a closed form.
            let spread = spread * (own_interior + own_rehit) / all;
            let all = apart(&interior_apart.with(&rehit_apart, |a, b| a + b), all) + spread;
            ([all, components[0], components[1]], sds)
        };
        let reflected: Vec<([f64; 3], [f64; 2])> =
            (0..self.lobes.len()).into_par_iter().map(reflected).collect();
        let [total_variation, interior, rehit] =
            [0, 1, 2].map(|k: usize| reflected.iter().map(|(found, _)| found[k]).collect());
        let sd = reflected.iter().fold(0.0f64, |most, (_, [fine, coarse])| most.max((fine - coarse).abs()));
        for (lobe, (_, [sd, _])) in self.lobes.iter_mut().zip(&reflected) {
            lobe.sd = *sd;
        }
        let through = if self.settings.both_sides { self.lobes.len() } else { 0 };
        let transmitted = (0..through)
            .map(|i| {
                let difference =
                    minus(&self.transmitted(i, &fine_basis), &coarse.transmitted(i, &coarse_basis));
                apart(&difference, self.lobes[i].transmitted.max(FAINT))
            })
            .collect();
        if let (Some(fine), Some(coarse)) = (&mut self.from_below, &coarse.from_below) {
            fine.compare(coarse);
        }
        let largest = |pick: fn(&Lobe) -> f64| {
            self.lobes.iter().zip(&coarse.lobes).map(|(a, b)| (pick(a) - pick(b)).abs()).fold(0.0, f64::max)
        };
        self.error = Some(ErrorEstimate {
            total_variation,
            components: [interior, rehit],
            transmitted,
            albedo: largest(|lobe| lobe.albedo).max(largest(|lobe| lobe.transmitted)),
            mean: largest(|lobe| lobe.mean),
            sd,
            skew: largest(|lobe| lobe.skew),
        });
    }

    /// Nodes and weights that integrate over exit directions (space: φ averaged, so 2π is in the weight).
    fn quadrature(&self) -> (Vec<f64>, Vec<f64>) {
        match self.grid.geometry {
            Geometry::Plane => {
                let mirrored = self.grid.theta.iter().map(|theta| -theta);
                let theta = mirrored.chain(self.grid.theta.iter().copied()).collect();
                (theta, [self.grid.weights.clone(), self.grid.weights.clone()].concat())
            }
            Geometry::Space => {
                let weights = self.grid.weights.iter().map(|w| 2.0 * std::f64::consts::PI * w).collect();
                (self.grid.theta.clone(), weights)
            }
        }
    }
}

fn totals(
    transport: &Transport,
    theta_i: &[f64],
    grid: &Grid,
    incident: &[Column],
    modes: &[ModeResult],
) -> Vec<Lobe> {
    let powers: Vec<Vec<f64>> = (0..4).map(|k| grid.power_weights(k)).collect();
    let lobe = |i: usize| {
        let single: f64 = incident[i].deposit(Fate::Reflected).map_or(0.0, |deposit| sum(deposit.column(0)));
        let mut raw = incident[i].reflected_powers;
        raw[0] = single;
        for (k, moment) in raw.iter_mut().enumerate() {
            let mode = if grid.geometry == Geometry::Plane { &modes[k % 2] } else { &modes[0] };
            for (j, power) in powers[k].iter().enumerate() {
                *moment += power * (mode.interior[(j, i)] + mode.rehit[(j, i)]);
            }
        }
        let rehit = sum(modes[0].rehit.column(i));
        let transmitted = sum(modes[0].transmitted.column(i));
        let albedo = single + rehit + sum(modes[0].interior.column(i));
        let (mean, sd, skew) = central(raw);
        Lobe {
            theta_i: theta_i[i],
            albedo,
            transmitted,
            absorbed: if transport.absorbs() { 1.0 - albedo - transmitted } else { 0.0 },
            surface: single + rehit,
            rehit,
            mean,
            sd,
            skew,
        }
    };
    (0..theta_i.len()).map(lobe).collect()
}

fn evaluate(coefficients: &Matrix, product: &Product) -> Matrix {
    let parity = |p: usize| {
        let modes = product.columns[p].rows();
        let picked = Matrix::from_fn(coefficients.rows(), modes, |j, k| coefficients[(j, 2 * k + p)]);
        product.rows[p].times(&picked).times(&product.columns[p])
    };
    let mut sum = parity(0);
    sum += &parity(1);
    sum
}

/// What some parts of a lobe, densities at these angles, add to its variance from [`FAR`] away, times its light: as it is, and by its size.
fn far_variance(lobe: &Lobe, theta: &[f64], weights: &[f64], parts: [&Matrix; 2]) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (k, (theta, weight)) in theta.iter().zip(weights).enumerate() {
        let away = theta - lobe.mean;
        if away.abs() > FAR * lobe.sd {
            let moment = weight * away * away * (parts[0][(k, 0)] + parts[1][(k, 0)]);
            sums = [sums[0] + moment, sums[1] + moment.abs()];
        }
    }
    sums
}

/// Two standard deviations of a lobe, at a resolution and at a coarser one, less what is `far` in their variances as far as they are `apart`.
fn steadied(sds: [f64; 2], [far, _]: [f64; 2], [apart, size]: [f64; 2]) -> [f64; 2] {
    let doubt = if size < far.abs() { size / far.abs() } else { 1.0 };
    let [fine, coarse] = [sds[0] * sds[0] - doubt * far, sds[1] * sds[1] - doubt * (far - apart)];
    [fine, coarse].map(|variance| variance.max(0.0).sqrt())
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
