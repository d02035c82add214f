//! The header of an OpenEXR file, read with suspicion: every length is checked against the bytes that are
//! there before it is used, and only what a pearl table may be is accepted (one scan-line part, channels of
//! one type, f32 or in compact files f16, no sub-sampling, ZIP or no compression). Layout: "OpenEXR File Layout", openexr.com.

use crate::error::{FieldError, ensure};
use crate::file::ATTRIBUTE;
use crate::model::dispersion::MOST_BANDS;
use crate::model::limits::{MAX_AXIS_CELLS, MAX_CELLS, MAX_META_BYTES};
use crate::model::meta::SCHEMA;
use exr::meta::attribute::SampleType;
use exr::prelude::Compression;

const MAGIC: [u8; 4] = [0x76, 0x2f, 0x31, 0x01];
const MAX_ATTRIBUTES: usize = 256;
const MAX_NAME: usize = 255;
/// Those of a table with both sides and the most bands of dispersion.
const MAX_CHANNELS: usize = 24 + 10 * MOST_BANDS;
/// Longest header that is looked at.
pub(super) const MAX_BYTES: usize = MAX_META_BYTES + (4 << 20);
/// Deflate cannot expand more than 1032 times (RFC 1951: 258 bytes from 2 bits); a claim beyond is false.
const MAX_EXPANSION: usize = 1040;

/// What the header of a table says.
#[derive(Debug)]
pub(super) struct Header<'a> {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) compression: Compression,
    pub(super) pearl: &'a [u8],
    /// Type of all channels.
    pub(super) sample_type: SampleType,
    channels: Vec<String>,
    /// Where the table of block offsets starts.
    end: usize,
}

/// Reads the header at the start of a file.
pub(super) fn parse(bytes: &[u8]) -> Result<Header<'_>, FieldError> {
    let mut cursor = Cursor { bytes, at: 0 };
    if cursor.bytes.len() < 8 || bytes[..4] != MAGIC {
        return Err(FieldError::new("file", format!("{}, expected an OpenEXR file", describe(bytes))));
    }
    cursor.at = 4;
    let version = cursor.u32("version")?;
    // Bit 10 (long names) is harmless; tiles, deep data and several parts are not a table.
    ensure("OpenEXR version", version & 0xff == 2 && version & !0x4ff == 0, || {
        format!("is 0x{version:x}, expected an OpenEXR 2 file with one scan-line part")
    })?;
    let mut found = Attributes::default();
    for _ in 0..MAX_ATTRIBUTES {
        let name = cursor.name()?;
        if name.is_empty() {
            return found.header(cursor.at);
        }
        let kind = cursor.name()?;
        let size = cursor.u32(name)? as usize;
        let limit = if name == ATTRIBUTE { MAX_META_BYTES } else { MAX_BYTES };
        ensure(&format!("attribute {name:?}"), size <= limit, || {
            format!("claims {size} bytes, expected at most {limit}")
        })?;
        let value = cursor.take(size, name)?;
        found.note(name, kind, value)?;
    }
    Err(FieldError::new("header", format!("has more than {MAX_ATTRIBUTES} attributes")))
}

fn describe(bytes: &[u8]) -> String {
    let known: [(&[u8], &str); 5] = [
        (b"\x89PNG", "is a PNG picture"),
        (b"\xff\xd8", "is a JPEG picture"),
        (b"tensor_file", "is an RGL tensor file"),
        (b"{", "is a text"),
        (b"", "is not OpenEXR"),
    ];
    if bytes.is_empty() {
        return "is empty".to_owned();
    }
    if MAGIC.starts_with(&bytes[..bytes.len().min(4)]) {
        return "is truncated".to_owned();
    }
    known.iter().find(|(magic, _)| bytes.starts_with(magic)).map_or("is not OpenEXR", |k| k.1).to_owned()
}

#[derive(Default)]
struct Attributes<'a> {
    channels: Option<(SampleType, Vec<String>)>,
    compression: Option<Compression>,
    window: Option<(usize, usize)>,
    pearl: Option<&'a [u8]>,
}

