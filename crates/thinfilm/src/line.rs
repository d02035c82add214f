//! Light of finite line width: R and T as means over a spectral line.
//!
//! A line is centred on the vacuum wavenumber 1/λ and has a full width at half maximum Δλ, as a width in wavelength; its
//! profile is taken in wavenumber, where line shapes are defined, with Δν = Δλ/λ². Its coherence length is about λ²/Δλ:
//! fringes finer than the line vanish, which is how a thick layer comes to add intensities.
//!
//! The line is cut into panels across none of whose halves the stack's phase turns by more than a radian (`crate::phase`: no
//! resonance hides in one), no panel four times as wide as its neighbour; rules of Gauss and Kronrod halve those that are not yet known well
//! enough. The far tails of a Lorentzian, thousands of fringes in a thousandth of the light, are sampled, and their standard error is
//! three times in the error.

use rayon::prelude::*;

use crate::Polarisation;
use crate::dense;
use crate::material::nanometres;
use crate::quadrature::GAUSS_KRONROD_15;
use crate::stack::{Gain, Stack, StackError};
use crate::wave::{WaveError, check_wavelength};

/// Profile of a spectral line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// exp(−4 ln 2·x²), x in full widths.
    Gaussian,
    /// 1/(1 + 4x²), at every wavenumber ν from −∞ to ∞ (R and T at −ν are those at ν). What lies where an index is not known
    /// (outside a table, or of a formula beyond half to one and a half times the wavenumber of the line) is left out, the rest scaled
    /// up, and its share added to the error.
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

/// Full widths on either side of its centre to which a line must be known; beyond, 2e-14 of a Gaussian's power are left.
const REACH: f64 = 3.25;
/// That may be this share of its wavenumber.
const WIDEST: f64 = 0.5;
/// A Lorentzian ends at this many times the wavenumber of its centre.
const LAST_WAVENUMBER: f64 = 1e6;

/// Radians that the stack's phase turns across half a panel, at most: half a resonance turns it by π/2.
const TURN: f64 = 1.0;
/// Panels at most, and layers that are followed for the phases of them.
const MOST_PANELS: f64 = 20_000.0;
const PHASE_WORK: f64 = 2e6;
/// Waves of the panels at most: halving ends there.
const MOST_WAVES: usize = 1 << 19;
/// First and largest number of waves in tails.
const FIRST_SAMPLES: usize = 1 << 10;
const MOST_SAMPLES: usize = 1 << 16;

/// Means over a line, each polarisation; rows of angles, each over the wavelengths.
#[derive(Clone, Debug, PartialEq)]
pub struct LineMean {
    /// Reflectance, `[s, p][angle][wavelength]`.
    pub reflectance: [Vec<Vec<f64>>; 2],
    /// Transmittance, likewise.
    pub transmittance: [Vec<Vec<f64>>; 2],
    /// Absorptance, likewise: exactly 0 for layers without absorption, negative only with gain.
    pub absorptance: [Vec<Vec<f64>>; 2],
    /// Bound on the error of an R or T: of the quadrature, of sampled tails (three standard errors) and of what is left out; infinite
    /// where something is left out and layers may amplify.
    pub error: f64,
}

