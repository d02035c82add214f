//! The Monte Carlo side of a bake: which paths are walked, by whom, and when it is enough.

use super::assemble::azimuth_width_deg;
use super::{BakeError, Bands, Observer, Progress, Request, Target};
use crate::effects::Effect;
use crate::tally::{CHUNK, Cells, Tally};
use lut_io::axis::ExitAxis;
use lut_io::measure;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use transport::walk::lanes::{Precision, Walker};
use transport::walk::{Exit, Fate};
use transport::{Geometry, Transport};

/// Paths that one task walks in one go: enough that draining the lanes at its end costs little.
const BLOCK: u64 = 8 * CHUNK;
/// Paths per incidence of the pilot that sizes the bake.
const PILOT: u64 = 2 * CHUNK;
/// Paths per incidence of an estimate that must cost next to nothing, and as many more as it takes for so many to come back: a lobe
/// of fewer hides how wide it is, and with it how many it needs.
const SCOUT_PATHS: u64 = 1024;
const SCOUTS_BACK: u64 = 400;
/// Incidences of the pilot of a forecast, and tasks of it for each thread: a last one that runs alone matters little.
const FORECAST_INCIDENCES: usize = 8;
const TASKS_A_THREAD: usize = 8;
/// Paths per incidence that say how deep a stack is.
const PROBE_PATHS: u64 = 64;
/// Longest time between two states that can be kept or stopped at.
const LONGEST_SLICE: Duration = Duration::from_millis(500);
/// Most paths per incidence: fixed-point sums have room for 1.7·10¹⁰.
pub const MAX_PATHS: u64 = 10_000_000_000;
/// A bake is sized so that its error bound is this share of what was asked for; the rest is left for the pilot's
/// own error, so that a second round is rare.
const AIM: f64 = 0.97;

/// Paths of every lobe, walked so far. A lobe is an incidence in a band: all incidences of the first band (the recipe's own
/// wavelength), then those of the next. Random numbers do not know the band: the same paths meet other indices.
#[derive(Debug)]
pub struct Sampling {
    /// One a band.
    walkers: Vec<Walker>,
    cells: Vec<Cells>,
    axis: ExitAxis,
    /// w of the decay postulate, degrees, where the recipe fixes it.
    azimuth_width_deg: Option<f64>,
    theta_i: Vec<f64>,
    /// Incidences of the table: the worst of so many keeps the promise.
    among: usize,
    seed: u64,
    event_cap: u32,
    shard: Shard,
    state: State,
    /// Solid angle per unit of extent of each cell, per lobe, as of the tallies: ones where nothing is walked yet.
    spreads: Vec<Vec<f64>>,
    started: Instant,
    /// Seconds and crossings before this process, for the rate.
    before: (f64, u64),
}

/// All that has to survive for a bake to go on where it stopped.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct State {
    /// One tally per lobe: per incidence and, with dispersion, per band.
    pub tallies: Vec<Tally>,
    /// Path numbers below this are done (or belong to other shards), per lobe.
    pub position: Vec<u64>,
    /// Where the round in progress ends, per lobe.
    pub targets: Vec<u64>,
    /// Milliseconds spent.
    pub milliseconds: u64,
}

/// Which blocks of paths a bake walks: those of shard `index` (from 1) of `count`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Shard {
    /// Number of this shard, 1 to `count`.
    pub index: u32,
    /// Shards in all.
    pub count: u32,
}

impl Shard {
    /// Everything in one bake.
    pub const WHOLE: Self = Self { index: 1, count: 1 };

    /// Blocks go round the shards, each lobe starting with the next one, so that every shard gets its share of
    /// every lobe.
    fn owns(self, lobe: usize, from: u64) -> bool {
        (from / BLOCK + lobe as u64) % u64::from(self.count) == u64::from(self.index - 1)
    }
}

/// One task: a run of path numbers of one lobe.
#[derive(Clone, Copy, Debug)]
struct Task {
    lobe: usize,
    from: u64,
    to: u64,
}