impl<'a> Attributes<'a> {
    fn note(&mut self, name: &str, kind: &str, value: &'a [u8]) -> Result<(), FieldError> {
        let expected_kind = match name {
            "channels" => "chlist",
            "compression" => "compression",
            "dataWindow" => "box2i",
            ATTRIBUTE => "string",
            _ => return Ok(()),
        };
        ensure(&format!("attribute {name}"), kind == expected_kind, || {
            format!("is of type {kind:?}, expected {expected_kind}")
        })?;
        match name {
            "channels" => self.channels = Some(channel_list(value)?),
            "compression" => self.compression = Some(compression(value)?),
            "dataWindow" => self.window = Some(data_window(value)?),
            _ => self.pearl = Some(value),
        }
        Ok(())
    }

    fn header(self, end: usize) -> Result<Header<'a>, FieldError> {
        let missing = |name: &str| {
            let problem = "is missing, expected a table written by `bake-brdf`";
            FieldError::new(format!("attribute {name}"), problem)
        };
        let pearl = self.pearl.ok_or_else(|| missing(ATTRIBUTE))?;
        let (sample_type, channels) = self.channels.ok_or_else(|| missing("channels"))?;
        let (width, height) = self.window.ok_or_else(|| missing("dataWindow"))?;
        Ok(Header {
            width,
            height,
            compression: self.compression.ok_or_else(|| missing("compression"))?,
            pearl,
            sample_type,
            channels,
            end,
        })
    }
}

/// Names of the channels, and the type that all of them have.
fn channel_list(value: &[u8]) -> Result<(SampleType, Vec<String>), FieldError> {
    let mut cursor = Cursor { bytes: value, at: 0 };
    let (mut kinds, mut names) = (None, Vec::new());
    loop {
        let name = cursor.name()?;
        if name.is_empty() {
            let kind = if kinds == Some(1) { SampleType::F16 } else { SampleType::F32 };
            return Ok((kind, names));
        }
        ensure("attribute channels", names.len() < MAX_CHANNELS, || {
            format!("lists more than {MAX_CHANNELS} channels")
        })?;
        let kind = cursor.u32("channels")?;
        cursor.take(4, "channels")?;
        let sampling = (cursor.u32("channels")?, cursor.u32("channels")?);
        let right = [1, 2].contains(&kind) && *kinds.get_or_insert(kind) == kind && sampling == (1, 1);
        ensure(&format!("channel {name}"), right, || {
            format!(
                "has type {kind} and sampling {sampling:?}, expected 2 (FLOAT; 1, HALF, in all channels of a compact file) and (1, 1)"
            )
        })?;
        names.push(name.to_owned());
    }
}

fn compression(value: &[u8]) -> Result<Compression, FieldError> {
    match value {
        [0] => Ok(Compression::Uncompressed),
        [2] => Ok(Compression::ZIP1),
        [3] => Ok(Compression::ZIP16),
        other => {
            let problem = format!("is {other:?}, expected 0 (none), 2 (ZIPS) or 3 (ZIP)");
            Err(FieldError::new("attribute compression", problem))
        }
    }
}

fn data_window(value: &[u8]) -> Result<(usize, usize), FieldError> {
    let corner: Vec<i64> =
        value.chunks_exact(4).map(|b| i64::from(i32::from_le_bytes([b[0], b[1], b[2], b[3]]))).collect();
    let field = "attribute dataWindow";
    let &[left, top, right, bottom] = corner.as_slice() else {
        return Err(FieldError::new(field, format!("has {} bytes, expected 16", value.len())));
    };
    let (width, height) = (right - left + 1, bottom - top + 1);
    let ok = (left, top) == (0, 0)
        && (1..=MAX_AXIS_CELLS as i64).contains(&width)
        && (1..=MAX_CELLS as i64).contains(&height)
        && width * height <= MAX_CELLS as i64;
    ensure(field, ok, || {
        format!(
            "is ({left}, {top})–({right}, {bottom}), expected it to start at (0, 0) and to hold at most {MAX_CELLS} cells"
        )
    })?;
    Ok((width as usize, height as usize))
}

