//! `bake-brdf --reproduce`: a table baked again from its metadata, compared bit by bit.

use super::progress::{seconds_text, watched};
use bake_brdf::bake::reproduce::{self, Difference};
use lut_io::solver::Solver;
use serde_json::json;
use std::fmt::Write as _;
use std::path::Path;
use std::time::Instant;
use terminal::{Manners, Outcome, Stop};

/// Differences listed before the rest is only counted.
const MOST_LISTED: usize = 20;

/// Runs the check on one file.
pub(super) fn run(path: &Path, manners: &Manners) -> Outcome {
    let file = path.display();
    let stored = lut_io::exr_file::read(path).map_err(|why| match why.is_bad_input() {
        true => Stop::bad_input(why),
        false => Stop::failure(why),
    })?;
    reproduce::request(stored.meta()).map_err(|why| Stop::bad_input(format!("{file}: {why}")))?;
    if stored.meta().solver == Solver::Walk {
        terminal::interruption()?;
    }
    let pool = manners.pool()?;
    let started = Instant::now();
    let again =
        pool.install(|| watched(manners, None, |observer| reproduce::bake_again(stored.meta(), observer)))?;
    let seconds = started.elapsed().as_secs_f64();
    let differences = reproduce::differences(&stored, &again);
    // The same table in another encoding (saved again by another program) is no other bake, but worth a word.
    let bytes = lut_io::exr_file::encode(&again).map_err(Stop::failure)?;
    let same_bytes = std::fs::read(path).is_ok_and(|old| old == bytes);
    if manners.json {
        terminal::print_json(&json!({
            "schema": "bake-reproduction/1",
            "file": file.to_string(),
            "identical": differences.is_empty(),
            "same_bytes": same_bytes,
            "seconds": seconds,
            "writer": { "stored": stored.meta().writer, "again": again.meta().writer },
            "differences": differences,
        }))?;
    } else {
        terminal::print(&text(&differences, same_bytes, stored.meta().per_incidence.len(), seconds))?;
    }
    match differences.first() {
        None => Ok(()),
        Some(first) => Err(Stop::check_failed(format!(
            "{file}: not reproduced: {} differences, first {}: {} in the file, {} baked again",
            differences.len(),
            first.field,
            first.stored,
            first.again
        ))),
    }
}

fn text(differences: &[Difference], same_bytes: bool, incidences: usize, seconds: f64) -> String {
    let time = seconds_text(seconds);
    if differences.is_empty() {
        let bytes = if same_bytes { "the same bytes" } else { "the same table in another encoding" };
        return format!("reproduced bit for bit: {incidences} incidences in {time}; {bytes}\n");
    }
    let mut text = format!("not reproduced: {} differences after {time}\n", differences.len());
    for Difference { field, stored, again } in differences.iter().take(MOST_LISTED) {
        let _ = writeln!(text, "  {field}: {stored} in the file, {again} baked again");
    }
    if differences.len() > MOST_LISTED {
        let _ = writeln!(text, "  … and {} more", differences.len() - MOST_LISTED);
    }
    text
}
