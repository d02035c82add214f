//! The table in memory: metadata and channels.

use crate::axis::ExitAxis;
use serde::{Deserialize, Serialize};

/// Schema name this crate writes; a reader refuses a newer major version.
pub const SCHEMA: &str = "pearl-lut/1";

/// How the azimuth of the lobe is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AzimuthMode {
    /// Plane lobe, spread out of the plane by the postulate of [`crate::decay`].
    Decay,
    /// (θo, φ) from the space walk.
    Walk,
}

/// Which solver made the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Solver {
    /// Monte Carlo walk: errors are standard errors.
    Walk,
    /// Adding and doubling: errors are the difference of two resolutions.
    Doubling,
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
    /// Mean of the exit angle: signed plane angle (decay) or polar angle (walk), degrees.
    pub mean_theta_o_deg: f64,
    /// Standard deviation of the same.
    pub sd_theta_o_deg: f64,
    /// Skewness of the same.
    pub skew_theta_o: f64,
    /// Errors of the fields above.
    pub std_error: SummaryErrors,
    /// Paths walked at this incidence (0 for doubling).
    pub paths: u64,
    /// Azimuth width w of the decay postulate at this incidence, degrees (0 for walk tables).
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
    /// Estimated error of the stored cells.
    pub reached_percent: f64,
    /// Incidence at which `reached_percent` was found, degrees.
    pub worst_theta_i_deg: f64,
    /// Estimated further error of reading half-way between two incidences.
    pub interpolation_percent: f64,
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
    /// `unweighted` or `visible`.
    pub normals: String,
}

/// Everything in the `pearl` attribute of the file. Field order is the order in the JSON text.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Meta {
    /// [`SCHEMA`].
    pub schema: String,
    /// `crate name version` of the writer.
    pub writer: String,
    /// The full recipe as baked, every default filled in. This crate does not look inside.
    pub recipe: serde_json::Value,
    /// Seed of the walk.
    pub seed: u64,
    /// Solver and its settings.
    pub solver: Solver,
    /// Settings of the solver worth knowing (estimator, precision, nodes, modes): free form.
    pub solver_settings: serde_json::Value,
    /// Azimuth mode.
    pub azimuth: AzimuthMode,
    /// Vacuum wavelength of the transport problem, nm.
    pub wavelength_nm: f64,
    /// Accuracy asked and reached.
    pub accuracy: Accuracy,
    /// Exit cells; widths in radians.
    pub exit_axis: ExitAxis,
    /// Interface 0, for the closed-form surface lobe.
    pub surface_model: SurfaceModel,
    /// Names of the effects that are in the table (MODEL §10).
    pub effects: Vec<String>,
    /// One summary per θi, ascending in θi.
    pub per_incidence: Vec<IncidenceSummary>,
    /// Further sections (spectra, both sides, …), each versioned by its own content.
    #[serde(flatten)]
    pub extra: serde_json::Map<String, serde_json::Value>,
}

/// A pearl table. Every channel holds `per_incidence.len() · axis.cells()` values, incidence-major, then
/// (walk tables) φ-major, columns last.
///
/// Values are f·cos θo in 1/sr. Decay tables store them in the plane of incidence over the signed exit
/// angle: cells with s > 0 are (θo = s, φ = 0), cells with s < 0 are (θo = −s, φ = 180°).
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Metadata.
    pub meta: Meta,
    /// Light that entered the stack and came back ("blur").
    pub interior: Lobe,
    /// Light reflected by interface 0 alone.
    pub surface: Lobe,
    /// The part of `surface` that met interface 0 more than once (the closed form gives the rest).
    pub rehit: Lobe,
}

/// One component of the lobe with its uncertainty.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Lobe {
    /// f·cos θo, 1/sr.
    pub value: Vec<f32>,
    /// Standard error of `value`, 1/sr.
    pub std_error: Vec<f32>,
    /// Paths that ended in the cell (0 throughout for doubling).
    pub count: Vec<f32>,
}

impl Table {
    /// Angles of incidence, radians, ascending.
    #[must_use]
    pub fn theta_i(&self) -> Vec<f64> {
        self.meta.per_incidence.iter().map(|incidence| incidence.theta_i_deg.to_radians()).collect()
    }
}
