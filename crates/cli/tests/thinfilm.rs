//! The built `thinfilm`, end to end.

use serde_json::Value;
use std::path::Path;
use std::process::{Command, Output};

fn tool(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_thinfilm"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the tool starts")
}

#[test]
fn one_quarter_wave_layer_has_the_textbook_reflectance() {
    // R = ((n0 ns − n1²)/(n0 ns + n1²))² for a quarter wave n1·d = λ/4 (Born & Wolf §1.6.3).
    let folder = tempfile::tempdir().unwrap();
    let text = r#"{"stack":{"layers":1,"aragonite":{"n":1.38,"thickness_nm":100},"substrate":{"n":1.52}}}"#;
    std::fs::write(folder.path().join("r.json"), text).unwrap();
    let args =
        ["spectrum", "r.json", "--angles-deg", "0", "--wavelengths-nm", "552:552:1", "--pol", "u", "--json"];
    let output = tool(folder.path(), &args);
    let spectrum: Value = serde_json::from_slice(&output.stdout).unwrap();
    let expected = ((1.52 - 1.38_f64.powi(2)) / (1.52 + 1.38_f64.powi(2))).powi(2);
    let (r, t) = (spectrum["R"][0][0].as_f64().unwrap(), spectrum["T"][0][0].as_f64().unwrap());
    assert!((r - expected).abs() < 1e-14 && (r + t - 1.0).abs() < 1e-14);
    assert_eq!(spectrum["schema"], "thinfilm-spectrum/1");
}

const HARD_CASES: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/hard_cases.json");

