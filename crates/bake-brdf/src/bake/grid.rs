//! The grid of a table: at which incidences it has rows, and into which cells of exit directions each is divided.

use super::{BakeError, Request, bands, exit_axis, placing};
use crate::options::{OptionError, check_incidences};
use lut_io::axis::ExitAxis;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use transport::doubling::{Checked, DoublingError, Operator, Solution, Wanted};
use transport::{Geometry, Light, Transport};

/// Shares of the accuracy asked for that reading between rows, and between cells, may take: more for cells where there are two
/// dimensions of them. What is left is the solver's.
pub(super) const fn reading_shares(axis: &ExitAxis) -> [f64; 2] {
    match axis {
        ExitAxis::Plane { .. } => [0.35, 0.35],
        ExitAxis::Space { .. } => [0.25, 0.45],
    }
}

/// Lobes by which a grid is placed are this much more accurate than what they decide, and as much again with each refinement, within
/// bounds. The solver is as fine: what is left of a lobe's ringing is missed between rows and cells, too.
const FINER: f64 = 0.3;
const LOBE_SHARES: [f64; 2] = [2e-6, 5e-3];
/// Share of the accuracy asked for that the solver may take: where its estimate comes to less, it is not made finer.
const SOLVER_MOST: f64 = 0.2;
/// Total variation of lobes that are not made finer for ringing that is left.
const FINEST_ATTEMPT: f64 = 2e-5;
/// Root of a share of all light below which a component makes the lobes finer; above, they are fine enough.
const FAINT: f64 = 0.15;
/// Rows or cells that miss this much more than they may are placed by finer lobes, so often at most.
const FAR: f64 = 1.2;
const ATTEMPTS: u32 = 3;
/// The solver is made finer at most so often.
pub(super) const MOST_REFINEMENTS: u32 = 6;
/// Lobes that decide a grid are made finer at most so often where they are not accurate enough.
pub(super) const MOST_RAISED: u32 = 4;
/// Bytes that solved stacks, fine and coarse, may take to be kept from placing rows to solving them.
const KEPT: f64 = (1u64 << 30) as f64;
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
    /// How often the resolution for that was found too coarse on the way.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub raised: u32,
}

#[allow(clippy::trivially_copy_pass_by_ref)] // as serde calls it
const fn is_zero(count: &u32) -> bool {
    *count == 0
}

/// Total variation of the lobes that decide a grid, and of those that are stored, refined so often.
fn lobe_share(axis: &ExitAxis, accuracy: f64, refinements: u32) -> f64 {
    let [rows, cells] = reading_shares(axis);
    let share = FINER.powi(1 + refinements as i32) * rows.min(cells) * accuracy;
    // Finer than rounding allows is asked for of no lobe, unless the accuracy itself is.
    share.max(LOBE_SHARES[0].min(0.5 * accuracy)).min(LOBE_SHARES[1])
}

/// What lobes that decide a grid, and those that are stored, are solved to.
fn wanted(axis: &ExitAxis, accuracy: f64, refinements: u32, raised: u32) -> Wanted {
    let aim = lobe_share(axis, accuracy, refinements);
    Wanted { aim, most: aim.max(SOLVER_MOST * accuracy), raised }
}

impl Grid {
    /// From JSON text.
    pub(super) fn from_json(text: &str) -> Result<Self, String> {
        let grid: Self = serde_json::from_str(text).map_err(|why| format!("its grid: {why}"))?;
        grid.axis.validate().map_err(|why| format!("its grid: {why}"))?;
        check_incidences(&grid.incident_deg).map_err(|why| format!("its grid: {why}"))?;
        Ok(grid)
    }

    /// Total variation that doubling is asked for where a table is wanted to an accuracy (shares of all light).
    pub(super) fn solver_wanted(&self, accuracy: f64) -> Wanted {
        wanted(&self.axis, accuracy, self.refinements, self.raised)
    }

