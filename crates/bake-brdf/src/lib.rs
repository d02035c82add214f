#![doc = include_str!("../README.md")]

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
