//! The Monte Carlo side of a bake: paths walked in tasks into tallies. How many are enough is decided in `effort`.

use super::{BakeError, Bands, Observer, Progress, Request};
use crate::recipe::Azimuth;
use crate::tally::{CHUNK, Cells, Tally};
use lut_io::axis::ExitAxis;
use lut_io::measure;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};
use transport::walk::lanes::{Precision, Walker};
use transport::walk::{Exit, Fate};

/// Paths that one task walks in one go: enough that draining the lanes at its end costs little.
pub(super) const BLOCK: u64 = 8 * CHUNK;
/// Longest time between two states that can be kept or stopped at.
const LONGEST_SLICE: Duration = Duration::from_millis(500);

/// Paths of every lobe, walked so far. A lobe is an incidence in a band: all incidences of the first band (the recipe's own
/// wavelength), then those of the next. Random numbers do not know the band: the same paths meet other indices.
#[derive(Debug)]
pub(crate) struct Sampling {
    /// One a band.
    walkers: Vec<Walker>,
    cells: Vec<Cells>,
    axis: ExitAxis,
    azimuth: Azimuth,
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
pub(super) struct Task {
    pub(super) lobe: usize,
    pub(super) from: u64,
    pub(super) to: u64,
}

impl Sampling {
    /// Prepares the walk of a request at its bands.
    ///
    /// # Errors
    /// A bad request, or a stack that cannot be walked.
    pub(crate) fn of(request: &Request, bands: &Bands, shard: Shard) -> Result<Self, BakeError> {
        let options = &request.options;
        options.check()?;
        let transports = bands.transports(request)?;
        let walker = |transport| Walker::new(transport, request.geometry(), options.precision, None);
        let walkers: Result<Vec<Walker>, _> = transports.iter().map(walker).collect();
        let axis = request.exit_axis();
        let theta_i = request.theta_i();
        let lobes = transports.len() * theta_i.len();
        Ok(Self {
            walkers: walkers.map_err(|why| BakeError::Input(why.to_string()))?,
            cells: theta_i.iter().map(|&theta| Cells::new(&axis, theta)).collect(),
            axis,
            azimuth: request.recipe.azimuth,
            among: theta_i.len(),
            theta_i,
            seed: options.seed,
            event_cap: options.event_cap,
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

    /// Counts these incidences as some of so many: the worst of all of them keeps the promise.
    pub(super) const fn set_among(&mut self, incidences: usize) {
        self.among = incidences;
    }

    /// Incidences of the table, of which these may be some.
    pub(super) const fn among(&self) -> usize {
        self.among
    }

    /// The exit cells.
    pub(super) const fn axis(&self) -> &ExitAxis {
        &self.axis
    }

    /// Incidences that are walked.
    pub(super) const fn incidences(&self) -> usize {
        self.theta_i.len()
    }

    /// The tallies of all lobes.
    pub(super) fn lobe_tallies(&self) -> &[Tally] {
        &self.state.tallies
    }

    /// Whether this is a whole bake, and not a shard of one.
    pub(super) fn is_whole(&self) -> bool {
        self.shard == Shard::WHOLE
    }

    /// Whether a round of paths is behind it.
    pub(super) fn has_begun(&self) -> bool {
        self.state.position.iter().any(|&position| position > 0)
    }

    /// The tallies of the recipe's own wavelength, one per incidence.
    pub(crate) fn tallies(&self) -> &[Tally] {
        self.band_tallies(0)
    }

    /// The tallies of a band, one per incidence.
    pub(super) fn band_tallies(&self, band: usize) -> &[Tally] {
        &self.state.tallies[band * self.theta_i.len()..(band + 1) * self.theta_i.len()]
    }

    /// Bands times incidences.
    pub(super) fn lobes(&self) -> usize {
        self.walkers.len() * self.theta_i.len()
    }

    /// Number of the incidence of a lobe.
    fn incidence_of(&self, lobe: usize) -> usize {
        lobe % self.theta_i.len()
    }

    /// What has to survive for the bake to go on later.
    pub(crate) fn state(&self) -> State {
        State { milliseconds: (1000.0 * self.seconds()) as u64, ..self.state.clone() }
    }

    /// Goes on where `state` stopped: first to the end of the round that was in progress.
    ///
    /// # Errors
    /// A state of other incidences or cells, or the observer asked to stop.
    pub(crate) fn resume(&mut self, state: State, observer: &Observer<'_>) -> Result<(), BakeError> {
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
    pub(super) fn seconds(&self) -> f64 {
        self.before.0 + self.started.elapsed().as_secs_f64()
    }

    /// Arithmetic that the walk uses, `f32` or `f64`.
    pub(crate) fn precision(&self) -> lut_io::solver::Precision {
        match self.walkers[0].precision() {
            Precision::F64 => lut_io::solver::Precision::F64,
            _ => lut_io::solver::Precision::F32,
        }
    }

    /// Solid angle per unit of extent of each cell of one lobe.
    pub(super) fn spread(&self, lobe: usize) -> &[f64] {
        &self.spreads[lobe]
    }

    /// In the plane the solid angle of a cell follows from the decay postulate, whose w may be the tally's own standard deviation.
    pub(super) fn refresh_spreads(&mut self) {
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
        let width = self.azimuth.decay_width_deg(sd).to_radians();
        let weights = measure::reading_weights(&self.axis, theta_i, width);
        weights.iter().zip(measure::cell_extents(&self.axis, theta_i)).map(|(w, extent)| w / extent).collect()
    }

    pub(super) fn crossings(&self) -> u64 {
        self.state.tallies.iter().map(|tally| tally.crossings).sum()
    }

    fn crossings_to(&self, targets: &[u64]) -> f64 {
        let incidences = self.state.tallies.iter().zip(&self.state.position).zip(targets);
        let each = incidences.map(|((tally, &position), &target)| {
            target.saturating_sub(position) as f64 * tally.crossings as f64 / tally.paths.max(1) as f64
        });
        each.sum::<f64>() / f64::from(self.shard.count)
    }

    /// Seconds that walking on to `targets` takes, at the rate so far.
    pub(super) fn seconds_to(&self, targets: &[u64]) -> f64 {
        let rate = self.crossings() as f64 / self.seconds();
        if rate > 0.0 { self.crossings_to(targets) / rate } else { 0.0 }
    }

    /// Walks every lobe up to its own number of paths, in slices after which the state is whole and can be kept.
    ///
    /// # Errors
    /// The observer asked to stop.
    pub(super) fn walk_to(&mut self, targets: &[u64], observer: &Observer<'_>) -> Result<(), BakeError> {
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
            observer.go_on()?;
            let tally = self.walk_task(task);
            let mut tallies = walked.lock().unwrap_or_else(PoisonError::into_inner);
            tallies[task.lobe].add(&tally);
            (observer.progress)(&Progress {
                tallies: &tallies,
                incidences: self.among,
                spreads,
                expected_crossings: expected,
            });
            Ok::<_, BakeError>(())
        })?;
        self.state.tallies = walked.into_inner().unwrap_or_else(PoisonError::into_inner);
        for task in slice {
            self.state.position[task.lobe] = task.to;
        }
        Ok(())
    }

    /// Walks tasks beside the rounds, unobserved: paths that only say what is to be expected.
    pub(super) fn walk_apart(&mut self, tasks: &[Task]) -> Result<(), BakeError> {
        self.walk_slice(tasks, 0.0, &self.spreads.clone(), &Observer::idle())
    }

    /// The tally of one task.
    pub(super) fn walk_task(&self, task: &Task) -> Tally {
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
