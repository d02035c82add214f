//! Compact forms of a table: small files that a reader expands into an ordinary table (`docs/LUT-FORMAT.md` §11).
//!
//! [`Form::Analytic`] describes every lobe by an analytic reflection distribution, the exponential of a polynomial in the
//! cell position; [`Form::Half`] keeps cells, fewer and in half precision. Both drop what only statistics need (standard errors,
//! counts, coordinates) and pack their metadata. [`crate::fit`] makes them.

use super::analytic;
use crate::error::FieldError;
pub use crate::model::compaction::{
    COMPACT_SCHEMA, Compaction, DeltaE, Form, KEY, Loss, MAX_EXPANDED_CELLS, MAX_ORDER, MAX_TERMS, Term,
};
use crate::model::table::{Component, Lobe, Meta, Parts, SCHEMA, Table};

/// A table in compact form: what a compact file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Compact {
    meta: Meta,
    section: Compaction,
    samples: [Vec<f32>; 3],
}

impl Compact {
    /// The compact form of these metadata, which have the section [`KEY`], and of the image of each component, in the order of
    /// [`Component::ALL`].
    ///
    /// # Errors
    /// Metadata that are not valid or have no such section, or images of another size than it says.
    pub fn new(meta: Meta, samples: [Vec<f32>; 3]) -> Result<Self, FieldError> {
        meta.validate()?;
        Self::of_checked_meta(meta, samples)
    }

    /// [`Compact::new`] of metadata that were validated.
    pub(crate) fn of_checked_meta(meta: Meta, samples: [Vec<f32>; 3]) -> Result<Self, FieldError> {
        let section = section_of(&meta)?.clone();
        let (width, height) = image_size(&meta)?;
        for (component, samples) in Component::ALL.iter().zip(&samples) {
            if samples.len() != width * height {
                let problem = format!("holds {} values, expected {}", samples.len(), width * height);
                return Err(FieldError::new(format!("channel {}", component.name()), problem));
            }
        }
        Ok(Self { meta, section, samples })
    }

    /// Metadata of the expanded table, the section [`KEY`] among them.
    #[must_use]
    pub const fn meta(&self) -> &Meta {
        &self.meta
    }

    /// The section that says how to expand it.
    #[must_use]
    pub const fn section(&self) -> &Compaction {
        &self.section
    }

    /// The image of each component, in the order of [`Component::ALL`].
    #[must_use]
    pub const fn samples(&self) -> &[Vec<f32>; 3] {
        &self.samples
    }

    /// Its metadata and samples, to make another of.
    #[must_use]
    pub fn into_parts(self) -> (Meta, [Vec<f32>; 3]) {
        (self.meta, self.samples)
    }

    /// The ordinary table that this stands for. Standard errors and counts are not known: they are 0.
    ///
    /// # Errors
    /// A form that does not fit the metadata, or samples that make no table.
    pub fn expand(self) -> Result<Table, FieldError> {
        let Self { mut meta, section, samples } = self;
        let axis = meta.exit_axis;
        let lobes = std::array::from_fn(|component| {
            let samples = &samples[component];
            let value: Vec<f32> = match &section.form {
                Form::Analytic { terms } => samples
                    .chunks_exact(terms.len())
                    .flat_map(|row| analytic::values(&axis, terms, row))
                    .collect(),
                Form::Half { exponent } => samples
                    .chunks_exact(axis.cells())
                    .zip(exponent)
                    .flat_map(|(row, exponent)| {
                        let scale = 2f64.powi(exponent[component]);
                        row.iter().map(move |sample| (f64::from(*sample) * scale) as f32)
                    })
                    .collect(),
            };
            Lobe { std_error: vec![0.0; value.len()], count: vec![0.0; value.len()], value }
        });
        meta.schema = SCHEMA.to_owned();
        Table::of_checked_meta(Parts { meta, lobes, passages: None, bands: Vec::new() })
    }
}

/// Width and height of the image of a compact file.
///
/// # Errors
/// Metadata without the section [`KEY`].
pub(crate) fn image_size(meta: &Meta) -> Result<(usize, usize), FieldError> {
    let incidences = meta.per_incidence.len();
    Ok(match &section_of(meta)?.form {
        Form::Analytic { terms } => (terms.len(), incidences),
        Form::Half { .. } => (meta.exit_axis.columns(), incidences * meta.exit_axis.rows_per_incidence()),
    })
}

/// The section of metadata that must have one.
pub(crate) fn section_of(meta: &Meta) -> Result<&Compaction, FieldError> {
    let section = meta.compact.as_ref();
    section.ok_or_else(|| FieldError::new(KEY, format!("is missing, expected it in a {COMPACT_SCHEMA} file")))
}
