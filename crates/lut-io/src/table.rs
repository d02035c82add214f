//! The table in memory: metadata and channels.

use crate::axis::{self, ExitAxis};
use crate::both_sides::{self, BothSides, Passage};
use crate::dispersion::{self, Dispersion};
use crate::error::FieldError;
use crate::spectra::Spectra;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Schema name this crate writes; a reader refuses a newer major version.
pub const SCHEMA: &str = "pearl-lut/1";

/// How the azimuth of the lobe is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AzimuthMode {
    /// Plane lobe, spread out of the plane by the postulate of [`crate::decay`].
    Decay,
    /// (θo, φ) from transport in space, no postulate.
    Space,
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
/// (space tables) φ-major, columns last.
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
    /// f·cos θo of what passes and of light from below, by [`Passage`], with the section [`BothSides`] of the metadata.
    pub passages: Option<[Vec<f32>; 3]>,
    /// Interior, surface and rehit at further wavelengths, with the section [`Dispersion`] of the metadata.
    pub bands: Vec<[Lobe; 3]>,
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

/// Most cells a table may have (incidences · φ cells · columns): 13 channels of it are 1.7 GB.
pub const MAX_CELLS: usize = 1 << 25;
/// Most cells along one axis, and most incidences.
pub const MAX_AXIS_CELLS: usize = 1 << 16;

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
}

impl Meta {
    /// A section of the metadata that is not checked by itself, if it is there.
    ///
    /// # Errors
    /// It has another shape than `S`; the error names the field.
    pub(crate) fn section<S: DeserializeOwned>(&self, key: &str) -> Result<Option<S>, FieldError> {
        let Some(value) = self.extra.get(key) else { return Ok(None) };
        let section =
            serde_path_to_error::deserialize(value).map_err(|error| match error.path().to_string() {
                path if path == "." => FieldError::new(key, error.inner().to_string()),
                path => FieldError::new(format!("{key}.{path}"), error.inner().to_string()),
            })?;
        Ok(Some(section))
    }

    /// Puts a section into the metadata.
    ///
    /// # Errors
    /// A number that JSON cannot say.
    pub(crate) fn put_section(&mut self, key: &str, section: &impl Serialize) -> Result<(), FieldError> {
        let value = serde_json::to_value(section).map_err(|error| FieldError::new(key, error.to_string()))?;
        self.extra.insert(key.to_owned(), value);
        Ok(())
    }

    /// Checks everything the metadata promise by themselves: schema, axis, incidences, ranges of shares.
    ///
    /// # Errors
    /// The first error found.
    pub fn validate(&self) -> Result<(), FieldError> {
        check_schema(&self.schema)?;
        self.check_axis()?;
        self.check_incidences()?;
        let positive = |field: &str, value: f64| check(field, value, value > 0.0, "a positive number");
        let share = |field: &str, value: f64| check(field, value, value >= 0.0, "a number ≥ 0");
        positive("wavelength_nm", self.wavelength_nm)?;
        positive("surface_model.n_ambient", self.surface_model.n_ambient)?;
        positive("surface_model.n_first", self.surface_model.n_first)?;
        share("surface_model.slope_sd", self.surface_model.slope_sd)?;
        if !["unweighted", "visible"].contains(&self.surface_model.normals.as_str()) {
            let found = &self.surface_model.normals;
            return Err(FieldError::new(
                "surface_model.normals",
                format!("is {found:?}, expected unweighted or visible"),
            ));
        }
        if let Some(asked) = self.accuracy.asked_percent {
            positive("accuracy.asked_percent", asked)?;
        }
        share("accuracy.reached_percent", self.accuracy.reached_percent)?;
        share("accuracy.worst_theta_i_deg", self.accuracy.worst_theta_i_deg)?;
        share("accuracy.interpolation_percent", self.accuracy.interpolation_percent)?;
        BothSides::of(self)?;
        Dispersion::of(self)?;
        crate::reciprocal::section(self)?;
        Spectra::of(self).map(|_| ())
    }

    fn check_axis(&self) -> Result<(), FieldError> {
        let axis = &self.exit_axis;
        match (self.azimuth, axis) {
            (AzimuthMode::Decay, ExitAxis::Plane { .. }) | (AzimuthMode::Space, ExitAxis::Space { .. }) => {}
            (azimuth, _) => {
                let problem =
                    format!("does not fit azimuth {azimuth:?}: decay goes with plane, space with space");
                return Err(FieldError::new("exit_axis.kind", problem));
            }
        }
        let width = axis.width();
        let in_range = (axis::MIN_WIDTH..=axis::MAX_WIDTH).contains(&width);
        check("exit_axis.width", width, in_range, "1e-7 to π/6 radians")?;
        let columns = axis.columns();
        if columns < 2 || columns % 2 == 1 || columns > MAX_AXIS_CELLS {
            let problem = format!("is {columns}, expected an even number from 2 to {MAX_AXIS_CELLS}");
            return Err(FieldError::new("exit_axis cells", problem));
        }
        let rows = axis.rows_per_incidence();
        if rows == 0 || rows > MAX_AXIS_CELLS || (self.azimuth == AzimuthMode::Space && rows < 2) {
            let problem = format!("is {rows}, expected 2 to {MAX_AXIS_CELLS}");
            return Err(FieldError::new("exit_axis.phi_cells", problem));
        }
        Ok(())
    }

