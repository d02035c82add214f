//! The built `bake-brdf`, end to end.

mod built;

use built::tool;
use lut_io::exr_file;
use lut_io::lobe::Interpolant;
use lut_io::solver::SolverSettings;
use lut_io::table::{Component, Table};
use std::f64::consts::{FRAC_PI_2, PI};
use std::path::Path;
use std::process::Command;

/// Without colours, which have tests of their own.
const LOBE_ALONE: [&str; 2] = ["--effects", "surface,blur,azimuth,absorption"];

fn bake(folder: &Path, args: &[&str]) -> Table {
    let output = tool(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    exr_file::read(&folder.join("pearl.exr")).expect("the table reads")
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

fn write_recipe(folder: &Path, text: &str) {
    std::fs::write(folder.join("recipe.json"), text).expect("the recipe is written");
}

/// Bakes a recipe text with further arguments.
fn bake_recipe(text: &str, args: &[&str]) -> Table {
    let folder = folder();
    write_recipe(folder.path(), text);
    bake(folder.path(), &[&["recipe.json"], args].concat())
}

#[test]
fn the_ledger_closes_for_every_kind_of_stack() {
    for text in [
        "{}",
        r#"{"stack":{"layers":1}}"#,
        r#"{"stack":{"layers":2}}"#,
        r#"{"stack":{"layers":37,"aragonite":{"n":1.9},"conchiolin":{"n":1.2}}}"#,
        r#"{"stack":{"layers":10,"substrate":{"n":1.0}}}"#,
        r#"{"stack":{"layers":10,"aragonite":{"k":0.01},"conchiolin":{"k":0.2}}}"#,
        r#"{"stack":{"layers":20},"facets":{"slope_sd_deg":0.01}}"#,
        r#"{"stack":{"layers":20},"facets":{"slope_sd_deg":25}}"#,
        r#"{"stack":{"layers":20},"facets":{"slope_sd_deg":0}}"#,
    ] {
        for (mode, cells) in [("decay", "64x1"), ("space", "32x8")] {
            let args =
                ["--paths", "2000", "--incident-deg", "0,30,89.9,90", "--azimuth", mode, "--cells", cells];
            let args = [&args[..], &LOBE_ALONE].concat();
            for row in &bake_recipe(text, &args).meta().per_incidence {
                let sum = row.albedo + row.transmitted + row.absorbed + row.truncated;
                assert!((sum - 1.0).abs() < 1e-12, "{text} {mode} {row:?}");
                assert_eq!(row.truncated, 0.0, "{text} {mode}");
            }
        }
    }
}

#[test]
fn pairs_are_twice_as_many_layers() {
    let args = ["--paths", "3000", "--incident-deg", "20"];
    let pairs = bake_recipe(r#"{"stack":{"layers":9,"count":"pairs"}}"#, &args);
    let layers = bake_recipe(r#"{"stack":{"layers":18}}"#, &args);
    assert_eq!(pairs.lobe(Component::Interior), layers.lobe(Component::Interior));
}

/// One weakly absorbing layer between media of its own index: nothing is reflected (k²/4n² is 1e-11), facets bend nothing, and what passes is
/// exp(−4πk·d/(λ cos θ)) exactly, for every path.
#[test]
fn a_layer_without_interfaces_obeys_beers_law() {
    let text = r#"{"stack":{"layers":1,"ambient":{"n":1.5},"aragonite":{"n":1.5,"k":1e-5,"thickness_nm":1600000},
        "substrate":{"n":1.5}}}"#;
    let table = bake_recipe(text, &["--paths", "500", "--incident-deg", "0,40,70"]);
    for row in &table.meta().per_incidence {
        let depth = 4.0 * PI * 1e-5 * 1.6e6 / 550.0 / row.theta_i_deg.to_radians().cos();
        // Weights and directions are f32 in the walk: 1e-7 each, and the exponent magnifies by the depth.
        assert!((row.transmitted - (-depth).exp()).abs() < 5e-7, "{row:?} {depth}");
        assert!((row.absorbed - 1.0 + (-depth).exp()).abs() < 5e-7);
    }
}

#[test]
fn threads_cannot_be_seen_in_the_file() {
    let folder = folder();
    let args = ["--paths", "70000", "--incident-deg", "0,30,85", "--seed", "5"];
    let bytes = |threads: &str| {
        bake(folder.path(), &[&args[..], &["--threads", threads]].concat());
        std::fs::read(folder.path().join("pearl.exr")).unwrap()
    };
    assert!(bytes("1") == bytes("3"));
}

#[test]
fn an_incidence_does_not_know_its_neighbours() {
    let alone = bake_recipe("{}", &["--paths", "3000", "--incident-deg", "30"]);
    let among = bake_recipe("{}", &["--paths", "3000", "--incident-deg", "0,30,60"]);
    let cells = alone.meta().exit_axis.cells();
    assert_eq!(
        alone.lobe(Component::Interior).value,
        among.lobe(Component::Interior).value[cells..2 * cells]
    );
}

#[test]
fn the_reader_returns_the_walks_albedo_and_normal_incidence_has_no_azimuth() {
    for mode in ["decay", "space"] {
        let table =
            bake_recipe("{}", &["--paths", "20000", "--incident-deg", "0,30,60,85", "--azimuth", mode]);
        let reader = Interpolant::new(table.clone());
        for summary in &table.meta().per_incidence {
            let row = reader.row(summary.theta_i_deg.to_radians());
            let (n, m) = (800, 600);
            let mut integral = 0.0;
            for i in 0..n {
                let theta_o = FRAC_PI_2 * (f64::from(i) + 0.5) / f64::from(n);
                for j in 0..m {
                    // Graded towards φ = 0, where cells are narrow: φ = π t².
                    let t = (f64::from(j) + 0.5) / f64::from(m);
                    let phi = PI * t * t;
                    let value = row.eval(Component::Interior, theta_o, phi)
                        + row.eval(Component::Surface, theta_o, phi);
                    integral += value * theta_o.sin() * 2.0 * t;
                }
            }
            integral *= PI * PI / f64::from(n * m);
            // The midpoint rule itself errs by about 1e-4 on a lobe with kinks at its cells.
            let albedo = summary.albedo;
            assert!(
                (integral / albedo - 1.0).abs() < 1e-3,
                "{mode} {}: {integral} {albedo}",
                summary.theta_i_deg
            );
        }
        for theta_o in [0.01_f64, 0.1, 0.3, 1.0] {
            let at = |phi: f64| reader.eval(Component::Interior, 0.0, theta_o, phi);
            for phi in [0.4, 1.6, 3.0, PI] {
                assert!(
                    (at(phi) - at(0.0)).abs() <= 1e-6 * at(0.0),
                    "{mode}: f depends on azimuth at normal incidence"
                );
            }
        }
    }
}

/// Largest total variation (per cent) between a table and bakes with incidences half-way between its own.
fn error_half_way(table: &Table, args: &[&str]) -> f64 {
    let nodes = table.theta_i();
    let middles: Vec<String> =
        nodes.windows(2).map(|two| (0.5 * (two[0] + two[1])).to_degrees().to_string()).collect();
    let list = middles.join(",");
    let truth = bake_recipe("{}", &[args, &["--incident-deg", &list]].concat());
    let (truth, reader) = (Interpolant::new(truth), Interpolant::new(table.clone()));
    let rows = truth.table().meta().per_incidence.iter().map(|row| {
        let theta_i = row.theta_i_deg.to_radians();
        let (exact, read) = (truth.row(theta_i), reader.row(theta_i));
        // Columns of the table's own axis, each in thirds; the plane lobe leaves forwards and backwards.
        let columns = table.meta().exit_axis.columns_at(theta_i);
        let azimuths = 24;
        let mut missed = 0.0;
        for k in 0..3 * columns.cells {
            let position = (k as f64 + 0.5) / 3.0;
            let (theta_o, step) = (columns.at(position), columns.slope(position) / 3.0);
            for p in 0..azimuths {
                let u = (f64::from(p) + 0.5) / f64::from(azimuths);
                // Dense around the plane of incidence.
                let (phi, around) = (PI * u * u, 2.0 * PI * u / f64::from(azimuths));
                if theta_o > 0.0 {
                    let apart = [Component::Interior, Component::Rehit].map(|component| {
                        read.eval(component, theta_o, phi) - exact.eval(component, theta_o, phi)
                    });
                    missed += 2.0 * around * theta_o.sin() * step * (apart[0] + apart[1]).abs();
                }
            }
        }
        100.0 * 0.5 * missed / row.albedo
    });
    rows.fold(0.0, f64::max)
}

#[test]
fn the_stored_interpolation_error_is_what_reading_half_way_misses() {
    for (mode, incidences) in
        [("decay", "0:80:20"), ("decay", "0:90:5"), ("space", "0:80:20"), ("space", "20,30,60")]
    {
        let exact = ["--azimuth", mode, "--solver", "doubling", "--accuracy", "0.5"];
        let exact = [&exact[..], &LOBE_ALONE].concat();
        let stored = |table: &Table| table.meta().accuracy.rows_percent;
        let solved = bake_recipe("{}", &[&exact[..], &["--incident-deg", incidences]].concat());
        let truth = error_half_way(&solved, &exact);
        assert!(
            (stored(&solved) / truth - 1.0).abs() < 0.1,
            "{mode} {incidences}: {} {truth}",
            stored(&solved)
        );
        if mode == "decay" {
            // A walk knows it as well, whatever its own noise.
            let few = ["--paths", "2000", "--incident-deg", incidences];
            let walked = bake_recipe("{}", &[&few[..], &LOBE_ALONE].concat());
            assert!((stored(&walked) / truth - 1.0).abs() < 0.1, "{incidences}: {} {truth}", stored(&walked));
        }
    }
}

#[test]
fn bad_input_is_one_line_and_exit_2_and_harms_nothing() {
    let folder = folder();
    let kept = folder.path().join("pearl.exr");
    std::fs::write(&kept, "precious").unwrap();
    std::fs::write(folder.path().join("garbage.json"), [0xff, 0xfe, 0x00]).unwrap();
    for text in [
        r#"{"stack":{"layer":500}}"#,
        r#"{"stack":{"aragonite":{"thickness_nm":-1}}}"#,
        r#"{"stack":{"aragonite":{"n":0}}}"#,
        r#"{"stack":{"aragonite":{"n":NaN}}}"#,
        r#"{"facets":{"slope_sd_deg":90}}"#,
        r#"{"facets":{"slope_sd_deg":"2 rad"}}"#,
        "[",
    ] {
        write_recipe(folder.path(), text);
        assert_refused(folder.path(), &["recipe.json"]);
    }
    for args in [
        &["garbage.json"][..],
        &["missing.json"],
        &["."],
        &["--paths", "0"],
        &["--paths", "-5"],
        &["--accuracy", "0"],
        &["--accuracy", "-1"],
        &["--accuracy", "NaN"],
        &["--accuracy", "1", "--paths", "5"],
        &["--time-budget", "-1"],
        &["--incident-deg", "91"],
        &["--incident-deg", ""],
        &["--event-cap", "0"],
        &["--threads", "0"],
        &["--frobnicate"],
        &["--reproduce", "garbage.json"],
        &["--reproduce", "missing.exr"],
        &["--reproduce", "pearl.exr", "--seed", "3"],
        &["--checkpoint-every", "0"],
        &["--seed", "x"],
    ] {
        assert_refused(folder.path(), args);
    }
    assert_eq!(std::fs::read(&kept).unwrap(), b"precious");
    let left: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().file_name()).collect();
    assert_eq!(left.len(), 3, "a refused bake leaves nothing behind: {left:?}");
}

fn assert_refused(folder: &Path, args: &[&str]) {
    let output = tool(folder, args);
    let line = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{args:?}: {line}");
    assert_eq!(line.trim_end().lines().count(), 1, "{args:?}: {line}");
    assert!(output.stdout.is_empty() && line.starts_with("bake-brdf: "), "{args:?}: {line}");
}

#[test]
fn an_output_that_cannot_be_written_is_found_before_the_work() {
    let folder = folder();
    for output in ["no/such/folder/pearl.exr", "."] {
        let output = tool(folder.path(), &["--paths", "100000000", "-o", output]);
        assert_eq!(output.status.code(), Some(1));
        assert_eq!(String::from_utf8_lossy(&output.stderr).trim_end().lines().count(), 1);
    }
}

/// Starts a bake and returns when it has walked its pilot.
#[cfg(unix)]
fn walking(folder: &Path, args: &[&str]) -> std::process::Child {
    use std::io::BufRead as _;
    use std::process::Stdio;
    let mut child = Command::new(env!("CARGO_BIN_EXE_bake-brdf"))
        .current_dir(folder)
        .args(args)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut stderr = std::io::BufReader::new(child.stderr.take().unwrap());
    let mut line = String::new();
    while !line.contains("expected to take") {
        line.clear();
        assert!(stderr.read_line(&mut line).unwrap() > 0, "it ended");
    }
    // Kept open: what else it says has to go somewhere.
    child.stderr = Some(stderr.into_inner());
    child
}

/// A bake that takes an hour, ended by Ctrl-C.
#[cfg(unix)]
fn interrupted(folder: &Path) -> std::process::ExitStatus {
    let mut child = walking(folder, &["--paths", "1000000000", "--incident-deg", "30"]);
    let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(kill.success());
    child.wait().unwrap()
}

#[cfg(unix)]
fn names(folder: &Path) -> Vec<std::ffi::OsString> {
    std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().file_name()).collect()
}

