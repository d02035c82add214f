//! Light of finite line width: R and T as means over a spectral line.
//!
//! A line is centred on the vacuum wavenumber 1/λ and has a full width at half maximum Δλ, as a width in wavelength; its
//! profile is taken in wavenumber, where line shapes are defined, with Δν = Δλ/λ². Its coherence length is about λ²/Δλ:
//! fringes finer than the line vanish, which is how a thick layer comes to add intensities.

use rayon::prelude::*;

use crate::dense;
use crate::material::nanometres;
use crate::stack::{Stack, StackError};
use crate::wave::WaveError;

/// Profile of a spectral line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// exp(−4 ln 2·x²), x in full widths.
    Gaussian,
    /// 1/(1 + 4x²), cut at [`LORENTZIAN_REACH`].
    Lorentzian,
}

/// A spectral line of a given shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Its profile.
    pub shape: Shape,
    /// Full width at half maximum in wavelength, metres.
    pub width: f64,
}

/// A Gaussian is cut where 2e-14 of its power is left.
const GAUSSIAN_REACH: f64 = 3.25;
/// Full widths on either side of its centre after which a Lorentzian is cut; the 0.8 % of its power that lie beyond are left
/// out and the rest scaled up. A cut is needed: the tails reach to wavelengths where no index is known.
pub const LORENTZIAN_REACH: f64 = 40.0;
/// A line may reach this share of its wavenumber to either side.
const WIDEST: f64 = 0.5;

/// First and largest number of waves in a line.
const FIRST_WAVES: usize = 33;
const MOST_WAVES: usize = 16_385;

/// Means over a line, unpolarised light and each polarisation; rows of angles, each over the wavelengths.
#[derive(Clone, Debug, PartialEq)]
pub struct LineMean {
    /// Reflectance, `[s, p][angle][wavelength]`.
    pub reflectance: [Vec<Vec<f64>>; 2],
    /// Transmittance, likewise.
    pub transmittance: [Vec<Vec<f64>>; 2],
    /// Absorptance, likewise: exactly 0 for layers without absorption, negative only with gain.
    pub absorptance: [Vec<Vec<f64>>; 2],
    /// Largest change of an R or T at the last doubling of the waves.
    pub change: f64,
}

/// Mean R and T over a line centred at each of `wavelengths` (metres), at angles in radians. Waves in the line are doubled
/// until nothing changes by more than `accuracy` (in units of R), or there are 16,385: [`LineMean::change`] says which.
///
/// # Errors
/// A width that is not a positive length or so large that the line would reach over half its wavenumber; else as
/// [`dense::spectra`], also where a table does not cover the whole line.
///
/// ```
/// use thinfilm::line::{self, Line, Shape};
/// use thinfilm::{Material, Stack};
/// // A glass plate of 1 mm: its fringes are 0.1 nm apart, a lamp's line of 1 nm does not see them.
/// let plate = Stack::alternating(
///     Material::constant(1.0),
///     (Material::constant(1.5), 1e-3, 0.0),
///     (Material::constant(1.5), 0.0, 0.0),
///     1,
///     Material::constant(1.0),
/// );
/// let mean = line::mean(&plate, Line { shape: Shape::Gaussian, width: 1e-9 }, &[550e-9], &[0.0], 1e-6)?;
/// // Two faces of R = 0.04 whose intensities add: 2R/(1 + R).
/// assert!((mean.reflectance[0][0][0] - 0.08 / 1.04).abs() < 1e-6);
/// # Ok::<(), thinfilm::StackError>(())
/// ```
pub fn mean(
    stack: &Stack,
    line: Line,
    wavelengths: &[f64],
    angles: &[f64],
    accuracy: f64,
) -> Result<LineMean, StackError> {
    let columns: Vec<Column> = wavelengths
        .par_iter()
        .map(|&centre| Column::converged(stack, line, centre, angles, accuracy))
        .collect::<Result<_, _>>()?;
    let rows = |quantity: usize| -> [Vec<Vec<f64>>; 2] {
        [0, 1].map(|pol| {
            (0..angles.len())
                .map(|angle| columns.iter().map(|column| column.values[angle][quantity][pol]).collect())
                .collect()
        })
    };
    Ok(LineMean {
        reflectance: rows(0),
        transmittance: rows(1),
        absorptance: rows(2),
        change: columns.iter().map(|column| column.change).fold(0.0, f64::max),
    })
}

