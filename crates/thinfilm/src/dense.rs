//! Many wavelengths × angles × both polarisations of one stack at once.
//!
//! Sixteen wavelengths make a tile, as many of them as the registers hold go through the layers together, tiles over all threads. A stack that
//! neither absorbs nor traps light (all kz real) is a product of real rotations: no division, no complex arithmetic.
//! All others go as complex amplitudes with decaying exponentials only. Each lane carries an estimate of its own
//! rounding error; where it exceeds 7e-14 (a resonance of high quality, a layer near its critical angle, in
//! amplitudes grazing incidence) that lane alone is done again by [`Multilayer::solve`](crate::wave::Multilayer::solve), the robust form. So
//! results agree with the robust form to 1e-12 everywhere.

mod kernel;
mod lanes;
mod levels;

use std::borrow::Cow;
use std::sync::OnceLock;

use num_complex::Complex64;
use rayon::prelude::*;

use crate::stack::{Gain, Indices, Stack, StackError};
use crate::wave::{
    InPlaneWave, Incidence, Polarisation, PowerBalance, WaveError, check_wavelength, half_turns_per_metre,
    sqrt_upper,
};
use kernel::{
    ComplexMedium, ComplexTile, DenseLayer, Interface, Kinds, LosslessMedium, LosslessTile, Passage, Store,
    TileResult, Turn,
};
use lanes::{LANES, Lanes, Real as _};
use levels::Level;

/// Largest estimated error that a fast lane may have, a fourteenth of the agreement promised: above, the robust form answers. (In 20,000
/// stacks the largest deviation is 13 times its estimate.)
const TOLERANCE: f64 = 7e-14;
/// The same for means and colours, which need no more: promised to 1e-9. Deep stacks (thousands of layers) keep their speed.
pub(crate) const MEAN_TOLERANCE: f64 = 1e-10;

/// The same for colours of irregular stacks, whose members scatter by a thousand times as much: clear ones are rotated in single precision.
/// Promised to 1e-3, emission to a tenth of itself.
pub(crate) const COLOUR_TOLERANCE: f64 = 2e-4;

/// R and T of a stack on a grid of angles × wavelengths.
#[derive(Clone, Debug, PartialEq)]
pub struct Spectra {
    wavelengths: usize,
    /// `[s, p]`, each `[angle][wavelength]`.
    reflectance: [Vec<f64>; 2],
    transmittance: [Vec<f64>; 2],
    emission: Option<[Vec<f64>; 2]>,
    /// At each wavelength.
    balances: Vec<PowerBalance>,
    robust_lanes: usize,
}

impl Spectra {
    /// R of one polarisation at one angle, over the wavelengths.
    #[must_use]
    pub fn reflectance(&self, angle: usize, polarisation: Polarisation) -> &[f64] {
        self.row(&self.reflectance[polarisation as usize], angle)
    }

    /// T of one polarisation at one angle, over the wavelengths.
    #[must_use]
    pub fn transmittance(&self, angle: usize, polarisation: Polarisation) -> &[f64] {
        self.row(&self.transmittance[polarisation as usize], angle)
    }

    /// A = 1 − R − T of one polarisation at one angle, over the wavelengths; as in [`Response`](crate::Response).
    #[must_use]
    pub fn absorptance(&self, angle: usize, polarisation: Polarisation) -> Vec<f64> {
        let powers =
            self.reflectance(angle, polarisation).iter().zip(self.transmittance(angle, polarisation));
        powers.zip(&self.balances).map(|((r, t), balance)| balance.absorptance(*r, *t)).collect()
    }

    /// Mean of R over s and p.
    #[must_use]
    pub fn unpolarised_reflectance(&self, angle: usize) -> Vec<f64> {
        self.mean(&self.reflectance, angle)
    }

    /// Mean of T over s and p.
    #[must_use]
    pub fn unpolarised_transmittance(&self, angle: usize) -> Vec<f64> {
        self.mean(&self.transmittance, angle)
    }

    /// Mean of A over s and p.
    #[must_use]
    pub fn unpolarised_absorptance(&self, angle: usize) -> Vec<f64> {
        let [s, p] = Polarisation::BOTH.map(|pol| self.absorptance(angle, pol));
        s.iter().zip(p).map(|(s, p)| 0.5 * (s + p)).collect()
    }

    /// Σ source·∫|E|² dz over the layers, mean of s and p, where sources were given.
    #[must_use]
    pub(crate) fn unpolarised_emission(&self, angle: usize) -> Option<Vec<f64>> {
        self.emission.as_ref().map(|emission| self.mean(emission, angle))
    }

    /// How many (angle, wavelength) pairs were done by the robust form.
    #[must_use]
    pub const fn robust_lanes(&self) -> usize {
        self.robust_lanes
    }

    fn row<'a>(&self, values: &'a [f64], angle: usize) -> &'a [f64] {
        &values[angle * self.wavelengths..(angle + 1) * self.wavelengths]
    }

    fn mean(&self, values: &[Vec<f64>; 2], angle: usize) -> Vec<f64> {
        let rows = self.row(&values[0], angle).iter().zip(self.row(&values[1], angle));
        rows.map(|(s, p)| 0.5 * (s + p)).collect()
    }
}

/// R and T of a stack at every angle (radians) and wavelength (metres).
///
/// # Errors
/// As [`Stack::check`], [`Stack::indices`] and [`crate::wave::Multilayer::solve`].
///
/// ```
/// use thinfilm::{Material, Polarisation, Stack, dense};
/// let pearl = Stack::alternating(
///     Material::constant(1.0),
///     (Material::constant(1.53), 450e-9, 0.0),
///     (Material::constant(1.43), 25e-9, 0.0),
///     500,
///     Material::constant(1.53),
/// );
/// let wavelengths: Vec<f64> = (380..=780).map(|nm| f64::from(nm) * 1e-9).collect();
/// let spectra = dense::spectra(&pearl, &wavelengths, &[0.0, 0.5])?;
/// let r = spectra.reflectance(1, Polarisation::S);
/// let t = spectra.transmittance(1, Polarisation::S);
/// assert!(r.iter().zip(t).all(|(r, t)| (r + t - 1.0).abs() < 1e-13));
/// # Ok::<(), thinfilm::StackError>(())
/// ```
pub fn spectra(stack: &Stack, wavelengths: &[f64], angles: &[f64]) -> Result<Spectra, StackError> {
    Solver::new(stack, wavelengths, None, TOLERANCE)?.spectra(angles)
}

