//! The file: whole, reproducible, and refused in one line when anything about it is wrong.

#![allow(clippy::print_stderr)] // a skipped test says why

use lut_io::exr_file::{self, decode, encode};
use lut_io::limits::MAX_META_BYTES;
use lut_io::solver::{Solver, SolverSettings, Walk};
use lut_io::table::AzimuthMode;
use lut_io::{FieldError, LutError, Parts, Table};
use proptest::prelude::*;
use std::fs;
use std::path::Path;

fn plane() -> Table {
    specimen::plane(&[0.0, 10.0, 30.0, 60.0, 80.0, 89.0], 32)
}

fn space() -> Table {
    specimen::space(&[0.0, 45.0, 80.0], 16, 8)
}

fn walk(parts: &mut Parts) -> &mut Walk {
    match &mut parts.meta.solver_settings {
        SolverSettings::Walk(walk) => walk,
        other => panic!("{other:?}"),
    }
}

fn error(bytes: &[u8]) -> FieldError {
    decode(bytes).expect_err("a damaged file must be refused")
}

/// Where the bytes of a header attribute start.
fn find(bytes: &[u8], needle: &[u8]) -> usize {
    bytes.windows(needle.len()).position(|window| window == needle).expect("the file has this text")
}

fn replaced(bytes: &[u8], from: &str, to: &str) -> Vec<u8> {
    assert_eq!(from.len(), to.len(), "offsets in the file must not move");
    let at = find(bytes, from.as_bytes());
    let mut bytes = bytes.to_vec();
    bytes[at..at + to.len()].copy_from_slice(to.as_bytes());
    bytes
}

/// A copy of the file with another `dataWindow` (xMin, yMin, xMax, yMax).
fn with_window(bytes: &[u8], window: [i32; 4]) -> Vec<u8> {
    let start = find(bytes, b"dataWindow\0box2i\0") + 17 + 4;
    let mut bytes = bytes.to_vec();
    for (i, corner) in window.iter().enumerate() {
        bytes[start + 4 * i..start + 4 * i + 4].copy_from_slice(&corner.to_le_bytes());
    }
    bytes
}

/// A file of other channels and metadata, written by the `exr` crate itself.
fn by_exr(channels: &[(&str, Vec<f32>)], size: (usize, usize), pearl: &str) -> Vec<u8> {
    use exr::prelude::*;
    let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> =
        channels.iter().map(|(name, v)| AnyChannel::new(*name, FlatSamples::F32(v.clone()))).collect();
    let mut attributes = LayerAttributes::default();
    attributes.other.insert(Text::from("pearl"), AttributeValue::Text(Text::from(pearl)));
    let encoding = Encoding {
        compression: Compression::ZIP16,
        blocks: Blocks::ScanLines,
        line_order: LineOrder::Increasing,
    };
    let mut bytes = std::io::Cursor::new(Vec::new());
    let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(channels));
    Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
    bytes.into_inner()
}

/// Channels, image size and metadata text of a file.
type Content = (Vec<(String, Vec<f32>)>, (usize, usize), String);

/// A table as `by_exr` takes it.
fn content(table: &Table) -> Content {
    let bytes = encode(table).unwrap();
    let image = {
        use exr::prelude::*;
        read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .from_buffered(std::io::Cursor::new(&bytes))
            .unwrap()
    };
    let layer = &image.layer_data;
    let channels = layer.channel_data.list.iter().map(|channel| {
        let values = channel.sample_data.values_as_f32().collect();
        (channel.name.to_string(), values)
    });
    let pearl = match &layer.attributes.other[&exr::meta::attribute::Text::from("pearl")] {
        exr::meta::attribute::AttributeValue::Text(text) => text.to_string(),
        other => panic!("{other:?}"),
    };
    (channels.collect(), (layer.size.0, layer.size.1), pearl)
}

fn rebuilt(parts: &Content) -> Vec<u8> {
    let channels: Vec<(&str, Vec<f32>)> = parts.0.iter().map(|(n, v)| (n.as_str(), v.clone())).collect();
    by_exr(&channels, parts.1, &parts.2)
}