impl Sampling {
    /// Prepares the walk of each band's transport problem at `theta_i` (radians) into the cells of `axis`.
    ///
    /// # Errors
    /// The walk cannot be prepared for this stack.
    pub fn new(
        transports: &[Transport],
        geometry: Geometry,
        axis: &ExitAxis,
        azimuth_width_deg: Option<f64>,
        theta_i: &[f64],
        seed: u64,
        event_cap: u32,
        precision: Precision,
        shard: Shard,
    ) -> Result<Self, BakeError> {
        let walker = |transport| Walker::new(transport, geometry, precision, None);
        let walkers: Result<Vec<Walker>, _> = transports.iter().map(walker).collect();
        let lobes = transports.len() * theta_i.len();
        Ok(Self {
            walkers: walkers.map_err(|why| BakeError::Input(why.to_string()))?,
            cells: theta_i.iter().map(|&theta| Cells::new(axis, theta)).collect(),
            axis: *axis,
            azimuth_width_deg,
            theta_i: theta_i.to_vec(),
            among: theta_i.len(),
            seed,
            event_cap,
            shard,
            state: State {
                tallies: vec![Tally::new(axis.cells()); lobes],
                position: vec![0; lobes],
                targets: vec![0; lobes],
                milliseconds: 0,
            },
            spreads: vec![vec![1.0; axis.cells()]; lobes],
            started: Instant::now(),
            before: (0.0, 0),
        })
    }

    /// The tallies of the recipe's own wavelength, one per incidence.
    #[must_use]
    pub fn tallies(&self) -> &[Tally] {
        self.band_tallies(0)
    }

    /// The tallies of a band, one per incidence.
    pub(super) fn band_tallies(&self, band: usize) -> &[Tally] {
        &self.state.tallies[band * self.theta_i.len()..(band + 1) * self.theta_i.len()]
    }

    /// Bands times incidences.
    fn lobes(&self) -> usize {
        self.walkers.len() * self.theta_i.len()
    }

    /// Number of the incidence of a lobe.
    fn incidence_of(&self, lobe: usize) -> usize {
        lobe % self.theta_i.len()
    }

    /// What has to survive for the bake to go on later.
    #[must_use]
    pub fn state(&self) -> State {
        State { milliseconds: (1000.0 * self.seconds()) as u64, ..self.state.clone() }
    }

    /// Goes on where `state` stopped: first to the end of the round that was in progress.
    ///
    /// # Errors
    /// A state of other incidences or cells, or the observer asked to stop.
    pub fn resume(&mut self, state: State, observer: &Observer<'_>) -> Result<(), BakeError> {
        let lobes = self.lobes();
        let fits = state.tallies.len() == lobes
            && state.position.len() == lobes
            && state.targets.len() == lobes
            && state.tallies.iter().all(|tally| tally.cells() == self.tally_cells());
        if !fits {
            return Err(BakeError::Input(
                "the checkpoint holds other incidences or cells than this bake".to_owned(),
            ));
        }
        self.before = (state.milliseconds as f64 / 1000.0, state.tallies.iter().map(|t| t.crossings).sum());
        let targets = state.targets.clone();
        self.state = state;
        self.refresh_spreads();
        self.walk_to(&targets, observer)
    }

    /// Seconds spent, in this process and before it.
    fn seconds(&self) -> f64 {
        self.before.0 + self.started.elapsed().as_secs_f64()
    }

    /// Walks every incidence up to a number of paths.
    ///
    /// # Errors
    /// The observer asked to stop.
    pub fn walk_to_paths(&mut self, paths: u64, observer: &Observer<'_>) -> Result<(), BakeError> {
        // Shards skip the pilot: it would not be a whole block.
        if self.shard == Shard::WHOLE {
            self.walk_pilot(paths.min(PILOT), observer)?;
        }
        let targets = vec![paths; self.lobes()];
        (observer.forecast)(self.seconds_to(&targets));
        self.walk_to(&targets, observer)
    }

