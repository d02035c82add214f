//! The pearl table (`pearl-lut/1`): one OpenEXR file that holds the light a nacre stack sends back.
//!
//! [`axis`] says which directions a row's cells cover, [`measure`] how much direction a cell stands for,
//! [`decay`] is the azimuth postulate, [`table`] is the table in memory, [`lobe`] reads it at any pair of
//! directions, [`both_sides`] adds transmission and light from below, [`compact`] are small forms of a table, [`dispersion`] lobes at further wavelengths, [`reciprocal`] makes a table the same both ways, [`spectra`] holds the colours of interference, [`exr_file`] is the file. [`slice`](mod@slice), [`check`], [`diff`] and [`reciprocity`] are what the tool `lut` shows. The file's layout is documented in `docs/LUT-FORMAT.md`.

pub mod atomic;
pub mod axis;
pub mod both_sides;
pub mod check;
pub mod compact;
pub mod decay;
pub mod diff;
pub mod dispersion;
pub mod error;
pub mod exr_file;
pub mod lobe;
pub mod measure;
pub mod merl;
pub mod monotone;
pub mod profile;
pub mod reciprocal;
pub mod reciprocity;
pub mod slice;
pub mod spectra;
pub mod table;
pub mod tensor_file;

pub use error::{FieldError, LutError};
pub use table::Table;