/// As [`spectra`], with indices given at each wavelength in place of those of the stack's materials.
///
/// # Errors
/// As [`Stack::check`], [`Stack::check_indices`] and [`crate::wave::Multilayer::solve`]; not as many indices as wavelengths.
pub fn spectra_of(
    stack: &Stack,
    wavelengths: &[f64],
    indices: Vec<Indices>,
    angles: &[f64],
) -> Result<Spectra, StackError> {
    if indices.len() != wavelengths.len() {
        let why = format!("indices are given at {} wavelengths of {}", indices.len(), wavelengths.len());
        return Err(WaveError::Unsuitable(why).into());
    }
    wavelengths.iter().try_for_each(|wavelength| check_wavelength(*wavelength))?;
    indices.iter().try_for_each(|indices| stack.check_indices(indices))?;
    Solver::with_indices(stack, wavelengths, indices, None, TOLERANCE)?.spectra(angles)
}

/// As [`spectra`], to no more than a tolerance: what a mean over many stacks or wavelengths is made of. Given `sources`, the
/// strength in each layer from the ambient side down, with Σ source·∫|E|² dz in the same pass.
pub(crate) fn spectra_for_means(
    tolerance: f64,
    stack: &Stack,
    wavelengths: &[f64],
    angles: &[f64],
    sources: Option<&[f64]>,
) -> Result<Spectra, StackError> {
    Solver::new(stack, wavelengths, sources, tolerance)?.spectra(angles)
}

struct Solver<'a> {
    stack: &'a Stack,
    wavelengths: &'a [f64],
    /// 2π/λ.
    k0: Vec<f64>,
    /// Indices at each wavelength.
    indices: Vec<Indices>,
    /// From the substrate up.
    layers: Vec<DenseLayer>,
    kinds: Option<Kinds>,
    /// Of all layers of each material, metres.
    thickness: Vec<f64>,
    interface_pairs: Vec<(usize, usize)>,
    interface_of: Vec<usize>,
    reference: usize,
    sources: Option<&'a [f64]>,
    /// Whether no index depends on the wavelength.
    is_dispersionless: bool,
    /// Largest estimated error of a fast lane.
    tolerance: f64,
    level: Level,
}

/// Tiles that are not worth another thread.
const TILES_AT_ONCE: usize = 2;
/// Most tiles that a thread takes without another being able to take over some of them: the last to finish keeps the others waiting.
const TILES_IN_A_ROW: usize = 8;

/// Media are numbered: materials first, then the ambient, then the substrate.
const fn ambient_number(materials: usize) -> usize {
    materials
}

const fn substrate_number(materials: usize) -> usize {
    materials + 1
}

/// Longer or more periodic stacks go to the robust form, whose cost grows with the logarithm of the repeats.
const MOST_FAST_LAYERS: u128 = 16_384;

/// cos² of the angle of incidence up to which rotations leave waves to the robust form (89.994°); and for amplitudes, which round the more the
/// nearer they come to grazing incidence, its product with the tolerance (89.3°, and 89.98° for means).
const STEEPEST_ROTATED: f64 = 1e-8;
const STEEPEST_AMPLITUDES: f64 = 1e-17;

impl<'a> Solver<'a> {
    fn new(
        stack: &'a Stack,
        wavelengths: &'a [f64],
        sources: Option<&'a [f64]>,
        tolerance: f64,
    ) -> Result<Self, StackError> {
        stack.check()?;
        let indices = wavelengths.iter().map(|&w| stack.indices(w)).collect::<Result<Vec<_>, _>>()?;
        Self::with_indices(stack, wavelengths, indices, sources, tolerance)
    }

    fn with_indices(
        stack: &'a Stack,
        wavelengths: &'a [f64],
        indices: Vec<Indices>,
        sources: Option<&'a [f64]>,
        tolerance: f64,
    ) -> Result<Self, StackError> {
        stack.check()?;
        if let (Some(sources), count) = (sources, stack.layer_count())
            && sources.len() as u128 != count
        {
            let why = format!("{} source strengths are given for {count} layers", sources.len());
            return Err(WaveError::Unsuitable(why).into());
        }
        let fast = stack.layer_count() <= MOST_FAST_LAYERS;
        let mut layers: Vec<DenseLayer> = Vec::new();
        if fast {
            let source = |at: usize| sources.map_or(0.0, |s| s[at]);
            layers.extend(stack.layers().enumerate().map(|(at, layer)| DenseLayer {
                medium: layer.material,
                thickness: layer.thickness,
                source: source(at),
            }));
            layers.reverse();
            // A layer of no thickness is no layer.
            layers.retain(|layer| layer.thickness > 0.0);
        }
        let materials = stack.materials.len();
        let mut interface_pairs = Vec::new();
        let mut below = substrate_number(materials);
        let media = layers.iter().map(|layer| layer.medium).chain([ambient_number(materials)]);
        let interface_of = media
            .map(|medium| {
                let pair = (medium, below);
                below = medium;
                interface_pairs.iter().position(|p| *p == pair).unwrap_or_else(|| {
                    interface_pairs.push(pair);
                    interface_pairs.len() - 1
                })
            })
            .collect();
        let is_dispersionless = indices.windows(2).all(|pair| pair[0] == pair[1]);
        let count_of = |medium: usize| layers.iter().filter(|layer| layer.medium == medium).count();
        let thickness_of = |medium: usize| {
            layers.iter().filter(|layer| layer.medium == medium).map(|layer| layer.thickness).sum()
        };
        let thickness = (0..materials).map(thickness_of).collect();
        let reference = (0..materials).max_by_key(|&m| count_of(m)).unwrap_or(0);
        Ok(Self {
            stack,
            wavelengths,
            k0: wavelengths.iter().map(|w| std::f64::consts::TAU / w).collect(),
            indices,
            kinds: Kinds::of(&layers),
            thickness,
            layers,
            interface_pairs,
            interface_of,
            reference,
            sources,
            is_dispersionless,
            tolerance,
            level: Level::detected(),
        })
    }