    /// Walks every lobe up to its own number of paths, band by band.
    ///
    /// # Errors
    /// The observer asked to stop.
    pub fn walk_to_each(&mut self, paths: &[u64], observer: &Observer<'_>) -> Result<(), BakeError> {
        self.walk_to(paths, observer)
    }

    /// Walks until the bound on the total variation of every incidence is at most `accuracy` (a share).
    ///
    /// Path counts are decided only from tallies at path counts decided before: a function of recipe, seed and
    /// accuracy, not of time or threads.
    ///
    /// # Errors
    /// The observer asked to stop, or the accuracy needs more than [`MAX_PATHS`].
    pub fn walk_to_accuracy(&mut self, accuracy: f64, observer: &Observer<'_>) -> Result<(), BakeError> {
        self.walk_pilot(PILOT, observer)?;
        (observer.forecast)(self.seconds_to_accuracy(accuracy));
        loop {
            let targets = self.targets_for_accuracy(accuracy);
            if let Some(&most) = targets.iter().max()
                && most > MAX_PATHS
            {
                let percent = 100.0 * accuracy;
                return Err(BakeError::Input(format!(
                    "accuracy {percent} % needs {most:.1e} paths an incidence, more than {MAX_PATHS:.1e}; ask for less, or use --solver doubling"
                )));
            }
            if targets.iter().zip(&self.state.tallies).all(|(&target, tally)| target <= tally.paths) {
                return Ok(());
            }
            self.walk_to(&targets, observer)?;
        }
    }

    /// Walks for about `budget` in all, sharing it so that every incidence ends with the same error.
    ///
    /// # Errors
    /// The observer asked to stop.
    pub fn walk_for(&mut self, budget: Duration, observer: &Observer<'_>) -> Result<(), BakeError> {
        self.walk_pilot(PILOT, observer)?;
        (observer.forecast)(budget.as_secs_f64() - self.seconds());
        // Leaves room for writing the file; slices let the measured rate correct itself.
        for slice in 0..64 {
            let left = 0.97 * budget.as_secs_f64() - self.seconds();
            if left < 0.01 * budget.as_secs_f64() {
                break;
            }
            let affordable = left * if slice == 0 { 0.3 } else { 0.7 };
            let targets = self.targets_for_seconds(affordable);
            if targets.iter().zip(&self.state.tallies).all(|(&target, tally)| target <= tally.paths) {
                break;
            }
            self.walk_to(&targets, observer)?;
        }
        Ok(())
    }

    /// What walking these lobes to `target` takes in all, from a pilot that this walks; a time is that of these lobes.
    fn forecast(&mut self, target: Target, observer: &Observer<'_>) -> Result<Forecast, BakeError> {
        let pilot = if let Target::Paths(paths) = target { paths.min(PILOT) } else { PILOT };
        self.walk_pilot(pilot, observer)?;
        let targets: Vec<u64> = match target {
            Target::AccuracyPercent(percent) => self.targets_for_accuracy(percent / 100.0),
            Target::Paths(paths) => vec![paths; self.lobes()],
            Target::Time(budget) => self.targets_for_seconds(budget.as_secs_f64()),
        };
        let crossings: Vec<f64> = self.state.tallies.iter().zip(&targets).map(crossings_of).collect();
        let seconds = if let Target::Time(budget) = target {
            budget.as_secs_f64()
        } else {
            let price = self.price(pilot, targets.iter().copied().max().unwrap_or(pilot));
            let tasks: u64 = targets.iter().map(|&paths| 1 + (paths - pilot).div_ceil(BLOCK)).sum();
            let work = price.crossing * crossings.iter().sum::<f64>() + price.task * tasks as f64;
            work / rayon::current_num_threads() as f64
        };
        Ok(Forecast {
            seconds,
            paths: targets.iter().fold(0, |sum: u64, &paths| sum.saturating_add(paths)),
            crossings: crossings.chunks(self.theta_i.len()).map(|band| band.iter().sum()).collect(),
        })
    }

