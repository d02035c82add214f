//! Means over irregular stacks: R and T of an ensemble of thicknesses, with their standard error. Each member is right to 1e-9.

use rayon::prelude::*;

use crate::dense;
use crate::stack::{Stack, StackError};
use crate::wave::Polarisation;

/// Mean and standard error, rows of angles, each over the wavelengths.
#[derive(Clone, Debug, PartialEq)]
pub struct EnsembleMean {
    /// Mean reflectance.
    pub reflectance: Vec<Vec<f64>>,
    /// Its standard error: 0 for a regular stack, unknown of one member.
    pub reflectance_error: Option<Vec<Vec<f64>>>,
    /// Mean transmittance.
    pub transmittance: Vec<Vec<f64>>,
    /// Its standard error.
    pub transmittance_error: Option<Vec<Vec<f64>>>,
    /// Mean absorptance: exactly 0 for layers without absorption, negative only with gain.
    pub absorptance: Vec<Vec<f64>>,
    /// Members drawn.
    pub members: u64,
    /// Whether the accuracy that was asked for, if one was, is reached.
    pub converged: bool,
}

/// Members of the first batch.
const FIRST_BATCH: u64 = 16;
/// Members at most.
pub const MOST_MEMBERS: u64 = 1 << 16;

/// Mean of `members` stacks drawn from `seed`, unpolarised light; a regular stack is its own ensemble.
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
    let members = count(stack, members);
    let mut sums = Sums::new(wavelengths.len() * angles.len());
    sums.extend(stack, seed, 0..members, wavelengths, angles, None)?;
    Ok(sums.finish(wavelengths.len(), stack.is_irregular(), true))
}

/// How many members of an ensemble are drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Members {
    /// So many.
    Count(u64),
    /// As many as bring the root mean square of the standard error of R to this or below, and no fewer than its reciprocal: what one
    /// member in N does (a narrow resonance that most of them miss) fewer than N have not shown. 65,536 at most.
    ToAccuracy(f64),
}

/// As [`mean`], for one polarisation (`None`: unpolarised) and a number of members that may follow from an accuracy.
///
/// # Errors
/// As [`mean`].
pub fn mean_of(
    stack: &Stack,
    seed: u64,
    members: Members,
    wavelengths: &[f64],
    angles: &[f64],
    polarisation: Option<Polarisation>,
) -> Result<EnsembleMean, StackError> {
    let mut sums = Sums::new(wavelengths.len() * angles.len());
    let mut next = match members {
        Members::Count(members) => count(stack, members),
        Members::ToAccuracy(_) => count(stack, FIRST_BATCH),
    };
    let is_irregular = stack.is_irregular();
    loop {
        sums.extend(stack, seed, sums.members..next, wavelengths, angles, polarisation)?;
        let converged = match members {
            Members::ToAccuracy(accuracy) if is_irregular => {
                sums.root_mean_square_error() <= accuracy && next as f64 * accuracy >= 1.0
            }
            _ => true,
        };
        if converged || next >= MOST_MEMBERS {
            return Ok(sums.finish(wavelengths.len(), is_irregular, converged));
        }
        next = (2 * next).min(MOST_MEMBERS);
    }
}

/// Members that a stack has where so many are asked for: a regular stack is its own ensemble.
pub(crate) fn count(stack: &Stack, members: u64) -> u64 {
    if stack.is_irregular() { members.clamp(1, MOST_MEMBERS) } else { 1 }
}

/// Hands what `of` makes of each member to `add`, in the order of the members, so that sums do not depend on the threads.
pub(crate) fn each_member<T: Send>(
    stack: &Stack,
    seed: u64,
    members: std::ops::Range<u64>,
    of: impl Fn(&Stack) -> Result<T, StackError> + Sync,
    mut add: impl FnMut(T),
) -> Result<(), StackError> {
    const BATCH: u64 = 16;
    for from in members.clone().step_by(BATCH as usize) {
        let batch = (from..(from + BATCH).min(members.end)).into_par_iter();
        let batch: Vec<T> =
            batch.map(|member| of(&stack.draw(seed, member)?)).collect::<Result<_, StackError>>()?;
        batch.into_iter().for_each(&mut add);
    }
    Ok(())
}