/// Mean R and T over a line centred at each of `wavelengths` (metres), at angles in radians, to `accuracy` (in units of R) where the work
/// allows it: [`LineMean::error`] says what was reached.
///
/// # Errors
/// A width that is not a positive length or so large that 3.25 of it would reach over half its wavenumber; else as
/// [`dense::spectra`], also where a table does not cover those 3.25 widths; more than [`crate::field::MOST_LISTED_LAYERS`] layers.
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
/// assert!((mean.reflectance[0][0][0] - 0.08 / 1.04).abs() < 1e-6 && mean.error <= 1e-6);
/// # Ok::<(), thinfilm::StackError>(())
/// ```
pub fn mean(
    stack: &Stack,
    line: Line,
    wavelengths: &[f64],
    angles: &[f64],
    accuracy: f64,
) -> Result<LineMean, StackError> {
    let most = crate::field::MOST_LISTED_LAYERS;
    if stack.layer_count() > u128::from(most) {
        return Err(WaveError::TooManyLayers { layers: stack.layer_count(), most }.into());
    }
    let pairs: Vec<(f64, f64)> =
        angles.iter().flat_map(|&theta| wavelengths.iter().map(move |&centre| (theta, centre))).collect();
    let means: Vec<Mean> = pairs
        .into_par_iter()
        .map(|(theta, centre)| Scan::new(stack, line, centre, theta)?.mean(accuracy))
        .collect::<Result<_, _>>()?;
    let rows = |quantity: usize| -> [Vec<Vec<f64>>; 2] {
        [0, 1].map(|pol| {
            let row = |row: &[Mean]| row.iter().map(|mean| mean.values[quantity][pol]).collect();
            means.chunks(wavelengths.len().max(1)).map(row).collect()
        })
    };
    Ok(LineMean {
        reflectance: rows(0),
        transmittance: rows(1),
        absorptance: rows(2),
        error: means.iter().map(|mean| mean.error).fold(0.0, f64::max),
    })
}

/// `[R, T, A][s, p]`.
type Values = [[f64; 2]; 3];

/// `a + weight·b`.
fn add(a: &mut Values, weight: f64, b: &Values) {
    for (a, b) in a.iter_mut().flatten().zip(b.iter().flatten()) {
        *a += weight * b;
    }
}

/// One centre at one angle.
struct Mean {
    values: Values,
    error: f64,
}

/// A part of the line, [from, to] in u, and the integrals over it.
#[derive(Clone, Copy)]
struct Panel {
    ends: [f64; 2],
    mass: f64,
    integrals: Values,
    error: f64,
}

/// Where panels end, and what share of the line is in those that are too small to be cut further.
struct Cuts {
    panels: Vec<[f64; 2]>,
    hidden: f64,
}

/// A line at one centre and angle. u is x, the distance from the centre in full widths, for a Gaussian, and atan 2x for a Lorentzian,
/// whose density over u is flat.
struct Scan<'a> {
    stack: &'a Stack,
    shape: Shape,
    centre: f64,
    theta: f64,
    /// Δλ/λ.
    share: f64,
    /// Ends of what is known of the line, in u.
    known: [f64; 2],
}

impl<'a> Scan<'a> {
    fn new(stack: &'a Stack, line: Line, centre: f64, theta: f64) -> Result<Self, StackError> {
        stack.check()?;
        check_wavelength(centre)?;
        let share = line.width / centre;
        if !(line.width > 0.0 && share * REACH <= WIDEST) {
            let why = format!(
                "the line is {} nm wide at {} nm; its width must be positive and at most {} nm there",
                nanometres(line.width),
                nanometres(centre),
                nanometres(WIDEST / REACH * centre)
            );
            return Err(WaveError::Unsuitable(why).into());
        }
        let known = match line.shape {
            Shape::Gaussian => [-REACH, REACH],
            Shape::Lorentzian => {
                let media = stack.materials.iter().chain([&stack.ambient, &stack.substrate]);
                let covered = media.map(|material| material.n.covers(centre));
                let [from, to] =
                    covered.fold([0.0, f64::INFINITY], |[a, b]: [f64; 2], [c, d]| [a.max(c), b.min(d)]);
                let last = LAST_WAVENUMBER / share;
                // To every wavelength there is a negative wavenumber, too, of which nothing is known where not all is.
                let low = if to.is_finite() { (centre / to - 1.0) / share } else { -last };
                let high = ((centre / from - 1.0) / share).min(last);
                [low.min(-REACH), high.max(REACH)].map(|x| (2.0 * x).atan())
            }
        };
        Ok(Self { stack, shape: line.shape, centre, theta, share, known })
    }

    /// Share of the line's power a unit of u.
    fn density(&self, u: f64) -> f64 {
        use std::f64::consts::{LN_2, PI};
        match self.shape {
            Shape::Gaussian => (4.0 * LN_2 / PI).sqrt() * (-4.0 * LN_2 * u * u).exp(),
            Shape::Lorentzian => 1.0 / PI,
        }
    }

