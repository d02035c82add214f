//! The table as an OpenEXR file: one scan-line part, f32, ZIP, one text attribute `pearl`; and its compact forms, which are
//! expanded when they are read.
//!
//! Layout in `docs/LUT-FORMAT.md`. Writing is bit-reproducible: the bytes depend on the table alone. Reading
//! trusts nothing: the header is parsed here with bounds on everything before anything is allocated
//! on its word, and only the blocks are left to the `exr` crate.

mod header;

use super::compact::{self, COMPACT_SCHEMA, Compact, Form};
use super::packing::{self, Packed};
use super::{ATTRIBUTE, atomic, zip};
use crate::error::{FieldError, LutError, READING};
use crate::model::both_sides::Passage;
use crate::model::dispersion;
use crate::model::limits::MAX_META_BYTES;
use crate::model::measure;
use crate::model::meta::{Meta, check_schema};
use crate::model::table::{Component, Lobe, Parts, Table};
use exr::block::chunk::{Chunk, CompressedBlock, CompressedScanLineBlock};
use exr::block::writer::ChunksWriter as _;
use exr::block::{UncompressedBlock, enumerate_ordered_header_block_indices};
use exr::image::write::layers::{LayersWriter as _, WritableLayers as _};
use exr::meta::attribute::{AttributeValue, ChannelDescription, LineOrder, SampleType, Text};
use exr::meta::{BlockDescription, MetaData};
use exr::prelude::f16;
use exr::prelude::{
    AnyChannel, AnyChannels, Compression, Encoding, FlatSamples, Image, Layer, LayerAttributes,
};
use exr::prelude::{SmallVec, Vec2};
use header::Header;
use rayon::prelude::*;
use std::fs;
use std::io::{self, Read as _};
use std::path::Path;

/// Writes a table; the file appears whole or not at all.
///
/// # Errors
/// Metadata that are too long, or the operating system refuses.
pub fn write(table: &Table, path: &Path) -> Result<(), LutError> {
    let bytes = encode(table).map_err(|error| LutError::invalid(path, error))?;
    atomic::write(path, &bytes).map_err(|error| LutError::io(path, "write the file", error))
}

/// Reads a table and checks all of it.
///
/// # Errors
/// One line naming the file, the field, the value found and what would be right.
pub fn read(path: &Path) -> Result<Table, LutError> {
    let bytes = read_bounded(path)?;
    decode(&bytes).map_err(|error| LutError::invalid(path, error))
}

/// The bytes of the file of a table.
///
/// # Errors
/// As [`write()`], short of the operating system.
pub fn encode(table: &Table) -> Result<Vec<u8>, FieldError> {
    let text = meta_to_ascii(table.meta())?;
    let channels = channels(table)
        .into_iter()
        .map(|(name, samples)| AnyChannel::new(name.as_str(), FlatSamples::F32(samples)))
        .collect();
    image(&text, image_size(table.meta()), channels)
}

/// The bytes of the file of a compact form.
///
/// # Errors
/// It does not expand to a valid table.
pub fn encode_compact(compact: &Compact) -> Result<Vec<u8>, FieldError> {
    let half = matches!(compact.section().form, Form::Half { .. });
    compact.clone().expand()?;
    let text = packing::pack(COMPACT_SCHEMA, &meta_to_ascii(compact.meta())?)?;
    let channels = Component::ALL.iter().zip(compact.samples()).map(|(component, samples)| {
        let samples = if half {
            FlatSamples::F16(samples.iter().map(|sample| f16::from_f32(*sample)).collect())
        } else {
            FlatSamples::F32(samples.clone())
        };
        AnyChannel::new(component.name(), samples)
    });
    image(&text, compact::image_size(compact.meta())?, channels.collect())
}