struct Sums {
    members: u64,
    r: Vec<f64>,
    r2: Vec<f64>,
    t: Vec<f64>,
    t2: Vec<f64>,
    a: Vec<f64>,
}

impl Sums {
    fn new(size: usize) -> Self {
        let zeros = || vec![0.0; size];
        Self { members: 0, r: zeros(), r2: zeros(), t: zeros(), t2: zeros(), a: zeros() }
    }

    fn extend(
        &mut self,
        stack: &Stack,
        seed: u64,
        members: std::ops::Range<u64>,
        wavelengths: &[f64],
        angles: &[f64],
        polarisation: Option<Polarisation>,
    ) -> Result<(), StackError> {
        self.members = members.end;
        let of = |member: &Stack| {
            dense::spectra_for_means(dense::MEAN_TOLERANCE, member, wavelengths, angles, None)
        };
        each_member(stack, seed, members, of, |spectra| {
            for angle in 0..angles.len() {
                let (r, t, a) = match polarisation {
                    None => (
                        spectra.unpolarised_reflectance(angle),
                        spectra.unpolarised_transmittance(angle),
                        spectra.unpolarised_absorptance(angle),
                    ),
                    Some(pol) => (
                        spectra.reflectance(angle, pol).to_vec(),
                        spectra.transmittance(angle, pol).to_vec(),
                        spectra.absorptance(angle, pol),
                    ),
                };
                for (i, ((r, t), a)) in r.iter().zip(t).zip(a).enumerate() {
                    let at = angle * wavelengths.len() + i;
                    self.a[at] += a;
                    self.r[at] += r;
                    self.r2[at] += r * r;
                    self.t[at] += t;
                    self.t2[at] += t * t;
                }
            }
        })
    }

    /// Standard error of a mean, from the sum and the sum of squares.
    fn error(&self, sum: f64, squares: f64) -> f64 {
        let n = self.members as f64;
        let mean = sum / n;
        ((squares / n - mean * mean).max(0.0) / (n - 1.0)).sqrt()
    }

    fn errors(&self, sums: &[f64], squares: &[f64]) -> Vec<f64> {
        sums.iter().zip(squares).map(|(sum, squares)| self.error(*sum, *squares)).collect()
    }

    fn root_mean_square_error(&self) -> f64 {
        let sum: f64 = self.errors(&self.r, &self.r2).iter().map(|error| error * error).sum();
        (sum / self.r.len().max(1) as f64).sqrt()
    }

