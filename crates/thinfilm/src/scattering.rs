//! Scattering matrices between two planes of one real reference admittance η, and their star product.
//!
//! With a real η every passive stack is contractive (|r| ≤ 1), whatever its layers do, so 1 − r′r never vanishes
//! except at a true resonance. N equal periods cost log₂ N products.

use num_complex::Complex64;

use crate::scaled::{Scaled, times_power_of_two};
use crate::wave::LayerMatrix;

/// Reflection from above and from below, and the transmission (equal both ways).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scattering {
    pub(crate) r: Complex64,
    pub(crate) r_back: Complex64,
    pub(crate) t: Scaled,
    pub(crate) reference: f64,
}

impl Scattering {
    /// `repeat` ≥ 1 periods of a unit; `None` for an empty unit or no repeat.
    pub(crate) fn of_run(unit: &[LayerMatrix], repeat: u64) -> Option<Self> {
        let reference = reference_admittance(unit);
        let period = unit
            .iter()
            .map(|layer| Self::of_layer(layer, reference))
            .reduce(|top, below| top.star(&below))?;
        period.repeated(repeat)
    }

    fn of_layer(layer: &LayerMatrix, reference: f64) -> Self {
        let i = Complex64::i();
        let (up, down) = (reference * layer.sin_over_q, layer.q_sin / reference);
        let t = 2.0 / (2.0 * layer.cos - i * (up + down));
        let r = -i * t * (up - down) / 2.0;
        let t = Scaled::new(t, -layer.exponent);
        Self { r, r_back: r, t, reference }
    }

    /// Redheffer's star product: `self` above `below`.
    fn star(&self, below: &Self) -> Self {
        let inner = 1.0 / (1.0 - self.r_back * below.r);
        let square =
            |t: Scaled, r: Complex64| times_power_of_two(t.mantissa * t.mantissa * r * inner, 2 * t.exponent);
        let t = self.t * below.t;
        Self {
            r: self.r + square(self.t, below.r),
            r_back: below.r_back + square(below.t, self.r_back),
            t: Scaled::new(t.mantissa * inner, t.exponent),
            reference: self.reference,
        }
    }

    fn repeated(self, repeat: u64) -> Option<Self> {
        let mut power = self;
        let mut rest = repeat;
        let mut product: Option<Self> = None;
        while rest > 0 {
            if rest & 1 == 1 {
                product = Some(product.map_or(power, |p| p.star(&power)));
            }
            rest >>= 1;
            if rest > 0 {
                power = power.star(&power);
            }
        }
        product
    }
}

/// A real η of the size of the layers' own admittances, |q|² = |q sin δ|/|sin δ/q|.
fn reference_admittance(unit: &[LayerMatrix]) -> f64 {
    let up: f64 = unit.iter().map(|layer| layer.q_sin.norm()).sum();
    let down: f64 = unit.iter().map(|layer| layer.sin_over_q.norm()).sum();
    let eta = (up / down).sqrt();
    if eta.is_normal() && (1e-30..1e30).contains(&eta) { eta } else { 1.0 }
}
