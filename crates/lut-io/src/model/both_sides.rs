//! What `--both-sides` adds to a table: the light that passes, and what becomes of light that comes from below.
//!
//! Four operators describe a nacre between the air above and a body below: R (the table itself), T, R′ and T′. With
//! all four the body can be changed without baking again: R + T′(I − R_body R′)⁻¹ R_body T.

use super::axis::ExitAxis;
use super::measure;
use super::summary::IncidenceSummary;
use crate::error::{FieldError, check, ensure};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// Key of the section in the metadata.
pub const KEY: &str = "both_sides";
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

    /// Estimated total variation of a passage at its worst incidence, per cent.
    #[must_use]
    pub fn accuracy_percent(&self, passage: Passage) -> f64 {
        self.from_below.iter().map(|below| below.accuracy_percent.of(passage)).fold(0.0, f64::max)
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

    /// Checks the section of a table with this exit axis and these incidences.
    pub(super) fn validate(
        &self,
        axis: &ExitAxis,
        per_incidence: &[IncidenceSummary],
    ) -> Result<(), FieldError> {
        for (name, n) in [("n_ambient", self.n_ambient), ("n_substrate", self.n_substrate)] {
            check(name, n, n > 0.0, "a positive number")?;
        }
        let (found, expected) = (self.from_below.len(), per_incidence.len());
        ensure("from_below", found == expected, || {
            format!("has {found} entries, expected {expected}, one for each of per_incidence")
        })?;
        for (i, (below, above)) in self.from_below.iter().zip(per_incidence).enumerate() {
            below.validate(axis, above).map_err(|error| error.within(&format!("from_below[{i}]")))?;
        }
        Ok(())
    }
}

impl FromBelow {
    /// Checks the entry that stands beside that of `above` in a table with this exit axis.
    fn validate(&self, axis: &ExitAxis, above: &IncidenceSummary) -> Result<(), FieldError> {
        let (found, expected) = (self.theta_i_deg, above.theta_i_deg);
        check("theta_i_deg", found, found.to_bits() == expected.to_bits(), &expected.to_string())?;
        let shares =
            [("reflected", self.reflected), ("transmitted", self.transmitted), ("absorbed", self.absorbed)];
        for (name, share) in shares {
            // Shares are sums of many roundings; beyond 1e-6 it is not rounding any more.
            check(name, share, (-1e-6..=1.0 + 1e-6).contains(&share), "a share from 0 to 1")?;
        }
        let least = if axis.rows_per_incidence() == 1 { 1e-6 } else { 0.0 };
        for passage in Passage::ALL {
            let (width, accuracy) = (self.azimuth_width_deg.of(passage), self.accuracy_percent.of(passage));
            let right = format!("a width in degrees from {least} to 1e6");
            let field = |of: &str| format!("{of}.{}", passage.name());
            check(&field("azimuth_width_deg"), width, (least..=1e6).contains(&width), &right)?;
            check(&field("accuracy_percent"), accuracy, accuracy >= 0.0, "a number ≥ 0")?;
        }
        Ok(())
    }
}