#[test]
fn a_table_comes_back_bit_by_bit() {
    for table in [plane(), space()] {
        let directory = tempfile::tempdir().unwrap();
        let path = directory.path().join("table.exr");
        exr_file::write(&table, &path).unwrap();
        assert_eq!(exr_file::read(&path).unwrap(), table);
    }
}

#[test]
fn the_same_table_makes_the_same_bytes() {
    assert_eq!(encode(&plane()).unwrap(), encode(&plane()).unwrap());
    assert_eq!(encode(&space()).unwrap(), encode(&space()).unwrap());
}

#[test]
fn every_character_of_a_recipe_survives_and_the_file_stays_ascii() {
    let recipe = serde_json::json!({"name": "真珠 \u{1F9AA} \u{7f} \"quoted\" \\ \n"});
    let table = specimen::changed(&plane(), |parts| parts.meta.recipe = recipe);
    let bytes = encode(&table).unwrap();
    assert_eq!(decode(&bytes).unwrap(), table);
    let start = find(&bytes, b"pearl\0string\0") + 17;
    let end = start + bytes[start..].iter().position(|b| *b == 0).unwrap();
    assert!(bytes[start..end].iter().all(|b| (b' '..=b'~').contains(b)));
}

#[test]
fn what_no_reader_would_take_is_not_a_table() {
    let refuse = |change: &dyn Fn(&mut Parts), field: &str| {
        let mut parts = plane().into_parts();
        change(&mut parts);
        let error = Table::new(parts).unwrap_err();
        assert_eq!(error.field, field, "{error}");
    };
    // What JSON cannot say.
    refuse(&|t| t.meta.per_incidence[2].skew_theta_o = f64::NAN, "per_incidence[2].skew_theta_o");
    refuse(&|t| t.meta.accuracy.asked_percent = Some(f64::INFINITY), "accuracy.asked_percent");
    refuse(&|t| t.lobes[0].value[3] = f32::NAN, "channel interior");
    refuse(&|t| t.lobes[1].value[3] = -1e-9, "channel surface");
    refuse(&|t| t.lobes[2].std_error[0] = f32::INFINITY, "channel rehit_std_error");
    refuse(&|t| t.lobes[0].count.truncate(5), "channel interior_count");
    refuse(&|t| t.bands.push(t.lobes.clone()), "dispersion");
    refuse(&|t| t.passages = Some(t.lobes.clone().map(|lobe| lobe.value)), "both_sides");
    refuse(&|t| t.meta.azimuth = AzimuthMode::Space, "exit_axis.kind");
    refuse(&|t| t.meta.per_incidence[1].theta_i_deg = 0.0, "per_incidence[1].theta_i_deg");
    refuse(&|t| t.meta.per_incidence[1].albedo = 1.5, "per_incidence[1].albedo");
    refuse(&|t| t.meta.per_incidence[1].surface = 0.999, "per_incidence[1].surface");
    refuse(&|t| t.meta.per_incidence[1].rehit = 0.9, "per_incidence[1].rehit");
    refuse(&|t| t.meta.per_incidence[1].azimuth_width_deg = 0.0, "per_incidence[1].azimuth_width_deg");
    refuse(&|t| t.meta.per_incidence.clear(), "per_incidence");
    refuse(&|t| t.meta.schema = "pearl-lut/2".to_owned(), "schema");
    refuse(&|t| t.meta.solver = Solver::Doubling, "solver_settings");
    refuse(&|t| walk(t).time_budget_seconds = Some(f64::NAN), "solver_settings.time_budget_seconds");
}

#[test]
fn a_refused_write_leaves_the_old_file_alone() {
    let directory = tempfile::tempdir().unwrap();
    let path = directory.path().join("table.exr");
    exr_file::write(&plane(), &path).unwrap();
    let before = fs::read(&path).unwrap();
    let endless = |parts: &mut Parts| parts.meta.writer = "x".repeat(MAX_META_BYTES);
    let bad = specimen::changed(&plane(), endless);
    assert!(exr_file::write(&bad, &path).unwrap_err().is_bad_input());
    assert_eq!(fs::read(&path).unwrap(), before);
    assert_eq!(fs::read_dir(directory.path()).unwrap().count(), 1);
}

