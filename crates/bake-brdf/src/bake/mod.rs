//! From a recipe to a table: chooses cells and incidences, runs a solver, assembles the result.

pub(crate) mod assemble;
mod bands;
mod choice;
mod halfway;
pub mod reproduce;
pub mod sampling;
mod second_side;
pub mod snapshot;

pub use bands::Bands;
pub use choice::{Counts, ROWS, WALKED, choose_solver, counts};

use crate::effects::{Decisions, Effect, EffectSet, View};
use crate::recipe::{AzimuthMode, Recipe, RecipeError};
use crate::spectra::{self, Colours, Wanted};
use crate::tally::Tally;
use lut_io::axis::{ExitAxis, MAX_WIDTH};
use lut_io::dispersion::Dispersion;
use lut_io::table::Table;
use sampling::{Sampling, Shard, State};
use serde::{Deserialize, Serialize};
use snapshot::Snapshot;
use std::sync::atomic::AtomicBool;
use std::time::Duration;
use transport::doubling::{self, DoublingError};
use transport::walk::lanes::Precision;
use transport::{Geometry, Light, Transport};

/// Columns of a plane table: cells of 0.07 σ-widths at the lobe's centre keep the reading error near 5e-4.
const PLANE_CELLS: usize = 128;
/// Columns of a space table.
const SPACE_THETA_CELLS: usize = 64;
/// φ cells of a space table.
const SPACE_PHI_CELLS: usize = 32;
/// Narrowest stretch width, radians: directions are stored in f32, whose angles are good to 6e-8.
const NARROWEST: f64 = 1e-6;

/// Event cap of a path unless another is asked for. The longest path seen in 10⁸ of the paper's pearl had
/// 29,000 events; trapped light (total reflection at every interface) would go on for ever.
pub const DEFAULT_EVENT_CAP: u32 = 10_000_000;

/// Loosest total variation that doubling is asked for: below this its own minimum resolution is finer anyway.
const COARSEST_DOUBLING: f64 = 0.05;

/// When a bake is finished.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// Total variation of the lobe, per cent of the reflected light, at the worst incidence.
    AccuracyPercent(f64),
    /// Paths per incidence.
    Paths(u64),
    /// Wall-clock time.
    Time(Duration),
}

/// Who solves the transport problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum SolverChoice {
    /// The Monte Carlo walk.
    Walk,
    /// Adding and doubling.
    Doubling,
    /// The cheaper of the two.
    Auto,
}

/// What to bake.
#[derive(Clone, Debug)]
pub struct Request {
    /// The pearl.
    pub recipe: Recipe,
    /// What of it is baked.
    pub effects: EffectSet,
    /// Whether the effects were listed by name: then one that this stack cannot have is an error.
    pub listed: bool,
    /// Angles of incidence, degrees, ascending, within [0, 90].
    pub incident_deg: Vec<f64>,
    /// When to stop.
    pub target: Target,
    /// Seed of the walk.
    pub seed: u64,
    /// Most events of a path; beyond it the path is booked as truncated.
    pub event_cap: u32,
    /// Arithmetic of the walk's geometry.
    pub precision: Precision,
}