/// The bytes of an OpenEXR file.
fn image(
    text: &str,
    size: (usize, usize),
    channels: SmallVec<[AnyChannel<FlatSamples>; 4]>,
) -> Result<Vec<u8>, FieldError> {
    let mut attributes = LayerAttributes::default();
    // One attribute only: the exr crate writes several in hash order, which is not reproducible.
    attributes.other.insert(Text::from(ATTRIBUTE), AttributeValue::Text(Text::from(text)));
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: exr::image::Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels));
    let image = Image::from_layer(layer);
    let headers = image.layer_data.infer_headers(&image.attributes);
    let pixels = image.layer_data.create_writer(&headers);
    let mut bytes = io::Cursor::new(Vec::new());
    // Blocks are compressed by the threads that called, not by a pool of the exr crate's own.
    let written = exr::block::write(&mut bytes, headers, true, |meta_data, writer| {
        let indices: Vec<_> = enumerate_ordered_header_block_indices(&meta_data.headers).collect();
        let compressed = indices.into_par_iter().map(|(at, index)| {
            let mut data = pixels.extract_uncompressed_block(&meta_data.headers, index);
            if cfg!(target_endian = "big") {
                let channels = &meta_data.headers[0].channels;
                let bytes = channels.bytes_per_pixel / channels.list.len();
                data.chunks_exact_mut(bytes).for_each(<[u8]>::reverse);
            }
            let y_coordinate = i32::try_from(index.pixel_position.y())?;
            let block = CompressedScanLineBlock { y_coordinate, compressed_pixels_le: zip::compressed(data) };
            let compressed_block = CompressedBlock::ScanLine(block);
            Ok((at, Chunk { layer_index: index.layer, compressed_block }))
        });
        let compressed: Vec<(usize, Chunk)> = compressed.collect::<Result<_, exr::error::Error>>()?;
        compressed.into_iter().try_for_each(|(at, chunk)| writer.write_chunk(at, chunk))
    });
    written.map_err(|error| FieldError::new("OpenEXR", error.to_string()))?;
    Ok(bytes.into_inner())
}

/// The table in the bytes of a file.
///
/// # Errors
/// The first error found; no input makes it panic or allocate more than the bytes can back.
pub fn decode(bytes: &[u8]) -> Result<Table, FieldError> {
    let header = header::parse(bytes)?;
    if schema_of(header.pearl)?.starts_with(COMPACT_SCHEMA) {
        return decode_compact(&header, bytes)?.expand();
    }
    let meta = meta_from_ascii(header.pearl)?;
    header.check_type(SampleType::F32)?;
    let mut names = channel_names(&meta);
    names.sort_unstable();
    header.check_channels(&names)?;
    header.check_size(image_size(&meta))?;
    let blocks = header.blocks(bytes)?;
    let samples = decompress(&header, &names, &blocks)?;
    assemble(meta, &names, samples)
}

fn decode_compact(header: &Header<'_>, bytes: &[u8]) -> Result<Compact, FieldError> {
    let packed: Packed = serde_json::from_slice(header.pearl).map_err(|error| {
        FieldError::new(format!("attribute {ATTRIBUTE}"), format!("is not its JSON: {error}"))
    })?;
    let meta = meta_from_ascii(&packing::unpack(&packed.packed)?)?;
    let size = compact::image_size(&meta)?;
    let half = matches!(compact::section_of(&meta)?.form, Form::Half { .. });
    header.check_type(if half { SampleType::F16 } else { SampleType::F32 })?;
    let mut names: Vec<String> = Component::ALL.iter().map(|component| component.name().to_owned()).collect();
    names.sort_unstable();
    header.check_channels(&names)?;
    header.check_size(size)?;
    let blocks = header.blocks(bytes)?;
    let mut samples = decompress(header, &names, &blocks)?;
    let samples = Component::ALL.map(|component| {
        let at = names.iter().position(|name| name == component.name());
        at.map(|at| std::mem::take(&mut samples[at])).unwrap_or_default()
    });
    Compact::of_checked_meta(meta, samples)
}

/// Width and height of the image of a table.
fn image_size(meta: &Meta) -> (usize, usize) {
    (meta.exit_axis.columns(), meta.per_incidence.len() * meta.exit_axis.rows_per_incidence())
}

