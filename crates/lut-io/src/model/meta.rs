//! The metadata of a table: what its text attribute holds.

use super::axis::ExitAxis;
use super::both_sides::{self, BothSides};
use super::compaction::{self, Compaction};
use super::dispersion::{self, Dispersion};
use super::reciprocal::{self, Reciprocal};
use super::solver::{Solver, SolverSettings};
use super::spectra::{self, Missing, Spectra};
use super::summary::{Accuracy, IncidenceSummary, SurfaceModel, check_incidences};
use crate::error::{FieldError, check, ensure};
use serde::{Deserialize, Serialize};

/// Schema name this crate writes; a reader refuses a newer major version.
pub const SCHEMA: &str = "pearl-lut/1";

/// How the azimuth of the lobe is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AzimuthMode {
    /// Plane lobe, spread out of the plane by the postulate of [`crate::decay`].
    Decay,
    /// (θo, φ) from transport in space, no postulate.
    Space,
}

/// Everything in the `pearl` attribute of the file. Field order is the order in the JSON text. Unknown keys are refused: every
/// section changes what the others mean, so that a reader that passes over one reads another table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Meta {
    /// [`SCHEMA`].
    pub schema: String,
    /// `crate name version` of the writer.
    pub writer: String,
    /// The full recipe as baked, every default filled in. This crate does not look inside.
    pub recipe: serde_json::Value,
    /// Seed of the walk.
    pub seed: u64,
    /// Solver and its settings.
    pub solver: Solver,
    /// What is worth knowing of its settings.
    pub solver_settings: SolverSettings,
    /// Azimuth mode.
    pub azimuth: AzimuthMode,
    /// Vacuum wavelength of the transport problem, nm.
    pub wavelength_nm: f64,
    /// Accuracy asked and reached.
    pub accuracy: Accuracy,
    /// Exit cells; widths in radians.
    pub exit_axis: ExitAxis,
    /// Interface 0, for the closed-form surface lobe.
    pub surface_model: SurfaceModel,
    /// Names of the effects that are in the table (`docs/EFFECTS.md`).
    pub effects: Vec<String>,
    /// One summary per θi, ascending in θi.
    pub per_incidence: Vec<IncidenceSummary>,
    /// Light that passes and light from below.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub both_sides: Option<BothSides>,
    /// Of a table from a compact file: its form, and what that lost.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub compact: Option<Compaction>,
    /// Names what the bake of this table holds: equal for equal tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub content_hash: Option<String>,
    /// Lobes at further wavelengths.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub dispersion: Option<Dispersion>,
    /// The table is read at the larger of its two angles, and is the same both ways.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub reciprocal: Option<Reciprocal>,
    /// Interference colours.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spectra: Option<Spectra>,
    /// Interference colours that the recipe's look calls for and the stack does not have.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub spectra_missing: Option<Missing>,
}

impl Meta {
    /// Name of the recipe, if it has one.
    #[must_use]
    pub fn recipe_name(&self) -> Option<&str> {
        #[derive(Deserialize)]
        struct Named<'a> {
            name: &'a str,
        }
        Named::deserialize(&self.recipe).ok().map(|recipe| recipe.name)
    }

    /// Checks everything the metadata promise by themselves: schema, axis, incidences, ranges, sections.
    ///
    /// # Errors
    /// The first error found.
    pub(crate) fn validate(&self) -> Result<(), FieldError> {
        check_schema(&self.schema)?;
        self.check_axis()?;
        check_incidences(&self.exit_axis, &self.per_incidence)?;
        check("wavelength_nm", self.wavelength_nm, self.wavelength_nm > 0.0, "a positive number")?;
        self.surface_model.validate()?;
        self.accuracy.validate()?;
        self.solver_settings.validate(self.solver)?;
        self.check_sections()
    }

    fn check_sections(&self) -> Result<(), FieldError> {
        let (axis, rows) = (&self.exit_axis, self.per_incidence.as_slice());
        let within = |key: &'static str| move |error: FieldError| error.within(key);
        if let Some(section) = &self.both_sides {
            section.validate(axis, rows).map_err(within(both_sides::KEY))?;
        }
        if let Some(section) = &self.compact {
            section.validate(axis, rows).map_err(within(compaction::KEY))?;
            self.check_single_lobe()?;
        }
        if let Some(section) = &self.dispersion {
            let own = (self.wavelength_nm, self.solver);
            section.validate(own, axis, rows).map_err(within(dispersion::KEY))?;
        }
        if let Some(section) = &self.reciprocal {
            section.validate(rows).map_err(within(reciprocal::KEY))?;
        }
        if let Some(section) = &self.spectra {
            section.validate().map_err(within(spectra::KEY))?;
        }
        Ok(())
    }

    /// Checks that there is one lobe, from above: what a compact form can hold.
    pub(crate) fn check_single_lobe(&self) -> Result<(), FieldError> {
        for (key, there) in
            [(both_sides::KEY, self.both_sides.is_some()), (dispersion::KEY, self.dispersion.is_some())]
        {
            ensure(key, !there, || {
                "has no place in a compact file, which holds one lobe from above".to_owned()
            })?;
        }
        Ok(())
    }

    fn check_axis(&self) -> Result<(), FieldError> {
        let fits = matches!(
            (self.azimuth, &self.exit_axis),
            (AzimuthMode::Decay, ExitAxis::Plane { .. }) | (AzimuthMode::Space, ExitAxis::Space { .. })
        );
        ensure("exit_axis.kind", fits, || {
            format!("does not fit azimuth {:?}: decay goes with plane, space with space", self.azimuth)
        })?;
        self.exit_axis.validate()
    }
}

pub(crate) fn check_schema(schema: &str) -> Result<(), FieldError> {
    if schema == SCHEMA || schema.strip_prefix(SCHEMA).is_some_and(|minor| minor.starts_with('.')) {
        return Ok(());
    }
    let newer = schema.strip_prefix("pearl-lut/").and_then(|v| v.split('.').next()?.parse::<u64>().ok());
    let advice = match newer {
        Some(major) if major > 1 => "the file was written by a newer version, this program reads",
        _ => "expected",
    };
    Err(FieldError::new("schema", format!("is {schema:?}; {advice} {SCHEMA}")))
}
