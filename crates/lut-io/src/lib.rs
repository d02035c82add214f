#![doc = include_str!("../README.md")]
//!
//! # Modules
//!
//! Each knows those before it alone:
//! - the table in memory: [`table`] with its metadata and their sections ([`solver`], [`spectra`], [`dispersion`], [`both_sides`],
//!   [`reciprocal`]); [`axis`] says which directions a row's cells cover, [`measure`] how much direction a cell stands for,
//!   [`decay`] is the azimuth postulate, [`limits`] bound what a file may claim;
//! - reading it: [`lobe`] at any pair of directions, [`profile`], [`slice`](mod@slice) and [`passage`] along a cut;
//! - the file: [`exr_file`], its small forms [`compact`], and [`atomic`] writing;
//! - what is done with tables: [`check`], [`diff`], [`fit`] to a compact form, [`reciprocity`], and [`symmetrise`] to a table that
//!   is the same both ways;
//! - beside them files of others: [`merl`] and [`tensor_file`].
//!
//! The crate has no features to choose.
//!
//! # Errors
//!
//! A [`FieldError`] names the field or channel, the value and what would be right; a [`LutError`] names the file as well, and tells bad
//! input from a failing machine. Files come from strangers: any bytes are read soundly or refused, and what a reader allocates is
//! bounded by [`limits`].

/// A small table for examples: the paper's pearl to 5 %, by doubling, as a compact file of `lut fit`.
pub const EXAMPLE: &[u8] = include_bytes!("../data/paper-coarse.exr");

pub mod error;
mod file;
mod formats;
mod model;
mod ops;
mod read;

pub use error::{FieldError, LutError};
pub use file::{atomic, compact, exr_file};
pub use formats::{merl, tensor_file};
pub use model::table::{Parts, Table};
pub use model::{axis, both_sides, decay, dispersion, limits, measure, reciprocal, solver, spectra, table};
pub use ops::{check, diff, fit, reciprocity, symmetrise};
pub use read::{lobe, monotone, passage, profile, slice};
