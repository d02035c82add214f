//! Recipe, plan, solvers and bake of the nacre light walk.

pub mod bake;
pub mod doubling;
pub mod recipe;
pub mod study;
pub mod tally;
pub mod transport;
pub mod walk;
