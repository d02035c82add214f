//! Optical constants: what index a material has at a wavelength.

use num_complex::Complex64;
use serde::{Deserialize, Serialize};

/// Real refractive index as a function of the vacuum wavelength.
///
/// In JSON: a number, `{"cauchy": [A, B, C, …]}` (B in µm², C in µm⁴ …),
/// `{"sellmeier": {"b": […], "c_um2": […]}}`, `{"table": [[nm, n, k], …]}` (linear interpolation, k
/// from the table is added to the medium's own `k`) or `{"material": "silver"}`, a name from [`crate::library`], which is read as the
/// numbers that stand there (and written as them).
#[derive(Clone, Debug, PartialEq)]
pub enum Dispersion {
    /// One index for every wavelength.
    Constant(f64),
    /// n(λ) = A + B/λ² + C/λ⁴ + …, λ in micrometres.
    Cauchy(Vec<f64>),
    /// n²(λ) = 1 + Σ b λ²/(λ² − c), λ in micrometres, c in µm².
    Sellmeier {
        /// Oscillator strengths.
        b: Vec<f64>,
        /// Squared resonance wavelengths in µm².
        c_um2: Vec<f64>,
    },
    /// Rows of (vacuum wavelength in nm, n, k), ascending in wavelength, read linearly.
    Table(Vec<[f64; 3]>),
}

/// A material: dispersion of n, and an extinction coefficient k on top of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Real index, with the k of a tabulated material.
    pub n: Dispersion,
    /// Extinction coefficient added at every wavelength (0 for a transparent medium).
    pub k: f64,
}

/// Why a material has no index at a wavelength, or none at all.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum MaterialError {
    /// A coefficient is not a finite number, or a list is empty or of the wrong length.
    #[error("{0}")]
    Malformed(String),
    /// The table does not reach the wavelength.
    #[error("the index table covers {from_nm} to {to_nm} nm, not {wavelength_nm} nm")]
    OutsideTable {
        /// The wavelength, nm.
        wavelength_nm: f64,
        /// First tabulated wavelength, nm.
        from_nm: f64,
        /// Last tabulated wavelength, nm.
        to_nm: f64,
    },
    /// The dispersion formula gives no positive real index here.
    #[error("the dispersion formula gives n = {n} at {wavelength_nm} nm; n must be positive and finite")]
    NoIndex {
        /// The wavelength, nm.
        wavelength_nm: f64,
        /// What the formula gives.
        n: f64,
    },
}

impl Material {
    /// A transparent material of one index.
    #[must_use]
    pub const fn constant(n: f64) -> Self {
        Self { n: Dispersion::Constant(n), k: 0.0 }
    }

    /// Complex index n + ik at a vacuum wavelength in metres.
    ///
    /// # Errors
    /// The wavelength lies outside a table, or the formula gives no positive finite n.
    pub fn index(&self, wavelength: f64) -> Result<Complex64, MaterialError> {
        let (n, k) = self.n.at(wavelength)?;
        Ok(Complex64::new(n, k + self.k))
    }
}

impl Dispersion {
    /// (n, k) at a vacuum wavelength in metres; k is 0 except for tables.
    ///
    /// # Errors
    /// As [`Material::index`].
    pub fn at(&self, wavelength: f64) -> Result<(f64, f64), MaterialError> {
        let um2 = (wavelength * 1e6).powi(2);
        let (n, k) = match self {
            Self::Constant(n) => (*n, 0.0),
            Self::Cauchy(coefficients) => (coefficients.iter().rev().fold(0.0, |sum, c| sum / um2 + c), 0.0),
            Self::Sellmeier { b, c_um2 } => {
                let n2: f64 = 1.0 + b.iter().zip(c_um2).map(|(b, c)| b * um2 / (um2 - c)).sum::<f64>();
                (n2.sqrt(), 0.0)
            }
            Self::Table(rows) => table_at(rows, wavelength)?,
        };
        if n.is_finite() && n > 0.0 {
            Ok((n, k))
        } else {
            Err(MaterialError::NoIndex { wavelength_nm: nanometres(wavelength), n })
        }
    }