fn read_bounded(path: &Path) -> Result<Vec<u8>, LutError> {
    let io_error = |error| LutError::io(path, READING, error);
    let mut file = fs::File::open(path).map_err(io_error)?;
    let mut bytes = Vec::new();
    let mut take = |bytes: &mut Vec<u8>, count: u64| io::Read::take(&mut file, count).read_to_end(bytes);
    // Look at the first bytes before believing that the rest is worth reading.
    take(&mut bytes, header::MAX_BYTES as u64).map_err(io_error)?;
    let header = header::parse(&bytes).map_err(|error| LutError::invalid(path, error))?;
    let largest = header.largest_file();
    if largest > bytes.len() as u64 {
        let missing = largest - bytes.len() as u64;
        take(&mut bytes, missing).map_err(io_error)?;
    }
    Ok(bytes)
}

/// The metadata as ASCII JSON, everything else escaped. They are valid: no number is a NaN or an infinity, which JSON cannot say.
fn meta_to_ascii(meta: &Meta) -> Result<String, FieldError> {
    let json = serde_json::to_string(meta).map_err(|error| FieldError::new("metadata", error.to_string()))?;
    let mut text = String::with_capacity(json.len());
    for character in json.chars() {
        // In JSON text a non-ASCII character can only stand inside a string, where \u is allowed.
        if character.is_ascii() && character != '\u{7f}' {
            text.push(character);
            continue;
        }
        for unit in character.encode_utf16(&mut [0; 2]) {
            text.push_str(&format!("\\u{unit:04x}"));
        }
    }
    if text.len() > MAX_META_BYTES {
        let problem = format!("is {} bytes of JSON, expected at most {MAX_META_BYTES}", text.len());
        return Err(FieldError::new(format!("attribute {ATTRIBUTE}"), problem));
    }
    Ok(text)
}

#[derive(serde::Deserialize)]
struct SchemaOnly {
    schema: String,
}

/// The schema first: a newer table is refused by its name, not by some field that changed since.
fn schema_of(text: &[u8]) -> Result<String, FieldError> {
    let SchemaOnly { schema } = serde_json::from_slice(text).map_err(|error| {
        FieldError::new(format!("attribute {ATTRIBUTE}"), format!("is not its JSON: {error}"))
    })?;
    check_schema(&schema)?;
    Ok(schema)
}

fn meta_from_ascii(text: &[u8]) -> Result<Meta, FieldError> {
    let attribute = || format!("attribute {ATTRIBUTE}");
    if let Some(at) = text.iter().position(|byte| !byte.is_ascii()) {
        let problem = format!("has byte 0x{:02x} at {at}, expected ASCII", text[at]);
        return Err(FieldError::new(attribute(), problem));
    }
    schema_of(text)?;
    let mut json = serde_json::Deserializer::from_slice(text);
    let meta: Meta = serde_path_to_error::deserialize(&mut json).map_err(|error| {
        FieldError::new(format!("{} field {}", attribute(), error.path()), error.inner().to_string())
    })?;
    meta.validate()?;
    Ok(meta)
}

/// The coordinate channels: redundant with the metadata, so that a stock reader needs no formula.
fn coordinates(meta: &Meta) -> Vec<(String, Vec<f32>)> {
    let axis = &meta.exit_axis;
    let cells = meta.per_incidence.len() * axis.cells();
    let new = || Vec::with_capacity(cells);
    let (mut theta_i, mut exit, mut theta_o, mut phi, mut weight) = (new(), new(), new(), new(), new());
    for summary in &meta.per_incidence {
        let incidence = summary.theta_i_deg.to_radians();
        let columns = axis.columns_at(incidence).centres();
        let rows = axis.phi_at(incidence).map(|phi| phi.centres());
        for row in 0..axis.rows_per_incidence() {
            for s in &columns {
                theta_i.push(summary.theta_i_deg as f32);
                exit.push(s.to_degrees() as f32);
                theta_o.push(s.abs().to_degrees() as f32);
                phi.push(match &rows {
                    Some(phi) => phi[row].to_degrees() as f32,
                    None if *s < 0.0 => 180.0,
                    None => 0.0,
                });
            }
        }
        let weights = measure::reading_weights(axis, incidence, summary.azimuth_width_deg.to_radians());
        weight.extend(weights.iter().map(|w| *w as f32));
    }
    let mut channels =
        vec![("theta_i_deg", theta_i), ("theta_o_deg", theta_o), ("phi_deg", phi), ("weight_sr", weight)];
    if axis.rows_per_incidence() == 1 {
        channels.push(("exit_deg", exit));
    }
    if let Some(section) = &meta.both_sides {
        channels.extend(Passage::ALL.map(|passage| (passage.weight_name(), section.weights(passage, axis))));
    }
    let mut channels: Vec<(String, Vec<f32>)> =
        channels.into_iter().map(|(name, samples)| (name.to_owned(), samples)).collect();
    for (index, band) in bands(meta).iter().enumerate() {
        channels.push((dispersion::channel_name("weight_sr", index), dispersion::weights(band, axis)));
    }
    channels
}

