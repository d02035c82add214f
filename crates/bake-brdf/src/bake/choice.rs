//! [`SolverChoice::Auto`]: the cheaper solver, by counting operations.
//!
//! Nothing is timed. What doubling does is counted by [`Settings::cost`], what the walk does by the crossings and
//! paths that a few scouts find it needs; both are priced in seconds of the same core. So the choice, and with it the bytes
//! of the table, depend on the request alone: not on the machine, its load, or the number of threads.
//!
//! `cargo run --release -p bake-brdf --example choice` tries the choice on requests that the fit of the prices has not seen.

use super::effort::{self, Effort};
use super::halfway::Auxiliary;
use super::{BakeError, Bands, Request, reading, walk_only};
use crate::effects::Effect;
use crate::options::{OptionError, Sides, SolverChoice, Target};
use crate::prices::{self, ROWS, WALKED};
use lut_io::axis::ExitAxis;
use transport::doubling::{self, DoublingError, OPERATIONS, Settings};
use transport::walk::lanes::Precision;
use transport::{Geometry, Normals, Transport};

/// Incidences at which paths are scouted: a few tell solvers apart whose prices differ by more than a factor of [`CLEAR`].
const FEW_SCOUTS: usize = 2;
const SCOUTS: usize = 16;
const CLEAR: f64 = 3.0;
/// A walk that doubling beats by so much is worth a word.
const TENFOLD: f64 = 10.0;
/// Where doubling costs so many times the walk, a thousand paths an incidence are enough to tell.
const BEYOND_DOUBT: f64 = 10.0;
/// Layers up to which scouts cost no more than the probe that may save them.
const SHALLOW: usize = 100;

/// What either solver has to do for a request.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Counts {
    /// Doubling: [`OPERATIONS`] of the solution and of the coarser one that estimates its error.
    pub doubling: [f64; OPERATIONS.len()],
    /// Doubling: [`ROWS`].
    pub rows: [f64; ROWS.len()],
    /// Walk: [`WALKED`].
    pub walk: [f64; WALKED.len()],
    /// Walk: [`OPERATIONS`] and [`ROWS`] of the doubling that measures its error half-way between incidences.
    pub beside_walk: [f64; OPERATIONS.len() + ROWS.len()],
}

/// The part of [`Counts`] that doubling does.
struct DoublingCounts {
    solver: [f64; OPERATIONS.len()],
    rows: [f64; ROWS.len()],
}

impl DoublingCounts {
    /// Seconds of one core.
    fn seconds(&self, geometry: Geometry) -> f64 {
        solver_seconds(geometry, &self.solver) + prices::sum(&self.rows, &prices::rows(geometry))
    }
}

/// The part of [`Counts`] that the walk does.
struct WalkCounts {
    own: [f64; WALKED.len()],
    beside: [f64; OPERATIONS.len() + ROWS.len()],
}

impl WalkCounts {
    /// Seconds of one core.
    fn seconds(&self, geometry: Geometry) -> f64 {
        prices::sum(&self.own, &prices::walked(geometry)) + beside_seconds(geometry, &self.beside)
    }
}

/// Seconds of one core that so many [`OPERATIONS`] take.
pub(super) fn solver_seconds(geometry: Geometry, counts: &[f64]) -> f64 {
    prices::sum(counts, &doubling::prices(geometry))
}

/// Who solves a request: the one wanted, [`SolverChoice::Auto`] decided. What only reflects once is not walked to an accuracy, unless
/// the options say so.
///
/// # Errors
/// A bad request.
pub fn solver(request: &Request, bands: &Bands) -> Result<SolverChoice, BakeError> {
    let options = &request.options;
    let to_accuracy = matches!(options.target, Target::AccuracyPercent(_));
    match request.wanted_solver() {
        SolverChoice::Auto if options.sides == Sides::Both => Ok(SolverChoice::Doubling),
        SolverChoice::Auto if request.effects.has_lobe() => Ok(choose_solver(request, bands)?.0),
        SolverChoice::Auto if to_accuracy => Ok(SolverChoice::Doubling),
        SolverChoice::Doubling => Ok(SolverChoice::Doubling),
        SolverChoice::Walk if options.solver.is_some() => Ok(SolverChoice::Walk),
        _ if to_accuracy && !request.effects.contains(Effect::Blur) => Ok(SolverChoice::Doubling),
        _ => Ok(SolverChoice::Walk),
    }
}

