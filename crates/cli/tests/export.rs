//! `lut export` as its users meet it: every format, what it prints, and whether a reader that shares no code with it
//! finds the error that was printed.

use lut_io::exr_file;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fs;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

type Direction = [f64; 3];

/// A table in a folder of its own, with a grey body and no interference.
struct Specimen {
    folder: tempfile::TempDir,
    table: PathBuf,
}

impl Specimen {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let table = folder.path().join("table.exr");
        let incidences: Vec<f64> = (0..=45).map(|i| 2.0 * f64::from(i)).collect();
        let look = json!({ "depth": 0.0, "coherence": 0.0, "brightness": 1.0, "body_rgb": [0.5, 0.6, 0.7] });
        let grey = |parts: &mut lut_io::Parts| parts.meta.recipe["look"] = look;
        let specimen = specimen::changed(&specimen::plane(&incidences, 96), grey);
        exr_file::write(&specimen, &table).unwrap();
        Self { folder, table }
    }

    fn export(&self, format: &str, output: &Path) -> Output {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lut"));
        command.arg("export").arg(&self.table).args(["--json", "--to", format, "-o"]).arg(output);
        command.output().unwrap()
    }

    /// Exit directions that `pearl sample` draws at wi, with density and rgb: (wo, pdf, rgb).
    fn drawn(&self, wi: Direction) -> Vec<(Direction, f64, [f64; 3])> {
        let at = format!("--wi={},{},{}", wi[0], wi[1], wi[2]);
        let sampled = pearl(&["sample", self.table.to_str().unwrap(), &at, "-n", "1500", "--seed", "3"], "");
        let found: Vec<Value> = lines(&sampled).filter(|line| line["wo"].is_array()).collect();
        let asked: String =
            found.iter().map(|line| format!("{}\n", json!({ "wi": wi, "wo": line["wo"] }))).collect();
        let values = pearl(&["eval", self.table.to_str().unwrap(), "--input", "-"], &asked);
        let triple = |value: &Value| [0, 1, 2].map(|c| value[c].as_f64().unwrap());
        (found.iter().zip(lines(&values)))
            .map(|(line, value)| (triple(&line["wo"]), line["pdf"].as_f64().unwrap(), triple(&value["rgb"])))
            .collect()
    }
}

fn pearl(args: &[&str], input: &str) -> String {
    let mut command = Command::new(env!("CARGO_BIN_EXE_pearl"));
    let mut child = command.args(args).stdin(Stdio::piped()).stdout(Stdio::piped()).spawn().unwrap();
    // From a thread of its own: pipes are finite on both sides.
    let (mut stdin, input) = (child.stdin.take().unwrap(), input.to_owned());
    let writer = std::thread::spawn(move || stdin.write_all(input.as_bytes()));
    let output = child.wait_with_output().unwrap();
    writer.join().unwrap().unwrap();
    assert!(output.status.success());
    String::from_utf8(output.stdout).unwrap()
}

fn lines(text: &str) -> impl Iterator<Item = Value> {
    text.lines().map(|line| serde_json::from_str(line).unwrap())
}

fn report(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["schema"], "lut-export/1");
    report
}

/// The printed error at every incidence against that of `read` on other directions.
fn assert_printed_is_measured(
    specimen: &Specimen,
    report: &Value,
    read: impl Fn(Direction, Direction) -> [f64; 3],
) {
    let rows = report["round_trip"]["per_incidence"].as_array().unwrap();
    assert_eq!(rows.len(), 15);
    for row in rows.iter().step_by(3) {
        let theta = row["theta_i_deg"].as_f64().unwrap().to_radians();
        let wi = [-0.28 * theta.sin(), 0.96 * theta.sin(), theta.cos()];
        let (mut apart, mut light) = (0.0, 0.0);
        for (wo, pdf, truth) in specimen.drawn(wi) {
            for (found, truth) in read(wi, wo).into_iter().zip(truth) {
                apart += (found - truth).abs() / pdf;
                light += truth / pdf;
            }
        }
        let (measured, printed) = (100.0 * apart / light, row["error_percent"].as_f64().unwrap());
        // Both are sums over some thousand directions; a third is far outside what those leave open.
        assert!((measured - printed).abs() < 0.33 * printed + 0.02, "{row}: measured {measured} %");
        assert!(measured > 0.0);
    }
    let worst = rows.iter().map(|row| row["error_percent"].as_f64().unwrap()).fold(0.0, f64::max);
    assert_eq!(report["round_trip"]["worst_percent"].as_f64().unwrap(), worst);
}