    /// Whether the fast loops take the stack at all.
    fn is_fast(&self) -> bool {
        self.stack.layer_count() <= MOST_FAST_LAYERS && self.stack.gain == Gain::Refused
    }

    /// Whether single precision will do, as far as its rounding without any resonance tells.
    fn takes_single(&self) -> bool {
        self.kinds.is_none() && 4.0 * f32::ROTATION_ROUNDING * self.layers.len() as f64 <= self.tolerance
    }

    fn spectra(&self, angles: &[f64]) -> Result<Spectra, StackError> {
        // (angle, wavelength) pairs in one row, so that no tile but the last has idle lanes.
        let size = angles.len() * self.wavelengths.len();
        let waves = self.waves(angles)?;
        let rows = || [vec![0.0; size], vec![0.0; size]];
        let mut spectra = Spectra {
            wavelengths: self.wavelengths.len(),
            reflectance: rows(),
            transmittance: rows(),
            emission: self.sources.map(|_| rows()),
            balances: self.balances(),
            robust_lanes: 0,
        };
        // Each tile writes into its part of the rows: no second pass, and the threads touch fresh memory together.
        let tiles = Cut::tiles(&mut spectra);
        let work = |scratch: &mut Scratch, (tile, cut)| self.tile(angles, &waves, tile * LANES, cut, scratch);
        spectra.robust_lanes = if tiles.len() <= TILES_AT_ONCE {
            // Waking a thread takes longer.
            let mut scratch = Scratch::default();
            tiles.into_iter().enumerate().map(|tile| work(&mut scratch, tile)).sum::<Result<_, _>>()?
        } else {
            tiles
                .into_par_iter()
                .with_max_len(TILES_IN_A_ROW)
                .enumerate()
                .map_init(Scratch::default, work)
                .try_reduce(|| 0, |a, b| Ok(a + b))?
        };
        Ok(spectra)
    }

    fn balances(&self) -> Vec<PowerBalance> {
        let layers = || self.stack.runs.iter().filter(|run| run.repeat > 0).flat_map(|run| &run.unit);
        let materials: Vec<usize> = (0..self.stack.materials.len())
            .filter(|material| layers().any(|layer| layer.material == *material))
            .collect();
        let balance = |indices: &Indices| {
            PowerBalance::of(indices.ambient, materials.iter().map(|at| indices.materials[*at]))
        };
        self.indices.iter().map(balance).collect()
    }

    /// Without dispersion, one wave an angle serves all wavelengths; empty otherwise.
    fn waves(&self, angles: &[f64]) -> Result<Vec<LaneWave>, StackError> {
        match self.indices.first() {
            Some(indices) if self.is_dispersionless => {
                angles.iter().map(|theta| LaneWave::new(indices, *theta)).collect()
            }
            _ => Ok(Vec::new()),
        }
    }

    /// The pairs from `first` on; returns how many of them the robust form did.
    fn tile(
        &self,
        angles: &[f64],
        waves: &[LaneWave],
        first: usize,
        cut: Cut<'_>,
        scratch: &mut Scratch,
    ) -> Result<usize, StackError> {
        let last = first + cut.len();
        let lanes = TileLanes::new(self, angles, waves, first, last)?;
        let is_lossless = lanes.is_lossless();
        let is_fast = |result: &TileResult, lane: usize, pol: usize| {
            // Stored energy is the first to leave the range.
            let is_finite = self.sources.is_none() || result.emission[pol].0[lane].is_finite();
            lanes.is_suitable(lane, is_lossless) && is_finite && result.error[pol].0[lane] <= self.tolerance
        };
        let all_fast = |result: &TileResult| {
            (0..last - first).all(|lane| is_fast(result, lane, 0) && is_fast(result, lane, 1))
        };
        let in_single = (is_lossless && self.takes_single()).then(|| lanes.lossless(scratch, true));
        let mut result = match in_single.filter(all_fast) {
            Some(result) => result,
            None if is_lossless => lanes.lossless(scratch, false),
            None => lanes.complex(scratch),
        };
        let mut robust = 0;
        for lane in 0..last - first {
            let slow: Vec<Polarisation> =
                Polarisation::BOTH.into_iter().filter(|pol| !is_fast(&result, lane, *pol as usize)).collect();
            if slow.is_empty() {
                continue;
            }
            robust += 1;
            let (angle, wavelength) =
                ((first + lane) / self.wavelengths.len(), (first + lane) % self.wavelengths.len());
            self.robust(angles[angle], wavelength, &slow, lane, &mut result)?;
        }
        cut.fill(&result);
        Ok(robust)
    }

    fn robust(
        &self,
        theta: f64,
        wavelength: usize,
        polarisations: &[Polarisation],
        lane: usize,
        result: &mut TileResult,
    ) -> Result<(), StackError> {
        let (lambda, multilayer) =
            (self.wavelengths[wavelength], self.stack.with_indices(&self.indices[wavelength]));
        let incidence = Incidence::Angle(theta);
        for &polarisation in polarisations {
            let pol = polarisation as usize;
            let response = multilayer.solve_with_gain(lambda, incidence, polarisation)?;
            result.reflectance[pol].0[lane] = response.reflectance;
            result.transmittance[pol].0[lane] = response.transmittance;
            if let Some(sources) = self.sources {
                let integrals = multilayer.field(lambda, incidence, polarisation)?.integrals();
                result.emission[pol].0[lane] = sources.iter().zip(integrals).map(|(s, e2)| s * e2).sum();
            }
        }
        Ok(())
    }
}

