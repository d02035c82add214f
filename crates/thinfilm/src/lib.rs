//! Multilayer thin-film interference and its colour.
#![doc = include_str!("conventions.md")]

pub mod material;

pub use material::{Dispersion, Material, MaterialError};
