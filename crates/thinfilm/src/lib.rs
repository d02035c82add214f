#![doc = include_str!("../README.md")]
#![doc = include_str!("conventions.md")]

pub mod colour;
pub mod dense;
pub mod emission;
pub mod ensemble;
pub mod field;
pub mod intensity;
pub mod library;
pub mod line;
pub mod material;
pub mod modulation;
mod phase;
mod precise;
pub mod quadrature;
pub mod reference_case;
mod scaled;
mod scattering;
pub mod stack;
pub mod wave;

pub use field::Field;
pub use material::{Dispersion, Material, MaterialError, nanometres};
pub use stack::{Gain, Indices, Stack, StackError, StackLayer, StackRun};
pub use wave::{Incidence, Layer, Multilayer, Polarisation, Response, Run, WaveError};
