//! The grid of a table: at which incidences it has rows, and into which cells of exit directions each is divided.

use super::{BakeError, COARSEST_DOUBLING, Request, bands, exit_axis, placing};
use crate::options::{OptionError, check_incidences};
use lut_io::axis::ExitAxis;
use serde::{Deserialize, Serialize};
use std::sync::atomic::AtomicBool;
use transport::doubling::{DoublingError, Operator, Settings, Solution};
use transport::{Geometry, Light, Transport};

/// Shares of the accuracy asked for that reading between rows, and between cells, may take: more for cells where there are two
/// dimensions of them. What is left is the solver's.
pub(super) const fn reading_shares(axis: &ExitAxis) -> [f64; 2] {
    match axis {
        ExitAxis::Plane { .. } => [0.35, 0.35],
        ExitAxis::Space { .. } => [0.25, 0.45],
    }
}

/// Lobes by which a grid is placed are this much more accurate than what they decide, and as much again each time, within bounds.
const FINER: f64 = 0.3;
const LOBE_SHARES: [f64; 2] = [2e-5, 5e-3];
/// Root of a share of all light below which a component makes the lobes finer; above, they are fine enough.
const FAINT: f64 = 0.15;
/// Share of the accuracy asked for that the solver takes of what reading between rows and cells leaves: what it leaves of ringing is
/// missed between rows and cells, too, so that it is about as fine as the lobes by which they were placed.
const SOLVER_SHARE: f64 = 0.1;
/// Total variation at which rounding begins to end what more nodes do.
const FINEST_DOUBLING: f64 = 2e-6;
/// Rows or cells that miss this much more than they may are placed by finer lobes, so often at most.
const FAR: f64 = 1.2;
const ATTEMPTS: u32 = 3;
/// The solver is made finer at most so often.
pub(super) const MOST_REFINEMENTS: u32 = 4;
/// Seconds of one core that one solution of the lobes may take; incidences of one.
const AFFORDABLE: f64 = 10.0;
const SOLVED: usize = 100;

/// The grid of a table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Grid {
    /// Angles of incidence, degrees, ascending.
    pub incident_deg: Vec<f64>,
    /// Exit cells of each.
    pub axis: ExitAxis,
    /// How often the lobes that placed them had to be made finer: the solver is as much finer than usual.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub refinements: u32,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl Grid {
    /// From JSON text.
    pub(super) fn from_json(text: &str) -> Result<Self, String> {
        let grid: Self = serde_json::from_str(text).map_err(|why| format!("its grid: {why}"))?;
        grid.axis.validate().map_err(|why| format!("its grid: {why}"))?;
        check_incidences(&grid.incident_deg).map_err(|why| format!("its grid: {why}"))?;
        Ok(grid)
    }

    /// Total variation that doubling is asked for where a table is wanted to an accuracy (both shares of all light).
    pub(super) fn solver_share(&self, accuracy: f64) -> f64 {
        let share = SOLVER_SHARE * accuracy * FINER.powi(self.refinements as i32);
        share.max(FINEST_DOUBLING.min(0.5 * accuracy)).min(COARSEST_DOUBLING)
    }

    /// The grid that a request asks for: its own incidences or as few as its accuracy takes, and as few cells as that takes. A
    /// function of the request alone. Stops soon after `stop` is set.
    ///
    /// # Errors
    /// A bad request; [`BakeError::Interrupted`].
    pub(super) fn of(stop: &AtomicBool, request: &Request) -> Result<Self, BakeError> {
        let options = &request.options;
        options.check()?;
        let transport = request.transport()?;
        let (geometry, slope_sd) = (request.geometry(), transport.facets.slope_sd);
        let listed = |axis| {
            let every_degree = || (0..=90).map(f64::from).collect();
            Self {
                incident_deg: options.incident_deg.clone().unwrap_or_else(every_degree),
                axis,
                refinements: 0,
            }
        };
        let first = exit_axis(geometry, slope_sd);
        let first = options.cells.map_or(first, |cells| with_cells(first, cells));
        first.validate().map_err(|why| OptionError::new("cells", why.to_string()))?;
        let both_given = options.incident_deg.is_some() && options.cells.is_some();
        if !request.effects.has_lobe() || slope_sd == 0.0 || both_given {
            return Ok(listed(first));
        }
        let problems = problems(request, transport)?;
        let azimuth = request.recipe.azimuth;
        let shares = reading_shares(&first).map(|share| share * options.target.share());
        let mut best: Option<Self> = None;
        // What is left of a lobe's ringing is missed between any cells and rows: then the lobes have to be finer, and the solver.
        for attempt in 0..ATTEMPTS {
            let finer = FINER * shares[0].min(shares[1]) * FINER.powi(attempt as i32);
            let solved = problems.iter().map(|transport| lobes(stop, transport, geometry, &first, finer));
            let solved = solved.collect::<Result<Vec<_>, BakeError>>()?;
            let Some(solved) = solved.into_iter().collect::<Option<Vec<_>>>() else { break };
            let faintest = solved.iter().map(|lobes| lobes.faintest).fold(1.0, f64::min);
            let needed =
                solved.iter().map(|lobes| placing::cells(stop, &first, azimuth, shares[1], &lobes.probed));
            let (axis, between_cells) = match options.cells {
                Some(_) => (first, 0.0),
                None => {
                    let needed = needed.collect::<Result<Vec<_>, BakeError>>()?;
                    needed.into_iter().max_by_key(|(axis, _)| axis.cells()).unwrap_or((first, 0.0))
                }
            };
            let operators = solved.iter().map(|lobes| &lobes.operator);
            let (grid, between_rows) = match options.incident_deg {
                Some(_) => (listed(axis), 0.0),
                None => {
                    let (incident_deg, missed) = placing::rows(stop, &axis, azimuth, shares[0], operators)?;
                    (Self { incident_deg, axis, refinements: 0 }, missed)
                }
            };
            // Half of what the faintest component took: of its own error the solver takes a tenth anyway.
            let refinements = attempt + (0.5 * faintest.ln() / FINER.ln()) as u32;
            best = Some(Self { refinements: refinements.min(MOST_REFINEMENTS), ..grid });
            let kept = between_cells <= FAR * shares[1] && between_rows <= FAR * shares[0];
            if kept || finer * faintest <= LOBE_SHARES[0] {
                break;
            }
        }
        Ok(best.unwrap_or_else(|| listed(first)))
    }
}

