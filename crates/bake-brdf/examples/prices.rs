//! What does a bake cost on this machine? Measures the prices of `src/prices.rs` and of `transport::doubling::prices`.
//!
//! `cargo run --release -p bake-brdf --example prices`: all of them, in the order of that file, about half an hour. `-- PART …`: only
//! `solvers`, `effects`, `colours`, `tables` or `bands`. `--azimuth decay|space` does half of `solvers`.
//!
//! Everything runs on one thread and is timed by its CPU clock (Linux; elsewhere by the wall clock), so that other work on the
//! machine disturbs little; `effects` are ratios by the wall clock, measured in turn. Fits are relative least squares without a price below zero; each says how far it is from its own data.

#![allow(clippy::print_stdout)] // Its figures are what it is for.

mod timing;

use bake_brdf::bake::{self, Bands, Counts, Observer, ROWS, Request, WALKED};
use bake_brdf::effects::Effects;
use bake_brdf::options::{Options, SolverChoice, Target};
use bake_brdf::recipe::{AzimuthMode, Recipe};
use bake_brdf::spectra::{self, Want, Wanted};
use bake_brdf::study;
use lut_io::Table;
use lut_io::exr_file;
use std::sync::atomic::AtomicBool;
use timing::{PATIENCE, PEARL, Result, Stack, cpu_seconds, incidences, request, timed};
use transport::doubling::{OPERATIONS, prices};

const FITTED: [Stack; 6] = [
    (500, 2.0, PEARL),
    (1, 2.0, PEARL),
    (20, 0.7, PEARL),
    (100, 5.0, [1.7, 1.4, 1.0]),
    (4, 1.0, [1.6, 1.3, 1.5]),
    (2000, 1.3, PEARL),
];

fn main() -> Result<()> {
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global()?;
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let given = |word: &str| arguments.iter().any(|argument| argument == word);
    let azimuths: &[AzimuthMode] = match (given("decay"), given("space")) {
        (true, false) => &[AzimuthMode::Decay],
        (false, true) => &[AzimuthMode::Space],
        _ => &[AzimuthMode::Decay, AzimuthMode::Space],
    };
    let all = !["solvers", "effects", "colours", "tables", "bands"].into_iter().any(given);
    let wanted = |part: &str| all || given(part);
    if wanted("solvers") {
        solvers(azimuths)?;
    }
    if wanted("effects") {
        effects()?;
    }
    if wanted("colours") {
        colours()?;
    }
    if wanted("tables") {
        tables()?;
    }
    if wanted("bands") {
        bands()?;
    }
    Ok(())
}

