//! `thinfilm`: what waves do in a stack of layers.

use bake_brdf::recipe::{self, Recipe};
use clap::{Parser, Subcommand, ValueEnum};
use rayon::prelude::*;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use terminal::{Outcome, Stop};
use thinfilm::reference_case::{CaseFile, Verdict};
use thinfilm::{Incidence, Polarisation, Response};

/// Longest file of reference cases that is read, bytes.
const MOST_CASE_BYTES: u64 = 256 << 20;
/// Most wavelengths or angles of one spectrum.
const MOST_SAMPLES: usize = 1_000_000;

/// Interference in multilayers: reflectance, transmittance and absorptance of a recipe's stack.
#[derive(Debug, Parser)]
#[command(name = "thinfilm", version)]
#[command(after_help = "Examples:
  thinfilm spectrum pearl.json --angles-deg 0,30 --wavelengths-nm 380:780:401 --pol u --json
  thinfilm verify cases.json        exit 3 if a case misses its own tolerance")]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print one JSON object on stdout instead of text.
    #[arg(long, global = true)]
    json: bool,
    /// Say nothing on stderr but errors.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more on stderr.
    #[arg(short, long, global = true)]
    verbose: bool,
    /// Threads to use [default: one per core].
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// R, T and A of a recipe's stack (mean thicknesses, coherent) over wavelengths and angles.
    Spectrum {
        /// Recipe (JSON).
        recipe: PathBuf,
        /// Angles of incidence in degrees, separated by commas.
        #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "0")]
        angles_deg: Vec<f64>,
        /// Vacuum wavelengths in nm: from A to B in N samples, both ends included.
        #[arg(long, value_name = "A:B:N", default_value = "380:780:401")]
        wavelengths_nm: String,
        /// Polarisation: s, p or unpolarised.
        #[arg(long, value_enum, default_value = "u")]
        pol: Pol,
    },
    /// Compare with reference answers (the format of hard_cases.json).
    Verify {
        /// Cases with answers to many digits.
        cases: PathBuf,
    },
}

#[derive(ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum Pol {
    S,
    P,
    U,
}

fn main() -> ExitCode {
    terminal::main(run)
}

fn run(cli: Cli) -> Outcome {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cli.threads.unwrap_or(0).into()).build();
    pool.map_err(Stop::failure)?.install(|| match &cli.command {
        Command::Spectrum { recipe, angles_deg, wavelengths_nm, pol } => {
            spectrum(recipe, angles_deg, wavelengths_nm, *pol, cli.json)
        }
        Command::Verify { cases } => verify(cases, cli.json),
    })
}

fn read(path: &Path, most: u64) -> Result<String, Stop> {
    use std::io::Read as _;
    let named = |why: String| Stop::BadInput(format!("{}: {why}", path.display()));
    let file = std::fs::File::open(path).map_err(|why| named(why.to_string()))?;
    let mut text = String::new();
    let length = file.take(most + 1).read_to_string(&mut text).map_err(|why| named(why.to_string()))?;
    if length as u64 > most { Err(named(format!("longer than {most} bytes"))) } else { Ok(text) }
}

/// `A:B:N` as N wavelengths from A to B.
fn samples(text: &str) -> Result<Vec<f64>, Stop> {
    let refuse = || {
        Stop::BadInput(format!(
            "--wavelengths-nm: {text:?} is not A:B:N; expected two wavelengths > 0 nm and a count from 1 to {MOST_SAMPLES}"
        ))
    };
    let parts: Vec<&str> = text.split(':').collect();
    let [from, to, count] = parts.as_slice() else { return Err(refuse()) };
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|x| x.is_finite() && *x > 0.0);
    let (Some(from), Some(to), Ok(count)) = (number(from), number(to), count.trim().parse::<usize>()) else {
        return Err(refuse());
    };
    if !(1..=MOST_SAMPLES).contains(&count) {
        return Err(refuse());
    }
    let step = if count > 1 { (to - from) / (count - 1) as f64 } else { 0.0 };
    Ok((0..count).map(|i| if i + 1 == count && count > 1 { to } else { from + i as f64 * step }).collect())
}