/// The accuracy, per cent, that a solution by doubling needs.
///
/// # Errors
/// A target of paths or time.
pub(super) fn accuracy_percent(request: &Request) -> Result<f64, BakeError> {
    match request.options.target {
        Target::AccuracyPercent(percent) => Ok(percent),
        Target::Paths(_) | Target::Time(_) => {
            let why = "doubling walks no paths; expected an accuracy, not paths or a time budget";
            Err(OptionError::new("solver", why).into())
        }
    }
}

/// What is known of both solvers.
enum Comparison {
    /// One of them cannot, or need not; why, in one sentence.
    Only(SolverChoice, String),
    /// Seconds of one core of each; the walk's may be a bound from below.
    Seconds { doubling: f64, nodes: usize, walk: f64, exact: bool },
}

/// Which solver is cheaper for a request at bands from [`Request::bands`], and why in one sentence.
///
/// # Errors
/// A bad request.
pub fn choose_solver(request: &Request, bands: &Bands) -> Result<(SolverChoice, String), BakeError> {
    Ok(match compare(request, bands)? {
        Comparison::Only(solver, why) => (solver, why),
        Comparison::Seconds { doubling, nodes, walk, exact } => {
            let choice = if doubling <= walk { SolverChoice::Doubling } else { SolverChoice::Walk };
            let about = if exact { "about" } else { "at least" };
            let why = format!(
                "doubling would take about {doubling:.2} s of one core, with {nodes} nodes, the walk {about} {walk:.2} s"
            );
            (choice, why)
        }
    })
}

/// One sentence on a walk that doubling would beat by [`TENFOLD`].
///
/// # Errors
/// A bad request.
pub fn advice(request: &Request, bands: &Bands) -> Result<Option<String>, BakeError> {
    Ok(match compare(request, bands)? {
        Comparison::Seconds { doubling, walk, .. } if walk >= TENFOLD * doubling => Some(format!(
            "doubling would take about {doubling:.2} s of one core, this walk {walk:.1} s or more"
        )),
        _ => None,
    })
}

fn compare(request: &Request, bands: &Bands) -> Result<Comparison, BakeError> {
    request.options.check()?;
    let walk = |why: &str| Ok(Comparison::Only(SolverChoice::Walk, why.to_owned()));
    let Target::AccuracyPercent(percent) = request.options.target else {
        return walk("only the walk has a number of paths or a time");
    };
    let transport = request.transport()?;
    if let Some(why) = walk_only(&transport) {
        return walk(why);
    }
    if transport.facets.slope_sd == 0.0 {
        let why = "smooth interfaces have a closed form".to_owned();
        return Ok(Comparison::Only(SolverChoice::Doubling, why));
    }
    let geometry = request.geometry();
    let settings = settings(request, &transport, percent / 100.0);
    if let Err(why) = check_doubling(request, &transport, percent / 100.0) {
        return walk(&format!("doubling is out of reach here: {why}"));
    }
    let transports = bands.transports(request)?;
    let seconds = |band: &Transport| counts_of_doubling(request, band, percent / 100.0).seconds(geometry);
    let doubling: f64 = transports.iter().map(seconds).sum();
    let bands = transports.len() as f64;
    let (walk, exact) = walk_against(request, &transport, percent / 100.0, doubling / bands)?;
    Ok(Comparison::Seconds { doubling, nodes: settings.nodes, walk: bands * walk, exact })
}

/// Seconds of one core that the walk takes in a band, known as well as the comparison with `by_doubling` needs, and whether that is more
/// than a bound from below: choosing must not take a noticeable part of what is chosen.
fn walk_against(
    request: &Request,
    transport: &Transport,
    accuracy: f64,
    by_doubling: f64,
) -> Result<(f64, bool), BakeError> {
    let geometry = request.geometry();
    let seconds = |effort| counts_of_walk(request, transport, effort).seconds(geometry);
    let probe = (transport.layers() > SHALLOW).then_some(Some(FEW_SCOUTS));
    for probed in std::iter::once(None).chain(probe) {
        let least = seconds(effort::least_effort(request, probed)?);
        if least >= by_doubling {
            return Ok((least, false));
        }
    }
    let beyond_doubt = |effort| by_doubling > BEYOND_DOUBT * seconds(effort);
    let few = seconds(effort::scout(request, accuracy, FEW_SCOUTS, beyond_doubt)?);
    let clear = few > CLEAR * by_doubling || by_doubling > CLEAR * few;
    if clear || request.grid.incident_deg.len() <= FEW_SCOUTS {
        return Ok((few, true));
    }
    Ok((seconds(effort::scout(request, accuracy, SCOUTS, |_| false)?), true))
}

