//! Compact forms of a table: small files that a reader expands into an ordinary table (`docs/LUT-FORMAT.md` §11).
//!
//! [`Form::Analytic`] describes every lobe by an analytic reflection distribution, the exponential of a polynomial in the
//! cell position ([`analytic`]); [`Form::Half`] keeps cells, fewer and in half precision ([`thin`]). Both drop what only
//! statistics need (standard errors, counts, coordinates) and pack their metadata ([`packing`]).

pub mod analytic;
pub mod packing;
pub mod thin;

use crate::error::FieldError;
use crate::table::{Component, Lobe, Meta, SCHEMA, Table};
use analytic::Term;
use serde::{Deserialize, Serialize};

/// Key of the section in the metadata; it stays there in the expanded table.
pub const KEY: &str = "compact";
/// Schema of a compact file: readers of ordinary tables alone refuse its channels.
pub const COMPACT_SCHEMA: &str = "pearl-lut/1.1";
/// Most cells that a compact file may expand to: its own bytes do not vouch for them.
pub const MAX_EXPANDED_CELLS: usize = 1 << 21;
/// Samples of [`Form::Half`] have their peak between 2^(this − 1) and 2^this: far from both ends of half precision.
const HALF_PEAK_EXPONENT: i32 = 15;

/// How the samples of a compact file turn into values.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "lowercase", deny_unknown_fields)]
pub enum Form {
    /// Image rows are incidences, image columns coefficients: value = exp(Σ coefficient · term).
    Analytic {
        /// One term a coefficient.
        terms: Vec<Term>,
    },
    /// Rows and columns are those of a table: value = sample · 2^exponent.
    Half {
        /// Exponents of each incidence, in the order of [`Component::ALL`].
        exponent: Vec<[i32; 3]>,
    },
}

/// The section [`KEY`]: the form, and what it lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Section {
    /// How to expand it.
    pub form: Form,
    /// Size of the file that it was made from, bytes.
    pub source_bytes: u64,
    /// Distance from the table that it was made from.
    pub error: Loss,
}

/// How far a compact form is from its table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Loss {
    /// Largest total variation over the incidences of the table, per cent of the reflected light.
    pub total_variation_percent: f64,
    /// Its mean over them.
    pub mean_total_variation_percent: f64,
    /// ΔE00 of a preview: mean over the pixels of the pearl, 99th percentile, largest. `None` before it is known.
    pub delta_e_2000: Option<DeltaE>,
}

/// Colour differences of two pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DeltaE {
    /// Mean over the pixels.
    pub mean: f64,
    /// The value that one pixel in a hundred exceeds.
    pub percentile_99: f64,
    /// Largest of all pixels.
    pub largest: f64,
}

/// A table in compact form: what a compact file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Compact {
    /// Metadata of the expanded table, the section [`KEY`] among them.
    pub meta: Meta,
    /// The image of each component, in the order of [`Component::ALL`].
    pub samples: [Vec<f32>; 3],
}

impl Section {
    /// The section of metadata, if they have one.
    ///
    /// # Errors
    /// It is there and is not valid.
    pub fn of(meta: &Meta) -> Result<Option<Self>, FieldError> {
        meta.section(KEY)
    }

    /// Puts the section into metadata.
    ///
    /// # Errors
    /// A number that JSON cannot say.
    pub fn store(&self, meta: &mut Meta) -> Result<(), FieldError> {
        meta.put_section(KEY, self)
    }
}

impl Compact {
    /// The section that says how to expand it.
    ///
    /// # Errors
    /// It is missing, or does not fit the table's axes.
    pub fn section(&self) -> Result<Section, FieldError> {
        section_of(&self.meta)
    }

    /// The ordinary table that this stands for. Standard errors and counts are not known: they are 0.
    ///
    /// # Errors
    /// A form that does not fit the metadata, or samples that make no table.
    pub fn expand(self) -> Result<Table, FieldError> {
        let section = self.section()?;
        let incidences = self.meta.per_incidence.len();
        let axis = self.meta.exit_axis;
        let [interior, surface, rehit] = std::array::from_fn(|component| {
            let samples = &self.samples[component];
            match &section.form {
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
            }
        });
        let lobe = |value: Vec<f32>| Lobe {
            value,
            std_error: vec![0.0; incidences * axis.cells()],
            count: vec![0.0; incidences * axis.cells()],
        };
        let mut meta = self.meta;
        meta.schema = SCHEMA.to_owned();
        let table = Table {
            meta,
            interior: lobe(interior),
            surface: lobe(surface),
            rehit: lobe(rehit),
            passages: None,
            bands: Vec::new(),
        };
        table.validate()?;
        Ok(table)
    }
}