/// Why a bake gave no table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum BakeError {
    /// The recipe is wrong.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// Something else that was asked for cannot be done; one line that says what would be right.
    #[error("{0}")]
    Input(String),
    /// Doubling does not reach what was asked for; the walk may.
    #[error("solver doubling: {0}")]
    Doubling(#[from] DoublingError),
    /// The observer asked to stop.
    #[error("interrupted; nothing was written")]
    Interrupted,
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
        static NEVER: AtomicBool = AtomicBool::new(false);
        Self { stop: &NEVER, progress: &|_| (), forecast: &|_| (), checkpoint: None }
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

/// The default angles of incidence: 0° to 90° by 1°.
#[must_use]
pub fn default_incident_deg() -> Vec<f64> {
    (0..=90).map(f64::from).collect()
}

/// The exit cells of a table for this geometry and facet slope (radians).
#[must_use]
pub fn exit_axis(geometry: Geometry, slope_sd: f64) -> ExitAxis {
    // Twice the slope is the width of a single reflection, the narrowest thing in the lobe.
    let width = (2.0 * slope_sd).clamp(NARROWEST, MAX_WIDTH);
    match geometry {
        Geometry::Plane => ExitAxis::Plane { cells: PLANE_CELLS, width },
        Geometry::Space => {
            ExitAxis::Space { theta_cells: SPACE_THETA_CELLS, phi_cells: SPACE_PHI_CELLS, width }
        }
    }
}

impl Request {
    /// What `bake-brdf RECIPE` bakes: the effects that the recipe's look calls for at the default incidences, with seed 1.
    #[must_use]
    pub fn new(recipe: Recipe, target: Target) -> Self {
        Self {
            effects: effects_of(&recipe),
            recipe,
            listed: false,
            incident_deg: default_incident_deg(),
            target,
            seed: 1,
            event_cap: DEFAULT_EVENT_CAP,
            precision: Precision::Auto,
        }
    }

    /// Checks what the recipe's own checks do not cover.
    ///
    /// # Errors
    /// One line that names the value and what would be right.
    pub fn check(&self) -> Result<(), BakeError> {
        let refuse = |line: String| Err(BakeError::Input(line));
        if self.incident_deg.is_empty() {
            return refuse("incident-deg: an empty list; give at least one angle from 0 to 90".to_owned());
        }
        if let Some(angle) = self.incident_deg.iter().find(|angle| !(0.0..=90.0).contains(*angle)) {
            return refuse(format!(
                "incident-deg: {angle} is not an angle of incidence; expected 0 to 90 degrees"
            ));
        }
        if self.incident_deg.windows(2).any(|pair| pair[0] >= pair[1]) {
            return refuse("incident-deg: angles must ascend and differ".to_owned());
        }
        if self.event_cap == 0 {
            return refuse("event-cap: 0 events would walk nothing; give at least 1".to_owned());
        }
        match self.target {
            Target::AccuracyPercent(percent) if !(percent > 0.0 && percent <= 100.0) => refuse(format!(
                "accuracy: {percent} is not a share; expected more than 0 and at most 100 per cent"
            )),
            Target::Paths(paths) if !(1..=sampling::MAX_PATHS).contains(&paths) => {
                refuse(format!("paths: {paths} per incidence; expected 1 to {}", sampling::MAX_PATHS))
            }
            Target::Time(budget) if budget.is_zero() => {
                refuse("time-budget: 0 seconds; expected more".to_owned())
            }
            _ => Ok(()),
        }
    }

    /// Plane or space, as the recipe's azimuth mode needs.
    #[must_use]
    pub fn geometry(&self) -> Geometry {
        match self.recipe.azimuth.mode {
            AzimuthMode::Decay => Geometry::Plane,
            AzimuthMode::Space => Geometry::Space,
        }
    }

    /// The transport problem at the recipe's wavelength, of the effects that are baked.
    ///
    /// # Errors
    /// As [`Recipe::transport`].
    pub fn transport(&self) -> Result<Transport, BakeError> {
        let wavelength = self.recipe.wavelength();
        let has = |effect| self.effects.contains(effect);
        let mut transport = if has(Effect::CoherentSheets) && has(Effect::Blur) {
            self.recipe.sheet_transport(wavelength)?
        } else {
            self.recipe.transport(wavelength)?
        };
        if has(Effect::Polarisation) && has(Effect::Blur) {
            transport.light = Light::Tracked;
        }
        if !self.effects.contains(Effect::Absorption) {
            transport.optical_depths.fill(0.0);
        }
        if !self.effects.contains(Effect::Blur) {
            // The surface alone: what passes it goes on into more of the same, where nothing reflects.
            let [ambient, first] = [transport.indices[0], transport.indices[1]];
            transport.indices = vec![ambient, first, first];
            transport.optical_depths = vec![0.0];
        }
        Ok(transport)
    }

    /// Angles of incidence, radians.
    #[must_use]
    pub fn theta_i(&self) -> Vec<f64> {
        self.incident_deg.iter().map(|angle| angle.to_radians()).collect()
    }

    /// The interference colours that the effects call for.
    pub(crate) fn colours(&self) -> Result<Colours, BakeError> {
        let wanted = Wanted::by_effects(self.effects, self.listed);
        spectra::of(&self.recipe, wanted).map_err(|why| BakeError::Input(why.to_string()))
    }

    pub(crate) fn sampling(&self, bands: &Bands, shard: Shard) -> Result<(Sampling, Lobes), BakeError> {
        self.check()?;
        let transports = self.transports(bands)?;
        let geometry = self.geometry();
        let axis = exit_axis(geometry, self.recipe.facets.slope_sd_deg.to_radians());
        let sampling = Sampling::new(
            &transports,
            geometry,
            &axis,
            self.recipe.azimuth.width_deg,
            &self.theta_i(),
            self.seed,
            self.event_cap,
            self.precision,
            shard,
        )?;
        Ok((sampling, Lobes { bands: bands.clone(), transports, axis }))
    }

    /// The transport problem at each band, the recipe's own wavelength first.
    fn transports(&self, bands: &Bands) -> Result<Vec<Transport>, BakeError> {
        bands.all_nm().map(|nm| self.at_wavelength(nm).transport()).collect()
    }
}

/// The lobes of a request: their wavelengths, the transport problem at each, and the exit cells of all.
pub(crate) struct Lobes {
    pub(crate) bands: Bands,
    pub(crate) transports: Vec<Transport>,
    pub(crate) axis: ExitAxis,
}

/// Names what a bake of this request by this solver holds: equal for equal tables (`content_hash` of the metadata).
///
/// SHA-256 over the version, the recipe and all that the numbers depend on, in hexadecimal.
#[must_use]
pub fn content_hash(request: &Request, solver: SolverChoice) -> String {
    use sha2::Digest as _;
    // Without a lobe neither incidences nor accuracy nor seed matter.
    let lobe = request.effects.has_lobe().then(|| {
        // 32 bits asked for or chosen are the same bits.
        let precision = request.transport().map(|transport| request.precision.resolve(&transport)).ok();
        let walk = (request.seed, request.event_cap, precision);
        let walk = (solver != SolverChoice::Doubling).then_some(walk);
        (solver, &request.incident_deg, request.target, walk)
    });
    let content = serde_json::json!({
        "writer": concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")),
        "recipe": request.recipe.to_json(),
        "effects": request.effects,
        "lobe": lobe,
    });
    let digest = sha2::Sha256::digest(content.to_string().as_bytes());
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// The effects that a recipe's own look calls for.
#[must_use]
pub fn effects_of(recipe: &Recipe) -> EffectSet {
    Decisions::of(recipe, &View::of_look(&recipe.look)).set()
}

/// A table without a lobe: all light goes to the body. No solver is needed.
///
/// # Errors
/// A bad request.
fn lobeless(request: &Request) -> Result<Table, BakeError> {
    request.check()?;
    let transport = request.transport()?;
    let axis = exit_axis(request.geometry(), transport.facets.slope_sd);
    // Two incidences hold what there is to say.
    let request = Request { incident_deg: vec![0.0, 90.0], ..request.clone() };
    Ok(assemble::lobeless_table(&request, &transport, &axis))
}

/// Which sides of the stack a bake answers for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sides {
    /// Light from above that comes back.
    Above,
    /// Also what passes, and light from below: the section `both_sides` of the table.
    Both,
}

/// Bakes with adding and doubling to the accuracy asked for, at bands from [`Request::bands`]: choosing them takes as long
/// as solving a few.
///
/// # Errors
/// A request for paths or time, or a problem out of the solver's reach; the message says what would do.
pub fn doubling(request: &Request, bands: &Bands, sides: Sides) -> Result<Table, BakeError> {
    if !request.effects.has_lobe() && sides == Sides::Both {
        let line = "both-sides: the effects leave no lobe, expected surface or blur among them";
        return Err(BakeError::Input(line.to_owned()));
    }
    if !request.effects.has_lobe() {
        return coloured(request, lobeless(request)?, &request.colours()?);
    }
    let percent = doubled_percent(request)?;
    let transport = request.transport()?;
    if sides == Sides::Both && !bands.further_nm.is_empty() {
        let line = "both-sides: holds one wavelength, expected --effects without dispersion";
        return Err(BakeError::Input(line.to_owned()));
    }
    // Before the lobe, so that a refusal comes before the work.
    let colours = request.colours()?;
    let further = bands.further_nm.iter().map(|nm| request.at_wavelength(*nm));
    let further: Result<Vec<Table>, BakeError> =
        further.map(|request| doubled(&request, &request.transport()?, percent, sides)).collect();
    let table = doubled(request, &transport, percent, sides)?;
    coloured(request, assemble::joined(table, further?, bands)?, &colours)
}

/// The accuracy, per cent, to which a request is solved by doubling.
///
/// # Errors
/// A request that doubling refuses before it begins.
fn doubled_percent(request: &Request) -> Result<f64, BakeError> {
    request.check()?;
    let Target::AccuracyPercent(percent) = request.target else {
        return Err(BakeError::Input(NO_PATHS.to_owned()));
    };
    let transport = request.transport()?;
    if let Some(why) = walk_only(&transport) {
        return Err(BakeError::Input(format!("solver doubling: {why}; use --solver walk or auto")));
    }
    if transport.facets.slope_sd > 0.0 {
        choice::check_doubling(request, &transport, percent / 100.0)?;
    }
    Ok(percent)
}

/// The table of one wavelength, without colours.
fn doubled(request: &Request, transport: &Transport, percent: f64, sides: Sides) -> Result<Table, BakeError> {
    let axis = exit_axis(request.geometry(), transport.facets.slope_sd);
    if transport.facets.slope_sd == 0.0 {
        let lobes = doubling::smooth(transport, &request.theta_i())?;
        let below = match sides {
            Sides::Above => None,
            Sides::Both => Some(doubling::smooth(&transport.upside_down(), &request.theta_i())?),
        };
        return second_side::smooth_table(request, transport, &axis, &lobes, below.as_deref())
            .map_err(invalid);
    }
    let share = (percent / 100.0).min(COARSEST_DOUBLING);
    let mut theta_i = request.theta_i();
    let intervals = halfway::intervals(&theta_i);
    theta_i.extend(halfway::middles(&theta_i, &intervals));
    let both_sides = sides == Sides::Both;
    let solution = doubling::solve_to(transport, request.geometry(), &theta_i, share, both_sides)?;
    let mut table = assemble::doubling_table(request, transport, &axis, &solution, &intervals);
    if let Some(below) = &solution.from_below {
        second_side::add(&mut table, request, transport, &solution, below).map_err(invalid)?;
    }
    Ok(table)
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
        return coloured(request, lobeless(request)?, &request.colours()?);
    }
    let (mut sampling, lobes) = request.sampling(bands, Shard::WHOLE)?;
    // Before the lobe, so that a refusal comes before the work.
    let colours = request.colours()?;
    let result = walk_target(request, &mut sampling, observer, resume);
    if let (Err(BakeError::Interrupted), Some(checkpoint)) = (&result, &observer.checkpoint) {
        (checkpoint.keep)(&sampling.state());
    }
    result?;
    coloured(request, assemble::walk_tables(request, &lobes, &sampling)?, &colours)
}

