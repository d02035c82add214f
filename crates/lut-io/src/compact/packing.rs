//! Metadata of compact files: numbers rounded to what they are worth, deflated, and written as base64 text.

use crate::error::FieldError;
use crate::exr_file::{ATTRIBUTE, MAX_META_BYTES};
use crate::spectra::Spectra;
use crate::table::Meta;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde::{Deserialize, Serialize};

/// Deflate's slowest and smallest.
const LEVEL: u8 = 10;
/// Significant digits of standard errors.
const ERROR_DIGITS: usize = 2;
/// Significant digits of shares and moments.
const SHARE_DIGITS: usize = 7;

/// The text attribute of a compact file.
#[derive(Deserialize, Serialize)]
pub(crate) struct Packed {
    /// [`super::COMPACT_SCHEMA`].
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

/// Rounds what the metadata say of each incidence, and the interference colours to `band_digits` significant digits.
///
/// The ledger still closes: what is transmitted takes up the rounding.
///
/// # Errors
/// A section `spectra` that is not valid.
pub fn round(meta: &mut Meta, band_digits: usize) -> Result<(), FieldError> {
    let share = |x: f64| to_digits(x, SHARE_DIGITS);
    for s in &mut meta.per_incidence {
        for field in [&mut s.albedo, &mut s.absorbed, &mut s.truncated, &mut s.surface, &mut s.rehit] {
            *field = share(*field);
        }
        for field in [&mut s.mean_theta_o_deg, &mut s.sd_theta_o_deg, &mut s.skew_theta_o] {
            *field = to_digits(*field, SHARE_DIGITS);
        }
        s.azimuth_width_deg = share(s.azimuth_width_deg);
        s.surface = s.surface.min(s.albedo);
        s.rehit = s.rehit.min(s.surface);
        // Ten decimals: shorter than the difference's own digits, and far below the ledger's tolerance.
        let rest = 1.0 - s.albedo - s.absorbed - s.truncated;
        s.transmitted = ((rest * 1e13).round() / 1e13).max(0.0);
        let e = &mut s.std_error;
        for field in [
            &mut e.albedo,
            &mut e.transmitted,
            &mut e.absorbed,
            &mut e.truncated,
            &mut e.surface,
            &mut e.mean_theta_o_deg,
            &mut e.sd_theta_o_deg,
            &mut e.skew_theta_o,
            &mut s.accuracy_percent,
        ] {
            *field = to_digits(*field, ERROR_DIGITS);
        }
    }
    let Some(mut spectra) = Spectra::of(meta)? else { return Ok(()) };
    let band = |x: &mut f64| *x = to_digits(*x, band_digits);
    // Colours in RGB are few, and what most pictures are made of.
    let rgb = |x: &mut f64| *x = to_digits(*x, band_digits + 1);
    if let Some(coherent) = &mut spectra.coherent {
        coherent.modulation.iter_mut().flatten().for_each(band);
        coherent.modulation_rgb.iter_mut().flatten().for_each(rgb);
        coherent.incoherent.iter_mut().for_each(rgb);
    }
    if let Some(emission) = &mut spectra.emission {
        emission.radiance.iter_mut().flatten().for_each(band);
        emission.radiance_rgb.iter_mut().flatten().for_each(rgb);
    }
    spectra.store(meta)
}

/// The number with so many significant decimal digits.
fn to_digits(x: f64, digits: usize) -> f64 {
    format!("{x:.*e}", digits.saturating_sub(1)).parse().unwrap_or(x)
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
