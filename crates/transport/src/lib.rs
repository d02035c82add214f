#![doc = include_str!("../README.md")]
//!
//! # Modules
//!
//! - here: [`Transport`] is the whole problem: indices, optical depths, facets at one wavelength;
//! - [`walk`] follows paths through it: [`walk::lanes`] many at once, [`walk::reference`] one at a time, to be read beside the paper;
//! - [`doubling`] solves it without random numbers, with an estimate of its error.
//!
//! None knows recipes, tables or files. The crate has no features to choose.
//!
//! # Errors
//!
//! [`walk::lanes::WalkError`] and [`doubling::DoublingError`] say in one line what a solver refuses: indices or facets out of range, or a
//! solution that would take more memory or time than there is. A doubling that does not reach its accuracy says what it reached.

pub mod doubling;
mod problem;
pub mod walk;

pub use problem::{Facets, Geometry, Light, Normals, Sheets, Transport};
