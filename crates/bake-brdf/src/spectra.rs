//! Interference colours of a recipe for rendering: which stack, angles and wavelengths M(λ, θ) and Ê(λ, θ) take
//! ([`thinfilm::modulation`] computes them), each only where it is [`Wanted`].
//!
//! Values are means over bands of 5 nm from 380 to 780 nm of as many wavelengths as the work allows, so that fringes
//! (0.84 nm wide for 500 layers) do not alias; RGB is summed over the single wavelengths. A stack with irregular
//! thicknesses is the mean over an ensemble drawn from a fixed seed, of as many members as the accuracy takes: a pilot at a few angles
//! says how many. Angles are halved where reading between them misses more than its share.
//!
//! R_incoherent is what the walk tends to for σ → 0 at its wavelength. So lobe·M never reflects more than it receives, and for
//! σ → 0 it is R_coherent.
//!
//! Where thickness is a control the bands go on beyond the visible range, and RGB is stored at as many scales of the thicknesses as
//! reading between them takes.

use crate::effects::{Effect, EffectSet};
use crate::prices;
use crate::recipe::{Recipe, RecipeError, ThicknessRange};
use crate::three_digits;
use lut_io::spectra::{Coherent, ColourError, Emission, Missing, Spectra, Thickness, ThicknessError};
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, Ordering};
use thinfilm::colour::Xyz;
use thinfilm::emission::SourceProfile;
use thinfilm::modulation::{self, Banded, Sampling, Scaled};
use thinfilm::{Dispersion, Material, Stack, StackError, StackRun, colour, intensity};
use transport::{Light, Transport};

/// Bands over the visible range of [`colour::VISIBLE`]: 5 nm each.
const BANDS: usize = 80;
/// Steps between angles, degrees: the stop bands of a regular stack move by up to 3 nm a degree.
const FINE_STEP_DEG: usize = 1;
/// Ê, and M of irregular stacks, are smoother.
const STEP_DEG: usize = 5;
/// Stands in for 90°, where no power arrives and radiance has no meaning.
const GRAZING_DEG: f64 = 89.9;
/// Wavelengths a band from which a pilot of a regular stack starts, and of M and of Ê of an irregular one, where more members are worth
/// more (but stored energy has narrower lines); and most: 0.25 nm resolve fringes of 0.84 nm.
const REGULAR_PER_BAND: f64 = 20.0;
const IRREGULAR_PER_BAND: [f64; 2] = [2.0, 8.0];
const FINEST: f64 = 160.0;
/// Seconds of one core, by the prices, that one quantity to ΔE00 1 may take (others by the square, as their members), and that its
/// pilot may.
const AFFORDABLE: f64 = 0.6;
const PILOT: f64 = 0.05;
/// Shares of the colour difference asked for that waves, and reading between angles, aim at.
const SAMPLING_SHARE: f64 = 0.6;
const ANGLES_SHARE: f64 = 0.4;
/// Members of a pilot, fewest and most, and its angles in degrees.
const PILOT_MEMBERS: [f64; 2] = [2.0, 16.0];
const PILOT_DEG: [f64; 6] = [0.0, 20.0, 40.0, 60.0, 75.0, 85.0];
/// Angle up to which a colour is judged: beyond, the surface reflects nearly all, by M near 1, and hides the base.
const JUDGED_DEG: f64 = 85.0;
/// Fewest and most members of an ensemble of irregular stacks.
const MEMBERS: [f64; 2] = [2.0, 4096.0];
/// Rounds of halving angles, and most of them.
const ANGLE_ROUNDS: usize = 4;
const MOST_ANGLES: usize = 400;
/// Deepest part of a stack, in layers, that waves are followed in one layer at a time.
const DEEPEST: usize = 16_384;
/// Largest ΔE00 that reading between scales of the thicknesses may miss, a first number of scales an octave, and most scales.
const BETWEEN_SCALES: f64 = 0.1;
const SCALES_PER_OCTAVE: f64 = 64.0;
const MOST_SCALES: usize = 512;
/// Names the ensemble.
const SEED: u64 = 0x70_6561_726c;

/// Why a recipe has no colours.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SpectraError {
    /// The recipe itself.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// The stack, or a wave in it.
    #[error("interference colours: {0}")]
    Stack(StackError),
    /// An effect that was listed by name.
    #[error("effects: {effect} cannot be had: {source}")]
    Required {
        /// The effect.
        effect: Effect,
        /// Why it cannot be had.
        source: Box<SpectraError>,
    },
    /// They are not wanted any more.
    #[error("stopped")]
    Stopped,
}

impl From<StackError> for SpectraError {
    fn from(error: StackError) -> Self {
        match error {
            StackError::Stopped => Self::Stopped,
            other => Self::Stack(other),
        }
    }
}

/// How much an interference colour is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Want {
    /// Not at all: it costs nothing.
    #[default]
    No,
    /// By the recipe's look; a stack whose waves cannot be followed bakes without it, and the table says why.
    IfPossible,
    /// By name: a stack whose waves cannot be followed is an error.
    Required,
}

/// Which interference colours a bake is to compute, and of what stack.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Wanted {
    /// M(λ, θ), effect `coherent`.
    pub coherent: Want,
    /// Ê(λ, θ), effect `emission`.
    pub emission: Want,
    /// Whether thicknesses vary (effect `irregularity`); without, every layer has its mean thickness.
    pub irregularity: bool,
    /// Whether layers absorb (effect `absorption`).
    pub absorption: bool,
    /// Whether the lobe's walk tracks s and p (effect `polarisation`), which changes what it reflects.
    pub polarisation: bool,
    /// Whether the lobe's walk meets coherent sheets (effect `coherent_sheets`).
    pub coherent_sheets: bool,
    /// Whether thickness is a control (effect `thickness`).
    pub thickness: bool,
}

impl Wanted {
    /// What a set of effects calls for; effects that were listed by name are [`Want::Required`].
    #[must_use]
    pub const fn by_effects(effects: EffectSet, listed: bool) -> Self {
        const fn want(is_on: bool, listed: bool) -> Want {
            match (is_on, listed) {
                (false, _) => Want::No,
                (true, false) => Want::IfPossible,
                (true, true) => Want::Required,
            }
        }
        Self {
            coherent: want(effects.contains(Effect::Coherent), listed),
            emission: want(effects.contains(Effect::Emission), listed),
            irregularity: effects.contains(Effect::Irregularity),
            absorption: effects.contains(Effect::Absorption),
            polarisation: effects.contains(Effect::Polarisation),
            coherent_sheets: effects.contains(Effect::CoherentSheets),
            thickness: effects.contains(Effect::Thickness),
        }
    }
}

/// The interference colours of a recipe, and which of those wanted it cannot have.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Colours {
    /// The section for the table.
    pub spectra: Spectra,
    /// Effects that are missing, with the reason.
    pub missing: Vec<(Effect, String)>,
}

impl Colours {
    /// The effects that are there.
    #[must_use]
    pub fn effects(&self) -> EffectSet {
        let coherent = self.spectra.coherent.as_ref().map(|_| Effect::Coherent);
        coherent.into_iter().chain(self.spectra.emission.as_ref().map(|_| Effect::Emission)).collect()
    }

    /// The section of the table that holds them, if there are any.
    pub(crate) fn section(&self) -> Option<Spectra> {
        (self.effects() != EffectSet::NONE).then(|| self.spectra.rounded())
    }

    /// The section of the table that says why some are missing, if any are.
    pub(crate) fn missing_section(&self) -> Option<Missing> {
        let why =
            |effect| self.missing.iter().find(|(missing, _)| *missing == effect).map(|(_, why)| why.clone());
        let missing = Missing { coherent: why(Effect::Coherent), emission: why(Effect::Emission) };
        (!self.missing.is_empty()).then_some(missing)
    }
}

