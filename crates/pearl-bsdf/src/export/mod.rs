//! A pearl in formats of other programs, with the error of the round trip.

mod astm;
mod blender;
mod csv;
mod gltf;
mod goniometer;
mod layered;
mod microfacet;
mod nonnegative;
pub mod npz;
mod openpbr;
mod radiance;
mod three;
mod zemax;

use crate::measured::{self, Channels, Reader};
use crate::round_trip::{self, Preview, RoundTrip};
use crate::{Array, Direction, PearlBsdf};
use lut_io::FieldError;
use lut_io::merl::Merl;
use lut_io::tensor_file;
use serde_json::{Map, Value, json};
use std::path::Path;

/// Wavelengths that a spectral file is compared at, spread evenly from the first to the last of the table: of the file and between.
const COMPARED: usize = 37;

/// A format.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// All that the evaluation reads, as named arrays.
    Arrays,
    /// Tensor file for RGB renderers.
    BsdfRgb,
    /// Tensor file for spectral renderers.
    BsdfSpectral,
    /// The MERL database's.
    Merl,
    /// Radiance's tensor tree.
    Radiance,
    /// Three microfacet lobes.
    Microfacet,
    /// Blender's: a script that makes a material.
    Blender,
    /// The same as an add-on.
    BlenderAddOn,
    /// A material for three.js.
    Three,
    /// A sphere with a material of glTF.
    Gltf,
    /// An OpenPBR surface of MaterialX.
    OpenPbr,
    /// The BRDF as an instrument measures it.
    Csv,
    /// The same, as ASTM has it.
    Astm,
    /// Zemax OpticStudio's tabular BSDF.
    Zemax,
}

impl Format {
    /// All of them.
    pub const ALL: [Self; 14] = [
        Self::Arrays,
        Self::BsdfRgb,
        Self::BsdfSpectral,
        Self::Merl,
        Self::Radiance,
        Self::Microfacet,
        Self::Blender,
        Self::BlenderAddOn,
        Self::Three,
        Self::Gltf,
        Self::OpenPbr,
        Self::Csv,
        Self::Astm,
        Self::Zemax,
    ];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Arrays => "arrays",
            Self::BsdfRgb => "bsdf-rgb",
            Self::BsdfSpectral => "bsdf-spectral",
            Self::Merl => "merl",
            Self::Radiance => "radiance",
            Self::Microfacet => "microfacet",
            Self::Blender => "blender",
            Self::BlenderAddOn => "blender-add-on",
            Self::Three => "three",
            Self::Gltf => "gltf",
            Self::OpenPbr => "openpbr",
            Self::Csv => "csv",
            Self::Astm => "astm",
            Self::Zemax => "zemax",
        }
    }

    /// How its files end.
    #[must_use]
    pub const fn ending(self) -> &'static str {
        match self {
            Self::Arrays => "npz",
            Self::BsdfRgb | Self::BsdfSpectral | Self::Zemax => "bsdf",
            Self::Merl => "binary",
            Self::Radiance => "xml",
            Self::Microfacet => "json",
            Self::Blender => "py",
            Self::BlenderAddOn => "zip",
            Self::Three => "js",
            Self::Gltf => "glb",
            Self::OpenPbr => "mtlx",
            Self::Csv => "csv",
            Self::Astm => "astm",
        }
    }

    /// What it is.
    #[must_use]
    pub const fn description(self) -> &'static str {
        match self {
            Self::Arrays => "All that the evaluation reads, as named arrays (.npz)",
            Self::BsdfRgb => "Tensor file (.bsdf) for RGB renderers",
            Self::BsdfSpectral => "Tensor file (.bsdf) for spectral renderers",
            Self::Merl => "MERL .binary; made reciprocal, as the format demands",
            Self::Radiance => "Radiance's BSDF XML: a tensor tree of rank 3, in colour",
            Self::Microfacet => "Three Beckmann lobes and a diffuse one by viewing angle (.json)",
            Self::Blender => "Python file that makes the material in Blender 4.2 and newer",
            Self::BlenderAddOn => {
                "Add-on for Blender (.zip) with File > Import > Pearl, and this pearl in it"
            }
            Self::Three => "ES module with a material for three.js",
            Self::Gltf => "A sphere with glTF's nearest material: iridescence, clearcoat (.glb)",
            Self::OpenPbr => "MaterialX's nearest OpenPBR surface (.mtlx)",
            Self::Csv => "The BRDF as measured: angles, solid angle, red, green, blue",
            Self::Astm => "The BRDF as measured, in the data format of ASTM E1392",
            Self::Zemax => "Tabular BSDF of Zemax OpticStudio (.bsdf, text)",
        }
    }
}