/// Adds the colours; thicknesses matter to nothing else, so that irregularity is held if a colour is.
fn coloured(request: &Request, mut table: Table, colours: &Colours) -> Result<Table, BakeError> {
    colours.store(&mut table.meta).map_err(invalid)?;
    if let (Some(coherent), Some(mut dispersion)) =
        (&colours.spectra.coherent, Dispersion::of(&table.meta).map_err(invalid)?)
    {
        let wanted = Wanted::by_effects(request.effects, request.listed);
        for band in &mut dispersion.bands {
            let nm = band.wavelength_nm;
            band.incoherent = Some(spectra::incoherent(&request.recipe, wanted, nm, &coherent.theta_deg)?);
        }
        dispersion.store(&mut table.meta).map_err(invalid)?;
    }
    let held = |effect: Effect| match effect {
        Effect::Coherent | Effect::Emission => colours.effects().contains(effect),
        Effect::Irregularity => colours.effects() != EffectSet::NONE,
        _ => true,
    };
    table.meta.effects = request.effects.iter().filter(|effect| held(*effect)).collect::<EffectSet>().names();
    Ok(table)
}

/// Whether the bake of these bands can be made reciprocal ([`reciprocal`]).
///
/// # Errors
/// More bands than the recipe's own.
pub fn can_be_reciprocal(bands: &Bands) -> Result<(), BakeError> {
    if bands.further_nm.is_empty() { Ok(()) } else { Err(invalid(lut_io::reciprocal::several_bands())) }
}

