//! Recipe, plan, solvers and bake of the nacre light walk.

pub mod doubling;
pub mod transport;
pub mod walk;
