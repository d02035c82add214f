//! `lut check`

use crate::{FileArg, read, read_lobe};
use bake_brdf::bake::implied;
use lut_io::Table;
use lut_io::check::{self, Finding, HONESTY_SIGNIFICANCE, Honesty};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use terminal::{Outcome, Stop};

#[derive(clap::Args, Debug)]
#[command(after_help = "Examples:
  lut check pearl.exr
  lut check pearl.exr --against other_seed.exr    are the stored errors honest?
What the cells, the metadata and the recipe imply of each other is worked out again, but for the lobe of the light that entered the
stack: only `bake-brdf --reproduce` finds other light by cell whose shares, moments and errors were changed along with it.
Exit codes: 0 all hold, 2 the file is not a table, 3 at least one does not hold.")]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    file: FileArg,
    /// A second walk of the same recipe with another seed: do the two differ as their stored errors say?
    #[arg(long, value_name = "FILE")]
    against: Option<PathBuf>,
}

pub(crate) fn run(args: &CheckArgs, json: bool) -> Outcome {
    let file = &args.file.file;
    let lobe = read_lobe(file)?;
    let table = lobe.table();
    let (findings, no_recipe) = implied::whole(&lobe);
    let honesty = match &args.against {
        Some(other) => honesty(table, file, other)?,
        None => Vec::new(),
    };
    let mut failed: Vec<&str> = findings.iter().filter(|f| f.pass == Some(false)).map(|f| f.check).collect();
    if !honesty.iter().all(honest) {
        failed.push("honesty");
    }
    if json {
        terminal::print_json(&json!({
            "schema": "lut-check/1",
            "pass": failed.is_empty(),
            "checks": findings,
            "recipe_not_read": no_recipe,
            "honesty": honesty,
            "provenance": provenance(table, file),
        }))?;
    } else {
        terminal::print(
            &(text(&findings)
                + &no_recipe_text(no_recipe)
                + &honesty_text(&honesty)
                + &provenance_text(table, file)),
        )?;
    }
    if failed.is_empty() {
        return Ok(());
    }
    Err(Stop::check_failed(format!("{}: does not hold: {}", file.display(), failed.join(", "))))
}

fn honesty(table: &Table, file: &Path, other: &Path) -> Result<Vec<Honesty>, Stop> {
    check::honesty(table, &read(other)?)
        .map_err(|error| Stop::bad_input(format!("{} against {}: {error}", file.display(), other.display())))
}

fn honest(found: &Honesty) -> bool {
    found.p >= HONESTY_SIGNIFICANCE
}

/// What the table was made of and by, and the command that makes it again.
fn provenance(table: &Table, file: &Path) -> Value {
    let meta = table.meta();
    json!({
        "writer": meta.writer,
        "recipe": meta.recipe_name(),
        "seed": meta.seed,
        "solver": meta.solver,
        "reproduce": format!("bake-brdf --reproduce {}", file.display()),
    })
}

fn text(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let verdict = match finding.pass {
            Some(true) => "ok",
            Some(false) => "FAILED",
            None => "info",
        };
        let Finding { check, what, worst, worst_theta_i_deg, wavelength_nm, tolerance, .. } = finding;
        let bound = tolerance.map_or_else(String::new, |tolerance| format!(" (at most {tolerance:e})"));
        let _ = writeln!(
            text,
            "{verdict:<7} {check:<17} {worst:.2e} at {worst_theta_i_deg:.2}°, {wavelength_nm} nm{bound}: {what}"
        );
    }
    text
}

fn no_recipe_text(why: Option<String>) -> String {
    why.map_or_else(String::new, |why| {
        format!("info    {:<17} not compared with the table: {why}\n", "recipe")
    })
}

fn honesty_text(honesty: &[Honesty]) -> String {
    let mut text = String::new();
    for found in honesty {
        let verdict = if honest(found) { "ok" } else { "FAILED" };
        let Honesty { of, count, variance, p, departure } = found;
        let _ = writeln!(
            text,
            "{verdict:<7} {:<17} {variance:.4} is the variance of {count} differences of {of} in standard errors \
             (p {p:.3}, at least {HONESTY_SIGNIFICANCE}; {departure:+.1} standard deviations from 1)",
            "honesty"
        );
    }
    text
}

fn provenance_text(table: &Table, file: &Path) -> String {
    let meta = table.meta();
    let name = meta.recipe_name().unwrap_or("without a name");
    format!(
        "info    {:<17} {}, recipe {name}, seed {}: the same bits? bake-brdf --reproduce {}\n",
        "provenance",
        meta.writer,
        meta.seed,
        file.display()
    )
}
