//! The colours of interference that rendering needs, baked once: section `spectra` of the metadata.
//!
//! Every array of arrays is `[θ][band]`: one row a stored angle, one value a wavelength band. A renderer
//! multiplies the lobe by the modulation at the half-vector angle, and the base by the emission at the viewing
//! angle. Each of the two is there only if the bake was asked for it.

use crate::error::{FieldError, check, ensure};
use serde::{Deserialize, Serialize};

/// Key of the section in the metadata.
pub const KEY: &str = "spectra";
/// Most bands, and most angles.
pub const MAX_NODES: usize = 1024;
/// Largest modulation or emission that is taken for one: R_incoherent of a pearl is far above 1e-6.
const MAX_VALUE: f64 = 1e6;

/// Interference colours over wavelength and angle.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spectra {
    /// Band centres, vacuum wavelength in nm, ascending and equally spaced. Values are means over the band. From 380 to 780 nm; with
    /// `thickness` as far beyond as its scales take.
    pub wavelength_nm: Vec<f64>,
    /// Colour of the lobes (effect `coherent`).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub coherent: Option<Coherent>,
    /// Colour of the base (effect `emission`).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub emission: Option<Emission>,
    /// The same at other thicknesses (effect `thickness`).
    #[serde(skip_serializing_if = "Option::is_none", default)]
    pub thickness: Option<Thickness>,
}

/// Colours at scales s of all thicknesses. At the wavelength λ a stack s times as thick has the M of λ/s, and the emission of λ/s in
/// units of its mean over the visible range; its colours in linear sRGB are stored, and read linearly in ln s.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Thickness {
    /// Scales, ascending; 1 among them, equal ratios below it and above it.
    pub scale: Vec<f64>,
    /// M in linear sRGB, `[scale][θ]`, θ of `coherent`; empty without it.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub modulation_rgb: Vec<Vec<[f64; 3]>>,
    /// Ê in linear sRGB, `[scale][θ]`, θ of `emission`; empty without it.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub radiance_rgb: Vec<Vec<[f64; 3]>>,
    /// Mean of `emission.radiance` over what is visible at a scale, `[scale][θ]`: what it is divided by there.
    #[serde(skip_serializing_if = "Vec::is_empty", default)]
    pub radiance_mean: Vec<Vec<f64>>,
    /// Error of the colours.
    pub delta_e00: ThicknessError,
}

/// How far a colour at a scale is from that of a stack of such thicknesses, CIEDE2000, at the worst angle up to 85°.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThicknessError {
    /// Read between scales.
    pub scales: f64,
    /// Of what does not scale, at the smallest and the largest scale: indices that depend on the wavelength, the depth of a source; 0
    /// where all scales.
    pub scaling: f64,
}

/// Section `spectra_missing`: why colours that the recipe's look calls for are not there, in words.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Missing {
    /// Why [`Spectra::coherent`] is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coherent: Option<String>,
    /// Why [`Spectra::emission`] is not.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub emission: Option<String>,
}

/// How far a colour is from the one that it stands for, CIEDE2000 under D65 of the spectrum as a reflectance, at the worst
/// angle up to 85°.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColourError {
    /// At the stored angles: two standard errors of an ensemble of irregular stacks, or the change where every second wavelength is left
    /// out, if that is more. None where it is not known.
    pub sampling: Option<f64>,
    /// Read linearly between angles.
    pub angles: f64,
    /// Of the bands, read linearly between their centres; RGB has no part in it.
    pub bands: f64,
}

impl ColourError {
    fn validate(&self, name: &str) -> Result<(), FieldError> {
        let Self { sampling, angles, bands } = *self;
        let parts = [("sampling", sampling.unwrap_or(0.0)), ("angles", angles), ("bands", bands)];
        parts.iter().try_for_each(|(part, error)| {
            let name = format!("{name}.{part}");
            check(&name, *error, error.is_finite() && *error >= 0.0, "a colour difference, 0 or more")
        })
    }
}

