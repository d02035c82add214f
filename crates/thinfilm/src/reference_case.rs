//! Checking [`Multilayer::solve`] against references computed in many digits.
//!
//! A case holds a stack, one wave, and r, t, R, T as decimal strings with the condition number κ of each. A result X passes
//! when it is finite and |X − ref| ≤ max(1e-12, 50·2⁻⁵³·(N + κ))·|ref|, N the number of layers: what rounding the inputs to
//! f64 already costs. Where the reference is exactly 0 the same bound is absolute. A quantity below 1e-300 is
//! compared by its logarithm, and its f64 value must be 0 or as small.

use num_complex::Complex64;
use serde::Deserialize;

use crate::wave::{Incidence, Layer, Multilayer, Polarisation, Response, Run, WaveError};

/// A file of reference cases. Keys that are not listed here are ignored.
#[derive(Clone, Debug, Deserialize)]
pub struct CaseFile {
    /// The cases.
    pub cases: Vec<Case>,
}

/// One stack, one wave, and what must come out.
#[derive(Clone, Debug, Deserialize)]
pub struct Case {
    /// Name of the case.
    pub id: String,
    /// "s" or "p".
    pub pol: String,
    /// Vacuum wavelength in nm.
    pub lambda_nm: f64,
    /// (n, k) of the ambient.
    pub n_in: [f64; 2],
    /// (n, k) of the substrate.
    pub n_sub: [f64; 2],
    /// (n, k) of the materials that `stack` refers to.
    pub materials: Vec<[f64; 2]>,
    /// Blocks from the incidence side.
    pub stack: Vec<CaseBlock>,
    /// Angle of incidence in radians; either this or `kx`.
    #[serde(default)]
    pub theta_rad: Option<f64>,
    /// In-plane wavenumber over k₀; either this or `theta_rad`.
    #[serde(default)]
    pub kx: Option<f64>,
    /// The references.
    #[serde(rename = "ref")]
    pub reference: CaseReference,
    /// Condition numbers.
    #[serde(default)]
    pub kappa: CaseCondition,
}

/// A unit of (material number, thickness in nm), repeated.
#[derive(Clone, Debug, Deserialize)]
pub struct CaseBlock {
    /// How often.
    pub repeat: u64,
    /// The layers of the unit.
    pub unit: Vec<(usize, f64)>,
}

/// Reference values as decimal strings.
#[derive(Clone, Debug, Deserialize)]
pub struct CaseReference {
    /// (Re, Im) of r.
    pub r: [String; 2],
    /// (Re, Im) of t.
    pub t: [String; 2],
    /// R.
    #[serde(rename = "R")]
    pub reflectance: String,
    /// T.
    #[serde(rename = "T")]
    pub transmittance: String,
}

/// Condition numbers; missing or null means: not known, the quantity is then held to N alone.
#[derive(Clone, Debug, Default, Deserialize)]
pub struct CaseCondition {
    /// κ of r.
    #[serde(default)]
    pub r: Option<f64>,
    /// κ of t.
    #[serde(default)]
    pub t: Option<f64>,
    /// κ of R.
    #[serde(default, rename = "R")]
    pub reflectance: Option<f64>,
    /// κ of T.
    #[serde(default, rename = "T")]
    pub transmittance: Option<f64>,
}

/// A case that is not well formed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("case {id:?}: {why}")]
pub struct CaseError {
    /// Name of the case.
    pub id: String,
    /// What is wrong, and what would be right.
    pub why: String,
}

/// Relative error of one quantity and what it may be.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Deviation {
    /// Relative error (absolute where the reference is 0).
    pub error: f64,
    /// Bound on it.
    pub tolerance: f64,
}

/// Verdict on one case.
#[derive(Clone, Debug, PartialEq)]
pub struct Verdict {
    /// Whether all four quantities are finite and within their tolerance.
    pub pass: bool,
    /// Deviation of r.
    pub r: Deviation,
    /// Deviation of t.
    pub t: Deviation,
    /// Deviation of R.
    pub reflectance: Deviation,
    /// Deviation of T.
    pub transmittance: Deviation,
}

/// Largest number of cases, and of layers listed in one, that a file may hold.
pub const MOST_CASES: usize = 100_000;

impl Case {
    /// Stack, wave and polarisation of the case.
    ///
    /// # Errors
    /// A field does not make sense; the text names it.
    pub fn wave(&self) -> Result<(Multilayer, Incidence, Polarisation), CaseError> {
        let wrong = |why: String| CaseError { id: self.id.clone(), why };
        let polarisation = match self.pol.as_str() {
            "s" => Polarisation::S,
            "p" => Polarisation::P,
            other => return Err(wrong(format!("pol is {other:?}; it must be \"s\" or \"p\""))),
        };
        let incidence = match (self.theta_rad, self.kx) {
            (Some(theta), None) => Incidence::Angle(theta),
            (None, Some(kx)) => Incidence::InPlane(kx),
            _ => return Err(wrong("it must have either theta_rad or kx".to_owned())),
        };
        let index = |[n, k]: [f64; 2]| Complex64::new(n, k);
        let layer = |&(material, nm): &(usize, f64)| {
            let index = *self.materials.get(material).ok_or_else(|| {
                wrong(format!("stack names material {material}; there are {} of them", self.materials.len()))
            })?;
            Ok(Layer { index: Complex64::new(index[0], index[1]), thickness: nm * 1e-9 })
        };
        let runs = self.stack.iter().map(|block| {
            Ok(Run { unit: block.unit.iter().map(layer).collect::<Result<_, _>>()?, repeat: block.repeat })
        });
        let stack = Multilayer {
            ambient: index(self.n_in),
            runs: runs.collect::<Result<_, _>>()?,
            substrate: index(self.n_sub),
        };
        Ok((stack, incidence, polarisation))
    }

