//! How much direction a cell stands for: cell sizes, reading weights, and from shares of light to stored values.
//!
//! A stored value sits at its cell's centre (half-way in *position*, [`Stretched::at`]); between centres a lobe
//! is read linearly in position, and constantly in the half cells at the two ends ([`crate::lobe`]). So the
//! hemispherical integral of a row is exactly Σ value·weight with weight = ∫ hat dω. The weights are stored in
//! the file (`weight_sr`), and the stored values are normalised with them.

use crate::model::axis::{ExitAxis, Stretched};
use crate::model::decay;
use std::f64::consts::{PI, TAU};

/// What the error of a component is judged by where all reflected light is by itself: √(all light · its own), so that one with a
/// hundredth of the light may be off by ten times as large a share of itself, as if it had been counted. One with less than a ten
/// thousandth is judged as if it had that.
///
/// The solver of `transport` judges its own error by the same rule.
#[must_use]
pub fn component_scale(own: f64, all: f64) -> f64 {
    const FAINTEST: f64 = 1e-4;
    all * (own / all).max(FAINTEST).sqrt()
}

/// Extent of each cell of one incidence: ds in radians for plane axes, the solid angle of the cell and its
/// mirror image (−φ) in steradians for space axes. Order as in the table: φ-major, columns last.
#[must_use]
pub fn cell_extents(axis: &ExitAxis, theta_i: f64) -> Vec<f64> {
    let columns = axis.columns_at(theta_i).edges();
    let Some(phi) = axis.phi_at(theta_i) else {
        return columns.windows(2).map(|s| s[1] - s[0]).collect();
    };
    // cos a − cos b = 2 sin((a + b)/2) sin((b − a)/2) keeps its digits for narrow cells.
    let bands: Vec<f64> =
        columns.windows(2).map(|t| 2.0 * (0.5 * (t[0] + t[1])).sin() * (0.5 * (t[1] - t[0])).sin()).collect();
    let sectors = phi.edges();
    sectors.windows(2).flat_map(|p| bands.iter().map(move |band| 2.0 * (p[1] - p[0]) * band)).collect()
}

/// Reading weight of each cell of one incidence, steradians: Σ value·weight is the hemispherical integral of
/// the lobe as it is read, with both mirror halves.
///
/// `azimuth_width` is w of the decay postulate, radians; space axes ignore it.
#[must_use]
pub fn reading_weights(axis: &ExitAxis, theta_i: f64, azimuth_width: f64) -> Vec<f64> {
    let columns = axis.columns_at(theta_i);
    let Some(phi) = axis.phi_at(theta_i) else {
        let concentration = theta_i.sin() / (azimuth_width * azimuth_width);
        return hat_integrals(&columns, |s| {
            let sines = s.map(|s| s.sin().abs());
            let means = decay::mean_decays(sines.map(|sine| concentration * sine));
            std::array::from_fn(|k| TAU * sines[k] * if s[k] >= 0.0 { means[k] } else { 1.0 - means[k] })
        });
    };
    let bands = hat_integrals(&columns, |theta| theta.map(f64::sin));
    let sectors = hat_integrals(&phi, |phi| phi.map(|_| 2.0));
    sectors.iter().flat_map(|sector| bands.iter().map(move |band| sector * band)).collect()
}

/// Factors that turn the share of light in each cell into its stored value, f·cos θo in 1/sr.
///
/// `shares[k]` is the light that left through cell k as a share of the incident light (paths in the cell over
/// paths walked); the density share/extent is rescaled so that Σ value·weight = Σ shares: in the plane this is
/// f cos θo = A·g/∫g dω of the azimuth postulate. Standard errors of shares take the same factors.
#[must_use]
pub fn value_factors(shares: &[f64], extents: &[f64], weights: &[f64]) -> Vec<f64> {
    let albedo: f64 = shares.iter().sum();
    let integral: f64 = shares.iter().zip(extents).zip(weights).map(|((share, d), w)| share / d * w).sum();
    // Without light every scale is right; 1 keeps the factors finite.
    let scale = if integral > 0.0 { albedo / integral } else { 1.0 };
    extents.iter().map(|extent| scale / extent).collect()
}