/// One tile's part of the rows of [`Spectra`]; [s, p].
struct Cut<'a> {
    reflectance: [&'a mut [f64]; 2],
    transmittance: [&'a mut [f64]; 2],
    emission: Option<[&'a mut [f64]; 2]>,
}

impl<'a> Cut<'a> {
    fn tiles(spectra: &'a mut Spectra) -> Vec<Self> {
        let cuts = |rows: &'a mut [Vec<f64>; 2]| {
            let [s, p] = rows;
            s.chunks_mut(LANES).zip(p.chunks_mut(LANES)).map(|(s, p)| [s, p])
        };
        let mut emission = spectra.emission.as_mut().map(cuts);
        cuts(&mut spectra.reflectance)
            .zip(cuts(&mut spectra.transmittance))
            .map(|(reflectance, transmittance)| {
                let emission = emission.as_mut().and_then(Iterator::next);
                Self { reflectance, transmittance, emission }
            })
            .collect()
    }

    fn len(&self) -> usize {
        self.reflectance[0].len()
    }

    fn fill(self, result: &TileResult) {
        let copy = |rows: [&mut [f64]; 2], lanes: &[Lanes; 2]| {
            for (row, lanes) in rows.into_iter().zip(lanes) {
                row.copy_from_slice(&lanes.0[..row.len()]);
            }
        };
        copy(self.reflectance, &result.reflectance);
        copy(self.transmittance, &result.transmittance);
        if let Some(emission) = self.emission {
            copy(emission, &result.emission);
        }
    }
}

/// Memory that a thread uses for tile after tile.
#[derive(Default)]
struct Scratch {
    lossless_media: Vec<LosslessMedium>,
    single_media: Vec<LosslessMedium<f32>>,
    turns: Vec<Turn>,
    stores: Vec<Store>,
    complex_media: Vec<ComplexMedium>,
    interfaces: Vec<Interface>,
    passages: Vec<Passage>,
}

/// One (angle, wavelength) pair in every medium.
#[derive(Clone)]
struct LaneWave {
    /// kz/k₀ of every medium: the admittance of s.
    kz: Vec<Complex64>,
    /// Admittance of p of every medium.
    q_p: Vec<Complex64>,
    /// N² of every medium.
    eps: Vec<Complex64>,
    /// kₓ/k₀.
    kx: f64,
    /// Computed where amplitudes are asked for.
    faces: OnceLock<Faces>,
}

/// What amplitudes need of a wave besides its phases; [s, p].
#[derive(Clone)]
struct Faces {
    /// At each interface ρ = (q_upper − q_lower)/(q_upper + q_lower) and 1/|τ|, τ = 2 q_upper/(q_upper + q_lower).
    interfaces: Vec<[(Complex64, f64); 2]>,
    /// |q_0| over the largest |q| of a layer.
    inverse_contrast: [f64; 2],
    /// Re q_sub/Re q_0.
    flux: [f64; 2],
    /// Amplitudes are no basis where kz nearly vanishes in a layer: there the two waves are one.
    is_critical: bool,
}

impl LaneWave {
    fn new(indices: &Indices, theta: f64) -> Result<Self, StackError> {
        let wave = InPlaneWave::new(indices.ambient, Incidence::Angle(theta))?;
        let media = || indices.materials.iter().chain([&indices.ambient, &indices.substrate]);
        let kz: Vec<Complex64> = media().map(|&index| sqrt_upper(wave.kz2(index))).collect();
        let eps: Vec<Complex64> = media().map(|index| index * index).collect();
        let q_p = kz.iter().zip(&eps).map(|(kz, eps)| kz / eps).collect();
        Ok(Self { q_p, kz, eps, kx: wave.kx, faces: OnceLock::new() })
    }

    /// At the interfaces of the pairs of media.
    fn faces(&self, pairs: &[(usize, usize)]) -> &Faces {
        self.faces.get_or_init(|| {
            let materials = self.kz.len() - 2;
            let (ambient, substrate) = (ambient_number(materials), substrate_number(materials));
            let face = |upper: usize, lower: usize, pol| {
                let (a, b) = (self.admittance(upper, pol), self.admittance(lower, pol));
                ((a - b) / (a + b), ((a + b) / (2.0 * a)).norm())
            };
            let inverse_contrast = |pol| {
                let largest = (0..materials).map(|m| self.admittance(m, pol).norm()).fold(0.0, f64::max);
                self.admittance(ambient, pol).norm() / largest
            };
            let flux = |pol| self.admittance(substrate, pol).re / self.admittance(ambient, pol).re;
            let mut layers = self.kz.iter().zip(&self.eps).take(materials);
            Faces {
                is_critical: layers.any(|(kz, eps)| kz.norm_sqr() < 1e-2 * eps.norm()),
                interfaces: pairs
                    .iter()
                    .map(|&(upper, lower)| Polarisation::BOTH.map(|pol| face(upper, lower, pol)))
                    .collect(),
                inverse_contrast: Polarisation::BOTH.map(inverse_contrast),
                flux: Polarisation::BOTH.map(flux),
            }
        })
    }

    fn admittance(&self, medium: usize, polarisation: Polarisation) -> Complex64 {
        match polarisation {
            Polarisation::S => self.kz[medium],
            Polarisation::P => self.q_p[medium],
        }
    }

    /// Whether cos² of the angle of incidence is larger than `cos2`: q of the ambient vanishes at 90°.
    fn is_steeper(&self, cos2: f64) -> bool {
        self.kz[self.kz.len() - 2].norm_sqr() > cos2 * self.eps[self.eps.len() - 2].norm()
    }
}

/// The pairs of one tile.
struct TileLanes<'a> {
    solver: &'a Solver<'a>,
    /// Without dispersion, neighbours in wavelength share everything but k₀.
    distinct: Vec<Cow<'a, LaneWave>>,
    /// Which of them a lane has; lanes past the last pair repeat it.
    of_lane: [usize; LANES],
    /// Whether rotations and amplitudes may take it.
    suitable: [[bool; 2]; LANES],
    /// 2π/λ.
    k0: Lanes,
}