    /// What a walk costs, from tasks as long as a pilot's and as long as those of the longest target: a task ends with lanes
    /// that empty, which short paths feel most.
    fn price(&self, pilot: u64, longest: u64) -> Price {
        let short = self.spent(pilot);
        let long = self.spent(longest.clamp(pilot, BLOCK));
        let rate = |(seconds, crossings): (f64, f64)| seconds / crossings.max(1.0);
        let tasks = rayon::current_num_threads() as f64;
        let crossing = (long.0 - short.0) / (long.1 - short.1);
        let task = (short.0 - crossing * short.1) / tasks;
        if crossing > 0.0 && task > 0.0 {
            Price { crossing, task }
        } else {
            Price { crossing: rate(long), task: 0.0 }
        }
    }

    /// Seconds of processors and crossings of a task of so many paths a thread, over lobes spread evenly.
    fn spent(&self, paths: u64) -> (f64, f64) {
        let threads = rayon::current_num_threads();
        let tasks = (0..threads).into_par_iter().map(|thread| {
            let lobe = (2 * thread + 1) * self.lobes() / (2 * threads);
            let before = thread_seconds();
            let tally = self.walk_task(&Task { lobe, from: 0, to: paths });
            (thread_seconds() - before, tally.crossings as f64)
        });
        tasks.reduce(|| (0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1))
    }

