//! `lut` as its users meet it: what it prints, where, and how it exits.

use lut_io::table::Component;
use lut_io::{Parts, Table, exr_file};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn plane() -> Table {
    specimen::plane(&[0.0, 15.0, 30.0, 45.0, 60.0, 75.0, 90.0], 64)
}

fn space() -> Table {
    specimen::space(&[0.0, 30.0, 60.0, 85.0], 32, 16)
}

/// A table in a folder of its own.
struct File {
    folder: tempfile::TempDir,
    path: PathBuf,
}

fn file(table: &Table) -> File {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.exr");
    exr_file::write(table, &path).unwrap();
    File { folder, path }
}

fn lut(args: &[&str], path: &Path) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_lut"));
    command.arg(args[0]).arg(path).args(&args[1..]);
    command.output().unwrap()
}

fn stdout(output: &Output) -> String {
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn json(output: &Output) -> Value {
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn floats(array: &Value) -> Vec<f64> {
    array.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect()
}

/// Asserts the exit code, and one line on stderr that has all the words.
fn refused(output: &Output, code: i32, words: &[&str]) {
    let stderr = String::from_utf8(output.stderr.clone()).unwrap();
    assert_eq!(output.status.code(), Some(code), "{stderr}");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    for word in words {
        assert!(stderr.contains(word), "{word} is missing in: {stderr}");
    }
}

#[test]
fn info_gives_every_field_of_the_interface() {
    let table = plane();
    let info = json(&lut(&["info", "--json"], &file(&table).path));
    assert_eq!(info["schema"], "pearl-lut/1");
    assert_eq!(info["recipe"], table.meta().recipe);
    assert_eq!(info["seed"], 7);
    assert_eq!(info["solver"], "walk");
    assert_eq!(info["grids"]["theta_i_deg"][2], 30.0);
    let incidences = info["per_incidence"].as_array().unwrap();
    assert_eq!(incidences.len(), 7);
    let fields = [
        "albedo",
        "transmitted",
        "absorbed",
        "truncated",
        "surface",
        "mean_theta_o_deg",
        "sd_theta_o_deg",
        "skew_theta_o",
    ];
    for (incidence, summary) in incidences.iter().zip(&table.meta().per_incidence) {
        assert_eq!(incidence["theta_i_deg"], summary.theta_i_deg);
        assert_eq!(incidence["albedo"], summary.albedo);
        for field in fields {
            assert!(incidence[field].is_f64(), "{field}");
            assert!(incidence["std_error"][field].is_f64(), "std_error.{field}");
        }
    }
}

#[test]
fn info_for_people_is_a_line_an_incidence() {
    let output = lut(&["info"], &file(&plane()).path);
    assert_eq!(output.status.code(), Some(0));
    let text = stdout(&output);
    let rows = text.lines().skip_while(|line| !line.contains("theta_i")).skip(1);
    assert_eq!(rows.count(), 7, "{text}");
}

#[test]
fn a_slice_at_a_stored_incidence_is_the_stored_bits() {
    let table = plane();
    let slice = json(&lut(&["slice", "--theta-i", "30", "--phi", "0", "--json"], &file(&table).path));
    assert_eq!(slice["stored"], true);
    let axis = table.meta().exit_axis.columns_at(30f64.to_radians());
    let forward: Vec<usize> = (0..64).filter(|k| axis.at(*k as f64 + 0.5) >= 0.0).collect();
    let printed: Vec<f32> = floats(&slice["interior"]).iter().map(|v| *v as f32).collect();
    let stored: Vec<f32> =
        forward.iter().map(|k| table.lobe(Component::Interior).value[2 * 64 + k]).collect();
    assert_eq!(printed, stored);
    let back = json(&lut(&["slice", "--theta-i", "30", "--phi", "180", "--json"], &file(&table).path));
    let printed: Vec<f32> = floats(&back["surface"]).iter().map(|v| *v as f32).collect();
    let stored: Vec<f32> =
        (0..forward[0]).rev().map(|k| table.lobe(Component::Surface).value[2 * 64 + k]).collect();
    assert_eq!(printed, stored);
}

#[test]
fn a_slice_of_a_walk_table_at_the_azimuth_of_a_cell_is_the_stored_bits() {
    let table = space();
    let phi = table.meta().exit_axis.phi_at(60f64.to_radians()).unwrap().at(3.5).to_degrees();
    // As a reader of the file's f32 channel would type it.
    let typed = (phi as f32).to_string();
    let slice = json(&lut(&["slice", "--theta-i", "60", "--phi", &typed, "--json"], &file(&table).path));
    assert_eq!(slice["stored"], true);
    let start = (2 * 16 + 3) * 32;
    let printed: Vec<f32> = floats(&slice["interior"]).iter().map(|v| *v as f32).collect();
    assert_eq!(printed, table.lobe(Component::Interior).value[start..start + 32]);
}

#[test]
fn csv_and_json_slices_say_the_same() {
    let file = file(&space());
    let args = ["slice", "--theta-i", "44", "--phi", "20"];
    let slice = json(&lut(&[&args[..], &["--json"]].concat(), &file.path));
    assert_eq!(slice["stored"], false);
    let csv = stdout(&lut(&[&args[..], &["--csv"]].concat(), &file.path));
    let mut lines = csv.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    for (row, line) in lines.enumerate() {
        for (name, field) in names.iter().zip(line.split(',')) {
            assert_eq!(field.parse::<f64>().unwrap(), slice[name][row].as_f64().unwrap(), "{name} {row}");
        }
    }
}

#[test]
fn angles_outside_the_table_are_refused() {
    let file = file(&specimen::plane(&[30.0, 60.0], 16));
    refused(&lut(&["slice", "--theta-i", "20"], &file.path), 2, &["--theta-i", "20", "30 to 60"]);
    refused(&lut(&["slice", "--theta-i", "-5"], &file.path), 2, &["--theta-i", "-5"]);
    refused(&lut(&["slice", "--theta-i", "nan"], &file.path), 2, &["--theta-i", "NaN"]);
    refused(&lut(&["slice", "--theta-i", "40", "--phi", "181"], &file.path), 2, &["--phi", "181"]);
    refused(&lut(&["slice"], &file.path), 2, &["--theta-i"]);
}

#[test]
fn plots_are_four_figures_as_svg_and_png() {
    for table in [plane(), space(), specimen::plane(&[50.0], 16)] {
        let file = file(&table);
        let figures = file.folder.path().join("new/figures");
        let output = lut(&["plot", "-o", figures.to_str().unwrap()], &file.path);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let mut names: Vec<String> =
            fs::read_dir(&figures).unwrap().map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        assert_eq!(names.len(), 9, "{names:?}");
        for name in names {
            let bytes = fs::read(figures.join(&name)).unwrap();
            if name == "reciprocity.json" {
                let map: Value = serde_json::from_slice(&bytes).unwrap();
                let angles = floats(&map["theta_deg"]);
                assert_eq!(map["schema"], "lut-reciprocity/1");
                assert!(
                    map["defect"].as_array().unwrap().iter().all(|row| floats(row).len() == angles.len())
                );
            } else if name.ends_with(".png") {
                assert!(bytes.starts_with(b"\x89PNG"), "{name}");
            } else {
                let svg = String::from_utf8(bytes).unwrap();
                assert!(svg.contains("<svg") && svg.contains("exit angle") && !svg.contains("NaN"), "{name}");
            }
        }
    }
}

#[test]
fn a_plot_into_a_file_is_a_failure_of_the_system() {
    let file = file(&plane());
    refused(&lut(&["plot", "-o", file.path.to_str().unwrap()], &file.path), 1, &["table.exr"]);
}

#[test]
fn a_table_does_not_differ_from_itself() {
    let file = file(&plane());
    let output = lut(&["diff", file.path.to_str().unwrap()], &file.path);
    assert_eq!((output.status.code(), stdout(&output).as_str()), (Some(0), "identical\n"));
}

/// The table with every cell moved by its standard error times a made-up normal deviate.
fn noisy(table: &Table, shift: f64) -> Table {
    let mut noisy = table.clone().into_parts();
    let mut state = 0x9e37_79b9_7f4a_7c15_u64;
    let mut deviate = || {
        // Sum of twelve uniforms less six: normal enough for a chi² test (splitmix64, seed above).
        let sum: f64 = (0..12)
            .map(|_| {
                state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
                let mut z = (state ^ (state >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
                z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
                ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
            })
            .sum();
        sum - 6.0
    };
    for lobe in &mut noisy.lobes[..2] {
        for (value, error) in lobe.value.iter_mut().zip(&lobe.std_error) {
            // Two tables with the same error: the difference has √2 of it.
            let moved =
                f64::from(*value) + f64::from(*error) * (std::f64::consts::SQRT_2 * deviate() + shift);
            *value = moved.max(0.0) as f32;
        }
    }
    specimen::made(noisy)
}

#[test]
fn a_difference_within_the_errors_is_not_significant_and_one_beyond_is() {
    let table = specimen::plane(&[15.0, 30.0, 45.0, 60.0, 75.0], 64);
    let (a, other_seed) = (file(&table), file(&noisy(&table, 0.0)));
    let within = lut(&["diff", "--json", other_seed.path.to_str().unwrap()], &a.path);
    assert_eq!(json(&within)["significant"], false);
    let b = file(&noisy(&table, 3.0));
    let beyond = lut(&["diff", "--json", b.path.to_str().unwrap()], &a.path);
    assert_eq!(beyond.status.code(), Some(3));
    let report: Value = serde_json::from_slice(&beyond.stdout).unwrap();
    assert_eq!(report["schema"], "lut-diff/1");
    assert_eq!(report["significant"], true);
    assert!(report["smallest_p"].as_f64().unwrap() < 1e-6);
    let albedo = specimen::changed(&table, |parts| {
        let at = &mut parts.meta.per_incidence[1];
        // 10 standard errors of the difference.
        at.albedo += 10.0 * 2f64.sqrt() * at.std_error.albedo;
    });
    let c = file(&albedo);
    refused_with_output(&lut(&["diff", c.path.to_str().unwrap()], &a.path), &["differ significantly"]);
    let d = file(&specimen::changed(&table, |parts| parts.meta.surface_model.n_first *= 1.01));
    refused_with_output(&lut(&["diff", d.path.to_str().unwrap()], &a.path), &["; surface_model.n_first at "]);
}

/// Exit 3 with results on stdout and one line on stderr.
fn refused_with_output(output: &Output, words: &[&str]) {
    refused(output, 3, words);
    assert!(!output.stdout.is_empty());
}

#[test]
fn tables_with_other_incidences_or_cells_are_compared_by_reading_between() {
    let a = file(&specimen::plane(&[0.0, 10.0, 20.0, 30.0, 40.0], 64));
    let b = file(&specimen::plane(&[5.0, 15.0, 25.0, 35.0], 96));
    let report = json(&lut(&["diff", "--json", b.path.to_str().unwrap()], &a.path));
    let compared: Vec<f64> = report["per_incidence"]
        .as_array()
        .unwrap()
        .iter()
        .map(|at| at["theta_i_deg"].as_f64().unwrap())
        .collect();
    assert_eq!(compared, [10.0, 20.0, 30.0]);
    // Other cells and incidences 5° away: the same lobe up to the reading error.
    assert!(report["worst_total_variation_percent"].as_f64().unwrap() < 2.0, "{report}");
    let apart = file(&specimen::plane(&[80.0, 85.0], 64));
    refused(&lut(&["diff", apart.path.to_str().unwrap()], &a.path), 2, &["per_incidence"]);
}

#[test]
fn a_sound_table_passes_every_check() {
    for table in [plane(), space()] {
        let report = json(&lut(&["check", "--json"], &file(&table).path));
        assert_eq!(report["schema"], "lut-check/1");
        assert_eq!(report["pass"], true, "{report:#}");
        let names: Vec<&str> = report["checks"]
            .as_array()
            .unwrap()
            .iter()
            .map(|check| check["check"].as_str().unwrap())
            .collect();
        assert!(
            ["energy", "positivity", "integral", "azimuth", "reciprocity"]
                .iter()
                .all(|name| names.contains(name))
        );
    }
}

#[test]
fn each_check_finds_the_fault_it_is_for() {
    let broken = |change: &dyn Fn(&mut Parts), check: &str| {
        let table = specimen::changed(&plane(), change);
        refused_with_output(&lut(&["check"], &file(&table).path), &[check]);
    };
    broken(&|t| t.meta.per_incidence[3].transmitted += 1e-11, "energy");
    // More is refused by every reader.
    broken(&|t| t.meta.per_incidence[3].surface = t.meta.per_incidence[3].albedo + 1e-8, "ledger");
    broken(&|t| t.lobes[0].value.iter_mut().for_each(|v| *v *= 1.002), "integral");
    broken(&|t| t.lobes[0].value[20] *= 1.01, "azimuth");
    broken(&|t| t.lobes[1].count[100] = 2e6, "counts");
    broken(&|t| t.lobes[0].std_error.iter_mut().for_each(|e| *e *= 0.9), "error_bars");
    // One cell of the lobe's flank, 60 % too high.
    broken(&|t| t.lobes[0].value[3 * 64 + 40] *= 1.6, "smoothness");
}

#[test]
fn honest_errors_pass_against_another_seed_and_dishonest_ones_do_not() {
    let table = specimen::plane(&[15.0, 30.0, 45.0, 60.0, 75.0], 64);
    let other = specimen::changed(&noisy(&table, 0.0), |parts| {
        parts.meta.seed += 1;
        for summary in &mut parts.meta.per_incidence {
            // One standard error of the difference.
            summary.albedo += 2f64.sqrt() * summary.std_error.albedo;
            summary.mean_theta_o_deg -= 2f64.sqrt() * summary.std_error.mean_theta_o_deg;
        }
    });
    let against = |a: &Table, b: &Table| {
        lut(&["check", "--json", "--against", file(b).path.to_str().unwrap()], &file(a).path)
    };
    let report = |output: &Output| -> Value { serde_json::from_slice(&output.stdout).unwrap() };
    let honest = report(&against(&table, &other));
    let interior = &honest["honesty"][0];
    assert_eq!(interior["of"], "interior");
    assert!(
        interior["count"].as_u64().unwrap() > 100 && interior["p"].as_f64().unwrap() > 1e-3,
        "{honest:#}"
    );
    // Errors a quarter too small, or too large.
    for factor in [0.75, 1.25] {
        let scaled =
            |parts: &mut Parts| parts.lobes[0].std_error.iter_mut().for_each(|error| *error *= factor);
        let [ours, boastful] = [&table, &other].map(|table| specimen::changed(table, scaled));
        let output = against(&ours, &boastful);
        assert_eq!(output.status.code(), Some(3));
        assert!(String::from_utf8_lossy(&output.stderr).contains("honesty"), "{:#}", report(&output));
    }
    let seed = &table.clone();
    refused(&against(&table, seed), 2, &["seed", "is the same"]);
    let recipe = specimen::changed(&other, |parts| parts.meta.recipe["name"] = "another".into());
    refused(&against(&table, &recipe), 2, &["recipe", "differs"]);
}

#[test]
fn a_check_says_where_a_table_comes_from() {
    let file = file(&plane());
    let report = json(&lut(&["check", "--json"], &file.path));
    let command = format!("bake-brdf --reproduce {}", file.path.display());
    assert_eq!(report["provenance"]["reproduce"], command);
    assert_eq!(report["provenance"]["seed"], 7);
    assert!(stdout(&lut(&["check"], &file.path)).contains(&command));
}

#[test]
fn bad_files_are_refused_by_every_command() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("bad.exr");
    let good = fs::read(file(&plane()).path).unwrap();
    let mut newer = good.clone();
    let at = good.windows(11).position(|w| w == b"pearl-lut/1").unwrap();
    newer[at + 10] = b'2';
    let cases: [(Vec<u8>, &str); 4] = [
        (b"\x89PNG\r\n\x1a\n0000000000".to_vec(), "PNG"),
        (good[..good.len() / 2].to_vec(), "truncated"),
        (newer, "pearl-lut/2"),
        (Vec::new(), "empty"),
    ];
    for (bytes, word) in cases {
        fs::write(&path, bytes).unwrap();
        let out = folder.path().join("figures");
        let commands: [&[&str]; 5] = [
            &["info", "--json"],
            &["slice", "--theta-i", "30"],
            &["plot", "-o", out.to_str().unwrap()],
            &["check"],
            &["diff", path.to_str().unwrap()],
        ];
        for command in commands {
            refused(&lut(command, &path), 2, &["bad.exr", word]);
        }
        assert!(!out.exists());
    }
    refused(&lut(&["info"], &folder.path().join("absent.exr")), 2, &["absent.exr"]);
    refused(&lut(&["info"], folder.path()), 2, &[folder.path().to_str().unwrap()]);
}

#[test]
fn a_reader_that_stops_early_ends_the_tool_quietly() {
    let file = file(&specimen::plane(&(0..=90).map(f64::from).collect::<Vec<_>>(), 16));
    for args in [&["info", "--json"][..], &["slice", "--theta-i", "30", "--csv"]] {
        let mut command = Command::new(env!("CARGO_BIN_EXE_lut"));
        command.arg(args[0]).arg(&file.path).args(&args[1..]);
        let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let output = child.wait_with_output().unwrap();
        assert_eq!((output.status.code(), output.stderr.len()), (Some(0), 0));
    }
}

#[test]
fn help_version_completions_and_manual_are_there() {
    let run = |args: &[&str]| Command::new(env!("CARGO_BIN_EXE_lut")).args(args).output().unwrap();
    for (args, word) in [
        (&["--help"][..], "Examples"),
        (&["slice", "--help"], "Examples"),
        (&["--version"], "lut "),
        (&["completions", "bash"], "_lut"),
        (&["man"], ".TH lut"),
    ] {
        let output = run(args);
        assert_eq!(output.status.code(), Some(0));
        assert!(stdout(&output).contains(word), "{args:?}");
    }
    for wrong in [&["nonsense"][..], &[], &["info"], &["info", "a", "--threads", "0"]] {
        assert_eq!(run(wrong).status.code(), Some(2), "{wrong:?}");
    }
}
