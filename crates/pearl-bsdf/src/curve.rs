//! The common grid of everything that depends on one angle: equal steps in u = √(1 − √cos θ).
//!
//! Near the normal u ≈ θ/2, so that what a table knows at every degree is resolved; near the horizon cos θ ≈ 4(1 − u)²,
//! so that albedos that fall off within a few σ are too. Two square roots a look-up, no arc cosine.

use crate::angles::{between, greatest, least};
use crate::quadrature::gauss_legendre;
use crate::single::step_of;

/// Steps of the grid.
pub(crate) const STEPS: usize = 1024;
/// Nodes of the grid.
pub(crate) const NODES: usize = STEPS + 1;

/// Four curves, read together; single precision keeps what a curve read linearly has.
pub(crate) type Quads = Box<[[f32; 4]; NODES]>;

/// Curves from their values at a node.
pub(crate) fn quads(at: impl Fn(usize) -> [f64; 4]) -> Quads {
    let mut quads = Box::new([[0.0; 4]; NODES]);
    for (node, quad) in quads.iter_mut().enumerate() {
        *quad = at(node).map(|value| value as f32);
    }
    quads
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
    pub(crate) fn read(self, curve: &[f64; NODES]) -> f64 {
        let (a, b) = self.around(curve);
        a + f64::from(self.fraction) * (b - a)
    }

    #[inline(always)]
    fn around<T>(self, curve: &[T; NODES]) -> (&T, &T) {
        // The mask says to the compiler what `of_cosines` keeps.
        let index = self.index & (STEPS - 1);
        (&curve[index], &curve[index + 1])
    }

    /// Adds a mass here to a histogram over the nodes, split linearly.
    pub(crate) fn deposit(self, mass: f64, histogram: &mut [f64; NODES]) {
        let fraction = f64::from(self.fraction);
        histogram[self.index] += (1.0 - fraction) * mass;
        histogram[self.index + 1] += fraction * mass;
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

/// 2∫ y(μ)·μ dμ of a curve as it is read: its cosine-weighted mean over the hemisphere.
pub(crate) fn hemispherical_mean(y: impl Fn(usize) -> f64) -> f64 {
    // μ = (1 − u²)²: 2μ dμ = 8u(1 − u²)³ du up to its sign. Times a linear piece that is of the eighth degree,
    // for which five points are exact.
    let rule = gauss_legendre(5);
    let h = 1.0 / STEPS as f64;
    let step = |i: usize| {
        let (a, b) = (y(i), y(i + 1));
        let at = |(x, w): &(f64, f64)| {
            let fraction = 0.5 * (1.0 + x);
            let u = h * (i as f64 + fraction);
            0.5 * w * h * (a + fraction * (b - a)) * 8.0 * u * (1.0 - u * u).powi(3)
        };
        rule.iter().map(at).sum::<f64>()
    };
    (0..STEPS).map(step).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hemispherical_mean_weights_by_the_cosine() {
        assert!((hemispherical_mean(|_| 1.0) - 1.0).abs() < 1e-14);
        // 2∫ μ·√(1 − √μ) dμ = ∫ u·8u(1 − u²)³ du = 8·16/315; u is read exactly.
        let mean = hemispherical_mean(|i| i as f64 / STEPS as f64);
        assert!((mean - 128.0 / 315.0).abs() < 1e-14, "{mean}");
    }

    #[test]
    fn places_are_clamped_and_never_nan() {
        let ramp = quads(|i| [i as f64; 4]);
        for (cos, expected) in [(f64::NAN, 1024.0), (-1.0, 1024.0), (2.0, 0.0), (0.5625, 512.0)] {
            assert_eq!(Place::of_cos(cos).read4(&ramp), [expected; 4]);
        }
    }
}
