//! From a recipe to a table: chooses cells and incidences, runs a solver, assembles the result.

mod assemble;
mod bands;
pub(crate) mod cells;
mod choice;
mod effort;
mod grid;
mod halfway;
pub mod implied;
mod placing;
mod reading;
pub mod reproduce;
mod request;
pub(crate) mod sampling;
mod second_side;
pub mod snapshot;

pub use crate::prices::{ROWS, WALKED};
pub use bands::Bands;
pub use cells::exit_axis;
pub use choice::{Counts, advice, choose_solver, counts, solver};
pub use grid::Grid;
pub use request::Request;
pub use sampling::{Shard, State};

use crate::effects::EffectError;
use crate::options::{OptionError, Sides, SolverChoice, Target};
use crate::prices;
use crate::recipe::RecipeError;
use crate::spectra::{self, SpectraError};
use crate::tally::Tally;
use assemble::{SecondSide, Solved};
use lut_io::axis::ExitAxis;
use lut_io::table::Table;
use sampling::Sampling;
use snapshot::Snapshot;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use transport::doubling::{self, DoublingError};
use transport::{Light, Transport};

/// Loosest total variation that doubling is asked for: below this its own minimum resolution is finer anyway.
const COARSEST_DOUBLING: f64 = 0.05;

/// Why a bake gave no table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BakeError {
    /// The recipe is wrong.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// One of the options.
    #[error(transparent)]
    Option(#[from] OptionError),
    /// A list of effects.
    #[error(transparent)]
    Effects(#[from] EffectError),
    /// Interference colours.
    #[error(transparent)]
    Spectra(SpectraError),
    /// Something else that cannot be done; one line that says what would be right.
    #[error("{0}")]
    Input(String),
    /// Doubling does not reach its target; the walk may.
    #[error("solver: doubling: {0}")]
    Doubling(DoublingError),
    /// The observer asked to stop.
    #[error("interrupted; nothing was written")]
    Interrupted,
}

impl From<DoublingError> for BakeError {
    fn from(error: DoublingError) -> Self {
        match error {
            DoublingError::Stopped => Self::Interrupted,
            other => Self::Doubling(other),
        }
    }
}

impl From<SpectraError> for BakeError {
    fn from(error: SpectraError) -> Self {
        match error {
            SpectraError::Stopped => Self::Interrupted,
            other => Self::Spectra(other),
        }
    }
}

/// Of what nobody stops.
pub(crate) static NEVER: AtomicBool = AtomicBool::new(false);

/// Refuses to go on once it is not wanted any more.
fn go_on(stop: &AtomicBool) -> Result<(), BakeError> {
    if stop.load(Ordering::Relaxed) { Err(BakeError::Interrupted) } else { Ok(()) }
}

/// Watches a bake, and can stop it.
pub struct Observer<'a> {
    /// Set from anywhere (a signal handler) to stop at the next task.
    pub stop: &'a AtomicBool,
    /// Called after every task, about a hundred times a second.
    pub progress: &'a (dyn Fn(&Progress<'_>) + Sync),
    /// Called once when the pilot is through, with the seconds the rest is expected to take.
    pub forecast: &'a (dyn Fn(f64) + Sync),
    /// Where states go from time to time.
    pub checkpoint: Option<Checkpoint<'a>>,
}

impl Observer<'_> {
    /// Watches nothing.
    #[must_use]
    pub const fn idle() -> Self {
        Self { stop: &NEVER, progress: &|_| (), forecast: &|_| (), checkpoint: None }
    }

    /// Whether the bake is still wanted.
    pub(crate) fn go_on(&self) -> Result<(), BakeError> {
        go_on(self.stop)
    }
}

/// Keeps the state of a bake from time to time.
pub struct Checkpoint<'a> {
    /// Least time between two states.
    pub every: Duration,
    /// Takes a state.
    pub keep: &'a (dyn Fn(&State) + Sync),
}