/// The prices that explain the samples best, printed by name.
fn print_fit<'n>(
    what: &str,
    names: impl IntoIterator<Item = &'n &'n str>,
    samples: &[(Vec<f64>, f64)],
) -> Vec<f64> {
    let (prices, misfit) = least_squares(samples);
    println!("{what}: fit within {misfit:.2} (rms of the ratio)");
    for (name, price) in names.into_iter().zip(&prices) {
        println!("    {price:9.2e}  {name}");
    }
    prices
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

/// A request's counts, and the seconds that each solver took, where it was measured.
struct Sample {
    counts: Counts,
    doubling: Option<f64>,
    walk: Option<f64>,
}

fn solvers(azimuths: &[AzimuthMode]) -> Result<()> {
    for &azimuth in azimuths {
        let mut samples = Vec::new();
        for stack in FITTED {
            for incident_deg in incidences() {
                for percent in [10.0, 3.0, 1.0] {
                    samples.push(sample(&request(stack, azimuth, &incident_deg, percent)?)?);
                }
            }
        }
        let doubling = samples.iter().filter_map(|sample| {
            Some(([&sample.counts.doubling[..], &sample.counts.rows].concat(), sample.doubling?))
        });
        let names = OPERATIONS.iter().chain(&ROWS);
        let by_doubling = print_fit(&format!("{azimuth:?}, doubling"), names, &doubling.collect::<Vec<_>>());
        // Its own doubling, at the prices just found, is not the walk's doing.
        let walk = samples.iter().filter_map(|sample| {
            let beside: f64 = sample.counts.beside_walk.iter().zip(&by_doubling).map(|(a, b)| a * b).sum();
            let seconds = sample.walk? - beside;
            (seconds > 0.0).then(|| (sample.counts.walk.to_vec(), seconds))
        });
        print_fit(&format!("{azimuth:?}, walk"), &WALKED, &walk.collect::<Vec<_>>());
    }
    Ok(())
}

fn sample(request: &Request) -> Result<Sample> {
    let counts = bake::counts(request)?;
    let forecast = bake::forecast(request, &request.bands()?, SolverChoice::Walk, &Observer::idle())?;
    let walk = if forecast.seconds > PATIENCE {
        None
    } else {
        let (table, seconds) =
            timed(cpu_seconds, || bake::walk(request, &request.bands()?, &Observer::idle(), None));
        table?;
        Some(seconds)
    };
    let expected: f64 = counts.doubling.iter().zip(prices(request.geometry())).map(|(a, b)| a * b).sum();
    let doubling = if expected > 2.0 * PATIENCE {
        None
    } else {
        let (table, seconds) = timed(cpu_seconds, || bake::doubling(request, &request.bands()?));
        table.ok().map(|_| seconds)
    };
    Ok(Sample { counts, doubling, walk })
}

/// A crossing, and the factors of what it carries.
fn effects() -> Result<()> {
    for cost in study::effects(&Recipe::default(), &Options::default())? {
        println!("a crossing: {:.2} ns, with {}: {:.2} times as many", cost.base_ns, cost.effect, cost.ratio);
    }
    Ok(())
}

/// Waves of M and Ê, by whether the stack repeats (without irregular thicknesses it does) and whether it absorbs.
fn colours() -> Result<()> {
    const NAMES: [&str; 2] = ["wave", "layer of a wave"];
    let recipe = |layers: usize, repeats: bool, absorbs: bool| {
        let (sd, k) = (if repeats { 0.0 } else { 20.0 }, if absorbs { 1e-4 } else { 0.0 });
        Recipe::from_json(&format!(
            r#"{{"stack": {{"layers": {layers}, "aragonite": {{"thickness_sd_nm": {sd}, "k": {k}}}}}}}"#
        ))
    };
    let wanted = Wanted { irregularity: true, absorption: true, ..Wanted::default() };
    let reflectance = Wanted { coherent: Want::Required, ..wanted };
    let field = Wanted { emission: Want::Required, ..wanted };
    let never = AtomicBool::new(false);
    let sample = |recipe: Recipe, wanted: Wanted| -> Result<(Vec<f64>, f64)> {
        let [coherent, emission] = spectra::counts(&never, &recipe, wanted, 1.0);
        let (colours, seconds) = timed(cpu_seconds, || spectra::of(&never, &recipe, wanted, 1.0));
        colours?;
        Ok((vec![coherent[0] + emission[0], coherent[1] + emission[1]], seconds))
    };
    let fit = |what: String, layers: &[usize], repeats, absorbs, wanted| -> Result<()> {
        let samples = layers.iter().map(|&layers| sample(recipe(layers, repeats, absorbs)?, wanted));
        print_fit(&what, &NAMES, &samples.collect::<Result<Vec<_>>>()?);
        Ok(())
    };
    for (repeats, absorbs) in [(true, false), (true, true), (false, false), (false, true)] {
        let what = format!("M, repeats {repeats}, absorbs {absorbs}");
        fit(what, &[2, 10, 100, 1000, 10_000], repeats, absorbs, reflectance)?;
    }
    fit("M, doubled".to_owned(), &[20_000, 40_000], true, false, reflectance)?;
    fit("Ê".to_owned(), &[2, 10, 100, 1000], false, true, field)?;
    Ok(())
}

/// Seconds of solving and writing a table beside what its solver is foretold to take, and the bytes of its file.
fn written(request: &Request, solver: SolverChoice) -> Result<(f64, f64, Table)> {
    let folder = tempfile::tempdir()?;
    let path = folder.path().join("table.exr");
    let bands = Bands::own(&request.recipe);
    let (table, seconds) = timed(cpu_seconds, || -> Result<Table> {
        let table = match solver {
            SolverChoice::Doubling => bake::doubling(request, &bands)?,
            _ => bake::walk(request, &bands, &Observer::idle(), None)?,
        };
        exr_file::write(&table, &path)?;
        Ok(table)
    });
    let foretold = bake::forecast(request, &bands, solver, &Observer::idle())?.seconds;
    Ok((seconds - foretold, std::fs::metadata(&path)?.len() as f64, table?))
}

/// Rows and files of tables of the paper's pearl.
fn tables() -> Result<()> {
    let pearl = |list: &str, azimuth: AzimuthMode, step: usize| -> Result<Request> {
        let (effects, _) = Effects::parse(list)?;
        let incident_deg = Some((0..=90).step_by(step).map(|angle| angle as f64).collect());
        let target = Target::AccuracyPercent(3.0);
        let options = Options { effects, azimuth: Some(azimuth), incident_deg, target, ..Options::default() };
        Ok(Request::new(Recipe::default(), options)?)
    };
    let decay = AzimuthMode::Decay;
    let (overhead, header, _) = written(&pearl("body", decay, 90)?, SolverChoice::Doubling)?;
    println!("a file: {overhead:.4} s, {header} bytes");
    for effect in ["coherent", "emission"] {
        let (_, bytes, _) = written(&pearl(&format!("body,{effect}"), decay, 90)?, SolverChoice::Doubling)?;
        println!("    {} bytes of {effect}", bytes - header);
    }
    for azimuth in [decay, AzimuthMode::Space] {
        for solver in [SolverChoice::Walk, SolverChoice::Doubling] {
            let measured = |step: usize| written(&pearl("surface,blur", azimuth, step)?, solver);
            let ((few, few_bytes, small), (many, many_bytes, large)) = (measured(9)?, measured(3)?);
            let rows = |table: &Table| table.meta().per_incidence.len() as f64;
            let more = rows(&large) - rows(&small);
            let summary = serde_json::to_string(&large.meta().per_incidence)?.len() as f64 / rows(&large);
            let cell = ((many_bytes - few_bytes) / more - summary) / large.meta().exit_axis.cells() as f64;
            println!(
                "{azimuth:?}, {}: {summary:.0} bytes of metadata an incidence, {cell:.1} bytes a cell",
                solver.name()
            );
            if solver == SolverChoice::Doubling {
                // The forecast of a walk rests on its pilot: it is off by more than rows take.
                println!("    {:.1e} s a row", (many - few) / more);
            }
        }
    }
    Ok(())
}

/// Choosing the bands of dispersion, by a rough stack and by a smooth one.
fn bands() -> Result<()> {
    for slope_sd_deg in [2.0, 0.0] {
        let text = format!(
            r#"{{"stack": {{"layers": 40, "aragonite": {{"n": {{"cauchy": [1.5, 0.01]}}}}}},
            "facets": {{"slope_sd_deg": {slope_sd_deg}}}}}"#
        );
        let foretold = |list: &str| -> Result<(Request, f64)> {
            let (effects, _) = Effects::parse(list)?;
            let request = Request::new(Recipe::from_json(&text)?, Options { effects, ..Options::default() })?;
            let own = Bands::own(&request.recipe);
            let forecast = bake::forecast(&request, &own, SolverChoice::Doubling, &Observer::idle())?;
            Ok((request, forecast.seconds))
        };
        let ((request, with), (_, without)) =
            (foretold("surface,blur,dispersion")?, foretold("surface,blur")?);
        let (chosen, seconds) = timed(cpu_seconds, || request.bands());
        chosen?;
        println!("choosing bands, σ = {slope_sd_deg}°: {seconds:.2e} s, foretold {:.2e} s", with - without);
    }
    Ok(())
}
