//! Means over irregular stacks: R and T of an ensemble of thicknesses, with their standard error.

use rayon::prelude::*;

use crate::dense;
use crate::stack::{Stack, StackError};

/// Mean and standard error, rows of angles, each over the wavelengths; unpolarised light.
#[derive(Clone, Debug, PartialEq)]
pub struct EnsembleMean {
    /// Mean reflectance.
    pub reflectance: Vec<Vec<f64>>,
    /// Its standard error, 0 for a regular stack.
    pub reflectance_error: Vec<Vec<f64>>,
    /// Mean transmittance.
    pub transmittance: Vec<Vec<f64>>,
    /// Members drawn.
    pub members: u64,
}

/// Members of the first batch.
const FIRST_BATCH: u64 = 16;
/// Members at most.
pub const MOST_MEMBERS: u64 = 1 << 16;

/// Mean of `members` stacks drawn from `seed`; a regular stack is its own ensemble.
///
/// # Errors
/// As [`Stack::draw`] and [`dense::spectra`].
pub fn mean(
    stack: &Stack,
    seed: u64,
    members: u64,
    wavelengths: &[f64],
    angles: &[f64],
) -> Result<EnsembleMean, StackError> {
    let members = if stack.is_irregular() { members.clamp(1, MOST_MEMBERS) } else { 1 };
    let mut sums = Sums::new(wavelengths.len() * angles.len());
    sums.extend(stack, seed, 0..members, wavelengths, angles)?;
    Ok(sums.finish(wavelengths.len()))
}

/// As [`mean`], with as many members as bring the root mean square of the standard error below `accuracy` (in units of R).
///
/// # Errors
/// As [`mean`].
pub fn mean_to_accuracy(
    stack: &Stack,
    seed: u64,
    accuracy: f64,
    wavelengths: &[f64],
    angles: &[f64],
) -> Result<EnsembleMean, StackError> {
    if !stack.is_irregular() {
        return mean(stack, seed, 1, wavelengths, angles);
    }
    let mut sums = Sums::new(wavelengths.len() * angles.len());
    let mut next = FIRST_BATCH;
    loop {
        sums.extend(stack, seed, sums.members..next, wavelengths, angles)?;
        if sums.root_mean_square_error() <= accuracy || next >= MOST_MEMBERS {
            return Ok(sums.finish(wavelengths.len()));
        }
        next = (2 * next).min(MOST_MEMBERS);
    }
}

struct Sums {
    members: u64,
    r: Vec<f64>,
    r2: Vec<f64>,
    t: Vec<f64>,
}

impl Sums {
    fn new(size: usize) -> Self {
        Self { members: 0, r: vec![0.0; size], r2: vec![0.0; size], t: vec![0.0; size] }
    }

    /// Members are added in their order, so that the sums do not depend on the threads.
    fn extend(
        &mut self,
        stack: &Stack,
        seed: u64,
        members: std::ops::Range<u64>,
        wavelengths: &[f64],
        angles: &[f64],
    ) -> Result<(), StackError> {
        const BATCH: u64 = 16;
        let mut from = members.start;
        while from < members.end {
            let to = (from + BATCH).min(members.end);
            let batch: Vec<dense::Spectra> = (from..to)
                .into_par_iter()
                .map(|member| dense::spectra(&stack.draw(seed, member)?, wavelengths, angles))
                .collect::<Result<_, _>>()?;
            for spectra in &batch {
                for angle in 0..angles.len() {
                    let (r, t) =
                        (spectra.unpolarised_reflectance(angle), spectra.unpolarised_transmittance(angle));
                    for (i, (r, t)) in r.iter().zip(t).enumerate() {
                        let at = angle * wavelengths.len() + i;
                        self.r[at] += r;
                        self.r2[at] += r * r;
                        self.t[at] += t;
                    }
                }
            }
            from = to;
        }
        self.members = members.end;
        Ok(())
    }

    fn error(&self, at: usize) -> f64 {
        if self.members < 2 {
            return 0.0;
        }
        let n = self.members as f64;
        let mean = self.r[at] / n;
        ((self.r2[at] / n - mean * mean).max(0.0) / (n - 1.0)).sqrt()
    }

    fn root_mean_square_error(&self) -> f64 {
        let sum: f64 = (0..self.r.len()).map(|at| self.error(at).powi(2)).sum();
        (sum / self.r.len().max(1) as f64).sqrt()
    }

    fn finish(&self, width: usize) -> EnsembleMean {
        let n = self.members as f64;
        let rows = |values: Vec<f64>| values.chunks(width.max(1)).map(<[f64]>::to_vec).collect();
        EnsembleMean {
            reflectance: rows(self.r.iter().map(|sum| sum / n).collect()),
            reflectance_error: rows((0..self.r.len()).map(|at| self.error(at)).collect()),
            transmittance: rows(self.t.iter().map(|sum| sum / n).collect()),
            members: self.members,
        }
    }
}