    /// Vacuum wavelengths (metres) at which there is an index: all of a constant, those of a table, and around the wavelength `of_interest`,
    /// where it is an interpolation, those of a formula.
    #[must_use]
    pub fn covers(&self, of_interest: f64) -> [f64; 2] {
        match self {
            Self::Constant(_) => [0.0, f64::INFINITY],
            Self::Table(rows) => match (rows.first(), rows.last()) {
                (Some(first), Some(last)) => [first[0] * 1e-9, last[0] * 1e-9],
                _ => [of_interest; 2],
            },
            Self::Cauchy(_) | Self::Sellmeier { .. } => [of_interest / 1.5, of_interest * 2.0],
        }
    }

    /// Whether the index depends on the wavelength at all.
    #[must_use]
    pub const fn is_constant(&self) -> bool {
        matches!(self, Self::Constant(_))
    }

    /// Checks the coefficients themselves, for every wavelength.
    ///
    /// # Errors
    /// [`MaterialError::Malformed`] with what would be right.
    pub fn check(&self) -> Result<(), MaterialError> {
        let malformed = |why: &str| Err(MaterialError::Malformed(why.to_owned()));
        match self {
            Self::Constant(n) if !(n.is_finite() && *n > 0.0) => {
                Err(MaterialError::Malformed(format!("{n} is not an index; n must be positive and finite")))
            }
            Self::Cauchy(c) if c.is_empty() || c.iter().any(|c| !c.is_finite()) => {
                malformed("cauchy needs a list of finite coefficients [A, B in um^2, C in um^4, ...]")
            }
            Self::Sellmeier { b, c_um2 } if b.is_empty() || b.len() != c_um2.len() => {
                malformed("sellmeier needs lists b and c_um2 of the same length, at least one term")
            }
            Self::Sellmeier { b, c_um2 } if b.iter().chain(c_um2).any(|x| !x.is_finite()) => {
                malformed("sellmeier needs finite coefficients")
            }
            Self::Table(rows) => check_table(rows),
            _ => Ok(()),
        }
    }
}

fn check_table(rows: &[[f64; 3]]) -> Result<(), MaterialError> {
    let malformed = |why: String| Err(MaterialError::Malformed(why));
    if rows.is_empty() {
        return malformed("an index table needs at least one row [nm, n, k]".to_owned());
    }
    for [nm, n, k] in rows {
        if !(nm.is_finite() && *nm > 0.0 && n.is_finite() && *n > 0.0 && k.is_finite()) {
            return malformed(format!("index table row [{nm}, {n}, {k}] needs nm > 0, n > 0 and finite k"));
        }
    }
    match rows.windows(2).find(|pair| pair[1][0] <= pair[0][0]) {
        Some(pair) => malformed(format!(
            "index table wavelengths must ascend; {} nm follows {} nm",
            pair[1][0], pair[0][0]
        )),
        None => Ok(()),
    }
}

fn table_at(rows: &[[f64; 3]], wavelength: f64) -> Result<(f64, f64), MaterialError> {
    let nm = wavelength * 1e9;
    let (first, last) = match rows {
        [first, .., last] => (first, last),
        [only] => (only, only),
        [] => return Err(MaterialError::Malformed("the index table is empty".to_owned())),
    };
    // A wavelength that went through metres and back may miss the end of the table by a rounding error.
    let slack = 1e-9 * nm;
    if !(nm >= first[0] - slack && nm <= last[0] + slack) {
        let wavelength_nm = nanometres(wavelength);
        return Err(MaterialError::OutsideTable { wavelength_nm, from_nm: first[0], to_nm: last[0] });
    }
    let above = rows.partition_point(|row| row[0] < nm).clamp(1, rows.len().max(2) - 1);
    let (Some(lo), Some(hi)) = (rows.get(above - 1), rows.get(above)) else {
        return Ok((first[1], first[2]));
    };
    let t = ((nm - lo[0]) / (hi[0] - lo[0])).clamp(0.0, 1.0);
    Ok((lo[1] + t * (hi[1] - lo[1]), lo[2] + t * (hi[2] - lo[2])))
}