#[cfg(unix)]
#[test]
fn ctrl_c_leaves_a_checkpoint_and_no_half_file() {
    let folder = folder();
    assert_eq!(interrupted(folder.path()).code(), Some(1));
    assert_eq!(names(folder.path()), ["pearl.exr.checkpoint"]);
}

#[test]
fn no_progress_bar_goes_into_a_pipe() {
    let folder = folder();
    let output = tool(folder.path(), &["--paths", "40000", "--incident-deg", "30"]);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!stderr.contains('\r') && !stderr.contains('\u{1b}'), "{stderr:?}");
    assert!(stderr.contains("expected to take"), "{stderr:?}");
    let quiet = tool(folder.path(), &["--paths", "40000", "--incident-deg", "30", "-q"]);
    assert!(quiet.stderr.is_empty());
}

#[test]
fn the_report_is_one_json_object_with_a_schema() {
    let folder = folder();
    for (args, schema) in [
        (&["--paths", "3000", "--incident-deg", "30", "--json"][..], "bake-report/1"),
        (
            &["--dry-run", "--accuracy", "5", "--incident-deg", "30", "--json", "-o", "dry.exr"],
            "bake-forecast/1",
        ),
    ] {
        let output = tool(folder.path(), args);
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(report["schema"], schema);
    }
    assert!(!folder.path().join("dry.exr").exists());
    let schema = tool(folder.path(), &["schema"]);
    assert!(
        serde_json::from_slice::<serde_json::Value>(&schema.stdout).unwrap()["properties"]["stack"]
            .is_object()
    );
}

