//! Lobes at further wavelengths: section `dispersion` of the metadata, and the channels `…_band01`, `…_band02` and so on.
//!
//! The table itself is the lobe at `wavelength_nm` of its metadata. Where indices or absorption depend on the wavelength and
//! the bake was asked for the effect `dispersion`, the same incidences and cells are stored once more for each further
//! band. Between bands a lobe is read linearly in wavelength, beyond the first and the last band it is that band's.

use crate::error::FieldError;
use crate::spectra::Spectra;
use crate::table::{Accuracy, IncidenceSummary, Lobe, Meta, SurfaceModel, Table};
use serde::{Deserialize, Serialize};

/// Key of the section in the metadata.
pub const KEY: &str = "dispersion";
/// Most bands beside the table's own.
pub const MOST_BANDS: usize = 32;

/// The lobe at one further wavelength, short of its channels.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Band {
    /// Vacuum wavelength, nm.
    pub wavelength_nm: f64,
    /// Settings of the solver in this band.
    pub solver_settings: serde_json::Value,
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

    fn validate(&self, meta: &Meta) -> Result<(), FieldError> {
        let count = self.bands.len();
        if !(1..=MOST_BANDS).contains(&count) {
            let problem = format!("has {count} entries, expected 1 to {MOST_BANDS}");
            return Err(FieldError::new(format!("{KEY}.bands"), problem));
        }
        if self.rgb_weights.len() != count + 1 {
            let problem = format!(
                "has {} entries, expected {}: the table's own band and the others",
                self.rgb_weights.len(),
                count + 1
            );
            return Err(FieldError::new(format!("{KEY}.rgb_weights"), problem));
        }
        // sRGB's negative parts stay well within this.
        const LARGEST_WEIGHT: f64 = 16.0;
        if let Some(weight) =
            self.rgb_weights.iter().flatten().find(|w| w.is_nan() || w.abs() > LARGEST_WEIGHT)
        {
            let problem = format!("has {weight}, expected numbers up to {LARGEST_WEIGHT}");
            return Err(FieldError::new(format!("{KEY}.rgb_weights"), problem));
        }
        if !(self.interpolation_percent >= 0.0 && self.interpolation_percent.is_finite()) {
            let problem = format!("is {}, expected a number ≥ 0", self.interpolation_percent);
            return Err(FieldError::new(format!("{KEY}.interpolation_percent"), problem));
        }
        let mut before = 0.0;
        for (i, band) in self.bands.iter().enumerate() {
            let within = |error: FieldError| {
                FieldError::new(format!("{KEY}.bands[{i}].{}", error.field), error.problem)
            };
            if band.wavelength_nm.is_nan()
                || band.wavelength_nm <= before
                || band.wavelength_nm == meta.wavelength_nm
            {
                let problem = format!(
                    "is {}, expected wavelengths that ascend and are not the table's own",
                    band.wavelength_nm
                );
                return Err(FieldError::new(format!("{KEY}.bands[{i}].wavelength_nm"), problem));
            }
            before = band.wavelength_nm;
            let angles = |rows: &[IncidenceSummary]| -> Vec<u64> {
                rows.iter().map(|row| row.theta_i_deg.to_bits()).collect()
            };
            if angles(&band.per_incidence) != angles(&meta.per_incidence) {
                let problem = "has other incidences than per_incidence of the table";
                return Err(FieldError::new(format!("{KEY}.bands[{i}].per_incidence"), problem));
            }
            if band.incoherent.iter().flatten().any(|r| !(f64::MIN_POSITIVE..=1.0).contains(r)) {
                let problem = "has a number that is no reflectance, expected more than 0 and at most 1";
                return Err(FieldError::new(format!("{KEY}.bands[{i}].incoherent"), problem));
            }
            band.alone(meta).validate().map_err(within)?;
        }
        Ok(())
    }
}

