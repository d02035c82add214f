//! The table between its nodes.

pub mod lobe;
pub mod monotone;
pub mod passage;
pub mod profile;
pub mod slice;
