//! Colours of spectra: CIE 1931 2° observer under D65, linear sRGB, ΔE00; with as many wavelengths as an accuracy takes.
//!
//! Data: `data/cie/observer_1931_2deg_d65_1nm.csv` (CIE 018:2019 and CIE 15), read linearly between its rows, 380–780 nm.

use std::sync::LazyLock;

use rayon::prelude::*;

use crate::stack::{Stack, StackError};
use crate::{dense, ensemble};
/// Tristimulus values; a perfect reflector has Y = 1.
pub type Xyz = [f64; 3];

static TABLE: LazyLock<Vec<[f64; 4]>> = LazyLock::new(|| {
    let text = include_str!("../data/cie/observer_1931_2deg_d65_1nm.csv");
    let row = |line: &str| {
        let mut fields = line.split(',').skip(1).map(|field| field.parse::<f64>().unwrap_or(0.0));
        std::array::from_fn(|_| fields.next().unwrap_or(0.0))
    };
    text.lines().filter(|line| !line.starts_with('#')).map(row).collect()
});

/// First and last wavelength of the visible range used here, metres.
pub const VISIBLE: [f64; 2] = [380e-9, 780e-9];

/// (x̄, ȳ, z̄)·D65 at a wavelength in metres.
pub(crate) fn weights(wavelength: f64) -> Xyz {
    let position = (wavelength * 1e9 - 380.0).clamp(0.0, 400.0);
    let below = (position as usize).min(TABLE.len() - 2);
    let t = position - below as f64;
    let at = |row: &[f64; 4], i: usize| row[i] * row[3];
    std::array::from_fn(|i| (1.0 - t) * at(&TABLE[below], i) + t * at(&TABLE[below + 1], i))
}

/// N equally spaced wavelengths (N ≥ 2) over [`VISIBLE`].
#[must_use]
pub fn wavelengths(count: usize) -> Vec<f64> {
    let step = (VISIBLE[1] - VISIBLE[0]) / (count.max(2) - 1) as f64;
    (0..count.max(2)).map(|i| VISIBLE[0] + step * i as f64).collect()
}

/// XYZ of a reflectance sampled at [`wavelengths`] of its length, under D65, by the trapezoid rule.
#[must_use]
pub fn xyz(reflectance: &[f64]) -> Xyz {
    Observer::new(reflectance.len()).xyz(reflectance)
}

/// What makes [`xyz`] of spectra of one length.
#[derive(Clone, Debug)]
pub(crate) struct Observer {
    /// Of the wavelengths, with their shares of the trapezoid rule.
    weights: Vec<Xyz>,
    /// Luminance of a perfect reflector.
    white: f64,
}

impl Observer {
    pub(crate) fn new(count: usize) -> Self {
        let share = |at: usize| if at == 0 || at + 1 == count { 0.5 } else { 1.0 };
        let weight = |(at, wavelength): (usize, f64)| weights(wavelength).map(|weight| share(at) * weight);
        let weights: Vec<Xyz> = wavelengths(count).into_iter().take(count).enumerate().map(weight).collect();
        let white = weights.iter().map(|weight| weight[1]).sum();
        Self { weights, white }
    }

    pub(crate) fn xyz(&self, reflectance: &[f64]) -> Xyz {
        let mut sum = [0.0; 3];
        for (weight, r) in self.weights.iter().zip(reflectance) {
            for (sum, weight) in sum.iter_mut().zip(weight) {
                *sum += weight * r;
            }
        }
        sum.map(|sum| sum / self.white)
    }
}

/// Linear sRGB (IEC 61966-2-1), not clipped: interference colours may lie outside the gamut.
#[must_use]
pub fn linear_srgb(xyz: Xyz) -> [f64; 3] {
    const M: [[f64; 3]; 3] = [
        [3.240_454_2, -1.537_138_5, -0.498_531_4],
        [-0.969_266_0, 1.876_010_8, 0.041_556_0],
        [0.055_643_4, -0.204_025_9, 1.057_225_2],
    ];
    M.map(|row| row.iter().zip(xyz).map(|(m, x)| m * x).sum())
}

/// Tristimulus values of a colour in linear sRGB: the inverse of [`linear_srgb`].
#[must_use]
pub fn xyz_of_linear_srgb(rgb: [f64; 3]) -> Xyz {
    const M: [[f64; 3]; 3] = [
        [0.412_456_4, 0.357_576_1, 0.180_437_5],
        [0.212_672_9, 0.715_152_2, 0.072_175_0],
        [0.019_333_9, 0.119_192_0, 0.950_304_1],
    ];
    M.map(|row| row.iter().zip(rgb).map(|(m, x)| m * x).sum())
}

