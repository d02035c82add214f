//! Is `--solver auto` right, and what are its prices?
//!
//! `cargo run --release -p bake-brdf --example choice`: both solvers and the choice between them over requests that the fit of
//! the prices has not seen. A line each: seconds of either solver, what `auto` takes (its own choosing included) over the
//! better of the two, and the total variation that the table turned out to have against a solution of 1e-4 per cent (1e-2 where that is too dear).
//! A walk that would take longer than a second is forecast instead, and its error not measured.
//!
//! `cargo run --release -p bake-brdf --example choice -- --fit`: bakes another list of requests by both solvers and fits the seconds
//! of one core that each counted operation takes: relative least squares, no price below zero. Prints the constants of
//! `transport::doubling::prices` and `bake::choice`, and how far the fit is from its own data.
//!
//! All bakes run on one thread and are timed by its CPU clock (Linux; elsewhere by the wall clock), so that other work on the
//! machine disturbs little. `--threads N` times the wall clock on N threads instead, `--azimuth decay|space` does half the list.

#![allow(clippy::print_stdout)] // Its table is what it is for.

use std::error::Error;
use std::time::Instant;

use bake_brdf::bake::{self, Counts, Observer, ROWS, Request, WALKED};
use bake_brdf::effects::{Effect, Effects};
use bake_brdf::options::{Options, SolverChoice, Target};
use bake_brdf::recipe::{AzimuthMode, Recipe};
use lut_io::Table;
use lut_io::diff::diff;
use lut_io::lobe::Interpolant;
use transport::doubling::{OPERATIONS, prices};

/// Longest walk that is walked, and half the longest doubling that is fitted, seconds.
const PATIENCE: f64 = 1.0;
const TRUTH_PERCENT: f64 = 1e-4;
/// Where that is too dear: still a fiftieth of the smallest error asked for.
const COARSE_TRUTH_PERCENT: f64 = 1e-2;
/// Short work is repeated until it has taken so many seconds, or so often.
const LONG_ENOUGH: f64 = 0.1;
const MOST_REPEATS: f64 = 100.0;
/// `auto` may take this many times the better solver's time.
const ALLOWED: f64 = 1.2;

type Result<T> = std::result::Result<T, Box<dyn Error>>;

/// Layers, σ in degrees, indices of the odd and even layers and of the substrate.
type Stack = (usize, f64, [f64; 3]);

const PEARL: [f64; 3] = [1.53, 1.43, 1.53];
const FITTED: [Stack; 6] = [
    (500, 2.0, PEARL),
    (1, 2.0, PEARL),
    (20, 0.7, PEARL),
    (100, 5.0, [1.7, 1.4, 1.0]),
    (4, 1.0, [1.6, 1.3, 1.5]),
    (2000, 1.3, PEARL),
];
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
    if arguments.iter().any(|argument| argument == "--fit") {
        fit(clock, &azimuths)
    } else {
        try_fresh(clock, &azimuths)
    }
}

/// Seconds on some clock.
type Clock = fn() -> f64;

fn wall_seconds() -> f64 {
    static START: std::sync::OnceLock<Instant> = std::sync::OnceLock::new();
    START.get_or_init(Instant::now).elapsed().as_secs_f64()
}

/// Of this thread, where the system says.
fn cpu_seconds() -> f64 {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").unwrap_or_default();
    let nanoseconds = text.split_whitespace().next().and_then(|text| text.parse::<f64>().ok());
    nanoseconds.map_or_else(wall_seconds, |nanoseconds| 1e-9 * nanoseconds)
}

/// What work gives, and how long it takes: the mean of as many repeats as the clock's ticks (4 ms) call for.
fn timed<T>(clock: Clock, mut work: impl FnMut() -> T) -> (T, f64) {
    let started = clock();
    let mut repeats = 1.0;
    let mut result = work();
    while clock() - started < LONG_ENOUGH && repeats < MOST_REPEATS {
        result = work();
        repeats += 1.0;
    }
    (result, (clock() - started) / repeats)
}

fn incidences() -> [Vec<f64>; 3] {
    [vec![30.0], vec![0.0, 30.0, 60.0, 85.0], (0..=90).map(f64::from).collect()]
}