#[test]
fn every_shipped_recipe_bakes() {
    let recipes = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/recipes");
    let mut seen = 0;
    for entry in std::fs::read_dir(recipes).unwrap() {
        let path = entry.unwrap().path();
        let folder = folder();
        let table =
            bake(folder.path(), &[path.to_str().unwrap(), "--accuracy", "20", "--incident-deg", "0,60"]);
        let name = table.meta().recipe["name"].as_str().unwrap().to_owned();
        assert_eq!(Some(name.as_str()), path.file_stem().and_then(|stem| stem.to_str()));
        assert!(!table.meta().recipe["sources"].as_object().unwrap().is_empty(), "{name} cites no source");
        seen += 1;
    }
    assert!(seen >= 5);
}

#[cfg(unix)]
#[test]
fn a_bake_that_was_killed_goes_on_to_the_same_bytes() {
    let folder = folder();
    let args = ["--paths", "400000", "--incident-deg", "0:80:20", "--checkpoint"];
    bake(folder.path(), &args);
    let table = folder.path().join("pearl.exr");
    let whole = std::fs::read(&table).unwrap();
    std::fs::remove_file(&table).unwrap();
    // States are kept from the pilot on.
    let kept = [&args[..], &["--checkpoint-every", "1e-9"]].concat();
    for more in [&[][..], &["--resume"]] {
        let mut child = walking(folder.path(), &[&kept[..], more].concat());
        child.kill().unwrap();
        child.wait().unwrap();
    }
    bake(folder.path(), &[&args[..], &["--resume"]].concat());
    assert!(std::fs::read(&table).unwrap() == whole);
    // A SIGKILL in the middle of a write may leave its temporary file, never a half output.
    let left = names(folder.path()).into_iter().filter(|name| !name.to_string_lossy().ends_with(".part"));
    assert_eq!(left.collect::<Vec<_>>(), ["pearl.exr"], "the checkpoint goes when the table is there");
}