impl<'a> TileLanes<'a> {
    fn new(
        solver: &'a Solver<'a>,
        angles: &[f64],
        waves: &'a [LaneWave],
        first: usize,
        last: usize,
    ) -> Result<Self, StackError> {
        let count = solver.wavelengths.len();
        let mut distinct: Vec<Cow<'a, LaneWave>> = Vec::with_capacity(2);
        let (mut of_lane, mut suitable, mut k0) = ([0; LANES], [[false; 2]; LANES], Lanes::splat(0.0));
        let (mut angle, mut wavelength) = (first / count, first % count);
        for lane in 0..LANES {
            let indices = &solver.indices[wavelength];
            let same = lane > 0
                && (wavelength > 0 || first + lane >= last)
                && (solver.is_dispersionless || wavelength > 0 && solver.indices[wavelength - 1] == *indices);
            if !same {
                distinct.push(match waves.get(angle) {
                    Some(wave) => Cow::Borrowed(wave),
                    None => Cow::Owned(LaneWave::new(indices, angles[angle])?),
                });
                let wave = &distinct[distinct.len() - 1];
                let fast = solver.is_fast() && indices.ambient.im == 0.0;
                suitable[lane] = [STEEPEST_ROTATED, STEEPEST_AMPLITUDES / solver.tolerance]
                    .map(|cos2| fast && wave.is_steeper(cos2));
            } else {
                suitable[lane] = suitable[lane - 1];
            }
            of_lane[lane] = distinct.len() - 1;
            k0.0[lane] = solver.k0[wavelength];
            if first + lane + 1 < last {
                wavelength += 1;
                if wavelength == count {
                    (angle, wavelength) = (angle + 1, 0);
                }
            }
        }
        Ok(Self { solver, distinct, of_lane, suitable, k0 })
    }

    /// Whether the loop that takes the tile knows the lane.
    fn is_suitable(&self, lane: usize, is_lossless: bool) -> bool {
        self.suitable[lane][usize::from(!is_lossless)]
    }

    /// A value a lane.
    fn gather(&self, f: impl Fn(&LaneWave) -> f64) -> Lanes {
        if let [only] = self.distinct.as_slice() {
            return Lanes::splat(f(only));
        }
        let mut lanes = Lanes::splat(0.0);
        let mut before = (usize::MAX, 0.0);
        for (lane, &at) in lanes.0.iter_mut().zip(&self.of_lane) {
            if before.0 != at {
                before = (at, f(&self.distinct[at]));
            }
            *lane = before.1;
        }
        lanes
    }

    fn real(&self, medium: usize, polarisation: Polarisation) -> Lanes {
        self.gather(|wave| wave.admittance(medium, polarisation).re)
    }

    fn is_lossless(&self) -> bool {
        let materials = self.solver.stack.materials.len();
        let propagates = |kz: &Complex64| kz.im == 0.0 && kz.re > 0.0;
        let all = self.distinct.iter().all(|wave| wave.kz[..materials].iter().all(propagates));
        self.solver.is_fast() && all && self.suitable.iter().any(|[rotations, _]| *rotations)
    }

    fn lossless(&self, scratch: &mut Scratch, in_single: bool) -> TileResult {
        let materials = self.solver.stack.materials.len();
        let ambient = ambient_number(materials);
        let Scratch { lossless_media: media, single_media, turns, stores, .. } = scratch;
        media.clear();
        media.extend((0..materials).map(|m| self.lossless_medium(m)));
        let level = self.solver.level;
        let mut result = if in_single {
            single_media.clear();
            single_media.extend(media.iter().map(LosslessMedium::in_single));
            let tile = self.lossless_tile(single_media);
            match self.solver.sources {
                None => kernel::lossless_in_single(level, &tile),
                Some(_) => kernel::lossless_emitting_in_single(level, &tile),
            }
        } else {
            let tile = self.lossless_tile(media);
            match (self.solver.sources, &self.solver.kinds) {
                (None, Some(kinds)) => kernel::lossless_by_kind(level, &tile, kinds, turns),
                (None, None) => kernel::lossless(level, &tile),
                (Some(_), Some(kinds)) => {
                    kernel::lossless_emitting_by_kind(level, &tile, kinds, turns, stores)
                }
                (Some(_), None) => kernel::lossless_emitting(level, &tile),
            }
        };
        if self.solver.sources.is_some() {
            // |E| = 1 means |H| = |N₀| for p.
            result.emission[1] = result.emission[1] * self.gather(|wave| wave.eps[ambient].norm());
        }
        result
    }

    fn lossless_tile<'t, T>(&'t self, media: &'t [LosslessMedium<T>]) -> LosslessTile<'t, T> {
        let materials = self.solver.stack.materials.len();
        let (ambient, substrate) = (ambient_number(materials), substrate_number(materials));
        let real = |medium: usize| Polarisation::BOTH.map(|pol| self.real(medium, pol));
        let q_substrate = Polarisation::BOTH
            .map(|pol| [self.real(substrate, pol), self.gather(|wave| wave.admittance(substrate, pol).im)]);
        LosslessTile {
            media,
            reference: self.solver.reference,
            layers: &self.solver.layers,
            q_reference: real(self.solver.reference),
            q_ambient: real(ambient),
            q_substrate,
        }
    }

    fn lossless_medium(&self, medium: usize) -> LosslessMedium {
        let reference = self.solver.reference;
        let ratio = |a: usize, b: usize| {
            if a == b {
                return [Lanes::splat(1.0); 2];
            }
            Polarisation::BOTH
                .map(|pol| self.gather(|wave| wave.admittance(a, pol).re / wave.admittance(b, pol).re))
        };
        let (up, kz) = (ratio(reference, medium), self.real(medium, Polarisation::S));
        let half_turns = self.k0.zip(kz, half_turns_per_metre);
        let (mean, face) = match self.solver.sources {
            Some(_) => self.energy_weights(medium, &up, kz),
            None => ([Lanes::splat(0.0); 2], [Lanes::splat(0.0); 2]),
        };
        LosslessMedium {
            half_turns,
            most_half_turns: half_turns.0.into_iter().fold(0.0, f64::max),
            up,
            down: ratio(medium, reference),
            mean,
            face,
        }
    }

