//! Integrals over the tabulated lobes.

use super::Lobes;
use crate::numerics::angles::Polar;
use crate::numerics::quadrature::gauss_legendre;
use lut_io::axis::Stretched;
use std::f64::consts::PI;

/// Fewest Gauss–Legendre points on every smooth piece of an integral over the tabulated lobes, in θo and in φ.
#[derive(Clone, Copy)]
pub(crate) struct Points {
    exit: usize,
    azimuth: usize,
}

/// For the shape of a distribution.
pub(crate) const COARSE: Points = Points { exit: 1, azimuth: 1 };
/// For its mass.
pub(crate) const FINE: Points = Points { exit: 3, azimuth: 2 };
/// A point for so much of a piece, radians, and the most points a piece: within a long one θd runs through waves of the
/// interference, of which one point in all missed 2e-4 of the light.
const REACH: f64 = PI / 180.0;
const MOST_POINTS: usize = 4;

/// Hands out the light of the tabulated lobes piece by piece: cos θd and the masses of interior and rehit.
pub(crate) fn integrate(lobes: &Lobes, theta_i: f64, points: Points, mut visit: impl FnMut(f64, [f64; 2])) {
    let i = Polar::at(theta_i);
    let incidence = lobes.incidence(&i);
    directions(lobes, theta_i, points, |o, phi, weight| {
        let y2 = (0.5 * phi).sin().powi(2);
        let light = lobes.light(&incidence, &i, o, y2).values;
        // wi·wo = cos θi cos θo − sin θi sin θo cos φ.
        let dot = i.cos * o.cos - i.sin * o.sin * (1.0 - 2.0 * y2);
        visit((0.5 * (1.0 + dot)).max(0.0).sqrt(), light.map(|l| l * weight));
    });
}

/// Hands out exit directions that resolve the tabulated lobes: the polar angle, φ in [0, π], and the solid angle on both sides of
/// the plane of incidence.
pub(crate) fn directions(
    lobes: &Lobes,
    theta_i: f64,
    points: Points,
    mut visit: impl FnMut(&Polar, f64, f64),
) {
    let incidence = lobes.incidence(&Polar::at(theta_i));
    let axis = &lobes.axis;
    let rules: Vec<_> = (1..=MOST_POINTS).map(gauss_legendre).collect();
    // |s| covers the plane's cells of both signs with one set of exits.
    let mut exits = kinks(&axis.columns_at(theta_i));
    exits.iter_mut().for_each(|s| *s = s.abs());
    exits.push(0.0);
    let tabulated = axis.phi_at(theta_i).map(|phi| rule_between(kinks(&phi), &rules, points.azimuth));
    for (theta_o, weight_o) in rule_between(exits, &rules, points.exit) {
        let o = Polar::at(theta_o);
        let decayed = tabulated.is_none().then(|| {
            let width = lobes.decay_width(&incidence, o.sin);
            let around = Stretched { lo: 0.0, centre: 0.0, hi: PI, width, cells: 14 };
            rule_between(kinks(&around), &rules, points.azimuth)
        });
        for &(phi, weight_phi) in tabulated.iter().chain(&decayed).flatten() {
            visit(&o, phi, 2.0 * weight_o * weight_phi * o.sin);
        }
    }
}

/// Edges and centres of the cells: what is read between them is smooth.
fn kinks(axis: &Stretched) -> Vec<f64> {
    (0..=2 * axis.cells).map(|half| axis.at(0.5 * half as f64)).collect()
}

/// Coordinates with weights: a Gauss–Legendre rule between every two of the nodes.
fn rule_between(mut nodes: Vec<f64>, rules: &[Vec<(f64, f64)>], least: usize) -> Vec<(f64, f64)> {
    nodes.sort_by(f64::total_cmp);
    let pieces = nodes.windows(2).flat_map(|ends| {
        let (middle, half) = (0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0]));
        let points = ((2.0 * half / REACH).ceil() as usize).clamp(least, MOST_POINTS);
        rules[points - 1].iter().map(move |(x, w)| (middle + half * x, half * w))
    });
    pieces.filter(|(_, weight)| *weight > 0.0).collect()
}