/// The colours of a recipe that are wanted, to a colour difference ΔE00 as far as the work allows: what is reached is stored. Stops soon
/// after `stop` is set, from anywhere.
///
/// # Errors
/// A recipe that the transport problem refuses; a [`Want::Required`] colour of a stack whose waves cannot be followed;
/// [`SpectraError::Stopped`].
pub fn of(
    stop: &AtomicBool,
    recipe: &Recipe,
    wanted: Wanted,
    delta_e00: f64,
) -> Result<Colours, SpectraError> {
    let beyond = beyond(recipe, wanted);
    let mut colours = Colours {
        spectra: Spectra { wavelength_nm: band_centres_nm(beyond), ..Spectra::default() },
        missing: Vec::new(),
    };
    if beyond != [0; 2] {
        let stack = wave_stack(recipe, wanted);
        let ends = [beyond_nm(beyond, 0), beyond_nm(beyond, 1)];
        let no_index = ends.into_iter().find_map(|nm| stack.at(1e-9 * nm).err());
        no_index.map_or(Ok(()), |why| {
            Err(SpectraError::Required { effect: Effect::Thickness, source: Box::new(why.into()) })
        })?;
    }
    let mut attempt = |effect, want, compute: &dyn Fn() -> Result<_, SpectraError>| {
        if want == Want::No {
            return Ok(None);
        }
        match compute() {
            Ok(part) => Ok(Some(part)),
            Err(SpectraError::Stack(why)) if want == Want::IfPossible => {
                colours.missing.push((effect, why.to_string()));
                Ok(None)
            }
            Err(SpectraError::Stopped) => Err(SpectraError::Stopped),
            Err(why) => Err(SpectraError::Required { effect, source: Box::new(why) }),
        }
    };
    let coherent = attempt(Effect::Coherent, wanted.coherent, &|| {
        coherent(stop, recipe, wanted, delta_e00).map(|(part, rows)| Part::Coherent(part, rows))
    })?;
    let emission = attempt(Effect::Emission, wanted.emission, &|| {
        emission(stop, recipe, wanted, delta_e00).map(|(part, rows)| Part::Emission(part, rows))
    })?;
    let mut scalable = Vec::new();
    for part in coherent.into_iter().chain(emission) {
        match part {
            Part::Coherent(part, rows) => {
                colours.spectra.coherent = Some(part);
                scalable.push(rows);
            }
            Part::Emission(part, rows) => {
                colours.spectra.emission = Some(part);
                scalable.push(rows);
            }
        }
    }
    if wanted.thickness && !scalable.is_empty() {
        colours.spectra.thickness = Some(thickness(stop, recipe, wanted, &scalable)?);
    }
    Ok(colours)
}

enum Part {
    Coherent(Coherent, Scalable),
    Emission(Emission, Scalable),
}

/// A colour by its single wavelengths, from which it follows at any scale of the thicknesses.
struct Scalable {
    theta_deg: Vec<f64>,
    rows: Vec<Banded>,
    sampling: Sampling,
    /// Largest value at each angle.
    most: Vec<f64>,
    /// What it is.
    kind: Quantity,
}

/// At each angle, linear sRGB and the mean that it is in units of (1 of M).
type Row = Vec<([f64; 3], f64)>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Quantity {
    Modulation,
    Emission,
}

impl Quantity {
    /// Ê has unit mean; a stack that gives off nothing has 1.
    fn mean(self, scaled: &Scaled, row: &Banded) -> f64 {
        let mean = if self == Self::Emission { scaled.mean(&row.spectrum) } else { 1.0 };
        if mean > 0.0 { mean } else { 1.0 }
    }
}

impl Scalable {
    /// The colour at a scale.
    fn at(&self, stop: &AtomicBool, scale: f64) -> Result<Row, SpectraError> {
        go_on(stop)?;
        let scaled = Scaled::new(self.sampling, scale);
        let row = |(row, most): (&Banded, &f64)| {
            if scale == 1.0 {
                return (row.rgb, 1.0);
            }
            let mean = self.kind.mean(&scaled, row);
            (scaled.rgb(&row.spectrum, most * mean).map(|channel| channel / mean), mean)
        };
        Ok(self.rows.par_iter().zip(&self.most).map(row).collect())
    }

    /// ΔE00 that reading between neighbouring scales misses half-way, at the worst angle.
    fn missed(&self, stop: &AtomicBool, scale: &[f64], nodes: &[Row]) -> Result<f64, SpectraError> {
        let judged = self.theta_deg.partition_point(|degrees| *degrees <= JUDGED_DEG);
        let mut worst = 0.0f64;
        for k in 0..scale.len() - 1 {
            let middle = self.at(stop, (scale[k] * scale[k + 1]).sqrt())?;
            let missed = |i: usize| {
                let read = [0, 1, 2].map(|c| 0.5 * (nodes[k][i].0[c] + nodes[k + 1][i].0[c]));
                let lab = |rgb| colour::lab(colour::xyz_of_linear_srgb(rgb));
                colour::delta_e_2000(lab(read), lab(middle[i].0))
            };
            worst = (0..judged).map(missed).fold(worst, f64::max);
        }
        Ok(worst)
    }
}

/// The colours at as many scales as reading between them takes.
fn thickness(
    stop: &AtomicBool,
    recipe: &Recipe,
    wanted: Wanted,
    parts: &[Scalable],
) -> Result<Thickness, SpectraError> {
    let mut per_octave = SCALES_PER_OCTAVE;
    let (scale, nodes, missed) = loop {
        let scale = scales(recipe, per_octave);
        let at_all = |part: &Scalable| scale.iter().map(|scale| part.at(stop, *scale)).collect();
        let nodes: Vec<Vec<Row>> = parts.iter().map(at_all).collect::<Result<_, SpectraError>>()?;
        let mut missed = 0.0f64;
        for (part, nodes) in parts.iter().zip(&nodes) {
            missed = missed.max(part.missed(stop, &scale, nodes)?);
        }
        // The error goes by the square of the distance.
        let finer = per_octave * (1.1 * (missed / BETWEEN_SCALES).sqrt()).clamp(1.1, 4.0);
        if missed <= BETWEEN_SCALES || scales(recipe, finer).len() > MOST_SCALES {
            break (scale, nodes, missed);
        }
        per_octave = finer;
    };
    let scaling = parts.iter().map(|part| scaling_error(stop, recipe, wanted, part));
    let scaling = scaling.collect::<Result<Vec<_>, _>>()?.into_iter().fold(0.0, f64::max);
    let delta_e00 = ThicknessError { scales: three_digits(missed), scaling: three_digits(scaling) };
    let mut thickness = Thickness { scale, delta_e00, ..Thickness::default() };
    for (part, nodes) in parts.iter().zip(nodes) {
        let rgb = nodes.iter().map(|rows| rows.iter().map(|(rgb, _)| *rgb).collect()).collect();
        if part.kind == Quantity::Modulation {
            thickness.modulation_rgb = rgb;
        } else {
            thickness.radiance_rgb = rgb;
            thickness.radiance_mean =
                nodes.iter().map(|rows| rows.iter().map(|(_, mean)| *mean).collect()).collect();
        }
    }
    Ok(thickness)
}

/// Scales from one end of a recipe's range to the other, so many an octave or a little more: 1 among them, ratios equal on either side.
fn scales(recipe: &Recipe, per_octave: f64) -> Vec<f64> {
    let ThicknessRange { min, max } = recipe.look.thickness.unwrap_or_default();
    let steps = |end: f64| (end.log2().abs() * per_octave).ceil() as usize;
    let side =
        |end: f64, k: usize| if k == steps(end) { end } else { end.powf(k as f64 / steps(end) as f64) };
    let below = (1..=steps(min)).rev().map(|k| side(min, k));
    below.chain([1.0]).chain((1..=steps(max)).map(|k| side(max, k))).collect()
}