/// The reciprocal table nearest to a baked one, named as another bake than that.
///
/// # Errors
/// A table that cannot be made reciprocal.
pub fn reciprocal(table: &Table) -> Result<Table, BakeError> {
    let mut table = lut_io::reciprocal::symmetrised(table).map_err(invalid)?;
    if let Some(serde_json::Value::String(hash)) = table.meta.extra.get_mut("content_hash") {
        hash.push_str("-reciprocal");
    }
    Ok(table)
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
    match request.target {
        Target::AccuracyPercent(percent) => sampling.walk_to_accuracy(percent / 100.0, observer),
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

/// Predicts the cost of a bake by a solver without doing it: the walk's from a pilot of a few thousand paths at some
/// incidences, doubling's from its operation count. What choosing the bands took is counted in.
///
/// # Errors
/// As [`walk()`] and [`doubling()`].
pub fn forecast(
    request: &Request,
    bands: &Bands,
    solver: SolverChoice,
    observer: &Observer<'_>,
) -> Result<Forecast, BakeError> {
    request.check()?;
    if !request.effects.has_lobe() {
        return Ok(Forecast { seconds: 0.0, paths: 0, bytes: 0, cells: 0, rows: 0 });
    }
    let transports = request.transports(bands)?;
    let axis = exit_axis(request.geometry(), transports[0].facets.slope_sd);
    let rows = (request.incident_deg.len() * transports.len()) as u64;
    let cells = axis.cells() as u64 * rows;
    let threads = rayon::current_num_threads() as f64;
    let (solved, paths) = if solver == SolverChoice::Doubling {
        doubled_percent(request)?;
        (doubling_seconds(request, &transports) / threads, 0)
    } else {
        let walk = sampling::forecast(request, bands, observer)?;
        let beside = transports.iter().zip(&walk.crossings);
        let beside = beside.map(|(transport, &each)| choice::seconds_beside_walk(request, transport, each));
        (walk.seconds + beside.sum::<f64>() / threads, walk.paths)
    };
    let seconds = solved + bands::seconds_to_choose(request)? / threads;
    // Three components of value, error and count, and four coordinates, four bytes each.
    Ok(Forecast { seconds, paths, bytes: cells * 13 * 4, cells, rows })
}

/// Seconds of one core that doubling takes over all bands to the accuracy of a request.
fn doubling_seconds(request: &Request, transports: &[Transport]) -> f64 {
    let Target::AccuracyPercent(percent) = request.target else { return 0.0 };
    let rough = transports.iter().filter(|transport| transport.facets.slope_sd > 0.0); // else a closed form
    rough
        .map(|transport| {
            let counts = choice::doubling_counts(request, transport, percent / 100.0);
            choice::solver_seconds(request.geometry(), &counts)
        })
        .sum()
}

const NO_PATHS: &str = "doubling walks no paths: give it --accuracy, not --paths or --time-budget";
