//! Multilayer thin-film interference and its colour.
//!
//! [`Multilayer::solve`](wave::Multilayer::solve) gives r, t, R, T, A of one stack at one wavelength and angle, in every
//! hard case; [`dense`] does many wavelengths and angles at once, fast; [`colour`] turns spectra into colours.
#![doc = include_str!("conventions.md")]

pub mod dense;
pub mod field;
pub mod material;
mod scaled;
mod scattering;
pub mod reference_case;
pub mod stack;
pub mod wave;

pub use material::{Dispersion, Material, MaterialError};
pub use field::Field;
pub use stack::{Gain, Indices, Stack, StackError, StackLayer, StackRun};
pub use wave::{Incidence, Layer, Multilayer, Polarisation, Response, Run, WaveError};
