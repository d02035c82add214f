//! What a BSDF multiplies by: M(λ, θ) = R_coherent/R_incoherent its lobe, and the emission Ê(λ, θo) its base. As means over
//! bands of wavelengths and as linear sRGB.

use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};

use crate::colour::{self, Observer, Xyz};
use crate::emission::{self, SourceProfile};
use crate::stack::{Stack, StackError};
use crate::{dense, ensemble};

/// How the spectra of a stack are sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sampling {
    /// Bands of equal width over [`colour::VISIBLE`].
    pub bands: usize,
    /// Further bands of that width below and above it: a stack with all thicknesses times s shows at λ what it shows at λ/s
    /// ([`Scaled`]).
    pub beyond: [usize; 2],
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
    /// The single wavelengths, and tristimulus values at the smallest and the largest scale that they serve; empty without bands beyond
    /// the visible range.
    pub spectrum: Vec<f64>,
    /// See [`Self::spectrum`].
    pub ends: Vec<Xyz>,
}

/// What makes colours of a spectrum at a scale s of all thicknesses: Maxwell's equations have no length of their own, so that with indices
/// that do not depend on the wavelength a stack s times as thick shows at λ what the stack itself shows at λ/s.
#[derive(Clone, Debug)]
pub struct Scaled {
    /// The first wavelength that is seen.
    first: usize,
    /// Tristimulus weights of the wavelengths from there on.
    xyz: Vec<Xyz>,
    /// Linear sRGB of a spectrum of 1.
    white: [f64; 3],
}

/// M at angles (radians): the coherent reflectance of unpolarised light over R_incoherent, one positive number an angle
/// ([`crate::intensity::incoherent`]). At most 1/R_incoherent, so that what is multiplied by it reflects no more than it receives.
/// Stops soon after `stop` is set, from anywhere.
///
/// # Errors
/// As [`Stack::draw`] and [`dense::spectra`]; [`StackError::Stopped`].
pub fn modulation(
    stop: &AtomicBool,
    stack: &Stack,
    incoherent: &[f64],
    angles: &[f64],
    sampling: Sampling,
) -> Result<Vec<Banded>, StackError> {
    let wavelengths = sampling.wavelengths();
    let coherent = Means::new(stop, stack, sampling, angles.len(), |member| {
        let spectra = dense::spectra_for_means(tolerance(stack), member, &wavelengths, angles, None)?;
        Ok((0..angles.len()).map(|at| spectra.unpolarised_reflectance(at)).collect())
    })?;
    let ends = sampling.ends();
    let row = |(at, incoherent): (usize, &f64)| {
        sampling.banded(&coherent, &ends, at, *incoherent, 1.0 / incoherent)
    };
    Ok(incoherent.par_iter().enumerate().map(row).collect())
}

/// Ê at angles (radians, below 90°): [`emission::radiance`] with unit mean over the visible bands, so that the hue goes with the view
/// and the brightness stays with the base. 1 where nothing comes out. Stops soon after `stop` is set, from anywhere.
///
/// # Errors
/// As [`emission::radiance`]; [`StackError::Stopped`].
pub fn emission(
    stop: &AtomicBool,
    stack: &Stack,
    profile: SourceProfile,
    angles: &[f64],
    sampling: Sampling,
) -> Result<Vec<Banded>, StackError> {
    let wavelengths = sampling.wavelengths();
    let radiance = Means::new(stop, stack, sampling, angles.len(), |member| {
        emission::of_member(tolerance(stack), member, profile, &wavelengths, angles)
    })?;
    let ends = sampling.ends();
    let row = |at: usize| {
        let visible = sampling.visible(&radiance.mean[at]);
        let mean = sampling.band_means(visible).iter().sum::<f64>() / sampling.bands as f64;
        let unit = if mean > 0.0 { mean } else { 1.0 };
        sampling.banded(&radiance, &ends, at, unit, f64::INFINITY)
    };
    Ok((0..angles.len()).into_par_iter().map(row).collect())
}

/// Members of an irregular stack scatter by far more than a rounding in single precision.
fn tolerance(stack: &Stack) -> f64 {
    if stack.is_irregular() { dense::COLOUR_TOLERANCE } else { dense::MEAN_TOLERANCE }
}

