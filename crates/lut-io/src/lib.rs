//! The pearl table (`pearl-lut/1`): one OpenEXR file that holds the light a nacre stack sends back.
//!
//! [`axis`] says which directions a row's cells cover, [`decay`] is the azimuth postulate, [`table`] is the
//! table in memory. The file's layout is documented in `docs/LUT-FORMAT.md`.

pub mod axis;
pub mod decay;
pub mod table;
