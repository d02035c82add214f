//! Bakes.

use crate::convert::{names, row};
use crate::errors::{failure, field, input, of_bake};
use crate::recipe::Recipe;
use crate::table::Table;
use bake_brdf::bake::{
    BakeError, Observer, Progress, Request, bake as solve, can_be_reciprocal, reciprocal as symmetrised,
};
use bake_brdf::effects::{Effects, View};
use bake_brdf::options::{Options, Sides, SolverChoice, Target};
use bake_brdf::recipe::AzimuthMode;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Between two looks at signals.
const TICK: Duration = Duration::from_millis(50);

/// What the thread that bakes and the one that waits for it share.
#[derive(Default)]
struct Shared {
    stop: AtomicBool,
    /// Share of the walk that is done, as the bits of an f64.
    done: AtomicU64,
    outcome: Mutex<Outcome>,
    ended: Condvar,
}

/// What a bake came to.
#[derive(Default)]
enum Outcome {
    #[default]
    Open,
    Ended(Box<Result<lut_io::Table, BakeError>>),
    /// The thread is gone without a result: a fault of ours.
    Lost,
}

/// Says that a thread has ended, however it did.
struct Ending(Arc<Shared>);

impl Drop for Ending {
    fn drop(&mut self) {
        let mut outcome = self.0.outcome.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(*outcome, Outcome::Open) {
            *outcome = Outcome::Lost;
        }
        self.0.ended.notify_all();
    }
}

/// Bakes a table.
#[pyfunction]
#[pyo3(signature = (
    recipe, *, solver=None, accuracy=None, paths=None, time_budget=None, incident_deg=None, cells=None, effects=None, azimuth=None,
    seed=1, both_sides=false, reciprocal=false, look=None, threads=None, progress=None
))]
pub(crate) fn bake(
    py: Python<'_>,
    recipe: &Bound<'_, PyAny>,
    solver: Option<&str>,
    accuracy: Option<f64>,
    paths: Option<u64>,
    time_budget: Option<f64>,
    incident_deg: Option<&Bound<'_, PyAny>>,
    cells: Option<[usize; 2]>,
    effects: Option<&Bound<'_, PyAny>>,
    azimuth: Option<&str>,
    seed: u64,
    both_sides: bool,
    reciprocal: bool,
    look: Option<&Bound<'_, PyDict>>,
    threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Table> {
    let (effects, listed_azimuth) = parse_effects(effects)?;
    let azimuth = azimuth.map(parse_azimuth).transpose()?;
    if let (Some(given), Some(listed)) = (azimuth, listed_azimuth)
        && given != listed
    {
        return Err(field("effects", "its azimuth is not that of azimuth; give one of the two"));
    }
    let options = Options {
        effects,
        azimuth: azimuth.or(listed_azimuth),
        incident_deg: incident_deg.map(|angles| row("incident_deg", angles)).transpose()?,
        cells,
        target: target(accuracy, paths, time_budget)?,
        solver: solver.map(parse_solver).transpose()?,
        seed,
        sides: if both_sides { Sides::Both } else { Sides::Above },
        ..Options::default()
    };
    let recipe = Recipe::of(recipe)?.inner;
    let view = crate::look::view(&recipe, look)?;
    if threads == Some(0) {
        return Err(field("threads", "0 threads bake nothing, expected at least 1"));
    }
    let pool = threads.map(|count| rayon::ThreadPoolBuilder::new().num_threads(count).build());
    let pool = pool.transpose().map_err(failure)?;
    let shared = Arc::new(Shared::default());
    let ending = Ending(Arc::clone(&shared));
    // A thread of its own, so that this one can look at signals; it ends by itself where nobody waits for it any more.
    std::thread::spawn(move || {
        let shared = &ending.0;
        let work = || whole(recipe, &view, options, reciprocal, shared);
        let result = match &pool {
            Some(pool) => pool.install(work),
            None => work(),
        };
        *shared.outcome.lock().unwrap_or_else(PoisonError::into_inner) = Outcome::Ended(Box::new(result));
    });
    Ok(Table::from(wait(py, &shared, progress)?))
}

/// From a recipe to a table.
fn whole(
    recipe: bake_brdf::recipe::Recipe,
    view: &View,
    options: Options,
    reciprocal: bool,
    shared: &Shared,
) -> Result<lut_io::Table, BakeError> {
    let (recipe, decisions) = options.decide(recipe, view)?;
    let request = Request::of(recipe, decisions.set(), options)?;
    if reciprocal {
        // Before anything is solved.
        can_be_reciprocal(&request.bands()?)?;
    }
    let share = |progress: &Progress<'_>| {
        let share = progress.crossings() as f64 / progress.expected_crossings;
        shared.done.store(share.clamp(0.0, 1.0).to_bits(), Ordering::Relaxed);
    };
    let table = solve(&request, &Observer { stop: &shared.stop, progress: &share, ..Observer::idle() })?;
    if reciprocal { symmetrised(&table) } else { Ok(table) }
}

