//! Who solved the transport problem, and with what settings.

use crate::error::{FieldError, check};
use serde::{Deserialize, Serialize};

/// Key of the settings in the metadata.
const KEY: &str = "solver_settings";

/// Which solver made a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Solver {
    /// Monte Carlo walk: errors are standard errors.
    Walk,
    /// Adding and doubling: errors are the difference of two resolutions.
    Doubling,
}

/// What is worth knowing of a solver's settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields, expecting = "are not those of a solver of this version")]
pub enum SolverSettings {
    /// Of a walk.
    Walk(Walk),
    /// Of doubling.
    Doubling(Doubling),
    /// Smooth interfaces need no resolution: [`Solver::Doubling`] has their closed form.
    Smooth {
        /// The closed form.
        closed_form: ClosedForm,
        /// How `accuracy.rows_percent` is known.
        interpolation: Interpolation,
    },
    /// No effect asks for a lobe: there is nothing to solve. Counts as [`Solver::Doubling`].
    Dark {
        /// How `accuracy.rows_percent` is known.
        interpolation: Interpolation,
        /// The lobe that is not there.
        lobe: NoLobe,
    },
}

/// Settings of a walk.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Walk {
    /// Crossings of interfaces over all paths of this wavelength.
    pub crossings: u64,
    /// What a path adds to its cell.
    pub estimator: Estimator,
    /// Most events of a path.
    pub event_cap: u32,
    /// How `accuracy.rows_percent` is known.
    pub interpolation: Interpolation,
    /// Arithmetic of the geometry.
    pub precision: Precision,
    /// Time that the bake was given, seconds; the table holds the paths walked in it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub time_budget_seconds: Option<f64>,
}

/// Settings of doubling.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Doubling {
    /// Density of the facet quadrature; 1 resolves every basis function in full.
    pub density: f64,
    /// How `accuracy.rows_percent` is known.
    pub interpolation: Interpolation,
    /// Azimuthal modes of the interior.
    pub modes: usize,
    /// Nodes a hemisphere and medium.
    pub nodes: usize,
    /// Facets beyond this many σ are left out.
    pub reach: f64,
    /// How often it was made finer than the accuracy asked for takes, so that rows and cells keep it too.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub refinements: u32,
    /// How often it was made finer before it was solved, because lobes that were to place rows and cells were not accurate enough.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub raised: u32,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// What a path adds to its cell.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Estimator {
    /// Its weight, where it leaves.
    Analog,
}

/// Arithmetic of the walk's geometry.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Precision {
    /// Single precision.
    F32,
    /// Double precision.
    F64,
}

/// How the error of reading between incidences is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Interpolation {
    /// By solutions half-way between incidences.
    Measured,
    /// From second differences of the rows.
    Estimated,
}

/// A lobe that needs no solver.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ClosedForm {
    /// Every interface is a mirror.
    #[serde(rename = "smooth interfaces")]
    SmoothInterfaces,
}

/// No lobe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum NoLobe {
    /// None.
    None,
}

impl SolverSettings {
    /// The solver whose settings these are.
    #[must_use]
    pub const fn solver(&self) -> Solver {
        match self {
            Self::Walk(_) => Solver::Walk,
            Self::Doubling(_) | Self::Smooth { .. } | Self::Dark { .. } => Solver::Doubling,
        }
    }

    /// Checks that they are this solver's, and ranges.
    pub(super) fn validate(&self, solver: Solver) -> Result<(), FieldError> {
        if self.solver() != solver {
            let problem = format!("are not those of the solver {solver:?}").to_lowercase();
            return Err(FieldError::new(KEY, problem));
        }
        let numbers = match self {
            Self::Walk(walk) => [("time_budget_seconds", walk.time_budget_seconds.unwrap_or(0.0)), ("", 0.0)],
            Self::Doubling(doubling) => [("density", doubling.density), ("reach", doubling.reach)],
            Self::Smooth { .. } | Self::Dark { .. } => return Ok(()),
        };
        numbers.into_iter().try_for_each(|(name, value)| {
            check(name, value, value >= 0.0, "a number ≥ 0").map_err(|error| error.within(KEY))
        })
    }
}
