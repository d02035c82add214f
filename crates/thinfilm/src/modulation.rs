//! What a BSDF multiplies by: M(λ, θ) = R_coherent/R_incoherent its lobe, and the emission Ê(λ, θo) its base. As means over
//! bands of wavelengths and as linear sRGB.

use rayon::prelude::*;

use crate::colour;
use crate::emission::{self, SourceProfile};
use crate::ensemble;
use crate::stack::{Stack, StackError};

/// How the spectra of a stack are sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Bands of equal width over [`colour::VISIBLE`].
    pub bands: usize,
    /// Wavelengths a band, 1 or more: fringes finer than their distance alias.
    pub per_band: usize,
    /// Members of the ensemble of an irregular stack.
    pub members: u64,
    /// Names that ensemble.
    pub seed: u64,
}

/// A spectrum at one angle.
#[derive(Clone, Debug, PartialEq)]
pub struct Banded {
    /// Mean in each band.
    pub bands: Vec<f64>,
    /// Linear sRGB of the single wavelengths, never negative; 1, 1, 1 for a spectrum that is 1 everywhere.
    pub rgb: [f64; 3],
}

/// M at angles (radians): the coherent reflectance of unpolarised light over R_incoherent, one positive number an angle
/// ([`crate::intensity::incoherent`]). At most 1/R_incoherent, so that what is multiplied by it reflects no more than it receives.
///
/// # Errors
/// As [`ensemble::mean`].
pub fn modulation(
    stack: &Stack,
    incoherent: &[f64],
    angles: &[f64],
    sampling: Sampling,
) -> Result<Vec<Banded>, StackError> {
    let Sampling { seed, members, .. } = sampling;
    let coherent = ensemble::mean(stack, seed, members, &sampling.wavelengths(), angles)?.reflectance;
    let row = |(coherent, incoherent): (Vec<f64>, &f64)| {
        let most = 1.0 / incoherent;
        let modulation: Vec<f64> = coherent.iter().map(|r| (r * most).clamp(0.0, most)).collect();
        sampling.banded(&modulation, most)
    };
    Ok(coherent.into_par_iter().zip(incoherent).map(row).collect())
}

/// Ê at angles (radians, below 90°): [`emission::radiance`] with unit mean over the bands, so that the hue goes with the view
/// and the brightness stays with the base. 1 where nothing comes out.
///
/// # Errors
/// As [`emission::radiance`].
pub fn emission(
    stack: &Stack,
    profile: SourceProfile,
    angles: &[f64],
    sampling: Sampling,
) -> Result<Vec<Banded>, StackError> {
    let Sampling { seed, members, .. } = sampling;
    let radiance = emission::radiance(stack, profile, seed, members, &sampling.wavelengths(), angles)?;
    let row = |radiance: Vec<f64>| {
        let mean = sampling.band_means(&radiance).iter().sum::<f64>() / sampling.bands as f64;
        let unit = |e: f64| if mean > 0.0 { e / mean } else { 1.0 };
        sampling.banded(&radiance.into_iter().map(unit).collect::<Vec<f64>>(), f64::INFINITY)
    };
    Ok(radiance.into_par_iter().map(row).collect())
}

impl Sampling {
    /// The edges of the bands among them.
    fn wavelengths(&self) -> Vec<f64> {
        colour::wavelengths(self.bands * self.per_band + 1)
    }

    /// Both edges of a band included (trapezoid rule).
    fn band_means(&self, values: &[f64]) -> Vec<f64> {
        let mean = |band: usize| {
            let inside = &values[band * self.per_band..=(band + 1) * self.per_band];
            let ends = 0.5 * (inside[0] + inside[self.per_band]);
            (ends + inside[1..self.per_band].iter().sum::<f64>()) / self.per_band as f64
        };
        (0..self.bands).map(mean).collect()
    }

    /// Colours up to `most`.
    fn banded(&self, values: &[f64], most: f64) -> Banded {
        let white = colour::linear_srgb(colour::xyz(&vec![1.0; values.len()]));
        let rgb = colour::linear_srgb(colour::xyz(values));
        Banded {
            bands: self.band_means(values),
            rgb: [0, 1, 2].map(|c| (rgb[c] / white[c]).clamp(0.0, most)),
        }
    }
}
