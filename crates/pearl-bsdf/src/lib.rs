#![doc = include_str!("../README.md")]
//!
//! # What is evaluated
//!
//! Directions are unit vectors in the local shading frame, z the outward normal, both pointing away from the
//! surface (Mitsuba's convention). `eval` includes cos θo; where either direction is at or below the horizon, or not of
//! unit length, it is 0.
//!
//! ```text
//! f  = brightness·lobe·[(1 − γ) + γ·M(θd)]·limit(θi)
//!    + ρ·(1 − A(θi))·(1 − A(θo)) / (π(1 − A_avg)) · [(1 − depth) + depth·Ê(θo)]·limit
//! lobe = mirror (closed form of interface 0, and what met it twice) + blur (the interior, tabulated)
//! ```
//!
//! A is the directional albedo of the first term per colour channel, A_avg its cosine-weighted mean. Two limits keep
//! the directional albedo at most 1 in every channel; both are 1 unless the light would not suffice:
//! - `limit(θi)` = 1/A before the limit, where that A exceeds 1;
//! - the base is divided by ρ·[(1 − depth) + depth·Ê(view)] where that exceeds 1, so that neither what it sends out in all nor
//!   what a viewer sees of a white surrounding is more than it receives.
//!
//! [`Prepared`] is a table made ready, once for all looks; [`PearlBsdf`] is a prepared table with [`Controls`]. Nothing is
//! allocated in `eval`, `pdf` and `sample`, nor in `eval_many`, `pdf_many` and `sample_many`, which answer for many pairs at a
//! call in about half the time a pair, with the same bits.
//!
//! # Modules
//!
//! - here: [`Prepared`], [`Controls`], [`PearlBsdf`], [`Sample`]; [`Prepared::arrays`] gives all that a renderer of other make has to
//!   gather from;
//! - [`export`]: the pearl in formats of other programs, each with its error; [`export::npz`] writes the arrays;
//! - [`measured`]: the adaptive parameterisation of measured materials, written and read; [`round_trip`]: how far a file is from the pearl;
//! - [`web`]: the evaluator in JavaScript and GLSL.
//!
//! The crate has no features to choose.
//!
//! # Errors
//!
//! A [`BsdfError`] is one line: a control out of its range, a control whose colours the table does not have, or what is wrong with the
//! table. Exports refuse with a [`lut_io::FieldError`]. Evaluation cannot fail: where there is no light it is 0.

mod controls;
mod eval;
pub mod export;
mod facets;
mod lobes;
pub mod measured;
mod numerics;
mod prepare;
pub mod round_trip;
mod sample;
pub mod web;

pub use controls::{BsdfError, Components, Controls};
pub use eval::{Evaluation, PearlBsdf};
pub use facets::MIN_SLOPE_SD;
pub use prepare::{Array, Prepared};
pub use sample::Sample;

/// A unit vector, or a linear sRGB triple where that is said.
pub type Direction = [f64; 3];

/// The direction of a vector of any length but 0; `None` for 0 and for what is not finite.
///
/// ```
/// assert_eq!(pearl_bsdf::unit([0.0, 0.0, 1e-300]), Some([0.0, 0.0, 1.0]));
/// assert_eq!(pearl_bsdf::unit([0.0, f64::NAN, 1.0]), None);
/// ```
#[must_use]
pub fn unit(v: [f64; 3]) -> Option<Direction> {
    // Scaled first, so that no square under- or overflows. (`max` passes over NaN.)
    let size = v.iter().fold(0.0, |most: f64, x| most.max(x.abs()));
    if size == 0.0 || v.iter().any(|x| !x.is_finite()) {
        return None;
    }
    let scaled = v.map(|x| x / size);
    let length = scaled.iter().map(|x| x * x).sum::<f64>().sqrt();
    Some(scaled.map(|x| x / length))
}