/// A request for the lobe alone: colours take either solver the same time.
fn request(stack: Stack, azimuth: AzimuthMode, incident_deg: &[f64], percent: f64) -> Result<Request> {
    let (layers, sigma_deg, [odd, even, substrate]) = stack;
    let text = format!(
        r#"{{"schema": "pearl-recipe/1", "stack": {{"layers": {layers}, "aragonite": {{"n": {odd}}}, "conchiolin": {{"n": {even}}},
        "substrate": {{"n": {substrate}}}}}, "facets": {{"slope_sd_deg": {sigma_deg}}}}}"#
    );
    let mut recipe = Recipe::from_json(&text)?;
    recipe.azimuth.mode = azimuth;
    let options = Options {
        effects: Effects::Listed([Effect::Surface, Effect::Blur, Effect::Azimuth].into_iter().collect()),
        incident_deg: incident_deg.to_vec(),
        target: Target::AccuracyPercent(percent),
        ..Options::default()
    };
    Ok(Request::new(recipe, options)?)
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

/// A request's counts, and the seconds that each solver took, where it was measured.
struct Sample {
    counts: Counts,
    doubling: Option<f64>,
    walk: Option<f64>,
}

fn fit(clock: Clock, azimuths: &[AzimuthMode]) -> Result<()> {
    for &azimuth in azimuths {
        let mut samples = Vec::new();
        for stack in FITTED {
            for incident_deg in incidences() {
                for percent in [10.0, 3.0, 1.0] {
                    samples.push(sample(clock, &request(stack, azimuth, &incident_deg, percent)?)?);
                }
            }
        }
        let doubling = samples.iter().filter_map(|sample| {
            Some(([&sample.counts.doubling[..], &sample.counts.rows].concat(), sample.doubling?))
        });
        let (by_doubling, misfit) = least_squares(&doubling.collect::<Vec<_>>());
        println!("{azimuth:?}, doubling: fit within {misfit:.2} (rms of the ratio)");
        for (name, price) in OPERATIONS.iter().chain(&ROWS).zip(&by_doubling) {
            println!("    {price:9.2e}  {name}");
        }
        // Its own doubling, at the prices just found, is not the walk's doing.
        let walk = samples.iter().filter_map(|sample| {
            let beside: f64 = sample.counts.beside_walk.iter().zip(&by_doubling).map(|(a, b)| a * b).sum();
            let seconds = sample.walk? - beside;
            (seconds > 0.0).then(|| (sample.counts.walk.to_vec(), seconds))
        });
        let (by_walk, misfit) = least_squares(&walk.collect::<Vec<_>>());
        println!("{azimuth:?}, walk: fit within {misfit:.2} (rms of the ratio)");
        for (name, price) in WALKED.iter().zip(&by_walk) {
            println!("    {price:9.2e}  {name}");
        }
    }
    Ok(())
}

fn sample(clock: Clock, request: &Request) -> Result<Sample> {
    let counts = bake::counts(request)?;
    let forecast = bake::forecast(request, &request.bands()?, SolverChoice::Walk, &Observer::idle())?;
    let walk = if forecast.seconds > PATIENCE {
        None
    } else {
        let (table, seconds) =
            timed(clock, || bake::walk(request, &request.bands()?, &Observer::idle(), None));
        table?;
        Some(seconds)
    };
    let expected: f64 = counts.doubling.iter().zip(prices(request.geometry())).map(|(a, b)| a * b).sum();
    let doubling = if expected > 2.0 * PATIENCE {
        None
    } else {
        let (table, seconds) = timed(clock, || bake::doubling(request, &request.bands()?));
        table.ok().map(|_| seconds)
    };
    Ok(Sample { counts, doubling, walk })
}

/// Prices ≥ 0 that make Σ(Σ_k count_k·price_k / seconds − 1)² least, by coordinate descent; and the rms of what is left.
fn least_squares(samples: &[(Vec<f64>, f64)]) -> (Vec<f64>, f64) {
    let rows: Vec<Vec<f64>> = samples
        .iter()
        .map(|(counts, seconds)| counts.iter().map(|count| count / seconds).collect())
        .collect();
    let mut prices = vec![0.0; rows.first().map_or(0, Vec::len)];
    let missing = |prices: &[f64], row: &[f64]| 1.0 - row.iter().zip(prices).map(|(a, b)| a * b).sum::<f64>();
    for _ in 0..20_000 {
        for k in 0..prices.len() {
            let square: f64 = rows.iter().map(|row| row[k] * row[k]).sum();
            if square > 0.0 {
                let step: f64 = rows.iter().map(|row| row[k] * missing(&prices, row)).sum::<f64>() / square;
                prices[k] = (prices[k] + step).max(0.0);
            }
        }
    }
    let left: f64 = rows.iter().map(|row| missing(&prices, row).powi(2)).sum();
    (prices, (left / rows.len() as f64).sqrt())
}
