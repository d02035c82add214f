//! What the tools `pearl` and `lut` share: pictures of a BSDF without a renderer.

pub mod preview;