fn spectrum(path: &Path, angles_deg: &[f64], wavelengths: &str, pol: Pol, as_json: bool) -> Outcome {
    let recipe = Recipe::from_json(&read(path, recipe::MAX_BYTES)?)
        .map_err(|why| Stop::BadInput(format!("{}: {why}", path.display())))?;
    let wavelengths_nm = samples(wavelengths)?;
    if let Some(angle) = angles_deg.iter().find(|angle| !(0.0..=90.0).contains(*angle)) {
        return Err(Stop::BadInput(format!(
            "--angles-deg: {angle} is not an angle of incidence; expected 0 to 90"
        )));
    }
    let stack = recipe.film_stack();
    let rows: Result<Vec<Vec<Rta>>, String> = wavelengths_nm
        .par_iter()
        .map(|&nm| {
            let film = stack.at(nm * 1e-9).map_err(|why| why.to_string())?;
            let solve = |angle: &f64, polarisation| {
                let incidence = Incidence::Angle(angle.to_radians());
                if recipe.stack.gain {
                    film.solve_with_gain(nm * 1e-9, incidence, polarisation)
                } else {
                    film.solve(nm * 1e-9, incidence, polarisation)
                }
                .map_err(|why| why.to_string())
            };
            angles_deg
                .iter()
                .map(|angle| {
                    Ok(match pol {
                        Pol::S => Rta::one(&solve(angle, Polarisation::S)?),
                        Pol::P => Rta::one(&solve(angle, Polarisation::P)?),
                        Pol::U => Rta::mean(&solve(angle, Polarisation::S)?, &solve(angle, Polarisation::P)?),
                    })
                })
                .collect()
        })
        .collect();
    let rows = rows.map_err(|why| Stop::BadInput(format!("{}: {why}", path.display())))?;
    if as_json {
        return terminal::print_json(&spectrum_json(&recipe, angles_deg, &wavelengths_nm, pol, &rows));
    }
    let mut text = "wavelength_nm,angle_deg,R,T,A\n".to_owned();
    for (nm, row) in wavelengths_nm.iter().zip(&rows) {
        for (angle, Rta { r, t, a }) in angles_deg.iter().zip(row) {
            text.push_str(&format!("{nm},{angle},{r},{t},{a}\n"));
        }
    }
    terminal::print(&text)
}

/// Shares reflected, transmitted, absorbed.
struct Rta {
    r: f64,
    t: f64,
    a: f64,
}

impl Rta {
    const fn one(response: &Response) -> Self {
        Self { r: response.reflectance, t: response.transmittance, a: response.absorptance }
    }

    fn mean(s: &Response, p: &Response) -> Self {
        Self {
            r: 0.5 * (s.reflectance + p.reflectance),
            t: 0.5 * (s.transmittance + p.transmittance),
            a: 0.5 * (s.absorptance + p.absorptance),
        }
    }
}

fn spectrum_json(
    recipe: &Recipe,
    angles_deg: &[f64],
    wavelengths_nm: &[f64],
    pol: Pol,
    rows: &[Vec<Rta>],
) -> Value {
    // One array an angle, one number a wavelength.
    let by_angle = |of: fn(&Rta) -> f64| -> Vec<Vec<f64>> {
        (0..angles_deg.len()).map(|i| rows.iter().map(|row| of(&row[i])).collect()).collect()
    };
    json!({
        "schema": "thinfilm-spectrum/1",
        "recipe": recipe.name,
        "pol": match pol { Pol::S => "s", Pol::P => "p", Pol::U => "u" },
        "angles_deg": angles_deg,
        "wavelengths_nm": wavelengths_nm,
        "R": by_angle(|x| x.r),
        "T": by_angle(|x| x.t),
        "A": by_angle(|x| x.a),
    })
}

fn verify(path: &Path, as_json: bool) -> Outcome {
    let named = |why: String| Stop::BadInput(format!("{}: {why}", path.display()));
    let text = read(path, MOST_CASE_BYTES)?;
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wavelengths_include_both_ends() {
        assert_eq!(samples("400:700:4").unwrap(), [400.0, 500.0, 600.0, 700.0]);
        assert_eq!(samples("550:550:1").unwrap(), [550.0]);
    }

    #[test]
    fn nonsense_wavelengths_are_refused() {
        for text in
            ["", "400", "400:700", "0:700:4", "-1:700:4", "400:700:0", "400:700:1e9", "a:b:c", "400:inf:3"]
        {
            assert!(samples(text).is_err(), "{text}");
        }
    }
}
