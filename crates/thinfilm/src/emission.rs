//! Light scattered inside the stack: the radiance that leaves at θo, by reciprocity
//! I(λ, θo) = (1/cos θo) ∫ s(z)·|E(z; θo)|² dz for a unit wave that enters from θo, or T(λ, θo) for sources below the stack.

use crate::stack::{Stack, StackError};
use crate::wave::WaveError;
use crate::{dense, ensemble};

/// Where the light is scattered.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum SourceProfile {
    /// Everywhere in the layers alike.
    #[default]
    Uniform,
    /// Falling as e^(−z/depth) from the first interface, its mean taken in each layer; depth in metres.
    Exponential {
        /// Depth of 1/e, metres.
        depth: f64,
    },
    /// Below the stack.
    Substrate,
}

/// I(λ, θo) for unpolarised light, rows of angles (radians), each over the wavelengths (metres), to 1e-9: the mean over `members`
/// stacks drawn from `seed` if the stack is irregular. With sources in the layers in units of length (source strength 1 at the
/// top), with sources in the substrate T.
///
/// # Errors
/// As [`Stack::draw`] and [`dense::spectra`]; an angle of 90°, where radiance has no meaning; a depth that is not positive.
pub fn radiance(
    stack: &Stack,
    profile: SourceProfile,
    seed: u64,
    members: u64,
    wavelengths: &[f64],
    angles: &[f64],
) -> Result<Vec<Vec<f64>>, StackError> {
    let members = ensemble::count(stack, members);
    let mut mean = vec![vec![0.0; wavelengths.len()]; angles.len()];
    let of = |member: &Stack| of_member(dense::MEAN_TOLERANCE, member, profile, wavelengths, angles);
    ensemble::each_member(stack, seed, 0..members, of, |one| {
        for (mean, value) in mean.iter_mut().flatten().zip(one.iter().flatten()) {
            *mean += value / members as f64;
        }
    })?;
    Ok(mean)
}

pub(crate) fn of_member(
    tolerance: f64,
    stack: &Stack,
    profile: SourceProfile,
    wavelengths: &[f64],
    angles: &[f64],
) -> Result<Vec<Vec<f64>>, StackError> {
    if profile == SourceProfile::Substrate {
        let spectra = dense::spectra_for_means(tolerance, stack, wavelengths, angles, None)?;
        return Ok((0..angles.len()).map(|at| spectra.unpolarised_transmittance(at)).collect());
    }
    let sources = strengths(stack, profile)?;
    let spectra = dense::spectra_for_means(tolerance, stack, wavelengths, angles, Some(&sources))?;
    let row = |(at, theta): (usize, &f64)| {
        let cos = theta.cos();
        if cos < 1e-9 {
            return Err(WaveError::Unsuitable("radiance has no meaning at 90 deg".to_owned()).into());
        }
        Ok(spectra.unpolarised_emission(at).unwrap_or_default().iter().map(|e| e / cos).collect())
    };
    angles.iter().enumerate().map(row).collect()
}

fn strengths(stack: &Stack, profile: SourceProfile) -> Result<Vec<f64>, StackError> {
    stack.check()?;
    let most = crate::field::MOST_LISTED_LAYERS;
    if stack.layer_count() > u128::from(most) {
        return Err(WaveError::TooManyLayers { layers: stack.layer_count(), most }.into());
    }
    let SourceProfile::Exponential { depth } = profile else {
        return Ok(stack.layers().map(|_| 1.0).collect());
    };
    if !(depth.is_finite() && depth > 0.0) {
        let why = format!("the source depth is {depth} m; it must be positive");
        return Err(WaveError::Unsuitable(why).into());
    }
    let mut top = 0.0;
    let strength = |layer: crate::stack::StackLayer| {
        let x = layer.thickness / depth;
        let mean = if x > 1e-12 { -(-x).exp_m1() / x } else { 1.0 };
        let strength = (-top / depth).exp() * mean;
        top += layer.thickness;
        strength
    };
    Ok(stack.layers().map(strength).collect())
}