/// ΔE00 between colours of stacks of the smallest and the largest thickness and what scaling makes of this one.
fn scaling_error(
    stop: &AtomicBool,
    recipe: &Recipe,
    wanted: Wanted,
    part: &Scalable,
) -> Result<f64, SpectraError> {
    let profile = recipe.source_profile();
    let stack = match part.kind {
        Quantity::Modulation => wave_stack(recipe, wanted),
        Quantity::Emission => emission_stack(recipe, wanted),
    };
    let fixed_depth = part.kind == Quantity::Emission && matches!(profile, SourceProfile::Exponential { .. });
    if !depends_on_wavelength(&stack) && !fixed_depth {
        return Ok(0.0);
    }
    let transport = walked(recipe, wanted, recipe.wavelength())?;
    let ThicknessRange { min, max } = recipe.look.thickness.unwrap_or_default();
    Ok(apart_at(stop, &stack, profile, &transport, part.kind, part.sampling, &[min, max])?)
}

/// The largest ΔE00, at the angles of a pilot, between what scaling makes of a stack and stacks of such thicknesses.
fn apart_at(
    stop: &AtomicBool,
    stack: &Stack,
    profile: SourceProfile,
    transport: &Transport,
    kind: Quantity,
    sampling: Sampling,
    scales: &[f64],
) -> Result<f64, StackError> {
    let solved = |stack: &Stack, sampling: Sampling| match kind {
        Quantity::Modulation => reflected(stop, stack, transport, &PILOT_DEG, sampling),
        Quantity::Emission => modulation::emission(stop, stack, profile, &radians(&PILOT_DEG), sampling),
    };
    let own = solved(stack, sampling)?;
    let mut worst = 0.0f64;
    for scale in scales {
        let mut other = stack.clone();
        for layer in other.runs.iter_mut().flat_map(|run| &mut run.unit) {
            layer.thickness *= scale;
            layer.thickness_sd *= scale;
        }
        let truth = solved(&other, Sampling { beyond: [0; 2], ..sampling })?;
        let scaled = Scaled::new(sampling, *scale);
        for (own, truth) in own.iter().zip(&truth) {
            let mean = kind.mean(&scaled, own);
            let found = scaled.xyz(&own.spectrum).map(|x| x / mean);
            worst = worst.max(colour::delta_e_2000(colour::lab(found), colour::lab(truth.xyz)));
        }
    }
    Ok(worst)
}

fn depends_on_wavelength(stack: &Stack) -> bool {
    let media = stack.materials.iter().chain([&stack.ambient, &stack.substrate]);
    media.into_iter().any(|material| !matches!(material.n, Dispersion::Constant(_)))
}

/// Bands beyond the visible range, below and above it, that the scales of a recipe take.
fn beyond(recipe: &Recipe, wanted: Wanted) -> [usize; 2] {
    if !wanted.thickness {
        return [0; 2];
    }
    let ThicknessRange { min, max } = recipe.look.thickness.unwrap_or_default();
    let [from, to] = colour::VISIBLE;
    let width = (to - from) / BANDS as f64;
    // Rounding takes no band more.
    [from - from / max, to / min - to].map(|range| (range / width - 1e-9).ceil() as usize)
}

/// First or last wavelength of the bands, nm.
fn beyond_nm(beyond: [usize; 2], end: usize) -> f64 {
    let [from, to] = colour::VISIBLE.map(|metres| 1e9 * metres);
    let width = (to - from) / BANDS as f64;
    if end == 0 { from - width * beyond[0] as f64 } else { to + width * beyond[1] as f64 }
}

/// The walk at a wavelength (metres) whose lobe the coherent colours multiply.
fn walked(recipe: &Recipe, wanted: Wanted, wavelength: f64) -> Result<Transport, RecipeError> {
    let mut transport = if wanted.coherent_sheets {
        recipe.sheet_transport(wavelength)
    } else {
        recipe.transport(wavelength)
    }?;
    if !wanted.absorption {
        transport.make_clear();
    }
    if wanted.polarisation {
        transport.light = Light::Tracked;
    }
    Ok(transport)
}

fn go_on(stop: &AtomicBool) -> Result<(), SpectraError> {
    if stop.load(Ordering::Relaxed) { Err(SpectraError::Stopped) } else { Ok(()) }
}

/// R_incoherent of the walk at a wavelength (nm), at the angles that colours are stored for.
pub(crate) fn incoherent(
    recipe: &Recipe,
    wanted: Wanted,
    nm: f64,
    theta_deg: &[f64],
) -> Result<Vec<f64>, RecipeError> {
    let transport = walked(recipe, wanted, 1e-9 * nm)?;
    Ok(radians(theta_deg).iter().map(|theta| incoherent_reflectance(&transport, *theta)).collect())
}

fn coherent(
    stop: &AtomicBool,
    recipe: &Recipe,
    wanted: Wanted,
    delta_e00: f64,
) -> Result<(Coherent, Scalable), SpectraError> {
    let transport = walked(recipe, wanted, recipe.wavelength())?;
    let stack = wave_stack(recipe, wanted);
    let effort = Effort::of_coherent(stop, &stack, &transport, delta_e00, beyond(recipe, wanted))?;
    let of = |theta_deg: &[f64]| reflected(stop, &stack, &transport, theta_deg, effort.sampling());
    let Curve { theta_deg, rows, error } = curve(&effort, delta_e00, of)?;
    let angles = radians(&theta_deg);
    let incoherent: Vec<f64> =
        angles.par_iter().map(|theta| incoherent_reflectance(&transport, *theta)).collect();
    let (modulation, modulation_rgb) = columns(&rows);
    let scalable = Scalable {
        theta_deg: theta_deg.clone(),
        rows,
        sampling: effort.sampling(),
        most: incoherent.iter().map(|r| 1.0 / r).collect(),
        kind: Quantity::Modulation,
    };
    Ok((Coherent { theta_deg, modulation, modulation_rgb, incoherent, delta_e00: error }, scalable))
}

fn reflected(
    stop: &AtomicBool,
    stack: &Stack,
    transport: &Transport,
    theta_deg: &[f64],
    sampling: Sampling,
) -> Result<Vec<Banded>, StackError> {
    let angles = radians(theta_deg);
    let incoherent: Vec<f64> =
        angles.par_iter().map(|theta| incoherent_reflectance(transport, *theta)).collect();
    modulation::modulation(stop, stack, &incoherent, &angles, sampling)
}

fn emission(
    stop: &AtomicBool,
    recipe: &Recipe,
    wanted: Wanted,
    delta_e00: f64,
) -> Result<(Emission, Scalable), SpectraError> {
    // Refuses what the bake refuses, with its words.
    recipe.transport(recipe.wavelength())?;
    let stack = emission_stack(recipe, wanted);
    let profile = recipe.source_profile();
    let effort = Effort::of_emission(stop, &stack, profile, delta_e00, beyond(recipe, wanted))?;
    let of = |theta_deg: &[f64]| {
        modulation::emission(stop, &stack, profile, &radians(theta_deg), effort.sampling())
    };
    let Curve { theta_deg, rows, error } = curve(&effort, delta_e00, of)?;
    let (radiance, radiance_rgb) = columns(&rows);
    let scalable = Scalable {
        theta_deg: theta_deg.clone(),
        most: vec![f64::INFINITY; rows.len()],
        rows,
        sampling: effort.sampling(),
        kind: Quantity::Emission,
    };
    Ok((Emission { theta_deg, radiance, radiance_rgb, delta_e00: error }, scalable))
}

fn columns(rows: &[Banded]) -> (Vec<Vec<f64>>, Vec<[f64; 3]>) {
    rows.iter().map(|row| (row.bands.clone(), row.rgb)).unzip()
}

/// A colour over angles.
struct Curve {
    theta_deg: Vec<f64>,
    rows: Vec<Banded>,
    error: ColourError,
}

