//! A table in compact form: its lobes fitted by the analytic distribution, or fewer cells in half precision.

mod analytic;
mod rounding;
mod thin;

use crate::error::FieldError;
use crate::file::compact::Compact;
use crate::model::compaction::{COMPACT_SCHEMA, Compaction, DeltaE, Form, Loss, Term, check_terms};
use crate::model::table::{Component, Table};
use crate::ops::diff::Difference;
pub use analytic::terms;
pub use thin::{resampled, thinned};

/// Samples of [`Form::Half`] have their peak between 2^(this − 1) and 2^this: far from both ends of half precision.
const HALF_PEAK_EXPONENT: i32 = 15;
/// Significant digits of the interference colours: what a form saves elsewhere must not be spent on digits.
const ANALYTIC_BAND_DIGITS: usize = 3;
const HALF_BAND_DIGITS: usize = 4;

/// The table in half precision, cells as they are.
///
/// # Errors
/// A table that is too large, or that holds light from below or lobes at further wavelengths.
pub fn halved(table: &Table, source_bytes: u64) -> Result<Compact, FieldError> {
    let cells = table.meta().exit_axis.cells();
    let mut exponent = vec![[0; 3]; table.meta().per_incidence.len()];
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
    check_terms(&terms, &table.meta().exit_axis)?;
    let samples = Component::ALL.map(|name| analytic::fit(table, name, &terms));
    compact(table, Form::Analytic { terms }, samples, source_bytes)
}

fn compact(
    table: &Table,
    form: Form,
    samples: [Vec<f32>; 3],
    source_bytes: u64,
) -> Result<Compact, FieldError> {
    let digits = match form {
        Form::Analytic { .. } => ANALYTIC_BAND_DIGITS,
        Form::Half { .. } => HALF_BAND_DIGITS,
    };
    let mut meta = rounding::rounded(table.meta().clone(), digits);
    meta.schema = COMPACT_SCHEMA.to_owned();
    meta.compact = Some(Compaction { form, source_bytes, error: Loss::default() });
    Compact::new(meta, samples)
}

/// The compact form, stating what it lost against its table: what a reader is told of the accuracy includes it.
///
/// # Errors
/// Numbers that are not finite.
pub fn with_loss(
    compact: Compact,
    difference: &Difference,
    delta_e_2000: Option<DeltaE>,
) -> Result<Compact, FieldError> {
    let section = compact.section().clone();
    let (mut meta, samples) = compact.into_parts();
    let errors = difference.per_incidence.iter().map(|at| at.total_variation_percent);
    let error = Loss {
        total_variation_percent: difference.worst_total_variation_percent,
        mean_total_variation_percent: errors.sum::<f64>() / difference.per_incidence.len() as f64,
        delta_e_2000,
    };
    for at in &mut meta.per_incidence {
        let own = difference.per_incidence.iter().find(|other| other.theta_i_deg == at.theta_i_deg);
        at.accuracy_percent += own.map_or(0.0, |own| own.total_variation_percent);
    }
    meta.accuracy.reached_percent += error.total_variation_percent;
    meta.compact = Some(Compaction { error, ..section });
    Compact::new(meta, samples)
}