impl Header<'_> {
    /// Rows of pixels in one compressed block.
    pub(super) const fn lines_per_block(&self) -> usize {
        self.compression.scan_lines_per_block()
    }

    const fn block_count(&self) -> usize {
        self.height.div_ceil(self.lines_per_block())
    }

    const fn raw_bytes(&self, rows: usize) -> usize {
        rows * self.width * self.channels.len() * self.sample_type.bytes_per_sample()
    }

    /// No file with this header is longer: what lies beyond need not be read.
    pub(super) const fn largest_file(&self) -> u64 {
        (self.end + self.raw_bytes(self.height) + 16 * self.block_count()) as u64
    }

    /// Checks that the channels hold samples of this type.
    pub(super) fn check_type(&self, expected: SampleType) -> Result<(), FieldError> {
        ensure("channels", self.sample_type == expected, || {
            format!("are of type {:?}, expected {expected:?}", self.sample_type)
        })
    }

    /// Checks that exactly these channels (sorted) are there.
    pub(super) fn check_channels(&self, expected: &[String]) -> Result<(), FieldError> {
        for name in expected {
            ensure(&format!("channel {name}"), self.channels.contains(name), || "is missing".to_owned())?;
        }
        for name in &self.channels {
            ensure(&format!("channel {name:?}"), expected.contains(name), || {
                format!("is not known in a {SCHEMA} table")
            })?;
        }
        ensure("attribute channels", self.channels == expected, || {
            "is not sorted by name without repeats".to_owned()
        })
    }

    /// Checks the image size against that of the metadata.
    pub(super) fn check_size(&self, (width, height): (usize, usize)) -> Result<(), FieldError> {
        ensure("attribute dataWindow", (self.width, self.height) == (width, height), || {
            format!(
                "makes {} × {} pixels, expected {width} × {height} (cells × rows of the metadata)",
                self.width, self.height
            )
        })
    }

    /// The compressed bytes of every block, top to bottom.
    pub(super) fn blocks<'b>(&self, bytes: &'b [u8]) -> Result<Vec<&'b [u8]>, FieldError> {
        let mut offsets = Cursor { bytes, at: self.end };
        let table = offsets.take(8 * self.block_count(), "block offsets")?;
        let mut blocks = Vec::with_capacity(self.block_count());
        for (index, offset) in table.as_chunks::<8>().0.iter().enumerate() {
            let top = index * self.lines_per_block();
            let rows = self.lines_per_block().min(self.height - top);
            blocks.push(self.block(bytes, u64::from_le_bytes(*offset), top, rows)?);
        }
        Ok(blocks)
    }

    fn block<'b>(
        &self,
        bytes: &'b [u8],
        offset: u64,
        top: usize,
        rows: usize,
    ) -> Result<&'b [u8], FieldError> {
        let field = || format!("image rows from {top}");
        let start = usize::try_from(offset).ok().filter(|start| (self.end..bytes.len()).contains(start));
        let Some(start) = start else {
            let problem =
                format!("lie at byte {offset} of {}: the file is truncated or damaged", bytes.len());
            return Err(FieldError::new(field(), problem));
        };
        let mut cursor = Cursor { bytes, at: start };
        let row = cursor.u32(&field())?;
        let size = cursor.u32(&field())? as usize;
        let raw = self.raw_bytes(rows);
        if row as usize != top || size > raw || size.saturating_mul(MAX_EXPANSION) < raw {
            let problem =
                format!("start with row {row} and {size} bytes for {raw} of pixels: the file is damaged");
            return Err(FieldError::new(field(), problem));
        }
        cursor.take(size, &field())
    }
}

struct Cursor<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Cursor<'a> {
    fn take(&mut self, count: usize, what: &str) -> Result<&'a [u8], FieldError> {
        let taken = self.at.checked_add(count).and_then(|end| self.bytes.get(self.at..end));
        let Some(taken) = taken else {
            let there = self.bytes.len() - self.at.min(self.bytes.len());
            let problem = format!("needs {count} bytes where {there} are left: the file is truncated");
            return Err(FieldError::new(what, problem));
        };
        self.at += count;
        Ok(taken)
    }

    fn u32(&mut self, what: &str) -> Result<u32, FieldError> {
        let bytes = self.take(4, what)?;
        Ok(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }

    /// A zero-terminated ASCII name.
    fn name(&mut self) -> Result<&'a str, FieldError> {
        let rest = &self.bytes[self.at.min(self.bytes.len())..];
        let head = &rest[..rest.len().min(MAX_NAME + 1)];
        let Some(length) = head.iter().position(|byte| *byte == 0) else {
            let problem = format!(
                "has a name without an end within {MAX_NAME} bytes: the file is truncated or damaged"
            );
            return Err(FieldError::new("header", problem));
        };
        self.at += length + 1;
        match std::str::from_utf8(&head[..length]) {
            Ok(name) if name.is_ascii() => Ok(name),
            _ => Err(FieldError::new("header", "has a name that is not ASCII")),
        }
    }
}