/// Non-linear sRGB in 0–255 of a linear colour, clipped.
#[must_use]
pub fn srgb_bytes(linear: [f64; 3]) -> [u8; 3] {
    linear.map(|c| {
        let c = c.clamp(0.0, 1.0);
        let encoded = if c <= 0.003_130_8 { 12.92 * c } else { 1.055 * c.powf(1.0 / 2.4) - 0.055 };
        (encoded * 255.0).round() as u8
    })
}

/// CIE L*a*b* against the D65 white of [`xyz`].
#[must_use]
pub fn lab(colour: Xyz) -> [f64; 3] {
    static WHITE: LazyLock<Xyz> = LazyLock::new(|| xyz(&[1.0; 401]));
    let white = *WHITE;
    let f = |t: f64| {
        if t > 216.0 / 24389.0 { t.cbrt() } else { (24389.0 / 27.0 * t + 16.0) / 116.0 }
    };
    let [x, y, z] = [0, 1, 2].map(|i| f(colour[i] / white[i]));
    [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
}

/// CIEDE2000 colour difference of two L*a*b* colours (Sharma, Wu and Dalal 2005).
#[must_use]
pub fn delta_e_2000(a: [f64; 3], b: [f64; 3]) -> f64 {
    let chroma = |c: [f64; 3]| c[1].hypot(c[2]);
    let seventh = |c: f64| (c.powi(7) / (c.powi(7) + 25f64.powi(7))).sqrt();
    let g = 0.5 * (1.0 - seventh(0.5 * (chroma(a) + chroma(b))));
    let prime = |c: [f64; 3]| {
        let a_prime = (1.0 + g) * c[1];
        let hue = if a_prime == 0.0 && c[2] == 0.0 {
            0.0
        } else {
            c[2].atan2(a_prime).to_degrees().rem_euclid(360.0)
        };
        (a_prime.hypot(c[2]), hue)
    };
    let ((c_1, h_1), (c_2, h_2)) = (prime(a), prime(b));
    let grey = c_1 * c_2 == 0.0;
    let turn = match h_2 - h_1 {
        _ if grey => 0.0,
        d if d > 180.0 => d - 360.0,
        d if d < -180.0 => d + 360.0,
        d => d,
    };
    let hue = match h_1 + h_2 {
        sum if grey => sum,
        sum if (h_1 - h_2).abs() <= 180.0 => sum / 2.0,
        sum if sum < 360.0 => (sum + 360.0) / 2.0,
        sum => (sum - 360.0) / 2.0,
    };
    let delta_hue = 2.0 * (c_1 * c_2).sqrt() * (turn / 2.0).to_radians().sin();
    let (light, c) = (0.5 * (a[0] + b[0]), 0.5 * (c_1 + c_2));
    let cos = |factor: f64, shift: f64| (factor * hue + shift).to_radians().cos();
    let t =
        1.0 - 0.17 * cos(1.0, -30.0) + 0.24 * cos(2.0, 0.0) + 0.32 * cos(3.0, 6.0) - 0.20 * cos(4.0, -63.0);
    let s_l = 1.0 + 0.015 * (light - 50.0).powi(2) / (20.0 + (light - 50.0).powi(2)).sqrt();
    let (s_c, s_h) = (1.0 + 0.045 * c, 1.0 + 0.015 * c * t);
    let rotation = -2.0 * seventh(c) * (60.0 * (-((hue - 275.0) / 25.0).powi(2)).exp()).to_radians().sin();
    let (l, c, h) = ((b[0] - a[0]) / s_l, (c_2 - c_1) / s_c, delta_hue / s_h);
    (l * l + c * c + h * h + rotation * c * h).max(0.0).sqrt()
}

/// A stack's colour in reflection at one angle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StackColour {
    /// Tristimulus values under D65.
    pub xyz: Xyz,
    /// Linear sRGB.
    pub linear_srgb: [f64; 3],
    /// CIE L*a*b*.
    pub lab: [f64; 3],
    /// Wavelengths that it took.
    pub wavelengths: usize,
    /// ΔE00 between this and half as many wavelengths.
    pub change: f64,
    /// Stacks that were averaged.
    pub members: u64,
    /// Standard error of the ensemble mean as ΔE00 (jackknife over the members): 0 for a regular stack, unknown of one member.
    pub ensemble_error: Option<f64>,
}

/// Accuracy by default, ΔE00.
pub const DEFAULT_ACCURACY: f64 = 0.1;
/// Members by default.
pub const DEFAULT_MEMBERS: u64 = 64;
const FIRST_WAVELENGTHS: usize = 801;
/// Wavelengths at most.
pub const MOST_WAVELENGTHS: usize = 102_401;

