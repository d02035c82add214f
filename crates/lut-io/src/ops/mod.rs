//! What is done with whole tables.

pub mod check;
pub mod diff;
mod explain;
pub mod fit;
mod moments;
pub mod reciprocity;
pub mod symmetrise;
