//! What is done with whole tables.

pub mod check;
pub mod diff;
pub mod fit;
pub mod reciprocity;
pub mod symmetrise;