/// A file, and what it holds.
#[derive(Clone, Debug)]
pub struct Export {
    /// Its format.
    pub format: Format,
    /// Its bytes.
    pub bytes: Vec<u8>,
    /// What it holds.
    pub content: Content,
}

/// What a file holds.
#[derive(Clone, Debug)]
pub enum Content {
    /// The arrays themselves.
    Arrays(Vec<Array>),
    /// An approximation, so far from the table; a picture of it too, of what is in colour.
    Approximation(Vec<RoundTrip>, Option<Preview>),
    /// The nearest material of a kind: the same, and its numbers.
    Material(Vec<RoundTrip>, Option<Preview>, Map<String, Value>),
}

impl Export {
    /// The pearl of this name in a format.
    ///
    /// # Errors
    /// More than a file of this format holds.
    pub fn new(bsdf: &PearlBsdf, name: &str, format: Format) -> Result<Self, FieldError> {
        let (bytes, content) = match format {
            Format::Arrays => arrays(bsdf)?,
            Format::BsdfRgb => tensor(bsdf, &Channels::Rgb, name)?,
            Format::BsdfSpectral => tensor(bsdf, &Channels::Spectral(measured::wavelengths_nm(bsdf)), name)?,
            Format::Merl => merl(bsdf)?,
            Format::Radiance => radiance(bsdf, name)?,
            Format::Microfacet => microfacet(bsdf, name)?,
            Format::Blender => blender(bsdf, name)?,
            Format::BlenderAddOn => {
                let (script, content) = blender(bsdf, name)?;
                let add_on =
                    blender::add_on(&script).map_err(|why| FieldError::new("add-on", why.to_string()))?;
                (add_on, content)
            }
            Format::Three => {
                let (module, arrays) = three::encode(bsdf, name)?;
                (module, Content::Arrays(arrays))
            }
            Format::Gltf => {
                let material = gltf::Gltf::new(bsdf);
                (material.encode(name), material_of(bsdf, material.fitted()))
            }
            Format::OpenPbr => {
                let surface = openpbr::OpenPbr::new(bsdf);
                (surface.encode(name)?, material_of(bsdf, surface.fitted()))
            }
            Format::Csv => measured_as(bsdf, csv::encode),
            Format::Astm => measured_as(bsdf, |measured| astm::encode(measured, name)),
            Format::Zemax => {
                let scatter = zemax::Scatter::new(bsdf);
                (scatter.encode(name), against_light(bsdf, |wi, wo| scatter.eval(wi, wo)))
            }
        };
        Ok(Self { format, bytes, content })
    }

    /// What a program says of the file that it wrote.
    #[must_use]
    pub fn report(&self, output: &Path) -> Value {
        let mut report = json!({
            "schema": "lut-export/1",
            "format": self.format.name(),
            "output": output.display().to_string(),
            "bytes": self.bytes.len(),
        });
        match &self.content {
            Content::Arrays(arrays) => {
                let shapes = arrays.iter().map(|array| (array.name.to_owned(), json!(array.shape)));
                report["arrays"] = Value::Object(shapes.collect());
            }
            Content::Approximation(errors, preview) => report["round_trip"] = described(errors, *preview),
            Content::Material(errors, preview, numbers) => {
                report["round_trip"] = described(errors, *preview);
                report["material"] = Value::Object(numbers.clone());
            }
        }
        report
    }
}

fn described(errors: &[RoundTrip], preview: Option<Preview>) -> Value {
    let row = |error: &RoundTrip| {
        json!({
            "theta_i_deg": error.theta_i_deg,
            "error_percent": error.error_percent,
            "bias_percent": error.bias_percent,
        })
    };
    let rows: Vec<_> = errors.iter().map(row).collect();
    let worst = errors.iter().map(|error| error.error_percent).fold(0.0, f64::max);
    let preview = preview.map(|Preview { mean, most }| json!({ "mean": mean, "percentile_95": most }));
    json!({ "worst_percent": worst, "preview_delta_e": preview, "per_incidence": rows })
}

fn arrays(bsdf: &PearlBsdf) -> Result<(Vec<u8>, Content), FieldError> {
    let arrays = bsdf.prepared().arrays();
    let bytes =
        npz::encode(&arrays, npz::Form::Whole).map_err(|why| FieldError::new("arrays", why.to_string()))?;
    Ok((bytes, Content::Arrays(arrays)))
}

fn tensor(bsdf: &PearlBsdf, channels: &Channels, name: &str) -> Result<(Vec<u8>, Content), FieldError> {
    let description = format!("{name}, exported by nacre");
    let bytes = tensor_file::encode(&measured::fields(bsdf, channels, &description))?;
    // What is compared is what was written.
    let reader = Reader::new(&tensor_file::decode(&bytes)?)?;
    let content = match channels {
        Channels::Rgb => in_colour(bsdf, |wi, wo| {
            let rgb = reader.eval(wi, wo);
            [rgb[0], rgb[1], rgb[2]]
        }),
        Channels::Spectral(_) => {
            let compared = compared_nm(&reader.wavelengths_nm);
            let errors = round_trip::measure(
                bsdf,
                |wi, wo| bsdf.eval_seen_spectrum(wi, wo, &compared),
                |wi, wo| reader.eval_spectrum(wi, wo, &compared),
            );
            Content::Approximation(errors, None)
        }
    };
    Ok((bytes, content))
}

