//! Stacks of materials: explicit, periodic, and irregular ones drawn from a seed.

use num_complex::Complex64;
use rand::SeedableRng as _;
use rand::rngs::StdRng;
use rand_distr::{Distribution as _, Normal};

use crate::material::{Material, MaterialError, nanometres};
use crate::wave::{Layer, Multilayer, Run, WaveError, check_half_spaces, check_wavelength};

/// One layer of a stack: which material, how thick, how irregular.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StackLayer {
    /// Number of the material in [`Stack::materials`].
    pub material: usize,
    /// Mean thickness, metres.
    pub thickness: f64,
    /// Standard deviation of the thickness from layer to layer, metres; 0 for a regular layer.
    pub thickness_sd: f64,
}

/// A unit of layers that stands `repeat` times in a row.
#[derive(Clone, Debug, PartialEq)]
pub struct StackRun {
    /// The layers of one period, from the ambient side down.
    pub unit: Vec<StackLayer>,
    /// How often.
    pub repeat: u64,
}

/// Whether negative k of layers is meant.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gain {
    /// A negative k is an error.
    #[default]
    Refused,
    /// A negative k amplifies.
    Allowed,
}

/// A stack of materials, for every wavelength.
#[derive(Clone, Debug, PartialEq)]
pub struct Stack {
    /// The half space that the light comes from.
    pub ambient: Material,
    /// The materials of the layers.
    pub materials: Vec<Material>,
    /// The layers, from the ambient side down.
    pub runs: Vec<StackRun>,
    /// The half space behind the layers.
    pub substrate: Material,
    /// Whether negative k is meant.
    pub gain: Gain,
}

/// What is wrong with a stack, or a wave in it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StackError {
    /// There is no layer.
    #[error("the stack is empty: it needs at least one layer")]
    Empty,
    /// A layer names a material that is not there.
    #[error("layer {layer} names material {material}; there are {materials}")]
    NoMaterial {
        /// Number of the layer in its run, from 1.
        layer: usize,
        /// The number it names.
        material: usize,
        /// How many materials there are.
        materials: usize,
    },
    /// A spread of thickness is not a length.
    #[error("layer {layer} has a thickness spread of {sd_nm} nm; it must be finite and not negative")]
    Spread {
        /// Number of the layer in its run, from 1.
        layer: usize,
        /// Standard deviation in nm.
        sd_nm: f64,
    },
    /// A material has no index at a wavelength.
    #[error("{medium}: {source}")]
    Material {
        /// Which medium.
        medium: String,
        /// Why.
        source: MaterialError,
    },
    /// A wave has no answer.
    #[error(transparent)]
    Wave(#[from] WaveError),
    /// It is not wanted any more.
    #[error("stopped")]
    Stopped,
}

impl Stack {
    /// The pearl of the paper and of every default: `layers` layers in total, odd ones of the first material.
    ///
    /// An odd count ends with half a period.
    #[must_use]
    pub fn alternating(
        ambient: Material,
        first: (Material, f64, f64),
        second: (Material, f64, f64),
        layers: u64,
        substrate: Material,
    ) -> Self {
        let layer = |material, thickness, thickness_sd| StackLayer { material, thickness, thickness_sd };
        let unit = vec![layer(0, first.1, first.2), layer(1, second.1, second.2)];
        let mut runs = Vec::new();
        if layers >= 2 {
            runs.push(StackRun { unit: unit.clone(), repeat: layers / 2 });
        }
        if layers % 2 == 1 {
            runs.push(StackRun { unit: vec![unit[0]], repeat: 1 });
        }
        Self { ambient, materials: vec![first.0, second.0], runs, substrate, gain: Gain::Refused }
    }

    /// Number of layers, repeats counted.
    #[must_use]
    pub fn layer_count(&self) -> u128 {
        self.runs.iter().map(|run| run.unit.len() as u128 * u128::from(run.repeat)).sum()
    }

