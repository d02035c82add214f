//! The colours of interference that rendering needs, baked once: section `spectra` of the metadata.
//!
//! Every array of arrays is `[θ][band]`: one row a stored angle, one value a wavelength band. A renderer
//! multiplies the lobe by the modulation at the half-vector angle, and the base by the illuminant at the exit
//! angle.

use crate::error::Flaw;
use crate::table::Meta;
use serde::{Deserialize, Serialize};

/// Key of the section in the metadata.
pub const KEY: &str = "spectra";
/// Most bands, and most angles.
pub const MAX_NODES: usize = 1024;
/// Largest modulation or illuminant that is taken for one: R_incoherent of a pearl is far above 1e-6.
const MAX_VALUE: f64 = 1e6;

/// Interference colours over wavelength and angle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Spectra {
    /// Band centres, vacuum wavelength in nm, ascending. Values are means over the band.
    pub wavelength_nm: Vec<f64>,
    /// Angles in the ambient medium, degrees, ascending from 0 to 90.
    pub theta_deg: Vec<f64>,
    /// M(λ, θ) = R_coherent / R_incoherent, θ the half-vector angle.
    pub modulation: Vec<Vec<f64>>,
    /// Ê(λ, θ): radiance of light scattered inside the stack, unit mean over wavelength, θ the exit angle.
    pub illuminant: Vec<Vec<f64>>,
    /// R_incoherent(λ, θ) that `modulation` was divided by; for information.
    pub incoherent: Vec<Vec<f64>>,
    /// M in linear sRGB (D65 white is 1, 1, 1), no channel below 0 or above 1/R_incoherent.
    pub modulation_rgb: Vec<[f64; 3]>,
    /// Ê in linear sRGB, no channel below 0.
    pub illuminant_rgb: Vec<[f64; 3]>,
}

impl Spectra {
    /// The section of a table, if it has one.
    ///
    /// # Errors
    /// The section is there and is not valid.
    pub fn of(meta: &Meta) -> Result<Option<Self>, Flaw> {
        let Some(value) = meta.extra.get(KEY) else { return Ok(None) };
        let spectra: Self =
            serde_path_to_error::deserialize(value).map_err(|error| match error.path().to_string() {
                path if path == "." => Flaw::new(KEY, error.inner().to_string()),
                path => Flaw::new(format!("{KEY}.{path}"), error.inner().to_string()),
            })?;
        spectra.validate().map_err(|flaw| Flaw::new(format!("{KEY}.{}", flaw.field), flaw.problem))?;
        Ok(Some(spectra))
    }

    /// Puts the section into a table's metadata, numbers rounded to seven significant digits (f32 holds no more).
    ///
    /// # Errors
    /// The section is not valid.
    pub fn store(&self, meta: &mut Meta) -> Result<(), Flaw> {
        let rounded = self.rounded();
        rounded.validate()?;
        let value = serde_json::to_value(&rounded).map_err(|error| Flaw::new(KEY, error.to_string()))?;
        meta.extra.insert(KEY.to_owned(), value);
        Ok(())
    }

    fn rounded(&self) -> Self {
        let row = |row: &Vec<f64>| row.iter().map(|x| seven_digits(*x)).collect();
        let rgb = |rgb: &[f64; 3]| rgb.map(seven_digits);
        Self {
            wavelength_nm: row(&self.wavelength_nm),
            theta_deg: row(&self.theta_deg),
            modulation: self.modulation.iter().map(row).collect(),
            illuminant: self.illuminant.iter().map(row).collect(),
            incoherent: self.incoherent.iter().map(row).collect(),
            modulation_rgb: self.modulation_rgb.iter().map(rgb).collect(),
            illuminant_rgb: self.illuminant_rgb.iter().map(rgb).collect(),
        }
    }

