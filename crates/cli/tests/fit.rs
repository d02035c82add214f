//! `lut fit` as its users meet it: small files that every command reads, and figures that can be checked.

use lut_io::compact::{Compact, Form};
use lut_io::fit;
use lut_io::lobe::Interpolant;
use lut_io::table::{Component, IncidenceSummary};
use lut_io::{Table, diff, exr_file};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

const EVERY_5_DEG: [f64; 19] =
    [0., 5., 10., 15., 20., 25., 30., 35., 40., 45., 50., 55., 60., 65., 70., 75., 80., 85., 90.];

fn tables() -> [(&'static str, Table); 2] {
    [("plane", specimen::plane(&EVERY_5_DEG, 64)), ("space", specimen::space(&EVERY_5_DEG, 32, 16))]
}

fn written(folder: &Path, name: &str, table: &Table) -> PathBuf {
    let path = folder.join(format!("{name}.exr"));
    exr_file::write(table, &path).unwrap();
    path
}

fn tool(binary: &str, args: &[&str]) -> Output {
    Command::new(binary).args(args).output().unwrap()
}

fn lut(args: &[&str]) -> Output {
    tool(env!("CARGO_BIN_EXE_lut"), args)
}

fn json(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn refused(output: &Output, words: &[&str]) {
    let stderr = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    for word in words {
        assert!(stderr.contains(word), "{word} is missing in: {stderr}");
    }
}

#[test]
fn both_forms_are_small_and_as_far_from_the_table_as_they_say() {
    let folder = tempfile::tempdir().unwrap();
    for (name, table) in tables() {
        let source = written(folder.path(), name, &table);
        let whole = Interpolant::new(table);
        for (form, worst_percent, least_ratio) in [("analytic", 3.0, 8.0), ("table", 0.31, 3.0)] {
            let small = folder.path().join("small.exr");
            let (from, to) = (source.to_str().unwrap(), small.to_str().unwrap());
            let said = json(&lut(&["fit", from, "--form", form, "-o", to, "--json"]));
            assert_eq!((&said["schema"], &said["form"]), (&"lut-fit/1".into(), &form.into()));
            let bytes = fs::metadata(&small).unwrap().len();
            assert_eq!(said["bytes"], bytes);
            assert_eq!(said["source_bytes"], fs::metadata(&source).unwrap().len());
            assert!(said["ratio"].as_f64().unwrap() > least_ratio, "{name} {form}: {said}");
            // The figure, measured again on what a reader sees.
            let read = exr_file::read(&small).unwrap();
            let section = read.meta().compact.as_ref().unwrap();
            assert_eq!(serde_json::to_value(section.error).unwrap(), said["error"]);
            let found = diff::diff(&whole, &Interpolant::new(read)).worst_total_variation_percent;
            let percent = said["error"]["total_variation_percent"].as_f64().unwrap();
            assert!(
                (found - percent).abs() < 1e-9 && percent <= worst_percent,
                "{name} {form}: {found} {percent}"
            );
            assert!(percent > 1e-4, "{name} {form}: a loss of nothing was not measured");
            let delta_e = &said["error"]["delta_e_2000"];
            let [mean, most] = ["mean", "largest"].map(|key| delta_e[key].as_f64().unwrap());
            assert!(mean > 0.0 && mean < 0.5 && most >= mean, "{name} {form}: {delta_e}");
            let check = lut(&["check", to]);
            assert_eq!(
                check.status.code(),
                Some(0),
                "{name} {form}: {}",
                String::from_utf8_lossy(&check.stdout)
            );
        }
    }
}

#[test]
fn half_precision_alone_keeps_every_cell_to_its_rounding() {
    let folder = tempfile::tempdir().unwrap();
    let small = folder.path().join("small.exr");
    for (name, table) in tables() {
        let source = written(folder.path(), name, &table);
        let (from, to) = (source.to_str().unwrap(), small.to_str().unwrap());
        json(&lut(&["fit", from, "--form", "table", "--total-variation", "0", "-o", to, "--json"]));
        let read = exr_file::read(&small).unwrap();
        assert_eq!(read.meta().exit_axis, table.meta().exit_axis);
        for component in Component::ALL {
            let peak = table.lobe(component).value.iter().copied().fold(0.0, f32::max);
            for (a, b) in table.lobe(component).value.iter().zip(&read.lobe(component).value) {
                // Half precision rounds to 2⁻¹¹; far from the peak it keeps 2⁻²⁴ of 2⁻¹⁵ of it.
                assert!((a - b).abs() <= a * 4.9e-4 + peak * 1e-9, "{a} {b}");
            }
        }
    }
}

#[test]
fn a_compact_file_is_read_by_the_tools_and_fitted_again() {
    let folder = tempfile::tempdir().unwrap();
    let (_, table) = &tables()[0];
    let source = written(folder.path(), "plane", table);
    let small = folder.path().join("small.exr");
    let again = folder.path().join("again.exr");
    let to = small.to_str().unwrap();
    json(&lut(&["fit", source.to_str().unwrap(), "-o", to, "--json"]));
    let info = json(&lut(&["info", to, "--json"]));
    assert_eq!(info["schema"], "pearl-lut/1");
    assert_eq!(info["per_incidence"].as_array().unwrap().len(), EVERY_5_DEG.len());
    let furnace = tool(env!("CARGO_BIN_EXE_pearl"), &["furnace", to, "--json"]);
    assert_eq!(furnace.status.code(), Some(0), "{}", String::from_utf8_lossy(&furnace.stderr));
    // What is fitted again is already of the form: nothing more is lost than where Newton's method stops.
    let said = json(&lut(&["fit", to, "-o", again.to_str().unwrap(), "--json"]));
    assert!(said["error"]["total_variation_percent"].as_f64().unwrap() < 0.02, "{said}");
    // The expanded table is an ordinary one.
    let expanded = folder.path().join("expanded.exr");
    exr_file::write(&exr_file::read(&small).unwrap(), &expanded).unwrap();
    assert_eq!(json(&lut(&["diff", to, expanded.to_str().unwrap(), "--json"]))["identical"], true);
}

#[test]
fn the_same_table_makes_the_same_bytes_on_any_number_of_threads() {
    let folder = tempfile::tempdir().unwrap();
    let (_, table) = &tables()[0];
    let source = written(folder.path(), "plane", table);
    let files = ["1", "3"].map(|threads| {
        let to = folder.path().join(format!("{threads}.exr"));
        json(&lut(&[
            "fit",
            source.to_str().unwrap(),
            "-o",
            to.to_str().unwrap(),
            "--json",
            "--threads",
            threads,
        ]));
        fs::read(to).unwrap()
    });
    assert_eq!(files[0], files[1]);
}

#[test]
fn wrong_requests_are_refused_in_one_line_and_leave_the_output_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (_, table) = &tables()[0];
    let source = written(folder.path(), "plane", table);
    let from = source.to_str().unwrap();
    let out = folder.path().join("out.exr");
    fs::write(&out, "precious").unwrap();
    let to = out.to_str().unwrap();
    let whole = fs::read(&source).unwrap();
    let cases: [(&[&str], &[&str]); 5] = [
        // Written over, the table would be lost.
        (&["fit", from, "-o", from], &["--output", "the table itself"]),
        (&["fit", from, "-o", to, "--form", "table", "--order", "3"], &["--order", "analytic"]),
        (&["fit", from, "-o", to, "--total-variation", "1"], &["--total-variation", "table"]),
        (&["fit", from, "-o", to, "--form", "table", "--total-variation", "-1"], &["-1", "0 to 100"]),
        (&["fit", "missing.exr", "-o", to], &["missing.exr"]),
    ];
    for (args, words) in cases {
        refused(&lut(args), words);
    }
    assert_eq!(fs::read_to_string(&out).unwrap(), "precious");
    assert!(fs::read(&source).unwrap() == whole);
}

#[test]
fn damaged_compact_files_are_refused_or_harmless() {
    for (_, table) in tables() {
        let terms = fit::terms(&table.meta().exit_axis, 5);
        for compact in [fit::fitted(&table, terms, 1).unwrap(), fit::halved(&table, 1).unwrap()] {
            let bytes = exr_file::encode_compact(&compact).unwrap();
            assert!(exr_file::decode(&bytes).is_ok());
            for cut in (0..bytes.len()).step_by(37) {
                assert!(exr_file::decode(&bytes[..cut]).is_err(), "cut at {cut}");
            }
            for at in 0..bytes.len().min(3000) {
                let mut damaged = bytes.clone();
                damaged[at] ^= 1 << (at % 8);
                // No panic; a table that comes out is whole.
                if let Ok(table) = exr_file::decode(&damaged) {
                    Table::new(table.into_parts()).unwrap();
                }
            }
        }
    }
}

#[test]
fn metadata_that_claim_too_much_or_do_not_fit_are_refused_with_their_field() {
    let (_, table) = &tables()[0];
    let good = fit::halved(table, 1).unwrap();
    let with_form = |form: Form| {
        let mut meta = good.meta().clone();
        meta.compact.as_mut().unwrap().form = form;
        Compact::new(meta, good.samples().clone()).unwrap_err()
    };
    assert_eq!(with_form(Form::Half { exponent: vec![[0; 3]; 2] }).field, "compact.form.exponent");
    assert_eq!(with_form(Form::Half { exponent: vec![[999; 3]; 19] }).field, "compact.form.exponent");
    assert_eq!(with_form(Form::Analytic { terms: Vec::new() }).field, "compact.form.terms");
    let mut meta = good.meta().clone();
    meta.compact = None;
    assert_eq!(Compact::new(meta, good.samples().clone()).unwrap_err().field, "compact");
    let mut many = good.meta().clone();
    if let lut_io::axis::ExitAxis::Plane { cells, .. } = &mut many.exit_axis {
        *cells = 1 << 16;
    }
    let at = |i| IncidenceSummary { theta_i_deg: 0.1 * f64::from(i), ..good.meta().per_incidence[0].clone() };
    many.per_incidence = (0..500).map(at).collect();
    // Over what its bytes could vouch for, under what a table may have.
    let error = Compact::new(many, good.samples().clone()).unwrap_err();
    assert!(error.field == "compact.form" && error.problem.contains("at most"), "{error}");
}