#[cfg(unix)]
#[test]
fn lobes_that_ring_are_made_finer_and_get_no_cells_for_it() {
    let recipe = r#"{"stack": {"layers": 30, "ambient": {"n": 1.4078}}, "facets": {"slope_sd_deg": 4}}"#;
    let folder = folder();
    write_recipe(folder.path(), recipe);
    let how = ["recipe.json", "--solver", "doubling", "--azimuth", "space", "--accuracy", "5"];
    let table = bake(folder.path(), &[&how[..], &LOBE_ALONE].concat());
    let meta = table.meta();
    let SolverSettings::Doubling(settings) = &meta.solver_settings else { panic!("{meta:?}") };
    assert!(settings.raised > 0, "{settings:?}");
    // 45 % of the accuracy are for reading between cells: fewer would do if much less were missed.
    let cells_percent = meta.accuracy.cells_percent.unwrap();
    assert!((0.6..=1.0).contains(&(cells_percent / (0.45 * 5.0))), "{cells_percent} %");
    let same = tool(folder.path(), &["--reproduce", "pearl.exr"]);
    assert!(same.status.success(), "{}", String::from_utf8_lossy(&same.stderr));
}

#[test]
fn a_checkpoint_of_another_bake_is_refused() {
    let folder = folder();
    interrupted(folder.path());
    let output = tool(folder.path(), &["--paths", "5", "--incident-deg", "30", "--resume"]);
    let line = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{line}");
    assert!(line.contains("pearl.exr.checkpoint: belongs to another bake"), "{line}");
}