    /// Checks shapes and ranges.
    ///
    /// # Errors
    /// The first flaw found.
    pub fn validate(&self) -> Result<(), Flaw> {
        let (bands, angles) = (self.wavelength_nm.len(), self.theta_deg.len());
        check_axis("wavelength_nm", &self.wavelength_nm, 1, |nm| nm > 0.0, "a positive wavelength")?;
        check_axis("theta_deg", &self.theta_deg, 2, |t| (0.0..=90.0).contains(&t), "an angle from 0 to 90")?;
        if self.theta_deg[0] != 0.0 || self.theta_deg[angles - 1] != 90.0 {
            let problem = format!(
                "runs from {} to {}, expected 0 to 90",
                self.theta_deg[0],
                self.theta_deg[angles - 1]
            );
            return Err(Flaw::new("theta_deg", problem));
        }
        for (name, rows) in [
            ("modulation", &self.modulation),
            ("illuminant", &self.illuminant),
            ("incoherent", &self.incoherent),
        ] {
            check_length(name, rows.len(), angles, "angles")?;
            for (i, row) in rows.iter().enumerate() {
                check_length(&format!("{name}[{i}]"), row.len(), bands, "bands")?;
                check_values(&format!("{name}[{i}]"), row)?;
            }
        }
        for (name, rows) in
            [("modulation_rgb", &self.modulation_rgb), ("illuminant_rgb", &self.illuminant_rgb)]
        {
            check_length(name, rows.len(), angles, "angles")?;
            for (i, rgb) in rows.iter().enumerate() {
                check_values(&format!("{name}[{i}]"), rgb)?;
            }
        }
        Ok(())
    }
}

fn check_axis(
    name: &str,
    nodes: &[f64],
    fewest: usize,
    valid: impl Fn(f64) -> bool,
    right: &str,
) -> Result<(), Flaw> {
    if !(fewest..=MAX_NODES).contains(&nodes.len()) {
        return Err(Flaw::new(
            name,
            format!("has {} entries, expected {fewest} to {MAX_NODES}", nodes.len()),
        ));
    }
    if let Some(i) = nodes.iter().position(|x| !(x.is_finite() && valid(*x))) {
        return Err(Flaw::new(format!("{name}[{i}]"), format!("is {}, expected {right}", nodes[i])));
    }
    match nodes.windows(2).position(|pair| pair[1] <= pair[0]) {
        None => Ok(()),
        Some(i) => {
            let problem =
                format!("is {}, expected more than the entry before it, {}", nodes[i + 1], nodes[i]);
            Err(Flaw::new(format!("{name}[{}]", i + 1), problem))
        }
    }
}

fn check_length(name: &str, found: usize, expected: usize, of: &str) -> Result<(), Flaw> {
    if found == expected {
        return Ok(());
    }
    Err(Flaw::new(name, format!("has {found} entries, expected one for each of the {expected} {of}")))
}

fn check_values(name: &str, values: &[f64]) -> Result<(), Flaw> {
    match values.iter().position(|v| !(0.0..=MAX_VALUE).contains(v)) {
        None => Ok(()),
        Some(i) => {
            Err(Flaw::new(format!("{name}[{i}]"), format!("is {}, expected 0 to {MAX_VALUE}", values[i])))
        }
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
            theta_deg: vec![0.0, 90.0],
            modulation: rows.clone(),
            illuminant: rows.clone(),
            incoherent: rows,
            modulation_rgb: vec![[0.1, 0.2, 0.3]; 2],
            illuminant_rgb: vec![[1.0; 3]; 2],
        }
    }

    #[test]
    fn numbers_keep_seven_digits() {
        assert_eq!(spectra().rounded().modulation[0][0], 0.3333333);
        assert_eq!(seven_digits(0.0), 0.0);
    }

    #[test]
    fn every_flaw_is_refused_with_its_field() {
        let breaks: [(&str, fn(&mut Spectra)); 8] = [
            ("wavelength_nm", |s| s.wavelength_nm.clear()),
            ("wavelength_nm[1]", |s| s.wavelength_nm[1] = 450.0),
            ("theta_deg", |s| s.theta_deg[1] = 89.0),
            ("modulation", |s| s.modulation.truncate(1)),
            ("modulation[1]", |s| s.modulation[1].push(0.0)),
            ("illuminant[0][1]", |s| s.illuminant[0][1] = f64::NAN),
            ("illuminant_rgb[1][2]", |s| s.illuminant_rgb[1][2] = -1e-3),
            ("theta_deg", |s| s.theta_deg = vec![0.0; MAX_NODES + 1]),
        ];
        assert_eq!(spectra().validate(), Ok(()));
        for (field, damage) in breaks {
            let mut broken = spectra();
            damage(&mut broken);
            assert_eq!(broken.validate().unwrap_err().field, field);
        }
    }
}