/// The further bands.
fn bands(meta: &Meta) -> &[dispersion::Band] {
    meta.dispersion.as_ref().map_or(&[], |section| &section.bands)
}

/// Names of the channels of a component, of a further band or the table's own.
fn lobe_names(component: Component, band: Option<usize>) -> [String; 3] {
    let name = component.name();
    let name = band.map_or_else(|| name.to_owned(), |band| dispersion::channel_name(name, band));
    let (error, count) = (format!("{name}_std_error"), format!("{name}_count"));
    [name, error, count]
}

/// Names of all channels of a table.
fn channel_names(meta: &Meta) -> Vec<String> {
    let mut names: Vec<String> =
        Component::ALL.into_iter().flat_map(|component| lobe_names(component, None)).collect();
    names.extend(["theta_i_deg", "theta_o_deg", "phi_deg", "weight_sr"].map(String::from));
    if meta.exit_axis.rows_per_incidence() == 1 {
        names.push("exit_deg".to_owned());
    }
    if meta.both_sides.is_some() {
        names.extend(Passage::ALL.iter().flat_map(|p| [p.name(), p.weight_name()]).map(String::from));
    }
    for band in 0..bands(meta).len() {
        names.extend(Component::ALL.into_iter().flat_map(|component| lobe_names(component, Some(band))));
        names.push(dispersion::channel_name("weight_sr", band));
    }
    names
}

fn channels(table: &Table) -> Vec<(String, Vec<f32>)> {
    let mut channels = coordinates(table.meta());
    let mut add = |names: [String; 3], lobe: &Lobe| {
        let samples = [&lobe.value, &lobe.std_error, &lobe.count];
        channels.extend(names.into_iter().zip(samples.map(Clone::clone)));
    };
    for component in Component::ALL {
        add(lobe_names(component, None), table.lobe(component));
    }
    for (band, lobes) in table.bands().iter().enumerate() {
        for (component, lobe) in Component::ALL.into_iter().zip(lobes) {
            add(lobe_names(component, Some(band)), lobe);
        }
    }
    for passage in Passage::ALL {
        channels.extend(table.passage(passage).map(|values| (passage.name().to_owned(), values.to_vec())));
    }
    channels
}