impl Scaled {
    /// At a scale that the bands of a sampling serve.
    #[must_use]
    pub fn new(sampling: Sampling, scale: f64) -> Self {
        let seen = sampling.wavelengths().into_iter().map(|wavelength| scale * wavelength).enumerate();
        let [from, to] = colour::VISIBLE;
        // The ends have no weight to speak of.
        let seen: Vec<_> = seen.filter(|(_, wavelength)| (from..=to).contains(wavelength)).collect();
        let weights: Vec<Xyz> = seen.iter().map(|(_, wavelength)| colour::weights(*wavelength)).collect();
        let luminance: f64 = weights.iter().map(|weight| weight[1]).sum();
        let xyz: Vec<Xyz> = weights.iter().map(|weight| weight.map(|w| w / luminance)).collect();
        let white = colour::linear_srgb(xyz.iter().fold([0.0; 3], |sum, w| [0, 1, 2].map(|i| sum[i] + w[i])));
        Self { first: seen.first().map_or(0, |(at, _)| *at), xyz, white }
    }

    /// Tristimulus values of a spectrum, not clipped.
    #[must_use]
    pub fn xyz(&self, spectrum: &[f64]) -> Xyz {
        let mut sum = [0.0; 3];
        for (weight, value) in self.xyz.iter().zip(&spectrum[self.first..]) {
            (0..3).for_each(|i| sum[i] += weight[i] * value);
        }
        sum
    }

    /// Linear sRGB of a spectrum, no channel below 0 or above `most`; 1, 1, 1 for one that is 1 everywhere.
    #[must_use]
    pub fn rgb(&self, spectrum: &[f64], most: f64) -> [f64; 3] {
        let rgb = colour::linear_srgb(self.xyz(spectrum));
        [0, 1, 2].map(|c| (rgb[c] / self.white[c]).clamp(0.0, most))
    }

    /// Mean over the wavelengths that are seen.
    #[must_use]
    pub fn mean(&self, spectrum: &[f64]) -> f64 {
        spectrum[self.first..].iter().take(self.xyz.len()).sum::<f64>() / self.xyz.len() as f64
    }

    /// [`Banded::change`]: without every second wavelength.
    fn change(&self, spectrum: &[f64]) -> f64 {
        let mut sums = [[0.0; 3]; 2];
        let mut white = [0.0; 2];
        for (at, (weight, value)) in self.xyz.iter().zip(&spectrum[self.first..]).enumerate() {
            (0..3).for_each(|i| sums[at % 2][i] += weight[i] * value);
            white[at % 2] += weight[1];
        }
        let all = [0, 1, 2].map(|i| sums[0][i] + sums[1][i]);
        let half = sums[0].map(|x| x / white[0]);
        colour::delta_e_2000(colour::lab(all), colour::lab(half))
    }
}