impl Band {
    /// The colours of a table with M relative to this band's R_incoherent.
    fn recoloured(&self, spectra: &Spectra) -> Result<Spectra, FieldError> {
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
            coherent.modulation[i].iter_mut().for_each(|m| *m *= factor);
            coherent.modulation_rgb[i] = coherent.modulation_rgb[i].map(|m| m * factor);
            coherent.incoherent[i] = *own;
        }
        Ok(spectra)
    }

    /// Metadata of a table of this band alone.
    fn alone(&self, meta: &Meta) -> Meta {
        Meta {
            schema: meta.schema.clone(),
            writer: meta.writer.clone(),
            recipe: meta.recipe.clone(),
            seed: meta.seed,
            solver: meta.solver,
            solver_settings: self.solver_settings.clone(),
            azimuth: meta.azimuth,
            wavelength_nm: self.wavelength_nm,
            accuracy: self.accuracy.clone(),
            exit_axis: meta.exit_axis,
            surface_model: self.surface_model.clone(),
            effects: meta.effects.clone(),
            per_incidence: self.per_incidence.clone(),
            extra: serde_json::Map::new(),
        }
    }
}

/// Name of a channel in a band: `interior` becomes `interior_band01`.
#[must_use]
pub fn channel_name(name: &str, band: usize) -> String {
    format!("{name}_band{:02}", band + 1)
}

impl Table {
    /// The lobes of the further bands, each as a table of its own, ascending in wavelength: what a bake of that wavelength
    /// alone holds. M of such a table is relative to that band's own R_incoherent.
    ///
    /// # Errors
    /// The section `dispersion` is not valid, or does not fit the channels.
    pub fn further_bands(&self) -> Result<Vec<Self>, FieldError> {
        let Some(section) = Dispersion::of(&self.meta)? else { return Ok(Vec::new()) };
        self.check_bands(Some(&section))?;
        let spectra = Spectra::of(&self.meta)?;
        let tables = section.bands.iter().zip(&self.bands).map(|(band, [interior, surface, rehit])| {
            let mut meta = band.alone(&self.meta);
            meta.extra = self.meta.extra.clone();
            meta.extra.remove(KEY);
            if let Some(spectra) = &spectra {
                band.recoloured(spectra)?.store(&mut meta)?;
            }
            Ok(Self {
                meta,
                interior: interior.clone(),
                surface: surface.clone(),
                rehit: rehit.clone(),
                passages: None,
                bands: Vec::new(),
            })
        });
        tables.collect()
    }

    /// Adds tables of the same recipe at further wavelengths, ascending, to this one.
    ///
    /// # Errors
    /// They do not fit this table.
    pub fn add_bands(
        &mut self,
        further: Vec<Self>,
        rgb_weights: Vec<[f64; 3]>,
        interpolation_percent: f64,
    ) -> Result<(), FieldError> {
        if further.is_empty() {
            return Ok(());
        }
        let mut section = Dispersion { interpolation_percent, rgb_weights, bands: Vec::new() };
        for table in further {
            let Meta { wavelength_nm, solver_settings, accuracy, surface_model, per_incidence, .. } =
                table.meta;
            section.bands.push(Band {
                wavelength_nm,
                solver_settings,
                accuracy,
                surface_model,
                // Filled in when the colours are known.
                incoherent: None,
                per_incidence,
            });
            self.bands.push([table.interior, table.surface, table.rehit]);
        }
        section.store(&mut self.meta)
    }

    pub(crate) fn check_bands(&self, section: Option<&Dispersion>) -> Result<(), FieldError> {
        let (found, expected) = (self.bands.len(), section.map_or(0, |section| section.bands.len()));
        if found == expected {
            return Ok(());
        }
        let problem = format!("names {expected} further bands, but there are channels of {found}");
        Err(FieldError::new(KEY, problem))
    }
}

/// Weight channels of a band's lobes, as of the table's own.
pub(crate) fn weights(band: &Band, meta: &Meta) -> Vec<f32> {
    let axis = &meta.exit_axis;
    let each = band.per_incidence.iter().flat_map(|summary| {
        let width = summary.azimuth_width_deg.to_radians();
        crate::measure::reading_weights(axis, summary.theta_i_deg.to_radians(), width)
    });
    each.map(|weight| weight as f32).collect()
}

/// Interior, surface and rehit of further bands.
pub(crate) type Bands = Vec<[Lobe; 3]>;
