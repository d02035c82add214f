//! Is `--solver auto` right?
//!
//! `cargo run --release -p bake-brdf --example choice`: both solvers and the choice between them over requests that the example
//! `prices` has not seen. A line each: seconds of either solver, what `auto` takes (its own choosing included) over the
//! better of the two, and the total variation that the table turned out to have against a solution of 1e-4 per cent (1e-2 where that is too dear).
//! A walk that would take longer than a second is forecast instead, and its error not measured.
//!
//! All bakes run on one thread and are timed by its CPU clock (Linux; elsewhere by the wall clock), so that other work on the
//! machine disturbs little. `--threads N` times the wall clock on N threads instead, `--azimuth decay|space` does half the list.

#![allow(clippy::print_stdout)] // Its table is what it is for.

mod timing;

use bake_brdf::bake::{self, Observer, Request};
use bake_brdf::options::SolverChoice;
use bake_brdf::recipe::AzimuthMode;
use lut_io::Table;
use lut_io::diff::diff;
use lut_io::lobe::Interpolant;
use timing::{Clock, PATIENCE, PEARL, Result, Stack, cpu_seconds, incidences, request, timed, wall_seconds};

const TRUTH_PERCENT: f64 = 1e-4;
/// Where that is too dear: still a fiftieth of the smallest error asked for.
const COARSE_TRUTH_PERCENT: f64 = 1e-2;
/// `auto` may take this many times the better solver's time.
const ALLOWED: f64 = 1.2;

const FRESH: [Stack; 5] = [
    (500, 3.0, PEARL),
    (2, 0.9, [1.5, 1.4, 1.33]),
    (12, 0.6, PEARL),
    (60, 1.5, [1.68, 1.4, 1.0]),
    (9, 6.0, [1.9, 1.2, 1.5]),
];

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let value = |name: &str| {
        let at = arguments.iter().position(|argument| argument == name)?;
        arguments.get(at + 1).map(String::as_str)
    };
    let threads = value("--threads").unwrap_or("1").parse()?;
    let azimuths = match value("--azimuth") {
        Some("decay") => vec![AzimuthMode::Decay],
        Some("space") => vec![AzimuthMode::Space],
        _ => vec![AzimuthMode::Decay, AzimuthMode::Space],
    };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    let pool = if threads == 1 { pool.use_current_thread() } else { pool };
    pool.build_global()?;
    let clock = if threads == 1 { cpu_seconds } else { wall_seconds };
    try_fresh(clock, &azimuths)
}

/// Seconds, and per cent of total variation against the truth where there is a table.
struct Run {
    seconds: f64,
    reached: Option<f64>,
}

fn compared(table: Table, truth: &Interpolant) -> Option<f64> {
    Some(diff(&Interpolant::new(table), truth).worst_total_variation_percent)
}

fn walked(clock: Clock, request: &Request, truth: &Interpolant) -> Result<Run> {
    let forecast = bake::forecast(request, &request.bands()?, SolverChoice::Walk, &Observer::idle())?;
    if forecast.seconds > PATIENCE {
        return Ok(Run { seconds: forecast.seconds, reached: None });
    }
    let (table, seconds) = timed(clock, || bake::walk(request, &request.bands()?, &Observer::idle(), None));
    Ok(Run { seconds, reached: compared(table?, truth) })
}

fn solved(clock: Clock, request: &Request, truth: &Interpolant) -> Run {
    let (table, seconds) = timed(clock, || bake::doubling(request, &request.bands()?));
    match table {
        Ok(table) => Run { seconds, reached: compared(table, truth) },
        Err(_) => Run { seconds: f64::INFINITY, reached: None },
    }
}

/// What the table of requests came to.
#[derive(Default)]
struct Score {
    ratios: Vec<f64>,
    /// Requests beyond the ratio, with the seconds lost.
    lost: Vec<f64>,
    /// Grids without a truth to compare with.
    skipped: usize,
    /// Reached over promised: walk, doubling.
    reached: [Vec<f64>; 2],
}