/// ∫ hat_k(x)·density(x) dx for every cell k of an axis; hat_k is 1 at the centre of cell k, falls linearly in
/// position to 0 at the neighbouring centres, and stays 1 in the outer halves of the first and last cells.
fn hat_integrals(axis: &Stretched, density: impl Fn([f64; NODES]) -> [f64; NODES]) -> Vec<f64> {
    let mut integrals = vec![0.0; axis.cells];
    let at = axis.with_slope();
    let halves = axis.by_steps(0.5, GAUSS_LEGENDRE.map(|(t, _)| t));
    let mut add = |nodes: [(f64, f64, f64); NODES]| {
        let densities = density(nodes.map(|(_, x, _)| x));
        for ((u, _, weight), density) in nodes.into_iter().zip(densities) {
            let mass = weight * density;
            let (cell, fraction) = neighbours(u, axis.cells);
            integrals[cell] += (1.0 - fraction) * mass;
            if fraction > 0.0 {
                integrals[cell + 1] += fraction * mass;
            }
        }
    };
    // u = from + (to − from)·t², so that a √x start is integrated as a polynomial.
    let graded = |from: f64, to: f64| {
        GAUSS_LEGENDRE.map(|(t, weight)| {
            let u = from + (to - from) * t * t;
            let (x, slope) = at(u);
            (u, x, weight * 2.0 * t * (to - from).abs() * slope)
        })
    };
    // Half cells: the hats have their kinks at centres, the axis has one at the edge in its middle, and the
    // density of a plane row has one at s = 0, where D̄ may start as √s.
    let kink = if axis.lo < 0.0 { axis.position(0.0) } else { 0.0 };
    for half in 0..2 * axis.cells {
        let (from, to) = (0.5 * half as f64, 0.5 * (half + 1) as f64);
        if from <= kink && kink <= to {
            add(graded(kink, from));
            add(graded(kink, to));
        } else {
            let at = halves(half);
            add(std::array::from_fn(|k| {
                let ((t, weight), (x, slope)) = (GAUSS_LEGENDRE[k], at[k]);
                (from + 0.5 * t, x, 0.5 * weight * slope)
            }));
        }
    }
    integrals
}

/// The cell whose centre lies at or before a position, and how far (0..1) the position is towards the next
/// centre; constant in the outer half cells.
pub(crate) fn neighbours(position: f64, cells: usize) -> (usize, f64) {
    let from_first = (position - 0.5).clamp(0.0, (cells - 1) as f64);
    let cell = (from_first as usize).min(cells.saturating_sub(2));
    (cell, from_first - cell as f64)
}

/// Nodes of a half cell.
const NODES: usize = 6;

/// Nodes and weights of the six-point Gauss–Legendre rule on [0, 1] (Abramowitz & Stegun table 25.4).
const GAUSS_LEGENDRE: [(f64, f64); NODES] = {
    const X: [f64; 3] = [0.238_619_186_083_196_9, 0.661_209_386_466_264_5, 0.932_469_514_203_152_1];
    const W: [f64; 3] = [0.467_913_934_572_691_0, 0.360_761_573_048_138_6, 0.171_324_492_379_170_4];
    [
        (0.5 - 0.5 * X[2], 0.5 * W[2]),
        (0.5 - 0.5 * X[1], 0.5 * W[1]),
        (0.5 - 0.5 * X[0], 0.5 * W[0]),
        (0.5 + 0.5 * X[0], 0.5 * W[0]),
        (0.5 + 0.5 * X[1], 0.5 * W[1]),
        (0.5 + 0.5 * X[2], 0.5 * W[2]),
    ]
};

