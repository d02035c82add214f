//! Bakes.

use crate::convert::{names, row, whole};
use crate::errors::{failure, field, input, of_bake};
use crate::recipe::Recipe;
use crate::table::Table;
use bake_brdf::bake::snapshot::{self, Snapshot};
use bake_brdf::bake::{
    BakeError, Observer, Progress, Request, Shard, bake as solve, can_be_reciprocal,
    reciprocal as symmetrised,
};
use bake_brdf::effects::{Effects, View};
use bake_brdf::options::{Options, Sides, SolverChoice, Target};
use bake_brdf::recipe::AzimuthMode;
use pyo3::prelude::*;
use pyo3::pybacked::PyBackedBytes;
use pyo3::types::{PyAny, PyBytes, PyDict};
use std::collections::HashMap;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Between two looks at signals.
const TICK: Duration = Duration::from_millis(50);
/// As of the tools.
const MOST_THREADS: usize = 4096;
/// What the system calls the thread that works.
const THREAD: &str = "nacre-bake";

/// What the thread that works and the one that waits for it share.
struct Shared<T> {
    stop: AtomicBool,
    /// Share of the walk that is done, as the bits of an f64.
    done: AtomicU64,
    outcome: Mutex<Outcome<T>>,
    ended: Condvar,
}

/// What the work came to.
enum Outcome<T> {
    Open,
    Ended(Box<Result<T, BakeError>>),
    /// The thread is gone without a result: a fault of ours.
    Lost,
}

/// Says that a thread has ended, however it did.
struct Ending<T>(Arc<Shared<T>>);

impl<T> Drop for Ending<T> {
    fn drop(&mut self) {
        let mut outcome = self.0.outcome.lock().unwrap_or_else(PoisonError::into_inner);
        if matches!(*outcome, Outcome::Open) {
            *outcome = Outcome::Lost;
        }
        self.0.ended.notify_all();
    }
}

#[doc = stub!("bake")]
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
    #[pyo3(from_py_with = whole::paths)] paths: Option<u64>,
    time_budget: Option<f64>,
    incident_deg: Option<&Bound<'_, PyAny>>,
    #[pyo3(from_py_with = whole::cells)] cells: Option<[usize; 2]>,
    effects: Option<&Bound<'_, PyAny>>,
    azimuth: Option<&str>,
    #[pyo3(from_py_with = whole::seed)] seed: u64,
    both_sides: bool,
    reciprocal: bool,
    look: Option<&Bound<'_, PyDict>>,
    #[pyo3(from_py_with = whole::threads)] threads: Option<usize>,
    progress: Option<&Bound<'_, PyAny>>,
) -> PyResult<Table> {
    let options = Options {
        target: target(accuracy, paths, time_budget)?,
        solver: solver.map(parse_solver).transpose()?,
        sides: if both_sides { Sides::Both } else { Sides::Above },
        ..options(incident_deg, cells, effects, azimuth, seed)?
    };
    let job = Job::new(recipe, look, options, threads)?;
    let table = watched(py, progress, move |observer| {
        job.run(observer.stop, |request| {
            if reciprocal {
                // Before anything is solved.
                can_be_reciprocal(&request.bands_unless(observer.stop)?)?;
            }
            let table = solve(request, observer)?;
            if reciprocal { symmetrised(&table) } else { Ok(table) }
        })
    });
    Ok(Table::from(table?))
}

#[doc = stub!("walk_shard")]
#[pyfunction]
#[pyo3(signature = (
    recipe, index, count, *, paths, incident_deg=None, cells=None, effects=None, azimuth=None, seed=1, look=None, threads=None
))]
pub(crate) fn walk_shard<'py>(
    py: Python<'py>,
    recipe: &Bound<'_, PyAny>,
    #[pyo3(from_py_with = whole::index)] index: u32,
    #[pyo3(from_py_with = whole::count)] count: u32,
    #[pyo3(from_py_with = whole::paths)] paths: u64,
    incident_deg: Option<&Bound<'_, PyAny>>,
    #[pyo3(from_py_with = whole::cells)] cells: Option<[usize; 2]>,
    effects: Option<&Bound<'_, PyAny>>,
    azimuth: Option<&str>,
    #[pyo3(from_py_with = whole::seed)] seed: u64,
    look: Option<&Bound<'_, PyDict>>,
    #[pyo3(from_py_with = whole::threads)] threads: Option<usize>,
) -> PyResult<Bound<'py, PyBytes>> {
    let target = Target::Paths(paths);
    let options = Options { target, ..options(incident_deg, cells, effects, azimuth, seed)? };
    let job = Job::new(recipe, look, options, threads)?;
    let shard = watched(py, None, move |observer| {
        job.run(observer.stop, |request| snapshot::walk_shard(request, Shard { index, count }, observer))
    });
    Ok(PyBytes::new(py, &shard?.encode().map_err(failure)?))
}

