//! Cuts through the lobes of [`crate::both_sides`]: one stored θi, one azimuth, all exit angles.

use crate::error::FieldError;
use crate::model::both_sides::{BothSides, FromBelow, Passage};
use crate::model::table::Table;
use crate::read::lobe::Cells;
use std::f64::consts::PI;

/// How near, in degrees, an angle of incidence must lie to one of the table to mean it.
const SAME_INCIDENCE_DEG: f64 = 1e-6;

/// A cut through one of the lobes: one stored θi, one azimuth, all exit angles.
#[derive(Clone, Debug, PartialEq)]
pub struct PassageSlice {
    /// Angle of incidence, degrees (in the substrate for light from below).
    pub theta_i_deg: f64,
    /// Azimuth of exit from the forward direction, degrees, 0 to 180.
    pub phi_deg: f64,
    /// Polar angle of exit, degrees, ascending.
    pub theta_o_deg: Vec<f64>,
    /// f·cos θo, 1/sr in the medium of exit.
    pub value: Vec<f64>,
}

/// Cuts the lobe of a passage at a stored θi and any φ (degrees, −180 to 180; the lobe is even in φ).
///
/// # Errors
/// The table has no second side, or no such incidence.
pub fn slice(
    table: &Table,
    passage: Passage,
    theta_i_deg: f64,
    phi_deg: f64,
) -> Result<PassageSlice, FieldError> {
    let (Some(section), Some(values)) = (&table.meta().both_sides, table.passage(passage)) else {
        let problem = "is not in this table, expected one with the section both_sides";
        return Err(FieldError::new(format!("lobe {}", passage.name()), problem));
    };
    let near = |below: &FromBelow| (below.theta_i_deg - theta_i_deg).abs() <= SAME_INCIDENCE_DEG;
    let Some(incidence) = section.from_below.iter().position(near) else {
        let problem = format!("is {theta_i_deg}, expected a stored incidence: {}", angles(section));
        return Err(FieldError::new("theta_i_deg", problem));
    };
    if !(-180.0..=180.0).contains(&phi_deg) {
        return Err(FieldError::new("phi_deg", format!("is {phi_deg}, expected -180 to 180")));
    }
    let below = &section.from_below[incidence];
    let axis = &table.meta().exit_axis;
    let specular = section.specular(passage, below.theta_i_deg.to_radians());
    let (columns, azimuths) = (axis.columns_at(specular), axis.phi_at(specular));
    let lobe = Cells { centre: specular, columns: &columns, phi: azimuths.as_ref() };
    let values = table.at_incidence(values, incidence);
    let cell = |row: usize, column: usize| [f64::from(values[row * columns.cells + column])];
    let width = below.azimuth_width_deg.of(passage).to_radians();
    let phi = phi_deg.abs().to_radians();
    let exits = exits(&lobe, phi);
    Ok(PassageSlice {
        theta_i_deg: below.theta_i_deg,
        phi_deg: phi_deg.abs(),
        value: exits.iter().flat_map(|theta_o| lobe.read(*theta_o, phi, width, cell)).collect(),
        theta_o_deg: exits.iter().map(|theta_o| theta_o.to_degrees()).collect(),
    })
}

/// The stored angles, a few of them.
fn angles(section: &BothSides) -> String {
    let few = section.from_below.iter().take(8).map(|below| below.theta_i_deg.to_string());
    let mut text = few.collect::<Vec<_>>().join(", ");
    if let [_, .., last] = section.from_below.as_slice()
        && section.from_below.len() > 8
    {
        text.push_str(&format!(", … {}", last.theta_i_deg));
    }
    text
}

/// Cell centres in θo: in the plane those of the half that φ lies in.
fn exits(lobe: &Cells<'_>, phi: f64) -> Vec<f64> {
    let centres = lobe.columns.centres();
    if lobe.phi.is_some() {
        return centres;
    }
    if phi == PI {
        return centres.iter().rev().filter(|s| **s < 0.0).map(|s| -s).collect();
    }
    centres.into_iter().filter(|s| *s >= 0.0).collect()
}