#[test]
fn a_table_is_reproduced_bit_for_bit_from_its_metadata_and_a_changed_one_is_not() {
    for args in [
        &["--paths", "9000"][..],
        &["--accuracy", "5"],
        &["--time-budget", "0.3", "--azimuth", "space"],
        &["--solver", "doubling", "--accuracy", "1"],
        &["--effects", "surface", "--paths", "9000"],
        &["--effects", "body"],
    ] {
        let folder = folder();
        let table = bake(folder.path(), &[args, &["--incident-deg", "0,30,80", "--seed", "9"]].concat());
        let same = tool(folder.path(), &["--reproduce", "pearl.exr", "--json"]);
        let report: serde_json::Value = serde_json::from_slice(&same.stdout).unwrap();
        assert_eq!(same.status.code(), Some(0), "{args:?}: {report:#}");
        assert_eq!((&report["identical"], &report["same_bytes"]), (&true.into(), &true.into()), "{args:?}");
        let cell = table.lobe(Component::Interior).value.len() / 2;
        let table = specimen::changed(&table, |parts| {
            let value = &mut parts.lobes[0].value[cell];
            *value = value.next_up();
        });
        exr_file::write(&table, &folder.path().join("pearl.exr")).unwrap();
        let other = tool(folder.path(), &["--reproduce", "pearl.exr"]);
        let line = String::from_utf8_lossy(&other.stderr).into_owned();
        assert_eq!(other.status.code(), Some(3), "{args:?}: {line}");
        assert!(line.contains("channel interior, 1 of"), "{args:?}: {line}");
    }
}