/// A colour at the angles of an effort, more where reading between them misses more than its share of a colour difference.
fn curve(
    effort: &Effort,
    delta_e00: f64,
    of: impl Fn(&[f64]) -> Result<Vec<Banded>, StackError>,
) -> Result<Curve, StackError> {
    let mut nodes: Vec<(f64, Banded)> = PILOT_DEG.into_iter().zip(effort.pilot.iter().cloned()).collect();
    let first = effort.theta_deg.iter().copied();
    let others: Vec<f64> = first.filter(|theta| nodes.iter().all(|(known, _)| known != theta)).collect();
    nodes.extend(others.iter().copied().zip(of(&others)?));
    nodes.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut missed = missed_between(&nodes);
    for _ in 0..ANGLE_ROUNDS {
        let wide = |i: &usize| nodes[*i].0 < JUDGED_DEG && missed[*i] > ANGLES_SHARE * delta_e00;
        let middles: Vec<f64> =
            (0..missed.len()).filter(wide).map(|i| 0.5 * (nodes[i].0 + nodes[i + 1].0)).collect();
        if middles.is_empty() || nodes.len() + middles.len() > MOST_ANGLES {
            break;
        }
        nodes.extend(middles.iter().copied().zip(of(&middles)?));
        nodes.sort_by(|a, b| a.0.total_cmp(&b.0));
        missed = missed_between(&nodes);
    }
    let judged = nodes.partition_point(|(degrees, _)| *degrees <= JUDGED_DEG);
    let worst =
        |of: &dyn Fn(&Banded) -> f64| nodes[..judged].iter().map(|(_, row)| of(row)).fold(0.0, f64::max);
    let known = nodes.iter().all(|(_, row)| row.sampling().is_some());
    let error = ColourError {
        sampling: known.then(|| three_digits(worst(&|row| row.sampling().unwrap_or(0.0)))),
        angles: three_digits(missed[..judged - 1].iter().copied().fold(0.0, f64::max)),
        bands: three_digits(worst(&|row| row.between_bands)),
    };
    let (theta_deg, rows) = nodes.into_iter().unzip();
    Ok(Curve { theta_deg, rows, error })
}

/// ΔE00 that reading misses in the middle of each interval: a quarter of what its ends are missed by from their neighbours (halves of
/// intervals as wide), beyond three standard errors of noise.
fn missed_between(nodes: &[(f64, Banded)]) -> Vec<f64> {
    let bends: Vec<f64> = nodes
        .windows(3)
        .map(|three| {
            let [(a, before), (b, here), (c, after)] = [&three[0], &three[1], &three[2]];
            let t = (b - a) / (c - a);
            let bent = |[before, here, after]: [&Xyz; 3]| {
                let read = [0, 1, 2].map(|i: usize| (1.0 - t) * before[i] + t * after[i]);
                colour::delta_e_2000(colour::lab(read), colour::lab(*here))
            };
            let ends = before.ends.iter().zip(&here.ends).zip(&after.ends);
            let bent = ends
                .map(|((before, here), after)| bent([before, here, after]))
                .fold(bent([&before.xyz, &here.xyz, &after.xyz]), f64::max);
            let noise = [(before, 1.0 - t), (here, 1.0), (after, t)]
                .map(|(row, share)| 1.5 * share * row.noise.unwrap_or(0.0));
            let noise2: f64 = noise.iter().map(|noise| noise * noise).sum();
            // The error of reading is the product of both parts of the interval.
            (bent * bent - noise2).max(0.0).sqrt() / ((b - a) * (c - b))
        })
        .collect();
    let intervals = nodes.len() - 1;
    (0..intervals)
        .map(|i| {
            let width = nodes[i + 1].0 - nodes[i].0;
            let left = bends.get(i.wrapping_sub(1)).or(bends.first());
            let right = bends.get(i).or(bends.last());
            let bend = left.into_iter().chain(right).copied().fold(0.0, f64::max);
            0.25 * width * width * bend
        })
        .collect()
}

fn absorbs(stack: &Stack) -> bool {
    stack.materials.iter().any(|material| {
        let in_table = matches!(&material.n, Dispersion::Table(rows) if rows.iter().any(|row| row[2] != 0.0));
        material.k != 0.0 || in_table
    })
}

/// Waves that M and Ê take to a colour difference ΔE00, and layers that those pass; 0 where a colour is not wanted or cannot be had. The pilot
/// of an irregular stack is run, unless `stop` is set.
#[must_use]
pub fn counts(stop: &AtomicBool, recipe: &Recipe, wanted: Wanted, delta_e00: f64) -> [[f64; 2]; 2] {
    let count = |stack: &Stack, effort: Result<Effort, SpectraError>| {
        let waves = effort.map_or(0.0, |effort| effort.waves());
        [waves, waves * stack.layer_count() as f64]
    };
    let coherent = || {
        let stack = wave_stack(recipe, wanted);
        let effort =
            walked(recipe, wanted, recipe.wavelength()).map_err(SpectraError::from).and_then(|transport| {
                Effort::of_coherent(stop, &stack, &transport, delta_e00, beyond(recipe, wanted))
            });
        count(&stack, effort)
    };
    let emission = || {
        let stack = emission_stack(recipe, wanted);
        let profile = recipe.source_profile();
        let effort = Effort::of_emission(stop, &stack, profile, delta_e00, beyond(recipe, wanted));
        count(&stack, effort)
    };
    [
        if wanted.coherent == Want::No { [0.0; 2] } else { coherent() },
        if wanted.emission == Want::No { [0.0; 2] } else { emission() },
    ]
}

/// Seconds of one core that M and Ê take to a colour difference ΔE00, each 0 where it is not wanted. Pilots stop soon after `stop` is set.
#[must_use]
pub fn forecast(stop: &AtomicBool, recipe: &Recipe, wanted: Wanted, delta_e00: f64) -> [f64; 2] {
    let [coherent, emission] = counts(stop, recipe, wanted, delta_e00);
    let wave = reflectance_price(&wave_stack(recipe, wanted));
    let field = field_price(&emission_stack(recipe, wanted), recipe.source_profile());
    [prices::sum(&coherent, &wave), prices::sum(&emission, &field)]
}

/// Seconds of a wave through a stack by itself, and for each layer.
fn reflectance_price(stack: &Stack) -> [f64; 2] {
    let repeats = !stack.is_irregular() && stack.runs.iter().any(|run| run.repeat > 1);
    // Repeated units of a deep stack are doubled.
    let deep = stack.layer_count() > DEEPEST as u128;
    if deep { prices::DOUBLED } else { prices::reflectance(repeats, absorbs(stack)) }
}

/// The same with its field.
fn field_price(stack: &Stack, profile: SourceProfile) -> [f64; 2] {
    if profile == SourceProfile::Substrate { reflectance_price(stack) } else { prices::FIELD }
}

/// How finely a quantity is sampled.
struct Effort {
    theta_deg: Vec<f64>,
    /// Wavelengths a band.
    per_band: f64,
    /// Members of an ensemble.
    members: f64,
    /// As [`Sampling::beyond`].
    beyond: [usize; 2],
    /// The colour at [`PILOT_DEG`], sampled so; nothing where it was sampled otherwise.
    pilot: Vec<Banded>,
}

impl Effort {
    /// Of M.
    fn of_coherent(
        stop: &AtomicBool,
        stack: &Stack,
        transport: &Transport,
        delta_e00: f64,
        beyond: [usize; 2],
    ) -> Result<Self, SpectraError> {
        let step = if stack.is_irregular() { STEP_DEG } else { FINE_STEP_DEG };
        let pilot = |sampling| reflected(stop, stack, transport, &PILOT_DEG, sampling);
        let per_band = if stack.is_irregular() { IRREGULAR_PER_BAND[0] } else { REGULAR_PER_BAND };
        let first = Self { theta_deg: angles_deg(step), per_band, members: 1.0, beyond, pilot: Vec::new() };
        first.chosen(stack, reflectance_price(stack), delta_e00, pilot)
    }