    fn finish(&self, width: usize, is_irregular: bool, converged: bool) -> EnsembleMean {
        let n = self.members as f64;
        let rows = |values: Vec<f64>| -> Vec<Vec<f64>> {
            values.chunks(width.max(1)).map(<[f64]>::to_vec).collect()
        };
        let errors = |sums: &[f64], squares: &[f64]| match self.members {
            0 | 1 if is_irregular => None,
            0 | 1 => Some(rows(vec![0.0; sums.len()])),
            _ => Some(rows(self.errors(sums, squares))),
        };
        EnsembleMean {
            reflectance: rows(self.r.iter().map(|sum| sum / n).collect()),
            reflectance_error: errors(&self.r, &self.r2),
            transmittance: rows(self.t.iter().map(|sum| sum / n).collect()),
            transmittance_error: errors(&self.t, &self.t2),
            absorptance: rows(self.a.iter().map(|sum| sum / n).collect()),
            members: self.members,
            converged,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;

    fn film() -> Stack {
        Stack::alternating(
            Material::constant(1.0),
            (Material::constant(1.53), 450e-9, 20e-9),
            (Material::constant(1.43), 25e-9, 1e-9),
            20,
            Material::constant(1.53),
        )
    }

    /// Many small ensembles scatter about a large one as each of them says.
    #[test]
    fn the_stated_error_is_the_scatter_of_ensembles() {
        let (wavelengths, angles) = ([500e-9, 600e-9], [0.2]);
        let whole = mean(&film(), 1_000, 20_000, &wavelengths, &angles).unwrap();
        let (mut scatter, mut stated) = (0.0, 0.0);
        for seed in 0..200 {
            let part = mean(&film(), seed, 32, &wavelengths, &angles).unwrap();
            for i in 0..2 {
                scatter += (part.reflectance[0][i] - whole.reflectance[0][i]).powi(2);
                stated += part.reflectance_error.as_ref().unwrap()[0][i].powi(2);
            }
        }
        // Variance of 400 values of two independent kinds: known to about 10 %; four of those.
        assert!((scatter / stated - 1.0).abs() < 0.4, "{}", scatter / stated);
    }

    #[test]
    fn an_accuracy_is_reached_and_polarisations_average_to_the_unpolarised() {
        let (wavelengths, angles) = ([450e-9, 550e-9, 650e-9], [0.0, 0.9]);
        let of = |members, pol| mean_of(&film(), 3, members, &wavelengths, &angles, pol).unwrap();
        let reached = of(Members::ToAccuracy(2e-3), None);
        let squares = reached.reflectance_error.iter().flatten().flatten().map(|e| e * e).sum::<f64>();
        assert!((squares / 6.0).sqrt() <= 2e-3 && reached.members >= 500 && reached.converged, "{reached:?}");
        let count = Members::Count(reached.members);
        let (s, p) = (of(count, Some(Polarisation::S)), of(count, Some(Polarisation::P)));
        for angle in 0..2 {
            for i in 0..3 {
                let mean = 0.5 * (s.reflectance[angle][i] + p.reflectance[angle][i]);
                assert!((mean - reached.reflectance[angle][i]).abs() < 1e-14);
            }
        }
    }

    #[test]
    fn an_error_that_is_not_known_is_none_and_an_accuracy_that_is_not_reached_is_told() {
        let of = |stack: &Stack, members| mean_of(stack, 1, members, &[500e-9], &[0.3], None).unwrap();
        let one = of(&film(), Members::Count(1));
        assert!(one.reflectance_error.is_none() && one.transmittance_error.is_none(), "{one:?}");
        assert!(of(&film(), Members::Count(2)).reflectance_error.unwrap()[0][0] > 0.0);
        let thin = Stack { runs: vec![crate::StackRun { repeat: 1, ..film().runs[0].clone() }], ..film() };
        let short = of(&thin, Members::ToAccuracy(1e-9));
        assert!(!short.converged && short.members == MOST_MEMBERS, "{short:?}");
        let regular = Stack { runs: film().draw(1, 0).unwrap().runs, ..film() };
        let exact = of(&regular, Members::ToAccuracy(1e-9));
        assert!(exact.converged && exact.members == 1 && exact.reflectance_error.unwrap() == [[0.0]]);
    }

    /// A cavity that a few members in a hundred have in tune: the first sixteen all reflect everything.
    #[test]
    fn a_resonance_that_few_members_meet_is_counted() {
        let quarter = |n: f64| 550e-9 / 4.0 / n;
        let layer =
            |material, thickness, thickness_sd| crate::StackLayer { material, thickness, thickness_sd };
        let run = |unit, repeat| crate::StackRun { unit, repeat };
        let (high, low) = (layer(0, quarter(2.3), 0.0), layer(1, quarter(1.46), 0.0));
        let filter = Stack {
            ambient: Material::constant(1.0),
            materials: vec![Material::constant(2.3), Material::constant(1.46)],
            runs: vec![
                run(vec![high, low], 7),
                run(vec![layer(0, 2.0 * quarter(2.3), 5e-9)], 1),
                run(vec![low, high], 7),
            ],
            substrate: Material::constant(1.0),
            gain: crate::Gain::Refused,
        };
        let of_seed = |seed, members| mean_of(&filter, seed, members, &[550e-9], &[0.0], None).unwrap();
        let misses = |seed: &u64| of_seed(*seed, Members::Count(16)).reflectance_error.unwrap()[0][0] < 1e-3;
        let seed = (0..100).find(misses).unwrap();
        let of = |members| of_seed(seed, members);
        let (few, all) = (of(Members::Count(16)), of(Members::Count(MOST_MEMBERS)));
        let found = of(Members::ToAccuracy(2e-3));
        let off = (found.transmittance[0][0] - all.transmittance[0][0]).abs();
        assert!(found.members >= 512 && off < 4.0 * 2e-3, "{found:?} {all:?}");
        assert!((few.transmittance[0][0] - all.transmittance[0][0]).abs() > 4e-3, "{all:?}");
    }
}