    /// Solves the case with [`Multilayer::solve`] and compares.
    ///
    /// # Errors
    /// The case is malformed, or its wave is none (a wavelength of 0, say).
    pub fn verify(&self) -> Result<Verdict, CaseError> {
        let (stack, incidence, polarisation) = self.wave()?;
        let response = stack
            .solve(self.lambda_nm * 1e-9, incidence, polarisation)
            .map_err(|error: WaveError| CaseError { id: self.id.clone(), why: error.to_string() })?;
        self.compare(&response, stack.layer_count())
    }

    /// Compares a response with the references.
    ///
    /// # Errors
    /// A reference is not a decimal number.
    pub fn compare(&self, response: &Response, layers: u128) -> Result<Verdict, CaseError> {
        let decimal = |field: &str, text: &str| {
            Decimal::parse(text).ok_or_else(|| CaseError {
                id: self.id.clone(),
                why: format!("ref.{field} is {text:?}, not a decimal number"),
            })
        };
        let tolerance = |kappa: Option<f64>| {
            let kappa = kappa.filter(|k| k.is_finite() && *k >= 0.0).unwrap_or(0.0);
            (50.0 * 2f64.powi(-53) * (layers as f64 + kappa)).max(1e-12)
        };
        let reference = &self.reference;
        let amplitude = |field: &str, [re, im]: &[String; 2], value: Complex64, ln_abs: f64| {
            Ok(complex_error(value, ln_abs, decimal(field, re)?, decimal(field, im)?))
        };
        let power = |field: &str, text: &str, value: f64, ln: f64| {
            let zero = Decimal { mantissa: 0.0, exponent: 0 };
            Ok(complex_error(Complex64::new(value, 0.0), ln, decimal(field, text)?, zero))
        };
        let r = amplitude("r", &reference.r, response.r, response.r.norm().ln())?;
        let t = amplitude("t", &reference.t, response.t, response.ln_abs_t)?;
        let big_r = power("R", &reference.reflectance, response.reflectance, response.reflectance.ln())?;
        let big_t = power("T", &reference.transmittance, response.transmittance, response.ln_transmittance)?;
        let deviation = |error, kappa| Deviation { error, tolerance: tolerance(kappa) };
        let deviations = [
            deviation(r, self.kappa.r),
            deviation(t, self.kappa.t),
            deviation(big_r, self.kappa.reflectance),
            deviation(big_t, self.kappa.transmittance),
        ];
        let [r, t, reflectance, transmittance] = deviations;
        // A NaN error fails: it compares false.
        let pass = deviations.iter().all(|d| d.error <= d.tolerance);
        Ok(Verdict { pass, r, t, reflectance, transmittance })
    }
}

/// mantissa · 10^exponent: a decimal string may lie far outside f64.
#[derive(Clone, Copy)]
struct Decimal {
    mantissa: f64,
    exponent: i32,
}

impl Decimal {
    fn parse(text: &str) -> Option<Self> {
        let (mantissa, exponent) = match text.split_once(['e', 'E']) {
            Some((mantissa, exponent)) => (mantissa, exponent.parse().ok()?),
            None => (text, 0),
        };
        let plain = mantissa.bytes().all(|c| c.is_ascii_digit() || b"+-.".contains(&c));
        let mantissa: f64 = mantissa.parse().ok()?;
        (plain && mantissa.is_finite() && (-1_000_000..=1_000_000).contains(&exponent))
            .then_some(Self { mantissa, exponent })
    }

    fn value(self) -> f64 {
        // Through a string: f64's own parser rounds correctly also where 10^exponent is not exact.
        format!("{}e{}", self.mantissa, self.exponent).parse().unwrap_or(0.0)
    }

    fn ln_abs(self) -> f64 {
        self.mantissa.abs().ln() + f64::from(self.exponent) * std::f64::consts::LN_10
    }
}

fn complex_error(value: Complex64, ln_abs: f64, re: Decimal, im: Decimal) -> f64 {
    const TINY: f64 = -300.0 * std::f64::consts::LN_10;
    let (ln_re, ln_im) = (re.ln_abs(), im.ln_abs());
    let larger = ln_re.max(ln_im);
    if larger == f64::NEG_INFINITY {
        return value.norm();
    }
    let reference = Complex64::new(re.value(), im.value());
    if larger >= TINY {
        return (value - reference).norm() / reference.norm();
    }
    // Below f64: the value must be as small, and its logarithm right.
    if value.norm().is_nan() || value.norm() > 1e-300 {
        return f64::INFINITY;
    }
    let ratio = (ln_re - larger).exp().hypot((ln_im - larger).exp());
    (ln_abs - (larger + ratio.ln())).exp_m1().abs()
}
