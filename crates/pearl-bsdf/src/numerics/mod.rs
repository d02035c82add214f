//! The arithmetic of evaluation: elementary functions without branches, grids and axes, many pairs side by side.

pub(crate) mod angles;
pub(crate) mod curve;
pub(crate) mod lanes;
pub(crate) mod normal;
pub(crate) mod quadrature;
pub(crate) mod single;
pub(crate) mod warp;
