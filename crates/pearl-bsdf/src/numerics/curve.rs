//! The common grid of everything that depends on one angle: equal steps in u = √(1 − √cos θ).
//!
//! Near the normal u ≈ θ/2, so that what a table knows at every degree is resolved; near the horizon cos θ ≈ 4(1 − u)²,
//! so that albedos that fall off within a few σ are too. Two square roots a look-up, no arc cosine.

use crate::numerics::angles::{between, greatest, least};
use crate::numerics::quadrature::gauss_legendre;
use crate::numerics::single::step_of;

/// Steps of the grid.
pub(crate) const STEPS: usize = 1024;
/// Nodes of the grid.
pub(crate) const NODES: usize = STEPS + 1;

/// A curve by its values at the nodes; single precision keeps what a curve read linearly has.
pub(crate) type Curve = Box<[f32; NODES]>;

/// A curve from its values at a node.
pub(crate) fn curve(at: impl Fn(usize) -> f64) -> Curve {
    let mut curve = Box::new([0.0; NODES]);
    for (node, value) in curve.iter_mut().enumerate() {
        *value = at(node) as f32;
    }
    curve
}

/// Four curves, read together.
pub(crate) type Quads = Box<[[f32; 4]; NODES]>;

/// Curves from their values at a node.
pub(crate) fn quads(at: impl Fn(usize) -> [f64; 4]) -> Quads {
    let mut quads = Box::new([[0.0; 4]; NODES]);
    for (node, quad) in quads.iter_mut().enumerate() {
        *quad = at(node).map(|value| value as f32);
    }
    quads
}

/// Three numbers at every node.
pub(crate) fn triples(at: impl Fn(usize, usize) -> f64) -> Vec<[f64; 3]> {
    (0..NODES).map(|node| [0, 1, 2].map(|c| at(node, c))).collect()
}

/// A place between two nodes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) index: usize,
    pub(crate) fraction: f32,
}

impl Place {
    /// The place of an angle, by its cosine; clamped to [0, 1], a NaN to 0.
    #[inline(always)]
    pub(crate) fn of_cos(cos: f64) -> Self {
        let [place] = Self::of_cosines([cos]);
        place
    }

    /// The places of several angles, two for little more than the price of one.
    #[inline(always)]
    pub(crate) fn of_cosines<const N: usize>(cos: [f64; N]) -> [Self; N] {
        let u = cos.map(Self::steps_of_cos);
        let mut places = [Self { index: 0, fraction: 0.0 }; N];
        for (place, u) in places.iter_mut().zip(u) {
            let (index, fraction) = step_of(u, (STEPS - 1) as f32);
            *place = Self { index, fraction };
        }
        places
    }

    /// Steps of the grid up to the angle of a cosine.
    #[inline(always)]
    pub(crate) fn steps_of_cos(cos: f64) -> f32 {
        (1.0 - least(greatest(cos as f32, 0.0), 1.0).sqrt()).sqrt() * STEPS as f32
    }

    /// Four curves read here, linearly between their nodes.
    #[inline(always)]
    pub(crate) fn read4(self, curves: &Quads) -> [f32; 4] {
        let (a, b) = self.around(curves);
        between(a, b, self.fraction)
    }

    /// A curve read here.
    #[inline(always)]
    pub(crate) fn read(self, curve: &Curve) -> f64 {
        let (a, b) = self.around(curve);
        let (a, b) = (f64::from(*a), f64::from(*b));
        a + f64::from(self.fraction) * (b - a)
    }

    /// Values of the nodes in double precision, read here.
    pub(crate) fn mix(self, values: &[f64]) -> f64 {
        let (a, b) = (values[self.index], values[self.index + 1]);
        a + f64::from(self.fraction) * (b - a)
    }

    #[inline(always)]
    fn around<T>(self, curve: &[T; NODES]) -> (&T, &T) {
        // The mask says to the compiler what `of_cosines` keeps.
        let index = self.index & (STEPS - 1);
        (&curve[index], &curve[index + 1])
    }

    /// Adds a mass here to a histogram over the nodes, split linearly.
    pub(crate) fn deposit(self, mass: f64, histogram: &mut [f64]) {
        let fraction = f64::from(self.fraction);
        histogram[self.index] += (1.0 - fraction) * mass;
        histogram[self.index + 1] += fraction * mass;
    }

    /// Adds two masses here to two histograms side by side.
    #[inline(always)]
    pub(crate) fn deposit_each(self, masses: [f64; 2], histograms: &mut [[f64; 2]]) {
        let fraction = f64::from(self.fraction);
        let [here, next] = &mut histograms[self.index..self.index + 2] else { return };
        for k in 0..2 {
            here[k] += (1.0 - fraction) * masses[k];
            next[k] += fraction * masses[k];
        }
    }
}

/// cos θ of a node.
pub(crate) fn cos_at(node: usize) -> f64 {
    let u = node as f64 / STEPS as f64;
    ((1.0 - u) * (1.0 + u)).powi(2)
}

/// θ of a node, radians.
pub(crate) fn theta_at(node: usize) -> f64 {
    cos_at(node).acos()
}

/// Weights of the nodes for the cosine-weighted mean over the hemisphere, 2∫ y(μ)·μ dμ, of a curve as it is read.
pub(crate) fn mean_weights() -> Curve {
    // μ = (1 − u²)²: 2μ dμ = 8u(1 − u²)³ du up to its sign. Times a linear piece that is of the eighth degree,
    // for which five points are exact.
    let rule = gauss_legendre(5);
    let h = 1.0 / STEPS as f64;
    let mut weights = vec![0.0; NODES];
    for step in 0..STEPS {
        for (x, w) in &rule {
            let fraction = 0.5 * (1.0 + x);
            let u = h * (step as f64 + fraction);
            let mass = 0.5 * w * h * 8.0 * u * (1.0 - u * u).powi(3);
            weights[step] += (1.0 - fraction) * mass;
            weights[step + 1] += fraction * mass;
        }
    }
    curve(|node| weights[node])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_weighs_by_the_cosine() {
        let weights = mean_weights();
        let mean = |y: &dyn Fn(usize) -> f64| -> f64 {
            weights.iter().enumerate().map(|(node, weight)| f64::from(*weight) * y(node)).sum()
        };
        // Weights are single precision.
        assert!((mean(&|_| 1.0) - 1.0).abs() < 1e-7);
        // 2∫ μ·√(1 − √μ) dμ = ∫ u·8u(1 − u²)³ du = 8·16/315; u is read exactly.
        let mean = mean(&|i| i as f64 / STEPS as f64);
        assert!((mean - 128.0 / 315.0).abs() < 1e-7, "{mean}");
    }

    #[test]
    fn places_are_clamped_and_never_nan() {
        let ramp = quads(|i| [i as f64; 4]);
        for (cos, expected) in [(f64::NAN, 1024.0), (-1.0, 1024.0), (2.0, 0.0), (0.5625, 512.0)] {
            assert_eq!(Place::of_cos(cos).read4(&ramp), [expected; 4]);
        }
    }
}
