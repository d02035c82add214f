//! The tensor file of the RGL material database (`.bsdf`): named arrays behind a small header, little-endian.
//!
//! `"tensor_file\0"`, version 1.0 as two bytes, u32 field count; per field u16 length and bytes of the name, u16
//! dimensions, u8 type, u64 offset from the start of the file, u64 extents. Read by Mitsuba's `measured`, pbrt-v4 and
//! powitacq (Dupuy and Jakob, *An Adaptive Parameterization for Efficient Material Acquisition and Rendering*, 2018).

use crate::error::{FieldError, ensure};

const MAGIC: &[u8] = b"tensor_file\0\x01\x00";
/// Types of the format that are used here.
const U8: u8 = 1;
const F32: u8 = 10;
/// Every array starts at a multiple of this, so that it can be mapped.
const ALIGNMENT: usize = 8;
/// Most fields, and most dimensions of one, that a file may have.
const MOST_FIELDS: u32 = 64;
const MOST_DIMENSIONS: u16 = 16;

/// Values of an array, the last extent fastest.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
    /// Bytes.
    U8(Vec<u8>),
    /// Single precision.
    F32(Vec<f32>),
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Self::U8(bytes) => bytes.len(),
            Self::F32(numbers) => numbers.len(),
        }
    }

    const fn bytes(&self) -> usize {
        match self {
            Self::U8(bytes) => bytes.len(),
            Self::F32(numbers) => 4 * numbers.len(),
        }
    }

    fn append_to(&self, file: &mut Vec<u8>) {
        match self {
            Self::U8(bytes) => file.extend(bytes),
            Self::F32(numbers) => file.extend(numbers.iter().flat_map(|x| x.to_le_bytes())),
        }
    }
}

/// One named array.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Name.
    pub name: String,
    /// Extents, the last one fastest.
    pub shape: Vec<usize>,
    /// Values, as many as the extents say.
    pub values: Values,
}

impl Field {
    /// An array of single-precision numbers.
    #[must_use]
    pub fn f32(name: &str, shape: &[usize], values: Vec<f32>) -> Self {
        Self { name: name.to_owned(), shape: shape.to_vec(), values: Values::F32(values) }
    }

    /// An array of bytes, one-dimensional.
    #[must_use]
    pub fn u8(name: &str, values: &[u8]) -> Self {
        Self { name: name.to_owned(), shape: vec![values.len()], values: Values::U8(values.to_vec()) }
    }
}

/// The bytes of a file with these fields.
///
/// # Errors
/// A field whose extents are not those of its values.
pub fn encode(fields: &[Field]) -> Result<Vec<u8>, FieldError> {
    for field in fields {
        let (expected, found): (usize, usize) = (field.shape.iter().product(), field.values.len());
        ensure(&field.name, found == expected, || {
            format!("has {found} values, expected {expected} from {:?}", field.shape)
        })?;
    }
    let header: usize = fields.iter().map(|f| 2 + f.name.len() + 2 + 1 + 8 + 8 * f.shape.len()).sum();
    let mut bytes = MAGIC.to_vec();
    bytes.extend((fields.len() as u32).to_le_bytes());
    let mut end = bytes.len() + header;
    let mut starts = Vec::with_capacity(fields.len());
    for field in fields {
        let start = end.next_multiple_of(ALIGNMENT);
        bytes.extend((field.name.len() as u16).to_le_bytes());
        bytes.extend(field.name.as_bytes());
        bytes.extend((field.shape.len() as u16).to_le_bytes());
        bytes.push(if matches!(field.values, Values::U8(_)) { U8 } else { F32 });
        bytes.extend((start as u64).to_le_bytes());
        bytes.extend(field.shape.iter().flat_map(|extent| (*extent as u64).to_le_bytes()));
        end = start + field.values.bytes();
        starts.push(start);
    }
    // A spectral file is some hundred megabytes: it is not to be held twice.
    bytes.reserve_exact(end - bytes.len());
    for (start, field) in starts.into_iter().zip(fields) {
        bytes.resize(start, 0);
        field.values.append_to(&mut bytes);
    }
    Ok(bytes)
}