#[test]
fn errors_name_the_file_and_stay_on_one_line() {
    let directory = tempfile::tempdir().unwrap();
    let absent = exr_file::read(&directory.path().join("absent.exr")).unwrap_err();
    assert!(absent.is_bad_input() && absent.to_string().contains("absent.exr"));
    assert!(exr_file::read(directory.path()).unwrap_err().is_bad_input());
    let path = directory.path().join("picture.exr");
    fs::write(&path, b"\x89PNG\r\n\x1a\n and so on").unwrap();
    let png = exr_file::read(&path).unwrap_err().to_string();
    assert!(png.contains("picture.exr") && png.contains("PNG") && png.lines().count() == 1, "{png}");
    let unwritable = exr_file::write(&plane(), &directory.path().join("absent/table.exr")).unwrap_err();
    assert!(!unwritable.is_bad_input() && matches!(unwritable, LutError::Io { .. }));
}

#[test]
fn a_full_disk_is_reported() {
    let full = Path::new("/dev/full");
    if !full.exists() {
        eprintln!("skipped: this system has no /dev/full");
        return;
    }
    let error = exr_file::write(&plane(), full).unwrap_err();
    assert!(!error.is_bad_input() && error.to_string().contains("/dev/full"), "{error}");
}

#[test]
fn a_file_cut_at_any_byte_is_refused() {
    let bytes = encode(&plane()).unwrap();
    for length in (0..bytes.len()).step_by(7).chain(bytes.len() - 40..bytes.len()) {
        let error = error(&bytes[..length]);
        assert!(!error.to_string().contains('\n'), "{error}");
    }
}

#[test]
fn a_cut_file_is_called_truncated() {
    let bytes = encode(&plane()).unwrap();
    for length in [2, 7, bytes.len() / 2, bytes.len() - 1] {
        assert!(error(&bytes[..length]).to_string().contains("truncated"), "{}", error(&bytes[..length]));
    }
    assert!(error(b"").to_string().contains("empty"));
}

#[test]
fn a_header_that_claims_too_much_is_refused_before_allocating() {
    let bytes = encode(&plane()).unwrap();
    let huge =
        [[0, 0, i32::MAX, i32::MAX], [0, 0, i32::MAX, 0], [0, 0, 0, i32::MAX], [i32::MIN, 0, i32::MAX, 1]];
    for window in huge {
        assert_eq!(error(&with_window(&bytes, window)).field, "attribute dataWindow");
    }
    // An attribute of 2 GB.
    let mut claim = bytes.clone();
    let at = find(&bytes, b"pearl\0string\0") + 13;
    claim[at..at + 4].copy_from_slice(&0x7fff_ffffu32.to_le_bytes());
    assert!(error(&claim).to_string().contains("claims"));
    // Axes of 2^60 cells.
    let text = content(&plane());
    let text = (text.0, text.1, text.2.replace("\"cells\":32", "\"cells\":1152921504606846976"));
    assert_eq!(error(&rebuilt(&text)).field, "exit_axis cells");
    // Large but legal axes that the file's few bytes cannot back.
    let cells = 1 << 16;
    let mut meta = plane().into_parts().meta;
    meta.exit_axis = lut_io::axis::ExitAxis::Plane { cells, width: 0.05 };
    let json = serde_json::to_string(&meta).unwrap();
    let text = (content(&plane()).0, (32, 6), json);
    let lying = with_window(&rebuilt(&text), [0, 0, cells as i32 - 1, 5]);
    // Refused by the size of the block, not after decompressing into reserved memory.
    assert!(error(&lying).problem.contains("of pixels"), "{}", error(&lying));
}

fn good_with_schema(schema: &str) -> Vec<u8> {
    let mut text = content(&plane());
    text.2 = text.2.replacen("pearl-lut/1", schema, 1);
    rebuilt(&text)
}