/// Solid angle of the hemisphere, steradians.
pub const HEMISPHERE: f64 = 2.0 * PI;

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    const PLANE: ExitAxis = ExitAxis::Plane { cells: 96, width: 0.07 };
    const SPACE: ExitAxis = ExitAxis::Space { theta_cells: 64, phi_cells: 24, width: 0.07 };
    const INCIDENCES: [f64; 6] = [0.0, 1e-6, 0.01, 0.6, 1.4, FRAC_PI_2];

    #[test]
    fn space_cells_cover_the_hemisphere_once() {
        for theta_i in INCIDENCES {
            let solid: f64 = cell_extents(&SPACE, theta_i).iter().sum();
            assert!((solid / HEMISPHERE - 1.0).abs() < 1e-12, "{theta_i}: {solid}");
            let read: f64 = reading_weights(&SPACE, theta_i, 0.0).iter().sum();
            // The six-point rule on half cells leaves less than 1e-9 for a smooth density.
            assert!((read / HEMISPHERE - 1.0).abs() < 1e-9, "{theta_i}: {read}");
        }
    }

    #[test]
    fn plane_weights_cover_the_hemisphere_once() {
        // g = 1 for p = 1, as D + (1 − D) = 1: the weights must add up to 2π whatever the decay.
        for theta_i in INCIDENCES {
            for width in [1e-4, 0.05, 0.2, 3.0] {
                let read: f64 = reading_weights(&PLANE, theta_i, width).iter().sum();
                // Six points a half cell; the widest cells, far from the mirror direction, leave 1.1e-8, below
                // the 6e-8 that the weights are rounded by in the file.
                assert!((read / HEMISPHERE - 1.0).abs() < 6e-8, "{theta_i} {width}: {read}");
            }
        }
    }

    #[test]
    fn plane_weights_are_the_integral_of_the_decayed_hats() {
        // Independent: brute midpoint sum over (θo, φ) of the lobe as it would be read.
        let (theta_i, width) = (0.5, 0.15);
        let axis = PLANE.columns_at(theta_i);
        let values: Vec<f64> = axis.centres().iter().map(|s| (-((s - 0.5) / 0.2).powi(2)).exp()).collect();
        let read = |s: f64| {
            let (k, t) = neighbours(axis.position(s), axis.cells);
            values[k] * (1.0 - t) + values[k + 1] * t
        };
        let (n, m) = (4000, 400);
        let mut integral = 0.0;
        for i in 0..n {
            let theta_o = FRAC_PI_2 * (i as f64 + 0.5) / n as f64;
            let (forward, back) = (read(theta_o), read(-theta_o));
            let x = decay::concentration(theta_i, theta_o, width);
            for j in 0..m {
                let d = decay::decay(x, (PI * (j as f64 + 0.5) / m as f64).cos());
                integral += (forward * d + back * (1.0 - d)) * theta_o.sin();
            }
        }
        integral *= FRAC_PI_2 / n as f64 * TAU / m as f64;
        let weights = reading_weights(&PLANE, theta_i, width);
        let sum: f64 = weights.iter().zip(&values).map(|(w, v)| w * v).sum();
        // The midpoint sum has an error of order 1/n² at the kinks of the reading rule.
        assert!((sum / integral - 1.0).abs() < 1e-6, "{sum} {integral}");
    }

    #[test]
    fn stored_values_integrate_to_the_shares_they_came_from() {
        for (axis, width) in [(PLANE, 0.15), (SPACE, 0.0)] {
            let weights = reading_weights(&axis, 0.9, width);
            let extents = cell_extents(&axis, 0.9);
            let shares: Vec<f64> = (0..axis.cells()).map(|k| 1e-4 * (1.0 + (k as f64).sin())).collect();
            let factors = value_factors(&shares, &extents, &weights);
            let read: f64 = (0..axis.cells()).map(|k| shares[k] * factors[k] * weights[k]).sum();
            assert!((read / shares.iter().sum::<f64>() - 1.0).abs() < 1e-13);
            let dark = value_factors(&vec![0.0; axis.cells()], &extents, &weights);
            assert!(dark.iter().all(|f| f.is_finite()));
        }
    }

    #[test]
    fn weights_at_normal_incidence_do_not_prefer_a_side() {
        let weights = reading_weights(&PLANE, 0.0, 0.1);
        for (a, b) in weights.iter().zip(weights.iter().rev()) {
            assert!((a / b - 1.0).abs() < 1e-12);
        }
    }
}
