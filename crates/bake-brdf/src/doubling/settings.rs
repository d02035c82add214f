//! How finely the solver works, and what it refuses.

use super::facets::Sampling;
use super::grid::Grid;
use crate::transport::{Geometry, Transport};

/// Resolution of the solver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// N: nodes a hemisphere.
    pub nodes: usize,
    /// Azimuthal modes of the interior (space; the plane always has two parities).
    pub modes: usize,
    /// Facets beyond this many σ are left out.
    pub reach: f64,
    /// Density of the facet quadrature, 1 = every basis function resolved in full.
    pub density: f64,
}

/// Why the solver does not answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum DoublingError {
    /// A number outside its range.
    #[error("{field} = {value}: {expected}")]
    Domain {
        /// What the number is.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What would be right.
        expected: &'static str,
    },
}

impl Settings {
    pub(super) fn check(&self, transport: &Transport, _geometry: Geometry) -> Result<(), DoublingError> {
        let sigma = transport.facets.slope_sd;
        if !(sigma > 0.0) {
            return Err(DoublingError::Domain { field: "slope_sd", value: sigma, expected: "> 0" });
        }
        Ok(())
    }

    pub(super) fn modes_in(&self, geometry: Geometry) -> usize {
        match geometry {
            Geometry::Plane => 2,
            Geometry::Space => self.modes,
        }
    }

    pub(super) fn sampling(&self, grid: &Grid) -> Sampling {
        let mode = self.modes as f64;
        Sampling {
            reach: self.reach,
            degree: grid.polynomials() as f64,
            modes: [mode, mode],
            density: self.density,
        }
    }
}
