//! Metadata of compact files: deflated, and written as base64 text.

use super::ATTRIBUTE;
use crate::error::FieldError;
use crate::model::limits::MAX_META_BYTES;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};

/// Deflate's slowest and smallest.
const LEVEL: u8 = 10;
/// The text attribute of a compact file.
#[derive(Deserialize, Serialize)]
pub(crate) struct Packed {
    /// [`super::compact::COMPACT_SCHEMA`].
    pub(crate) schema: String,
    /// The metadata as JSON, in zlib's format, in base64.
    pub(crate) packed: String,
}

/// Packs metadata given as JSON text.
pub(crate) fn pack(schema: &str, json: &str) -> Result<String, FieldError> {
    let deflated = miniz_oxide::deflate::compress_to_vec_zlib(json.as_bytes(), LEVEL);
    let packed = Packed { schema: schema.to_owned(), packed: STANDARD.encode(deflated) };
    serde_json::to_string(&packed).map_err(|error| FieldError::new("metadata", error.to_string()))
}

/// The JSON text of packed metadata; at most [`MAX_META_BYTES`].
pub(crate) fn unpack(packed: &str) -> Result<Vec<u8>, FieldError> {
    let field = || format!("attribute {ATTRIBUTE} field packed");
    let deflated = STANDARD
        .decode(packed)
        .map_err(|error| FieldError::new(field(), format!("is not base64: {error}")))?;
    miniz_oxide::inflate::decompress_to_vec_zlib_with_limit(&deflated, MAX_META_BYTES).map_err(|error| {
        FieldError::new(
            field(),
            format!("does not inflate to at most {MAX_META_BYTES} bytes: {:?}", error.status),
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_packed_is_unpacked() {
        let json = r#"{"schema":"pearl-lut/1.1","seed":7}"#;
        let packed: Packed = serde_json::from_str(&pack("pearl-lut/1.1", json).unwrap()).unwrap();
        assert_eq!(unpack(&packed.packed).unwrap(), json.as_bytes());
    }

    #[test]
    fn damaged_or_boundless_text_is_refused() {
        assert!(unpack("not base64!").unwrap_err().problem.contains("base64"));
        assert!(unpack("AAAA").unwrap_err().problem.contains("inflate"));
        let bomb = miniz_oxide::deflate::compress_to_vec_zlib(&vec![b' '; MAX_META_BYTES + 1], 6);
        assert!(unpack(&STANDARD.encode(bomb)).unwrap_err().problem.contains("at most"));
    }
}
