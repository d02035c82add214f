//! `lut check`

use crate::{FileArg, read_lobe};
use lut_io::check::{self, Finding};
use std::fmt::Write as _;
use terminal::{Outcome, Stop};

#[derive(clap::Args, Debug)]
#[command(after_help = "Exit codes: 0 all hold, 2 the file is not a table, 3 at least one does not hold.")]
pub(crate) struct CheckArgs {
    #[command(flatten)]
    file: FileArg,
    /// Print one JSON object.
    #[arg(long)]
    json: bool,
}

pub(crate) fn run(args: &CheckArgs) -> Outcome {
    let lobe = read_lobe(&args.file.file)?;
    let findings = check::check(&lobe);
    let failed: Vec<&str> = findings.iter().filter(|f| f.pass == Some(false)).map(|f| f.check).collect();
    if args.json {
        terminal::print_json(&serde_json::json!({
            "schema": "lut-check/1",
            "pass": failed.is_empty(),
            "checks": findings,
        }))?;
    } else {
        terminal::print(&text(&findings))?;
    }
    if failed.is_empty() {
        return Ok(());
    }
    let file = args.file.file.display();
    Err(Stop::check_failed(format!("{file}: does not hold: {}", failed.join(", "))))
}

fn text(findings: &[Finding]) -> String {
    let mut text = String::new();
    for finding in findings {
        let verdict = match finding.pass {
            Some(true) => "ok",
            Some(false) => "FAILED",
            None => "info",
        };
        let Finding { check, what, worst, worst_theta_i_deg, tolerance, .. } = finding;
        let bound = tolerance.map_or_else(String::new, |tolerance| format!(" (at most {tolerance:e})"));
        let _ =
            writeln!(text, "{verdict:<7} {check:<17} {worst:.2e} at {worst_theta_i_deg:.2}°{bound}: {what}");
    }
    text
}