#[test]
fn a_newer_schema_is_refused_by_name_whatever_else_changed() {
    let bytes = encode(&plane()).unwrap();
    let newer = error(&replaced(&bytes, "pearl-lut/1", "pearl-lut/2"));
    assert_eq!(newer.field, "schema");
    assert!(newer.problem.contains("pearl-lut/2") && newer.problem.contains("newer"), "{newer}");
    let mut text = content(&plane());
    text.2 = r#"{"schema":"pearl-lut/7","something":"else"}"#.to_owned();
    assert!(error(&rebuilt(&text)).problem.contains("pearl-lut/7"));
    let minor = good_with_schema("pearl-lut/1.4");
    assert_eq!(decode(&minor).unwrap().meta().schema, "pearl-lut/1.4");
    assert!(error(&good_with_schema("pearl-lut/11")).problem.contains("newer"));
    text.2 = r#"{"schema":"other/1"}"#.to_owned();
    assert_eq!(error(&rebuilt(&text)).field, "schema");
}

#[test]
fn damaged_metadata_are_refused_with_the_field() {
    let good = content(&plane());
    let with = |pearl: String| error(&rebuilt(&(good.0.clone(), good.1, pearl))).to_string();
    assert!(with("not json".to_owned()).contains("attribute pearl"));
    assert!(with("[".repeat(100_000)).contains("attribute pearl"));
    let deep = format!("{{\"schema\":\"pearl-lut/1\",\"recipe\":{}", "[".repeat(100_000));
    assert!(with(deep).contains("attribute pearl"));
    let albedo = good.2.replacen("\"albedo\":", "\"albedo\":-", 1);
    assert!(with(albedo).contains("per_incidence[0].albedo"));
    let wrong_type = good.2.replacen("\"seed\":7", "\"seed\":\"seven\"", 1);
    assert!(with(wrong_type).contains("seed"));
    let huge = good.2.replacen("\"wavelength_nm\":550.0", "\"wavelength_nm\":1e999", 1);
    assert!(with(huge).contains("attribute pearl"));
    let odd = good.2.replacen("\"cells\":32", "\"cells\":33", 1);
    assert!(with(odd).contains("exit_axis cells"));
    let unknown = good.2.replacen("\"paths\":", "\"pathz\":", 1);
    assert!(with(unknown).contains("per_incidence[0]"));
    let section = good.2.replacen("\"seed\":", "\"provenance\":{},\"seed\":", 1);
    assert!(with(section).contains("provenance"));
    let normals = good.2.replacen("\"unweighted\"", "\"any\"", 1);
    assert!(with(normals).contains("surface_model.normals"));
    for (right, wrong) in [
        ("\"f32\"", "\"f16\""),
        ("\"event_cap\":", "\"event_cap\":1e40,\"cap\":"),
        ("\"crossings\":", "\"crossing\":"),
    ] {
        assert!(good.2.contains(right), "{right}");
        assert!(with(good.2.replacen(right, wrong, 1)).contains("solver_settings: are not those"), "{wrong}");
    }
}

#[test]
fn wrong_channels_are_refused_by_name() {
    let good = content(&plane());
    let mut missing = good.clone();
    missing.0.retain(|(name, _)| name != "rehit");
    assert_eq!(error(&rebuilt(&missing)).field, "channel rehit");
    let mut extra = good.clone();
    extra.0.push(("R".to_owned(), good.0[0].1.clone()));
    assert_eq!(error(&rebuilt(&extra)).field, "channel \"R\"");
}

#[test]
fn wrong_samples_are_refused_by_channel_and_cell() {
    let good = content(&plane());
    let with = |name: &str, at: usize, value: f32| {
        let mut bad = good.clone();
        bad.0.iter_mut().find(|(known, _)| known == name).unwrap().1[at] = value;
        error(&rebuilt(&bad))
    };
    assert_eq!(
        with("interior", 40, f32::NAN).to_string(),
        "channel interior: is NaN at cell 40, expected a finite number ≥ 0"
    );
    assert_eq!(with("surface", 0, f32::INFINITY).field, "channel surface");
    assert_eq!(with("rehit_count", 1, -1.0).field, "channel rehit_count");
    assert_eq!(with("theta_i_deg", 3, 17.0).field, "channel theta_i_deg");
    assert_eq!(with("weight_sr", 3, f32::NAN).field, "channel weight_sr");
}

#[test]
fn a_size_that_does_not_fit_the_metadata_is_refused() {
    let mut bad = content(&plane());
    bad.2 = bad.2.replacen("\"cells\":32", "\"cells\":34", 1);
    assert_eq!(error(&rebuilt(&bad)).field, "attribute dataWindow");
}

