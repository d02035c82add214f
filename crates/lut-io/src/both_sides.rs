//! What `--both-sides` adds to a table: the light that passes, and what becomes of light that comes from below.
//!
//! Four operators describe a nacre between the air above and a body below: R (the table itself), T, R′ and T′. With
//! all four the body can be changed without baking again: R + T′(I − R_body R′)⁻¹ R_body T.

use crate::axis::ExitAxis;
use crate::decay;
use crate::error::FieldError;
use crate::measure;
use crate::table::{Meta, Table};
use serde::{Deserialize, Serialize};
use std::f64::consts::{FRAC_PI_2, PI};

/// Key of the section in the metadata.
pub const KEY: &str = "both_sides";
/// How near, in degrees, an angle of incidence must lie to one of the table to mean it.
const SAME_INCIDENCE_DEG: f64 = 1e-6;

/// One of the three lobes that are stored beside the reflected one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Passage {
    /// T: from above into the substrate.
    Transmitted,
    /// R′: from the substrate back into it.
    BelowReflected,
    /// T′: from the substrate out of the top.
    BelowTransmitted,
}

impl Passage {
    /// All of them, in the order of the enum's discriminants.
    pub const ALL: [Self; 3] = [Self::Transmitted, Self::BelowReflected, Self::BelowTransmitted];

    /// Name of its channel in the file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Transmitted => "transmitted",
            Self::BelowReflected => "below_reflected",
            Self::BelowTransmitted => "below_transmitted",
        }
    }

    /// Name of the channel of its weights.
    #[must_use]
    pub const fn weight_name(self) -> &'static str {
        match self {
            Self::Transmitted => "transmitted_weight_sr",
            Self::BelowReflected => "below_reflected_weight_sr",
            Self::BelowTransmitted => "below_transmitted_weight_sr",
        }
    }
}

/// One number for each [`Passage`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // the fields are the passages
pub struct PerPassage {
    pub transmitted: f64,
    pub below_reflected: f64,
    pub below_transmitted: f64,
}

impl PerPassage {
    /// The number of a passage.
    #[must_use]
    pub const fn of(&self, passage: Passage) -> f64 {
        match passage {
            Passage::Transmitted => self.transmitted,
            Passage::BelowReflected => self.below_reflected,
            Passage::BelowTransmitted => self.below_transmitted,
        }
    }
}

/// What becomes of the light that arrives from below at one angle, and how the stored lobes of this angle are read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FromBelow {
    /// Angle of incidence in the substrate, degrees: those of `per_incidence`.
    pub theta_i_deg: f64,
    /// Share of the light from below that goes back into the substrate.
    pub reflected: f64,
    /// Share that leaves the top.
    pub transmitted: f64,
    /// Share that the layers absorb.
    pub absorbed: f64,
    /// w of the decay postulate of each lobe, degrees (0 in space tables).
    pub azimuth_width_deg: PerPassage,
    /// Estimated total variation of each lobe, per cent of its light.
    pub accuracy_percent: PerPassage,
}

/// Section `both_sides` of the metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BothSides {
    /// Index of the ambient medium.
    pub n_ambient: f64,
    /// Index of the substrate.
    pub n_substrate: f64,
    /// One entry an incidence, in the order of `per_incidence`.
    pub from_below: Vec<FromBelow>,
}

impl BothSides {
    /// The section of a table, if it has one.
    ///
    /// # Errors
    /// The section is there and is not valid.
    pub fn of(meta: &Meta) -> Result<Option<Self>, FieldError> {
        let Some(section) = meta.section::<Self>(KEY)? else { return Ok(None) };
        section.validate(meta)?;
        Ok(Some(section))
    }

    /// Puts the section into a table's metadata.
    ///
    /// # Errors
    /// The section is not valid.
    pub fn store(&self, meta: &mut Meta) -> Result<(), FieldError> {
        self.validate(meta)?;
        meta.put_section(KEY, self)
    }

    /// The direction of a passage's smooth counterpart at θi, radians: where its cells are finest. Past the critical angle
    /// it is the horizon.
    #[must_use]
    pub fn specular(&self, passage: Passage, theta_i: f64) -> f64 {
        let refracted = |ratio: f64| (ratio * theta_i.sin()).min(1.0).asin().min(FRAC_PI_2);
        match passage {
            Passage::Transmitted => refracted(self.n_ambient / self.n_substrate),
            Passage::BelowReflected => theta_i,
            Passage::BelowTransmitted => refracted(self.n_substrate / self.n_ambient),
        }
    }

    /// Reading weights of a passage at every incidence, as [`measure::reading_weights`], incidence-major.
    #[must_use]
    pub fn weights(&self, passage: Passage, axis: &ExitAxis) -> Vec<f32> {
        let each = self.from_below.iter().flat_map(|below| {
            let specular = self.specular(passage, below.theta_i_deg.to_radians());
            let width = below.azimuth_width_deg.of(passage).to_radians();
            measure::reading_weights(axis, specular, width)
        });
        each.map(|weight| weight as f32).collect()
    }

