//! What a goniometer measures of the pearl: the BRDF at angles of incidence and of scatter.
//!
//! Light arrives at θi and is seen at θo and φ, from the mirror direction; a pearl is alike on both sides of the plane of
//! incidence, so that φ goes from 0 to 180°.

use crate::{Direction, PearlBsdf};
use rayon::prelude::*;

/// Angles, degrees: from, to (not included) and step.
const THETA_I_DEG: [[f64; 3]; 3] = [[0.0, 60.0, 2.5], [60.0, 80.0, 2.0], [80.0, 90.0, 1.0]];
const THETA_O_DEG: [[f64; 3]; 2] = [[0.0, 75.0, 1.0], [75.0, 90.0, 0.5]];
/// Facets tilted across the plane of incidence turn the azimuth by no more than twice their tilt over tan θ.
const PHI_DEG: [[f64; 3]; 5] =
    [[0.0, 1.0, 0.125], [1.0, 4.0, 0.5], [4.0, 10.0, 1.0], [10.0, 30.0, 2.0], [30.0, 190.0, 10.0]];

/// A measured BRDF.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    /// Angles, degrees.
    pub(super) theta_i: Vec<f64>,
    theta_o: Vec<f64>,
    phi: Vec<f64>,
    /// f in 1/sr, linear sRGB, by θi, θo and φ.
    values: Vec<[f64; 3]>,
}

/// A value and where it is, degrees; the solid angle that it stands for, with its mirror image at −φ.
#[derive(Clone, Copy, Debug)]
pub(super) struct Row {
    pub(super) theta_i: f64,
    pub(super) theta_o: f64,
    pub(super) phi: f64,
    pub(super) solid_angle: f64,
    pub(super) rgb: [f64; 3],
}

impl Measured {
    pub(super) fn new(bsdf: &PearlBsdf) -> Self {
        let [theta_i, theta_o, phi] = [steps(&THETA_I_DEG), steps(&THETA_O_DEG), steps(&PHI_DEG)];
        let at = |incidence: &f64| -> Vec<[f64; 3]> {
            let wi = direction(*incidence, 180.0);
            let pairs = theta_o.iter().flat_map(|theta_o| phi.iter().map(move |phi| (*theta_o, *phi)));
            pairs
                .map(|(theta_o, phi)| {
                    let wo = direction(theta_o, phi);
                    bsdf.eval(wi, wo).rgb().map(|x| x / wo[2])
                })
                .collect()
        };
        let values = theta_i.par_iter().flat_map_iter(at).collect();
        Self { theta_i, theta_o, phi, values }
    }

    /// All that is measured, φ fastest.
    pub(super) fn rows(&self) -> impl Iterator<Item = Row> {
        let places = (0..self.theta_i.len() * self.theta_o.len() * self.phi.len()).map(|at| {
            let (rest, phi) = (at / self.phi.len(), at % self.phi.len());
            (rest / self.theta_o.len(), rest % self.theta_o.len(), phi)
        });
        places.zip(&self.values).map(|((i, o, phi), rgb)| {
            let [low, high] = cell(&self.theta_o, o, 90.0).map(|degrees| degrees.to_radians().cos());
            let [from, to] = cell(&self.phi, phi, 180.0).map(f64::to_radians);
            Row {
                theta_i: self.theta_i[i],
                theta_o: self.theta_o[o],
                phi: self.phi[phi],
                solid_angle: 2.0 * (low - high) * (to - from),
                rgb: *rgb,
            }
        })
    }

    /// f·cos θo, which is smooth up to the horizon where f is not, read linearly in the three angles.
    pub(super) fn eval(&self, wi: Direction, wo: Direction) -> [f64; 3] {
        let degrees = |cos: f64| cos.clamp(-1.0, 1.0).acos().to_degrees();
        let across = [wi[0].hypot(wi[1]), wo[0].hypot(wo[1])];
        let cos_phi = -(wi[0] * wo[0] + wi[1] * wo[1]) / (across[0] * across[1]).max(1e-30);
        let places = [
            place(&self.theta_i, degrees(wi[2])),
            place(&self.theta_o, degrees(wo[2])),
            place(&self.phi, degrees(cos_phi)),
        ];
        let mut sum = [0.0; 3];
        for corner in 0..8 {
            let [i, o, p] = [0, 1, 2].map(|axis| {
                let (node, share) = places[axis];
                if corner >> axis & 1 == 1 { (node + 1, share) } else { (node, 1.0 - share) }
            });
            let value = self.values[(i.0 * self.theta_o.len() + o.0) * self.phi.len() + p.0];
            let share = i.1 * o.1 * p.1 * self.theta_o[o.0].to_radians().cos();
            (0..3).for_each(|c| sum[c] += share * value[c]);
        }
        sum
    }
}

/// A direction at θ and at φ from the x axis, degrees.
pub(super) fn direction(theta: f64, phi: f64) -> Direction {
    let (sin, cos) = theta.to_radians().sin_cos();
    // Cosines keep their sign where they are nearly none.
    let (y, x) = phi.to_radians().sin_cos();
    [sin * x, sin * y, cos]
}

pub(super) fn steps(ranges: &[[f64; 3]]) -> Vec<f64> {
    let range = |[from, to, step]: &[f64; 3]| {
        let (from, step) = (*from, *step);
        (0..((to - from) / step).round() as usize).map(move |k| from + step * k as f64)
    };
    ranges.iter().flat_map(range).collect()
}

/// Between which nodes an angle is, and how far from the first.
pub(super) fn place(nodes: &[f64], at: f64) -> (usize, f64) {
    let node = nodes.partition_point(|node| *node <= at).clamp(1, nodes.len() - 1) - 1;
    (node, ((at - nodes[node]) / (nodes[node + 1] - nodes[node])).clamp(0.0, 1.0))
}

/// What is nearer to a node than to others.
fn cell(nodes: &[f64], at: usize, end: f64) -> [f64; 2] {
    let low = if at == 0 { nodes[0] } else { 0.5 * (nodes[at - 1] + nodes[at]) };
    [low, nodes.get(at + 1).map_or(end, |next| 0.5 * (nodes[at] + next))]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn angles_are_read_between_their_nodes_and_solid_angles_fill_the_hemisphere() {
        let [theta_i, theta_o, phi] = [steps(&THETA_I_DEG), steps(&THETA_O_DEG), steps(&PHI_DEG)];
        assert_eq!((theta_i[1], theta_i[24], theta_i.last()), (2.5, 60.0, Some(&89.0)));
        assert_eq!((phi.first(), phi.last()), (Some(&0.0), Some(&180.0)));
        let value = |i: f64, o: f64, p: f64| [1.0 + 0.1 * i, 2.0 + o, 3.0 - 0.01 * p];
        let mut values = Vec::new();
        for i in &theta_i {
            for o in &theta_o {
                let cos = o.to_radians().cos();
                values.extend(phi.iter().map(|p| value(*i, *o, *p).map(|x| x / cos)));
            }
        }
        let measured = Measured { theta_i, theta_o, phi, values };
        let (wi, wo) = (direction(31.3, 180.0), direction(41.7, -63.0));
        let (found, expected) = (measured.eval(wi, wo), value(31.3, 41.7, 63.0));
        assert!((0..3).all(|c| (found[c] - expected[c]).abs() < 1e-9), "{found:?} {expected:?}");
        let total: f64 = measured.rows().filter(|row| row.theta_i == 0.0).map(|row| row.solid_angle).sum();
        assert!((total - 2.0 * PI).abs() < 1e-9, "{total}");
    }
}
