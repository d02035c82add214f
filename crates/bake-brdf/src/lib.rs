#![doc = include_str!("../README.md")]

pub mod bake;
pub mod effects;
pub mod options;
pub mod plan;
mod prices;
pub mod recipe;
pub mod scene;
pub mod spectra;
pub mod study;
pub mod tally;