    /// Arithmetic that the walk uses, `f32` or `f64`.
    #[must_use]
    pub fn precision(&self) -> &'static str {
        match self.walkers[0].precision() {
            Precision::F64 => "f64",
            _ => "f32",
        }
    }

    /// Solid angle per unit of extent of each cell of one lobe.
    pub(super) fn spread(&self, lobe: usize) -> &[f64] {
        &self.spreads[lobe]
    }

    /// In the plane the solid angle of a cell follows from the decay postulate, whose w may be the tally's own standard deviation.
    fn refresh_spreads(&mut self) {
        if matches!(self.axis, ExitAxis::Space { .. }) {
            return;
        }
        self.spreads = (0..self.lobes()).into_par_iter().map(|lobe| self.plane_spread(lobe)).collect();
    }

    fn plane_spread(&self, lobe: usize) -> Vec<f64> {
        let tally = &self.state.tallies[lobe];
        if tally.paths == 0 {
            return vec![1.0; tally.cells()];
        }
        let theta_i = self.theta_i[self.incidence_of(lobe)];
        let sd = tally.moments(theta_i).sd.to_degrees();
        let width = azimuth_width_deg(self.azimuth_width_deg, sd).to_radians();
        let weights = measure::reading_weights(&self.axis, theta_i, width);
        weights.iter().zip(measure::cell_extents(&self.axis, theta_i)).map(|(w, extent)| w / extent).collect()
    }

    /// Bound on the total variation of every incidence, for extrapolation ([`Tally::total_variation_bound`]).
    pub(super) fn bounds(&self) -> Vec<f64> {
        let tallies = self.state.tallies.iter().enumerate();
        tallies.map(|(i, tally)| tally.total_variation_quantile(self.spread(i), self.among)).collect()
    }

    /// Paths of every incidence at which its bound reaches `accuracy`.
    fn targets_for_accuracy(&self, accuracy: f64) -> Vec<u64> {
        let tallies = self.state.tallies.iter().zip(self.bounds());
        tallies.map(|(tally, bound)| paths_for(tally.paths, bound, accuracy)).collect()
    }

    /// Seconds that walking to `accuracy` will still take, from the rate so far.
    fn seconds_to_accuracy(&self, accuracy: f64) -> f64 {
        self.seconds_to(&self.targets_for_accuracy(accuracy))
    }

    /// Walks the pilot that every decision and prediction starts from.
    fn walk_pilot(&mut self, paths: u64, observer: &Observer<'_>) -> Result<(), BakeError> {
        if self.state.position.iter().any(|&position| position > 0) {
            return Ok(()); // resumed
        }
        let targets = vec![paths; self.lobes()];
        self.walk_to(&targets, observer)
    }

    /// The first scouts: a few paths.
    fn walk_scouts(&mut self) -> Result<(), BakeError> {
        let lobes = 0..self.lobes();
        let tasks: Vec<Task> = lobes.map(|lobe| Task { lobe, from: 0, to: SCOUT_PATHS }).collect();
        self.walk_slice(&tasks, 0.0, &self.spreads.clone(), &Observer::idle())
    }

    /// More of them, up to a pilot's, where few came back.
    fn walk_more_scouts(&mut self) -> Result<(), BakeError> {
        let more = self.state.tallies.iter().enumerate().map(|(lobe, tally)| {
            let times = SCOUTS_BACK.div_ceil(tally.reflected_paths().max(1));
            Task { lobe, from: SCOUT_PATHS, to: (times * SCOUT_PATHS).min(PILOT) }
        });
        let tasks: Vec<Task> = more.filter(|task| task.to > task.from).collect();
        self.walk_slice(&tasks, 0.0, &self.spreads.clone(), &Observer::idle())?;
        self.refresh_spreads();
        Ok(())
    }

    /// What a walk to `accuracy` has to do, from the paths walked so far at some of `among` incidences.
    fn effort(&self, accuracy: f64) -> Effort {
        let share = self.among as f64 / self.theta_i.len() as f64;
        let mut effort = Effort { crossings: 0.0, paths: 0.0 };
        for (tally, target) in self.state.tallies.iter().zip(self.targets_for_accuracy(accuracy)) {
            let paths = share * target.max(PILOT) as f64;
            effort.paths += paths;
            effort.crossings += paths * tally.crossings as f64 / tally.paths as f64;
        }
        effort
    }

    fn crossings(&self) -> u64 {
        self.state.tallies.iter().map(|tally| tally.crossings).sum()
    }

    fn crossings_to(&self, targets: &[u64]) -> f64 {
        let incidences = self.state.tallies.iter().zip(&self.state.position).zip(targets);
        let each = incidences.map(|((tally, &position), &target)| {
            target.saturating_sub(position) as f64 * tally.crossings as f64 / tally.paths.max(1) as f64
        });
        each.sum::<f64>() / f64::from(self.shard.count)
    }

    fn seconds_to(&self, targets: &[u64]) -> f64 {
        let rate = self.crossings() as f64 / self.seconds();
        if rate > 0.0 { self.crossings_to(targets) / rate } else { 0.0 }
    }

    /// Paths proportional to (error·√paths)² that take `seconds` more.
    fn targets_for_seconds(&self, seconds: f64) -> Vec<u64> {
        let tallies = self.state.tallies.iter();
        let needs: Vec<f64> =
            tallies.zip(self.bounds()).map(|(tally, bound)| bound.powi(2) * tally.paths as f64).collect();
        let scaled = |factor: f64| -> Vec<u64> {
            let target = |(need, tally): (&f64, &Tally)| {
                let chunks = (factor * need / CHUNK as f64).min(MAX_PATHS as f64 / CHUNK as f64) as u64;
                (chunks * CHUNK).max(tally.paths)
            };
            needs.iter().zip(&self.state.tallies).map(target).collect()
        };
        // seconds_to is monotonic in the factor: bisect on its logarithm.
        let (mut lo, mut hi) = (0.0_f64, 60.0_f64);
        for _ in 0..60 {
            let middle = 0.5 * (lo + hi);
            if self.seconds_to(&scaled(middle.exp())) > seconds { hi = middle } else { lo = middle }
        }
        scaled(lo.exp())
    }

    /// Walks every incidence to its target, in slices after which the state is whole and can be kept.
    fn walk_to(&mut self, targets: &[u64], observer: &Observer<'_>) -> Result<(), BakeError> {
        let mut tasks = Vec::new();
        for (lobe, (&position, &target)) in self.state.position.iter().zip(targets).enumerate() {
            // A chunk is never split between two rounds: its sums are rounded once.
            debug_assert!(position >= target || position.is_multiple_of(CHUNK));
            let mut from = position;
            while from < target {
                let to = target.min((from / BLOCK + 1) * BLOCK);
                if self.shard.owns(lobe, from) {
                    tasks.push(Task { lobe, from, to });
                }
                from = to;
            }
        }
        self.state.targets = targets.to_vec();
        let spreads = self.spreads.clone();
        let expected = self.crossings() as f64 + self.crossings_to(targets);
        let mut kept = Instant::now();
        let mut left = tasks.as_slice();
        let due = observer.checkpoint.as_ref().map_or(LONGEST_SLICE, |checkpoint| checkpoint.every);
        while !left.is_empty() {
            let (slice, rest) = left.split_at(left.len().min(self.tasks_per_slice(due.min(LONGEST_SLICE))));
            self.walk_slice(slice, expected, &spreads, observer)?;
            left = rest;
            if let Some(checkpoint) = &observer.checkpoint
                && kept.elapsed() >= checkpoint.every
            {
                (checkpoint.keep)(&self.state());
                kept = Instant::now();
            }
        }
        for (position, &target) in self.state.position.iter_mut().zip(targets) {
            *position = (*position).max(target);
        }
        if !tasks.is_empty() {
            self.refresh_spreads();
        }
        Ok(())
    }

    /// About `time`'s worth of blocks; a few for every thread, so that none waits long at the end of a slice.
    fn tasks_per_slice(&self, time: Duration) -> usize {
        let paths: u64 = self.state.tallies.iter().map(|tally| tally.paths).sum();
        let walked = self.crossings().saturating_sub(self.before.1) as f64;
        let paths_per_second =
            paths as f64 * walked / self.crossings().max(1) as f64 / self.started.elapsed().as_secs_f64();
        ((time.as_secs_f64() * paths_per_second / BLOCK as f64) as usize)
            .max(8 * rayon::current_num_threads())
    }

    /// Walks a slice of tasks whole; if it is interrupted the state stays as it was before the slice.
    fn walk_slice(
        &mut self,
        slice: &[Task],
        expected: f64,
        spreads: &[Vec<f64>],
        observer: &Observer<'_>,
    ) -> Result<(), BakeError> {
        let walked = Mutex::new(self.state.tallies.clone());
        slice.par_iter().try_for_each(|task| {
            if observer.stop.load(Ordering::Relaxed) {
                return Err(BakeError::Interrupted);
            }
            let tally = self.walk_task(task);
            let mut tallies = walked.lock().unwrap_or_else(PoisonError::into_inner);
            tallies[task.lobe].add(&tally);
            (observer.progress)(&Progress {
                tallies: &tallies,
                incidences: self.among,
                spreads,
                expected_crossings: expected,
            });
            Ok(())
        })?;
        self.state.tallies = walked.into_inner().unwrap_or_else(PoisonError::into_inner);
        for task in slice {
            self.state.position[task.lobe] = task.to;
        }
        Ok(())
    }

    fn walk_task(&self, task: &Task) -> Tally {
        let incidence = self.incidence_of(task.lobe);
        let cells = &self.cells[incidence];
        let empty = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };
        let mut exits = vec![empty; (task.to - task.from) as usize];
        let theta_i = self.theta_i[incidence];
        let walker = &self.walkers[task.lobe / self.theta_i.len()];
        let mut tally = Tally::new(self.tally_cells());
        tally.crossings = walker.run(theta_i, self.seed, task.from..task.to, self.event_cap, &mut exits);
        for chunk in exits.chunks(CHUNK as usize) {
            tally.add_chunk(cells, chunk);
        }
        tally
    }

    fn tally_cells(&self) -> usize {
        self.cells.first().map_or(0, Cells::count)
    }
}