#[test]
fn widths_that_do_not_fit_the_coordinates_are_refused() {
    let good = content(&plane());
    let width = format!("\"width\":{}", 4f64.to_radians());
    assert!(good.2.contains(&width));
    let bad = (good.0.clone(), good.1, good.2.replacen(&width, "\"width\":0.1", 1));
    assert_eq!(error(&rebuilt(&bad)).field, "channel theta_o_deg");
}

#[test]
fn other_kinds_of_openexr_files_are_refused() {
    let bytes = encode(&plane()).unwrap();
    for (flag, name) in [(0x02, "tiled"), (0x08, "deep"), (0x10, "multi-part")] {
        let mut other = bytes.clone();
        other[5] |= flag;
        assert_eq!(error(&other).field, "OpenEXR version", "{name}");
    }
    let mut lossy = bytes.clone();
    let at = find(&bytes, b"compression\0compression\0") + 24 + 4;
    lossy[at] = 5;
    assert_eq!(error(&lossy).field, "attribute compression");
    assert_eq!(error(&replaced(&bytes, "pearl\0string\0", "pearx\0string\0")).field, "attribute pearl");
}

#[test]
fn a_file_saved_again_by_another_program_is_still_read() {
    // Other attributes, other order of attributes, other lossless compression, blocks elsewhere: all legal.
    let (channels, size, pearl) = content(&plane());
    use exr::prelude::*;
    let list: SmallVec<[AnyChannel<FlatSamples>; 4]> =
        channels.iter().map(|(n, v)| AnyChannel::new(n.as_str(), FlatSamples::F32(v.clone()))).collect();
    for compression in [Compression::ZIP1, Compression::Uncompressed] {
        let mut attributes = LayerAttributes::named("table");
        attributes.owner = Some(Text::from("someone"));
        attributes.other.insert(Text::from("pearl"), AttributeValue::Text(Text::from(pearl.as_str())));
        attributes.other.insert(Text::from("more"), AttributeValue::F32(1.0));
        let encoding = Encoding { compression, blocks: Blocks::ScanLines, line_order: LineOrder::Decreasing };
        let layer = Layer::new(size, attributes, encoding, AnyChannels::sort(list.clone()));
        let mut bytes = std::io::Cursor::new(Vec::new());
        Image::from_layer(layer).write().non_parallel().to_buffered(&mut bytes).unwrap();
        assert_eq!(decode(&bytes.into_inner()).unwrap(), plane());
    }
}

/// FNV-1a, enough to notice that a byte moved.
fn fingerprint(bytes: &[u8]) -> u64 {
    bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

#[test]
fn the_bytes_of_a_small_table_do_not_change_between_versions() {
    // Values that need no libm but the axis', so that the fingerprint is the layout's and the encoder's.
    let table = specimen::changed(&specimen::plane(&[0.0], 2), |parts| {
        parts.lobes = [(); 3].map(|()| lut_io::table::Lobe {
            value: vec![0.25, 0.5],
            std_error: vec![0.125, 0.0],
            count: vec![3.0, 4.0],
        });
        let meta = &mut parts.meta;
        meta.recipe["schema"] = "pearl-recipe/1".into();
        (meta.accuracy.reached_percent, meta.accuracy.solver_percent) = (0.9, 0.8);
        let summary = &mut meta.per_incidence[0];
        (summary.mean_theta_o_deg, summary.sd_theta_o_deg, summary.skew_theta_o) = (0.0, 8.5, 0.1);
        let error = &mut summary.std_error;
        error.surface = error.albedo;
        (error.mean_theta_o_deg, error.sd_theta_o_deg, error.skew_theta_o) = (0.01, 0.01, 0.004);
    });
    let bytes = encode(&table).unwrap();
    assert_eq!((bytes.len(), fingerprint(&bytes)), (1940, 8_826_537_761_634_338_426));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn damage_is_refused_or_harmless(
        space_table in any::<bool>(), hits in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6)
    ) {
        let mut bytes = encode(&if space_table { space() } else { plane() }).unwrap();
        for (at, value) in hits {
            let at = at.index(bytes.len());
            bytes[at] = value;
        }
        // Must not panic; what is accepted must be a table that could be written again.
        if let Ok(table) = decode(&bytes) {
            prop_assert!(encode(&table).is_ok() && Table::new(table.into_parts()).is_ok());
        }
    }

    #[test]
    fn damage_to_the_header_is_refused_or_harmless(at in 0usize..2000, value in any::<[u8; 4]>()) {
        let mut bytes = encode(&plane()).unwrap();
        let at = at.min(bytes.len() - 4);
        bytes[at..at + 4].copy_from_slice(&value);
        if let Ok(table) = decode(&bytes) {
            prop_assert!(Table::new(table.into_parts()).is_ok());
        }
    }

    #[test]
    fn noise_is_not_a_table(noise in prop::collection::vec(any::<u8>(), 0..400)) {
        let mut bytes = vec![0x76, 0x2f, 0x31, 0x01, 2, 0, 0, 0];
        bytes.extend(noise);
        prop_assert!(decode(&bytes).is_err());
    }

    #[test]
    fn any_values_come_back_bit_by_bit(values in prop::collection::vec(0.0f32..f32::MAX, 6 * 32)) {
        let table = specimen::changed(&plane(), |parts| {
            parts.lobes[0].value = values.clone();
            parts.lobes[1].std_error = values;
        });
        prop_assert_eq!(decode(&encode(&table).unwrap()).unwrap(), table);
    }
}