    /// At least the share of the line's power between two u.
    fn most_mass(&self, [from, to]: [f64; 2]) -> f64 {
        (to - from) * self.density(from.max(0.0).min(to))
    }

    /// Wavenumber over that of the centre, never 0.
    fn wavenumber(&self, u: f64) -> f64 {
        let x = match self.shape {
            Shape::Gaussian => u,
            Shape::Lorentzian => 0.5 * u.tan(),
        };
        let wavenumber = 1.0 + x * self.share;
        if wavenumber.abs() < 1e-9 { 1e-9 } else { wavenumber }
    }

    fn wavelength(&self, u: f64) -> f64 {
        self.centre / self.wavenumber(u).abs()
    }

    fn mean(&self, accuracy: f64) -> Result<Mean, StackError> {
        let layers = self.stack.layer_count() as f64;
        let most_panels = (PHASE_WORK / layers).clamp(0.05 * MOST_PANELS, MOST_PANELS);
        let resolved = self.resolved(accuracy, most_panels)?;
        let mut unknown = match self.shape {
            Shape::Gaussian => 0.0,
            Shape::Lorentzian => 1.0 - self.most_mass(self.known),
        };
        let mut panels = Vec::new();
        let mut sampled = vec![[self.known[0], resolved[0]], [resolved[1], self.known[1]]];
        match self.panels(resolved, 1e-3 * accuracy, most_panels as usize)? {
            Some(Cuts { panels: ends, hidden }) => {
                panels = self.halved(self.integrated(&ends)?, 0.5 * accuracy)?;
                unknown += hidden;
            }
            None => sampled = vec![self.known],
        }
        let mut values = Values::default();
        let (mut mass, mut error) = (0.0, 0.0);
        for panel in &panels {
            add(&mut values, 1.0, &panel.integrals);
            mass += panel.mass;
            error += panel.error;
        }
        sampled.retain(|[from, to]| from < to);
        if !sampled.is_empty() {
            let (mean, share, its_error) = self.sampled(&sampled, 0.25 * accuracy)?;
            add(&mut values, share, &mean);
            mass += share;
            error += share * its_error;
        }
        values.iter_mut().flatten().for_each(|value| *value /= mass);
        if unknown > 1e-12 && self.stack.gain == Gain::Allowed {
            error = f64::INFINITY;
        }
        Ok(Mean { values, error: error + unknown })
    }

    /// The part that is cut into panels: all of a Gaussian; of a Lorentzian as much as leaves tails that can be sampled, if the fringes
    /// are not too many.
    fn resolved(&self, accuracy: f64, most_panels: f64) -> Result<[f64; 2], StackError> {
        let [low, high] = self.known;
        if self.shape == Shape::Gaussian {
            return Ok(self.known);
        }
        // Three standard errors of R = 0 or 1 at most.
        let needed = 1.5 / (MOST_SAMPLES as f64).sqrt() / (0.25 * accuracy) / std::f64::consts::PI;
        let fringes = 2.0 * self.stack.optical_thickness(self.centre)? * self.share / self.centre;
        // A fringe turns the phase by π, a panel by 2 at most; half of the panels are for what is not as even.
        let affordable = 0.5 * most_panels / (std::f64::consts::PI * fringes);
        let end = (2.0 * needed.min(affordable).max(REACH)).atan();
        Ok([low.max(-end), high.min(end)])
    }