/// A length in metres for people to read, in nm: 14 digits, so that what went through metres comes back as it was.
#[must_use]
pub fn nanometres(metres: f64) -> f64 {
    format!("{:.13e}", metres * 1e9).parse().unwrap_or(f64::NAN)
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SellmeierJson {
    b: Vec<f64>,
    c_um2: Vec<f64>,
}

impl<'de> Deserialize<'de> for Dispersion {
    fn deserialize<D: serde::Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        use serde::de::Error as _;
        const FORMS: &str = "a number, {\"cauchy\": [A, B, ...]}, {\"sellmeier\": {\"b\": [...], \"c_um2\": [...]}}, {\"table\": [[nm, n, k], ...]} or {\"material\": NAME}";
        let value = serde_json::Value::deserialize(deserializer)?;
        let wrong = || D::Error::custom(format!("{value} is not an index; expected {FORMS}"));
        let dispersion = match &value {
            serde_json::Value::Number(number) => Self::Constant(number.as_f64().ok_or_else(wrong)?),
            serde_json::Value::Object(map) if map.len() == 1 => {
                let (kind, inner) = map.iter().next().ok_or_else(wrong)?;
                match kind.as_str() {
                    "cauchy" => Self::Cauchy(Vec::deserialize(inner).map_err(|_| wrong())?),
                    "sellmeier" => {
                        let SellmeierJson { b, c_um2 } =
                            SellmeierJson::deserialize(inner).map_err(|_| wrong())?;
                        Self::Sellmeier { b, c_um2 }
                    }
                    "table" => Self::Table(Vec::deserialize(inner).map_err(|_| wrong())?),
                    "material" => named(inner).map_err(D::Error::custom)?,
                    _ => return Err(wrong()),
                }
            }
            _ => return Err(wrong()),
        };
        dispersion.check().map_err(D::Error::custom)?;
        Ok(dispersion)
    }
}

fn named(name: &serde_json::Value) -> Result<Dispersion, String> {
    let entries = crate::library::entries();
    let found = entries.iter().find(|entry| name.as_str() == Some(entry.name.as_str()));
    found.map(|entry| entry.n.clone()).ok_or_else(|| {
        let names: Vec<&str> = entries.iter().map(|entry| entry.name.as_str()).collect();
        format!("{name} is not a material of the library; expected one of {}", names.join(", "))
    })
}

impl Serialize for Dispersion {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Self::Constant(n) => serializer.serialize_f64(*n),
            Self::Cauchy(c) => serde_json::json!({ "cauchy": c }).serialize(serializer),
            Self::Sellmeier { b, c_um2 } => {
                serde_json::json!({ "sellmeier": { "b": b, "c_um2": c_um2 } }).serialize(serializer)
            }
            Self::Table(rows) => serde_json::json!({ "table": rows }).serialize(serializer),
        }
    }
}