/// Colours of a stack in unpolarised light at angles (radians); an irregular stack's is that of the mean of `members`
/// stacks drawn from `seed`.
///
/// The first grid resolves the finest fringe; wavelengths are doubled, angle by angle, until ΔE00 between two grids is at
/// most `accuracy` or [`MOST_WAVELENGTHS`] are reached: [`StackColour::change`] says which.
///
/// # Errors
/// As [`Stack::draw`] and [`crate::dense::spectra`].
///
/// ```
/// use thinfilm::{Material, Stack, colour};
/// let film = Stack::alternating(
///     Material::constant(1.0),
///     (Material::constant(1.33), 300e-9, 0.0),
///     (Material::constant(1.33), 0.0, 0.0),
///     1,
///     Material::constant(1.0),
/// );
/// let colours = colour::of_stack(&film, 0, 1, &[0.0], colour::DEFAULT_ACCURACY)?;
/// // A soap film of 300 nm reflects best at 4nd/3 = 532 nm.
/// let [r, g, b] = colours[0].linear_srgb;
/// assert!(g > r && g > b);
/// # Ok::<(), thinfilm::StackError>(())
/// ```
pub fn of_stack(
    stack: &Stack,
    seed: u64,
    members: u64,
    angles: &[f64],
    accuracy: f64,
) -> Result<Vec<StackColour>, StackError> {
    stack.check()?;
    let members = ensemble::count(stack, members);
    angles
        .iter()
        .map(|theta| {
            let mut count = first_count(stack)?;
            let mut coarse = EnsembleColour::new(stack, seed, members, count, *theta)?;
            loop {
                count = 2 * count - 1;
                let fine = EnsembleColour::new(stack, seed, members, count, *theta)?;
                let change = delta_e_2000(lab(coarse.mean), lab(fine.mean));
                if change <= accuracy || count >= MOST_WAVELENGTHS {
                    return Ok(fine.colour(count, change, stack.is_irregular()));
                }
                coarse = fine;
            }
        })
        .collect()
}

/// 800·2ᵏ + 1 wavelengths, no wider apart than the finest fringe (λ²/2nd at the blue end), so that two grids in a row do not
/// miss the same fringes.
fn first_count(stack: &Stack) -> Result<usize, StackError> {
    let fringe = VISIBLE[0] * VISIBLE[0] / (2.0 * stack.optical_thickness(VISIBLE[0])?);
    let mut count = FIRST_WAVELENGTHS;
    // The last doubling is kept for the comparison.
    while count < MOST_WAVELENGTHS / 2 && (VISIBLE[1] - VISIBLE[0]) / (count - 1) as f64 > fringe {
        count = 2 * count - 1;
    }
    Ok(count)
}

/// Standard error of the mean of the colours of an ensemble, as ΔE00: √((n − 1)/n Σ ΔE²) over the means without one member (Tukey's
/// jackknife). 0 of a regular stack, `None` of one member of an irregular one.
pub(crate) fn standard_error(members: &[Xyz], mean: Xyz, is_irregular: bool) -> Option<f64> {
    if members.len() < 2 {
        return (!is_irregular).then_some(0.0);
    }
    let n = members.len() as f64;
    let whole = lab(mean);
    let square = |member: &Xyz| {
        let without = std::array::from_fn(|c| (n * mean[c] - member[c]) / (n - 1.0));
        delta_e_2000(whole, lab(without)).powi(2)
    };
    Some(((n - 1.0) / n * members.iter().map(square).sum::<f64>()).sqrt())
}

/// XYZ of every member of an ensemble at one angle, and their mean. XYZ is linear in R: the mean's colour is the colour of the
/// mean.
struct EnsembleColour {
    members: Vec<Xyz>,
    mean: Xyz,
}

impl EnsembleColour {
    fn new(stack: &Stack, seed: u64, members: u64, count: usize, theta: f64) -> Result<Self, StackError> {
        let wavelengths = wavelengths(count);
        let of = |member: u64| {
            let member = stack.draw(seed, member)?;
            let spectra =
                dense::spectra_for_means(dense::MEAN_TOLERANCE, &member, &wavelengths, &[theta], None)?;
            Ok::<_, StackError>(xyz(&spectra.unpolarised_reflectance(0)))
        };
        let members: Vec<Xyz> = (0..members).into_par_iter().map(of).collect::<Result<_, _>>()?;
        let mean = std::array::from_fn(|c| members.iter().map(|m| m[c]).sum::<f64>() / members.len() as f64);
        Ok(Self { members, mean })
    }