/// Width and height of the image of a compact file.
///
/// # Errors
/// As [`Compact::section`].
pub(crate) fn image_size(meta: &Meta) -> Result<(usize, usize), FieldError> {
    let incidences = meta.per_incidence.len();
    Ok(match section_of(meta)?.form {
        Form::Analytic { terms } => (terms.len(), incidences),
        Form::Half { .. } => (meta.exit_axis.columns(), incidences * meta.exit_axis.rows_per_incidence()),
    })
}

/// The valid section of metadata that must have one.
pub(crate) fn section_of(meta: &Meta) -> Result<Section, FieldError> {
    let section = Section::of(meta)?
        .ok_or_else(|| FieldError::new(KEY, format!("is missing, expected it in a {COMPACT_SCHEMA} file")))?;
    let incidences = meta.per_incidence.len();
    let cells = incidences.saturating_mul(meta.exit_axis.cells());
    if cells > MAX_EXPANDED_CELLS {
        let problem = format!("expands to {cells} cells, expected at most {MAX_EXPANDED_CELLS}");
        return Err(FieldError::new(KEY, problem));
    }
    match &section.form {
        Form::Analytic { terms } => analytic::check(terms, &meta.exit_axis)?,
        Form::Half { exponent } => {
            let field = format!("{KEY}.form.exponent");
            if exponent.len() != incidences {
                let problem = format!(
                    "has {} entries, expected one for each of the {incidences} incidences",
                    exponent.len()
                );
                return Err(FieldError::new(field, problem));
            }
            if let Some(wrong) = exponent.iter().flatten().find(|e| !(-200..=127).contains(*e)) {
                return Err(FieldError::new(field, format!("has {wrong}, expected -200 to 127")));
            }
        }
    }
    if meta.extra.contains_key(crate::both_sides::KEY) {
        return Err(FieldError::new(crate::both_sides::KEY, "has no place in a compact file"));
    }
    if meta.extra.contains_key(crate::dispersion::KEY) {
        return Err(FieldError::new(
            crate::dispersion::KEY,
            "has no place in a compact file, which holds one lobe; expected a table baked without the effect dispersion",
        ));
    }
    Ok(section)
}

/// The table in half precision, cells as they are.
///
/// # Errors
/// A table that is too large, or that holds light from below or lobes at further wavelengths.
pub fn halved(table: &Table, source_bytes: u64) -> Result<Compact, FieldError> {
    let cells = table.meta.exit_axis.cells();
    let mut exponent = vec![[0; 3]; table.meta.per_incidence.len()];
    let samples = std::array::from_fn(|component| {
        let values = &table.lobe(Component::ALL[component]).value;
        let mut samples = Vec::with_capacity(values.len());
        for (row, exponent) in values.chunks_exact(cells).zip(&mut exponent) {
            let peak = row.iter().copied().fold(0f32, f32::max);
            if peak > 0.0 {
                exponent[component] = f64::from(peak).log2().floor() as i32 + 1 - HALF_PEAK_EXPONENT;
            }
            let scale = 2f64.powi(-exponent[component]);
            samples.extend(row.iter().map(|value| (f64::from(*value) * scale) as f32));
        }
        samples
    });
    compact(table, Form::Half { exponent }, samples, source_bytes)
}

/// The table with its lobes fitted by the analytic distribution of these terms.
///
/// # Errors
/// As [`halved`], or terms that make no distribution.
pub fn fitted(table: &Table, terms: Vec<Term>, source_bytes: u64) -> Result<Compact, FieldError> {
    analytic::check(&terms, &table.meta.exit_axis)?;
    let samples = Component::ALL.map(|name| analytic::fit(table, name, &terms));
    compact(table, Form::Analytic { terms }, samples, source_bytes)
}

fn compact(
    table: &Table,
    form: Form,
    samples: [Vec<f32>; 3],
    source_bytes: u64,
) -> Result<Compact, FieldError> {
    let mut meta = table.meta.clone();
    meta.schema = COMPACT_SCHEMA.to_owned();
    Section { form, source_bytes, error: Loss::default() }.store(&mut meta)?;
    section_of(&meta)?;
    Ok(Compact { meta, samples })
}