#[test]
fn the_hard_cases_are_within_their_tolerance() {
    let output = tool(Path::new("."), &["verify", HARD_CASES, "--json"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(report["cases"].as_array().unwrap().len(), 83);
    assert!(report["cases"].as_array().unwrap().iter().all(|case| case["pass"] == true));
}

/// Johnson and Christy's silver, thick: R = |(n − 1)/(n + 1)|² at 520.9 nm, n = 0.05 + 3.324i.
#[test]
fn a_recipe_names_materials_of_the_library() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = |name: &str| {
        let text = format!(
            r#"{{"stack":{{"layers":1,"aragonite":{{"n":{{"material":"{name}"}},"thickness_nm":500}}}}}}"#
        );
        std::fs::write(folder.path().join("r.json"), text).unwrap();
        tool(folder.path(), &["spectrum", "r.json", "--wavelengths-nm", "520.9:520.9:1", "--json"])
    };
    let spectrum: Value = serde_json::from_slice(&recipe("silver").stdout).unwrap();
    let expected = (0.95f64.powi(2) + 3.324f64.powi(2)) / (1.05f64.powi(2) + 3.324f64.powi(2));
    // e^-80 of the light comes back from the far side.
    assert!((spectrum["R"][0][0].as_f64().unwrap() - expected).abs() < 1e-12, "{spectrum}");
    let refused = recipe("unobtainium");
    let stderr = String::from_utf8_lossy(&refused.stderr);
    assert_eq!(refused.status.code(), Some(2));
    assert!(
        stderr.lines().count() == 1 && stderr.contains("unobtainium") && stderr.contains("silver"),
        "{stderr}"
    );
}

#[test]
fn every_material_is_listed_with_its_source() {
    let listed: Value =
        serde_json::from_slice(&tool(Path::new("."), &["materials", "--json"]).stdout).unwrap();
    assert_eq!(listed["schema"], "thinfilm-materials/1");
    let materials = listed["materials"].as_array().unwrap();
    assert!(
        materials.iter().any(|m| m["name"] == "silver" && m["source"].as_str().unwrap().contains("Johnson"))
    );
    let plain = tool(Path::new("."), &["materials"]);
    assert_eq!(String::from_utf8_lossy(&plain.stdout).lines().count(), 1 + materials.len());
}

#[test]
fn a_wrong_answer_is_noticed() {
    let folder = tempfile::tempdir().unwrap();
    let mut file: Value = serde_json::from_str(&std::fs::read_to_string(HARD_CASES).unwrap()).unwrap();
    file["cases"][0]["ref"]["R"] = Value::from("0.5");
    std::fs::write(folder.path().join("wrong.json"), file.to_string()).unwrap();
    assert_eq!(tool(folder.path(), &["verify", "wrong.json"]).status.code(), Some(3));
}

/// One line on stderr that names what is wrong, exit 2, nothing on stdout, no file left behind.
#[test]
fn bad_input_is_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let recipe = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    recipe("r.json", r#"{"stack":{"layers":4}}"#);
    recipe("gain.json", r#"{"stack":{"aragonite":{"k":-0.1}}}"#);
    recipe("empty.json", r#"{"stack":{"explicit":[]}}"#);
    recipe("none.json", r#"{"stack":{"layers":0}}"#);
    recipe("nan.json", r#"{"stack":{"aragonite":{"n":1e400}}}"#);
    recipe("thick.json", r#"{"stack":{"aragonite":{"thickness_nm":-3}}}"#);
    recipe("table.json", r#"{"stack":{"aragonite":{"n":{"table":[[400,1.5,0],[500,1.5,0]]}}}}"#);
    recipe("broken.json", r#"{"stack":"#);
    recipe("murky.json", r#"{"stack":{"layers":4,"ambient":{"n":1.4,"k":1e-9}}}"#);
    recipe("laser.json", r#"{"stack":{"layers":4,"substrate":{"n":1.4,"k":-1e-9},"gain":true}}"#);
    recipe("lasing.json", r#"{"stack":{"explicit":[{"n":3,"k":-1,"thickness_nm":5000}],"gain":true}}"#);
    for (args, named) in [
        (&["spectrum", "missing.json"][..], "missing.json"),
        (&["spectrum", "r.json", "--angles-deg", "91"], "91"),
        (&["spectrum", "r.json", "--angles-deg", "-1"], "-1"),
        (&["spectrum", "r.json", "--angles-deg", "nan"], "nan"),
        (&["spectrum", "r.json", "--wavelengths-nm", "0:700:3"], "0:700:3"),
        (&["spectrum", "r.json", "--wavelengths-nm", "0"], "--wavelengths-nm"),
        (&["spectrum", "gain.json"], "-0.1"),
        (&["spectrum", "empty.json"], "explicit"),
        (&["spectrum", "none.json"], "layers"),
        (&["spectrum", "nan.json"], "nan.json"),
        (&["spectrum", "thick.json"], "-3"),
        (&["spectrum", "table.json"], "400 to 500 nm"),
        (&["spectrum", "broken.json"], "broken.json"),
        (&["colour", "table.json"], "400 to 500 nm"),
        (&["colour", "gain.json"], "-0.1"),
        (&["colour", "r.json", "--angles-deg", "91"], "91"),
        (&["colour", "r.json", "--accuracy", "0"], "--accuracy"),
        (&["colour", "r.json", "--members", "0"], "--members"),
        (&["swatch", "table.json", "-o", "out.png"], "400 to 500 nm"),
        (&["swatch", "r.json", "-o", "out.png", "--thickness-percent", "0:1:2"], "--thickness-percent"),
        (&["swatch", "r.json", "-o", "out.png", "--angles-deg", "0:90:0"], "--angles-deg"),
        (&["swatch", "r.json"], "--output"),
        (&["spectrum", "r.json", "--line-width-nm", "300"], "at most"),
        (&["spectrum", "r.json", "--line-width-nm", "nan"], "--line-width-nm"),
        (&["spectrum", "r.json", "--accuracy", "0"], "--accuracy"),
        (&["spectrum", "r.json", "--incoherent-above-nm", "0"], "--incoherent-above-nm"),
        (&["spectrum", "r.json", "--members", "2", "--line-width-nm", "1"], "cannot be used with"),
        (&["spectrum", "r.json", "--line-shape", "lorentzian"], "--line-width-nm"),
        (&["spectrum", "r.json", "--seed", "3", "--line-width-nm", "1"], "cannot be used with"),
        (&["spectrum", "murky.json", "--angles-deg", "20"], "normal incidence"),
        (&["spectrum", "murky.json", "--incoherent-above-nm", "10"], "without absorption"),
        (&["colour", "murky.json", "--angles-deg", "20"], "normal incidence"),
        (&["swatch", "murky.json", "-o", "out.png"], "normal incidence"),
        (&["spectrum", "laser.json"], "the substrate"),
        (&["colour", "laser.json"], "only layers can amplify"),
        (&["spectrum", "lasing.json", "--incoherent-above-nm", "1000"], "lasing threshold"),
        (&["verify", "r.json"], "cases"),
        (&["verify", "missing.json"], "missing.json"),
    ] {
        let output = tool(folder.path(), args);
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {line}");
        assert_eq!(line.trim_end().lines().count(), 1, "{args:?}: {line}");
        assert!(line.contains(named), "{args:?}: {line}");
        assert!(output.stdout.is_empty(), "{args:?}");
        assert!(!folder.path().join("out.png").exists(), "{args:?}");
    }
}

#[test]
fn gain_is_computed_where_the_recipe_asks_for_it() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"{"stack":{"layers":2,"gain":true,"aragonite":{"k":-0.001}}}"#;
    std::fs::write(folder.path().join("gain.json"), text).unwrap();
    let output = tool(folder.path(), &["spectrum", "gain.json", "--wavelengths-nm", "550:550:1", "--json"]);
    let spectrum: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(spectrum["A"][0][0].as_f64().unwrap() < 0.0);
}

/// A film of n = 1.33, 300 nm, in air reflects best at 4nd/3 = 532 nm, green; one of no contrast is black.
#[test]
fn colours_of_films_are_those_of_newton() {
    let folder = tempfile::tempdir().unwrap();
    let film = |n: f64| {
        format!(r#"{{"stack":{{"explicit":[{{"n":{n},"thickness_nm":300}}],"substrate":{{"n":1}}}}}}"#)
    };
    std::fs::write(folder.path().join("film.json"), film(1.33)).unwrap();
    std::fs::write(folder.path().join("air.json"), film(1.0)).unwrap();
    let colour = |recipe: &str| -> Value {
        let output = tool(folder.path(), &["colour", recipe, "--angles-deg", "0,60", "--json"]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let film = colour("film.json");
    assert_eq!(film["schema"], "thinfilm-colour/1");
    let rgb = |colours: &Value, at: usize| -> Vec<f64> {
        let rgb = colours["colours"][at]["linear_srgb"].as_array().unwrap();
        rgb.iter().map(|c| c.as_f64().unwrap()).collect()
    };
    let green = rgb(&film, 0);
    assert!(green[1] > green[0] && green[1] > green[2], "{green:?}");
    // At 60° that maximum is at 404 nm.
    let blue = rgb(&film, 1);
    assert!(blue[2] > green[2] && blue[2] > blue[1], "{blue:?}");
    assert!(rgb(&colour("air.json"), 0).iter().all(|c| c.abs() < 1e-14));
}

/// The pixels in the middle of a swatch's cells are the colours that `colour` prints, at the exposure of the brightest channel.
#[test]
fn a_swatch_shows_the_colours_of_its_cells() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("r.json"), r#"{"stack":{"layers":4}}"#).unwrap();
    let half_more =
        r#"{"stack":{"layers":4,"aragonite":{"thickness_nm":675},"conchiolin":{"thickness_nm":37.5}}}"#;
    std::fs::write(folder.path().join("half_more.json"), half_more).unwrap();
    cells_are_those_of(&folder, "100:100:1", "r.json");
    cells_are_those_of(&folder, "150:150:1", "half_more.json");
}

/// The swatch of `r.json` at one thickness against the colours of a recipe that is as thick.
fn cells_are_those_of(folder: &tempfile::TempDir, percent: &str, twin: &str) {
    let run = |args: &[&str]| {
        let output = tool(folder.path(), args);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        output.stdout
    };
    run(&["swatch", "r.json", "-o", "s.png", "--angles-deg", "0,30,60", "--thickness-percent", percent]);
    let file = std::io::BufReader::new(std::fs::File::open(folder.path().join("s.png")).unwrap());
    let mut reader = png::Decoder::new(file).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    let frame = reader.next_frame(&mut pixels).unwrap();
    let channels = frame.color_type.samples();
    let colours: Value =
        serde_json::from_slice(&run(&["colour", twin, "--angles-deg", "0,30,60", "--json"])).unwrap();
    let linear: Vec<Vec<f64>> = colours["colours"]
        .as_array()
        .unwrap()
        .iter()
        .map(|c| c["linear_srgb"].as_array().unwrap().iter().map(|x| x.as_f64().unwrap()).collect())
        .collect();
    let brightest = linear.iter().flatten().copied().fold(0.0, f64::max);
    for (row, linear) in linear.iter().enumerate() {
        // Cells of 36 × 40 below and right of a margin of 96 × 64, drawn at twice that.
        let (x, y) = (2 * (96 + 18), 2 * (64 + 20 + 40 * row));
        let at = (y * frame.width as usize + x) * channels;
        for (c, linear) in linear.iter().enumerate() {
            let x = (linear / brightest).max(0.0);
            let encoded = if x <= 0.003_130_8 { 12.92 * x } else { 1.055 * x.powf(1.0 / 2.4) - 0.055 };
            let seen = f64::from(pixels[at + c]);
            assert!(
                (seen - 255.0 * encoded).abs() <= 1.0,
                "row {row}, channel {c}: {seen} {}",
                255.0 * encoded
            );
        }
    }
}

#[test]
fn an_ensemble_has_the_members_that_its_accuracy_takes() {
    let folder = tempfile::tempdir().unwrap();
    let text = r#"{"stack":{"layers":20,"aragonite":{"thickness_sd_nm":20}}}"#;
    std::fs::write(folder.path().join("r.json"), text).unwrap();
    let ensemble = |flag: &str, value: &str| -> Value {
        let waves = ["--wavelengths-nm", "450:650:3", "--angles-deg", "0,40", "--json"];
        let output = tool(folder.path(), &[&["spectrum", "r.json", flag, value][..], &waves].concat());
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let errors = |spectrum: &Value| -> f64 {
        let rows = spectrum["R_std_error"].as_array().unwrap();
        let squares: Vec<f64> = rows
            .iter()
            .flat_map(|row| row.as_array().unwrap())
            .map(|error| error.as_f64().unwrap().powi(2))
            .collect();
        (squares.iter().sum::<f64>() / squares.len() as f64).sqrt()
    };
    let few = ensemble("--members", "4");
    assert_eq!(few["members"], 4);
    let many = ensemble("--accuracy", "0.002");
    assert!(errors(&few) > 0.002 && errors(&many) <= 0.002, "{} {}", errors(&few), errors(&many));
    assert!(many["members"].as_u64().unwrap() > 4);
}

/// One member has no error, too few do not converge, and a line says how well it is known.
#[test]
fn errors_that_are_not_known_are_null_and_accuracies_that_are_not_reached_are_told() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
    write("r.json", r#"{"stack":{"explicit":[{"n":1.6,"thickness_nm":400,"thickness_sd_nm":40}]}}"#);
    write(
        "table.json",
        r#"{"stack":{"explicit":[{"n":{"table":[[400,1.5,0],[700,1.5,0]]},"thickness_nm":5000}]}}"#,
    );
    let run = |args: &[&str]| -> (Value, String) {
        let waves = ["--wavelengths-nm", "552:552:1", "--json"];
        let output = tool(folder.path(), &[args, &waves].concat());
        let told = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(0), "{told}");
        (serde_json::from_slice(&output.stdout).unwrap(), told)
    };
    let (one, told) = run(&["spectrum", "r.json", "--members", "1"]);
    assert!(one["R_std_error"].is_null() && one["T_std_error"].is_null() && told.is_empty(), "{one}");
    assert!(one.get("converged").is_none(), "{one}");
    let (few, told) = run(&["spectrum", "r.json", "--accuracy", "1e-8"]);
    assert!(few["converged"] == false && few["members"] == 65_536, "{few}");
    assert!(told.lines().count() == 1 && told.contains("65536"), "{told}");
    let (_, told) = run(&["spectrum", "r.json", "--accuracy", "1e-8", "-q"]);
    assert!(told.is_empty(), "{told}");
    let line = ["--line-width-nm", "3", "--line-shape", "lorentzian"];
    let (cut, told) = run(&[&["spectrum", "table.json"][..], &line].concat());
    assert!(cut["converged"] == false && cut["error"].as_f64().unwrap() > 3e-3, "{cut}");
    assert!(told.lines().count() == 1 && told.contains("error of the mean"), "{told}");
    let (whole, told) = run(&[&["spectrum", "r.json"][..], &line].concat());
    assert!(
        whole["converged"] == true && whole["error"].as_f64().unwrap() <= 1e-4 && told.is_empty(),
        "{whole}"
    );
    let output = tool(folder.path(), &["colour", "r.json", "--members", "1", "--angles-deg", "0", "--json"]);
    let colour: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert!(colour["colours"][0]["ensemble_std_error_delta_e"].is_null(), "{colour}");
}