/// Paths, a multiple of [`CHUNK`], at which the bound on the total variation reaches `accuracy`.
fn paths_for(paths: u64, bound: f64, accuracy: f64) -> u64 {
    if bound <= accuracy {
        return paths;
    }
    let factor = (bound / (AIM * accuracy)).powi(2);
    let chunks = (paths as f64 * factor / CHUNK as f64).ceil();
    // Casts of floats saturate.
    (chunks as u64).saturating_mul(CHUNK)
}

/// Crossings of so many paths, at the rate of those tallied.
fn crossings_of((tally, &paths): (&Tally, &u64)) -> f64 {
    paths as f64 * tally.crossings as f64 / tally.paths.max(1) as f64
}

/// Seconds of one core, whatever else the machine does.
struct Price {
    crossing: f64,
    /// A task, beside its crossings.
    task: f64,
}

/// Seconds that this thread has spent on a processor: other work on the machine does not count. By the clock where the system
/// does not say.
fn thread_seconds() -> f64 {
    #[cfg(unix)]
    {
        let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
        time.tv_sec as f64 + 1e-9 * time.tv_nsec as f64
    }
    #[cfg(not(unix))]
    {
        static START: std::sync::LazyLock<Instant> = std::sync::LazyLock::new(Instant::now);
        START.elapsed().as_secs_f64()
    }
}

