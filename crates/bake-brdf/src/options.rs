//! What of a recipe is baked, and how well.

use crate::effects::{Decisions, EffectError, Effects, View};
use crate::recipe::{AzimuthMode, Recipe};
use crate::tally::MAX_PATHS;
use serde::{Deserialize, Serialize};
use std::time::Duration;
use transport::walk::lanes::Precision;

/// Accuracy of a bake that names no target, per cent: about 15 s for the paper's pearl on two cores.
pub const DEFAULT_ACCURACY_PERCENT: f64 = 1.0;

/// Event cap of a path. The longest path seen in 10⁸ of the paper's pearl had 29,000 events; trapped light (total reflection
/// at every interface) would go on for ever.
pub const DEFAULT_EVENT_CAP: u32 = 10_000_000;

/// What of a recipe is baked, and how well: the same for a table, a plan, a study and a shard.
///
/// ```
/// use bake_brdf::options::{Options, SolverChoice, Target};
///
/// let options = Options {
///     incident_deg: Some(vec![0.0, 30.0, 60.0]),
///     target: Target::AccuracyPercent(5.0),
///     solver: Some(SolverChoice::Auto),
///     ..Options::default()
/// };
/// assert!(options.check().is_ok());
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Options {
    /// Which effects the table is to hold.
    pub effects: Effects,
    /// Azimuth mode in place of the recipe's.
    pub azimuth: Option<AzimuthMode>,
    /// Angles of incidence, degrees, ascending, within [0, 90]; `None`: where lobes change, as few as the accuracy takes.
    pub incident_deg: Option<Vec<f64>>,
    /// Exit cells of an incidence: columns (θo), and in space rows (φ); `None`: as few as the accuracy takes.
    pub cells: Option<[usize; 2]>,
    /// When the bake is finished.
    pub target: Target,
    /// Who solves, in place of the recipe's choice.
    pub solver: Option<SolverChoice>,
    /// Seed of the walk.
    pub seed: u64,
    /// Most events of a path; beyond it the path is booked as truncated.
    pub event_cap: u32,
    /// Arithmetic of the walk's geometry.
    pub precision: Precision,
    /// Which sides of the stack the table answers for.
    pub sides: Sides,
}

/// An option out of its range, or one that does not go with the recipe or with another option.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {why}")]
pub struct OptionError {
    /// The field of [`Options`]; of its targets `accuracy`, `paths` or `time_budget`, of its sides `both_sides`.
    pub field: &'static str,
    /// What is wrong, and what would be right.
    pub why: String,
}

impl OptionError {
    pub(crate) fn new(field: &'static str, why: impl Into<String>) -> Self {
        Self { field, why: why.into() }
    }
}

/// When a bake is finished.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Target {
    /// Total variation of the lobe, per cent of the reflected light, at the worst incidence.
    AccuracyPercent(f64),
    /// Paths per incidence.
    Paths(u64),
    /// Wall-clock time.
    Time(Duration),
}

impl Target {
    /// The accuracy, a share: that of a bake without a target where paths or a time are the target.
    pub(crate) const fn share(&self) -> f64 {
        match self {
            Self::AccuracyPercent(percent) => *percent / 100.0,
            Self::Paths(_) | Self::Time(_) => DEFAULT_ACCURACY_PERCENT / 100.0,
        }
    }
}

/// Who solves the transport problem.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "lowercase")]
pub enum SolverChoice {
    /// The Monte Carlo walk.
    Walk,
    /// Adding and doubling.
    Doubling,
    /// The cheaper of the two.
    Auto,
}

impl SolverChoice {
    /// Its name in reports and on the command line.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Walk => "walk",
            Self::Doubling => "doubling",
            Self::Auto => "auto",
        }
    }
}

/// Which sides of the stack a table answers for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Sides {
    /// Light from above that comes back.
    Above,
    /// Also what passes, and light from below: the section `both_sides` of the table. By doubling alone.
    Both,
}

impl Default for Options {
    /// The effects that the look calls for, to [`DEFAULT_ACCURACY_PERCENT`], with seed 1.
    fn default() -> Self {
        Self {
            effects: Effects::Look,
            azimuth: None,
            incident_deg: None,
            cells: None,
            target: Target::AccuracyPercent(DEFAULT_ACCURACY_PERCENT),
            solver: None,
            seed: 1,
            event_cap: DEFAULT_EVENT_CAP,
            precision: Precision::Auto,
            sides: Sides::Above,
        }
    }
}

