//! Recipe, plan, solvers and bake of the nacre light walk.

pub mod recipe;
pub mod tally;
pub mod transport;
pub mod walk;