    fn validate(&self, meta: &Meta) -> Result<(), FieldError> {
        for (name, n) in [("n_ambient", self.n_ambient), ("n_substrate", self.n_substrate)] {
            if !(n.is_finite() && n > 0.0) {
                return Err(FieldError::new(
                    format!("{KEY}.{name}"),
                    format!("is {n}, expected a positive number"),
                ));
            }
        }
        let (found, expected) = (self.from_below.len(), meta.per_incidence.len());
        if found != expected {
            let problem = format!("has {found} entries, expected {expected}, one for each of per_incidence");
            return Err(FieldError::new(format!("{KEY}.from_below"), problem));
        }
        for (i, (below, above)) in self.from_below.iter().zip(&meta.per_incidence).enumerate() {
            let at = |name: &str| format!("{KEY}.from_below[{i}].{name}");
            if below.theta_i_deg.to_bits() != above.theta_i_deg.to_bits() {
                let problem = format!("is {}, expected {}", below.theta_i_deg, above.theta_i_deg);
                return Err(FieldError::new(at("theta_i_deg"), problem));
            }
            // Shares are sums of many roundings; beyond 1e-6 it is not rounding any more.
            for (name, value) in [
                ("reflected", below.reflected),
                ("transmitted", below.transmitted),
                ("absorbed", below.absorbed),
            ] {
                if !(-1e-6..=1.0 + 1e-6).contains(&value) {
                    return Err(FieldError::new(
                        at(name),
                        format!("is {value}, expected a share from 0 to 1"),
                    ));
                }
            }
            for passage in Passage::ALL {
                let (width, accuracy) =
                    (below.azimuth_width_deg.of(passage), below.accuracy_percent.of(passage));
                let least = if meta.exit_axis.rows_per_incidence() == 1 { 1e-6 } else { 0.0 };
                if !(least..=1e6).contains(&width) {
                    let problem = format!("is {width}, expected a width in degrees from {least} to 1e6");
                    return Err(FieldError::new(
                        at(&format!("azimuth_width_deg.{}", passage.name())),
                        problem,
                    ));
                }
                if !(accuracy.is_finite() && accuracy >= 0.0) {
                    let problem = format!("is {accuracy}, expected a number ≥ 0");
                    return Err(FieldError::new(
                        at(&format!("accuracy_percent.{}", passage.name())),
                        problem,
                    ));
                }
            }
        }
        Ok(())
    }
}

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
    let (Some(section), Some(lobes)) = (BothSides::of(&table.meta)?, &table.passages) else {
        let problem = "is not in this table, expected one baked with --both-sides";
        return Err(FieldError::new(format!("lobe {}", passage.name()), problem));
    };
    let near = |below: &FromBelow| (below.theta_i_deg - theta_i_deg).abs() <= SAME_INCIDENCE_DEG;
    let Some(incidence) = section.from_below.iter().position(near) else {
        let problem = format!("is {theta_i_deg}, expected a stored incidence: {}", section.angles());
        return Err(FieldError::new("--theta-i", problem));
    };
    if !(-180.0..=180.0).contains(&phi_deg) {
        return Err(FieldError::new("--phi", format!("is {phi_deg}, expected -180 to 180")));
    }
    let below = &section.from_below[incidence];
    let axis = &table.meta.exit_axis;
    let specular = section.specular(passage, below.theta_i_deg.to_radians());
    let cells = incidence * axis.cells()..(incidence + 1) * axis.cells();
    let lobe = Row { axis, specular, values: &lobes[passage as usize][cells] };
    let width = below.azimuth_width_deg.of(passage).to_radians();
    let phi = phi_deg.abs().to_radians();
    let exits: Vec<f64> = lobe.exits(phi);
    Ok(PassageSlice {
        theta_i_deg: below.theta_i_deg,
        phi_deg: phi_deg.abs(),
        value: exits.iter().map(|theta_o| lobe.at(*theta_o, phi, width)).collect(),
        theta_o_deg: exits.iter().map(|theta_o| theta_o.to_degrees()).collect(),
    })
}

impl BothSides {
    fn angles(&self) -> String {
        let few = self.from_below.iter().take(8).map(|below| below.theta_i_deg.to_string());
        let mut text = few.collect::<Vec<_>>().join(", ");
        if let [_, .., last] = self.from_below.as_slice()
            && self.from_below.len() > 8
        {
            text.push_str(&format!(", … {}", last.theta_i_deg));
        }
        text
    }
}

/// The cells of one incidence.
struct Row<'a> {
    axis: &'a ExitAxis,
    specular: f64,
    values: &'a [f32],
}

impl Row<'_> {
    /// Cell centres in θo: in the plane those of the half that φ lies in.
    fn exits(&self, phi: f64) -> Vec<f64> {
        let centres = self.axis.columns_at(self.specular).centres();
        if self.axis.rows_per_incidence() > 1 {
            return centres;
        }
        if phi == PI {
            return centres.iter().rev().filter(|s| **s < 0.0).map(|s| -s).collect();
        }
        centres.into_iter().filter(|s| *s >= 0.0).collect()
    }

    /// Linear in position between cell centres, `row` of the φ cells.
    fn along(&self, row: usize, angle: f64) -> f64 {
        let columns = self.axis.columns_at(self.specular);
        let (cell, fraction) = measure::neighbours(columns.position(angle), columns.cells);
        let value = |k: usize| f64::from(self.values[row * columns.cells + k]);
        (1.0 - fraction) * value(cell) + fraction * value(cell + 1)
    }

    fn at(&self, theta_o: f64, phi: f64, width: f64) -> f64 {
        let Some(azimuths) = self.axis.phi_at(self.specular) else {
            let d = decay::decay(decay::concentration(self.specular, theta_o, width), phi.cos());
            return self.along(0, theta_o) * d + self.along(0, -theta_o) * (1.0 - d);
        };
        let (row, fraction) = measure::neighbours(azimuths.position(phi), azimuths.cells);
        (1.0 - fraction) * self.along(row, theta_o) + fraction * self.along(row + 1, theta_o)
    }
}
