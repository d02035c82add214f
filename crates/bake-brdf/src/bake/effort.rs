//! How many paths a walk takes: for an accuracy, in a time, and what that costs before it is done.

use super::grid::reading_shares;
use super::sampling::{BLOCK, Sampling, Shard, Task};
use super::{BakeError, Bands, Observer, Request};
use crate::options::{OptionError, Target};
use crate::tally::{CHUNK, MAX_PATHS, Tally};
use rayon::prelude::*;
use std::time::Duration;

/// Paths per incidence of the pilot that sizes the bake.
const PILOT: u64 = 2 * CHUNK;
/// Paths per incidence of an estimate that must cost next to nothing, and as many more as it takes for so many to come back: a lobe
/// of fewer hides how wide it is, and with it how many it needs.
const SCOUT_PATHS: u64 = 2048;
const SCOUTS_BACK: u64 = 400;
/// Incidences of the pilot of a forecast, and tasks of it for each thread: a last one that runs alone matters little.
const FORECAST_INCIDENCES: usize = 8;
const TASKS_A_THREAD: usize = 8;
/// Crossings of that pilot at most: of stacks so deep that its paths would take minutes there are fewer, at [`DEEP_INCIDENCES`], since
/// each of them waits for its longest path.
const FORECAST_CROSSINGS: f64 = 3e8;
const DEEP_INCIDENCES: usize = 2;
/// Paths per incidence that say how deep a stack is.
const PROBE_PATHS: u64 = 64;
/// A bake is sized so that its error bound is this share of the accuracy; the rest is left for the pilot's own error, so that a
/// second round is rare.
const AIM: f64 = 0.97;

impl Sampling {
    /// Share of the accuracy asked for that noise may take: with what reading between cells misses, added in the square, the whole.
    fn noise_share(&self) -> f64 {
        let [_, cells] = reading_shares(self.axis());
        (1.0 - cells * cells).sqrt()
    }

    /// Walks every incidence up to a number of paths.
    ///
    /// # Errors
    /// The observer asked to stop.
    pub(crate) fn walk_to_paths(&mut self, paths: u64, observer: &Observer<'_>) -> Result<(), BakeError> {
        // Shards skip the pilot: it would not be a whole block.
        if self.is_whole() {
            self.walk_pilot(paths.min(PILOT), observer)?;
        }
        let targets = vec![paths; self.lobes()];
        (observer.forecast)(self.seconds_to(&targets));
        self.walk_to(&targets, observer)
    }

    /// Walks until the bound on the total variation of every incidence is at most `percent`.
    ///
    /// Path counts are decided only from tallies at path counts decided before: a function of recipe, seed and
    /// accuracy, not of time or threads.
    ///
    /// # Errors
    /// The observer asked to stop, or the accuracy needs more than [`MAX_PATHS`].
    pub(super) fn walk_to_accuracy(
        &mut self,
        percent: f64,
        observer: &Observer<'_>,
    ) -> Result<(), BakeError> {
        let accuracy = self.noise_share() * percent / 100.0;
        self.walk_pilot(PILOT, observer)?;
        let mut targets = self.targets_for_accuracy(accuracy);
        (observer.forecast)(self.seconds_to(&targets));
        loop {
            if let Some(&most) = targets.iter().max()
                && most > MAX_PATHS
            {
                let why = format!(
                    "{percent} % needs {most:.1e} paths an incidence, more than {MAX_PATHS:.1e}; expected less accuracy, or solver doubling"
                );
                return Err(OptionError::new("accuracy", why).into());
            }
            if self.have_reached(&targets) {
                return Ok(());
            }
            self.walk_to(&targets, observer)?;
            targets = self.targets_for_accuracy(accuracy);
        }
    }

