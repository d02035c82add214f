//! NumPy's .npz: a zip archive of .npy files, stored as they are. The same arrays give the same bytes.

use crate::Array;
use std::io::{Cursor, Write as _};
use zip::result::ZipResult;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, DateTime, ZipWriter};

/// The bytes of an archive.
pub(super) fn encode(arrays: &[Array]) -> ZipResult<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let stored = SimpleFileOptions::default()
        .compression_method(CompressionMethod::Stored)
        .last_modified_time(DateTime::default());
    for Array { name, shape, values, .. } in arrays {
        archive.start_file(format!("{name}.npy"), stored)?;
        archive.write_all(&header(shape))?;
        archive.write_all(&values.iter().flat_map(|x| x.to_le_bytes()).collect::<Vec<u8>>())?;
    }
    Ok(archive.finish()?.into_inner())
}

/// Header of a .npy file, version 1.0 (<https://numpy.org/doc/stable/reference/generated/numpy.lib.format.html>).
fn header(shape: &[usize]) -> Vec<u8> {
    const MAGIC: &[u8] = b"\x93NUMPY\x01\x00";
    const ALIGNMENT: usize = 64;
    // A tuple of one has a comma behind it.
    let shape: String = shape.iter().map(|count| format!("{count}, ")).collect();
    let mut text = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", shape.trim_end());
    let unpadded = MAGIC.len() + 2 + text.len() + 1;
    text.push_str(&" ".repeat(unpadded.next_multiple_of(ALIGNMENT) - unpadded));
    text.push('\n');
    let length = u16::try_from(text.len()).unwrap_or(u16::MAX).to_le_bytes();
    [MAGIC, &length, text.as_bytes()].concat()
}
