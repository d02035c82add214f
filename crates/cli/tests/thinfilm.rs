//! The built `thinfilm`, end to end.

#![allow(clippy::print_stdout)] // a skipped check says why

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

#[test]
fn the_hard_cases_are_within_their_tolerance() {
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/hard_cases.json");
    if !cases.exists() {
        println!("skipped: {} is not there", cases.display());
        return;
    }
    let output = tool(Path::new("."), &["verify", cases.to_str().unwrap(), "--json"]);
    let report: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(report["cases"].as_array().unwrap().len() >= 83);
}

#[test]
fn a_wrong_answer_is_noticed_and_bad_input_refused() {
    let folder = tempfile::tempdir().unwrap();
    let cases = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/hard_cases.json");
    if let Ok(text) = std::fs::read_to_string(cases) {
        let mut file: Value = serde_json::from_str(&text).unwrap();
        file["cases"][0]["ref"]["R"] = Value::from("0.5");
        std::fs::write(folder.path().join("wrong.json"), file.to_string()).unwrap();
        assert_eq!(tool(folder.path(), &["verify", "wrong.json"]).status.code(), Some(3));
    } else {
        println!("skipped the altered case: no hard_cases.json beside the checkout");
    }
    std::fs::write(folder.path().join("r.json"), "{}").unwrap();
    std::fs::write(folder.path().join("gain.json"), r#"{"stack":{"aragonite":{"k":-0.1}}}"#).unwrap();
    let table = r#"{"stack":{"aragonite":{"n":{"table":[[400,1.5,0],[500,1.5,0]]}}}}"#;
    std::fs::write(folder.path().join("table.json"), table).unwrap();
    for args in [
        &["spectrum", "missing.json"][..],
        &["spectrum", "r.json", "--angles-deg", "91"],
        &["spectrum", "r.json", "--wavelengths-nm", "0:700:3"],
        &["spectrum", "gain.json"],
        &["spectrum", "table.json"],
        &["verify", "r.json"],
        &["verify", "missing.json"],
    ] {
        let output = tool(folder.path(), args);
        let line = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {line}");
        assert_eq!(line.trim_end().lines().count(), 1, "{args:?}: {line}");
    }
}
