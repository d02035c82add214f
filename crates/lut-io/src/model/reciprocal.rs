//! Section `reciprocal`: the table is read at the larger of its two angles, and is the same both ways.
//!
//! Write F = f·cos θi·cos θo; of a table it is v(θi → θo)·cos θi, v the stored f·cos θo. With this section
//! F(a, b) = v(larger → smaller)·cos larger: reciprocal by construction, between its nodes too, and finite at grazing.
//! [`crate::symmetrise`] makes such a table of any other.

use super::summary::IncidenceSummary;
use crate::error::{FieldError, check, ensure};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// Key of the section in the metadata.
pub const KEY: &str = "reciprocal";
/// Steps of θi at which a table says how much light is read: a quarter of a degree each.
pub const STEPS: usize = 360;

/// What making a table reciprocal changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Reciprocal {
    /// Largest total variation between the table before and after, per cent of the reflected light.
    pub moved_percent: f64,
    /// Largest relative difference between the reflected light as read at the larger angle and its albedo, per cent.
    pub albedo_percent: f64,
    /// Light of the interior lobe as read, less its albedo, at [`STEPS`] equal steps of θi from 0 to 90°.
    pub interior_gain: Vec<f64>,
    /// The same of the rehit lobe.
    pub rehit_gain: Vec<f64>,
}

impl Reciprocal {
    /// Light of interior and rehit as read, less their albedos, at θi (radians): linear between the steps.
    #[must_use]
    pub fn gain(&self, theta_i: f64) -> [f64; 2] {
        let step = (theta_i / FRAC_PI_2).clamp(0.0, 1.0) * STEPS as f64;
        let k = (step as usize).min(STEPS - 1);
        let t = step - k as f64;
        [&self.interior_gain, &self.rehit_gain].map(|gain| gain[k] * (1.0 - t) + gain[k + 1] * t)
    }

    /// Checks the section of a table with these incidences.
    pub(super) fn validate(&self, per_incidence: &[IncidenceSummary]) -> Result<(), FieldError> {
        check("moved_percent", self.moved_percent, self.moved_percent >= 0.0, "a number ≥ 0")?;
        check("albedo_percent", self.albedo_percent, self.albedo_percent >= 0.0, "a number ≥ 0")?;
        for (name, gain) in [("interior_gain", &self.interior_gain), ("rehit_gain", &self.rehit_gain)] {
            let shares = gain.iter().all(|share| (-1.0..=1.0).contains(share));
            ensure(name, gain.len() == STEPS + 1 && shares, || {
                format!("is not {} numbers from -1 to 1", STEPS + 1)
            })?;
        }
        let first = per_incidence[0].azimuth_width_deg;
        per_incidence.iter().map(|s| s.azimuth_width_deg).try_for_each(|width| {
            ensure("azimuth_width_deg", width == first, || {
                format!("is {first} and {width}, expected the same at all incidences")
            })
        })
    }
}
