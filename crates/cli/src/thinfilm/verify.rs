//! `thinfilm verify`: answers against references with many digits.

use rayon::prelude::*;
use serde_json::{Value, json};
use std::path::Path;
use terminal::{Outcome, Stop};
use thinfilm::reference_case::{CaseFile, Verdict};

/// Longest file of reference cases that is read, bytes.
const MOST_CASE_BYTES: u64 = 256 << 20;

pub(crate) fn verify(path: &Path, as_json: bool) -> Outcome {
    let named = |why: String| Stop::BadInput(format!("{}: {why}", path.display()));
    let text = terminal::read_text(path, MOST_CASE_BYTES)?;
    let file: CaseFile = serde_json::from_str(&text).map_err(|why| named(why.to_string()))?;
    let verdicts: Result<Vec<Verdict>, _> = file.cases.par_iter().map(|case| case.verify()).collect();
    let verdicts = verdicts.map_err(|why| named(why.to_string()))?;
    if verdicts.is_empty() {
        return Err(named("no cases in it".to_owned()));
    }
    let failed = verdicts.iter().filter(|verdict| !verdict.pass).count();
    let cases = file.cases.iter().zip(&verdicts);
    if as_json {
        let list: Vec<Value> = cases
            .map(|(case, v)| {
                json!({
                    "id": case.id,
                    "pass": v.pass,
                    "relative_error": {
                        "r": v.r.error, "t": v.t.error, "R": v.reflectance.error, "T": v.transmittance.error,
                    },
                    "tolerance": {
                        "r": v.r.tolerance, "t": v.t.tolerance,
                        "R": v.reflectance.tolerance, "T": v.transmittance.tolerance,
                    },
                })
            })
            .collect();
        terminal::print_json(&json!({
            "schema": "thinfilm-verify/1", "passed": verdicts.len() - failed, "failed": failed, "cases": list,
        }))?;
    } else {
        let mut text = String::new();
        for (case, v) in cases {
            let verdict = if v.pass { "ok  " } else { "MISS" };
            text.push_str(&format!(
                "{verdict} {:<40} r {:.1e}  t {:.1e}  R {:.1e}  T {:.1e}\n",
                case.id, v.r.error, v.t.error, v.reflectance.error, v.transmittance.error
            ));
        }
        text.push_str(&format!("{} of {} within their tolerance\n", verdicts.len() - failed, verdicts.len()));
        terminal::print(&text)?;
    }
    if failed > 0 {
        return Err(Stop::check_failed(format!(
            "{}: {failed} of {} cases miss their tolerance",
            path.display(),
            verdicts.len()
        )));
    }
    Ok(())
}