/// The samples of every channel, in the order of `names` (sorted, as OpenEXR stores channels).
fn decompress(header: &Header<'_>, names: &[String], blocks: &[&[u8]]) -> Result<Vec<Vec<f32>>, FieldError> {
    let (width, height) = (header.width, header.height);
    let description = |name: &String| ChannelDescription {
        name: Text::from(name.as_str()),
        sample_type: header.sample_type,
        quantize_linearly: false,
        sampling: Vec2(1, 1),
    };
    // A header of our own making: nothing of the file's reaches the exr crate but the compressed bytes.
    let exr_header = exr::meta::header::Header::new(
        Text::from("part0"),
        (width, height),
        names.iter().map(description).collect(),
    )
    .with_encoding(header.compression, BlockDescription::ScanLines, LineOrder::Increasing);
    let requirements = exr::meta::Requirements {
        file_format_version: 2,
        is_single_layer_and_tiled: false,
        has_long_names: false,
        has_deep_data: false,
        has_multiple_layers: false,
    };
    let meta_data = MetaData { requirements, headers: SmallVec::from_elem(exr_header, 1) };
    let mut samples = vec![vec![0f32; width * height]; names.len()];
    let lines = header.lines_per_block();
    let mut places: Vec<Vec<&mut [f32]>> = Vec::new();
    places.resize_with(blocks.len(), Vec::new);
    for channel in &mut samples {
        places.iter_mut().zip(channel.chunks_mut(lines * width)).for_each(|(place, part)| place.push(part));
    }
    let read = |(index, (compressed, place)): (usize, (&&[u8], &mut Vec<&mut [f32]>))| {
        let top = index * lines;
        let damaged = || {
            FieldError::new(format!("image rows from {top}"), "cannot be decompressed: the file is damaged")
        };
        let block = CompressedScanLineBlock {
            y_coordinate: i32::try_from(top).map_err(|_| damaged())?,
            compressed_pixels_le: compressed.to_vec(),
        };
        let chunk = Chunk { layer_index: 0, compressed_block: CompressedBlock::ScanLine(block) };
        let block = UncompressedBlock::decompress_chunk(chunk, &meta_data, true).map_err(|_| damaged())?;
        for line in block.lines(&meta_data.headers[0].channels) {
            let start = (line.location.position.y() - top) * width;
            let target = &mut place[line.location.channel][start..start + width];
            if header.sample_type == SampleType::F16 {
                let mut halves = vec![f16::ZERO; width];
                line.read_samples_into_slice(&mut halves).map_err(|_| damaged())?;
                target.iter_mut().zip(halves).for_each(|(sample, half)| *sample = half.to_f32());
            } else {
                line.read_samples_into_slice(target).map_err(|_| damaged())?;
            }
        }
        Ok(())
    };
    let results: Vec<Result<(), FieldError>> =
        blocks.par_iter().zip(&mut places).enumerate().map(read).collect();
    // The first damaged block is named, whichever was found first.
    results.into_iter().collect::<Result<(), FieldError>>()?;
    Ok(samples)
}

fn assemble(meta: Meta, names: &[String], mut samples: Vec<Vec<f32>>) -> Result<Table, FieldError> {
    let mut take = |name: &str| {
        let at = names.iter().position(|known| known == name);
        at.map(|at| std::mem::take(&mut samples[at])).unwrap_or_default()
    };
    for (name, expected) in coordinates(&meta) {
        check_coordinates(&name, &take(&name), &expected)?;
    }
    let passages = meta.both_sides.as_ref().map(|_| Passage::ALL.map(|passage| take(passage.name())));
    let mut lobe = |names: [String; 3]| {
        let [value, std_error, count] = names.map(|name| take(&name));
        Lobe { value, std_error, count }
    };
    let lobes = Component::ALL.map(|component| lobe(lobe_names(component, None)));
    let further = 0..bands(&meta).len();
    let bands =
        further.map(|band| Component::ALL.map(|component| lobe(lobe_names(component, Some(band))))).collect();
    Table::of_checked_meta(Parts { meta, lobes, passages, bands })
}

/// The coordinate channels must say what the axes of the metadata say.
fn check_coordinates(name: &str, found: &[f32], expected: &[f32]) -> Result<(), FieldError> {
    // Another libm moves a coordinate by an ulp or two of f32, a weight by its quadrature's rounding; 1e-4 of
    // the value is far below one cell and far above that. 1e-5 degrees absolute covers angles near 0.
    let differs = |(a, b): (&f32, &f32)| {
        let difference = f64::from(*a) - f64::from(*b);
        difference.is_nan() || difference.abs() > 1e-4 * f64::from(b.abs()) + 1e-5
    };
    match found.iter().zip(expected).position(differs) {
        None => Ok(()),
        Some(at) => {
            let problem = format!(
                "is {} at cell {at}, expected {} from the axes in attribute {ATTRIBUTE}",
                found[at], expected[at]
            );
            Err(FieldError::new(format!("channel {name}"), problem))
        }
    }
}
