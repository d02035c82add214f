#![doc = include_str!("../README.md")]
//!
//! [`Transport`] is the whole problem: indices, optical depths, facets at one wavelength. [`walk`] follows paths through
//! it, [`doubling`] solves it without random numbers. Neither knows recipes, tables or files.

pub mod doubling;
mod problem;
pub mod walk;

pub use problem::{Facets, Geometry, Light, Normals, Sheets, Transport};