/// How far a bake is.
pub struct Progress<'a> {
    /// Tallies so far, one per incidence.
    pub tallies: &'a [Tally],
    /// Incidences in a band: the worst of so many is bounded.
    pub incidences: usize,
    /// Solid angle per unit of extent of their cells, as known when the round began.
    pub spreads: &'a [Vec<f64>],
    /// Crossings after which the present round is through.
    pub expected_crossings: f64,
}

impl Progress<'_> {
    /// Crossings done so far.
    #[must_use]
    pub fn crossings(&self) -> u64 {
        self.tallies.iter().map(|tally| tally.crossings).sum()
    }

    /// Bound on the error reached so far, per cent, at the worst incidence.
    #[must_use]
    pub fn error_percent(&self) -> f64 {
        let (tallies, incidences) = (self.tallies.iter().zip(self.spreads), self.incidences);
        100.0
            * tallies
                .map(|(tally, spread)| tally.total_variation_bound(spread, incidences))
                .fold(0.0, f64::max)
    }
}

/// A table without a lobe: all light goes to the body. No solver is needed.
///
/// # Errors
/// A bad request.
fn lobeless(stop: &AtomicBool, request: &Request) -> Result<Table, BakeError> {
    request.options.check()?;
    // Two incidences hold what there is to say.
    let request = request.at_incidences(vec![0.0, 90.0]);
    let dark = assemble::dark(&request, &request.transport()?, &request.exit_axis());
    assemble::table(&request, vec![dark], None, &Bands::own(&request.recipe), &request.colours(stop)?)
}

/// Bakes a table: chooses bands and solver, solves, adds colours.
///
/// # Errors
/// As [`walk()`] and [`doubling()`]; where [`SolverChoice::Auto`] chose a doubling that does not reach its target, the walk's.
pub fn bake(request: &Request, observer: &Observer<'_>) -> Result<Table, BakeError> {
    let bands = request.bands_unless(observer.stop)?;
    if solver(request, &bands)? == SolverChoice::Doubling {
        match doubling_watched(request, &bands, observer) {
            Err(BakeError::Doubling(_)) if may_walk(request) => {}
            table => return table,
        }
    }
    walk(request, &bands, observer, None)
}

/// Whether a doubling that fails may be walked instead.
#[must_use]
pub fn may_walk(request: &Request) -> bool {
    request.wanted_solver() == SolverChoice::Auto && request.options.sides == Sides::Above
}

/// Bakes with adding and doubling to an accuracy, at bands from [`Request::bands`]: choosing them takes as long as solving a few.
///
/// # Errors
/// A target of paths or time, or a problem out of the solver's reach; the message says what would do.
pub fn doubling(request: &Request, bands: &Bands) -> Result<Table, BakeError> {
    doubling_watched(request, bands, &Observer::idle())
}

/// [`doubling()`] that an observer can stop.
fn doubling_watched(request: &Request, bands: &Bands, observer: &Observer<'_>) -> Result<Table, BakeError> {
    let both_sides = request.options.sides == Sides::Both;
    let refuse = |why: &str| Err(OptionError::new("both_sides", why).into());
    if !request.effects.has_lobe() {
        if both_sides {
            return refuse("the effects leave no lobe; expected surface or blur among them");
        }
        return lobeless(observer.stop, request);
    }
    let percent = doubled_percent(request)?;
    if both_sides && !bands.further_nm.is_empty() {
        return refuse("holds one wavelength; expected effects without dispersion");
    }
    // Before the lobe, so that a refusal comes before the work.
    let colours = request.colours(observer.stop)?;
    let axis = request.exit_axis();
    let mut second_side = None;
    let mut solved = Vec::new();
    for nm in bands.all_nm() {
        let request = request.at_wavelength(nm);
        let (lobe, side) = doubled(&request, &request.transport()?, &axis, percent, observer)?;
        solved.push(lobe);
        second_side = second_side.or(side);
    }
    assemble::table(request, solved, second_side, bands, &colours)
}

