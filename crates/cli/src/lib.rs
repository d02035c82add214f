//! What the tools `lut`, `pearl` and `thinfilm` share: reading a table, writing a file, and pictures of a BSDF without a renderer.
//!
//! A picture of eight by eight pixels:
//!
//! ```
//! use nacre_cli::preview::{self, Lighting, Quality, Shape};
//! use pearl_bsdf::{Controls, PearlBsdf, Prepared};
//! use std::sync::Arc;
//!
//! let table = lut_io::exr_file::decode(lut_io::EXAMPLE)?;
//! let pearl = PearlBsdf::new(Arc::new(Prepared::new(table)?), Controls::default())?;
//! let quality = Quality { size: 8, samples: 1, seed: 1 };
//! let pictures = preview::render([&pearl], Shape::Sphere, &[Lighting::Distant], quality);
//! let lit = pictures[0][0].view(preview::SUM).iter().filter(|rgb| rgb[1] > 0.0).count();
//! assert!(lit > 8, "{lit}");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! # Modules
//!
//! - [`preview`]: a sphere and a free-form swatch, a picture a component;
//! - [`read_table`], [`read_recipe`], [`write_file`] and [`print_files`] give errors that a tool can end with ([`terminal::Stop`]).
//!
//! The crate has no features to choose. Each tool is a binary of its own beside this library; `lut man` has the manual of `lut`.

use bake_brdf::recipe::{self, Recipe};
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

/// Reads a recipe: of a file, of standard input, or of a built-in name.
///
/// # Errors
/// Why there is none, or what is wrong with it.
pub fn read_recipe(path: &Path) -> Result<Recipe, Stop> {
    recipe::named(path, |path| terminal::read_text(path, recipe::MAX_BYTES), Stop::BadInput)
}

/// Finds out before the work what would end it after, and keeps a table or a recipe (`what`) from being written over by what is made of
/// it.
///
/// # Errors
/// The output is the input, or cannot be written.
pub fn check_output(what: &str, input: &Path, output: &Path) -> Outcome {
    if lut_io::atomic::same_file(input, output) {
        let problem = format!("is the {what} itself, which would be lost: name another file");
        return Err(Stop::bad_input(format!("--output: {} {problem}", output.display())));
    }
    lut_io::atomic::check(output).map_err(|why| Stop::failure(format!("{}: {why}", output.display())))
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
