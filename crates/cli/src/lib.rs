//! What the tools share: reading a table, writing a file, and pictures of a BSDF without a renderer.

use lut_io::table::Table;
use lut_io::{LutError, exr_file};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use terminal::{Manners, Outcome, Stop};

pub mod preview;

/// Reads a table.
///
/// # Errors
/// Why it cannot be read; of a file that is not there also what makes one.
pub fn read_table(path: &Path) -> Result<Table, Stop> {
    exr_file::read(path).map_err(|error| match &error {
        LutError::Io { .. } if path.as_os_str() == "-" => {
            Stop::bad_input("-: a table is read from a file, not from standard input")
        }
        LutError::Io { source, .. } if source.kind() == ErrorKind::NotFound => {
            Stop::bad_input(format!("{error}; `bake-brdf RECIPE -o {}` bakes it", path.display()))
        }
        _ if error.is_bad_input() => Stop::bad_input(error),
        _ => Stop::failure(error),
    })
}

/// Writes a file whole or not at all.
///
/// # Errors
/// Why it cannot be written, with its name.
pub fn write_file(path: &Path, bytes: &[u8]) -> Outcome {
    lut_io::atomic::write(path, bytes)
        .map_err(|error| Stop::failure(format!("{}: cannot write the file: {error}", path.display())))
}

/// Says which files a tool wrote: one a line, or as an object.
///
/// # Errors
/// Standard output takes no more.
pub fn print_files(schema: &str, files: &[PathBuf], manners: &Manners) -> Outcome {
    let names: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
    if manners.json {
        return terminal::print_json(&serde_json::json!({ "schema": schema, "files": names }));
    }
    if manners.quiet { Ok(()) } else { terminal::print(&(names.join("\n") + "\n")) }
}