#[test]
fn both_solvers_write_the_same_lobe() {
    for mode in ["decay", "space"] {
        let cells = if mode == "space" { "64x32" } else { "128" };
        let args = ["--incident-deg", "0,30,60,85", "--azimuth", mode, "--cells", cells];
        let walked = bake_recipe("{}", &[&args[..], &["--paths", "200000"]].concat());
        let solved = bake_recipe("{}", &[&args[..], &["--solver", "doubling", "--accuracy", "0.1"]].concat());
        for (a, b) in walked.meta().per_incidence.iter().zip(&solved.meta().per_incidence) {
            // Four comparisons an incidence, 32 in all: 4.5 standard errors is met by chance once in 5,000 runs.
            for (x, y, error) in [
                (a.albedo, b.albedo, a.std_error.albedo),
                (a.surface, b.surface, a.std_error.surface),
                (a.mean_theta_o_deg, b.mean_theta_o_deg, a.std_error.mean_theta_o_deg),
                (a.sd_theta_o_deg, b.sd_theta_o_deg, a.std_error.sd_theta_o_deg),
            ] {
                assert!((x - y).abs() < 4.5 * error + 1e-5, "{mode} {}: {x} {y} {error}", a.theta_i_deg);
            }
        }
        // Cell by cell: the mean square of standardised differences over populated cells is 1 within 10 %
        // (several hundred cells: its standard deviation is below 0.05).
        let (mut sum, mut cells) = (0.0, 0.0);
        for k in 0..walked.lobe(Component::Interior).value.len() {
            if walked.lobe(Component::Interior).count[k] >= 50.0 {
                let z = (walked.lobe(Component::Interior).value[k]
                    - solved.lobe(Component::Interior).value[k])
                    / walked.lobe(Component::Interior).std_error[k];
                sum += f64::from(z * z);
                cells += 1.0;
            }
        }
        assert!(
            cells > 200.0 && (sum / cells - 1.0).abs() < 0.2,
            "{mode}: {} over {cells} cells",
            sum / cells
        );
    }
}

#[test]
fn a_table_holds_the_effects_asked_for_and_no_others() {
    let listed = |list: &str| {
        bake_recipe(ABSORBING, &["--paths", "20000", "--incident-deg", "0,60", "--effects", list])
    };
    let whole = listed("blur,absorption,body");
    assert_eq!(whole.meta().effects, ["surface", "blur", "azimuth", "absorption", "body"]);
    let clear = listed("blur");
    assert_eq!(clear.meta().effects, ["surface", "blur", "azimuth"]);
    let surface = listed("surface");
    assert_eq!(surface.meta().effects, ["surface"]);
    for ((whole, clear), surface) in
        whole.meta().per_incidence.iter().zip(&clear.meta().per_incidence).zip(&surface.meta().per_incidence)
    {
        assert!(whole.absorbed > 0.1 && clear.absorbed == 0.0, "{whole:?} {clear:?}");
        assert!(clear.albedo > clear.surface + 0.01, "{clear:?}");
        assert_eq!(surface.albedo, surface.surface, "nothing comes back from below");
        // The same flat walk meets the same first facet: 20,000 paths, 5 standard errors.
        assert!((surface.surface - clear.surface).abs() < 5.0 * (0.1_f64 * 0.9 / 20_000.0).sqrt());
    }
    let none = listed("body");
    assert_eq!(none.meta().effects, ["body"]);
    assert!(
        none.lobe(Component::Interior)
            .value
            .iter()
            .chain(&none.lobe(Component::Surface).value)
            .all(|value| *value == 0.0)
    );
    assert!(none.meta().per_incidence.iter().all(|row| row.albedo == 0.0 && row.transmitted == 1.0));
}

