//! The grid of a table: at which incidences it has rows, and into which cells of exit directions each is divided.

use super::{BakeError, COARSEST_DOUBLING, Request, exit_axis, placing};
use crate::options::{OptionError, check_incidences};
use lut_io::axis::ExitAxis;
use serde::{Deserialize, Serialize};
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

/// Lobes by which a grid is placed are this much more accurate than what they decide, within bounds.
const FINER: f64 = 0.3;
const LOBE_SHARES: [f64; 2] = [2e-5, 5e-3];
/// Root of a share of all light below which a component makes the lobes finer; above, they are fine enough.
const FAINT: f64 = 0.15;
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
}

impl Grid {
    /// From JSON text.
    pub(super) fn from_json(text: &str) -> Result<Self, String> {
        let grid: Self = serde_json::from_str(text).map_err(|why| format!("its grid: {why}"))?;
        grid.axis.validate().map_err(|why| format!("its grid: {why}"))?;
        check_incidences(&grid.incident_deg).map_err(|why| format!("its grid: {why}"))?;
        Ok(grid)
    }

    /// The grid that a request asks for: its own incidences or as few as its accuracy takes, and as few cells as that takes. A
    /// function of the request alone.
    ///
    /// # Errors
    /// A bad request.
    pub(super) fn of(request: &Request) -> Result<Self, BakeError> {
        let options = &request.options;
        options.check()?;
        let transport = request.transport()?;
        let (geometry, slope_sd) = (request.geometry(), transport.facets.slope_sd);
        let listed = |axis| {
            let every_degree = || (0..=90).map(f64::from).collect();
            Self { incident_deg: options.incident_deg.clone().unwrap_or_else(every_degree), axis }
        };
        let first = exit_axis(geometry, slope_sd);
        let first = options.cells.map_or(first, |cells| with_cells(first, cells));
        first.validate().map_err(|why| OptionError::new("cells", why.to_string()))?;
        let both_given = options.incident_deg.is_some() && options.cells.is_some();
        if !request.effects.has_lobe() || slope_sd == 0.0 || both_given {
            return Ok(listed(first));
        }
        let share = options.target.share();
        let transport = stand_in(request, transport)?;
        let Some((operator, probed)) = lobes(&transport, geometry, &first, share)? else {
            return Ok(listed(first));
        };
        let azimuth = request.recipe.azimuth;
        let [rows_share, cells_share] = reading_shares(&first);
        let axis = match options.cells {
            Some(_) => first,
            None => placing::cells(&first, azimuth, cells_share * share, &probed),
        };
        if options.incident_deg.is_some() {
            return Ok(listed(axis));
        }
        Ok(Self { incident_deg: placing::rows(&axis, azimuth, rows_share * share, &operator)?, axis })
    }
}

/// Lobes fine enough to decide a grid of such an axis, solved at the probes of its cells, and what solves more of them; none where they
/// cost too much.
fn lobes(
    transport: &Transport,
    geometry: Geometry,
    axis: &ExitAxis,
    share: f64,
) -> Result<Option<(Operator, Solution)>, BakeError> {
    let probes = placing::probes(axis);
    let solved = |finer: f64| -> Result<Option<(Operator, Solution)>, BakeError> {
        let settings = Settings::for_accuracy(transport, geometry, finer.max(LOBE_SHARES[0]));
        if settings.cost(transport, geometry, SOLVED).seconds > AFFORDABLE {
            return Ok(None);
        }
        let operator = match Operator::new(transport, geometry, &settings) {
            Err(DoublingError::Domain { .. } | DoublingError::TooCostly { .. }) => return Ok(None),
            operator => operator?,
        };
        let probed = operator.solve(&probes)?;
        Ok(Some((operator, probed)))
    };
    let [rows_share, cells_share] = reading_shares(axis);
    let finer = (FINER * rows_share.min(cells_share) * share).min(LOBE_SHARES[1].min(COARSEST_DOUBLING));
    let Some(coarse) = solved(finer)? else { return Ok(None) };
    // A faint component is judged by the root of its share: its lobes have to be finer by as much.
    let faintest = placing::faintest(&coarse.1);
    let fine = if faintest < FAINT { solved(finer * faintest)? } else { None };
    Ok(Some(fine.unwrap_or(coarse)))
}

const fn with_cells(axis: ExitAxis, [columns, rows]: [usize; 2]) -> ExitAxis {
    match axis {
        ExitAxis::Plane { width, .. } => ExitAxis::Plane { cells: columns, width },
        ExitAxis::Space { width, .. } => ExitAxis::Space { theta_cells: columns, phi_cells: rows, width },
    }
}

/// A problem with a like lobe that doubling can solve: unpolarised for tracked light, interfaces for coherent sheets.
fn stand_in(request: &Request, mut transport: Transport) -> Result<Transport, BakeError> {
    if transport.sheets.is_some() {
        transport = request.recipe.transport(request.recipe.wavelength())?;
    }
    transport.light = Light::Unpolarised;
    Ok(transport)
}