/// The accuracy, per cent, to which a request is solved by doubling.
///
/// # Errors
/// A request that doubling refuses before it begins.
fn doubled_percent(request: &Request) -> Result<f64, BakeError> {
    request.options.check()?;
    let percent = choice::accuracy_percent(request)?;
    let transport = request.transport()?;
    if let Some(why) = walk_only(&transport) {
        let why = format!("doubling cannot: {why}; expected walk or auto");
        return Err(OptionError::new("solver", why).into());
    }
    if transport.facets.slope_sd > 0.0 {
        choice::check_doubling(request, &transport, percent / 100.0)?;
    }
    Ok(percent)
}

/// The lobe at one wavelength, and the other side of it if that is wanted.
fn doubled(
    request: &Request,
    transport: &Transport,
    axis: &ExitAxis,
    percent: f64,
    observer: &Observer<'_>,
) -> Result<(Solved, Option<SecondSide>), BakeError> {
    let both_sides = request.options.sides == Sides::Both;
    if transport.facets.slope_sd == 0.0 {
        let lobes = doubling::smooth(transport, &request.theta_i())?;
        let upside_down = both_sides.then(|| transport.upside_down());
        let below = upside_down.map(|below| doubling::smooth(&below, &request.theta_i())).transpose()?;
        return Ok(second_side::smooth(request, transport, axis, &lobes, below.as_deref()));
    }
    let wanted = request.grid.solver_wanted(percent / 100.0);
    let theta_i = reading::with_middles(&request.theta_i());
    let geometry = request.geometry();
    let known = request.solved_before(transport, &wanted.settings(transport, geometry));
    let solution =
        doubling::solve_to_unless(observer.stop, transport, geometry, &theta_i, wanted, both_sides, known)?;
    let solved = assemble::doubled(request, transport, axis, &solution, observer)?;
    let below = solution.from_below.as_ref();
    Ok((solved, below.map(|below| second_side::of(request, transport, axis, &solution, below))))
}

/// Why a problem has no solution by doubling, if it has none.
fn walk_only(transport: &Transport) -> Option<&'static str> {
    if transport.sheets.is_some() {
        return Some("coherent sheets are walked only");
    }
    (transport.light == Light::Tracked).then_some("s and p are tracked by the walk only")
}

fn invalid(error: lut_io::FieldError) -> BakeError {
    BakeError::Input(format!("the table would not be valid: {error}"))
}

/// Bakes with the Monte Carlo walk, at bands from [`Request::bands`]; goes on from `resume` where that is given. A bake that is
/// interrupted hands its last whole state to the observer's checkpoint.
///
/// # Errors
/// A bad request, a state of another bake, or an observer that asked to stop.
pub fn walk(
    request: &Request,
    bands: &Bands,
    observer: &Observer<'_>,
    resume: Option<Snapshot>,
) -> Result<Table, BakeError> {
    if !request.effects.has_lobe() {
        return lobeless(observer.stop, request);
    }
    let mut sampling = Sampling::of(request, bands, Shard::WHOLE)?;
    // Before the lobe, so that a refusal comes before the work.
    let colours = request.colours(observer.stop)?;
    let result = walk_target(request, &mut sampling, observer, resume);
    if let (Err(BakeError::Interrupted), Some(checkpoint)) = (&result, &observer.checkpoint) {
        (checkpoint.keep)(&sampling.state());
    }
    result?;
    assemble::walk_table(request, bands, &sampling, &colours)
}

/// Whether the bake of these bands can be made reciprocal ([`reciprocal`]).
///
/// # Errors
/// More bands than the recipe's own.
pub fn can_be_reciprocal(bands: &Bands) -> Result<(), BakeError> {
    if bands.further_nm.is_empty() { Ok(()) } else { Err(invalid(lut_io::symmetrise::several_bands())) }
}

/// The reciprocal table nearest to a baked one.
///
/// # Errors
/// A table that cannot be made reciprocal.
pub fn reciprocal(table: &Table) -> Result<Table, BakeError> {
    lut_io::symmetrise::symmetrised(table).map_err(invalid)
}