/// A `.bsdf` file, from the description of the format alone.
struct TensorFile {
    fields: HashMap<String, (Vec<usize>, Vec<f64>)>,
}

impl TensorFile {
    fn read(path: &Path) -> Self {
        let bytes = fs::read(path).unwrap();
        assert_eq!(&bytes[..14], b"tensor_file\0\x01\0");
        let number = |at: usize, size: usize| {
            (0..size).rev().fold(0u64, |value, k| (value << 8) | u64::from(bytes[at + k])) as usize
        };
        let (count, mut at) = (number(14, 4), 18);
        let mut fields = HashMap::new();
        for _ in 0..count {
            let length = number(at, 2);
            let name = String::from_utf8(bytes[at + 2..at + 2 + length].to_vec()).unwrap();
            at += 2 + length;
            let (dimensions, kind, offset) = (number(at, 2), bytes[at + 2], number(at + 3, 8));
            let shape: Vec<usize> = (0..dimensions).map(|d| number(at + 11 + 8 * d, 8)).collect();
            at += 11 + 8 * dimensions;
            let size: usize = shape.iter().product();
            let value = |k: usize| match kind {
                1 => f64::from(bytes[offset + k]),
                10 => f64::from(f32::from_bits(number(offset + 4 * k, 4) as u32)),
                other => panic!("type {other}"),
            };
            fields.insert(name, (shape, (0..size).map(value).collect()));
        }
        Self { fields }
    }

    fn field(&self, name: &str) -> (&[usize], &[f64]) {
        let (shape, values) = &self.fields[name];
        (shape, values)
    }

    /// f·cos θo of the first three channels: Dupuy and Jakob (2018), the densities integrated by sums over their cells.
    fn eval(&self, wi: Direction, wo: Direction) -> [f64; 3] {
        let half: Direction = std::array::from_fn(|i| wi[i] + wo[i]);
        let length = half.iter().map(|x| x * x).sum::<f64>().sqrt();
        let theta_m = (half[2] / length).min(1.0).acos();
        let phi = half[1].atan2(half[0]) - wi[1].atan2(wi[0]);
        let (u, v) = ((theta_m / FRAC_PI_2).sqrt(), ((phi + PI) / TAU).rem_euclid(1.0));
        let (_, theta) = self.field("theta_i");
        let theta_i = wi[2].acos();
        let k = (1..theta.len() - 1).filter(|k| theta[*k] <= theta_i).count();
        let t = ((theta_i - theta[k]) / (theta[k + 1] - theta[k])).clamp(0.0, 1.0);
        let (shape, vndf) = self.field("vndf");
        let (rows, columns) = (shape[2], shape[3]);
        let slice = |k: usize| -> Vec<f64> {
            let slice = &vndf[k * rows * columns..(k + 1) * rows * columns];
            let total = integral(
                &(0..rows).map(|r| integral(&slice[r * columns..(r + 1) * columns], 1.0)).collect::<Vec<_>>(),
                1.0,
            );
            slice.iter().map(|x| x / total).collect()
        };
        let density: Vec<f64> =
            slice(k).iter().zip(slice(k + 1)).map(|(a, b)| (1.0 - t) * a + t * b).collect();
        let totals: Vec<f64> = density.chunks(columns).map(|row| integral(row, 1.0)).collect();
        let y = integral(&totals, v);
        let row: Vec<f64> = (0..columns)
            .map(|c| read(&(0..rows).map(|r| density[r * columns + c]).collect::<Vec<_>>(), v))
            .collect();
        let x = integral(&row, u) / integral(&row, 1.0);
        let (ndf_shape, ndf) = self.field("ndf");
        let factor = read(&ndf[..ndf_shape[1]], u) / (4.0 * self.field("sigma").1[0]);
        let (shape, values) = self.field(if self.fields.contains_key("rgb") { "rgb" } else { "spectra" });
        let (channels, n) = (shape[2], shape[3]);
        std::array::from_fn(|channel| {
            let at = |k: usize| {
                let start = (k * channels + channel.min(channels - 1)) * n * n;
                let rows: Vec<f64> =
                    (0..n).map(|r| read(&values[start + r * n..start + (r + 1) * n], x)).collect();
                read(&rows, y)
            };
            factor * ((1.0 - t) * at(k) + t * at(k + 1))
        })
    }
}

