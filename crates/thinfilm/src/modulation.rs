//! What a BSDF multiplies by: M(λ, θ) = R_coherent/R_incoherent its lobe, and the emission Ê(λ, θo) its base. As means over
//! bands of wavelengths and as linear sRGB.

use rayon::prelude::*;

use crate::colour::{self, Xyz};
use crate::emission::{self, SourceProfile};
use crate::stack::{Stack, StackError};
use crate::{dense, ensemble};

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
    /// Tristimulus values of the single wavelengths, not clipped.
    pub xyz: Xyz,
    /// Two standard errors of the colour by the members of an ensemble, ΔE00: 0 of a regular stack, `None` of one member of an irregular one.
    pub noise: Option<f64>,
    /// Change of the colour where every second wavelength is left out, ΔE00; `None` of an odd number of intervals.
    pub change: Option<f64>,
    /// ΔE00 between the colour and that of the bands, read linearly between their centres.
    pub between_bands: f64,
}

/// M at angles (radians): the coherent reflectance of unpolarised light over R_incoherent, one positive number an angle
/// ([`crate::intensity::incoherent`]). At most 1/R_incoherent, so that what is multiplied by it reflects no more than it receives.
///
/// # Errors
/// As [`Stack::draw`] and [`dense::spectra`].
pub fn modulation(
    stack: &Stack,
    incoherent: &[f64],
    angles: &[f64],
    sampling: Sampling,
) -> Result<Vec<Banded>, StackError> {
    let wavelengths = sampling.wavelengths();
    let coherent = Means::new(stack, sampling, angles.len(), |member| {
        let spectra = dense::spectra_for_means(member, &wavelengths, angles, None)?;
        Ok((0..angles.len()).map(|at| spectra.unpolarised_reflectance(at)).collect())
    })?;
    let row = |(at, incoherent): (usize, &f64)| sampling.banded(&coherent, at, *incoherent, 1.0 / incoherent);
    Ok(incoherent.par_iter().enumerate().map(row).collect())
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
    let wavelengths = sampling.wavelengths();
    let radiance = Means::new(stack, sampling, angles.len(), |member| {
        emission::of_member(member, profile, &wavelengths, angles)
    })?;
    let row = |at: usize| {
        let mean = sampling.band_means(&radiance.mean[at]).iter().sum::<f64>() / sampling.bands as f64;
        let unit = if mean > 0.0 { mean } else { 1.0 };
        sampling.banded(&radiance, at, unit, f64::INFINITY)
    };
    Ok((0..angles.len()).into_par_iter().map(row).collect())
}

/// Spectra of an ensemble.
struct Means {
    /// Their mean, rows of angles, each over the wavelengths.
    mean: Vec<Vec<f64>>,
    /// Colours of the members, rows of angles.
    colours: Vec<Vec<Xyz>>,
    /// Whether the stack is its own ensemble.
    is_irregular: bool,
}

impl Banded {
    /// What members and wavelengths leave open of the colour, ΔE00, as far as both are known. Of noise the change has one standard error:
    /// what exceeds two is of fringes that the wavelengths miss and all members share.
    #[must_use]
    pub fn sampling(&self) -> Option<f64> {
        self.noise.zip(self.change).map(|(noise, change)| noise.max(change))
    }
}

impl Means {
    /// Of the spectra of each member, rows of angles.
    fn new(
        stack: &Stack,
        sampling: Sampling,
        angles: usize,
        of_member: impl Fn(&Stack) -> Result<Vec<Vec<f64>>, StackError> + Sync,
    ) -> Result<Self, StackError> {
        let members = ensemble::count(stack, sampling.members);
        let share = 1.0 / members as f64;
        let mut means = Self {
            mean: vec![vec![0.0; sampling.bands * sampling.per_band + 1]; angles],
            colours: vec![Vec::new(); angles],
            is_irregular: stack.is_irregular(),
        };
        let of = |member: &Stack| -> Result<Vec<(Vec<f64>, Xyz)>, StackError> {
            let with_colour = |row: Vec<f64>| {
                let colour = colour::xyz(&row);
                (row, colour)
            };
            Ok(of_member(member)?.into_iter().map(with_colour).collect())
        };
        ensemble::each_member(stack, sampling.seed, 0..members, of, |rows| {
            for (at, (row, colour)) in rows.into_iter().enumerate() {
                for (mean, value) in means.mean[at].iter_mut().zip(row) {
                    *mean += share * value;
                }
                means.colours[at].push(colour);
            }
        })?;
        Ok(means)
    }

    /// [`Banded::noise`] at an angle, in some unit.
    fn noise(&self, at: usize, unit: f64) -> Option<f64> {
        let scaled = |xyz: &Xyz| xyz.map(|x| x / unit);
        let colours: Vec<Xyz> = self.colours[at].iter().map(scaled).collect();
        let mean = scaled(&colour::xyz(&self.mean[at]));
        colour::standard_error(&colours, mean, self.is_irregular).map(|error| 2.0 * error)
    }

    /// [`Banded::change`] at an angle, in some unit.
    fn change(&self, at: usize, unit: f64) -> Option<f64> {
        let row = &self.mean[at];
        // Both ends are among every second one.
        let every_second: Vec<f64> = row.iter().step_by(2).copied().collect();
        let lab = |row: &[f64]| colour::lab(colour::xyz(row).map(|x| x / unit));
        (row.len() > 2 && row.len() % 2 == 1).then(|| colour::delta_e_2000(lab(row), lab(&every_second)))
    }
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

    /// The mean at an angle in some unit, colours up to `most`.
    fn banded(&self, means: &Means, at: usize, unit: f64, most: f64) -> Banded {
        let values: Vec<f64> = means.mean[at].iter().map(|value| (value / unit).clamp(0.0, most)).collect();
        let white = colour::linear_srgb(colour::xyz(&vec![1.0; values.len()]));
        let xyz = colour::xyz(&values);
        let rgb = colour::linear_srgb(xyz);
        let bands = self.band_means(&values);
        let read = colour::xyz(&self.read_between(&bands));
        Banded {
            rgb: [0, 1, 2].map(|c| (rgb[c] / white[c]).clamp(0.0, most)),
            noise: means.noise(at, unit),
            change: means.change(at, unit),
            between_bands: colour::delta_e_2000(colour::lab(xyz), colour::lab(read)),
            bands,
            xyz,
        }
    }

    /// Bands at each wavelength: linearly between their centres, the outer ones beyond theirs.
    fn read_between(&self, bands: &[f64]) -> Vec<f64> {
        let at = |i: usize| {
            let position = (i as f64 / self.per_band as f64 - 0.5).clamp(0.0, (bands.len() - 1) as f64);
            let (band, t) = (position as usize, position.fract());
            (1.0 - t) * bands[band] + t * bands[(band + 1).min(bands.len() - 1)]
        };
        (0..=self.bands * self.per_band).map(at).collect()
    }
}
