//! Interference colours of a recipe for rendering: M(λ, θ), Ê(λ, θ) and their RGB (MODEL §8, §9).
//!
//! Values are means over bands of 10 nm from 380 to 780 nm of as many wavelengths as the work allows, so that fringes
//! (0.84 nm wide for 500 layers) do not alias; RGB is summed over the single wavelengths. A stack with irregular
//! thicknesses is the mean over an ensemble drawn from a fixed seed.
//!
//! - M = R_coherent/R_incoherent; R_incoherent is what the walk tends to for σ → 0: reflectances of the interfaces, added
//!   as intensities at the walk's wavelength. M ≤ 1/R_incoherent by construction.
//! - Ê ∝ (1/cos θ) ∫|E(z)|² dz over the layers for a unit wave entering at θ (reciprocity; uniform sources), with unit
//!   mean over the bands.

use crate::recipe::{Count, Recipe, RecipeError};
use lut_io::spectra::Spectra;
use rayon::prelude::*;
use thinfilm::{
    Gain, Incidence, Layer, Material, MaterialError, Multilayer, Polarisation, Run, Stack, StackError,
    StackLayer, StackRun, WaveError, colour,
};
use transport::Transport;

/// Range and number of bands.
const FIRST_NM: f64 = 380.0;
const BAND_NM: f64 = 10.0;
const BANDS: usize = 40;
/// Angles, degrees.
const STEP_DEG: usize = 3;
/// Stands in for 90°, where the incident power vanishes.
const GRAZING_DEG: f64 = 89.9;
/// Most wavelengths a band: fringes of 500 layers are 0.84 nm wide.
const FINEST: usize = 20;
/// Layers × wavelengths × angles × polarisations × members that one table may cost, for reflectance and for fields
/// (about 60 and 150 ns each).
const REFLECTANCE_WORK: f64 = 1e8;
const FIELD_WORK: f64 = 2e7;
/// Members of an ensemble of irregular stacks, for reflectance and for fields.
const MEMBERS: usize = 16;
const FIELD_MEMBERS: usize = 4;
/// Deepest part of a stack that waves are followed in one layer at a time.
const DEEPEST: usize = 20_000;
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
    Stack(#[from] StackError),
    /// A wave in the stack.
    #[error("interference colours: {0}")]
    Wave(#[from] WaveError),
}

/// The colours of a recipe; takes seconds for an irregular stack, less for a regular one.
///
/// # Errors
/// A recipe that the transport problem refuses, or a wave that the stack amplifies without bound.
pub fn of(recipe: &Recipe) -> Result<Spectra, SpectraError> {
    let transport = recipe.transport(recipe.wavelength())?;
    let stack = stack(recipe);
    let members = Members::new(&stack)?;
    let theta_deg: Vec<f64> = (0..=90).step_by(STEP_DEG).map(|degrees| degrees as f64).collect();
    let angles: Vec<Angle> = theta_deg
        .par_iter()
        .map(|degrees| members.at(degrees.min(GRAZING_DEG).to_radians(), &transport))
        .collect::<Result<_, _>>()?;
    Ok(Spectra {
        wavelength_nm: (0..BANDS).map(|band| FIRST_NM + BAND_NM * (band as f64 + 0.5)).collect(),
        theta_deg,
        modulation: angles.iter().map(|a| a.modulation.clone()).collect(),
        illuminant: angles.iter().map(|a| a.illuminant.clone()).collect(),
        incoherent: angles.iter().map(|a| vec![a.incoherent; BANDS]).collect(),
        modulation_rgb: angles.iter().map(|a| a.modulation_rgb).collect(),
        illuminant_rgb: angles.iter().map(|a| a.illuminant_rgb).collect(),
    })
}

/// The rows of one angle.
struct Angle {
    modulation: Vec<f64>,
    illuminant: Vec<f64>,
    incoherent: f64,
    modulation_rgb: [f64; 3],
    illuminant_rgb: [f64; 3],
}

/// The stacks that are averaged, and how finely.
struct Members {
    stacks: Vec<Stack>,
    reflectance_per_band: usize,
    field_per_band: usize,
}

impl Members {
    fn new(stack: &Stack) -> Result<Self, StackError> {
        let irregular = stack.is_irregular();
        let count = if irregular { MEMBERS } else { 1 };
        let stacks: Vec<Stack> =
            (0..count as u64).map(|member| stack.draw(SEED, member)).collect::<Result<_, _>>()?;
        // Repeated units are doubled: a few products in place of every layer.
        let steps: f64 = stacks[0]
            .runs
            .iter()
            .map(|run| run.unit.len() as f64 * (1.0 + (run.repeat as f64).log2().max(0.0)))
            .sum();
        let waves = (BANDS * (90 / STEP_DEG + 1) * 2) as f64;
        let per_band = |work: f64, steps: f64, members: usize| {
            ((work / (waves * steps * members as f64)) as usize).clamp(1, FINEST)
        };
        let layers = stack.layer_count() as f64;
        Ok(Self {
            reflectance_per_band: per_band(REFLECTANCE_WORK, steps, count),
            field_per_band: per_band(FIELD_WORK, layers, count.min(FIELD_MEMBERS)),
            stacks,
        })
    }

    fn at(&self, theta: f64, transport: &Transport) -> Result<Angle, SpectraError> {
        let incoherent = incoherent_reflectance(transport, theta);
        let (nm, reflectance) =
            self.spectrum(self.reflectance_per_band, &self.stacks, |stack, metres, pol| {
                Ok(stack.solve(metres, Incidence::Angle(theta), pol)?.reflectance)
            })?;
        let most = 1.0 / incoherent;
        let modulation: Vec<f64> = reflectance.iter().map(|r| (r / incoherent).clamp(0.0, most)).collect();
        let emitters = &self.stacks[..self.stacks.len().min(FIELD_MEMBERS)];
        let (emission_nm, emission) =
            self.spectrum(self.field_per_band, emitters, |stack, metres, pol| {
                Ok(stack.field(metres, Incidence::Angle(theta), pol)?.integrals().iter().sum())
            })?;
        let mean = emission.iter().sum::<f64>() / emission.len() as f64;
        // 1/cos θ drops out of the unit mean. Without layers to emit there is no hue either.
        let illuminant: Vec<f64> = emission.iter().map(|e| if mean > 0.0 { e / mean } else { 1.0 }).collect();
        Ok(Angle {
            modulation_rgb: colour::linear_srgb_of(&metres(&nm), &modulation).map(|c| c.clamp(0.0, most)),
            illuminant_rgb: colour::linear_srgb_of(&metres(&emission_nm), &illuminant).map(|c| c.max(0.0)),
            modulation: band_means(&modulation),
            illuminant: band_means(&illuminant),
            incoherent,
        })
    }

    /// A quantity over equidistant wavelengths (nm), mean over stacks and polarisations.
    fn spectrum(
        &self,
        per_band: usize,
        stacks: &[Stack],
        value: impl Fn(&Multilayer, f64, Polarisation) -> Result<f64, SpectraError>,
    ) -> Result<(Vec<f64>, Vec<f64>), SpectraError> {
        let step = BAND_NM / per_band as f64;
        let nm: Vec<f64> = (0..BANDS * per_band).map(|i| FIRST_NM + step * (i as f64 + 0.5)).collect();
        let mut values = Vec::with_capacity(nm.len());
        for nm in &nm {
            let mut sum = 0.0;
            for stack in stacks {
                let waves = multilayer(stack, nm * 1e-9)?;
                for polarisation in Polarisation::BOTH {
                    sum += value(&waves, nm * 1e-9, polarisation)?;
                }
            }
            values.push(sum / (2 * stacks.len()) as f64);
        }
        Ok((nm, values))
    }
}

fn metres(nm: &[f64]) -> Vec<f64> {
    nm.iter().map(|nm| nm * 1e-9).collect()
}

fn band_means(values: &[f64]) -> Vec<f64> {
    let per_band = values.len() / BANDS;
    values.chunks(per_band).map(|band| band.iter().sum::<f64>() / per_band as f64).collect()
}

/// The recipe's stack for waves; of an explicit or irregular one the uppermost 20,000 layers.
fn stack(recipe: &Recipe) -> Stack {
    let source = &recipe.stack;
    let (ambient, substrate) = (source.ambient.material(), source.substrate.material());
    let count = source.layer_count();
    let resolved = source.layers_resolved();
    if source.explicit.is_none() && count >= 2 {
        let layer =
            |i: usize| (resolved[i].material.clone(), resolved[i].thickness, resolved[i].thickness_sd);
        let irregular = resolved[0].thickness_sd > 0.0 || resolved[1].thickness_sd > 0.0;
        let count = if irregular { count.min(DEEPEST) } else { count };
        debug_assert!(matches!(source.count, Count::Layers | Count::Pairs));
        return Stack::alternating(ambient, layer(0), layer(1), count as u64, substrate);
    }
    let kept = &resolved[..count.min(DEEPEST)];
    let unit = kept.iter().enumerate().map(|(material, layer)| StackLayer {
        material,
        thickness: layer.thickness,
        thickness_sd: layer.thickness_sd,
    });
    Stack {
        ambient,
        materials: kept.iter().map(|layer| layer.material.clone()).collect(),
        runs: vec![StackRun { unit: unit.collect(), repeat: 1 }],
        substrate,
        gain: Gain::Refused,
    }
}

/// The stack at a wavelength; a tabulated index stays constant beyond its table.
fn multilayer(stack: &Stack, metres: f64) -> Result<Multilayer, StackError> {
    let index = |material: &Material| {
        let index = material.index(metres).or_else(|error| match error {
            MaterialError::OutsideTable { from_nm, to_nm, wavelength_nm } => {
                material.index(wavelength_nm.clamp(from_nm, to_nm) * 1e-9)
            }
            other => Err(other),
        });
        index.map_err(|source| StackError::Material { medium: "a layer or half space".to_owned(), source })
    };
    let materials: Vec<_> = stack.materials.iter().map(index).collect::<Result<_, _>>()?;
    let run = |run: &StackRun| Run {
        unit: run
            .unit
            .iter()
            .map(|layer| Layer { index: materials[layer.material], thickness: layer.thickness })
            .collect(),
        repeat: run.repeat,
    };
    Ok(Multilayer {
        ambient: index(&stack.ambient)?,
        runs: stack.runs.iter().map(run).collect(),
        substrate: index(&stack.substrate)?,
    })
}

/// Reflectance of the stack when intensities add: the walk with flat interfaces.
fn incoherent_reflectance(transport: &Transport, theta: f64) -> f64 {
    let indices = &transport.indices;
    let sin = indices[0] * theta.sin();
    let cos = |n: f64| (1.0 - (sin / n).powi(2)).max(0.0).sqrt();
    let last = indices.len() - 1;
    let mut below = fresnel(indices[last - 1], cos(indices[last - 1]), indices[last], cos(indices[last]));
    for layer in (1..last).rev() {
        let depth = transport.optical_depths[layer - 1];
        let passed = if depth > 0.0 { (-2.0 * depth / cos(indices[layer])).exp() } else { 1.0 };
        let r = fresnel(indices[layer - 1], cos(indices[layer - 1]), indices[layer], cos(indices[layer]));
        let inside = passed * below;
        // r + (1 − r)²·inside/(1 − r·inside), which is 1 where both are.
        below = if r >= 1.0 { 1.0 } else { r + (1.0 - r) * (1.0 - r) * inside / (1.0 - r * inside) };
    }
    // A stack that matches the ambient reflects nothing coherently either; the floor keeps the quotient finite.
    below.max(1e-6)
}

/// Unpolarised reflectance of an interface; 1 for a wave that does not pass.
fn fresnel(n1: f64, cos1: f64, n2: f64, cos2: f64) -> f64 {
    if cos2 <= 0.0 || cos1 <= 0.0 {
        return 1.0;
    }
    let s = (n1 * cos1 - n2 * cos2) / (n1 * cos1 + n2 * cos2);
    let p = (n2 * cos1 - n1 * cos2) / (n2 * cos1 + n1 * cos2);
    0.5 * (s * s + p * p)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn recipe(text: &str) -> Recipe {
        Recipe::from_json(text).unwrap()
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
        let spectra = of(&recipe(r#"{"stack": {"layers": 7}}"#)).unwrap();
        spectra.validate().unwrap();
        for (i, row) in spectra.modulation.iter().enumerate() {
            let most = 1.0 / spectra.incoherent[i][0];
            assert!(row.iter().chain(&spectra.modulation_rgb[i]).all(|m| *m <= most + 1e-12));
            let mean = spectra.illuminant[i].iter().sum::<f64>() / BANDS as f64;
            assert!((mean - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn a_stack_of_one_index_has_no_hue_but_that_of_its_surface() {
        // One thick layer of the substrate's own material: a single interface, coherent = incoherent.
        let spectra = of(&recipe(
            r#"{"stack": {"explicit": [{"n": 1.5, "thickness_nm": 1000}], "substrate": {"n": 1.5}}}"#,
        ))
        .unwrap();
        for row in &spectra.modulation[..spectra.modulation.len() - 1] {
            assert!(row.iter().all(|m| (m - 1.0).abs() < 1e-9), "{row:?}");
        }
        for rgb in spectra.illuminant_rgb {
            assert!(rgb.iter().all(|c| (c - 1.0).abs() < 1e-6), "{rgb:?}");
        }
    }

    #[test]
    fn a_tabulated_index_that_ends_inside_the_visible_is_held_constant() {
        let spectra = of(&recipe(
            r#"{"stack": {"explicit": [{"n": {"table": [[540, 1.5, 0], [560, 1.6, 0]]}, "thickness_nm": 300}]}}"#,
        ))
        .unwrap();
        spectra.validate().unwrap();
    }

    #[test]
    fn irregular_stacks_are_reproducible() {
        let text = r#"{"stack": {"layers": 6, "aragonite": {"thickness_sd_nm": 20}}}"#;
        assert_eq!(of(&recipe(text)).unwrap(), of(&recipe(text)).unwrap());
    }
}