    /// Of Ê.
    fn of_emission(
        stop: &AtomicBool,
        stack: &Stack,
        profile: SourceProfile,
        delta_e00: f64,
        beyond: [usize; 2],
    ) -> Result<Self, SpectraError> {
        let pilot = |sampling| modulation::emission(stop, stack, profile, &radians(&PILOT_DEG), sampling);
        let per_band = IRREGULAR_PER_BAND[1];
        let first =
            Self { theta_deg: angles_deg(STEP_DEG), per_band, members: 1.0, beyond, pilot: Vec::new() };
        first.chosen(stack, field_price(stack, profile), delta_e00, pilot)
    }

    /// As many wavelengths, and members of an irregular stack, as a pilot finds necessary and the work allows.
    fn chosen(
        self,
        stack: &Stack,
        price: [f64; 2],
        delta_e00: f64,
        pilot: impl Fn(Sampling) -> Result<Vec<Banded>, StackError>,
    ) -> Result<Self, SpectraError> {
        // A wavelength a band, of one member, in both polarisations.
        let wave = prices::sum(&[1.0, stack.layer_count() as f64], &price);
        let bands = self.sampling().all_bands();
        let seconds = |angles: usize| (2 * bands * angles) as f64 * wave;
        let affordable = (AFFORDABLE / (delta_e00.powi(2) * seconds(self.theta_deg.len()))).max(1.0).floor();
        let aim = SAMPLING_SHARE * delta_e00;
        let mut effort = Self { per_band: self.per_band.min(affordable), ..self };
        if stack.is_irregular() {
            let [fewest, enough] = PILOT_MEMBERS;
            let members = PILOT / (effort.per_band * seconds(PILOT_DEG.len()));
            effort.members = members.clamp(fewest, enough).floor();
        }
        // Fringes that all members share take more wavelengths; what is noise takes more members.
        let (noise, rows) = loop {
            let rows = pilot(effort.sampling())?;
            let worst = |of: &dyn Fn(&Banded) -> Option<f64>| rows.iter().filter_map(of).fold(0.0, f64::max);
            let (noise, change) = (worst(&|row| row.noise), worst(&|row| row.change));
            if change <= aim.max(noise) || 2.0 * effort.per_band > affordable.min(FINEST) {
                break (noise, rows);
            }
            effort.per_band *= 2.0;
        };
        let piloted = effort.members;
        if stack.is_irregular() {
            let [fewest, most] = MEMBERS;
            let wanted = (effort.members * (noise / aim).powi(2)).ceil();
            effort.members = wanted.min((affordable / effort.per_band).floor()).clamp(fewest, most);
        }
        if effort.members == piloted {
            effort.pilot = rows;
        }
        Ok(effort)
    }

    /// Wavelengths × angles × polarisations × members.
    fn waves(&self) -> f64 {
        (2 * self.sampling().all_bands() * self.theta_deg.len()) as f64 * self.per_band * self.members
    }

    const fn sampling(&self) -> Sampling {
        Sampling {
            bands: BANDS,
            beyond: self.beyond,
            per_band: self.per_band as usize,
            members: self.members as u64,
            seed: SEED,
        }
    }
}

fn angles_deg(step: usize) -> Vec<f64> {
    (0..=90).step_by(step).map(|degrees| degrees as f64).collect()
}

fn radians(theta_deg: &[f64]) -> Vec<f64> {
    theta_deg.iter().map(|degrees| degrees.min(GRAZING_DEG).to_radians()).collect()
}

fn band_centres_nm([below, above]: [usize; 2]) -> Vec<f64> {
    let edge = |band: f64| {
        1e9 * (colour::VISIBLE[0] + (colour::VISIBLE[1] - colour::VISIBLE[0]) * band / BANDS as f64)
    };
    (0..below + BANDS + above).map(|band| edge(band as f64 - below as f64 + 0.5)).collect()
}

/// The recipe's stack for waves over the bands: a tabulated index stays constant beyond its table, and of an
/// irregular or explicit stack only the uppermost layers are followed.
fn wave_stack(recipe: &Recipe, wanted: Wanted) -> Stack {
    let mut stack = recipe.film_stack();
    if !wanted.absorption {
        stack.materials.iter_mut().for_each(make_clear);
    }
    if !wanted.irregularity {
        stack.runs.iter_mut().flat_map(|run| &mut run.unit).for_each(|layer| layer.thickness_sd = 0.0);
    }
    let media = stack.materials.iter_mut().chain([&mut stack.ambient, &mut stack.substrate]);
    let beyond = beyond(recipe, wanted);
    // Rounding leaves no wavelength outside.
    let margin_nm = if wanted.thickness { 1.0 } else { 0.0 };
    let range_nm = [beyond_nm(beyond, 0) - margin_nm, beyond_nm(beyond, 1) + margin_nm];
    media.for_each(|material| hold_constant(material, range_nm));
    let periodic = stack.runs.iter().any(|run| run.repeat > 1);
    if stack.is_irregular() || !periodic { shortened(stack, DEEPEST) } else { stack }
}

/// Fields are followed through the uppermost layers only; light from below the stack needs none.
fn emission_stack(recipe: &Recipe, wanted: Wanted) -> Stack {
    let stack = wave_stack(recipe, wanted);
    if recipe.source_profile() == SourceProfile::Substrate { stack } else { shortened(stack, DEEPEST) }
}

fn make_clear(material: &mut Material) {
    material.k = 0.0;
    if let Dispersion::Table(rows) = &mut material.n {
        rows.iter_mut().for_each(|row| row[2] = 0.0);
    }
}

/// Extends a tabulated index to a range.
fn hold_constant(material: &mut Material, [first_nm, last_nm]: [f64; 2]) {
    let Dispersion::Table(rows) = &mut material.n else { return };
    if let Some(&[nm, n, k]) = rows.first()
        && nm > first_nm
    {
        rows.insert(0, [first_nm, n, k]);
    }
    if let Some(&[nm, n, k]) = rows.last()
        && nm < last_nm
    {
        rows.push([last_nm, n, k]);
    }
}

/// The uppermost `most` layers of a stack, or a few less to end with a whole period.
fn shortened(mut stack: Stack, most: usize) -> Stack {
    let mut room = most;
    let cut = |run: StackRun| {
        let length = run.unit.len();
        let repeat = run.repeat.min((room / length.max(1)) as u64);
        let unit = if repeat == 0 { run.unit[..room.min(length)].to_vec() } else { run.unit };
        let repeat = repeat.max(1);
        room -= unit.len() * repeat as usize;
        StackRun { unit, repeat }
    };
    stack.runs = stack.runs.into_iter().map(cut).filter(|run| !run.unit.is_empty()).collect();
    stack
}