/// Spectra of an ensemble.
struct Means {
    /// Their mean, rows of angles, each over the wavelengths.
    mean: Vec<Vec<f64>>,
    /// Colours of the members, rows of angles.
    colours: Vec<Vec<Xyz>>,
    /// Whether the stack is its own ensemble.
    is_irregular: bool,
    /// Of the visible wavelengths, and of every second one.
    observer: Observer,
    every_second: Observer,
    /// Linear sRGB of a perfect reflector.
    white: [f64; 3],
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
        stop: &AtomicBool,
        stack: &Stack,
        sampling: Sampling,
        angles: usize,
        of_member: impl Fn(&Stack) -> Result<Vec<Vec<f64>>, StackError> + Sync,
    ) -> Result<Self, StackError> {
        let members = ensemble::count(stack, sampling.members);
        let share = 1.0 / members as f64;
        let visible = sampling.bands * sampling.per_band + 1;
        let observer = Observer::new(visible);
        let mut means = Self {
            mean: vec![vec![0.0; sampling.all_bands() * sampling.per_band + 1]; angles],
            colours: vec![Vec::new(); angles],
            is_irregular: stack.is_irregular(),
            white: colour::linear_srgb(observer.xyz(&vec![1.0; visible])),
            every_second: Observer::new(visible.div_ceil(2)),
            observer: observer.clone(),
        };
        let of = |member: &Stack| -> Result<Vec<(Vec<f64>, Xyz)>, StackError> {
            if stop.load(Ordering::Relaxed) {
                return Err(StackError::Stopped);
            }
            let with_colour = |row: Vec<f64>| {
                let colour = observer.xyz(sampling.visible(&row));
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

    /// [`Banded::noise`] at an angle of this mean colour, in some unit.
    fn noise(&self, mean: Xyz, at: usize, unit: f64) -> Option<f64> {
        let scaled = |xyz: &Xyz| xyz.map(|x| x / unit);
        let colours: Vec<Xyz> = self.colours[at].iter().map(scaled).collect();
        colour::standard_error(&colours, scaled(&mean), self.is_irregular).map(|error| 2.0 * error)
    }

    /// [`Banded::change`] of a visible spectrum of this colour, in some unit.
    fn change(&self, row: &[f64], mean: Xyz, unit: f64) -> Option<f64> {
        // Both ends are among every second one.
        let every_second: Vec<f64> = row.iter().step_by(2).copied().collect();
        let lab = |xyz: Xyz| colour::lab(xyz.map(|x| x / unit));
        let half = || colour::delta_e_2000(lab(mean), lab(self.every_second.xyz(&every_second)));
        (row.len() > 2 && row.len() % 2 == 1).then(half)
    }
}

impl Sampling {
    /// All bands.
    #[must_use]
    pub const fn all_bands(&self) -> usize {
        self.beyond[0] + self.bands + self.beyond[1]
    }

    /// The smallest and the largest scale of all thicknesses that the bands serve.
    #[must_use]
    pub fn scales(&self) -> [f64; 2] {
        let [from, to] = colour::VISIBLE;
        let width = (to - from) / self.bands as f64;
        [to / (to + width * self.beyond[1] as f64), from / (from - width * self.beyond[0] as f64)]
    }

    /// The edges of the bands among them, metres.
    fn wavelengths(&self) -> Vec<f64> {
        let [from, to] = colour::VISIBLE;
        let step = (to - from) / (self.bands * self.per_band) as f64;
        let below = (self.beyond[0] * self.per_band) as f64;
        (0..=self.all_bands() * self.per_band).map(|i| from + step * (i as f64 - below)).collect()
    }

    /// What of a spectrum is visible.
    fn visible<'v>(&self, values: &'v [f64]) -> &'v [f64] {
        &values[self.beyond[0] * self.per_band..][..=self.bands * self.per_band]
    }

    /// Both edges of a band included (trapezoid rule).
    fn band_means(&self, values: &[f64]) -> Vec<f64> {
        let mean = |band: usize| {
            let inside = &values[band * self.per_band..=(band + 1) * self.per_band];
            let ends = 0.5 * (inside[0] + inside[self.per_band]);
            (ends + inside[1..self.per_band].iter().sum::<f64>()) / self.per_band as f64
        };
        (0..(values.len() - 1) / self.per_band).map(mean).collect()
    }

    /// What makes colours at the ends of the range of scales, where there is one.
    fn ends(&self) -> Vec<Scaled> {
        if self.beyond == [0; 2] {
            return Vec::new();
        }
        self.scales().map(|scale| Scaled::new(*self, scale)).into()
    }

    /// The mean at an angle in some unit, colours up to `most`.
    fn banded(&self, means: &Means, ends: &[Scaled], at: usize, unit: f64, most: f64) -> Banded {
        let whole: Vec<f64> = means.mean[at].iter().map(|value| (value / unit).clamp(0.0, most)).collect();
        let values = self.visible(&whole);
        let xyz = means.observer.xyz(values);
        let rgb = colour::linear_srgb(xyz);
        let read = means.observer.xyz(&self.read_between(&self.band_means(values)));
        let visible = self.visible(&means.mean[at]);
        let mean = means.observer.xyz(visible);
        let change = means.change(visible, mean, unit);
        Banded {
            rgb: [0, 1, 2].map(|c| (rgb[c] / means.white[c]).clamp(0.0, most)),
            noise: means.noise(mean, at, unit),
            change: change.map(|change| ends.iter().map(|end| end.change(&whole)).fold(change, f64::max)),
            between_bands: colour::delta_e_2000(colour::lab(xyz), colour::lab(read)),
            bands: self.band_means(&whole),
            xyz,
            ends: ends.iter().map(|end| end.xyz(&whole)).collect(),
            spectrum: if ends.is_empty() { Vec::new() } else { whole },
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