    /// Walks for about `budget` in all, sharing it so that every incidence ends with the same error.
    ///
    /// # Errors
    /// The observer asked to stop.
    pub(super) fn walk_for(&mut self, budget: Duration, observer: &Observer<'_>) -> Result<(), BakeError> {
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
            if self.have_reached(&targets) {
                break;
            }
            self.walk_to(&targets, observer)?;
        }
        Ok(())
    }

    fn have_reached(&self, targets: &[u64]) -> bool {
        targets.iter().zip(self.lobe_tallies()).all(|(&target, tally)| target <= tally.paths)
    }

    /// What walking these lobes to `target` takes in all, from a pilot that this walks, of `affordable` paths in all at most; a time is
    /// that of these lobes.
    fn forecast(
        &mut self,
        target: Target,
        affordable: u64,
        observer: &Observer<'_>,
    ) -> Result<Forecast, BakeError> {
        let pilot = if let Target::Paths(paths) = target { paths.min(PILOT) } else { PILOT };
        let pilot = pilot.min((affordable / self.lobes() as u64).max(PROBE_PATHS));
        self.walk_pilot(pilot, observer)?;
        let targets: Vec<u64> = match target {
            Target::AccuracyPercent(percent) => {
                self.targets_for_accuracy(self.noise_share() * percent / 100.0)
            }
            Target::Paths(paths) => vec![paths; self.lobes()],
            Target::Time(budget) => self.targets_for_seconds(budget.as_secs_f64()),
        };
        let crossings: Vec<f64> = self.lobe_tallies().iter().zip(&targets).map(crossings_of).collect();
        let seconds = if let Target::Time(budget) = target {
            budget.as_secs_f64()
        } else {
            let each_thread = affordable / rayon::current_num_threads() as u64;
            let longest = targets.iter().copied().max().unwrap_or(pilot).min(each_thread);
            let price = self.price(pilot, longest.clamp(pilot, BLOCK));
            let tasks: u64 = targets.iter().map(|&paths| 1 + (paths - pilot).div_ceil(BLOCK)).sum();
            let work = price.crossing * crossings.iter().sum::<f64>() + price.task * tasks as f64;
            work / rayon::current_num_threads() as f64
        };
        Ok(Forecast {
            seconds,
            paths: targets.iter().fold(0, |sum: u64, &paths| sum.saturating_add(paths)),
            crossings: crossings.chunks(self.incidences()).map(|band| band.iter().sum()).collect(),
        })
    }

    /// What a walk costs, from tasks as long as a pilot's and longer ones: a task ends with lanes that empty, which short paths feel
    /// most.
    fn price(&self, pilot: u64, longer: u64) -> Price {
        let short = self.spent(pilot);
        let long = if longer > pilot { self.spent(longer) } else { short };
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

    /// Bound on the total variation of every incidence, for extrapolation ([`Tally::total_variation_bound`]).
    fn bounds(&self) -> Vec<f64> {
        let tallies = self.lobe_tallies().iter().enumerate();
        tallies.map(|(i, tally)| tally.total_variation_quantile(self.spread(i), self.among())).collect()
    }

    /// Paths of every incidence at which its bound reaches `accuracy`.
    fn targets_for_accuracy(&self, accuracy: f64) -> Vec<u64> {
        let tallies = self.lobe_tallies().iter().zip(self.bounds());
        tallies.map(|(tally, bound)| paths_for(tally.paths, bound, accuracy)).collect()
    }

    /// Walks the pilot that every decision and prediction starts from.
    fn walk_pilot(&mut self, paths: u64, observer: &Observer<'_>) -> Result<(), BakeError> {
        if self.has_begun() {
            return Ok(()); // resumed
        }
        let targets = vec![paths; self.lobes()];
        self.walk_to(&targets, observer)
    }

    /// The first scouts: a few paths.
    fn walk_scouts(&mut self) -> Result<(), BakeError> {
        let lobes = 0..self.lobes();
        let tasks: Vec<Task> = lobes.map(|lobe| Task { lobe, from: 0, to: SCOUT_PATHS }).collect();
        self.walk_apart(&tasks)
    }

    /// More of them, up to a pilot's, where few came back.
    fn walk_more_scouts(&mut self) -> Result<(), BakeError> {
        let more = self.lobe_tallies().iter().enumerate().map(|(lobe, tally)| {
            let times = SCOUTS_BACK.div_ceil(tally.reflected_paths().max(1));
            Task { lobe, from: SCOUT_PATHS, to: (times * SCOUT_PATHS).min(PILOT) }
        });
        let tasks: Vec<Task> = more.filter(|task| task.to > task.from).collect();
        self.walk_apart(&tasks)?;
        self.refresh_spreads();
        Ok(())
    }

    /// What a walk to `accuracy` has to do, from the paths walked so far at some of `among` incidences.
    fn effort(&self, accuracy: f64) -> Effort {
        let share = self.among() as f64 / self.incidences() as f64;
        let mut effort = Effort { crossings: 0.0, paths: 0.0 };
        let targets = self.targets_for_accuracy(self.noise_share() * accuracy);
        for (tally, target) in self.lobe_tallies().iter().zip(targets) {
            let paths = share * target.max(PILOT) as f64;
            effort.paths += paths;
            effort.crossings += paths * tally.crossings as f64 / tally.paths as f64;
        }
        effort
    }

    /// Paths proportional to (error·√paths)² that take `seconds` more.
    fn targets_for_seconds(&self, seconds: f64) -> Vec<u64> {
        let tallies = self.lobe_tallies().iter();
        let needs: Vec<f64> =
            tallies.zip(self.bounds()).map(|(tally, bound)| bound.powi(2) * tally.paths as f64).collect();
        let scaled = |factor: f64| -> Vec<u64> {
            let target = |(need, tally): (&f64, &Tally)| {
                let chunks = (factor * need / CHUNK as f64).min(MAX_PATHS as f64 / CHUNK as f64) as u64;
                (chunks * CHUNK).max(tally.paths)
            };
            needs.iter().zip(self.lobe_tallies()).map(target).collect()
        };
        // seconds_to is monotonic in the factor: bisect on its logarithm.
        let (mut lo, mut hi) = (0.0_f64, 60.0_f64);
        for _ in 0..60 {
            let middle = 0.5 * (lo + hi);
            if self.seconds_to(&scaled(middle.exp())) > seconds { hi = middle } else { lo = middle }
        }
        scaled(lo.exp())
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
        static START: std::sync::LazyLock<std::time::Instant> =
            std::sync::LazyLock::new(std::time::Instant::now);
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
    let affordable = FORECAST_CROSSINGS / crossings_a_path(request, bands, DEEP_INCIDENCES)?;
    let busy = (TASKS_A_THREAD * rayon::current_num_threads()).div_ceil(bands.all_nm().count());
    let mut sampling = at_some(request, bands, busy.max(FORECAST_INCIDENCES))?;
    if affordable < (PILOT * sampling.lobes() as u64) as f64 {
        sampling = at_some(request, bands, DEEP_INCIDENCES)?;
    }
    let share = sampling.among() as f64 / sampling.incidences() as f64;
    let target = match request.options.target {
        Target::Time(budget) => Target::Time(budget.div_f64(share)),
        target => target,
    };
    let few = sampling.forecast(target, affordable as u64, observer)?;
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
    let mut sampling = at_some(request, &Bands::own(&request.recipe), scouts)?;
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
    let paths = (PILOT * request.grid.incident_deg.len() as u64) as f64;
    let Some(scouts) = probed else {
        return Ok(Effort { crossings: paths, paths });
    };
    let each = crossings_a_path(request, &Bands::own(&request.recipe), scouts)?;
    Ok(Effort { crossings: (0.5 * each).max(1.0) * paths, paths })
}

/// Crossings a path has, from a few dozen at up to `count` incidences; at least 1.
fn crossings_a_path(request: &Request, bands: &Bands, count: usize) -> Result<f64, BakeError> {
    let mut sampling = at_some(request, bands, count)?;
    let lobes = sampling.lobes();
    let tasks: Vec<Task> = (0..lobes).map(|lobe| Task { lobe, from: 0, to: PROBE_PATHS }).collect();
    sampling.walk_apart(&tasks)?;
    Ok((sampling.crossings() as f64 / (PROBE_PATHS * lobes as u64) as f64).max(1.0))
}

/// The walk of a request at `count` of its incidences at most.
fn at_some(request: &Request, bands: &Bands, count: usize) -> Result<Sampling, BakeError> {
    let angles = &request.grid.incident_deg;
    let request = request.at_incidences(spread_out(angles, count));
    let mut sampling = Sampling::of(&request, bands, Shard::WHOLE)?;
    sampling.set_among(angles.len());
    Ok(sampling)
}

/// At most `count` of the angles: the middles of as many parts of the list.
fn spread_out(angles: &[f64], count: usize) -> Vec<f64> {
    let count = count.clamp(1, angles.len());
    (0..count).map(|part| angles[(2 * part + 1) * angles.len() / (2 * count)]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::Options;
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
                let cells = Some([96, 32]);
                let options = Options { incident_deg: Some(vec![30.0]), cells, ..Options::default() };
                let request = Request::new(recipe, options).unwrap();
                let crossings = |enough: bool| scout(&request, 0.02, 1, |_| enough).unwrap().crossings;
                let ratio = crossings(true) / crossings(false);
                assert!(
                    (1.0 / 3.0..3.0).contains(&ratio),
                    "{layers} layers, {sigma_deg}°, {mode:?}: {ratio}"
                );
            }
        }
    }

    /// Its pilot of every incidence would be 10¹⁰ crossings.
    #[test]
    fn a_forecast_of_a_deep_stack_walks_few_paths_and_still_knows_them() {
        let text = r#"{"stack": {"layers": 100000}, "facets": {"slope_sd_deg": 0.05}}"#;
        let options = Options {
            incident_deg: Some((0..90).map(f64::from).collect()),
            cells: Some([96, 1]),
            target: Target::Paths(1_000_000),
            event_cap: 1_000_000,
            ..Options::default()
        };
        let request = Request::new(Recipe::from_json(text).unwrap(), options).unwrap();
        let bands = Bands::own(&request.recipe);
        let counted = std::sync::atomic::AtomicU64::new(0);
        let observer = Observer {
            progress: &|progress| {
                let paths = progress.tallies.iter().map(|tally| tally.paths).sum();
                counted.fetch_max(paths, std::sync::atomic::Ordering::Relaxed);
            },
            ..Observer::idle()
        };
        let found = forecast(&request, &bands, &observer).unwrap();
        let walked = counted.into_inner();
        assert!((2 * PROBE_PATHS..PILOT).contains(&walked), "{walked} paths");
        // A path has about two thirds of a crossing a layer, until it is given up.
        let each = found.crossings[0] / found.paths as f64;
        assert!((3e3..3e5).contains(&each), "{each}");
        assert_eq!(found.paths, 90_000_000);
    }
}
