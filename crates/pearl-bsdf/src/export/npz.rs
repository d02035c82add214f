//! NumPy's .npz: a zip archive of .npy files. The same arrays give the same bytes.

use crate::Array;
use half::f16;
use std::io::{Cursor, Write as _};
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// Numbers of an array, and whether they are deflated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Form {
    /// Single precision, as they are.
    Whole,
    /// Deflated, in half precision where that is named: for pages that travel.
    Small,
}

/// Arrays that keep a colour's accuracy in half precision (5e-4 of a value): curves of colours.
fn may_be_half(name: &str) -> bool {
    name.ends_with("_spectral") || name.ends_with("_scaled")
}

/// The bytes of an archive.
///
/// # Errors
/// More than an archive holds.
pub fn encode(arrays: &[Array], form: Form) -> ZipResult<Vec<u8>> {
    let method = match form {
        Form::Whole => CompressionMethod::Stored,
        Form::Small => CompressionMethod::Deflated,
    };
    let options = SimpleFileOptions::default()
        .compression_method(method)
        .compression_level((form == Form::Small).then_some(9))
        .last_modified_time(DateTime::default());
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    for Array { name, shape, values, .. } in arrays {
        let half = form == Form::Small && may_be_half(name);
        archive.start_file(format!("{name}.npy"), options)?;
        archive.write_all(&header(shape, if half { "<f2" } else { "<f4" }))?;
        let bytes: Vec<u8> = if half {
            values.iter().flat_map(|x| f16::from_f32(*x).to_le_bytes()).collect()
        } else {
            values.iter().flat_map(|x| x.to_le_bytes()).collect()
        };
        archive.write_all(&bytes)?;
    }
    Ok(archive.finish()?.into_inner())
}

/// Header of a .npy file, version 1.0 (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>).
fn header(shape: &[usize], kind: &str) -> Vec<u8> {
    const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
    const ALIGNMENT: usize = 64;
    // A tuple of one has a comma behind it.
    let shape: String = shape.iter().map(|count| format!("{count}, ")).collect();
    let mut text =
        format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({}), }}", shape.trim_end());
    let unpadded = MAGIC.len() + 2 + text.len() + 1;
    text.push_str(&" ".repeat(unpadded.next_multiple_of(ALIGNMENT) - unpadded));
    text.push('\n');
    let length = u16::try_from(text.len()).unwrap_or(u16::MAX).to_le_bytes();
    [MAGIC, &length, text.as_bytes()].concat()
}