/// What a walk is expected to take.
pub(super) struct Forecast {
    /// Seconds by the clock, with the threads in use.
    pub(super) seconds: f64,
    /// Paths over all lobes.
    pub(super) paths: u64,
    /// Facets met, by band.
    pub(super) crossings: Vec<f64>,
}

/// What the walk of a request takes, from a pilot of every band at [`FORECAST_INCIDENCES`] incidences, more where that leaves
/// threads without a task.
pub(super) fn forecast(
    request: &Request,
    bands: &Bands,
    observer: &Observer<'_>,
) -> Result<Forecast, BakeError> {
    let angles = &request.incident_deg;
    let busy = (TASKS_A_THREAD * rayon::current_num_threads()).div_ceil(bands.all_nm().count());
    let few = spread_out(angles, busy.max(FORECAST_INCIDENCES));
    let share = angles.len() as f64 / few.len() as f64;
    let piloted = Request { incident_deg: few, ..request.clone() };
    let (mut sampling, _) = piloted.sampling(bands, Shard::WHOLE)?;
    sampling.among = angles.len();
    let target = match request.target {
        Target::Time(budget) => Target::Time(budget.div_f64(share)),
        target => target,
    };
    let few = sampling.forecast(target, observer)?;
    Ok(Forecast {
        seconds: share * few.seconds,
        paths: (share * few.paths as f64).round() as u64,
        crossings: few.crossings.iter().map(|crossings| share * crossings).collect(),
    })
}

/// What a walk has to do in all.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Effort {
    /// Facets met.
    pub(super) crossings: f64,
    /// Paths.
    pub(super) paths: f64,
}

/// What a walk to `accuracy` (a share) has to do at the recipe's own wavelength, from a few thousand paths at up to `scouts`
/// incidences: counts of seeded paths, so the same anywhere; good to about a quarter, and done in milliseconds. To a factor of
/// a few, and done sooner, where `enough` says that this will do.
pub(super) fn scout(
    request: &Request,
    accuracy: f64,
    scouts: usize,
    enough: impl Fn(Effort) -> bool,
) -> Result<Effort, BakeError> {
    let few = spread_out(&request.incident_deg, scouts);
    let effects = request.effects.without(Effect::Dispersion);
    let scouted = Request { incident_deg: few, effects, ..request.clone() };
    let (mut sampling, _) = scouted.sampling(&Bands::own(&request.recipe), Shard::WHOLE)?;
    sampling.among = request.incident_deg.len();
    sampling.walk_scouts()?;
    let rough = sampling.effort(accuracy);
    if enough(rough) {
        return Ok(rough);
    }
    sampling.walk_more_scouts()?;
    Ok(sampling.effort(accuracy))
}