fn walk_target(
    request: &Request,
    sampling: &mut Sampling,
    observer: &Observer<'_>,
    resume: Option<Snapshot>,
) -> Result<(), BakeError> {
    if let Some(snapshot) = resume {
        Snapshot::new(request, Shard::WHOLE, sampling.state())
            .same_bake(&snapshot)
            .map_err(|why| BakeError::Input(format!("the checkpoint {why}")))?;
        sampling.resume(snapshot.state, observer)?;
    }
    match request.options.target {
        Target::AccuracyPercent(percent) => sampling.walk_to_accuracy(percent, observer),
        Target::Paths(paths) => sampling.walk_to_paths(paths, observer),
        Target::Time(budget) => sampling.walk_for(budget, observer),
    }
}

/// What the lobes of a bake would cost, beside making rows of the table and colours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Forecast {
    /// Seconds of wall-clock time with the threads in use.
    pub seconds: f64,
    /// Paths over all incidences.
    pub paths: u64,
    /// Bytes of the table before compression.
    pub bytes: u64,
    /// Cells over all incidences and bands.
    pub cells: u64,
    /// Rows of the table: incidences times bands.
    pub rows: u64,
}

/// Predicts the cost of a bake by a solver without doing it: of its lobe, its colours and its file.
///
/// # Errors
/// As [`walk()`] and [`doubling()`].
pub fn forecast(
    request: &Request,
    bands: &Bands,
    solver: SolverChoice,
    observer: &Observer<'_>,
) -> Result<Forecast, BakeError> {
    let lobe = lobe_forecast(request, bands, solver, observer)?;
    let threads = rayon::current_num_threads() as f64;
    let (wanted, accuracy) = (request.wanted_colours(), request.colour_accuracy());
    let colours: f64 = spectra::forecast(observer.stop, &request.recipe, wanted, accuracy).iter().sum();
    observer.go_on()?;
    Ok(Forecast { seconds: lobe.seconds + colours / threads + prices::OVERHEAD_SECONDS, ..lobe })
}

/// Predicts the cost of a lobe and its rows: the walk's from a pilot of a few thousand paths at some incidences, doubling's from its
/// operation count. What placing rows and cells took is counted in, and what choosing the bands does.
///
/// # Errors
/// As [`walk()`] and [`doubling()`].
pub(crate) fn lobe_forecast(
    request: &Request,
    bands: &Bands,
    solver: SolverChoice,
    observer: &Observer<'_>,
) -> Result<Forecast, BakeError> {
    request.options.check()?;
    if !request.effects.has_lobe() {
        return Ok(Forecast { seconds: 0.0, paths: 0, bytes: 0, cells: 0, rows: 0 });
    }
    let transports = bands.transports(request)?;
    let rows = (request.grid.incident_deg.len() * transports.len()) as u64;
    let cells = request.exit_axis().cells() as u64 * rows;
    let threads = rayon::current_num_threads() as f64;
    let (solved, paths) = if solver == SolverChoice::Doubling {
        let percent = doubled_percent(request)?;
        (doubling_seconds(request, &transports, percent) / threads, 0)
    } else {
        let walk = effort::forecast(request, bands, observer)?;
        let beside = transports.iter().zip(&walk.crossings);
        let beside = beside.map(|(transport, &each)| choice::seconds_beside_walk(request, transport, each));
        (walk.seconds + beside.sum::<f64>() / threads, walk.paths)
    };
    let beside = prices::row_beside(request.geometry()) * rows as f64;
    let chosen = request.placing_seconds + bands::seconds_to_choose(request)? / threads;
    let seconds = solved + beside + chosen;
    // Three components of value, error and count, and four coordinates, four bytes each.
    Ok(Forecast { seconds, paths, bytes: cells * 13 * 4, cells, rows })
}