/// The fields of a file; only those of the two types used here.
///
/// # Errors
/// Not such a file, a damaged one, or another type.
pub fn decode(bytes: &[u8]) -> Result<Vec<Field>, FieldError> {
    let mut rest = bytes
        .strip_prefix(MAGIC)
        .ok_or_else(|| FieldError::new("file", "does not start with tensor_file, version 1.0"))?;
    let count = u32::from_le_bytes(take(&mut rest)?);
    ensure("file", count <= MOST_FIELDS, || {
        format!("claims {count} fields, expected at most {MOST_FIELDS}")
    })?;
    (0..count).map(|_| decode_field(bytes, &mut rest)).collect()
}

fn decode_field(bytes: &[u8], rest: &mut &[u8]) -> Result<Field, FieldError> {
    let length = usize::from(u16::from_le_bytes(take(rest)?));
    let (name, after) = rest.split_at_checked(length).ok_or_else(cut_short)?;
    *rest = after;
    let name = std::str::from_utf8(name)
        .map_err(|_| FieldError::new("file", "has a field whose name is not UTF-8"))?
        .to_owned();
    let dimensions = u16::from_le_bytes(take(rest)?);
    ensure(&name, dimensions <= MOST_DIMENSIONS, || {
        format!("has {dimensions} dimensions, expected at most {MOST_DIMENSIONS}")
    })?;
    let [kind] = take(rest)?;
    let offset = u64::from_le_bytes(take(rest)?);
    let shape = (0..dimensions)
        .map(|_| Ok(u64::from_le_bytes(take(rest)?)))
        .collect::<Result<Vec<_>, FieldError>>()?;
    ensure(&name, [U8, F32].contains(&kind), || {
        format!("is of type {kind}, expected {U8} (u8) or {F32} (f32)")
    })?;
    let size = if kind == U8 { 1 } else { 4 };
    // What the header claims is checked against the bytes that are there before anything is reserved.
    let length = shape.iter().try_fold(size, |product: u64, extent| product.checked_mul(*extent));
    let array = length
        .and_then(|length| Some(offset as usize..usize::try_from(offset.checked_add(length)?).ok()?))
        .and_then(|range| bytes.get(range))
        .ok_or_else(|| FieldError::new(name.clone(), "reaches beyond the end of the file"))?;
    let values = if kind == U8 {
        Values::U8(array.to_vec())
    } else {
        Values::F32(array.as_chunks().0.iter().map(|chunk| f32::from_le_bytes(*chunk)).collect())
    };
    Ok(Field { name, shape: shape.into_iter().map(|extent| extent as usize).collect(), values })
}

fn take<const N: usize>(rest: &mut &[u8]) -> Result<[u8; N], FieldError> {
    let (chunk, after) = rest.split_first_chunk::<N>().ok_or_else(cut_short)?;
    *rest = after;
    Ok(*chunk)
}

fn cut_short() -> FieldError {
    FieldError::new("file", "is cut short")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fields() -> Vec<Field> {
        vec![
            Field::u8("description", b"a pearl"),
            Field::f32("theta_i", &[3], vec![0.0, 0.5, 1.0]),
            Field::f32("rgb", &[1, 2, 3], (0..6).map(|i| i as f32 * 0.25).collect()),
        ]
    }

    #[test]
    fn fields_come_back_as_they_were_written() {
        assert_eq!(decode(&encode(&fields()).unwrap()).unwrap(), fields());
    }

    #[test]
    fn every_cut_and_every_flipped_header_byte_is_an_error_or_other_values_but_no_panic() {
        let bytes = encode(&fields()).unwrap();
        for length in 0..bytes.len() {
            assert!(decode(&bytes[..length]).is_err(), "{length}");
        }
        for at in 0..bytes.len() {
            for bit in 0..8 {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << bit;
                let _ = decode(&damaged);
            }
        }
    }

    #[test]
    fn extents_that_do_not_fit_the_values_are_refused() {
        let wrong = [Field::f32("rgb", &[2, 2], vec![0.0; 3])];
        assert_eq!(encode(&wrong).unwrap_err().field, "rgb");
    }
}
