//! Scattering matrices between two planes of one real reference admittance η, and their star product.
//!
//! With a real η every passive stack is contractive (|r| ≤ 1), whatever its layers do, so 1 − r′r never vanishes
//! except at a true resonance. N equal periods cost log₂ N products, which are done with twice the digits of f64: the
//! rounding of one period would come back N times.

use num_complex::Complex64;

use crate::precise::{Precise, PreciseComplex};
use crate::scaled::{Scaled, exponent_of};
use crate::wave::LayerMatrix;

/// Reflection from above and from below, and the transmission (equal both ways) without its power of two.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scattering {
    r: PreciseComplex,
    r_back: PreciseComplex,
    t: PreciseComplex,
    t_exponent: i64,
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

    /// Reflection from above.
    pub(crate) fn r(&self) -> Complex64 {
        self.r.into()
    }

    /// Reflection from below.
    pub(crate) fn r_back(&self) -> Complex64 {
        self.r_back.into()
    }

    pub(crate) fn t(&self) -> Scaled {
        Scaled::new(self.t.into(), self.t_exponent)
    }

    fn of_layer(layer: &LayerMatrix, reference: f64) -> Self {
        let [cos, sin_over_q, q_sin] = layer.precise();
        let reference_is = PreciseComplex::from(Complex64::new(reference, 0.0));
        let (up, down) = (reference_is * sin_over_q, q_sin / reference_is);
        let two = PreciseComplex::from(Complex64::new(2.0, 0.0));
        let t = two / (two * cos - (up + down).times_i());
        let r = (t * (down - up)).times_i().scaled(0.5);
        Self { r, r_back: r, t, t_exponent: -layer.exponent, reference }.normalised()
    }

    /// Redheffer's star product: `self` above `below`.
    fn star(&self, below: &Self) -> Self {
        let one = PreciseComplex::from(Complex64::new(1.0, 0.0));
        let inner = one / (one - self.r_back * below.r);
        let square = |by: &Self, r: PreciseComplex| {
            let power = 2f64.powi(by.t_exponent.clamp(-1022, 1022) as i32);
            (by.t * by.t * r * inner).scaled(power).scaled(power)
        };
        Self {
            r: self.r + square(self, below.r),
            r_back: below.r_back + square(below, self.r_back),
            t: self.t * below.t * inner,
            t_exponent: self.t_exponent + below.t_exponent,
            reference: self.reference,
        }
        .normalised()
    }

    /// Brings the larger part of t into [1, 2).
    fn normalised(self) -> Self {
        let part = |x: Precise| x.hi.abs();
        let Some(shift) = exponent_of(part(self.t.re).max(part(self.t.im))) else {
            return Self { t_exponent: 0, ..self };
        };
        // In two steps: 2^-shift alone may be beyond f64.
        let half = shift / 2;
        let t = self.t.scaled(2f64.powi(-half as i32)).scaled(2f64.powi((half - shift) as i32));
        Self { t, t_exponent: self.t_exponent + shift, ..self }
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