/// Waits for a bake without the interpreter's lock; takes it to look at signals and to call `progress`.
fn wait(py: Python<'_>, shared: &Shared, progress: Option<&Bound<'_, PyAny>>) -> PyResult<lut_io::Table> {
    let started = Instant::now();
    let mut told = None;
    let mut tell = |share: f64| match progress {
        Some(progress) if told != Some(share) => {
            told = Some(share);
            progress.call1((share, started.elapsed().as_secs_f64())).map(drop)
        }
        _ => Ok(()),
    };
    loop {
        let outcome = py.detach(|| {
            let open = shared.outcome.lock().unwrap_or_else(PoisonError::into_inner);
            let waited =
                shared.ended.wait_timeout_while(open, TICK, |outcome| matches!(outcome, Outcome::Open));
            let (mut outcome, _) = waited.unwrap_or_else(PoisonError::into_inner);
            std::mem::take(&mut *outcome)
        });
        match outcome {
            Outcome::Ended(result) => {
                let table = result.map_err(|why| of_bake(&why))?;
                tell(1.0)?;
                return Ok(table);
            }
            Outcome::Lost => return Err(failure("the bake ended without a result")),
            Outcome::Open => {
                let share = f64::from_bits(shared.done.load(Ordering::Relaxed));
                // Below 1 until the table is there.
                let outcome = py.check_signals().and_then(|()| tell(share.min(0.999)));
                if outcome.is_err() {
                    shared.stop.store(true, Ordering::Relaxed);
                }
                outcome?;
            }
        }
    }
}

fn target(accuracy: Option<f64>, paths: Option<u64>, time_budget: Option<f64>) -> PyResult<Target> {
    match (accuracy, paths, time_budget) {
        (None, None, None) => Ok(Options::default().target),
        (Some(percent), None, None) => Ok(Target::AccuracyPercent(percent)),
        (None, Some(paths), None) => Ok(Target::Paths(paths)),
        (None, None, Some(seconds)) => match Duration::try_from_secs_f64(seconds) {
            Ok(time) => Ok(Target::Time(time)),
            Err(_) => Err(field(
                "time_budget",
                format_args!("{seconds} is not a time, expected seconds, more than 0"),
            )),
        },
        _ => Err(input("accuracy, paths, time_budget: expected one of them at most")),
    }
}

fn parse_solver(name: &str) -> PyResult<SolverChoice> {
    let all = [SolverChoice::Walk, SolverChoice::Doubling, SolverChoice::Auto];
    let unknown = || field("solver", format_args!("{name:?} is not one of walk, doubling, auto"));
    all.into_iter().find(|solver| solver.name() == name).ok_or_else(unknown)
}

fn parse_azimuth(name: &str) -> PyResult<AzimuthMode> {
    AzimuthMode::from_name(name)
        .ok_or_else(|| field("azimuth", format_args!("{name:?} is not one of decay, space")))
}

/// The effects of a list, and the azimuth mode that it may have.
fn parse_effects(effects: Option<&Bound<'_, PyAny>>) -> PyResult<(Effects, Option<AzimuthMode>)> {
    let Some(effects) = effects else { return Ok((Effects::default(), None)) };
    Effects::parse(&names("effects", effects)?.join(",")).map_err(input)
}