    fn colour(&self, wavelengths: usize, change: f64, is_irregular: bool) -> StackColour {
        let ensemble_error = standard_error(&self.members, self.mean, is_irregular);
        StackColour {
            xyz: self.mean,
            linear_srgb: linear_srgb(self.mean),
            lab: lab(self.mean),
            wavelengths,
            change,
            members: self.members.len() as u64,
            ensemble_error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;

    #[test]
    fn a_white_reflector_is_white_in_every_space() {
        let white = xyz(&[1.0; 801]);
        // D65: x = 0.31272, y = 0.32903 (CIE 15), here from 380 to 780 nm only.
        let sum: f64 = white.iter().sum();
        assert!((white[0] / sum - 0.31272).abs() < 2e-4 && (white[1] / sum - 0.32903).abs() < 2e-4);
        // The sRGB matrix has its white to four digits.
        assert!(linear_srgb(white).iter().all(|c| (c - 1.0).abs() < 2e-3));
        assert!((lab(white)[0] - 100.0).abs() < 1e-3);
    }

    #[test]
    fn delta_e_2000_has_the_published_test_values() {
        // Sharma, Wu and Dalal, Color Res. Appl. 30 (2005) 21, table 1: pairs 1, 4, 7, 13, 17, 25.
        let pairs = [
            ([50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485], 2.0425),
            ([50.0, -1.3802, -84.2814], [50.0, 0.0, -82.7485], 1.0000),
            ([50.0, 0.0, 0.0], [50.0, -1.0, 2.0], 2.3669),
            ([50.0, -0.0010, 2.4900], [50.0, 0.0009, -2.4900], 4.8045),
            ([50.0, 2.5, 0.0], [73.0, 25.0, -18.0], 27.1492),
            ([60.2574, -34.0099, 36.2677], [60.4626, -34.1751, 39.4387], 1.2644),
        ];
        for (a, b, expected) in pairs {
            assert!((delta_e_2000(a, b) - expected).abs() < 5e-5, "{a:?} {b:?}: {}", delta_e_2000(a, b));
        }
    }

    fn pearl(sd: f64) -> Stack {
        Stack::alternating(
            Material::constant(1.0),
            (Material::constant(1.53), 450e-9, 450e-9 * sd),
            (Material::constant(1.43), 25e-9, 25e-9 * sd),
            500,
            Material::constant(1.53),
        )
    }

    #[test]
    fn default_accuracy_is_within_0_3_of_12801_wavelengths() {
        let angles: Vec<f64> = (0..=6).map(|i| f64::from(10 * i).to_radians()).collect();
        for sd in [0.0, 0.03, 0.10] {
            let colours = of_stack(&pearl(sd), 7, 2, &angles, DEFAULT_ACCURACY).unwrap();
            let reference = ensemble::mean(&pearl(sd), 7, 2, &wavelengths(12_801), &angles).unwrap();
            for ((theta, colour), row) in angles.iter().zip(&colours).zip(&reference.reflectance) {
                let error = delta_e_2000(colour.lab, lab(xyz(row)));
                assert!(
                    error <= 0.3,
                    "sd {sd}, {theta} rad: {error} with {} wavelengths",
                    colour.wavelengths
                );
                assert!(colour.change <= DEFAULT_ACCURACY, "{colour:?}");
            }
        }
    }

    /// Many small ensembles: their scatter about the mean of all is what one of them states as its error.
    #[test]
    fn the_stated_error_of_an_ensemble_is_the_scatter_of_ensembles() {
        let stack =
            Stack { runs: vec![crate::StackRun { repeat: 10, ..pearl(0.1).runs[0].clone() }], ..pearl(0.1) };
        const GROUPS: u64 = 60;
        let groups: Vec<StackColour> =
            (0..GROUPS).map(|seed| of_stack(&stack, seed, 16, &[0.3], 1.0).unwrap()[0]).collect();
        let mean = |of: fn(&StackColour, usize) -> f64| -> [f64; 3] {
            std::array::from_fn(|c| groups.iter().map(|g| of(g, c)).sum::<f64>() / GROUPS as f64)
        };
        let centre = lab(mean(|g, c| g.xyz[c]));
        let scatter =
            (groups.iter().map(|g| delta_e_2000(centre, g.lab).powi(2)).sum::<f64>() / GROUPS as f64).sqrt();
        let stated =
            (groups.iter().map(|g| g.ensemble_error.unwrap().powi(2)).sum::<f64>() / GROUPS as f64).sqrt();
        // 60 groups of 3 coordinates know a standard deviation to about 8 %; four of those.
        assert!((scatter / stated - 1.0).abs() < 0.32, "{scatter} {stated}");
    }
}