/// Coherent interference: what the lobes are multiplied by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Coherent {
    /// Half-vector angles in the ambient medium, degrees, ascending from 0 to 90.
    pub theta_deg: Vec<f64>,
    /// M(λ, θ) = R_coherent / R_incoherent.
    pub modulation: Vec<Vec<f64>>,
    /// M in linear sRGB (M = 1 at all wavelengths is 1, 1, 1), no channel below 0 or above 1/R_incoherent.
    pub modulation_rgb: Vec<[f64; 3]>,
    /// R_incoherent(θ) that `modulation` was divided by; for information.
    pub incoherent: Vec<f64>,
    /// Error of the colours.
    pub delta_e00: ColourError,
}

/// Incoherent interference: what the base is multiplied by.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Emission {
    /// Angles of exit into the ambient medium, degrees, ascending from 0 to 90.
    pub theta_deg: Vec<f64>,
    /// Ê(λ, θ): radiance of light scattered inside the stack, unit mean over the bands at each θ.
    pub radiance: Vec<Vec<f64>>,
    /// Ê in linear sRGB (Ê = 1 at all wavelengths is 1, 1, 1), no channel below 0.
    pub radiance_rgb: Vec<[f64; 3]>,
    /// Error of the colours.
    pub delta_e00: ColourError,
}

impl Spectra {
    /// Numbers rounded to seven significant digits: f32 holds no more.
    #[must_use]
    pub fn rounded(&self) -> Self {
        let row = |row: &Vec<f64>| -> Vec<f64> { row.iter().map(|x| seven_digits(*x)).collect() };
        let rows = |rows: &Vec<Vec<f64>>| rows.iter().map(row).collect();
        let rgb = |rows: &Vec<[f64; 3]>| rows.iter().map(|rgb| rgb.map(seven_digits)).collect();
        Self {
            wavelength_nm: row(&self.wavelength_nm),
            coherent: self.coherent.as_ref().map(|coherent| Coherent {
                theta_deg: row(&coherent.theta_deg),
                modulation: rows(&coherent.modulation),
                modulation_rgb: rgb(&coherent.modulation_rgb),
                incoherent: row(&coherent.incoherent),
                delta_e00: coherent.delta_e00,
            }),
            emission: self.emission.as_ref().map(|emission| Emission {
                theta_deg: row(&emission.theta_deg),
                radiance: rows(&emission.radiance),
                radiance_rgb: rgb(&emission.radiance_rgb),
                delta_e00: emission.delta_e00,
            }),
            thickness: self.thickness.as_ref().map(|thickness| Thickness {
                scale: thickness.scale.clone(),
                modulation_rgb: thickness.modulation_rgb.iter().map(rgb).collect(),
                radiance_rgb: thickness.radiance_rgb.iter().map(rgb).collect(),
                radiance_mean: rows(&thickness.radiance_mean),
                delta_e00: thickness.delta_e00,
            }),
        }
    }

    /// The bands between 380 and 780 nm.
    #[must_use]
    pub fn visible(&self) -> std::ops::Range<usize> {
        let below = |limit: f64| self.wavelength_nm.partition_point(|nm| *nm < limit);
        if self.thickness.is_some() { below(380.0)..below(780.0) } else { 0..self.wavelength_nm.len() }
    }

    /// Checks shapes and ranges.
    ///
    /// # Errors
    /// The first error found.
    pub fn validate(&self) -> Result<(), FieldError> {
        check_axis("wavelength_nm", &self.wavelength_nm, 1, |nm| nm > 0.0, "a positive wavelength")?;
        let bands = self.wavelength_nm.len();
        if let Some(Coherent { theta_deg, modulation, modulation_rgb, incoherent, delta_e00 }) =
            &self.coherent
        {
            delta_e00.validate("coherent.delta_e00")?;
            check_angles("coherent.theta_deg", theta_deg)?;
            check_rows("coherent.modulation", modulation, theta_deg.len(), bands)?;
            check_rows("coherent.modulation_rgb", modulation_rgb, theta_deg.len(), 3)?;
            check_length("coherent.incoherent", incoherent.len(), theta_deg.len(), "angles")?;
            check_values("coherent.incoherent", incoherent)?;
        }
        if let Some(Emission { theta_deg, radiance, radiance_rgb, delta_e00 }) = &self.emission {
            delta_e00.validate("emission.delta_e00")?;
            check_angles("emission.theta_deg", theta_deg)?;
            check_rows("emission.radiance", radiance, theta_deg.len(), bands)?;
            check_rows("emission.radiance_rgb", radiance_rgb, theta_deg.len(), 3)?;
        }
        let angles = [
            self.coherent.as_ref().map_or(0, |part| part.theta_deg.len()),
            self.emission.as_ref().map_or(0, |part| part.theta_deg.len()),
        ];
        self.thickness.as_ref().map_or(Ok(()), |thickness| thickness.validate(angles))
    }
}

