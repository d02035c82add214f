//! Lobes at further wavelengths: section `dispersion` of the metadata, and the channels `…_band01`, `…_band02` and so on.
//!
//! The table itself is the lobe at `wavelength_nm` of its metadata. Where indices or absorption depend on the wavelength and
//! the bake was asked for the effect `dispersion`, the same incidences and cells are stored once more for each further
//! band. Between bands a lobe is read linearly in wavelength, beyond the first and the last band it is that band's.

use super::axis::ExitAxis;
use super::measure;
use super::solver::{Solver, SolverSettings};
use super::spectra::Spectra;
use super::summary::{Accuracy, IncidenceSummary, SurfaceModel, check_incidences};
use crate::error::{FieldError, check, ensure};
use serde::{Deserialize, Serialize};

/// Key of the section in the metadata.
pub const KEY: &str = "dispersion";
/// Most bands beside the table's own.
pub const MOST_BANDS: usize = 32;
/// Largest share of a lobe in a channel, either sign: sRGB's negative parts stay well within this.
const LARGEST_WEIGHT: f64 = 16.0;

/// The lobe at one further wavelength, short of its channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Band {
    /// Vacuum wavelength, nm.
    pub wavelength_nm: f64,
    /// Settings of the solver in this band.
    pub solver_settings: SolverSettings,
    /// Accuracy reached in this band.
    pub accuracy: Accuracy,
    /// Interface 0 in this band.
    pub surface_model: SurfaceModel,
    /// R_incoherent of this band at the angles of `spectra.coherent`; there if that is.
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub incoherent: Option<Vec<f64>>,
    /// One entry an incidence, in the order of the table's.
    pub per_incidence: Vec<IncidenceSummary>,
}

/// Section `dispersion` of the metadata.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Dispersion {
    /// What reading between bands adds to the error: total variation, per cent of the reflected light, largest found.
    pub interpolation_percent: f64,
    /// Share of each lobe in the channels of linear sRGB: the table's own first, then the bands'. Each channel's shares add
    /// up to 1; some are negative, as sRGB is.
    pub rgb_weights: Vec<[f64; 3]>,
    /// The further bands, ascending in wavelength.
    pub bands: Vec<Band>,
}

impl Dispersion {
    /// Checks the section of a table with this wavelength (nm), solver, exit axis and incidences.
    pub(super) fn validate(
        &self,
        (own_nm, solver): (f64, Solver),
        axis: &ExitAxis,
        per_incidence: &[IncidenceSummary],
    ) -> Result<(), FieldError> {
        let count = self.bands.len();
        ensure("bands", (1..=MOST_BANDS).contains(&count), || {
            format!("has {count} entries, expected 1 to {MOST_BANDS}")
        })?;
        let weights = self.rgb_weights.len();
        ensure("rgb_weights", weights == count + 1, || {
            format!("has {weights} entries, expected {}: the table's own band and the others", count + 1)
        })?;
        for weight in self.rgb_weights.iter().flatten() {
            check("rgb_weights", *weight, weight.abs() <= LARGEST_WEIGHT, "numbers up to 16")?;
        }
        let percent = self.interpolation_percent;
        check("interpolation_percent", percent, percent >= 0.0, "a number ≥ 0")?;
        let mut before = 0.0;
        for (i, band) in self.bands.iter().enumerate() {
            let ascends = band.wavelength_nm > before && band.wavelength_nm != own_nm;
            before = band.wavelength_nm;
            let right = "wavelengths that ascend and are not the table's own";
            check("wavelength_nm", band.wavelength_nm, ascends, right)
                .and_then(|()| band.validate(solver, axis, per_incidence))
                .map_err(|error| error.within(&format!("bands[{i}]")))?;
        }
        Ok(())
    }
}

impl Band {
    fn validate(
        &self,
        solver: Solver,
        axis: &ExitAxis,
        per_incidence: &[IncidenceSummary],
    ) -> Result<(), FieldError> {
        let angles = |rows: &[IncidenceSummary]| -> Vec<u64> {
            rows.iter().map(|row| row.theta_i_deg.to_bits()).collect()
        };
        ensure("per_incidence", angles(&self.per_incidence) == angles(per_incidence), || {
            "has other incidences than the table".to_owned()
        })?;
        for r in self.incoherent.iter().flatten() {
            let right = "reflectances, more than 0 and at most 1";
            check("incoherent", *r, (f64::MIN_POSITIVE..=1.0).contains(r), right)?;
        }
        check_incidences(axis, &self.per_incidence)?;
        self.surface_model.validate()?;
        self.accuracy.validate()?;
        self.solver_settings.validate(solver)
    }

    /// The colours of a table with M relative to this band's R_incoherent.
    pub(super) fn recoloured(&self, spectra: &Spectra) -> Result<Spectra, FieldError> {
        let mut spectra = spectra.clone();
        let Some(coherent) = &mut spectra.coherent else { return Ok(spectra) };
        let count = coherent.theta_deg.len();
        let Some(own) = self.incoherent.as_ref().filter(|own| own.len() == count) else {
            let problem = format!("is missing or not of the {count} angles of spectra.coherent");
            return Err(FieldError::new(
                format!("{KEY}.bands.incoherent at {} nm", self.wavelength_nm),
                problem,
            ));
        };
        for (i, own) in own.iter().enumerate() {
            let factor = coherent.incoherent[i] / own;
            for rows in spectra.thickness.iter_mut().flat_map(|thickness| &mut thickness.modulation_rgb) {
                rows[i] = rows[i].map(|m| m * factor);
            }
            coherent.modulation[i].iter_mut().for_each(|m| *m *= factor);
            coherent.modulation_rgb[i] = coherent.modulation_rgb[i].map(|m| m * factor);
            coherent.incoherent[i] = *own;
        }
        Ok(spectra.rounded())
    }
}

/// Name of a channel in a band: `interior` becomes `interior_band01`.
#[must_use]
pub fn channel_name(name: &str, band: usize) -> String {
    format!("{name}_band{:02}", band + 1)
}

/// Weight channels of a band's lobes, as of the table's own.
pub(crate) fn weights(band: &Band, axis: &ExitAxis) -> Vec<f32> {
    let each = band.per_incidence.iter().flat_map(|summary| {
        let width = summary.azimuth_width_deg.to_radians();
        measure::reading_weights(axis, summary.theta_i_deg.to_radians(), width)
    });
    each.map(|weight| weight as f32).collect()
}
