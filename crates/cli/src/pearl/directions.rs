//! `pearl eval` and `pearl sample`: directions in or out, one JSON object a line.

use crate::args::{EvalArgs, SampleArgs, Triple};
use pearl_bsdf::{Components, Direction, Evaluation};
use rand::{RngExt as _, SeedableRng as _};
use serde::Deserialize;
use serde_json::{Value, json};
use std::io::{BufRead as _, BufWriter, Read as _, Write as _};
use terminal::{Outcome, Stop, stdout_error};

/// Longest input line, bytes: six numbers take far less.
const MAX_LINE: u64 = 4096;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Pair {
    wi: Triple,
    wo: Triple,
}

/// Evaluates every line of the input; nothing is kept but the line at hand.
///
/// As a renderer that traces paths from the camera asks: wi looks at the surface, light arrives from wo.
pub(crate) fn eval(args: &EvalArgs) -> Outcome {
    let bsdf = args.pearl.bsdf()?;
    let name = args.input.display();
    let mut source = terminal::open_text(&args.input)?;
    let mut out = BufWriter::new(std::io::stdout().lock());
    let mut line = Vec::new();
    for number in 1u64.. {
        line.clear();
        let read = (&mut source)
            .take(MAX_LINE + 1)
            .read_until(b'\n', &mut line)
            .map_err(|error| Stop::failure(format!("{name}: line {number}: {error}")))?;
        if read == 0 {
            break;
        }
        // What was evaluated before the bad line has its answers.
        let bad = |out: &mut BufWriter<_>, why: String| {
            out.flush().map_err(|error| stdout_error(&error))?;
            Err(Stop::bad_input(format!("{name}: line {number}: {why}")))
        };
        if read as u64 > MAX_LINE {
            return bad(&mut out, format!("is longer than {MAX_LINE} bytes"));
        }
        if line.iter().all(u8::is_ascii_whitespace) {
            continue;
        }
        let (wi, wo) = match parse(&line) {
            Ok(pair) => pair,
            Err(why) => return bad(&mut out, why),
        };
        let (value, pdf) = (bsdf.eval_seen(wi, wo), bsdf.pdf(wi, wo));
        let mut object = json!({ "rgb": value.rgb(), "pdf": pdf, "components": components(&value) });
        if !args.wavelengths_nm.is_empty() {
            let at = |nm: &f64| bsdf.eval_seen_at(wi, wo, *nm).iter().sum::<f64>();
            object["spectral"] = args.wavelengths_nm.iter().map(at).collect();
        }
        writeln!(out, "{object}").map_err(|error| stdout_error(&error))?;
    }
    out.flush().map_err(|error| stdout_error(&error))
}

fn parse(line: &[u8]) -> Result<(Direction, Direction), String> {
    let pair: Pair = serde_json::from_slice(line)
        .map_err(|error| format!("{error}; expected {{\"wi\":[x,y,z],\"wo\":[x,y,z]}}"))?;
    Ok((unit("wi", pair.wi)?, unit("wo", pair.wo)?))
}

/// The direction of a vector of any length but 0.
fn unit(name: &str, v: Triple) -> Result<Direction, String> {
    let refuse = || format!("{name} is {v:?}, expected three finite numbers that are not all 0");
    pearl_bsdf::unit(v).ok_or_else(refuse)
}

fn components(value: &Evaluation) -> Value {
    Components::NAMES
        .into_iter()
        .zip(value.parts())
        .map(|(name, rgb)| (name.to_owned(), json!(rgb)))
        .collect()
}

/// Draws directions; a draw that finds none is printed with `"wo": null`.
pub(crate) fn sample(args: &SampleArgs) -> Outcome {
    let bsdf = args.pearl.bsdf()?;
    let wi = unit("--wi", args.wi).map_err(Stop::bad_input)?;
    let mut random = rand::rngs::StdRng::seed_from_u64(args.seed);
    let mut out = BufWriter::new(std::io::stdout().lock());
    for _ in 0..args.count {
        let object = match bsdf.sample(wi, random.random(), random.random(), random.random()) {
            Some(sample) => {
                let value = bsdf.eval_seen(wi, sample.wo);
                let rgb = value.rgb();
                json!({
                    "wo": sample.wo, "pdf": sample.pdf, "rgb": rgb,
                    "weight": rgb.map(|x| x / sample.pdf), "components": components(&value),
                })
            }
            None => json!({ "wo": null, "pdf": 0.0, "rgb": [0.0, 0.0, 0.0], "weight": [0.0, 0.0, 0.0] }),
        };
        writeln!(out, "{object}").map_err(|error| stdout_error(&error))?;
    }
    out.flush().map_err(|error| stdout_error(&error))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_of_any_length_become_unit_vectors() {
        for scale in [1e-300, 1e-3, 1.0, 1e300] {
            let w = unit("wi", [0.0, 3.0 * scale, 4.0 * scale]).unwrap();
            assert!((w[1] - 0.6).abs() < 1e-15 && (w[2] - 0.8).abs() < 1e-15);
        }
        assert!(unit("wi", [0.0; 3]).is_err() && unit("wi", [f64::NAN, 0.0, 1.0]).is_err());
    }
}