const ABSORBING: &str = r#"{"stack":{"layers":40,"aragonite":{"n":1.9},"conchiolin":{"k":0.1}}}"#;

#[test]
fn effects_that_cannot_be_baked_are_refused_in_one_line() {
    let folder = folder();
    for (list, said) in [
        ("glitter", "--effects: \"glitter\" is no effect; expected all alone, or a list of surface, blur"),
        ("blur,,body", "--effects: \"\" is no effect"),
        ("azimuth:flat", "--effects: azimuth:flat is no azimuth; expected azimuth:decay or azimuth:space"),
    ] {
        let output = tool(folder.path(), &["--effects", list]);
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{list}: {line}");
        assert!(line.contains(said) && line.trim_end().lines().count() == 1, "{list}: {line}");
    }
    assert_eq!(std::fs::read_dir(folder.path()).expect("the folder reads").count(), 0);
}

/// (has a modulation, has an emission).
fn colours(table: &Table) -> (bool, bool) {
    let spectra = table.meta().spectra.as_ref();
    spectra.map_or((false, false), |spectra| (spectra.coherent.is_some(), spectra.emission.is_some()))
}

#[test]
fn each_interference_colour_is_in_the_file_exactly_when_it_is_called_for() {
    let args = ["--paths", "1000", "--incident-deg", "0,60"];
    let look = |depth: f64, coherence: f64| {
        let text =
            format!(r#"{{"stack":{{"layers":6}},"look":{{"depth":{depth},"coherence":{coherence}}}}}"#);
        bake_recipe(&text, &args)
    };
    for (depth, coherence) in [(0.0, 0.0), (0.5, 0.0), (0.0, 0.5), (0.5, 0.5)] {
        let table = look(depth, coherence);
        assert_eq!(colours(&table), (coherence > 0.0, depth > 0.0), "{depth} {coherence}");
        let named = |name: &str| table.meta().effects.iter().any(|effect| effect == name);
        assert_eq!((named("coherent"), named("emission")), colours(&table));
    }
    let listed = |list: &str| {
        let listed = [&args[..], &["--effects", list]].concat();
        colours(&bake_recipe(r#"{"stack":{"layers":6}}"#, &listed))
    };
    assert_eq!(listed("blur"), (false, false));
    assert_eq!(listed("blur,coherent"), (true, false));
    assert_eq!(listed("emission,body"), (false, true));
}

/// n of the aragonite is negative at the violet end: there is a walk at 550 nm and no colour.
const NO_VIOLET: &str = r#"{"stack":{"layers":6,"aragonite":{"n":{"cauchy":[3.153,-0.5]}}}}"#;

#[test]
fn a_stack_without_colours_bakes_with_the_reason_or_is_refused_by_name() {
    let args = ["--paths", "1000", "--incident-deg", "0,60"];
    let table = bake_recipe(NO_VIOLET, &args);
    assert_eq!(colours(&table), (false, false));
    let missing = table.meta().spectra_missing.as_ref().expect("the reasons");
    for (effect, why) in [("coherent", &missing.coherent), ("emission", &missing.emission)] {
        assert!(why.as_ref().is_some_and(|why| why.contains("380")), "{missing:?}");
        assert!(!table.meta().effects.iter().any(|name| name == effect));
    }
    let folder = folder();
    write_recipe(folder.path(), NO_VIOLET);
    for further in [&["--effects", "blur,coherent"][..], &["--effects", "blur,emission", "--shard", "1/2"]] {
        let output = tool(folder.path(), &[&["recipe.json"], &args[..], further].concat());
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{line}");
        assert!(line.contains("cannot be had") && line.trim_end().lines().count() == 1, "{line}");
        assert_eq!(std::fs::read_dir(folder.path()).expect("the folder reads").count(), 1);
    }
}