impl Thickness {
    /// For so many angles of M and of Ê, 0 where there is none.
    fn validate(&self, [coherent, emission]: [usize; 2]) -> Result<(), FieldError> {
        check_axis("thickness.scale", &self.scale, 2, |s| (0.01..=100.0).contains(&s), "0.01 to 100")?;
        ensure("thickness.scale", self.scale.contains(&1.0), || "has no 1 among its scales".to_owned())?;
        for (name, error) in [("scales", self.delta_e00.scales), ("scaling", self.delta_e00.scaling)] {
            let name = format!("thickness.delta_e00.{name}");
            check(&name, error, error.is_finite() && error >= 0.0, "a colour difference, 0 or more")?;
        }
        let rgb = [
            ("thickness.modulation_rgb", &self.modulation_rgb, coherent),
            ("thickness.radiance_rgb", &self.radiance_rgb, emission),
        ];
        for (name, scales, angles) in rgb {
            check_scales(name, scales.len(), self.scale.len(), angles)?;
            for (k, rows) in scales.iter().enumerate() {
                check_rows(&format!("{name}[{k}]"), rows, angles, 3)?;
            }
        }
        let name = "thickness.radiance_mean";
        check_scales(name, self.radiance_mean.len(), self.scale.len(), emission)?;
        for (k, row) in self.radiance_mean.iter().enumerate() {
            let name = format!("{name}[{k}]");
            check_length(&name, row.len(), emission, "angles")?;
            check_values(&name, row)?;
            let dark = row.iter().position(|mean| *mean == 0.0);
            dark.map_or(Ok(()), |i| check(&format!("{name}[{i}]"), 0.0, false, "more than 0"))?;
        }
        Ok(())
    }
}

/// As many rows as there are scales; none where there are no angles.
fn check_scales(name: &str, found: usize, scales: usize, angles: usize) -> Result<(), FieldError> {
    check_length(name, found, if angles == 0 { 0 } else { scales }, "scales")
}

fn check_angles(name: &str, theta_deg: &[f64]) -> Result<(), FieldError> {
    check_axis(name, theta_deg, 2, |t| (0.0..=90.0).contains(&t), "an angle from 0 to 90")?;
    let (first, last) = (theta_deg[0], theta_deg[theta_deg.len() - 1]);
    ensure(name, (first, last) == (0.0, 90.0), || format!("runs from {first} to {last}, expected 0 to 90"))
}

fn check_rows<R: AsRef<[f64]>>(
    name: &str,
    rows: &[R],
    angles: usize,
    bands: usize,
) -> Result<(), FieldError> {
    check_length(name, rows.len(), angles, "angles")?;
    rows.iter().map(AsRef::as_ref).enumerate().try_for_each(|(i, row)| {
        let name = format!("{name}[{i}]");
        check_length(&name, row.len(), bands, "bands")?;
        check_values(&name, row)
    })
}

fn check_axis(
    name: &str,
    nodes: &[f64],
    fewest: usize,
    valid: impl Fn(f64) -> bool,
    right: &str,
) -> Result<(), FieldError> {
    let count = nodes.len();
    ensure(name, (fewest..=MAX_NODES).contains(&count), || {
        format!("has {count} entries, expected {fewest} to {MAX_NODES}")
    })?;
    for (i, node) in nodes.iter().enumerate() {
        check(&format!("{name}[{i}]"), *node, valid(*node), right)?;
    }
    for (i, pair) in nodes.windows(2).enumerate() {
        let right = format!("more than the entry before it, {}", pair[0]);
        check(&format!("{name}[{}]", i + 1), pair[1], pair[1] > pair[0], &right)?;
    }
    Ok(())
}

fn check_length(name: &str, found: usize, expected: usize, of: &str) -> Result<(), FieldError> {
    ensure(name, found == expected, || {
        format!("has {found} entries, expected one for each of the {expected} {of}")
    })
}