/// One centre at all angles.
struct Column {
    /// `[angle][R, T, A][s, p]`.
    values: Vec<[[f64; 2]; 3]>,
    change: f64,
}

impl Column {
    fn converged(
        stack: &Stack,
        line: Line,
        centre: f64,
        angles: &[f64],
        accuracy: f64,
    ) -> Result<Self, StackError> {
        let mut waves = line.first_count(stack, centre)?;
        let mut coarse = means(stack, line, centre, angles, waves)?;
        loop {
            waves = 2 * waves - 1;
            let fine = means(stack, line, centre, angles, waves)?;
            // R and T: A is what they leave.
            let change = (coarse.iter().zip(&fine))
                .flat_map(|(a, b)| a[..2].iter().flatten().zip(b[..2].iter().flatten()))
                .fold(0.0, |most: f64, (a, b)| most.max((a - b).abs()));
            if change <= accuracy || waves >= MOST_WAVES {
                return Ok(Self { values: fine, change });
            }
            coarse = fine;
        }
    }
}

fn means(
    stack: &Stack,
    line: Line,
    centre: f64,
    angles: &[f64],
    waves: usize,
) -> Result<Vec<[[f64; 2]; 3]>, StackError> {
    let (wavelengths, weights) = line.waves(centre, waves)?;
    let spectra = dense::spectra(stack, &wavelengths, angles)?;
    let mean = |row: &[f64]| row.iter().zip(&weights).map(|(value, weight)| value * weight).sum::<f64>();
    let at = |angle: usize| {
        [
            crate::Polarisation::BOTH.map(|pol| mean(spectra.reflectance(angle, pol))),
            crate::Polarisation::BOTH.map(|pol| mean(spectra.transmittance(angle, pol))),
            crate::Polarisation::BOTH.map(|pol| mean(&spectra.absorptance(angle, pol))),
        ]
    };
    Ok((0..angles.len()).map(at).collect())
}

impl Line {
    /// At least four waves a fringe in the middle of the line, so that two numbers of waves do not miss the same fringes.
    fn first_count(self, stack: &Stack, centre: f64) -> Result<usize, StackError> {
        let thickness = stack.optical_thickness(centre)?;
        let end = match self.shape {
            Shape::Gaussian => 2.0 * GAUSSIAN_REACH,
            Shape::Lorentzian => (2.0 * LORENTZIAN_REACH).atan(),
        };
        let fringes = end * self.width / (centre * centre) * 2.0 * thickness;
        let mut count = FIRST_WAVES;
        while count < MOST_WAVES / 2 && ((count - 1) as f64) < 4.0 * fringes {
            count = 2 * count - 1;
        }
        Ok(count)
    }