/// Equidistant nodes on [0, 1] read linearly.
fn read(nodes: &[f64], x: f64) -> f64 {
    let position = x.clamp(0.0, 1.0) * (nodes.len() - 1) as f64;
    let k = (position as usize).min(nodes.len() - 2);
    nodes[k] + (position - k as f64) * (nodes[k + 1] - nodes[k])
}

/// ∫ from 0 to x of what [`read`] reads.
fn integral(nodes: &[f64], x: f64) -> f64 {
    let step = 1.0 / (nodes.len() - 1) as f64;
    let whole = ((x / step) as usize).min(nodes.len() - 1);
    let cells: f64 = (0..whole).map(|k| 0.5 * step * (nodes[k] + nodes[k + 1])).sum();
    let rest = x - whole as f64 * step;
    cells + if rest > 0.0 { 0.5 * rest * (nodes[whole] + read(nodes, x)) } else { 0.0 }
}

#[test]
fn the_printed_error_of_an_rgb_file_is_what_another_reader_measures() {
    let specimen = Specimen::new();
    let output = specimen.folder.path().join("pearl.bsdf");
    let report = report(&specimen.export("bsdf-rgb", &output));
    assert_eq!(report["format"], "bsdf-rgb");
    assert_eq!(report["bytes"].as_u64().unwrap(), fs::metadata(&output).unwrap().len());
    let file = TensorFile::read(&output);
    assert!(file.fields.contains_key("rgb") && !file.fields.contains_key("wavelengths"));
    assert_eq!(file.field("jacobian").1, [1.0]);
    assert_printed_is_measured(&specimen, &report, |wi, wo| file.eval(wi, wo));
}

#[test]
fn the_same_table_gives_the_same_archive_of_arrays() {
    let specimen = Specimen::new();
    let [first, second] = ["a.npz", "b.npz"].map(|name| specimen.folder.path().join(name));
    let report = report(&specimen.export("arrays", &first));
    assert_eq!(report["arrays"]["cells"], json!([1, 46, 1, 96, 4]));
    assert!(report.get("round_trip").is_none(), "nothing is approximated");
    assert_eq!(specimen.export("arrays", &second).status.code(), Some(0));
    assert_eq!(fs::read(&first).unwrap(), fs::read(&second).unwrap());
}

#[test]
fn a_spectral_file_has_wavelengths_and_the_mean_of_a_colourless_table() {
    let specimen = Specimen::new();
    let output = specimen.folder.path().join("pearl.bsdf");
    let report = report(&specimen.export("bsdf-spectral", &output));
    let file = TensorFile::read(&output);
    assert!(!file.fields.contains_key("rgb"));
    let (_, nm) = file.field("wavelengths");
    assert!(nm.windows(2).all(|pair| pair[1] > pair[0]) && nm[0] >= 300.0, "{nm:?}");
    assert!(report["round_trip"]["worst_percent"].as_f64().unwrap() < 3.0);
    let wi = [0.6, 0.0, 0.8];
    let wo = [-0.5, 0.1, (1.0f64 - 0.26).sqrt()];
    let asked = format!("{}\n", json!({ "wi": wi, "wo": wo }));
    let line =
        pearl(&["eval", specimen.table.to_str().unwrap(), "--input", "-", "--wavelengths-nm", "500"], &asked);
    let truth = lines(&line).next().unwrap()["spectral"][0].as_f64().unwrap();
    let found = file.eval(wi, wo)[0];
    assert!((found / truth - 1.0).abs() < 0.02, "{found} {truth}");
}

/// What readers of the MERL database do: the bin that a pair of directions falls into.
fn merl_bin(wi: Direction, wo: Direction) -> usize {
    let sum: Direction = std::array::from_fn(|i| wi[i] + wo[i]);
    let length = sum.iter().map(|x| x * x).sum::<f64>().sqrt();
    let half = sum.map(|x| x / length);
    // The half vector turned to the pole, as the database's own code does.
    let (theta_h, phi_h) = (half[2].min(1.0).acos(), half[1].atan2(half[0]));
    let about_z =
        [wi[0] * phi_h.cos() + wi[1] * phi_h.sin(), -wi[0] * phi_h.sin() + wi[1] * phi_h.cos(), wi[2]];
    let diff = [
        about_z[0] * theta_h.cos() - about_z[2] * theta_h.sin(),
        about_z[1],
        about_z[0] * theta_h.sin() + about_z[2] * theta_h.cos(),
    ];
    let (theta_d, mut phi_d) = (diff[2].min(1.0).acos(), diff[1].atan2(diff[0]));
    if phi_d < 0.0 {
        phi_d += PI;
    }
    let bin = |x: f64, count: usize| ((x * count as f64) as usize).min(count - 1);
    let index_h = ((90.0 * (theta_h / FRAC_PI_2 * 90.0)).sqrt() as usize).min(89);
    (index_h * 90 + bin(theta_d / FRAC_PI_2, 90)) * 180 + bin(phi_d / PI, 180)
}