fn try_fresh(clock: Clock, azimuths: &[AzimuthMode]) -> Result<()> {
    println!(
        "layers  sigma  azimuth  incidences  asked %  walk s    reached %  doubling s  reached %  auto       choosing s  auto/best"
    );
    let mut score = Score::default();
    for stack in FRESH {
        for &azimuth in azimuths {
            for incident_deg in incidences() {
                grid(clock, stack, azimuth, &incident_deg, &mut score)?;
            }
        }
    }
    let within = score.ratios.iter().filter(|ratio| **ratio <= ALLOWED).count();
    let worst = score.ratios.iter().copied().fold(0.0, f64::max);
    println!(
        "{within} of {} requests within {ALLOWED} of the better solver, worst {worst:.2}",
        score.ratios.len()
    );
    if score.skipped > 0 {
        println!("{} grids skipped", score.skipped);
    }
    for lost in score.lost {
        println!("beyond it: {lost:.4} s lost");
    }
    for (name, reached) in ["walk", "doubling"].into_iter().zip(&score.reached) {
        let exceeded = reached.iter().filter(|ratio| **ratio > 1.0).count();
        let worst = reached.iter().copied().fold(0.0, f64::max);
        println!(
            "{name}: {} tables measured, {exceeded} above their promise, worst {worst:.3} of it",
            reached.len()
        );
    }
    Ok(())
}

/// The table at the finest accuracy that can be paid for.
fn truth(at: &dyn Fn(f64) -> Result<Request>) -> Result<Interpolant> {
    let solved = |percent: f64| -> Result<Table> {
        let request = at(percent)?;
        Ok(bake::doubling(&request, &request.bands()?)?)
    };
    Ok(Interpolant::new(solved(TRUTH_PERCENT).or_else(|_| solved(COARSE_TRUTH_PERCENT))?))
}

fn grid(
    clock: Clock,
    stack: Stack,
    azimuth: AzimuthMode,
    incident_deg: &[f64],
    score: &mut Score,
) -> Result<()> {
    let at = |percent: f64| request(stack, azimuth, incident_deg, percent);
    let truth = match truth(&at) {
        Ok(truth) => truth,
        Err(why) => {
            let (layers, sigma, _) = stack;
            println!(
                "{layers} layers, {sigma}°, {azimuth:?}, {} incidences: skipped, no truth: {why}",
                incident_deg.len()
            );
            score.skipped += 1;
            return Ok(());
        }
    };
    for percent in [10.0, 5.0, 2.0, 0.5] {
        let request = at(percent)?;
        let walk = walked(clock, &request, &truth)?;
        let doubling = solved(clock, &request, &truth);
        let (choice, choosing) = timed(clock, || bake::choose_solver(&request, &request.bands()?));
        let chosen = choice?.0;
        let auto = choosing + if chosen == SolverChoice::Walk { walk.seconds } else { doubling.seconds };
        let best = walk.seconds.min(doubling.seconds);
        score.ratios.push(auto / best);
        if auto / best > ALLOWED {
            score.lost.push(auto - best);
        }
        for (all, run) in score.reached.iter_mut().zip([&walk, &doubling]) {
            all.extend(run.reached.map(|reached| reached / percent));
        }
        let reached = |run: &Run| run.reached.map_or("-".to_owned(), |percent| format!("{percent:.3}"));
        println!(
            "{:>6}  {:>5}  {:<7}  {:>10}  {percent:>7}  {:>8.4}  {:>9}  {:>10.4}  {:>9}  {:<9}  {choosing:>10.4}  {:>9.2}",
            stack.0,
            stack.1,
            format!("{azimuth:?}").to_lowercase(),
            incident_deg.len(),
            walk.seconds,
            reached(&walk),
            doubling.seconds,
            reached(&doubling),
            format!("{chosen:?}").to_lowercase(),
            auto / best
        );
    }
    Ok(())
}
