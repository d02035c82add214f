//! The 83 hard cases with 40-digit references, where the file lies beside the checkout.

#![allow(clippy::print_stderr)] // a skipped test says so

use std::path::Path;

use thinfilm::reference_case::CaseFile;

fn cases() -> Option<CaseFile> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/hard_cases.json");
    let path = if path.exists() {
        path
    } else {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../../shared/hard_cases.json")
    };
    let Ok(text) = std::fs::read_to_string(&path) else {
        eprintln!("skipped: no ../shared/hard_cases.json beside the checkout");
        return None;
    };
    Some(serde_json::from_str(&text).unwrap())
}

#[test]
fn every_hard_case_is_within_its_own_tolerance() {
    let Some(file) = cases() else { return };
    let mut misses = Vec::new();
    for case in &file.cases {
        let verdict = case.verify().unwrap();
        if !verdict.pass {
            misses.push(format!("{}: {verdict:?}", case.id));
        }
    }
    assert!(misses.is_empty(), "{} of {} miss:\n{}", misses.len(), file.cases.len(), misses.join("\n"));
}