    /// Panels; `None` where they are too many.
    fn panels(&self, [from, to]: [f64; 2], least: f64, most: usize) -> Result<Option<Cuts>, StackError> {
        const FIRST: u32 = 8;
        let node = |u: f64| -> Result<(f64, [f64; 2]), StackError> {
            let wavelength = self.wavelength(u);
            let phases = self.stack.at(wavelength)?.phases(wavelength, self.theta)?;
            Ok((u, phases.map(|phase| phase.copysign(phase * self.wavenumber(u)))))
        };
        let turn = |a: &[f64; 2], b: &[f64; 2]| (a[0] - b[0]).abs().max((a[1] - b[1]).abs());
        let first: Vec<(f64, [f64; 2])> = (0..=FIRST)
            .map(|i| node(from + (to - from) * f64::from(i) / f64::from(FIRST)))
            .collect::<Result<_, _>>()?;
        let mut open: Vec<[(f64, [f64; 2]); 2]> =
            first.windows(2).rev().map(|pair| [pair[0], pair[1]]).collect();
        let (mut panels, mut hidden) = (Vec::new(), 0.0);
        while let Some([a, b]) = open.pop() {
            if panels.len() + open.len() > most {
                return Ok(None);
            }
            let middle = node(0.5 * (a.0 + b.0))?;
            let is_even = turn(&a.1, &middle.1).max(turn(&middle.1, &b.1)) <= TURN;
            let mass = self.most_mass([a.0, b.0]);
            if is_even || mass <= least {
                panels.push([a.0, b.0]);
                hidden += if is_even { 0.0 } else { mass };
            } else {
                open.extend([[middle, b], [a, middle]]);
            }
        }
        Ok(Some(Cuts { panels: graded(panels), hidden }))
    }

    /// Halves panels until their errors sum to `accuracy` or less, or there are too many.
    fn halved(&self, mut panels: Vec<Panel>, accuracy: f64) -> Result<Vec<Panel>, StackError> {
        let mut waves = panels.len() * 15;
        loop {
            let error: f64 = panels.iter().map(|panel| panel.error).sum();
            let share = 0.25 * accuracy / panels.len() as f64;
            let (known, coarse): (Vec<Panel>, Vec<Panel>) = panels.iter().partition(|panel| {
                let [from, to] = panel.ends;
                panel.error <= share || to - from < 1e-13
            });
            waves += 30 * coarse.len();
            if error <= accuracy || coarse.is_empty() || waves > MOST_WAVES {
                return Ok(panels);
            }
            let halves: Vec<[f64; 2]> = coarse.iter().flat_map(|panel| halves(panel.ends)).collect();
            panels = known;
            panels.extend(self.integrated(&halves)?);
        }
    }

    /// ∫ over panels, by Kronrod's rule of 15 nodes; the error as QUADPACK estimates it (R. Piessens et al., 1983).
    fn integrated(&self, panels: &[[f64; 2]]) -> Result<Vec<Panel>, StackError> {
        let rule: Vec<[f64; 3]> =
            GAUSS_KRONROD_15[1..].iter().rev().map(|&[x, k, g]| [-x, k, g]).chain(GAUSS_KRONROD_15).collect();
        let node = |&[from, to]: &[f64; 2], x: f64| 0.5 * (from + to) + 0.5 * (to - from) * x;
        let nodes: Vec<f64> =
            panels.iter().flat_map(|panel| rule.iter().map(move |[x, ..]| node(panel, *x))).collect();
        let values = self.values(&nodes)?;
        let panel = |(at, &ends): (usize, &[f64; 2])| {
            let half = 0.5 * (ends[1] - ends[0]);
            let (mut mass, mut integrals, mut gauss) = (0.0, Values::default(), Values::default());
            let parts = || nodes[15 * at..].iter().zip(&values[15 * at..]).zip(&rule);
            for ((u, values), [_, kronrod, legendre]) in parts() {
                let density = half * self.density(*u);
                mass += kronrod * density;
                add(&mut integrals, kronrod * density, values);
                add(&mut gauss, legendre * density, values);
            }
            let mut error: f64 = 0.0;
            for quantity in 0..2 {
                for pol in 0..2 {
                    let mean = integrals[quantity][pol] / (2.0 * half);
                    let spread: f64 = parts()
                        .map(|((u, v), [_, k, _])| {
                            k * half * (self.density(*u) * v[quantity][pol] - mean).abs()
                        })
                        .sum();
                    let off = (integrals[quantity][pol] - gauss[quantity][pol]).abs();
                    let estimate =
                        if spread > 0.0 { spread * (200.0 * off / spread).powf(1.5).min(1.0) } else { off };
                    error = error.max(estimate);
                }
            }
            Panel { ends, mass, integrals, error }
        };
        Ok(panels.iter().enumerate().map(panel).collect())
    }

