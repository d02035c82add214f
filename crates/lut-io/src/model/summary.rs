//! What the metadata say of the lobe at one wavelength: its incidences, its accuracy, and interface 0.

use super::axis::ExitAxis;
use super::limits::{MAX_AXIS_CELLS, MAX_CELLS};
use crate::error::{FieldError, check, ensure};
use serde::{Deserialize, Serialize};

/// One of the three tabulated parts of the lobe.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Component {
    /// Light that entered the stack and came back.
    Interior,
    /// Light reflected by interface 0 alone.
    Surface,
    /// The part of `Surface` that met interface 0 more than once.
    Rehit,
}

/// Estimated errors (one standard error, or the difference of two resolutions) of [`IncidenceSummary`].
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[allow(missing_docs)] // the fields are those of IncidenceSummary
pub struct SummaryErrors {
    pub albedo: f64,
    pub transmitted: f64,
    pub absorbed: f64,
    pub truncated: f64,
    pub surface: f64,
    pub mean_theta_o_deg: f64,
    pub sd_theta_o_deg: f64,
    pub skew_theta_o: f64,
}

/// What becomes of the light that arrives at one θi; shares of the incident light.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IncidenceSummary {
    /// Angle of incidence, degrees.
    pub theta_i_deg: f64,
    /// All that leaves the top: surface and interior.
    pub albedo: f64,
    /// All that passes the last interface.
    pub transmitted: f64,
    /// Lost to absorption in the layers.
    pub absorbed: f64,
    /// Paths cut by the event cap.
    pub truncated: f64,
    /// Reflected by interface 0 alone, before anything entered; part of `albedo`.
    pub surface: f64,
    /// The part of `surface` that met interface 0 more than once.
    pub rehit: f64,
    /// Mean of the exit angle: signed angle in the plane (decay) or polar angle (space), degrees.
    pub mean_theta_o_deg: f64,
    /// Standard deviation of the same.
    pub sd_theta_o_deg: f64,
    /// Skewness of the same.
    pub skew_theta_o: f64,
    /// Errors of the fields above.
    pub std_error: SummaryErrors,
    /// Paths walked at this incidence (0 for doubling).
    pub paths: u64,
    /// Azimuth width w of the decay postulate at this incidence, degrees (0 for space tables).
    pub azimuth_width_deg: f64,
    /// Estimated total variation error of the stored lobe, per cent of the reflected light.
    pub accuracy_percent: f64,
}

/// Accuracy of the table: total variation, per cent of the reflected light, worst incidence.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Accuracy {
    /// What `--accuracy` asked for; `None` when paths or a time budget were given.
    pub asked_percent: Option<f64>,
    /// Of the lobe as it is read at any pair of angles.
    pub reached_percent: f64,
    /// Incidence at which the solver is worst, degrees.
    pub worst_theta_i_deg: f64,
    /// The solver's part: the error of the stored cells.
    pub solver_percent: f64,
    /// What reading between rows adds.
    pub rows_percent: f64,
    /// What reading between cells adds, where that is known.
    pub cells_percent: Option<f64>,
    /// Of each component as it is read, where that is known.
    pub components: Option<ComponentAccuracy>,
}

/// Error of each component as it is read, at the worst incidence.
///
/// Per cent of its [`crate::measure::component_scale`], √(all reflected light · the component's own).
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ComponentAccuracy {
    /// Light that entered the stack and came back.
    pub interior_percent: f64,
    /// Light that met interface 0 more than once.
    pub rehit_percent: f64,
    /// The stored `surface`. Who has its single reflection in closed form is off by the error of the re-hits alone.
    pub surface_percent: f64,
}

/// What the closed-form surface lobe needs: interface 0 and its facets.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SurfaceModel {
    /// Index of the ambient medium.
    pub n_ambient: f64,
    /// Index of the first layer at the bake wavelength.
    pub n_first: f64,
    /// Facet slope standard deviation σ, radians.
    pub slope_sd: f64,
    /// Which facets the light meets.
    pub normals: Normals,
}

/// Which facets of interface 0 the light meets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Normals {
    /// All of them by their density, from wherever it comes.
    Unweighted,
    /// Each by the area that it shows to the light.
    Visible,
}

impl Component {
    /// All components, in the order of the enum's discriminants.
    pub const ALL: [Self; 3] = [Self::Interior, Self::Surface, Self::Rehit];

    /// Name of the component's channel in the file.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Interior => "interior",
            Self::Surface => "surface",
            Self::Rehit => "rehit",
        }
    }
}

impl IncidenceSummary {
    /// Share of the incident light that leaves as this component.
    #[must_use]
    pub fn share(&self, component: Component) -> f64 {
        match component {
            Component::Interior => (self.albedo - self.surface).max(0.0),
            Component::Surface => self.surface,
            Component::Rehit => self.rehit,
        }
    }