impl schemars::JsonSchema for Dispersion {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "Dispersion".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let numbers = serde_json::json!({ "type": "array", "items": { "type": "number" }, "minItems": 1 });
        let names: Vec<&str> = crate::library::entries().iter().map(|entry| entry.name.as_str()).collect();
        schemars::json_schema!({
            "description": "Real refractive index: a number, Cauchy or Sellmeier coefficients (wavelength in micrometres), rows [nm, n, k], or the name of a library material (`thinfilm materials` lists them).",
            "oneOf": [
                { "type": "number", "exclusiveMinimum": 0 },
                { "type": "object", "additionalProperties": false, "required": ["cauchy"],
                  "properties": { "cauchy": numbers } },
                { "type": "object", "additionalProperties": false, "required": ["sellmeier"],
                  "properties": { "sellmeier": { "type": "object", "additionalProperties": false,
                    "required": ["b", "c_um2"], "properties": { "b": numbers, "c_um2": numbers } } } },
                { "type": "object", "additionalProperties": false, "required": ["table"],
                  "properties": { "table": { "type": "array", "minItems": 1, "items":
                    { "type": "array", "items": { "type": "number" }, "minItems": 3, "maxItems": 3 } } } },
                { "type": "object", "additionalProperties": false, "required": ["material"],
                  "properties": { "material": { "enum": names } } }
            ]
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cauchy_is_a_series_in_inverse_squared_micrometres() {
        let n = Dispersion::Cauchy(vec![1.5, 0.004, 0.0002]).at(500e-9).unwrap().0;
        assert!((n - (1.5 + 0.004 / 0.25 + 0.0002 / 0.0625)).abs() < 1e-14);
    }

    #[test]
    fn lengths_that_went_through_metres_are_printed_as_they_were_given() {
        for tenths in 1..20_000 {
            let nm = f64::from(tenths) / 10.0;
            assert_eq!(nanometres(nm * 1e-9), nm);
        }
        let refusal = Dispersion::Table(vec![[600.0, 1.5, 0.0]]).at(500e-9).unwrap_err().to_string();
        assert_eq!(refusal, "the index table covers 600 to 600 nm, not 500 nm");
    }

    #[test]
    fn a_table_is_read_linearly_and_refuses_to_extrapolate() {
        let table = Dispersion::Table(vec![[400.0, 1.6, 0.0], [600.0, 1.5, 0.1]]);
        let (n, k) = table.at(500e-9).unwrap();
        assert!((n - 1.55).abs() < 1e-12 && (k - 0.05).abs() < 1e-12);
        assert!(table.at(400e-9).is_ok() && table.at(600e-9).is_ok());
        assert!(matches!(table.at(399e-9), Err(MaterialError::OutsideTable { .. })));
    }

    #[test]
    fn every_form_survives_json() {
        for text in [
            "1.53",
            r#"{"cauchy":[1.5,0.004]}"#,
            r#"{"sellmeier":{"b":[1.0],"c_um2":[0.01]}}"#,
            r#"{"table":[[400.0,1.6,0.0],[700.0,1.5,0.0]]}"#,
        ] {
            let parsed: Dispersion = serde_json::from_str(text).unwrap();
            assert_eq!(serde_json::to_string(&parsed).unwrap(), text);
        }
    }

    #[test]
    fn a_name_is_the_numbers_of_the_library() {
        let named: Dispersion = serde_json::from_str(r#"{"material": "silver"}"#).unwrap();
        // Johnson and Christy's silver at 520.9 nm.
        assert_eq!(named.at(520.9e-9).unwrap(), (0.05, 3.324));
        let written = serde_json::to_string(&named).unwrap();
        assert_eq!(serde_json::from_str::<Dispersion>(&written).unwrap(), named);
        let error =
            serde_json::from_str::<Dispersion>(r#"{"material": "unobtainium"}"#).unwrap_err().to_string();
        assert!(
            error.contains("unobtainium") && error.contains("conchiolin") && !error.contains('\n'),
            "{error}"
        );
    }

    #[test]
    fn nonsense_is_refused_with_what_would_be_right() {
        for text in [
            "0",
            "-1.5",
            "\"1.5\"",
            "{\"cauchy\":[]}",
            "{\"cauchi\":[1]}",
            "{\"material\":3}",
            "{\"table\":[[500,1.5,0],[400,1.5,0]]}",
        ] {
            let error = serde_json::from_str::<Dispersion>(text).unwrap_err().to_string();
            assert!(!error.contains('\n') && error.len() > 20, "{text}: {error}");
        }
    }
}