    /// Mean over parts of the line at points spread evenly over them, the share of the line that they hold, and three standard errors:
    /// no less than 3/N, since what happens less often may not have been met.
    fn sampled(&self, parts: &[[f64; 2]], accuracy: f64) -> Result<(Values, f64, f64), StackError> {
        let width: f64 = parts.iter().map(|[from, to]| to - from).sum();
        let share = match self.shape {
            Shape::Gaussian => 1.0,
            Shape::Lorentzian => width / std::f64::consts::PI,
        };
        let mut count = FIRST_SAMPLES;
        loop {
            let step = width / count as f64;
            // Fringes are much finer than a step: the golden ratio only keeps points from standing in a row.
            let point = |i: usize| {
                let mut along = step * (i as f64 + (0.618_033_988_749_895 * i as f64).fract());
                let part = parts.iter().find(|[from, to]| {
                    let inside = along < to - from;
                    along -= if inside { 0.0 } else { to - from };
                    inside
                });
                part.map_or(parts[0][0], |[from, _]| from + along)
            };
            let points: Vec<f64> = (0..count).map(point).collect();
            let weights: Vec<f64> = match self.shape {
                Shape::Gaussian => points.iter().map(|u| self.density(*u) * step).collect(),
                Shape::Lorentzian => vec![1.0 / count as f64; count],
            };
            let values = self.values(&points)?;
            let mut mean = Values::default();
            values.iter().zip(&weights).for_each(|(values, weight)| add(&mut mean, *weight, values));
            // Of R and T; the weights are those of the points themselves.
            let variance = |quantity: usize, pol: usize| -> f64 {
                let mean = mean[quantity][pol];
                values.iter().zip(&weights).map(|(v, w)| (w * (v[quantity][pol] - mean)).powi(2)).sum()
            };
            let worst = (0..4).map(|i| variance(i / 2, i % 2)).fold(0.0, f64::max);
            let error = 3.0 * worst.sqrt().max(weights.iter().copied().fold(0.0, f64::max));
            if share * error <= accuracy || count >= MOST_SAMPLES {
                return Ok((mean, share, error));
            }
            count *= 2;
        }
    }

    /// R, T and A at points of the line.
    fn values(&self, points: &[f64]) -> Result<Vec<Values>, StackError> {
        let wavelengths: Vec<f64> = points.iter().map(|u| self.wavelength(*u)).collect();
        let spectra = dense::spectra(self.stack, &wavelengths, &[self.theta])?;
        let absorptance = Polarisation::BOTH.map(|pol| spectra.absorptance(0, pol));
        let reflectance = Polarisation::BOTH.map(|pol| spectra.reflectance(0, pol));
        let transmittance = Polarisation::BOTH.map(|pol| spectra.transmittance(0, pol));
        let at = |i: usize| {
            [reflectance.map(|r| r[i]), transmittance.map(|t| t[i]), [absorptance[0][i], absorptance[1][i]]]
        };
        Ok((0..points.len()).map(at).collect())
    }
}

fn halves([from, to]: [f64; 2]) -> [[f64; 2]; 2] {
    let middle = 0.5 * (from + to);
    [[from, middle], [middle, to]]
}

