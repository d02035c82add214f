//! Exit directions by random numbers, and their densities.

mod lobes;
mod many;

use crate::Direction;
use crate::eval::{Evaluation, Pair, PearlBsdf, Viewer, above_horizon};
use crate::numerics::angles::{Polar, least, turned};
use crate::numerics::curve::Place;
use lobes::Exit;
use pulp::{Arch, Simd, WithSimd};

/// What is sampled, in the order of the probabilities: interior, rehit, facets of interface 0, base.
const INTERIOR: usize = 0;
const REHIT: usize = 1;
const SURFACE: usize = 2;
const BASE: usize = 3;

/// A sampled exit direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Exit direction.
    pub wo: Direction,
    /// Its probability density, 1/sr: what [`PearlBsdf::pdf`] says.
    pub pdf: f64,
    /// f·cos θo: what [`PearlBsdf::eval`] says.
    pub value: Evaluation,
}

impl PearlBsdf {
    /// An exit direction from three uniform numbers in [0, 1); `None` where nothing is reflected, or where the
    /// random numbers find no direction above the horizon (rarer than 1e-3).
    #[must_use]
    pub fn sample(&self, wi: Direction, u1: f64, u2: f64, u3: f64) -> Option<Sample> {
        Arch::new().dispatch(Sampled { pearl: self, wi: &wi, u: [u1, u2, u3] })
    }
}

/// [`PearlBsdf::sample`].
struct Sampled<'a> {
    pearl: &'a PearlBsdf,
    wi: &'a Direction,
    u: [f64; 3],
}

impl WithSimd for Sampled<'_> {
    type Output = Option<Sample>;

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) -> Option<Sample> {
        let Self { pearl, wi: &wi, u: [u1, u2, u3] } = self;
        if !above_horizon(wi) {
            return None;
        }
        let [polar] = Polar::of([wi]);
        let own = pearl.own();
        let incidence = own.band.lobes.incidence(&polar);
        let (part, select) = choose(&pearl.chances(Place::of_cos(wi[2])), u1);
        let wo = match part {
            SURFACE => own.band.facets.sample(wi, &polar, u2, u3),
            BASE => direction(polar.azimuth, &cosine_hemisphere(u2, u3)),
            _ => direction(polar.azimuth, &own.band.lobes.sample(part, &incidence, select, u2, u3)),
        };
        if !above_horizon(wo) {
            return None;
        }
        let [polar_o] = Polar::of([wo]);
        let geometry = own.geometry_at(&Pair::of(wi, wo, [polar, polar_o]), &incidence);
        let pdf = pearl.density(&geometry);
        if !(pdf > 0.0 && pdf.is_finite()) {
            return None;
        }
        Some(Sample { wo, pdf, value: pearl.value(&geometry, Viewer::AtExit) })
    }
}

/// The direction of an exit; its φ counts from the mirror direction of wi, whose own azimuth is given.
#[inline(always)]
fn direction((along, across): (f64, f64), exit: &Exit) -> Direction {
    let Exit { cos, sin, azimuth: (cos_phi, sin_phi) } = *exit;
    [sin * (-cos_phi * along - sin_phi * across), sin * (-cos_phi * across + sin_phi * along), cos]
}

#[inline(always)]
fn cosine_hemisphere(u: f64, v: f64) -> Exit {
    Exit { cos: (1.0 - u).sqrt(), sin: u.sqrt(), azimuth: turned(v) }
}

/// The part that u falls on, and what is left of the random number; of no chances at all, [`BASE`].
#[inline(always)]
fn choose(chances: &[f64; 4], u: f64) -> (usize, f64) {
    // Sums and no branches, which random numbers would mispredict. A part of no chance begins where the next one does.
    let from_rehit = chances[0];
    let from_surface = from_rehit + chances[1];
    let from_base = from_surface + chances[2];
    let at = u * (from_base + chances[3]);
    let (part, from, chance) = (INTERIOR, 0.0, chances[0]);
    let (part, from, chance) =
        if at >= from_rehit { (REHIT, from_rehit, chances[1]) } else { (part, from, chance) };
    let (part, from, chance) =
        if at >= from_surface { (SURFACE, from_surface, chances[2]) } else { (part, from, chance) };
    let (part, from, chance) =
        if at >= from_base { (BASE, from_base, chances[3]) } else { (part, from, chance) };
    (part, least((at - from) / chance, 1.0 - f64::EPSILON))
}