fn compared_nm(nodes: &[f64]) -> Vec<f64> {
    let (first, last) = (nodes[0], nodes[nodes.len() - 1]);
    // Some offset: bands are evenly spaced, and not all are to be met alike.
    (0..COMPARED).map(|i| first + (last - first) * (i as f64 + 0.37) / COMPARED as f64).collect()
}

fn merl(bsdf: &PearlBsdf) -> Result<(Vec<u8>, Content), FieldError> {
    let merl = Merl::tabulate(|wi, wo| {
        let (there, back) = (bsdf.eval_seen(wi, wo).rgb(), bsdf.eval_seen(wo, wi).rgb());
        // Reciprocal, as the format demands, by the mean of both ways weighted by the light that each stands for. The plain mean
        // of both f grows without limit where one direction nears the horizon, and such a pearl shines.
        std::array::from_fn(|c| (there[c] + back[c]) / (wo[2] + wi[2]))
    });
    let bytes = merl.encode();
    let merl = Merl::decode(&bytes)?;
    let read = |wi, wo: Direction| merl.eval(wi, wo).map_or([0.0; 3], |rgb| rgb.map(|x| x * wo[2]));
    Ok((bytes, in_colour(bsdf, read)))
}

fn radiance(bsdf: &PearlBsdf, name: &str) -> Result<(Vec<u8>, Content), FieldError> {
    let (bytes, tree) = radiance::encode(bsdf, name)?;
    Ok((bytes, in_colour(bsdf, |wi, wo| tree.eval(wi, wo))))
}

fn microfacet(bsdf: &PearlBsdf, name: &str) -> Result<(Vec<u8>, Content), FieldError> {
    let lobes = microfacet::Microfacets::new(bsdf)?;
    Ok((lobes.encode(name), in_colour(bsdf, |wi, wo| lobes.eval(wi, wo))))
}

fn blender(bsdf: &PearlBsdf, name: &str) -> Result<(Vec<u8>, Content), FieldError> {
    let curves = blender::Curves::new(bsdf)?;
    Ok((curves.script(name)?, in_colour(bsdf, |wi, wo| curves.eval(wi, wo))))
}

/// How far a file in linear sRGB is from what a viewer sees of the table.
fn in_colour(bsdf: &PearlBsdf, file: impl Fn(Direction, Direction) -> [f64; 3] + Sync) -> Content {
    compared(bsdf, |wi, wo| bsdf.eval_seen(wi, wo).rgb(), file)
}

/// And from the table for light that arrives at an incidence, which is what instruments measure.
fn against_light(bsdf: &PearlBsdf, file: impl Fn(Direction, Direction) -> [f64; 3] + Sync) -> Content {
    compared(bsdf, |wi, wo| bsdf.eval(wi, wo).rgb(), file)
}

fn compared(
    bsdf: &PearlBsdf,
    truth: impl Fn(Direction, Direction) -> [f64; 3] + Sync,
    file: impl Fn(Direction, Direction) -> [f64; 3] + Sync,
) -> Content {
    let errors = round_trip::measure(bsdf, |wi, wo| truth(wi, wo).to_vec(), |wi, wo| file(wi, wo).to_vec());
    Content::Approximation(errors, Some(round_trip::preview(bsdf, truth, file)))
}

fn material_of<const N: usize>(bsdf: &PearlBsdf, fitted: &layered::Fitted<N>) -> Content {
    match in_colour(bsdf, |wi, wo| fitted.eval(wi, wo)) {
        Content::Approximation(errors, preview) => Content::Material(errors, preview, fitted.describe()),
        other => other,
    }
}

fn measured_as(bsdf: &PearlBsdf, encode: impl Fn(&goniometer::Measured) -> Vec<u8>) -> (Vec<u8>, Content) {
    let measured = goniometer::Measured::new(bsdf);
    (encode(&measured), against_light(bsdf, |wi, wo| measured.eval(wi, wo)))
}

/// A name that XML cannot hold.
fn check_xml(name: &str) -> Result<(), FieldError> {
    if name.chars().all(|c| c == '\t' || !c.is_control()) {
        return Ok(());
    }
    Err(FieldError::new("name", "holds a control character, which XML cannot"))
}

fn xml_text(name: &str) -> String {
    name.replace('&', "&amp;").replace('<', "&lt;")
}