/// Ways in which a file is hurt beyond a changed byte.
#[derive(Clone, Debug)]
enum Hurt {
    Byte(u8),
    Word([u8; 4]),
    Offset([u8; 8]),
    Remove(usize),
    Repeat(usize),
    Zero(usize),
}

fn hurt() -> impl Strategy<Value = Hurt> {
    let near_limits =
        prop::sample::select(vec![0u32, 1, 0x7fff_ffff, 0x8000_0000, 0xffff_ffff, 0xffff, 0x0100_0000]);
    prop_oneof![
        any::<u8>().prop_map(Hurt::Byte),
        near_limits.prop_map(|word| Hurt::Word(word.to_le_bytes())),
        any::<u64>().prop_map(|offset| Hurt::Offset(offset.to_le_bytes())),
        (1usize..40).prop_map(Hurt::Remove),
        (1usize..40).prop_map(Hurt::Repeat),
        (1usize..40).prop_map(Hurt::Zero),
    ]
}

fn apply(bytes: &mut Vec<u8>, at: usize, hurt: &Hurt) {
    let end = |length: usize| (at + length).min(bytes.len());
    match hurt {
        Hurt::Byte(byte) => bytes[at] = *byte,
        Hurt::Word(word) => {
            let end = end(4);
            bytes[at..end].copy_from_slice(&word[..end - at]);
        }
        Hurt::Offset(offset) => {
            let end = end(8);
            bytes[at..end].copy_from_slice(&offset[..end - at]);
        }
        Hurt::Remove(length) => drop(bytes.drain(at..end(*length))),
        Hurt::Repeat(length) => {
            let copy = bytes[at..end(*length)].to_vec();
            bytes.splice(at..at, copy);
        }
        Hurt::Zero(length) => {
            let end = end(*length);
            bytes[at..end].fill(0);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(500_000))]

    #[test]
    #[ignore = "half a million damaged files, seconds in release mode: run by `cargo xtask rust`"]
    fn long_no_damage_makes_the_reader_panic(
        space_table in any::<bool>(),
        hurts in prop::collection::vec((any::<prop::sample::Index>(), any::<bool>(), hurt()), 1..5),
    ) {
        use std::sync::LazyLock;
        static FILES: LazyLock<[Vec<u8>; 2]> = LazyLock::new(|| [encode(&plane()).unwrap(), encode(&space()).unwrap()]);
        let mut bytes = FILES[usize::from(space_table)].clone();
        for (at, in_header, hurt) in &hurts {
            if bytes.is_empty() {
                break;
            }
            // The header is a small part of the file and the larger part of the danger.
            let room = if *in_header { bytes.len().min(2500) } else { bytes.len() };
            apply(&mut bytes, at.index(room), hurt);
        }
        if let Ok(table) = decode(&bytes) {
            prop_assert!(Table::new(table.into_parts()).is_ok());
        }
    }
}
