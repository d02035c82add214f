//! How fast this machine is, now and with the threads in use: a short measured solution behind every prediction.
//!
//! The prices of [`super::choice`] say how the cost of doubling grows with its size; what a unit of price takes here is measured on
//! a coarse solution of the same problem, at a few incidences, some hundredths of a second. (The walk has a pilot of its own.)

use super::choice::{ROWS, row_counts, row_prices, solver_seconds};
use super::{BakeError, Request, assemble, exit_axis};
use lut_io::exr_file;
use std::time::Instant;
use transport::Transport;
use transport::doubling::{self, Settings};

/// Incidences of a pilot.
const INCIDENCES: usize = 8;
/// Seconds of one core, by price, that a pilot may take.
const SECONDS: f64 = 0.02;
/// Steps to coarser settings that are tried at most.
const STEPS: usize = 12;

/// What a pilot measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Pilot {
    /// Wall-clock seconds here for a second of the price list, the threads in use counted in.
    slowness: f64,
    /// Wall-clock seconds that a row of the table took, from the solution to the file's bytes.
    row_seconds: f64,
    /// [`ROWS`] of one such row.
    row: [f64; ROWS.len()],
}

impl Pilot {
    /// Solves a request coarsely at a few of its incidences, and makes a table of it.
    ///
    /// # Errors
    /// A problem that doubling does not solve.
    pub(super) fn of(
        request: &Request,
        transport: &Transport,
        settings: &Settings,
    ) -> Result<Self, BakeError> {
        let geometry = request.geometry();
        let every = request.incident_deg.len().div_ceil(INCIDENCES);
        let incident_deg: Vec<f64> = request.incident_deg.iter().copied().step_by(every).collect();
        let few = Request { incident_deg, ..request.clone() };
        let theta_i = few.theta_i();
        let mut coarse = *settings;
        let price = |settings: &Settings| {
            solver_seconds(geometry, &settings.cost(transport, geometry, theta_i.len()).counts)
        };
        for _ in 0..STEPS {
            if price(&coarse) <= SECONDS {
                break;
            }
            coarse = coarse.coarser();
        }
        let started = Instant::now();
        let solution = doubling::solve(transport, geometry, &theta_i, &coarse)?;
        let solved = started.elapsed().as_secs_f64();
        let axis = exit_axis(geometry, transport.facets.slope_sd);
        let started = Instant::now();
        let table = assemble::doubling_table(&few, transport, &axis, &solution, &[]);
        exr_file::encode(&table).map_err(super::invalid)?;
        let rows = theta_i.len();
        Ok(Self {
            slowness: solved / price(&coarse).max(f64::MIN_POSITIVE),
            row_seconds: started.elapsed().as_secs_f64() / rows as f64,
            row: row_counts(&axis, &coarse, 1),
        })
    }

    /// Wall-clock seconds of so many [`transport::doubling::OPERATIONS`] and of the rows of `settings`.
    pub(super) fn seconds(&self, request: &Request, operations: &[f64], settings: &Settings, rows: usize) -> f64 {
        let geometry = request.geometry();
        let axis = exit_axis(geometry, request.recipe.facets.slope_sd_deg.to_radians());
        let prices = row_prices(geometry);
        // Rows of finer settings take more basis values.
        let more: f64 = row_counts(&axis, settings, 1)
            .iter()
            .zip(self.row)
            .zip(prices)
            .map(|((count, here), price)| (count - here) * price)
            .sum();
        let row = (self.row_seconds + self.slowness * more).max(0.0);
        self.slowness * solver_seconds(geometry, operations) + rows as f64 * row
    }
}
