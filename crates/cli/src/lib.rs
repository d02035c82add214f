//! What the tools `pearl` and `lut` share: reading a table, and pictures of a BSDF without a renderer.

use lut_io::table::Table;
use lut_io::{LutError, exr_file};
use std::io::ErrorKind;
use std::path::Path;
use terminal::Stop;

pub mod preview;

/// Reads a table.
///
/// # Errors
/// Why it cannot be read; of a file that is not there also what makes one.
pub fn read_table(path: &Path) -> Result<Table, Stop> {
    exr_file::read(path).map_err(|error| match &error {
        LutError::Io { source, .. } if source.kind() == ErrorKind::NotFound => {
            Stop::bad_input(format!("{error}; `bake-brdf RECIPE -o {}` bakes it", path.display()))
        }
        _ if error.is_bad_input() => Stop::bad_input(error),
        _ => Stop::failure(error),
    })
}