    /// The layers one by one, from the ambient side down.
    pub fn layers(&self) -> impl DoubleEndedIterator<Item = StackLayer> + '_ {
        self.runs.iter().flat_map(|run| (0..run.repeat).flat_map(move |_| run.unit.iter().copied()))
    }

    /// Σ n d over the layers at a vacuum wavelength, metres: fringes at normal incidence are 1/(2 Σ n d) apart in 1/λ.
    ///
    /// # Errors
    /// As [`Stack::check`] and [`Stack::indices`].
    pub fn optical_thickness(&self, wavelength: f64) -> Result<f64, StackError> {
        self.check()?;
        let indices = self.indices(wavelength)?;
        let run = |run: &StackRun| {
            let unit = run.unit.iter().map(|layer| indices.materials[layer.material].re * layer.thickness);
            unit.sum::<f64>() * run.repeat as f64
        };
        Ok(self.runs.iter().map(run).sum())
    }

    /// Whether some layer's thickness varies from place to place.
    #[must_use]
    pub fn is_irregular(&self) -> bool {
        self.runs.iter().filter(|run| run.repeat > 0).any(|run| run.unit.iter().any(|l| l.thickness_sd > 0.0))
    }

    /// Checks numbers that do not depend on the wavelength.
    ///
    /// # Errors
    /// No layer, a material number out of range, a thickness or spread that is not a length.
    pub fn check(&self) -> Result<(), StackError> {
        if self.layer_count() == 0 {
            return Err(StackError::Empty);
        }
        for (at, layer) in self.runs.iter().flat_map(|run| run.unit.iter().enumerate()) {
            if layer.material >= self.materials.len() {
                let (material, materials) = (layer.material, self.materials.len());
                return Err(StackError::NoMaterial { layer: at + 1, material, materials });
            }
            if !(layer.thickness.is_finite() && layer.thickness >= 0.0) {
                return Err(WaveError::Thickness {
                    layer: at + 1,
                    thickness_nm: nanometres(layer.thickness),
                }
                .into());
            }
            if !(layer.thickness_sd.is_finite() && layer.thickness_sd >= 0.0) {
                return Err(StackError::Spread { layer: at + 1, sd_nm: nanometres(layer.thickness_sd) });
            }
        }
        Ok(())
    }

    /// Indices of ambient, materials and substrate at a vacuum wavelength in metres.
    ///
    /// # Errors
    /// A table that does not cover the wavelength; negative k of a half-space, or of a layer without [`Gain::Allowed`]; a wavelength
    /// that is no length.
    pub fn indices(&self, wavelength: f64) -> Result<Indices, StackError> {
        check_wavelength(wavelength)?;
        let index = |material: &Material, medium: &dyn Fn() -> String| {
            material.index(wavelength).map_err(|source| StackError::Material { medium: medium(), source })
        };
        let layer = |(at, material): (usize, &Material)| index(material, &|| material_name(at));
        let indices = Indices {
            ambient: index(&self.ambient, &|| "the ambient".to_owned())?,
            materials: self.materials.iter().enumerate().map(layer).collect::<Result<_, _>>()?,
            substrate: index(&self.substrate, &|| "the substrate".to_owned())?,
        };
        self.check_gain(&indices)?;
        Ok(indices)
    }

    /// Checks indices that are given in place of those of the materials.
    ///
    /// # Errors
    /// Not as many as materials, one that is not finite or whose n is not positive, negative k as for [`Stack::indices`].
    pub fn check_indices(&self, indices: &Indices) -> Result<(), StackError> {
        let (found, expected) = (indices.materials.len(), self.materials.len());
        if found != expected {
            let why = format!("{found} indices are given for {expected} materials");
            return Err(WaveError::Unsuitable(why).into());
        }
        let media = [&indices.ambient, &indices.substrate].into_iter().chain(&indices.materials);
        let is_index = |index: &Complex64| index.is_finite() && index.re > 0.0;
        if let Some((at, index)) = media.enumerate().find(|(_, index)| !is_index(index)) {
            let medium = match at {
                0 => "the ambient".to_owned(),
                1 => "the substrate".to_owned(),
                material => material_name(material - 2),
            };
            let why = format!(
                "{medium} has n = {} and k = {}; n must be positive, both finite",
                index.re, index.im
            );
            return Err(WaveError::Unsuitable(why).into());
        }
        self.check_gain(indices)
    }

    fn check_gain(&self, indices: &Indices) -> Result<(), StackError> {
        let amplifies = |(_, index): &(usize, &Complex64)| index.im < 0.0 && self.gain == Gain::Refused;
        if let Some((at, index)) = indices.materials.iter().enumerate().find(amplifies) {
            return Err(WaveError::Gain { medium: material_name(at), k: index.im }.into());
        }
        Ok(check_half_spaces(indices.ambient, indices.substrate)?)
    }

    /// The stack at one wavelength (metres), mean thicknesses.
    ///
    /// # Errors
    /// As [`Stack::check`] and [`Stack::indices`].
    pub fn at(&self, wavelength: f64) -> Result<Multilayer, StackError> {
        self.check()?;
        Ok(self.with_indices(&self.indices(wavelength)?))
    }

    /// The stack of these indices, mean thicknesses; stack and indices are checked.
    #[must_use]
    pub fn with_indices(&self, indices: &Indices) -> Multilayer {
        let run = |run: &StackRun| Run {
            unit: run
                .unit
                .iter()
                .map(|layer| Layer { index: indices.materials[layer.material], thickness: layer.thickness })
                .collect(),
            repeat: run.repeat,
        };
        Multilayer {
            ambient: indices.ambient,
            runs: self.runs.iter().map(run).collect(),
            substrate: indices.substrate,
        }
    }

    /// Member `member` of the ensemble that `seed` names: every layer's thickness drawn from a normal distribution,
    /// negative draws redrawn. A pure function of stack, seed and member. A regular stack comes back as it is.
    ///
    /// # Errors
    /// As [`Stack::check`]; more than [`crate::field::MOST_LISTED_LAYERS`] layers.
    pub fn draw(&self, seed: u64, member: u64) -> Result<Self, StackError> {
        self.check()?;
        if !self.is_irregular() {
            return Ok(self.clone());
        }
        let most = crate::field::MOST_LISTED_LAYERS;
        if self.layer_count() > u128::from(most) {
            return Err(WaveError::TooManyLayers { layers: self.layer_count(), most }.into());
        }
        let mut random =
            StdRng::seed_from_u64(seed ^ member.wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(32));
        let unit = self.layers().map(|layer| StackLayer {
            thickness: draw_thickness(&mut random, layer.thickness, layer.thickness_sd),
            thickness_sd: 0.0,
            ..layer
        });
        Ok(Self { runs: vec![StackRun { unit: unit.collect(), repeat: 1 }], ..self.clone() })
    }
}

fn material_name(at: usize) -> String {
    format!("material {}", at + 1)
}

/// Indices of a stack's media at one wavelength.
#[derive(Clone, Debug, PartialEq)]
pub struct Indices {
    /// Of the ambient.
    pub ambient: Complex64,
    /// Of [`Stack::materials`], in their order.
    pub materials: Vec<Complex64>,
    /// Of the substrate.
    pub substrate: Complex64,
}

fn draw_thickness(random: &mut StdRng, mean: f64, sd: f64) -> f64 {
    let Ok(normal) = Normal::new(mean, sd) else { return mean };
    // mean ≥ 0, so half of all draws or more are accepted.
    loop {
        let thickness = normal.sample(random);
        if thickness >= 0.0 {
            return thickness;
        }
    }
}