/// What a walk to any accuracy at least has to do: its pilot. With one crossing a path, or half of the crossings that a few
/// dozen paths have at up to `probed` incidences, which says enough of stacks so deep that a thousand paths take seconds.
pub(super) fn least_effort(request: &Request, probed: Option<usize>) -> Result<Effort, BakeError> {
    let paths = (PILOT * request.incident_deg.len() as u64) as f64;
    let Some(scouts) = probed else {
        return Ok(Effort { crossings: paths, paths });
    };
    let effects = request.effects.without(Effect::Dispersion);
    let few = Request { incident_deg: spread_out(&request.incident_deg, scouts), effects, ..request.clone() };
    let (mut sampling, _) = few.sampling(&Bands::own(&request.recipe), Shard::WHOLE)?;
    let lobes = sampling.lobes();
    let tasks: Vec<Task> = (0..lobes).map(|lobe| Task { lobe, from: 0, to: PROBE_PATHS }).collect();
    sampling.walk_slice(&tasks, 0.0, &sampling.spreads.clone(), &Observer::idle())?;
    let each = sampling.crossings() as f64 / (PROBE_PATHS * lobes as u64) as f64;
    Ok(Effort { crossings: (0.5 * each).max(1.0) * paths, paths })
}

/// At most `count` of the angles: the middles of as many parts of the list.
fn spread_out(angles: &[f64], count: usize) -> Vec<f64> {
    let count = count.clamp(1, angles.len());
    (0..count).map(|part| angles[(2 * part + 1) * angles.len() / (2 * count)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recipe::{AzimuthMode, Recipe};

    /// The choice takes a rough effort only where ten times as much would choose alike.
    #[test]
    fn the_first_scouts_know_the_effort_to_a_factor_of_three() {
        for (layers, sigma_deg) in [(2, 0.9), (12, 0.6), (60, 1.5), (500, 3.0)] {
            let text = format!(
                r#"{{"schema": "pearl-recipe/1", "stack": {{"layers": {layers}}}, "facets": {{"slope_sd_deg": {sigma_deg}}}}}"#
            );
            for mode in [AzimuthMode::Decay, AzimuthMode::Space] {
                let mut recipe = Recipe::from_json(&text).unwrap();
                recipe.azimuth.mode = mode;
                let request = Request {
                    incident_deg: vec![30.0],
                    ..Request::new(recipe, Target::AccuracyPercent(2.0))
                };
                let crossings = |enough: bool| scout(&request, 0.02, 1, |_| enough).unwrap().crossings;
                let ratio = crossings(true) / crossings(false);
                assert!(
                    (1.0 / 3.0..3.0).contains(&ratio),
                    "{layers} layers, {sigma_deg}°, {mode:?}: {ratio}"
                );
            }
        }
    }

    /// Four threads a core that only spin leave a clock a fifth of the processor; ones that share a core slow each other
    /// by less than two.
    #[test]
    fn other_work_on_the_machine_does_not_change_a_forecast() {
        let recipe = Recipe::from_json(r#"{"schema": "pearl-recipe/1", "stack": {"layers": 20}}"#).unwrap();
        let request =
            Request { incident_deg: vec![0.0, 30.0, 60.0], ..Request::new(recipe, Target::Paths(200_000)) };
        let bands = Bands::own(&request.recipe);
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        let least = || {
            let seconds = || pool.install(|| forecast(&request, &bands, &Observer::idle()).unwrap().seconds);
            (0..3).map(|_| seconds()).fold(f64::INFINITY, f64::min)
        };
        let alone = least();
        let ends = std::sync::atomic::AtomicBool::new(false);
        let among_others = std::thread::scope(|scope| {
            for _ in 0..4 * std::thread::available_parallelism().map_or(1, usize::from) {
                scope.spawn(|| {
                    while !ends.load(Ordering::Relaxed) {
                        std::hint::spin_loop();
                    }
                });
            }
            let seconds = least();
            ends.store(true, Ordering::Relaxed);
            seconds
        });
        assert!((0.5..2.0).contains(&(among_others / alone)), "{alone} s, {among_others} s among others");
    }
}