    /// [`LosslessMedium::mean`] and [`LosslessMedium::face`].
    fn energy_weights(&self, medium: usize, up: &[Lanes; 2], kz: Lanes) -> ([Lanes; 2], [Lanes; 2]) {
        let n2 = self.gather(|wave| wave.eps[medium].re);
        let face = (kz * self.k0).map(|rate| 0.5 / rate);
        let bias = (kz * kz - self.gather(|wave| wave.kx * wave.kx)) / (n2 * n2);
        ([Lanes::splat(0.5), n2.map(|n2| 0.5 / n2)], [-(face * up[0]), face * up[1] * bias])
    }

    fn complex(&self, scratch: &mut Scratch) -> TileResult {
        if !(self.solver.is_fast() && self.suitable.iter().any(|[_, amplitudes]| *amplitudes)) {
            return TileResult::UNKNOWN;
        }
        let materials = self.solver.stack.materials.len();
        let ambient = ambient_number(materials);
        let Scratch { complex_media: media, interfaces, passages, .. } = scratch;
        media.clear();
        media.extend((0..materials).map(|medium| self.complex_medium(medium)));
        interfaces.clear();
        interfaces.extend((0..self.solver.interface_pairs.len()).map(|at| self.interface(at)));
        let of_faces = |value: fn(&Faces) -> [f64; 2]| {
            [0, 1].map(|pol| self.gather(|wave| value(self.faces(wave))[pol]))
        };
        let tile = ComplexTile {
            inverse_contrast: of_faces(|faces| faces.inverse_contrast),
            media,
            layers: &self.solver.layers,
            kinds: self.solver.kinds.as_ref(),
            interface_of: &self.solver.interface_of,
            interfaces,
            flux: of_faces(|faces| faces.flux),
        };
        let mut result = if self.solver.sources.is_some() {
            let mut result = kernel::complex_emitting(self.solver.level, &tile);
            // |E| = 1 means |H| = |N₀| for p.
            result.emission[1] = result.emission[1] * self.gather(|wave| wave.eps[ambient].norm());
            result
        } else {
            kernel::complex(self.solver.level, &tile, passages)
        };
        let is_critical = |lane: &usize| self.faces(&self.distinct[self.of_lane[*lane]]).is_critical;
        for lane in (0..LANES).filter(is_critical) {
            for error in &mut result.error {
                error.0[lane] = f64::NAN;
            }
        }
        result
    }

    fn complex_medium(&self, medium: usize) -> ComplexMedium {
        let kz = self.gather(|wave| wave.kz[medium].re);
        let decay = (self.k0 * self.gather(|wave| wave.kz[medium].im)).scale(2.0 * std::f64::consts::LOG2_E);
        let (mut alone, mut together) = ([Lanes::splat(1.0); 2], [Lanes::splat(1.0); 2]);
        if self.solver.sources.is_some() {
            // E of a p wave from its H: along the layers kz/N², across them kₓ/N².
            let along = self.gather(|wave| wave.q_p[medium].norm_sqr());
            let across = self.gather(|wave| (wave.kx / wave.eps[medium]).norm_sqr());
            (alone[1], together[1]) = (along + across, across - along);
        }
        ComplexMedium {
            quarter_turns: self.k0.zip(kz, half_turns_per_metre).scale(4.0),
            decay,
            most_decay: decay.0.into_iter().fold(0.0, f64::max),
            thickness: self.solver.thickness[medium],
            alone,
            together,
        }
    }