    fn check_incidences(&self) -> Result<(), FieldError> {
        let count = self.per_incidence.len();
        if count == 0 || count > MAX_AXIS_CELLS {
            let problem = format!("has {count} entries, expected 1 to {MAX_AXIS_CELLS}");
            return Err(FieldError::new("per_incidence", problem));
        }
        // No overflow: each factor is at most 2^16, and usize has 64 bits where tables of this size exist.
        let cells = count
            .saturating_mul(self.exit_axis.columns())
            .saturating_mul(self.exit_axis.rows_per_incidence());
        if cells > MAX_CELLS {
            let problem =
                format!("times the cells of exit_axis is {cells} cells, expected at most {MAX_CELLS}");
            return Err(FieldError::new("per_incidence", problem));
        }
        let mut previous = f64::NEG_INFINITY;
        for (i, summary) in self.per_incidence.iter().enumerate() {
            let at = |name: &str| format!("per_incidence[{i}].{name}");
            let theta = summary.theta_i_deg;
            check(&at("theta_i_deg"), theta, (0.0..=90.0).contains(&theta), "0 to 90")?;
            check(&at("theta_i_deg"), theta, theta > previous, "more than the entry before it")?;
            previous = theta;
            summary
                .validate(self.azimuth)
                .map_err(|error| FieldError::new(at(&error.field), error.problem))?;
        }
        Ok(())
    }
}

impl IncidenceSummary {
    fn validate(&self, azimuth: AzimuthMode) -> Result<(), FieldError> {
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
        let finite = [
            ("mean_theta_o_deg", self.mean_theta_o_deg),
            ("sd_theta_o_deg", self.sd_theta_o_deg),
            ("skew_theta_o", self.skew_theta_o),
        ];
        for (name, value) in finite {
            check(name, value, true, "a finite number")?;
        }
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
        match azimuth {
            AzimuthMode::Decay => check(
                "azimuth_width_deg",
                width,
                (1e-6..=1e6).contains(&width),
                "a width in degrees from 1e-6 to 1e6",
            ),
            AzimuthMode::Space => check("azimuth_width_deg", width, width >= 0.0, "a number ≥ 0"),
        }
    }
}

pub(crate) fn check_schema(schema: &str) -> Result<(), FieldError> {
    if schema == SCHEMA || schema.strip_prefix(SCHEMA).is_some_and(|minor| minor.starts_with('.')) {
        return Ok(());
    }
    let newer = schema.strip_prefix("pearl-lut/").and_then(|v| v.split('.').next()?.parse::<u64>().ok());
    let advice = match newer {
        Some(major) if major > 1 => "the file was written by a newer version, this program reads",
        _ => "expected",
    };
    Err(FieldError::new("schema", format!("is {schema:?}; {advice} {SCHEMA}")))
}

fn check(field: &str, value: f64, ok: bool, right: &str) -> Result<(), FieldError> {
    if ok && value.is_finite() {
        return Ok(());
    }
    Err(FieldError::new(field, format!("is {value}, expected {right}")))
}

impl Table {
    /// Angles of incidence, radians, ascending.
    #[must_use]
    pub fn theta_i(&self) -> Vec<f64> {
        self.meta.per_incidence.iter().map(|incidence| incidence.theta_i_deg.to_radians()).collect()
    }

    /// The tabulated part of the lobe of that name.
    #[must_use]
    pub const fn lobe(&self, component: Component) -> &Lobe {
        match component {
            Component::Interior => &self.interior,
            Component::Surface => &self.surface,
            Component::Rehit => &self.rehit,
        }
    }

    /// Checks that metadata and channels are whole and consistent: what a reader may rely on.
    ///
    /// # Errors
    /// The first error found.
    pub fn validate(&self) -> Result<(), FieldError> {
        self.meta.validate()?;
        let cells = self.meta.per_incidence.len() * self.meta.exit_axis.cells();
        for component in Component::ALL {
            check_lobe(component.name(), self.lobe(component), cells)?;
        }
        self.check_bands(Dispersion::of(&self.meta)?.as_ref())?;
        for (band, lobes) in self.bands.iter().enumerate() {
            for (component, lobe) in Component::ALL.iter().zip(lobes) {
                check_lobe(&dispersion::channel_name(component.name(), band), lobe, cells)?;
            }
        }
        match (&self.passages, self.meta.extra.contains_key(both_sides::KEY)) {
            (None, false) => {}
            (Some(lobes), true) => {
                for (passage, values) in Passage::ALL.iter().zip(lobes) {
                    check_channel(passage.name(), values, cells)?;
                }
            }
            _ => {
                let problem = "and the channels of light from below go together, found one without the other";
                return Err(FieldError::new(both_sides::KEY, problem));
            }
        }
        Ok(())
    }
}

fn check_lobe(name: &str, lobe: &Lobe, cells: usize) -> Result<(), FieldError> {
    check_channel(name, &lobe.value, cells)?;
    check_channel(&format!("{name}_std_error"), &lobe.std_error, cells)?;
    check_channel(&format!("{name}_count"), &lobe.count, cells)
}

fn check_channel(name: &str, samples: &[f32], cells: usize) -> Result<(), FieldError> {
    if samples.len() != cells {
        let problem = format!("holds {} values, expected {cells} (incidences × cells)", samples.len());
        return Err(FieldError::new(format!("channel {name}"), problem));
    }
    match samples.iter().position(|v| !(v.is_finite() && *v >= 0.0)) {
        None => Ok(()),
        Some(at) => {
            let problem = format!("is {} at cell {at}, expected a finite number ≥ 0", samples[at]);
            Err(FieldError::new(format!("channel {name}"), problem))
        }
    }
}
