//! Is `--solver auto` right? Both solvers and the choice between them over a grid of requests.
//!
//! `cargo run --release -p bake-brdf --example choice`: for each stack, geometry, list of incidences and accuracy the seconds of
//! either solver, what `auto` takes (its own choosing included) over the better of the two, and the total variation
//! that the table turned out to have against a solution of 1e-4 per cent. A walk that would take longer than
//! two seconds is forecast instead, and its error not measured.

#![allow(clippy::print_stdout)] // Its table is what it is for.

use std::error::Error;
use std::time::Instant;

use bake_brdf::bake::{self, Observer, Request, Sides, SolverChoice, Target};
use bake_brdf::recipe::{AzimuthMode, Recipe};
use lut_io::Table;
use lut_io::diff::diff;
use lut_io::lobe::Interpolant;

/// Longest walk that is walked, seconds.
const PATIENCE: f64 = 2.0;
const TRUTH_PERCENT: f64 = 1e-4;

/// Seconds, and per cent of total variation against the truth where there is a table.
struct Run {
    seconds: f64,
    reached: Option<f64>,
}

fn timed<T>(work: impl FnOnce() -> T) -> (T, f64) {
    let started = Instant::now();
    let result = work();
    (result, started.elapsed().as_secs_f64())
}

fn compared(table: Table, truth: &Interpolant) -> Option<f64> {
    Some(diff(&Interpolant::new(table), truth).worst_total_variation_percent)
}

fn walked(request: &Request, truth: &Interpolant) -> Result<Run, Box<dyn Error>> {
    let forecast = bake::forecast(request, &Observer::idle())?;
    if forecast.seconds > PATIENCE {
        return Ok(Run { seconds: forecast.seconds, reached: None });
    }
    let (table, seconds) = timed(|| bake::walk(request, &Observer::idle(), None));
    Ok(Run { seconds, reached: compared(table?, truth) })
}

fn solved(request: &Request, truth: &Interpolant) -> Result<Run, Box<dyn Error>> {
    let (table, seconds) = timed(|| bake::doubling(request, Sides::Above));
    Ok(match table {
        Ok(table) => Run { seconds, reached: compared(table, truth) },
        Err(_) => Run { seconds: f64::INFINITY, reached: None },
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    println!(
        "layers  sigma  azimuth  incidences  asked %  walk s    reached %  doubling s  reached %  auto       choosing s  auto/best"
    );
    let degree: Vec<f64> = (0..=90).map(f64::from).collect();
    for (layers, sigma_deg) in [(500, 2.0), (1, 2.0), (20, 0.7)] {
        for azimuth in [AzimuthMode::Decay, AzimuthMode::Walk] {
            for incident_deg in [&[30.0][..], &[0.0, 30.0, 60.0, 85.0], &degree] {
                grid(layers, sigma_deg, azimuth, incident_deg)?;
            }
        }
    }
    Ok(())
}

fn grid(
    layers: usize,
    sigma_deg: f64,
    azimuth: AzimuthMode,
    incident_deg: &[f64],
) -> Result<(), Box<dyn Error>> {
    let mut recipe = Recipe::default();
    recipe.stack.layers = Some(layers);
    recipe.facets.slope_sd_deg = sigma_deg;
    recipe.azimuth.mode = azimuth;
    let at = |percent: f64| Request {
        incident_deg: incident_deg.to_vec(),
        ..Request::new(recipe.clone(), Target::AccuracyPercent(percent))
    };
    let truth = Interpolant::new(bake::doubling(&at(TRUTH_PERCENT), Sides::Above)?);
    for percent in [10.0, 5.0, 2.0, 1.0, 0.1] {
        let request = at(percent);
        let walk = walked(&request, &truth)?;
        let doubling = solved(&request, &truth)?;
        let (choice, choosing) = timed(|| bake::choose_solver(&request));
        let chosen = choice?.0;
        let auto = choosing + if chosen == SolverChoice::Walk { walk.seconds } else { doubling.seconds };
        let reached = |run: &Run| run.reached.map_or("-".to_owned(), |percent| format!("{percent:.3}"));
        println!(
            "{layers:>6}  {sigma_deg:>5}  {:<7}  {:>10}  {percent:>7}  {:>8.3}  {:>9}  {:>10.3}  {:>9}  {:<9}  {choosing:>10.4}  {:>9.2}",
            format!("{azimuth:?}").to_lowercase(),
            incident_deg.len(),
            walk.seconds,
            reached(&walk),
            doubling.seconds,
            reached(&doubling),
            format!("{chosen:?}").to_lowercase(),
            auto / walk.seconds.min(doubling.seconds)
        );
    }
    Ok(())
}
