//! The table in memory: metadata and channels.

use super::both_sides::{self, Passage};
use super::dispersion::{self, Band};
pub use super::meta::{AzimuthMode, Meta, SCHEMA};
pub use super::summary::{
    Accuracy, Component, ComponentAccuracy, IncidenceSummary, Normals, SummaryErrors, SurfaceModel,
};
use crate::error::{FieldError, ensure};

/// What a table is made of. Every channel holds `per_incidence.len() · axis.cells()` values, incidence-major, then
/// (space tables) φ-major, columns last.
///
/// Values are f·cos θo in 1/sr. Decay tables store them in the plane of incidence over the signed exit
/// angle: cells with s > 0 are (θo = s, φ = 0), cells with s < 0 are (θo = −s, φ = 180°).
#[derive(Clone, Debug, PartialEq)]
pub struct Parts {
    /// Metadata.
    pub meta: Meta,
    /// The tabulated parts of the lobe, in the order of [`Component::ALL`].
    pub lobes: [Lobe; 3],
    /// f·cos θo of what passes and of light from below, by [`Passage`]; with the section [`both_sides`] of the metadata.
    pub passages: Option<[Vec<f32>; 3]>,
    /// The lobes at further wavelengths; with the section [`dispersion`] of the metadata.
    pub bands: Vec<[Lobe; 3]>,
}

/// A pearl table: whole and consistent since [`Table::new`]. Another table is made of its [`Parts`].
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    parts: Parts,
}

/// One component of the lobe with its uncertainty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lobe {
    /// f·cos θo, 1/sr.
    pub value: Vec<f32>,
    /// Standard error of `value`, 1/sr.
    pub std_error: Vec<f32>,
    /// Paths that ended in the cell (0 throughout for doubling).
    pub count: Vec<f32>,
}

impl Table {
    /// The table of these parts: what they promise each other is checked here, and what a reader may rely on.
    ///
    /// # Errors
    /// The first error found.
    pub fn new(parts: Parts) -> Result<Self, FieldError> {
        parts.meta.validate()?;
        Self::of_checked_meta(parts)
    }

    /// [`Table::new`] of metadata that were validated.
    pub(crate) fn of_checked_meta(parts: Parts) -> Result<Self, FieldError> {
        let Parts { meta, lobes, passages, bands } = &parts;
        let cells = meta.per_incidence.len() * meta.exit_axis.cells();
        for (component, lobe) in Component::ALL.iter().zip(lobes) {
            check_lobe(component.name(), lobe, cells)?;
        }
        let named = meta.dispersion.as_ref().map_or(0, |section| section.bands.len());
        ensure(dispersion::KEY, bands.len() == named, || {
            format!("names {named} further bands, but there are channels of {}", bands.len())
        })?;
        for (band, lobes) in bands.iter().enumerate() {
            for (component, lobe) in Component::ALL.iter().zip(lobes) {
                check_lobe(&dispersion::channel_name(component.name(), band), lobe, cells)?;
            }
        }
        ensure(both_sides::KEY, passages.is_some() == meta.both_sides.is_some(), || {
            "and the channels of light from below go together, found one without the other".to_owned()
        })?;
        for (passage, values) in Passage::ALL.iter().zip(passages.iter().flatten()) {
            check_channel(passage.name(), values, cells)?;
        }
        Ok(Self { parts })
    }

    /// The parts, to make another table of.
    #[must_use]
    pub fn into_parts(self) -> Parts {
        self.parts
    }

    /// Metadata.
    #[must_use]
    pub const fn meta(&self) -> &Meta {
        &self.parts.meta
    }

    /// The tabulated part of the lobe of that name.
    #[must_use]
    pub const fn lobe(&self, component: Component) -> &Lobe {
        &self.parts.lobes[component as usize]
    }

    /// f·cos θo of a passage, 1/sr in the medium that it leads into; `None` without the section [`both_sides`].
    #[must_use]
    pub fn passage(&self, passage: Passage) -> Option<&[f32]> {
        Some(&self.parts.passages.as_ref()?[passage as usize])
    }

    /// The lobes at further wavelengths, as [`dispersion::Dispersion::bands`] names them, each in the order of [`Component::ALL`].
    #[must_use]
    pub fn bands(&self) -> &[[Lobe; 3]] {
        &self.parts.bands
    }

    /// The lobes of the further bands, each as a table of its own, ascending in wavelength: what a bake of that wavelength
    /// alone holds. M of such a table is relative to that band's own R_incoherent.
    ///
    /// # Errors
    /// Colours or a reciprocal reading that do not fit a band.
    pub fn further_bands(&self) -> Result<Vec<Self>, FieldError> {
        let meta = self.meta();
        let bands = meta.dispersion.iter().flat_map(|section| &section.bands).zip(self.bands());
        let table = |(band, lobes): (&Band, &[Lobe; 3])| {
            let meta = Meta {
                wavelength_nm: band.wavelength_nm,
                solver_settings: band.solver_settings.clone(),
                accuracy: band.accuracy.clone(),
                surface_model: band.surface_model.clone(),
                per_incidence: band.per_incidence.clone(),
                both_sides: None,
                dispersion: None,
                spectra: meta.spectra.as_ref().map(|spectra| band.recoloured(spectra)).transpose()?,
                ..meta.clone()
            };
            Self::new(Parts { meta, lobes: lobes.clone(), passages: None, bands: Vec::new() })
        };
        bands.map(table).collect()
    }

    /// Angles of incidence, radians, ascending.
    #[must_use]
    pub fn theta_i(&self) -> Vec<f64> {
        self.meta().per_incidence.iter().map(|incidence| incidence.theta_i_deg.to_radians()).collect()
    }

    /// The part of a channel that belongs to the incidence of this index.
    #[must_use]
    pub fn at_incidence<'s>(&self, samples: &'s [f32], index: usize) -> &'s [f32] {
        let cells = self.meta().exit_axis.cells();
        &samples[index * cells..(index + 1) * cells]
    }
}

fn check_lobe(name: &str, lobe: &Lobe, cells: usize) -> Result<(), FieldError> {
    check_channel(name, &lobe.value, cells)?;
    check_channel(&format!("{name}_std_error"), &lobe.std_error, cells)?;
    check_channel(&format!("{name}_count"), &lobe.count, cells)
}

fn check_channel(name: &str, samples: &[f32], cells: usize) -> Result<(), FieldError> {
    let (field, found) = (format!("channel {name}"), samples.len());
    ensure(&field, found == cells, || {
        format!("holds {found} values, expected {cells} (incidences × cells)")
    })?;
    match samples.iter().position(|v| !(v.is_finite() && *v >= 0.0)) {
        None => Ok(()),
        Some(at) => {
            let problem = format!("is {} at cell {at}, expected a finite number ≥ 0", samples[at]);
            Err(FieldError::new(field, problem))
        }
    }
}