/// Checks angles of incidence, degrees.
///
/// # Errors
/// None of them, one beyond \[0, 90\], or some that do not ascend.
pub(crate) fn check_incidences(angles: &[f64]) -> Result<(), OptionError> {
    let refuse = |why: String| Err(OptionError::new("incident_deg", why));
    if angles.is_empty() {
        return refuse("an empty list; expected at least one angle from 0 to 90".to_owned());
    }
    if let Some(angle) = angles.iter().find(|angle| !(0.0..=90.0).contains(*angle)) {
        return refuse(format!("{angle} is not an angle of incidence; expected 0 to 90 degrees"));
    }
    if angles.windows(2).any(|pair| pair[0] >= pair[1]) {
        return refuse("expected angles that ascend and differ".to_owned());
    }
    Ok(())
}

impl Options {
    /// Checks every range, and what does not go together.
    ///
    /// # Errors
    /// The first field that is wrong.
    pub fn check(&self) -> Result<(), OptionError> {
        let refuse = |field, why: String| Err(OptionError::new(field, why));
        self.incident_deg.as_deref().map_or(Ok(()), check_incidences)?;
        if self.event_cap == 0 {
            return refuse("event_cap", "0 events would walk nothing; expected at least 1".to_owned());
        }
        match self.target {
            Target::AccuracyPercent(percent) if !(percent > 0.0 && percent <= 100.0) => {
                let why = format!("{percent} is not a share; expected more than 0 and at most 100 per cent");
                return refuse("accuracy", why);
            }
            Target::Paths(paths) if !(1..=MAX_PATHS).contains(&paths) => {
                return refuse("paths", format!("{paths} per incidence; expected 1 to {MAX_PATHS}"));
            }
            Target::Time(budget) if budget.is_zero() => {
                return refuse("time_budget", "0 seconds; expected more".to_owned());
            }
            _ => {}
        }
        if self.sides == Sides::Both && self.solver == Some(SolverChoice::Walk) {
            let why = "the walk comes from above only; expected solver doubling or auto";
            return refuse("both_sides", why.to_owned());
        }
        Ok(())
    }

    /// The recipe with the azimuth mode of these options, and its effects with the reason for each.
    ///
    /// # Errors
    /// A listed effect that this version does not simulate.
    pub fn decide(&self, mut recipe: Recipe, view: &View) -> Result<(Recipe, Decisions), EffectError> {
        recipe.azimuth.mode = self.azimuth.unwrap_or(recipe.azimuth.mode);
        let decisions = Decisions::of(&recipe, view, self.effects)?;
        Ok((recipe, decisions))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_out_of_range_is_refused_by_its_field() {
        let refused = |change: fn(&mut Options)| {
            let mut options = Options::default();
            change(&mut options);
            options.check().unwrap_err().to_string()
        };
        for (line, field) in [
            (refused(|o| o.incident_deg = Some(Vec::new())), "incident_deg"),
            (refused(|o| o.incident_deg = Some(vec![0.0, 91.0])), "incident_deg"),
            (refused(|o| o.incident_deg = Some(vec![f64::NAN])), "incident_deg"),
            (refused(|o| o.incident_deg = Some(vec![10.0, 10.0])), "incident_deg"),
            (refused(|o| o.target = Target::AccuracyPercent(0.0)), "accuracy"),
            (refused(|o| o.target = Target::AccuracyPercent(f64::NAN)), "accuracy"),
            (refused(|o| o.target = Target::Paths(0)), "paths"),
            (refused(|o| o.target = Target::Paths(MAX_PATHS + 1)), "paths"),
            (refused(|o| o.target = Target::Time(Duration::ZERO)), "time_budget"),
            (refused(|o| o.event_cap = 0), "event_cap"),
            (refused(|o| (o.sides, o.solver) = (Sides::Both, Some(SolverChoice::Walk))), "both_sides"),
        ] {
            assert!(line.starts_with(&format!("{field}: ")) && line.contains("expected"), "{line}");
        }
        assert!(Options::default().check().is_ok());
    }
}