/// Seconds of one core that doubling takes over all bands to an accuracy, per cent.
fn doubling_seconds(request: &Request, transports: &[Transport], percent: f64) -> f64 {
    let rough = transports.iter().filter(|transport| transport.facets.slope_sd > 0.0); // else a closed form
    rough
        .map(|transport| {
            let counts = choice::doubling_counts(request, transport, percent / 100.0);
            choice::solver_seconds(request.geometry(), &counts)
        })
        .sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::effects::{Effect, EffectSet};
    use crate::options::Options;
    use crate::recipe::Recipe;

    #[test]
    fn a_doubling_that_is_stopped_gives_no_table() {
        let options = Options {
            solver: Some(SolverChoice::Doubling),
            incident_deg: Some(vec![0.0, 40.0]),
            cells: Some([20, 10]),
            target: Target::AccuracyPercent(5.0),
            ..Options::default()
        };
        let request = Request::new(Recipe::default(), options).unwrap();
        let stop = AtomicBool::new(false);
        let observer = Observer { stop: &stop, ..Observer::idle() };
        assert!(bake(&request, &observer).is_ok());
        stop.store(true, Ordering::Relaxed);
        assert!(matches!(bake(&request, &observer), Err(BakeError::Interrupted)));
    }

    #[test]
    fn rows_of_a_doubling_are_not_made_once_it_is_stopped() {
        let options = Options { incident_deg: Some(vec![0.0]), cells: Some([20, 10]), ..Options::default() };
        let request = Request::new(Recipe::default(), options).unwrap();
        let (transport, axis) = (request.transport().unwrap(), request.exit_axis());
        let theta_i = reading::with_middles(&request.theta_i());
        let solution = doubling::solve_to(&transport, request.geometry(), &theta_i, 0.05, false).unwrap();
        let stop = AtomicBool::new(true);
        let observer = Observer { stop: &stop, ..Observer::idle() };
        let made = assemble::doubled(&request, &transport, &axis, &solution, &observer);
        assert!(matches!(made, Err(BakeError::Interrupted)));
        assert!(assemble::doubled(&request, &transport, &axis, &solution, &Observer::idle()).is_ok());
    }

    #[test]
    fn rows_cells_bands_and_colours_are_not_looked_for_once_they_are_not_wanted() {
        let glassy = r#"{"stack":{"layers":9,"aragonite":{"n":{"cauchy":[1.52,0.02]},"thickness_sd_nm":5}},"look":{"depth":0.5}}"#;
        let recipe = Recipe::from_json(glassy).unwrap();
        let effects = [Effect::Surface, Effect::Blur, Effect::Coherent, Effect::Emission, Effect::Dispersion];
        let effects: EffectSet = effects.into_iter().collect();
        let stopped = AtomicBool::new(true);
        let of = |stop: &AtomicBool, options: &Options| {
            Request::of_unless(stop, recipe.clone(), effects, options.clone())
        };
        let given = |incident_deg, cells| Options {
            incident_deg,
            cells,
            target: Target::AccuracyPercent(5.0),
            ..Options::default()
        };
        let (rows, cells) = (Some(vec![0.0, 60.0]), Some([20, 10]));
        for options in [given(rows.clone(), None), given(None, cells), given(None, None)] {
            assert!(of(&NEVER, &options).is_ok());
            assert!(matches!(of(&stopped, &options), Err(BakeError::Interrupted)));
        }
        let request = of(&stopped, &given(rows, cells)).unwrap();
        assert!(matches!(request.bands_unless(&stopped), Err(BakeError::Interrupted)));
        assert!(matches!(request.colours(&stopped), Err(BakeError::Interrupted)));
        assert!(request.bands_unless(&NEVER).is_ok() && request.colours(&NEVER).is_ok());
        let observer = Observer { stop: &stopped, ..Observer::idle() };
        let bands = Bands::own(&recipe);
        let foretold = forecast(&request, &bands, SolverChoice::Doubling, &observer);
        assert!(matches!(foretold, Err(BakeError::Interrupted)));
    }
}