    fn faces<'w>(&self, wave: &'w LaneWave) -> &'w Faces {
        wave.faces(&self.solver.interface_pairs)
    }

    fn interface(&self, at: usize) -> Interface {
        let rho = |pol: usize| {
            let re = self.gather(|wave| self.faces(wave).interfaces[at][pol].0.re);
            [re, self.gather(|wave| self.faces(wave).interfaces[at][pol].0.im)]
        };
        let inverse_tau = |pol: usize| self.gather(|wave| self.faces(wave).interfaces[at][pol].1);
        Interface { rho: [0, 1].map(rho), inverse_tau: [0, 1].map(inverse_tau) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::Material;

    fn pearl(k: f64, sd: f64, layers: u64) -> Stack {
        let material = |n| Material { k, ..Material::constant(n) };
        Stack::alternating(
            Material::constant(1.0),
            (material(1.53), 450e-9, 450e-9 * sd),
            (material(1.43), 25e-9, 25e-9 * sd),
            layers,
            Material::constant(1.53),
        )
        .draw(1, 0)
        .unwrap()
    }

    /// (k, irregularity): the four loops.
    const LOOPS: [(f64, f64); 4] = [(0.0, 0.0), (0.0, 0.03), (1e-3, 0.0), (1e-3, 0.03)];

    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        let wavelengths: Vec<f64> = (0..37).map(|i| 380e-9 + 11e-9 * f64::from(i)).collect();
        for (k, sd) in LOOPS {
            let stack = pearl(k, sd, 100);
            let sources = vec![1.0; 100];
            for sources in [None, Some(sources.as_slice())] {
                let of = |level| {
                    let solver = Solver::new(&stack, &wavelengths, sources, TOLERANCE).unwrap();
                    Solver { level, ..solver }.spectra(&[0.0, 0.7, 1.3]).unwrap()
                };
                let levels = Level::all();
                for level in &levels[1..] {
                    assert_eq!(of(levels[0]), of(*level), "k {k}, sd {sd}, {level:?}");
                }
            }
        }
    }

    /// Layers by kind and layers one by one are the same numbers but for rounding.
    #[test]
    fn layers_by_kind_are_the_layers() {
        let wavelengths: Vec<f64> = (0..32).map(|i| 380e-9 + 12e-9 * f64::from(i)).collect();
        for k in [0.0, 1e-3] {
            let stack = pearl(k, 0.0, 101);
            let by_kind = Solver::new(&stack, &wavelengths, None, TOLERANCE).unwrap();
            assert!(by_kind.kinds.is_some());
            let one_by_one =
                Solver { kinds: None, ..Solver::new(&stack, &wavelengths, None, TOLERANCE).unwrap() };
            let (a, b) = (by_kind.spectra(&[0.4]).unwrap(), one_by_one.spectra(&[0.4]).unwrap());
            let sources: Vec<f64> = (0..101).map(|i| (0.618 * f64::from(i)).fract()).collect();
            let emission = |by_kind: bool| {
                let solver = Solver::new(&stack, &wavelengths, Some(&sources), TOLERANCE).unwrap();
                let kinds = solver.kinds.clone().filter(|_| by_kind);
                let spectra = Solver { kinds, ..solver }.spectra(&[0.4]).unwrap();
                spectra.unpolarised_emission(0).unwrap()
            };
            for (a, b) in emission(true).into_iter().zip(emission(false)) {
                assert!((a / b - 1.0).abs() < 1e-12, "{a} {b}");
            }
            for pol in Polarisation::BOTH {
                for (a, b) in a.reflectance(0, pol).iter().zip(b.reflectance(0, pol)) {
                    assert!((a - b).abs() < 1e-13, "{a} {b}");
                }
                for (a, b) in a.transmittance(0, pol).iter().zip(b.transmittance(0, pol)) {
                    assert!((a - b).abs() < 1e-13, "{a} {b}");
                }
            }
        }
    }

    /// Stack `seed` of a family of all lengths, regular and irregular, with and without loss, and four angles for it.
    fn stack_of_any_length(seed: u64) -> (Stack, [f64; 4]) {
        use rand::{RngExt as _, SeedableRng as _};
        let mut random = rand::rngs::StdRng::seed_from_u64(seed);
        let layers = random.random_range(0.0..8.3f64).exp() as u64 + 1;
        let k = [0.0, 0.0, 1e-4, 1e-2][random.random_range(0..4usize)];
        let sd = [0.0, 0.03, 0.3][random.random_range(0..3usize)];
        let mut draw = |low: f64, high: f64| random.random_range(low..high);
        let material = |n| Material { k, ..Material::constant(n) };
        let mut layer = || (material(draw(1.1, 2.4)), draw(1e-9, 500e-9));
        let ((first, a), (second, b)) = (layer(), layer());
        let (ambient, substrate) = (draw(1.0, 1.6), draw(1.0, 2.0));
        let stack = Stack::alternating(
            Material::constant(ambient),
            (first, a, a * sd),
            (second, b, b * sd),
            layers,
            Material::constant(substrate),
        );
        (
            stack.draw(seed, 0).unwrap(),
            [0.0, draw(0.0, 1.5), draw(1.4, 1.56), draw(1.56, std::f64::consts::FRAC_PI_2)],
        )
    }

    /// Largest deviation from the robust form among the lanes whose estimated error is at most `tolerance`: of R and T, and of
    /// the emission relative to itself.
    fn worst_fast(seed: u64, tolerance: f64) -> [f64; 2] {
        let (stack, angles) = stack_of_any_length(seed);
        let wavelengths: Vec<f64> = (0..LANES as u32).map(|i| 380e-9 + 25e-9 * f64::from(i)).collect();
        // Strengths of 0 to 1 that differ from layer to layer.
        let sources: Vec<f64> = (0..stack.layer_count()).map(|i| (0.618 * i as f64).fract()).collect();
        let [without, with] = [None, Some(sources.as_slice())]
            .map(|sources| Solver::new(&stack, &wavelengths, sources, tolerance).unwrap());
        let mut worst = [0.0f64; 2];
        for (at, theta) in angles.into_iter().enumerate() {
            let of_tile =
                |solver| TileLanes::new(solver, &angles, &[], at * LANES, (at + 1) * LANES).unwrap();
            let lanes = of_tile(&without);
            let is_lossless = lanes.is_lossless();
            let passed = |lanes: &TileLanes| match is_lossless {
                true => lanes.lossless(&mut Scratch::default(), without.takes_single()),
                false => lanes.complex(&mut Scratch::default()),
            };
            let (result, emitting) = (passed(&lanes), passed(&of_tile(&with)));
            let suitable = |at: &usize| lanes.is_suitable(*at, is_lossless);
            for (lane, &wavelength) in wavelengths.iter().enumerate().filter(|(at, _)| suitable(at)) {
                let film = stack.at(wavelength).unwrap();
                let incidence = Incidence::Angle(theta);
                for pol in Polarisation::BOTH {
                    let of = |values: &[Lanes; 2]| values[pol as usize].0[lane];
                    if of(&result.error) <= tolerance {
                        let robust = film.solve(wavelength, incidence, pol).unwrap();
                        worst[0] = worst[0]
                            .max((of(&result.reflectance) - robust.reflectance).abs())
                            .max((of(&result.transmittance) - robust.transmittance).abs());
                    }
                    if of(&emitting.error) <= tolerance {
                        let field = film.field(wavelength, incidence, pol).unwrap();
                        let robust: f64 = sources.iter().zip(field.integrals()).map(|(s, e2)| s * e2).sum();
                        if robust == 0.0 {
                            continue; // one layer, and it is dark
                        }
                        worst[1] = worst[1].max((of(&emitting.emission) / robust - 1.0).abs());
                    }
                }
            }
        }
        worst
    }

    /// Regular stacks of a thousand layers and more near grazing incidence. There the robust form, doubled in plain f64, and the
    /// fast path were 1.0e-12 to 2.3e-12 apart.
    const LONG_REGULAR: [u64; 8] = [829, 1320, 4364, 8887, 8989, 9275, 16507, 18532];

    fn assert_errors_are_as_promised(seeds: impl IntoParallelIterator<Item = u64> + Clone) {
        for (tolerance, promises) in
            [(TOLERANCE, [1e-12, 1e-10]), (MEAN_TOLERANCE, [1e-9; 2]), (COLOUR_TOLERANCE, [1e-3, 1e-1])]
        {
            let each = seeds.clone().into_par_iter().map(|seed| worst_fast(seed, tolerance));
            let worst = each.reduce(|| [0.0; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
            let kept = worst.iter().zip(promises).all(|(worst, promise)| *worst <= promise);
            assert!(kept, "tolerance {tolerance:e}: off by {worst:?}");
        }
    }

    /// 1e-12 for spectra and 1e-10 for their emission, 1e-9 for means; for colours 1e-3, and a tenth for their emission (5.7e-4 and 4.5e-2
    /// in 20,000 stacks).
    #[test]
    fn fast_lanes_are_right_in_stacks_of_any_length() {
        assert_errors_are_as_promised((0..250).chain(LONG_REGULAR).collect::<Vec<u64>>());
    }

    /// The emission of a clear stack takes the fast lanes however deep it is, up to grazing incidence, and is that of the robust
    /// field.
    #[test]
    fn emission_of_deep_stacks_stays_fast_and_right() {
        let wavelengths: Vec<f64> = (0..21).map(|i| 380e-9 + 20e-9 * f64::from(i)).collect();
        let angles = [0.0, 30.0, 60.0, 84.0, 89.9].map(f64::to_radians);
        for (layers, sd) in [(2000, 0.0), (10_000, 0.0), (10_000, 0.03), (16_384, 0.0)] {
            let stack = pearl(0.0, sd, layers);
            let sources = vec![1.0; layers as usize];
            let spectra =
                spectra_for_means(MEAN_TOLERANCE, &stack, &wavelengths, &angles, Some(&sources)).unwrap();
            assert!(
                spectra.robust_lanes() <= 1,
                "{layers} layers, sd {sd}: {} robust lanes",
                spectra.robust_lanes()
            );
            for (at, theta) in angles.into_iter().enumerate() {
                let emission = spectra.unpolarised_emission(at).unwrap();
                for (found, &wavelength) in emission.iter().zip(&wavelengths) {
                    let film = stack.at(wavelength).unwrap();
                    let of = |pol| -> f64 {
                        film.field(wavelength, Incidence::Angle(theta), pol).unwrap().integrals().iter().sum()
                    };
                    let robust = 0.5 * (of(Polarisation::S) + of(Polarisation::P));
                    assert!(
                        (found / robust - 1.0).abs() < 1e-9,
                        "{layers} layers, sd {sd}, {theta} rad, {wavelength} m: {found} {robust}"
                    );
                }
            }
        }
    }

    /// So does what an absorbing stack reflects and gives off.
    #[test]
    fn means_of_absorbing_stacks_stay_fast_and_right_up_to_grazing_incidence() {
        let wavelengths: Vec<f64> = (0..21).map(|i| 380e-9 + 20e-9 * f64::from(i)).collect();
        for (k, sd, layers) in [(1e-4, 0.03, 2000), (5e-3, 0.03, 1000), (1e-3, 0.0, 500)] {
            let (stack, theta) = (pearl(k, sd, layers), 89.9_f64.to_radians());
            let sources = vec![1.0; layers as usize];
            let spectra =
                spectra_for_means(MEAN_TOLERANCE, &stack, &wavelengths, &[theta], Some(&sources)).unwrap();
            assert_eq!(spectra.robust_lanes(), 0, "k {k}, sd {sd}");
            let emission = spectra.unpolarised_emission(0).unwrap();
            for (at, &wavelength) in wavelengths.iter().enumerate() {
                let film = stack.at(wavelength).unwrap();
                let solved = Polarisation::BOTH.map(|pol| {
                    let incidence = Incidence::Angle(theta);
                    let response = film.solve(wavelength, incidence, pol).unwrap();
                    let off = (spectra.reflectance(0, pol)[at] - response.reflectance).abs();
                    assert!(off < 1e-9, "k {k}, sd {sd}, {wavelength} m: R off by {off:e}");
                    film.field(wavelength, incidence, pol).unwrap().integrals().iter().sum::<f64>()
                });
                let off = emission[at] / (0.5 * (solved[0] + solved[1])) - 1.0;
                assert!(off.abs() < 1e-9, "k {k}, sd {sd}, {wavelength} m: emission off by {off:e}");
            }
        }
    }

    /// `cargo test --release -p thinfilm long_fast_lanes -- --ignored`, five minutes.
    #[test]
    #[ignore = "long"]
    fn long_fast_lanes_are_right_in_many_stacks() {
        assert_errors_are_as_promised(0..20_000);
    }

    /// `cargo test --release -p thinfilm rate_of_each_level -- --ignored --nocapture --test-threads 1`
    #[test]
    #[ignore = "a measurement, not a check"]
    #[allow(clippy::print_stdout)]
    fn rate_of_each_level() {
        let wavelengths: Vec<f64> = (0..81).map(|i| 380e-9 + 5e-9 * f64::from(i)).collect();
        let angles: Vec<f64> = (0..90).map(|deg| f64::from(deg).to_radians()).collect();
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let sources = vec![1.0; 500];
        for ((k, sd), sources) in LOOPS.into_iter().flat_map(|of| [(of, None), (of, Some(&sources[..]))]) {
            let stack = pearl(k, sd, 500);
            for level in Level::all() {
                let solver =
                    Solver { level, ..Solver::new(&stack, &wavelengths, sources, TOLERANCE).unwrap() };
                let seconds = (0..5).map(|_| {
                    let start = std::time::Instant::now();
                    pool.install(|| solver.spectra(&angles)).unwrap();
                    start.elapsed().as_secs_f64()
                });
                let rate = 500.0 * 81.0 * 90.0 * 2.0 / seconds.fold(f64::INFINITY, f64::min);
                let emits = if sources.is_some() { ", with its emission" } else { "" };
                println!("k {k}, irregular by {sd}{emits}: {level:?} {rate:.2e} layer evaluations/s");
            }
        }
    }
}