    fn validate(&self, axis: &ExitAxis) -> Result<(), FieldError> {
        // Shares are sums of many roundings; beyond this it is not rounding any more.
        const ROUNDING: f64 = 1e-6;
        let shares = [
            ("albedo", self.albedo),
            ("transmitted", self.transmitted),
            ("absorbed", self.absorbed),
            ("truncated", self.truncated),
            ("surface", self.surface),
            ("rehit", self.rehit),
        ];
        for (name, value) in shares {
            check(name, value, (0.0..=1.0 + ROUNDING).contains(&value), "a share from 0 to 1")?;
        }
        check("surface", self.surface, self.surface <= self.albedo + ROUNDING, "at most albedo")?;
        check("rehit", self.rehit, self.rehit <= self.surface + ROUNDING, "at most surface")?;
        check("mean_theta_o_deg", self.mean_theta_o_deg, true, "a finite number")?;
        check("sd_theta_o_deg", self.sd_theta_o_deg, true, "a finite number")?;
        check("skew_theta_o", self.skew_theta_o, true, "a finite number")?;
        let e = &self.std_error;
        let errors = [
            ("std_error.albedo", e.albedo),
            ("std_error.transmitted", e.transmitted),
            ("std_error.absorbed", e.absorbed),
            ("std_error.truncated", e.truncated),
            ("std_error.surface", e.surface),
            ("std_error.mean_theta_o_deg", e.mean_theta_o_deg),
            ("std_error.sd_theta_o_deg", e.sd_theta_o_deg),
            ("std_error.skew_theta_o", e.skew_theta_o),
            ("accuracy_percent", self.accuracy_percent),
        ];
        for (name, value) in errors {
            check(name, value, value >= 0.0, "a number ≥ 0")?;
        }
        let width = self.azimuth_width_deg;
        match axis {
            ExitAxis::Plane { .. } => {
                let right = "a width in degrees from 1e-6 to 1e6";
                check("azimuth_width_deg", width, (1e-6..=1e6).contains(&width), right)
            }
            ExitAxis::Space { .. } => check("azimuth_width_deg", width, width >= 0.0, "a number ≥ 0"),
        }
    }
}

impl Accuracy {
    pub(super) fn validate(&self) -> Result<(), FieldError> {
        if let Some(asked) = self.asked_percent {
            check("accuracy.asked_percent", asked, asked > 0.0, "a positive number")?;
        }
        let share = |field: &str, value: f64| check(field, value, value >= 0.0, "a number ≥ 0");
        share("accuracy.reached_percent", self.reached_percent)?;
        share("accuracy.worst_theta_i_deg", self.worst_theta_i_deg)?;
        share("accuracy.solver_percent", self.solver_percent)?;
        share("accuracy.rows_percent", self.rows_percent)?;
        share("accuracy.cells_percent", self.cells_percent.unwrap_or(0.0))?;
        let components = self.components.unwrap_or_default();
        share("accuracy.components.interior_percent", components.interior_percent)?;
        share("accuracy.components.rehit_percent", components.rehit_percent)?;
        share("accuracy.components.surface_percent", components.surface_percent)
    }
}

impl SurfaceModel {
    pub(super) fn validate(&self) -> Result<(), FieldError> {
        check("surface_model.n_ambient", self.n_ambient, self.n_ambient > 0.0, "a positive number")?;
        check("surface_model.n_first", self.n_first, self.n_first > 0.0, "a positive number")?;
        check("surface_model.slope_sd", self.slope_sd, self.slope_sd >= 0.0, "a number ≥ 0")
    }
}

/// Checks the summaries of a table with this exit axis, number and ranges.
pub(super) fn check_incidences(
    axis: &ExitAxis,
    per_incidence: &[IncidenceSummary],
) -> Result<(), FieldError> {
    let count = per_incidence.len();
    ensure("per_incidence", (1..=MAX_AXIS_CELLS).contains(&count), || {
        format!("has {count} entries, expected 1 to {MAX_AXIS_CELLS}")
    })?;
    // No overflow: each factor is at most 2^16, and usize has 64 bits where tables of this size exist.
    let cells = count.saturating_mul(axis.columns()).saturating_mul(axis.rows_per_incidence());
    ensure("per_incidence", cells <= MAX_CELLS, || {
        format!("times the cells of exit_axis is {cells} cells, expected at most {MAX_CELLS}")
    })?;
    let mut previous = f64::NEG_INFINITY;
    for (i, summary) in per_incidence.iter().enumerate() {
        let at = |name: &str| format!("per_incidence[{i}].{name}");
        let theta = summary.theta_i_deg;
        check(&at("theta_i_deg"), theta, (0.0..=90.0).contains(&theta), "0 to 90")?;
        check(&at("theta_i_deg"), theta, theta > previous, "more than the entry before it")?;
        previous = theta;
        summary.validate(axis).map_err(|error| FieldError::new(at(&error.field), error.problem))?;
    }
    Ok(())
}