/// What either solver would do for a request that both can answer.
///
/// # Errors
/// A bad request, or one for paths or time.
pub fn counts(request: &Request) -> Result<Counts, BakeError> {
    request.options.check()?;
    let percent = accuracy_percent(request)?;
    let transport = request.transport()?;
    let effort = effort::scout(request, percent / 100.0, SCOUTS, |_| false)?;
    let doubling = counts_of_doubling(request, &transport, percent / 100.0);
    let walk = counts_of_walk(request, &transport, effort);
    Ok(Counts { doubling: doubling.solver, rows: doubling.rows, walk: walk.own, beside_walk: walk.beside })
}

fn counts_of_doubling(request: &Request, transport: &Transport, accuracy: f64) -> DoublingCounts {
    let settings = settings(request, transport, accuracy);
    DoublingCounts {
        solver: doubling_counts(request, transport, accuracy),
        rows: row_counts(&request.exit_axis(), &settings, solved_incidences(request).len()),
    }
}

fn counts_of_walk(request: &Request, transport: &Transport, effort: Effort) -> WalkCounts {
    let beside = counts_beside_walk(request, transport, effort.crossings);
    let own = [
        crossing_weight(request, transport) * effort.crossings,
        effort.paths,
        request.grid.incident_deg.len() as f64,
    ];
    WalkCounts { own, beside }
}

/// [`OPERATIONS`] and [`ROWS`] of the doubling that measures a walk of so many crossings half-way between incidences.
fn counts_beside_walk(
    request: &Request,
    transport: &Transport,
    crossings: f64,
) -> [f64; OPERATIONS.len() + ROWS.len()] {
    let geometry = request.geometry();
    let mut beside = [0.0; OPERATIONS.len() + ROWS.len()];
    if let Some(auxiliary) = Auxiliary::of(transport, geometry, &request.theta_i(), crossings) {
        let (solver, rows) = beside.split_at_mut(OPERATIONS.len());
        solver.copy_from_slice(&auxiliary.cost.counts);
        rows.copy_from_slice(&row_counts(&request.exit_axis(), &auxiliary.settings, auxiliary.incidences()));
    }
    beside
}

/// Seconds of one core that measuring a walk of so many crossings half-way between incidences takes.
pub(super) fn seconds_beside_walk(request: &Request, transport: &Transport, crossings: f64) -> f64 {
    beside_seconds(request.geometry(), &counts_beside_walk(request, transport, crossings))
}

fn beside_seconds(geometry: Geometry, beside: &[f64]) -> f64 {
    let (solver, rows) = beside.split_at(OPERATIONS.len());
    solver_seconds(geometry, solver) + prices::sum(rows, &prices::rows(geometry))
}

/// The settings that doubling starts with.
pub(super) fn settings(request: &Request, transport: &Transport, accuracy: f64) -> Settings {
    request.grid.solver_wanted(accuracy).settings(transport, request.geometry())
}

/// Refuses what doubling would refuse before it begins.
pub(super) fn check_doubling(
    request: &Request,
    transport: &Transport,
    accuracy: f64,
) -> Result<(), DoublingError> {
    let geometry = request.geometry();
    let settings = settings(request, transport, accuracy);
    settings.check_first_attempt(transport, geometry, &solved_incidences(request)).map(drop)
}

/// Incidences that doubling solves, radians: those asked for, and some half-way between them.
fn solved_incidences(request: &Request) -> Vec<f64> {
    reading::with_middles(&request.theta_i())
}

/// [`OPERATIONS`] of doubling to `accuracy` (a share), its error estimate included. A stack that was solved to place the rows is not
/// solved again.
pub(super) fn doubling_counts(
    request: &Request,
    transport: &Transport,
    accuracy: f64,
) -> [f64; OPERATIONS.len()] {
    let settings = settings(request, transport, accuracy);
    let incidences = solved_incidences(request).len();
    let counts = |incidences| -> [f64; OPERATIONS.len()] {
        let [fine, coarse] = [settings, settings.coarser()]
            .map(|settings| settings.cost(transport, request.geometry(), incidences).counts);
        std::array::from_fn(|i| fine[i] + coarse[i])
    };
    let known = request.solved_before(transport, &settings);
    let (all, solved) = (counts(incidences), known.map(|_| counts(0)).unwrap_or_default());
    std::array::from_fn(|i| all[i] - solved[i])
}

