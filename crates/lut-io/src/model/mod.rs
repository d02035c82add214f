//! The table itself: axes and what their cells stand for, metadata with their sections, channels, validation.

pub mod axis;
pub mod both_sides;
pub(crate) mod compaction;
pub mod decay;
pub mod dispersion;
pub mod limits;
pub mod measure;
pub(crate) mod meta;
pub mod reciprocal;
pub mod solver;
pub mod spectra;
mod summary;
pub mod table;