/// R_incoherent: the walk with flat interfaces, in the walk's light and at its sheets.
pub(crate) fn incoherent_reflectance(transport: &Transport, theta: f64) -> f64 {
    let Transport { optical_depths, sheets, .. } = transport;
    let indices: Vec<_> = (0..transport.indices.len()).map(|medium| transport.index(medium)).collect();
    let sheet = |interface: usize, cosine: f64| {
        let sheets = sheets.filter(|sheets| (1..=sheets.last).contains(&interface))?;
        Some(sheets.reflectance(indices[interface].re, cosine))
    };
    let of =
        |share_of_s| intensity::incoherent(&indices, optical_depths, theta, share_of_s, sheet).reflectance;
    let reflectance = match transport.light {
        Light::Unpolarised => of(0.5),
        Light::Tracked => 0.5 * (of(1.0) + of(0.0)),
        Light::S => of(1.0),
        Light::P => of(0.0),
    };
    // A stack that matches the ambient reflects nothing coherently either; the floor keeps the quotient finite.
    reflectance.max(1e-6)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::NEVER;
    use crate::bake::{self, Observer, Request};
    use crate::options::{Options, Target};

    const BOTH: Wanted = Wanted {
        coherent: Want::Required,
        emission: Want::Required,
        irregularity: true,
        absorption: true,
        polarisation: false,
        coherent_sheets: false,
        thickness: false,
    };

    fn of(recipe: &Recipe, wanted: Wanted, delta_e00: f64) -> Result<Colours, SpectraError> {
        super::of(&NEVER, recipe, wanted, delta_e00)
    }

    fn forecast(recipe: &Recipe, wanted: Wanted, delta_e00: f64) -> [f64; 2] {
        super::forecast(&NEVER, recipe, wanted, delta_e00)
    }

    fn recipe(text: &str) -> Recipe {
        Recipe::from_json(text).unwrap()
    }

    fn both(text: &str) -> (Coherent, Emission) {
        let spectra = of(&recipe(text), BOTH, 1.0).unwrap().spectra;
        spectra.validate().unwrap();
        (spectra.coherent.unwrap(), spectra.emission.unwrap())
    }

    #[test]
    fn the_papers_incoherent_reflectance_is_the_albedo_of_its_flat_walk() {
        // Two-stream sum of 500 inner interfaces of reflectance ((1.53 − 1.43)/(1.53 + 1.43))² under one of 1.53.
        let r = (0.1f64 / 2.96).powi(2);
        let inner = 500.0 * r / (1.0 + 499.0 * r);
        let outer = (0.53f64 / 2.53).powi(2);
        let expected = outer + (1.0 - outer).powi(2) * inner / (1.0 - outer * inner);
        let found = incoherent_reflectance(&Transport::paper(), 0.0);
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }

    #[test]
    fn a_short_regular_stack_has_valid_colours_bounded_by_its_energy() {
        let (coherent, emission) = both(r#"{"stack": {"layers": 7}}"#);
        for (i, row) in coherent.modulation.iter().enumerate() {
            let most = 1.0 / coherent.incoherent[i];
            assert!(row.iter().chain(&coherent.modulation_rgb[i]).all(|m| *m <= most + 1e-12));
        }
        for row in &emission.radiance {
            let mean = row.iter().sum::<f64>() / BANDS as f64;
            assert!((mean - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_band_is_the_mean_reflectance_of_the_stack_in_it() {
        // One film, solved wave by wave with the general solver, far more finely than a band.
        let recipe = recipe(r#"{"stack": {"layers": 3}}"#);
        let (coherent, _) = both(r#"{"stack": {"layers": 3}}"#);
        let (band, degrees) = (33, 40);
        let waves = 500;
        let mean: f64 = (0..waves)
            .map(|i| {
                let nm = 380.0 + 5.0 * (band as f64 + (f64::from(i) + 0.5) / f64::from(waves));
                let stack = recipe.film_stack().at(nm * 1e-9).unwrap();
                let angle = thinfilm::Incidence::Angle((degrees as f64).to_radians());
                let r = |pol| stack.solve(nm * 1e-9, angle, pol).unwrap().reflectance;
                thinfilm::Polarisation::BOTH.map(r).iter().sum::<f64>() / 2.0
            })
            .sum::<f64>()
            / f64::from(waves);
        let found = coherent.modulation[degrees][band] * coherent.incoherent[degrees];
        assert!((found - mean).abs() < 1e-5 * mean, "{found} {mean}");
    }

    #[test]
    fn a_stack_of_one_index_has_no_hue_but_that_of_its_surface() {
        // One thick layer of the substrate's own material: a single interface, coherent = incoherent.
        let (coherent, emission) =
            both(r#"{"stack": {"explicit": [{"n": 1.5, "thickness_nm": 1000}], "substrate": {"n": 1.5}}}"#);
        for row in &coherent.modulation[..coherent.modulation.len() - 1] {
            assert!(row.iter().all(|m| (m - 1.0).abs() < 1e-9), "{row:?}");
        }
        for rgb in emission.radiance_rgb {
            assert!(rgb.iter().all(|c| (c - 1.0).abs() < 1e-6), "{rgb:?}");
        }
    }

    #[test]
    fn the_incoherent_reflectance_is_that_of_the_walk_that_is_baked() {
        let smooth = recipe(r#"{"stack":{"layers":60},"facets":{"slope_sd_deg":0}}"#);
        let effects = [Effect::Surface, Effect::Blur, Effect::Azimuth];
        for extra in [vec![], vec![Effect::Polarisation], vec![Effect::CoherentSheets, Effect::Polarisation]]
        {
            let set: EffectSet = effects.into_iter().chain(extra).collect();
            let options = Options {
                incident_deg: Some(vec![60.0]),
                target: Target::Paths(200_000),
                seed: 2,
                event_cap: 1_000_000,
                ..Options::default()
            };
            let request = Request::of(smooth.clone(), set, options).unwrap();
            let table = bake::walk(&request, &request.bands().unwrap(), &Observer::idle(), None).unwrap();
            let walk = walked(&smooth, Wanted::by_effects(set, false), smooth.wavelength()).unwrap();
            let expected = incoherent_reflectance(&walk, 60_f64.to_radians());
            // Five standard errors of 200,000 paths.
            let error = (expected * (1.0 - expected) / 200_000.0).sqrt();
            let found = table.meta().per_incidence[0].albedo;
            assert!((found - expected).abs() < 5.0 * error, "{set:?}: {found} {expected}");
        }
    }

    #[test]
    fn a_tabulated_index_that_ends_inside_the_visible_is_held_constant() {
        let table = |rows: &str| {
            format!(r#"{{"stack": {{"explicit": [{{"n": {{"table": {rows}}}, "thickness_nm": 300}}]}}}}"#)
        };
        let (short, _) = both(&table("[[540, 1.5, 0], [560, 1.6, 0]]"));
        let (long, _) = both(&table("[[300, 1.5, 0], [540, 1.5, 0], [560, 1.6, 0], [800, 1.6, 0]]"));
        assert_eq!(short, long);
    }

    #[test]
    fn irregular_stacks_are_reproducible_on_any_number_of_threads() {
        let irregular = recipe(r#"{"stack": {"layers": 6, "aragonite": {"thickness_sd_nm": 20}}}"#);
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| of(&irregular, BOTH, 1.0).unwrap())
        };
        assert_eq!(on(1), on(3));
    }

    /// Colours at stored angles and half-way, against an ensemble of another seed, with more members and wavelengths.
    #[test]
    fn colours_are_as_near_as_they_say_at_angles_and_between_them() {
        let cases = [
            (r#"{"layers": 12, "aragonite": {"thickness_sd_nm": 10}}"#, 4.0),
            (r#"{"layers": 12, "aragonite": {"thickness_sd_nm": 10}}"#, 2.0),
            (r#"{"layers": 150, "conchiolin": {"thickness_sd_nm": 3}}"#, 1.0),
            (r#"{"layers": 1, "aragonite": {"thickness_nm": 1500}}"#, 1.0),
            (r#"{"layers": 40, "aragonite": {"k": 1e-3}}"#, 1.0),
        ];
        for (stack, asked) in cases {
            let recipe = recipe(&format!(r#"{{"stack": {stack}}}"#));
            let transport = walked(&recipe, BOTH, recipe.wavelength()).unwrap();
            let stack = wave_stack(&recipe, BOTH);
            let effort = Effort::of_coherent(&NEVER, &stack, &transport, asked, [0; 2]).unwrap();
            let of = |theta_deg: &[f64], sampling| {
                reflected(&NEVER, &stack, &transport, theta_deg, sampling).unwrap()
            };
            if !effort.pilot.is_empty() {
                // What is taken of the pilot is what would be solved again.
                assert_eq!(effort.pilot, of(&PILOT_DEG, effort.sampling()), "{recipe:?}");
            }
            assert!(stack.is_irregular() || !effort.pilot.is_empty(), "{recipe:?}");
            let curve = curve(&effort, asked, |theta_deg| Ok(of(theta_deg, effort.sampling()))).unwrap();
            let ColourError { sampling, angles, bands } = curve.error;
            let said = sampling.unwrap().hypot(angles);
            assert!(said + bands <= 1.5 * asked, "{recipe:?}: {:?} of {asked}", curve.error);
            let judged = curve.theta_deg.partition_point(|degrees| *degrees < JUDGED_DEG);
            let probes: Vec<usize> = (0..judged).step_by(curve.rows.len() / 6).collect();
            let middle = |i: usize| 0.5 * (curve.theta_deg[i] + curve.theta_deg[i + 1]);
            let theta_deg: Vec<f64> = probes.iter().flat_map(|i| [curve.theta_deg[*i], middle(*i)]).collect();
            let finer = Sampling { seed: 99, members: 4 * effort.members as u64, ..effort.sampling() };
            let truth = of(&theta_deg, Sampling { per_band: 2 * finer.per_band, ..finer });
            for (k, i) in probes.iter().enumerate() {
                let (here, next) = (&curve.rows[*i].xyz, &curve.rows[i + 1].xyz);
                let between = [0, 1, 2].map(|c: usize| 0.5 * (here[c] + next[c]));
                for (read, truth) in [(*here, &truth[2 * k]), (between, &truth[2 * k + 1])] {
                    let off = colour::delta_e_2000(colour::lab(read), colour::lab(truth.xyz));
                    // Three standard errors of the noise.
                    assert!(off <= 1.5 * said, "{recipe:?}, {}°: {off}, {:?}", theta_deg[2 * k], curve.error);
                }
            }
        }
    }

    #[test]
    fn more_accuracy_takes_more_members_and_a_deep_irregular_stack_says_what_it_reached() {
        let members = |text: &str, asked| {
            let recipe = recipe(text);
            let transport = walked(&recipe, BOTH, recipe.wavelength()).unwrap();
            Effort::of_coherent(&NEVER, &wave_stack(&recipe, BOTH), &transport, asked, [0; 2])
                .unwrap()
                .members
        };
        let few = r#"{"stack": {"layers": 20, "aragonite": {"thickness_sd_nm": 10}}}"#;
        assert!(members(few, 4.0) < members(few, 1.0) && members(few, 1.0) < members(few, 0.5));
        let deep = recipe(r#"{"stack": {"layers": 2000, "aragonite": {"k": 1e-6, "thickness_sd_nm": 10}}}"#);
        let wanted = Wanted { emission: Want::No, ..BOTH };
        let said = of(&deep, wanted, 1.0).unwrap().spectra.coherent.unwrap().delta_e00;
        assert!(said.sampling.unwrap() > 1.0, "{said:?}");
    }

    /// Linear sRGB at a scale, read as a renderer does.
    fn read(thickness: &Thickness, rgb: &[Vec<[f64; 3]>], s: f64) -> Vec<[f64; 3]> {
        let k = thickness.scale.partition_point(|scale| *scale <= s).clamp(1, thickness.scale.len() - 1) - 1;
        let (from, to) = (thickness.scale[k], thickness.scale[k + 1]);
        let t = (s / from).ln() / (to / from).ln();
        let pairs = rgb[k].iter().zip(&rgb[k + 1]);
        pairs.map(|(a, b)| [0, 1, 2].map(|c| (1.0 - t) * a[c] + t * b[c])).collect()
    }

    /// Largest ΔE00 up to 85° between M and Ê of a stack at a scale and those of a bake of such thicknesses; its colours at scales.
    fn bakes_apart_at(
        stack: &dyn Fn(f64) -> String,
        s: f64,
        wanted: Wanted,
        delta_e00: f64,
    ) -> ([f64; 2], Thickness) {
        let own = of(&recipe(&stack(1.0)), Wanted { thickness: true, ..wanted }, delta_e00).unwrap().spectra;
        own.validate().unwrap();
        let other = of(&recipe(&stack(s)), wanted, delta_e00).unwrap().spectra;
        let thickness = own.thickness.clone().unwrap();
        let worst = |theta_deg: &[f64], read: Vec<[f64; 3]>, truth_deg: &[f64], truth: &[[f64; 3]]| -> f64 {
            let lab = |rgb: &[f64; 3]| colour::lab(colour::xyz_of_linear_srgb(*rgb));
            let common = theta_deg.iter().zip(&read).filter(|(degrees, _)| **degrees <= JUDGED_DEG);
            let found = common.filter_map(|(degrees, read)| {
                let at = truth_deg.iter().position(|other| other == degrees)?;
                Some(colour::delta_e_2000(lab(read), lab(&truth[at])))
            });
            found.fold(0.0, f64::max)
        };
        let (a, b) = (own.coherent.unwrap(), other.coherent.unwrap());
        let coherent = worst(
            &a.theta_deg,
            read(&thickness, &thickness.modulation_rgb, s),
            &b.theta_deg,
            &b.modulation_rgb,
        );
        let (a, b) = (own.emission.unwrap(), other.emission.unwrap());
        let emission =
            worst(&a.theta_deg, read(&thickness, &thickness.radiance_rgb, s), &b.theta_deg, &b.radiance_rgb);
        ([coherent, emission], thickness)
    }

    #[test]
    fn colours_at_other_thicknesses_are_those_of_bakes_of_such_thicknesses() {
        let stack = |s: f64| {
            let (a, c) = (450.0 * s, 25.0 * s);
            format!(
                r#"{{"stack": {{"layers": 40, "aragonite": {{"thickness_nm": {a}, "k": 1e-4}}, "conchiolin": {{"thickness_nm": {c}}}}}}}"#
            )
        };
        for s in [0.7, 0.83, 1.27, 1.4] {
            let (apart, thickness) = bakes_apart_at(&stack, s, BOTH, 0.3);
            assert!(thickness.delta_e00.scales <= BETWEEN_SCALES && thickness.delta_e00.scaling == 0.0);
            assert!(apart.iter().all(|apart| *apart <= 0.1), "{s}: {apart:?}");
        }
    }

    /// Light is stored in its 500 layers in lines so narrow that a bake's own wavelengths miss ΔE00 0.1; these do not.
    #[test]
    #[ignore = "a minute: narrow lines take many wavelengths"]
    fn long_colours_of_the_papers_pearl_at_other_thicknesses_are_those_of_such_stacks() {
        let recipe = Recipe::default();
        let wanted = Wanted { thickness: true, ..BOTH };
        let transport = walked(&recipe, wanted, recipe.wavelength()).unwrap();
        let stack = wave_stack(&recipe, wanted);
        for (kind, per_band) in [(Quantity::Modulation, 640), (Quantity::Emission, 1280)] {
            let beyond = beyond(&recipe, wanted);
            let sampling = Sampling { bands: BANDS, beyond, per_band, members: 1, seed: SEED };
            for scale in [0.7, 0.83, 1.2, 1.4] {
                let profile = recipe.source_profile();
                let apart = apart_at(&NEVER, &stack, profile, &transport, kind, sampling, &[scale]).unwrap();
                assert!(apart <= 0.1, "{kind:?} at {scale}: {apart}");
            }
        }
    }

    #[test]
    fn what_does_not_scale_is_said() {
        let stack = |s: f64| {
            let (a, c) = (450.0 * s, 25.0 * s);
            format!(
                r#"{{"stack": {{"layers": 20, "aragonite": {{"n": {{"cauchy": [1.52, 0.01]}}, "thickness_nm": {a}}}, "conchiolin": {{"thickness_nm": {c}}}}}}}"#
            )
        };
        for s in [0.7, 1.4] {
            let (apart, thickness) = bakes_apart_at(&stack, s, BOTH, 0.3);
            let (worst, said) = (apart[0].max(apart[1]), thickness.delta_e00.scaling);
            assert!(worst > 1.0 && worst <= 1.3 * said, "{s}: {apart:?}, said {said}");
        }
    }

    #[test]
    fn thickness_as_a_control_leaves_the_colours_at_the_recipes_own() {
        let recipe = recipe(r#"{"stack": {"layers": 6}, "look": {"thickness": {"min": 0.9, "max": 1.1}}}"#);
        let plain = of(&recipe, BOTH, 1.0).unwrap().spectra;
        let thick = of(&recipe, Wanted { thickness: true, ..BOTH }, 1.0).unwrap().spectra;
        let visible = thick.visible();
        assert_eq!(thick.wavelength_nm[visible.clone()], plain.wavelength_nm);
        assert!(
            thick.wavelength_nm[0] < 380.0 / 1.1 + 5.0
                && thick.wavelength_nm.last().unwrap() > &(780.0 / 0.9 - 5.0)
        );
        let (wide, own) = (thick.coherent.unwrap(), plain.coherent.unwrap());
        assert_eq!((&wide.theta_deg, &wide.modulation_rgb), (&own.theta_deg, &own.modulation_rgb));
        assert!(
            wide.modulation.iter().zip(&own.modulation).all(|(wide, own)| wide[visible.clone()] == own[..])
        );
        let section = thick.thickness.unwrap();
        let one = section.scale.iter().position(|s| *s == 1.0).unwrap();
        assert_eq!(section.modulation_rgb[one], own.modulation_rgb);
        assert_eq!((section.scale[0], *section.scale.last().unwrap()), (0.9, 1.1));
        assert!(plain.thickness.is_none());
    }

    #[test]
    fn a_stack_without_an_index_beyond_the_visible_says_that_thickness_cannot_be_had() {
        // n² is 5.2 at 380 nm, and −2.6 at 271 nm, beyond the pole at 316 nm.
        let text =
            r#"{"stack": {"layers": 4, "aragonite": {"n": {"sellmeier": {"b": [1.3], "c_um2": [0.1]}}}}}"#;
        let wanted = Wanted { thickness: true, coherent: Want::IfPossible, ..Wanted::default() };
        let error = of(&recipe(text), wanted, 1.0).unwrap_err().to_string();
        assert!(error.starts_with("effects: thickness cannot be had: "), "{error}");
    }

    #[test]
    fn only_what_is_wanted_is_there() {
        let recipe = recipe(r#"{"stack": {"layers": 4}, "look": {"depth": 0, "coherence": 0.3}}"#);
        let held = |effects: &[Effect]| {
            let wanted = Wanted::by_effects(effects.iter().copied().collect(), false);
            of(&recipe, wanted, 1.0).unwrap().effects().iter().collect::<Vec<_>>()
        };
        assert_eq!(held(&[Effect::Coherent, Effect::Blur]), [Effect::Coherent]);
        assert_eq!(held(&[Effect::Emission]), [Effect::Emission]);
        assert_eq!(held(&[Effect::Surface, Effect::Irregularity]), []);
    }

    #[test]
    fn absorption_and_irregularity_change_the_colours_only_where_they_are_wanted() {
        let plain = both(r#"{"stack": {"layers": 4}}"#);
        let text = r#"{"stack": {"layers": 4, "aragonite": {"k": 0.01, "thickness_sd_nm": 30}}}"#;
        let of_text = |wanted| {
            let spectra = of(&recipe(text), wanted, 1.0).unwrap().spectra;
            (spectra.coherent.unwrap(), spectra.emission.unwrap())
        };
        assert_eq!(of_text(Wanted { irregularity: false, absorption: false, ..BOTH }), plain);
        let absorbing = of_text(Wanted { irregularity: false, ..BOTH });
        let irregular = of_text(Wanted { absorption: false, ..BOTH });
        for (coherent, emission) in [absorbing, irregular] {
            assert_ne!(coherent.modulation[0], plain.0.modulation[0]);
            assert_ne!(emission.radiance, plain.1.radiance);
        }
    }

    #[test]
    fn a_stack_without_an_index_somewhere_bakes_without_colour_unless_it_was_listed_by_name() {
        // n = 3.153 − 0.5 µm²/λ² is 1.5 at 550 nm, where the walk is, and negative at 380 nm.
        let violet = recipe(
            r#"{"stack": {"layers": 4, "aragonite": {"n": {"cauchy": [3.153, -0.5]}, "thickness_nm": 450}}}"#,
        );
        let effects: EffectSet = [Effect::Coherent, Effect::Emission].into_iter().collect();
        let colours = of(&violet, Wanted::by_effects(effects, false), 1.0).unwrap();
        assert_eq!(colours.effects(), EffectSet::NONE);
        assert_eq!(colours.missing.len(), 2);
        assert!(colours.missing[0].1.contains("n = -0."), "{:?}", colours.missing);
        let error = of(&violet, Wanted::by_effects(effects, true), 1.0).unwrap_err().to_string();
        assert!(error.starts_with("effects: coherent cannot be had: ") && !error.contains('\n'), "{error}");
    }

    #[test]
    fn colours_of_more_layers_are_predicted_to_take_longer_and_absorbing_ones_longest() {
        let stack = |layers: u32, k: f64| {
            recipe(&format!(r#"{{"stack": {{"layers": {layers}, "aragonite": {{"k": {k}}}}}}}"#))
        };
        let [few, more, absorbing] =
            [(10, 0.0), (40, 0.0), (40, 1e-3)].map(|(layers, k)| forecast(&stack(layers, k), BOTH, 1.0));
        assert!((0..2).all(|colour| 0.0 < few[colour] && few[colour] < more[colour]), "{few:?} {more:?}");
        assert!(more[0] < absorbing[0], "{more:?} {absorbing:?}");
        assert_eq!(forecast(&stack(40, 0.0), Wanted::default(), 1.0), [0.0; 2]);
    }

    #[test]
    fn the_emission_is_that_of_the_sources_that_the_recipe_names() {
        let of_sources = |sources: &str| {
            both(&format!(r#"{{"stack": {{"layers": 40, "emission_sources": {sources}}}}}"#)).1.radiance
        };
        let [uniform, substrate] = [r#""uniform""#, r#""substrate""#].map(of_sources);
        let deepest = of_sources(r#"{"depth_nm": 1e9}"#);
        for (a, b) in uniform.iter().flatten().zip(deepest.iter().flatten()) {
            // The stack is 1e-5 of that depth.
            assert!((a - b).abs() < 1e-4, "{a} {b}");
        }
        // Light from below is what the stack lets through: most where it reflects least.
        let (coherent, _) = both(r#"{"stack": {"layers": 40}}"#);
        let of_band =
            |band: usize| (coherent.modulation[30][band] * coherent.incoherent[30], substrate[6][band]);
        for band in 1..BANDS {
            let ((r_0, e_0), (r_1, e_1)) = (of_band(0), of_band(band));
            assert!((e_1 / e_0 - (1.0 - r_1) / (1.0 - r_0)).abs() < 1e-3, "{band}");
        }
    }

    #[test]
    fn a_deep_stack_is_cut_to_the_layers_that_are_followed() {
        let stack = recipe(r#"{"stack": {"layers": 99999}}"#).film_stack();
        assert_eq!(shortened(stack.clone(), 16_384).layer_count(), 16_384);
        assert_eq!(shortened(stack.clone(), 100_000), stack);
        let explicit =
            Stack { runs: vec![StackRun { unit: stack.layers().take(7).collect(), repeat: 1 }], ..stack };
        assert_eq!(shortened(explicit, 5).layer_count(), 5);
    }
}