/// [`ROWS`] of a table of so many solved incidences.
fn row_counts(axis: &ExitAxis, settings: &Settings, incidences: usize) -> [f64; ROWS.len()] {
    // In space modes are summed at each node and cell.
    let modes = if matches!(axis, ExitAxis::Space { .. }) { settings.modes as f64 } else { 1.0 };
    let rows = incidences as f64;
    [rows, rows * axis.columns() as f64 * settings.nodes as f64 * modes]
}

/// What the effects make of a crossing.
fn crossing_weight(request: &Request, transport: &Transport) -> f64 {
    let factor = |on: bool, factor: f64| if on { factor } else { 1.0 };
    factor(request.options.precision.resolve(transport) == Precision::F64, prices::DOUBLE_PRECISION)
        * factor(transport.facets.normals == Normals::Visible, prices::VISIBLE)
        * factor(transport.absorbs(), prices::ABSORBING)
        * factor(transport.has_complex_faces(), prices::COMPLEX)
}

#[cfg(test)]
mod tests {
    use super::super::{Observer, forecast};
    use super::*;
    use crate::effects::Effects;
    use crate::options::Options;
    use crate::recipe::Recipe;

    fn request(layers: usize, target: Target) -> Request {
        let text = format!(r#"{{"stack": {{"layers": {layers}}}, "facets": {{"slope_sd_deg": 2}}}}"#);
        let options = Options {
            effects: Effects::Listed([Effect::Surface, Effect::Blur, Effect::Azimuth].into_iter().collect()),
            incident_deg: Some(vec![0.0, 20.0, 40.0, 60.0, 80.0]),
            target,
            ..Options::default()
        };
        Request::new(Recipe::from_json(&text).unwrap(), options).unwrap()
    }

    fn seconds(request: &Request, solver: SolverChoice) -> f64 {
        forecast(request, &Bands::own(&request.recipe), solver, &Observer::idle()).unwrap().seconds
    }

    #[test]
    fn a_forecast_counts_in_that_bands_are_chosen() {
        let plain = request(40, Target::AccuracyPercent(1.0));
        let mut dispersed = plain.clone();
        dispersed.effects = dispersed.effects.union([Effect::Dispersion].into_iter().collect());
        let [with, without] = [&dispersed, &plain].map(|request| seconds(request, SolverChoice::Doubling));
        let choosing = super::super::bands::seconds_to_choose(&dispersed).unwrap();
        let threads = rayon::current_num_threads() as f64;
        assert!(
            choosing > 0.0 && ((with - without) * threads / choosing - 1.0).abs() < 1e-9,
            "{with} {without}"
        );
    }

    #[test]
    fn a_forecast_counts_in_what_is_solved_half_way() {
        // Of the solution and of the coarser one: five incidences and the middles of the four intervals.
        let doubled = request(40, Target::AccuracyPercent(1.0));
        let counts = doubling_counts(&doubled, &doubled.transport().unwrap(), 0.01);
        let incidences = OPERATIONS.iter().position(|name| *name == "incidence").unwrap();
        assert_eq!(counts[incidences], 2.0 * 9.0);
        // A walk of one path takes no time beside its own.
        let walked = request(40, Target::Paths(1));
        let beside = seconds_beside_walk(&walked, &walked.transport().unwrap(), 0.0);
        let threads = rayon::current_num_threads() as f64;
        assert!(beside > 0.0 && seconds(&walked, SolverChoice::Walk) >= beside / threads, "{beside}");
    }

    #[test]
    fn doubling_takes_longer_for_more_layers_incidences_and_accuracy() {
        let of = |layers, percent, degrees: usize| {
            let mut request = request(layers, Target::AccuracyPercent(percent));
            request.grid.incident_deg = (0..=90).step_by(degrees).map(|angle| angle as f64).collect();
            // What the clock says depends on the machine's load.
            request.placing_seconds = 0.0;
            // A faint interior is solved more finely, whatever has how many layers; and what placed the rows is solved once.
            (request.grid.refinements, request.grid.raised, request.placed_by) = (0, 0, Vec::new());
            seconds(&request, SolverChoice::Doubling)
        };
        let base = of(40, 1.0, 10);
        assert!(base > 0.0 && base < of(400, 1.0, 10) && base < of(40, 0.1, 10) && base < of(40, 1.0, 3));
    }
}
