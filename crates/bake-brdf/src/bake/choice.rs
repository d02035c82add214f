//! `--solver auto`: the cheaper solver, by counting operations.
//!
//! Nothing is timed. The doubling's cost comes from [`Settings::cost`], the walk's from the crossings and
//! paths that a few scouts find it needs; both in seconds of the same core. So the choice, and with it the bytes of the
//! table, depend on the request alone: not on the machine, its load, or the number of threads.

use super::{BakeError, COARSEST_DOUBLING, Request, SolverChoice, Target, sampling, walk_only};
use transport::doubling::Settings;
use transport::walk::lanes::Precision;
use transport::{Geometry, Normals, Transport};

/// Nanoseconds of one AVX-512 core a crossing (32 bits, no effect), and a path: its start, its end and its place in the
/// tally. `docs/WALK.md`, "Speed".
const PLANE_CROSSING: f64 = 1.5;
const SPACE_CROSSING: f64 = 1.8;
const PATH: f64 = 150.0;
/// Factors of the effects on a crossing (`bake-brdf study`).
const DOUBLE_PRECISION: f64 = 1.8;
const VISIBLE: f64 = 1.4;
const ABSORBING: f64 = 1.2;
/// Seconds that an incidence's lobe takes to become a row of the table, doubling.
const PLANE_ROW: f64 = 1e-4;
const SPACE_ROW: f64 = 2e-3;
/// What the second, coarser resolution of doubling adds to the first.
const ERROR_ESTIMATE: f64 = 0.6;

/// Which solver is cheaper for a request, and why in one sentence.
///
/// # Errors
/// A bad request.
pub fn choose_solver(request: &Request) -> Result<(SolverChoice, String), BakeError> {
    request.check()?;
    let Target::AccuracyPercent(percent) = request.target else {
        let reason = "paths or a time budget were asked for, which only the walk has".to_owned();
        return Ok((SolverChoice::Walk, reason));
    };
    let transport = request.transport()?;
    if let Some(why) = walk_only(&transport) {
        return Ok((SolverChoice::Walk, why.to_owned()));
    }
    if transport.facets.slope_sd == 0.0 {
        return Ok((SolverChoice::Doubling, "smooth interfaces have a closed form".to_owned()));
    }
    let share = (percent / 100.0).min(COARSEST_DOUBLING);
    let settings = Settings::for_accuracy(&transport, request.geometry(), share);
    if let Err(why) = settings.check(&transport, request.geometry(), &request.theta_i()) {
        return Ok((SolverChoice::Walk, format!("doubling is out of reach here: {why}")));
    }
    let bands = 1 + request.bands()?.further_nm.len();
    let by_doubling = bands as f64 * doubling_seconds(request, &transport, &settings);
    let by_walk = walk_seconds(request, &transport, percent / 100.0)?;
    let choice = if by_doubling <= by_walk { SolverChoice::Doubling } else { SolverChoice::Walk };
    let reason = format!(
        "doubling would take about {by_doubling:.2} s of one core, with {} nodes, the walk {by_walk:.2} s",
        settings.nodes
    );
    Ok((choice, reason))
}

/// Seconds of one core that doubling takes, its error estimate and the table included.
fn doubling_seconds(request: &Request, transport: &Transport, settings: &Settings) -> f64 {
    let geometry = request.geometry();
    let incidences = request.incident_deg.len();
    let row = if geometry == Geometry::Plane { PLANE_ROW } else { SPACE_ROW };
    (1.0 + ERROR_ESTIMATE) * settings.cost(transport, geometry, incidences).seconds + row * incidences as f64
}

/// Seconds of one core that a walk to `accuracy` (a share) takes.
fn walk_seconds(request: &Request, transport: &Transport, accuracy: f64) -> Result<f64, BakeError> {
    let effort = sampling::scout(request, accuracy)?;
    let mut crossing = match request.geometry() {
        Geometry::Plane => PLANE_CROSSING,
        Geometry::Space => SPACE_CROSSING,
    };
    if request.precision.resolve(transport) == Precision::F64 {
        crossing *= DOUBLE_PRECISION;
    }
    if transport.facets.normals == Normals::Visible {
        crossing *= VISIBLE;
    }
    if transport.absorbs() {
        crossing *= ABSORBING;
    }
    Ok(1e-9 * (crossing * effort.crossings + PATH * effort.paths))
}