#[doc = stub!("merge")]
#[pyfunction]
pub(crate) fn merge(py: Python<'_>, shards: Vec<PyBackedBytes>) -> PyResult<Table> {
    let table = py.detach(|| {
        let decoded = shards.iter().enumerate().map(|(at, bytes)| {
            let name = format!("shards[{at}]");
            let snapshot = Snapshot::decode(bytes).map_err(|why| format!("{name}: {why}"))?;
            Ok((name, snapshot))
        });
        let decoded = decoded.collect::<Result<Vec<_>, String>>()?;
        snapshot::merge(&decoded).map_err(|why| why.to_string())
    });
    Ok(Table::from(table.map_err(input)?))
}

/// What bakes and shards of bakes are told alike.
fn options(
    incident_deg: Option<&Bound<'_, PyAny>>,
    cells: Option<[usize; 2]>,
    effects: Option<&Bound<'_, PyAny>>,
    azimuth: Option<&str>,
    seed: u64,
) -> PyResult<Options> {
    let (effects, listed_azimuth) = parse_effects(effects)?;
    let azimuth = azimuth.map(parse_azimuth).transpose()?;
    if let (Some(given), Some(listed)) = (azimuth, listed_azimuth)
        && given != listed
    {
        return Err(field("effects", "its azimuth is not that of azimuth; give one of the two"));
    }
    Ok(Options {
        effects,
        azimuth: azimuth.or(listed_azimuth),
        incident_deg: incident_deg.map(|angles| row("incident_deg", angles)).transpose()?,
        cells,
        seed,
        ..Options::default()
    })
}

/// A recipe with its options, and the threads that work.
struct Job {
    recipe: bake_brdf::recipe::Recipe,
    view: View,
    options: Options,
    pool: Option<rayon::ThreadPool>,
}

impl Job {
    fn new(
        recipe: &Bound<'_, PyAny>,
        look: Option<&Bound<'_, PyDict>>,
        options: Options,
        threads: Option<usize>,
    ) -> PyResult<Self> {
        let recipe = Recipe::of(recipe)?.inner;
        let view = crate::look::view(&recipe, look, &HashMap::new())?;
        if let Some(count) = threads.filter(|count| !(1..=MOST_THREADS).contains(count)) {
            return Err(field("threads", format_args!("{count} is not valid, expected 1 to {MOST_THREADS}")));
        }
        let pool = threads.map(|count| rayon::ThreadPoolBuilder::new().num_threads(count).build());
        Ok(Self { recipe, view, options, pool: pool.transpose().map_err(failure)? })
    }

    fn run<T: Send>(
        self,
        stop: &AtomicBool,
        work: impl FnOnce(&Request) -> Result<T, BakeError> + Send,
    ) -> Result<T, BakeError> {
        let Self { recipe, view, options, pool } = self;
        let work = || {
            let (recipe, decisions) = options.decide(recipe, &view)?;
            work(&Request::of_unless(stop, recipe, decisions.set(), options)?)
        };
        match &pool {
            Some(pool) => pool.install(work),
            None => work(),
        }
    }
}

/// Works on a thread of its own, so that this one can look at signals and call `progress`; the thread ends by itself where nobody waits
/// for it any more.
pub(crate) fn watched<T: Send + 'static>(
    py: Python<'_>,
    progress: Option<&Bound<'_, PyAny>>,
    work: impl FnOnce(&Observer<'_>) -> Result<T, BakeError> + Send + 'static,
) -> PyResult<T> {
    let shared = Arc::new(Shared {
        stop: AtomicBool::new(false),
        done: AtomicU64::default(),
        outcome: Mutex::new(Outcome::Open),
        ended: Condvar::new(),
    });
    let ending = Ending(Arc::clone(&shared));
    let thread = std::thread::Builder::new().name(THREAD.to_owned());
    let spawned = thread.spawn(move || {
        let shared = &ending.0;
        let share = |progress: &Progress<'_>| {
            let share = progress.crossings() as f64 / progress.expected_crossings;
            shared.done.store(share.clamp(0.0, 1.0).to_bits(), Ordering::Relaxed);
        };
        let result = work(&Observer { stop: &shared.stop, progress: &share, ..Observer::idle() });
        *shared.outcome.lock().unwrap_or_else(PoisonError::into_inner) = Outcome::Ended(Box::new(result));
    });
    spawned.map_err(failure)?;
    wait(py, &shared, progress)
}

/// Waits for work without the interpreter's lock; takes it to look at signals and to call `progress`.
fn wait<T: Send>(py: Python<'_>, shared: &Shared<T>, progress: Option<&Bound<'_, PyAny>>) -> PyResult<T> {
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
            std::mem::replace(&mut *outcome, Outcome::Open)
        });
        match outcome {
            Outcome::Ended(result) => {
                let result = result.map_err(|why| of_bake(&why))?;
                tell(1.0)?;
                return Ok(result);
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

pub(crate) fn parse_solver(name: &str) -> PyResult<SolverChoice> {
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