fn check_values(name: &str, values: &[f64]) -> Result<(), FieldError> {
    match values.iter().position(|v| !(0.0..=MAX_VALUE).contains(v)) {
        None => Ok(()),
        Some(i) => check(&format!("{name}[{i}]"), values[i], false, "0 to 1e6"),
    }
}

/// The number with seven significant decimal digits.
fn seven_digits(x: f64) -> f64 {
    // Formatting and parsing round correctly; powers of ten would not.
    format!("{x:.6e}").parse().unwrap_or(x)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spectra() -> Spectra {
        let rows = vec![vec![1.0 / 3.0, 0.5], vec![1.25, 2.0]];
        Spectra {
            wavelength_nm: vec![450.0, 650.0],
            coherent: Some(Coherent {
                theta_deg: vec![0.0, 90.0],
                modulation: rows.clone(),
                modulation_rgb: vec![[0.1, 0.2, 0.3]; 2],
                incoherent: vec![0.4, 1.0],
                delta_e00: ColourError::default(),
            }),
            emission: Some(Emission {
                theta_deg: vec![0.0, 90.0],
                radiance: rows,
                radiance_rgb: vec![[1.0; 3]; 2],
                delta_e00: ColourError::default(),
            }),
            thickness: Some(Thickness {
                scale: vec![0.9, 1.0, 1.1],
                modulation_rgb: vec![vec![[0.5; 3]; 2]; 3],
                radiance_rgb: vec![vec![[1.0; 3]; 2]; 3],
                radiance_mean: vec![vec![1.0; 2]; 3],
                delta_e00: ThicknessError::default(),
            }),
        }
    }

    fn thickness(spectra: &mut Spectra) -> &mut Thickness {
        spectra.thickness.as_mut().unwrap()
    }

    fn coherent(spectra: &mut Spectra) -> &mut Coherent {
        spectra.coherent.as_mut().unwrap()
    }

    fn emission(spectra: &mut Spectra) -> &mut Emission {
        spectra.emission.as_mut().unwrap()
    }

    #[test]
    fn numbers_keep_seven_digits() {
        assert_eq!(coherent(&mut spectra().rounded()).modulation[0][0], 0.3333333);
        assert_eq!(seven_digits(0.0), 0.0);
    }

    #[test]
    fn every_flaw_is_refused_with_its_field() {
        #[allow(clippy::type_complexity)] // a list of named breakages
        let breaks: [(&str, fn(&mut Spectra)); 17] = [
            ("wavelength_nm", |s| s.wavelength_nm.clear()),
            ("wavelength_nm[1]", |s| s.wavelength_nm[1] = 450.0),
            ("coherent.theta_deg", |s| coherent(s).theta_deg[1] = 89.0),
            ("coherent.modulation", |s| coherent(s).modulation.truncate(1)),
            ("coherent.modulation[1]", |s| coherent(s).modulation[1].push(0.0)),
            ("coherent.incoherent", |s| coherent(s).incoherent.clear()),
            ("coherent.delta_e00.angles", |s| coherent(s).delta_e00.angles = -1.0),
            ("emission.radiance[0][1]", |s| emission(s).radiance[0][1] = f64::NAN),
            ("emission.radiance_rgb[1][2]", |s| emission(s).radiance_rgb[1][2] = -1e-3),
            ("emission.theta_deg", |s| emission(s).theta_deg = vec![0.0; MAX_NODES + 1]),
            ("thickness.scale", |s| thickness(s).scale[1] = 1.01),
            ("thickness.scale[0]", |s| thickness(s).scale[0] = 0.0),
            ("thickness.delta_e00.scaling", |s| thickness(s).delta_e00.scaling = f64::NAN),
            ("thickness.modulation_rgb", |s| thickness(s).modulation_rgb.truncate(2)),
            ("thickness.radiance_rgb[2]", |s| thickness(s).radiance_rgb[2].truncate(1)),
            ("thickness.radiance_mean[1][0]", |s| thickness(s).radiance_mean[1][0] = 0.0),
            ("thickness.modulation_rgb", |s| s.coherent = None),
        ];
        assert_eq!(spectra().validate(), Ok(()));
        for (field, damage) in breaks {
            let mut broken = spectra();
            damage(&mut broken);
            assert_eq!(broken.validate().unwrap_err().field, field);
        }
    }
}
