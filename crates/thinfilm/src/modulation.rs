//! What a BSDF reads: M(λ, θ) = R_coherent/R_incoherent and the emission Ê(λ, θo) with unit mean over wavelength.

use rayon::prelude::*;

use crate::emission::{self, SourceProfile};
use crate::ensemble;
use crate::intensity::{Light, incoherent};
use crate::stack::{Stack, StackError};

/// M(λ, θ) of a stack (the mean of `members` draws if it is irregular), rows of angles (radians), each over the
/// wavelengths (metres): the coherent reflectance over that of the same layers with their intensities added, unpolarised
/// at every interface, as a walk without tilt has it. 1 where nothing is reflected at all. Finite up to 90°.
///
/// # Errors
/// As [`ensemble::mean`] and [`incoherent`].
pub fn modulation(
    stack: &Stack,
    seed: u64,
    members: u64,
    wavelengths: &[f64],
    angles: &[f64],
) -> Result<Vec<Vec<f64>>, StackError> {
    let coherent = ensemble::mean(stack, seed, members, wavelengths, angles)?.reflectance;
    let row = |(theta, coherent): (&f64, Vec<f64>)| {
        let ratio = |(wavelength, r): (&f64, f64)| {
            let added = incoherent(stack, *wavelength, *theta, Light::Unpolarised)?.reflectance;
            Ok(if added > 0.0 { r / added } else { 1.0 })
        };
        wavelengths.iter().zip(coherent).map(ratio).collect()
    };
    angles.par_iter().zip(coherent).map(row).collect()
}

/// Ê(λ, θo): [`emission::radiance`], the mean of `members` draws, each row divided by its mean over the wavelengths, so
/// that the hue goes with the view and the brightness stays with the walk.
///
/// # Errors
/// As [`emission::radiance`].
pub fn emission(
    stack: &Stack,
    profile: SourceProfile,
    seed: u64,
    members: u64,
    wavelengths: &[f64],
    angles: &[f64],
) -> Result<Vec<Vec<f64>>, StackError> {
    let members = if stack.is_irregular() { members.max(1) } else { 1 };
    let mut sums = vec![vec![0.0; wavelengths.len()]; angles.len()];
    for member in 0..members {
        let emission = emission::radiance(&stack.draw(seed, member)?, profile, wavelengths, angles)?;
        for (sum, value) in sums.iter_mut().flatten().zip(emission.iter().flatten()) {
            *sum += value;
        }
    }
    for row in &mut sums {
        let mean = row.iter().sum::<f64>() / row.len().max(1) as f64;
        // Nothing comes out (total reflection): no hue.
        row.iter_mut().for_each(|x| *x = if mean > 0.0 { *x / mean } else { 1.0 });
    }
    Ok(sums)
}