/// Halves panels until none is over four times as wide as its neighbour: a resonance beside a wide one reaches into it.
fn graded(mut panels: Vec<[f64; 2]>) -> Vec<[f64; 2]> {
    loop {
        let width = |at: usize| panels.get(at).map_or(f64::INFINITY, |[from, to]| to - from);
        let is_wide = |at: usize| width(at) > 4.0 * width(at + 1).min(width(at.wrapping_sub(1)));
        let finer: Vec<[f64; 2]> = (0..panels.len())
            .flat_map(|at| {
                let [first, second] = halves(panels[at]);
                if is_wide(at) { vec![first, second] } else { vec![panels[at]] }
            })
            .collect();
        if finer.len() == panels.len() {
            return panels;
        }
        panels = finer;
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
            let found = mean(&plate(), line, &[centre], &[0.0], 1e-5).unwrap();
            // Half width Δν/2; transform exp(−Δν|τ|/2).
            let half = 0.5 * width / (centre * centre);
            let expected = transmitted(centre, |tau| (-half * tau).exp());
            let off = (found.transmittance[0][0][0] - expected).abs();
            assert!(off < 1e-6 && off <= found.error && found.error < 1e-5, "{width}: {found:?} {expected}");
        }
    }

    #[test]
    fn a_line_of_no_width_or_too_much_is_refused() {
        for width in [0.0, -1e-9, f64::NAN, 300e-9] {
            let line = Line { shape: Shape::Gaussian, width };
            assert!(mean(&plate(), line, &[550e-9], &[0.0], 1e-3).is_err(), "{width}");
        }
    }

    /// A cavity of `pairs` quarter-wave pairs a mirror, tuned to 550 nm: a line of width λ/Q in a stop band of T = 1e-9 and less.
    fn cavity(pairs: u64, k: f64) -> Stack {
        let quarter = |n: f64| 550e-9 / 4.0 / n;
        let layer = |material, thickness| crate::StackLayer { material, thickness, thickness_sd: 0.0 };
        let (high, low) = (layer(0, quarter(2.3)), layer(1, quarter(1.46)));
        let spacer = layer(0, 2.0 * quarter(2.3));
        let run = |unit, repeat| crate::StackRun { unit, repeat };
        Stack {
            ambient: Material::constant(1.0),
            materials: vec![Material { k, ..Material::constant(2.3) }, Material::constant(1.46)],
            runs: vec![run(vec![high, low], pairs), run(vec![spacer], 1), run(vec![low, high], pairs)],
            substrate: Material::constant(1.0),
            gain: Gain::Refused,
        }
    }

    /// T of a resonance far narrower than the line is that of a Lorentzian peak: T₀·π/2·Γ·(profile there), Γ its full width at half maximum
    /// in full widths of the line. Γ comes from T itself, beside the peak.
    #[test]
    fn a_resonance_of_any_width_is_found_wherever_it_lies_in_the_line() {
        for (pairs, k) in [(10, 0.0), (14, 0.0), (18, 0.0), (12, 1e-6)] {
            let stack = cavity(pairs, k);
            let at = |detuning: f64| {
                let wavelength = 550e-9 / (1.0 + detuning);
                let incidence = crate::Incidence::Angle(0.0);
                stack
                    .at(wavelength)
                    .unwrap()
                    .solve(wavelength, incidence, Polarisation::S)
                    .unwrap()
                    .transmittance
            };
            // T(δ) = T₀/(1 + (2δ/γ)²); the detuning where T is half is found by halving.
            let (mut inside, mut outside) = (0.0, 1e-2);
            for _ in 0..200 {
                let middle = 0.5 * (inside + outside);
                if at(middle) > 0.5 * at(0.0) { inside = middle } else { outside = middle }
            }
            let gamma = 2.0 * inside;
            for (centre, width) in [(550.4e-9, 8e-9), (548.77e-9, 3e-9), (550e-9, 0.9e-9), (551.3e-9, 5e-9)] {
                if gamma * 550e-9 > 0.02 * width {
                    continue; // not far narrower
                }
                let line = Line { shape: Shape::Gaussian, width };
                let found = mean(&stack, line, &[centre], &[0.0], 1e-7).unwrap();
                let x = (centre / 550e-9 - 1.0) / (width / centre);
                use std::f64::consts::{LN_2, PI};
                let profile = (4.0 * LN_2 / PI).sqrt() * (-4.0 * LN_2 * x * x).exp();
                let peak = at(0.0) * 0.5 * PI * gamma * centre / width * profile;
                // Γ is a fiftieth of the line at most, and the stop band passes a little beside the peak.
                let off = (found.transmittance[0][0][0] - peak).abs();
                assert!(off < 0.03 * peak + 2e-6, "{pairs} {k} {centre} {width}: {found:?}, {peak}");
            }
        }
    }

    /// Against a great many waves in the line, resonances of every width among them, aslant and absorbing.
    #[test]
    fn means_are_within_their_error_of_many_waves() {
        let (centre, width) = (551.7e-9, 6e-9);
        for (pairs, k, theta, shape) in [
            (4, 0.0, 0.0, Shape::Gaussian),
            (6, 0.0, 0.4, Shape::Gaussian),
            (8, 1e-4, 0.2, Shape::Gaussian),
            (9, 0.0, 0.0, Shape::Gaussian),
            (5, 0.0, 0.3, Shape::Lorentzian),
        ] {
            let stack = cavity(pairs, k);
            let found = mean(&stack, Line { shape, width }, &[centre], &[theta], 1e-5).unwrap();
            assert!(found.error <= 1e-5, "{found:?}");
            let scan = Scan::new(&stack, Line { shape, width }, centre, theta).unwrap();
            let [from, to] = scan.known;
            let waves = if shape == Shape::Gaussian { 100_000 } else { 4_000_000 };
            let u: Vec<f64> =
                (0..waves).map(|i| from + (to - from) * (f64::from(i) + 0.5) / f64::from(waves)).collect();
            let weights: Vec<f64> = u.iter().map(|u| scan.density(*u)).collect();
            let wavelengths: Vec<f64> = u.iter().map(|u| scan.wavelength(*u)).collect();
            let spectra = dense::spectra(&stack, &wavelengths, &[theta]).unwrap();
            for (at, pol) in Polarisation::BOTH.into_iter().enumerate() {
                let terms = spectra.transmittance(0, pol).iter().zip(&weights);
                let sum: f64 = terms.map(|(t, weight)| t * weight).sum();
                let off = found.transmittance[at][0][0] - sum / weights.iter().sum::<f64>();
                // In the far tails of a Lorentzian are more fringes than waves: a standard error of 4e-6.
                assert!(off.abs() <= 1.2e-5, "{pairs} {shape:?} {pol:?}: {off:e}, {found:?}");
            }
        }
    }

    /// Where an index ends, the share of a Lorentzian beyond is in the error.
    #[test]
    fn what_is_cut_off_a_lorentzian_is_in_its_error() {
        let line = Line { shape: Shape::Lorentzian, width: 2e-9 };
        let table = crate::Dispersion::Table(vec![[500.0, 1.5, 0.0], [600.0, 1.5, 0.0]]);
        let cut =
            Stack { materials: vec![Material { n: table, k: 0.0 }, Material::constant(1.5)], ..plate() };
        let [cut, whole] = [cut, plate()].map(|stack| mean(&stack, line, &[550e-9], &[0.0], 1e-4).unwrap());
        // Beyond 50 nm on either side, as atan(2x)/π has it.
        let x = |edge: f64| (550e-9 / edge - 1.0) / (2.0 / 550.0);
        let left = 1.0 - ((2.0 * x(500e-9)).atan() - (2.0 * x(600e-9)).atan()) / std::f64::consts::PI;
        assert!(left > 1e-2 && (left..left + 1e-4).contains(&cut.error), "{left} {cut:?}");
        let off = (cut.transmittance[0][0][0] - whole.transmittance[0][0][0]).abs();
        assert!(off > 1e-5 && off < cut.error && whole.error <= 1e-4, "{cut:?} {whole:?}");
        // Too few of the wavelengths: refused.
        let table = crate::Dispersion::Table(vec![[545.0, 1.5, 0.0], [600.0, 1.5, 0.0]]);
        let short =
            Stack { materials: vec![Material { n: table, k: 0.0 }, Material::constant(1.5)], ..plate() };
        assert!(mean(&short, line, &[550e-9], &[0.0], 1e-4).is_err());
    }

    /// Ten thousand fringes in a line: more than panels are made for, and a mean with its standard error.
    #[test]
    fn more_fringes_than_can_be_resolved_are_sampled() {
        let thick = Stack::alternating(
            Material::constant(1.0),
            (Material::constant(INDEX), 0.3, 0.0),
            (Material::constant(INDEX), 0.0, 0.0),
            1,
            Material::constant(1.0),
        );
        for shape in [Shape::Gaussian, Shape::Lorentzian] {
            let found = mean(&thick, Line { shape, width: 2e-9 }, &[550e-9], &[0.0], 1e-5).unwrap();
            let off = (found.reflectance[0][0][0] - 0.08 / 1.04).abs();
            assert!(off <= found.error && found.error > 1e-5 && found.error < 3e-3, "{found:?}");
        }
    }
}