/// What decides the grid of one problem.
struct Lobes<'s> {
    operator: Operator<'s>,
    /// Solved at the probes of the cells.
    probed: Solution,
    /// By how much they are finer for the sake of their faintest component.
    faintest: f64,
}

/// Lobes to decide a grid of such an axis by, to such an accuracy within bounds; none where they cost too much.
fn lobes<'s>(
    stop: &'s AtomicBool,
    transport: &Transport,
    geometry: Geometry,
    axis: &ExitAxis,
    finer: f64,
) -> Result<Option<Lobes<'s>>, BakeError> {
    let probes = placing::probes(axis);
    let solved = |finer: f64, faintest: f64| -> Result<Option<Lobes<'s>>, BakeError> {
        let settings = Settings::for_accuracy(transport, geometry, (finer * faintest).max(LOBE_SHARES[0]));
        if settings.cost(transport, geometry, SOLVED).seconds > AFFORDABLE {
            return Ok(None);
        }
        let operator = match Operator::new_unless(stop, transport, geometry, &settings) {
            Err(DoublingError::Domain { .. } | DoublingError::TooCostly { .. }) => return Ok(None),
            operator => operator?,
        };
        let probed = operator.solve(&probes)?;
        Ok(Some(Lobes { operator, probed, faintest }))
    };
    let finer = finer.min(LOBE_SHARES[1].min(COARSEST_DOUBLING));
    let Some(coarse) = solved(finer, 1.0)? else { return Ok(None) };
    // A faint component is judged by the root of its share: its lobes have to be finer by as much.
    let faintest = placing::faintest(&coarse.probed);
    let fine = if faintest < FAINT { solved(finer, faintest)? } else { None };
    Ok(Some(fine.unwrap_or(coarse)))
}

const fn with_cells(axis: ExitAxis, [columns, rows]: [usize; 2]) -> ExitAxis {
    match axis {
        ExitAxis::Plane { width, .. } => ExitAxis::Plane { cells: columns, width },
        ExitAxis::Space { width, .. } => ExitAxis::Space { theta_cells: columns, phi_cells: rows, width },
    }
}

/// What decides a grid: the lobe at the recipe's wavelength, and where it is dispersed at both ends of the wavelengths looked at.
fn problems(request: &Request, own: Transport) -> Result<Vec<Transport>, BakeError> {
    let mut problems = vec![stand_in(request, own)?];
    for nm in bands::ends(request) {
        let request = request.at_wavelength(nm);
        problems.push(stand_in(&request, request.transport()?)?);
    }
    Ok(problems)
}

/// A problem with a like lobe that doubling can solve: unpolarised for tracked light, interfaces for coherent sheets.
fn stand_in(request: &Request, mut transport: Transport) -> Result<Transport, BakeError> {
    if transport.sheets.is_some() {
        transport = request.recipe.transport(request.recipe.wavelength())?;
    }
    transport.light = Light::Unpolarised;
    Ok(transport)
}
