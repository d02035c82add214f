//! Densities that are piecewise linear in cell position, and their distribution functions.

use super::{DENSITIES, Values};
use crate::numerics::angles::{greatest, least};
use lut_io::axis::ExitAxis;

/// What is sampled of one lobe, every incidence.
#[derive(Clone, Debug, Default)]
pub(crate) struct Distribution {
    /// Integral of the density u up to each cell centre of a row, \[incidence, φ row, column\].
    pub(crate) cumulative: Vec<f32>,
    /// Where to begin looking in it (`guide`).
    pub(crate) guide: Vec<u16>,
    /// Σ u of each row, \[incidence, φ row\].
    pub(crate) row_total: Vec<f32>,
    /// Integral of the rows' totals up to the centre of each φ row of an incidence.
    pub(crate) row_cumulative: Vec<f32>,
    /// Where to begin looking in it.
    pub(crate) row_guide: Vec<u16>,
}

/// Where the integral of a piecewise-linear density reaches its target: behind a position, with the densities there and at the
/// next one, and what is left of the target.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Found {
    pub(crate) base: f64,
    pub(crate) density: [f64; 2],
    pub(crate) rest: f64,
}

impl Distribution {
    /// Of interior (0) or rehit (1).
    pub(crate) fn new(axis: &ExitAxis, cells: &[Values], lobe: usize) -> Self {
        let mut this = Self::default();
        for of_incidence in cells.chunks(axis.cells()) {
            let mut totals = Vec::with_capacity(axis.rows_per_incidence());
            for row in of_incidence.chunks(axis.columns()) {
                let density: Vec<f64> =
                    row.iter().map(|values| f64::from(values[DENSITIES + lobe])).collect();
                totals.push(density.iter().sum());
                cumulate(&density, &mut this.cumulative, &mut this.guide);
            }
            cumulate(&totals, &mut this.row_cumulative, &mut this.row_guide);
            this.row_total.extend(totals.iter().map(|total| *total as f32));
        }
        this
    }
}

/// Integral up to each centre, and where to begin looking for a share of the total: centres surely below each of as many equal steps
/// as there are cells.
fn cumulate(density: &[f64], cumulative: &mut Vec<f32>, guide: &mut Vec<u16>) {
    let (from, cells) = (cumulative.len(), density.len());
    let mut sum = 0.5 * density[0];
    cumulative.push(sum as f32);
    for pair in density.windows(2) {
        sum += 0.5 * (pair[0] + pair[1]);
        cumulative.push(sum as f32);
    }
    let (total, mut above) = (f64::from(density.iter().sum::<f64>() as f32), 0);
    for step in 0..cells {
        // Short of the step by more than rounding.
        let target = total * (step as f64 - 1e-6) / cells as f64;
        while above < cells && f64::from(cumulative[from + above]) <= target {
            above += 1;
        }
        guide.push(u16::try_from(above).unwrap_or(u16::MAX));
    }
}

/// Where the integral of a piecewise-linear density reaches a share of its total.
///
/// The density is u\[k\] at position k + ½, linear between, constant in the outer half cells; `cumulative\[k\]` is its
/// integral up to position k + ½.
#[inline(always)]
pub(crate) fn find(
    density: impl Fn(usize) -> f64,
    cumulative: &[f32],
    guide: &[u16],
    total: f32,
    share: f64,
) -> Found {
    let last = cumulative.len() - 1;
    let target = share * f64::from(total);
    let reached = |k: usize| f64::from(cumulative[k]);
    // `partition_point`, from where the guide says.
    let step = (share * guide.len() as f64) as usize;
    let mut above = usize::from(guide[step.min(last)]);
    // One step without a branch, which random numbers would mispredict; more are fewer.
    above += usize::from(above <= last && reached(above) <= target);
    while above <= last && reached(above) <= target {
        above += 1;
    }
    let below = above.saturating_sub(1);
    let (base, reached) = if above == 0 { (0.0, 0.0) } else { (above as f64 - 0.5, reached(below)) };
    Found { base, density: [density(below), density(above.min(last))], rest: target - reached }
}

impl Found {
    /// The position.
    #[inline(always)]
    pub(crate) fn position(&self) -> f64 {
        let Self { base, density: [a, b], rest } = *self;
        // a·t + (b − a)·t²/2 = rest, in the form that does not cancel.
        let root = greatest(a * a + 2.0 * (b - a) * rest, 0.0).sqrt();
        base + if a + root > 0.0 { least(2.0 * rest / (a + root), 1.0) } else { 0.0 }
    }

    /// All four numbers.
    #[inline(always)]
    pub(crate) const fn parts(&self) -> [f64; 4] {
        let Self { base, density: [a, b], rest } = *self;
        [base, a, b, rest]
    }
}

/// Integral of such a density up to a position.
pub(crate) fn cumulative_at(density: impl Fn(usize) -> f64, cumulative: &[f32], position: f64) -> f64 {
    let last = cumulative.len() - 1;
    let from_first = position - 0.5;
    if from_first <= 0.0 {
        return position.max(0.0) * density(0);
    }
    let k = (from_first as usize).min(last);
    let t = from_first - k as f64;
    let next = density((k + 1).min(last));
    f64::from(cumulative[k]) + t * (density(k) + 0.5 * t * (next - density(k)))
}