    /// Vacuum wavelengths in the line, and their weights, which sum to 1.
    fn waves(self, centre: f64, count: usize) -> Result<(Vec<f64>, Vec<f64>), StackError> {
        if !(centre.is_finite() && centre > 0.0) {
            return Err(WaveError::Wavelength { wavelength_nm: nanometres(centre) }.into());
        }
        let share = self.width / centre;
        let reach = match self.shape {
            Shape::Gaussian => GAUSSIAN_REACH,
            Shape::Lorentzian => LORENTZIAN_REACH,
        };
        if !(self.width > 0.0 && share * reach <= WIDEST) {
            let why = format!(
                "the line is {} nm wide at {} nm; its width must be positive and at most {} nm there",
                nanometres(self.width),
                nanometres(centre),
                nanometres(WIDEST / reach * centre)
            );
            return Err(WaveError::Unsuitable(why).into());
        }
        // Trapezoids: in x for a Gaussian, which ends in zeros; for a Lorentzian in u, x = tan(u)/2, where it is flat.
        let end = match self.shape {
            Shape::Gaussian => reach,
            Shape::Lorentzian => (2.0 * reach).atan(),
        };
        let wave = |i: usize| {
            let u = end * (2.0 * i as f64 / (count - 1) as f64 - 1.0);
            let half = if i == 0 || i == count - 1 { 0.5 } else { 1.0 };
            let (x, weight) = match self.shape {
                Shape::Gaussian => (u, (-4.0 * std::f64::consts::LN_2 * u * u).exp()),
                Shape::Lorentzian => (0.5 * u.tan(), 1.0),
            };
            (centre / (1.0 + x * share), half * weight)
        };
        let (wavelengths, mut weights): (Vec<f64>, Vec<f64>) = (0..count).map(wave).unzip();
        let total: f64 = weights.iter().sum();
        weights.iter_mut().for_each(|weight| *weight /= total);
        Ok((wavelengths, weights))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;

    const INDEX: f64 = 1.5;
    const THICKNESS: f64 = 20e-6;

    fn plate() -> Stack {
        Stack::alternating(
            Material::constant(1.0),
            (Material::constant(INDEX), THICKNESS, 0.0),
            (Material::constant(INDEX), 0.0, 0.0),
            1,
            Material::constant(1.0),
        )
    }

    /// T of a plate is a Fourier series in the wavenumber ν, (1 − ρ)/(1 + ρ)·[1 + 2Σ ρᵐ cos(4πm n d ν)], ρ = face reflectance
    /// (Born & Wolf §7.6.1); a line multiplies each term by the Fourier transform of its profile.
    fn transmitted(centre: f64, damped: impl Fn(f64) -> f64) -> f64 {
        let rho = ((INDEX - 1.0) / (INDEX + 1.0)).powi(2);
        let phase = 4.0 * std::f64::consts::PI * INDEX * THICKNESS;
        let term =
            |m: i32| rho.powi(m) * (phase * f64::from(m) / centre).cos() * damped(phase * f64::from(m));
        (1.0 - rho) / (1.0 + rho) * (1.0 + 2.0 * (1..30).map(term).sum::<f64>())
    }

    #[test]
    fn a_gaussian_line_damps_each_harmonic_of_a_plate_as_its_transform() {
        for (centre, width) in [(550e-9, 0.5e-9), (551e-9, 3e-9), (600e-9, 8e-9)] {
            let line = Line { shape: Shape::Gaussian, width };
            let found = mean(&plate(), line, &[centre], &[0.0], 1e-10).unwrap();
            // FWHM Δν, σ = Δν/√(8 ln 2); transform exp(−σ²τ²/2).
            let sigma = width / (centre * centre) / (8.0 * std::f64::consts::LN_2).sqrt();
            let expected = transmitted(centre, |tau| (-0.5 * (sigma * tau).powi(2)).exp());
            assert!((found.transmittance[0][0][0] - expected).abs() < 1e-9, "{width}: {found:?} {expected}");
            assert!((found.reflectance[1][0][0] + found.transmittance[1][0][0] - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_lorentzian_line_damps_each_harmonic_exponentially() {
        for (centre, width) in [(550e-9, 0.2e-9), (551e-9, 1e-9)] {
            let line = Line { shape: Shape::Lorentzian, width };
            let found = mean(&plate(), line, &[centre], &[0.0], 1e-7).unwrap();
            // Half width Δν/2; transform exp(−Δν|τ|/2).
            let half = 0.5 * width / (centre * centre);
            let expected = transmitted(centre, |tau| (-half * tau).exp());
            // 0.8 % of the profile is cut, of fringes of ± 0.08 which average out there: 1e-3 at most.
            assert!((found.transmittance[0][0][0] - expected).abs() < 1e-3, "{width}: {found:?} {expected}");
        }
    }

    #[test]
    fn a_line_of_no_width_or_too_much_is_refused() {
        for width in [0.0, -1e-9, f64::NAN, 300e-9] {
            let line = Line { shape: Shape::Gaussian, width };
            assert!(mean(&plate(), line, &[550e-9], &[0.0], 1e-3).is_err(), "{width}");
        }
    }
}
