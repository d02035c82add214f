//! The table on disk.

pub(crate) mod analytic;
pub mod atomic;
pub mod compact;
pub mod exr_file;
mod packing;
mod zip;

/// Name of the text attribute that holds the metadata.
const ATTRIBUTE: &str = "pearl";
