//! A cut through the lobe: one θi, one azimuth, all exit angles.

use crate::error::FieldError;
use crate::model::table::Component;
use crate::read::lobe::{Interpolant, Row};
use std::f64::consts::{FRAC_PI_2, PI};

/// How near, in cells, an azimuth must lie to a φ cell's centre to mean that cell: azimuths are typed or copied
/// from the file's f32 channels with their last digits lost.
const SAME_CELL: f64 = 1e-3;
/// How near, in degrees, an angle of incidence must lie to one of the table to mean it.
const SAME_INCIDENCE_DEG: f64 = 1e-6;

/// f·cos θo along θo at one θi and φ. All vectors are as long as `theta_o_deg`.
#[derive(Clone, Debug, PartialEq)]
pub struct Slice {
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// Azimuth of exit from the mirror direction, degrees, 0 to 180.
    pub phi_deg: f64,
    /// Whether this is a stored incidence and azimuth: then values, errors and counts are the stored numbers, bit
    /// by bit. Elsewhere values and errors are read by the rule of [`crate::lobe`], its correction included.
    pub stored: bool,
    /// Polar angle of exit, degrees, ascending: the centres of the table's cells.
    pub theta_o_deg: Vec<f64>,
    /// The three components.
    pub components: [ComponentSlice; 3],
}

/// One component of a [`Slice`].
#[derive(Clone, Debug, PartialEq)]
pub struct ComponentSlice {
    /// Which one.
    pub component: Component,
    /// f·cos θo, 1/sr.
    pub value: Vec<f64>,
    /// Standard error of `value`, 1/sr.
    pub std_error: Vec<f64>,
    /// Paths in the cell; only of stored slices.
    pub count: Option<Vec<f64>>,
    /// Factor by which the reader multiplies stored numbers here to keep the albedo ([`Row::correction`]).
    pub correction: f64,
}

/// The stored cells that a slice runs through: φ row and columns in the order of ascending θo.
struct Cells {
    row: usize,
    columns: Vec<usize>,
}

impl Slice {
    /// Cuts a table at θi and φ; both in degrees, θi in [0, 90], φ in [−180, 180] (f is even in φ).
    #[must_use]
    pub fn new(lobe: &Interpolant, theta_i_deg: f64, phi_deg: f64) -> Self {
        let per_incidence = &lobe.table().meta().per_incidence;
        let known = per_incidence.iter().find(|s| (s.theta_i_deg - theta_i_deg).abs() <= SAME_INCIDENCE_DEG);
        let theta_i_deg = known.map_or(theta_i_deg, |summary| summary.theta_i_deg);
        let row = lobe.row(theta_i_deg.to_radians());
        let (phi_deg, cells) = stored_azimuth(&row, phi_deg.abs());
        let exits = exit_angles(&row, cells.as_ref());
        let cells = cells.filter(|_| row.stored().is_some());
        let phi = phi_deg.to_radians();
        let components = Component::ALL.map(|component| {
            let samples = lobe.table().lobe(component);
            let pick = |samples: &[f32], cells: &Cells| {
                cells.columns.iter().map(|column| row.cell(samples, cells.row, *column)).collect::<Vec<f64>>()
            };
            let (value, std_error, count) = match &cells {
                Some(cells) => (
                    pick(&samples.value, cells),
                    pick(&samples.std_error, cells),
                    Some(pick(&samples.count, cells)),
                ),
                None => (
                    exits.iter().map(|theta_o| row.eval(component, *theta_o, phi)).collect(),
                    exits.iter().map(|theta_o| row.std_error(component, *theta_o, phi)).collect(),
                    None,
                ),
            };
            ComponentSlice { component, value, std_error, count, correction: row.correction(component) }
        });
        Self {
            theta_i_deg,
            phi_deg,
            stored: cells.is_some(),
            theta_o_deg: exits.iter().map(|theta_o| theta_o.to_degrees()).collect(),
            components,
        }
    }

    /// The component's part of the slice.
    #[must_use]
    pub const fn component(&self, component: Component) -> &ComponentSlice {
        &self.components[component as usize]
    }
}

/// The azimuth, moved onto a stored one if it means that, and the cells there.
fn stored_azimuth(row: &Row<'_>, phi_deg: f64) -> (f64, Option<Cells>) {
    let centres = row.columns().centres();
    let Some(axis) = row.phi() else {
        // The plane of incidence: its forward half ascending, its retro half turned round.
        let columns: Vec<usize> = match phi_deg {
            0.0 => (0..centres.len()).filter(|k| centres[*k] >= 0.0).collect(),
            180.0 => (0..centres.len()).rev().filter(|k| centres[*k] < 0.0).collect(),
            _ => return (phi_deg, None),
        };
        return (phi_deg, Some(Cells { row: 0, columns }));
    };
    let position = axis.position(phi_deg.to_radians()) - 0.5;
    let cell = position.round();
    if (position - cell).abs() > SAME_CELL || cell < 0.0 {
        return (phi_deg, None);
    }
    let columns = (0..centres.len()).collect();
    (axis.at(cell + 0.5).to_degrees(), Some(Cells { row: cell as usize, columns }))
}

fn exit_angles(row: &Row<'_>, cells: Option<&Cells>) -> Vec<f64> {
    let centres = row.columns().centres();
    match cells {
        Some(cells) => cells.columns.iter().map(|column| centres[*column].abs()).collect(),
        // Out of the plane: the forward half's cells, which resolve the lobe.
        None => centres.into_iter().filter(|s| *s >= 0.0).collect(),
    }
}

/// Where in (θi, φ) a slice can be asked for.
///
/// # Errors
/// What is wrong with the angles, for a table that knows the incidences `first..=last` (degrees).
pub fn check_angles(lobe: &Interpolant, theta_i_deg: f64, phi_deg: f64) -> Result<(), FieldError> {
    let per_incidence = &lobe.table().meta().per_incidence;
    let (first, last) = (per_incidence[0].theta_i_deg, per_incidence[per_incidence.len() - 1].theta_i_deg);
    let (lo, hi) = (first - SAME_INCIDENCE_DEG, last + SAME_INCIDENCE_DEG);
    if !(lo..=hi).contains(&theta_i_deg) {
        let problem =
            format!("is {theta_i_deg}, expected an incidence within the table's, {first} to {last}");
        return Err(FieldError::new("theta_i_deg", problem));
    }
    if !(-180.0..=180.0).contains(&phi_deg) {
        return Err(FieldError::new("phi_deg", format!("is {phi_deg}, expected -180 to 180")));
    }
    debug_assert!(hi.to_radians() <= FRAC_PI_2 + 1e-6 && phi_deg.to_radians().abs() <= PI + 1e-9);
    Ok(())
}
