//! Section `compact`: how a compact file is expanded, and what it lost.

use super::axis::ExitAxis;
use super::summary::IncidenceSummary;
use crate::error::{FieldError, check, ensure};
use serde::{Deserialize, Serialize};

/// Key of the section in the metadata; it stays there in the expanded table.
pub const KEY: &str = "compact";
/// Schema of a compact file: readers of ordinary tables alone refuse its channels.
pub const COMPACT_SCHEMA: &str = "pearl-lut/1.1";
/// Most cells that a compact file may expand to: its own bytes do not vouch for them.
pub const MAX_EXPANDED_CELLS: usize = 1 << 21;
/// Most terms of a distribution.
pub const MAX_TERMS: usize = 512;
/// Largest order of a polynomial.
pub const MAX_ORDER: u16 = 255;

/// Orders (m, n) of one term T_m(x)·T_2n(y).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Term(pub u16, pub u16);

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
        /// Exponents of each incidence, in the order of [`crate::table::Component::ALL`].
        exponent: Vec<[i32; 3]>,
    },
}

/// The section [`KEY`]: the form, and what it lost.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Compaction {
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

impl Compaction {
    /// Checks the section of a table with this exit axis and these incidences.
    pub(super) fn validate(
        &self,
        axis: &ExitAxis,
        per_incidence: &[IncidenceSummary],
    ) -> Result<(), FieldError> {
        let incidences = per_incidence.len();
        let cells = incidences.saturating_mul(axis.cells());
        ensure("form", cells <= MAX_EXPANDED_CELLS, || {
            format!("expands to {cells} cells, expected at most {MAX_EXPANDED_CELLS}")
        })?;
        match &self.form {
            Form::Analytic { terms } => check_terms(terms, axis)?,
            Form::Half { exponent } => {
                let field = "form.exponent";
                let found = exponent.len();
                ensure(field, found == incidences, || {
                    format!("has {found} entries, expected one for each of the {incidences} incidences")
                })?;
                for e in exponent.iter().flatten() {
                    ensure(field, (-200..=127).contains(e), || format!("has {e}, expected -200 to 127"))?;
                }
            }
        }
        let Loss { total_variation_percent, mean_total_variation_percent, delta_e_2000 } = self.error;
        let DeltaE { mean, percentile_99, largest } = delta_e_2000.unwrap_or_default();
        let errors = [total_variation_percent, mean_total_variation_percent, mean, percentile_99, largest];
        for error in errors {
            check("error", error, error >= 0.0, "numbers ≥ 0")?;
        }
        Ok(())
    }
}

/// Checks terms that a file claims.
pub(crate) fn check_terms(terms: &[Term], axis: &ExitAxis) -> Result<(), FieldError> {
    let (field, count) = ("form.terms", terms.len());
    ensure(field, (1..=MAX_TERMS).contains(&count), || {
        format!("has {count} entries, expected 1 to {MAX_TERMS}")
    })?;
    ensure(field, terms[0] == Term(0, 0), || {
        "does not start with the constant, expected [0, 0] first".to_owned()
    })?;
    // Lobes in the plane have no azimuth.
    let most = if matches!(axis, ExitAxis::Plane { .. }) { 0 } else { MAX_ORDER };
    for Term(m, n) in terms {
        ensure(field, *m <= MAX_ORDER && *n <= most, || {
            format!("has [{m}, {n}], expected orders 0 to {MAX_ORDER} and 0 to {most}")
        })?;
    }
    Ok(())
}