    /// The grid that a request asks for: its own incidences or as few as its accuracy takes, and as few cells as that takes. A
    /// function of the request alone. With it the stacks that were solved for it. Stops soon after `stop` is set.
    ///
    /// # Errors
    /// A bad request; [`BakeError::Interrupted`].
    pub(super) fn of(stop: &AtomicBool, request: &Request) -> Result<(Self, Vec<Arc<Checked>>), BakeError> {
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
                raised: 0,
            }
        };
        let first = exit_axis(geometry, slope_sd);
        let first = options.cells.map_or(first, |cells| with_cells(first, cells));
        first.validate().map_err(|why| OptionError::new("cells", why.to_string()))?;
        let both_given = options.incident_deg.is_some() && options.cells.is_some();
        if !request.effects.has_lobe() || slope_sd == 0.0 || both_given {
            return Ok((listed(first), Vec::new()));
        }
        let problems = problems(request, transport)?;
        let azimuth = request.recipe.azimuth;
        let accuracy = options.target.share();
        let shares = reading_shares(&first).map(|share| share * accuracy);
        let mut best = None;
        // What is left of a lobe's ringing is missed between any cells and rows: then the lobes have to be finer, and the solver.
        for attempt in 0..ATTEMPTS {
            let solved = problems.iter().map(|of| lobes(stop, of, geometry, &first, accuracy, attempt));
            let solved = solved.collect::<Result<Vec<_>, BakeError>>()?;
            let Some(solved) = solved.into_iter().collect::<Option<Vec<_>>>() else { break };
            let refinements = solved.iter().map(|lobes| lobes.refinements).max().unwrap_or(attempt);
            let raised = solved.iter().map(|lobes| lobes.raised).max().unwrap_or(0);
            let needed =
                solved.iter().map(|lobes| placing::cells(stop, &first, azimuth, shares[1], &lobes.probed));
            let (axis, between_cells) = match options.cells {
                Some(_) => (first, 0.0),
                None => {
                    let needed = needed.collect::<Result<Vec<_>, BakeError>>()?;
                    needed.into_iter().max_by_key(|(axis, _)| axis.cells()).unwrap_or((first, 0.0))
                }
            };
            let operators = solved.iter().map(|lobes| lobes.checked.operator());
            let (grid, between_rows) = match options.incident_deg {
                Some(_) => (listed(axis), 0.0),
                None => {
                    let (incident_deg, missed) = placing::rows(stop, &axis, azimuth, shares[0], operators)?;
                    (Self { incident_deg, ..listed(axis) }, missed)
                }
            };
            let kept = between_cells <= FAR * shares[1] && between_rows <= FAR * shares[0];
            let mut room = KEPT;
            let fits = |checked: &Checked| {
                room -= checked.bytes();
                room >= 0.0
            };
            let solved = solved.into_iter().map(|lobes| lobes.checked).take_while(fits);
            best = Some((Self { refinements, raised, ..grid }, solved.map(Arc::new).collect()));
            if kept || lobe_share(&first, accuracy, refinements) <= FINEST_ATTEMPT {
                break;
            }
        }
        Ok(best.unwrap_or_else(|| (listed(first), Vec::new())))
    }
}

/// What decides the grid of one problem.
struct Lobes {
    checked: Checked,
    /// Solved at the probes of the cells.
    probed: Solution,
    /// How often they were made finer, for the attempt and for the sake of their faintest component.
    refinements: u32,
    /// How often their resolution was made finer, for what they were not accurate enough.
    raised: u32,
}

/// Lobes to decide a grid of such an axis by, refined so often; none where they cost too much.
fn lobes(
    stop: &AtomicBool,
    transport: &Transport,
    geometry: Geometry,
    axis: &ExitAxis,
    accuracy: f64,
    refinements: u32,
) -> Result<Option<Lobes>, BakeError> {
    let probes: Vec<f64> = placing::probes(axis).iter().map(|probe| probe.theta_i).collect();
    let operator = |refinements, raised| -> Result<Option<Operator>, BakeError> {
        let settings = wanted(axis, accuracy, refinements, raised).settings(transport, geometry);
        if settings.cost(transport, geometry, SOLVED).seconds > AFFORDABLE {
            return Ok(None);
        }
        match Operator::new_unless(stop, transport, geometry, &settings) {
            Err(DoublingError::Domain { .. } | DoublingError::TooCostly { .. }) => Ok(None),
            operator => Ok(Some(operator?)),
        }
    };
    let Some(mut first) = operator(refinements, 0)? else { return Ok(None) };
    let mut refinements = refinements;
    // A faint component is judged by the root of its share: its lobes have to be finer by as much.
    let faintest = placing::faintest(&first.solve_unless(stop, &probes)?);
    if faintest < FAINT {
        let finer = (refinements + (faintest.ln() / FINER.ln()).ceil() as u32).min(MOST_REFINEMENTS);
        if let Some(fine) = operator(finer, 0)? {
            (first, refinements) = (fine, finer);
        }
    }
    // Lobes that ring would be given cells for their ringing.
    let most = wanted(axis, accuracy, refinements, 0).most;
    let mut checked = Checked::new_unless(stop, first)?;
    let mut raised = 0;
    loop {
        let probed = checked.solve_unless(stop, &probes)?;
        let known = probed.error.as_ref().is_some_and(|error| error.worst() <= most);
        let finer = if known || raised == MOST_RAISED { None } else { operator(refinements, raised + 1)? };
        let Some(finer) = finer else { return Ok(Some(Lobes { checked, probed, refinements, raised })) };
        checked = checked.raised(finer);
        raised += 1;
    }
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