#[test]
fn the_printed_error_of_a_merl_file_is_what_another_reader_measures() {
    let specimen = Specimen::new();
    let output = specimen.folder.path().join("pearl.binary");
    let report = report(&specimen.export("merl", &output));
    // Reciprocal by weight of the light: the plain mean of both ways has 164 % too much of it at 88.5°.
    let surplus = report["round_trip"]["per_incidence"].as_array().unwrap().iter();
    assert!(surplus.map(|row| row["bias_percent"].as_f64().unwrap()).all(|bias| bias < 15.0), "{report}");
    let bytes = fs::read(&output).unwrap();
    let count = 90 * 90 * 180;
    assert_eq!(bytes.len(), 12 + 24 * count);
    let stored = |k: usize| f64::from_le_bytes(bytes[12 + 8 * k..20 + 8 * k].try_into().unwrap());
    assert_printed_is_measured(&specimen, &report, |wi, wo| {
        let bin = merl_bin(wi, wo);
        let scale = [1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0];
        std::array::from_fn(|c| (stored(c * count + bin) * scale[c]).max(0.0) * wo[2])
    });
}

#[test]
fn the_same_table_makes_the_same_bytes() {
    let specimen = Specimen::new();
    let paths = ["a", "b"].map(|name| specimen.folder.path().join(name));
    for (path, threads) in paths.iter().zip(["1", "2"]) {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lut"));
        command
            .arg("export")
            .arg(&specimen.table)
            .args(["--threads", threads, "--to", "bsdf-rgb", "-o"])
            .arg(path);
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        assert!(String::from_utf8(output.stdout).unwrap().contains("85.5°"));
    }
    assert!(fs::read(&paths[0]).unwrap() == fs::read(&paths[1]).unwrap());
}

#[test]
fn what_cannot_be_exported_is_refused_in_one_line_and_harms_nothing() {
    let specimen = Specimen::new();
    let folder = specimen.folder.path();
    let old = folder.join("old.bsdf");
    fs::write(&old, b"an older file").unwrap();
    let damaged = folder.join("damaged.exr");
    let bytes = fs::read(&specimen.table).unwrap();
    fs::write(&damaged, &bytes[..bytes.len() / 2]).unwrap();
    let (table, damaged) = (specimen.table.to_str().unwrap(), damaged.to_str().unwrap());
    let absent = folder.join("absent.exr");
    let nowhere = folder.join("no/such/folder.bsdf");
    let old_path = old.to_str().unwrap();
    let cases: [(&[&str], i32, &str); 8] = [
        (&[table, "--to", "bsdf-xyz", "-o", old_path], 2, "bsdf-xyz"),
        (&[table, "-o", old_path], 2, "--to"),
        (&[table, "--to", "merl"], 2, "--output"),
        (&[damaged, "--to", "merl", "-o", old_path], 2, "damaged.exr"),
        (&[absent.to_str().unwrap(), "--to", "merl", "-o", old_path], 2, "absent.exr"),
        (&[table, "--to", "merl", "-o", nowhere.to_str().unwrap()], 1, "no/such"),
        // A made-up table without interference colours.
        (
            &[table, "--to", "blender", "-o", old_path],
            2,
            "spectra: are missing, expected interference colours",
        ),
        // Its own table would be written over.
        (&[table, "--to", "merl", "-o", table], 2, "--output"),
    ];
    for (args, code, word) in cases {
        let output = Command::new(env!("CARGO_BIN_EXE_lut")).arg("export").args(args).output().unwrap();
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(code), "{args:?}: {stderr}");
        assert!(stderr.lines().count() == 1 && stderr.contains(word), "{args:?}: {stderr}");
        assert!(output.stdout.is_empty());
        assert_eq!(fs::read(&old).unwrap(), b"an older file");
        assert!(fs::read(table).unwrap() == bytes, "{args:?}");
    }
}
