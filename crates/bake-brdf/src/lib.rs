#![doc = include_str!("../README.md")]
//!
//! # Modules
//!
//! - [`recipe`]: what a pearl is made of, and the built-in ones; [`options`]: what of it to bake, and how well;
//! - [`effects`]: which effects a table holds, with a reason for each; [`plan`]: what they cost;
//! - [`bake`]: the bake itself, forecasts, shards and checkpoints; [`tally`]: exits of a walk, in any order the same bits;
//! - [`spectra`]: the colours of interference; [`study`]: what accuracy costs in time.
//!
//! # Features
//!
//! - `cli`, on by default: the binary `bake-brdf` and what it needs of a terminal. The library is the same without it.
//!
//! # Errors
//!
//! Every error is one line that names the field, the value and what would be right: [`recipe::RecipeError`],
//! [`options::OptionError`], [`bake::BakeError`]. Nothing panics on bad input.

pub mod bake;
pub mod effects;
pub mod options;
pub mod plan;
mod prices;
pub mod recipe;
pub mod spectra;
pub mod study;
pub mod tally;

/// A number to three significant digits: an estimate of an error is good for no more.
pub(crate) fn three_digits(x: f64) -> f64 {
    format!("{x:.2e}").parse().unwrap_or(x)
}
