//! The renderer's variant: how many channels, and whether polarised.

use super::SceneError;
use super::tree::{Element, Files};
use crate::effects::{ColourMode, Setting};

/// Colour and polarisation of a renderer, each with where it was said.
#[derive(Clone, Debug, PartialEq)]
pub struct Variant {
    /// Channels.
    pub colour: Setting<ColourMode>,
    /// Whether Stokes vectors are followed.
    pub polarised: Setting<bool>,
}

impl Variant {
    /// Parses a Mitsuba variant (`scalar_rgb`, `llvm_ad_spectral_polarized`) or its colour part alone (`mono`, `rgb`,
    /// `spectral`, `polarised`).
    ///
    /// # Errors
    /// A name that is none; what would be right.
    pub fn parse(name: &str, from: &str) -> Result<Self, String> {
        let (mut colour, mut polarised) = (None, false);
        let mut known = !name.is_empty();
        for part in name.split('_') {
            match part {
                "scalar" | "llvm" | "cuda" | "ad" | "double" => {}
                "mono" => colour = Some(ColourMode::Mono),
                "rgb" => colour = Some(ColourMode::Rgb),
                "spectral" => colour = Some(ColourMode::Spectral),
                "polarized" | "polarised" => polarised = true,
                _ => known = false,
            }
        }
        if !known || (colour.is_none() && !polarised) {
            return Err(format!(
                "variant {name:?} is none; expected mono, rgb, spectral or polarised, or a variant of Mitsuba such as llvm_ad_spectral_polarized"
            ));
        }
        Ok(Self {
            colour: Setting::new(colour.unwrap_or_default(), from),
            polarised: Setting::new(polarised, from),
        })
    }
}

/// The variant that a scene hints at.
pub(super) fn hinted(files: &Files, root: &Element) -> Result<Variant, SceneError> {
    let named = root.children.iter().find(|c| c.tag == "default" && c.attribute("name") == Some("variant"));
    if let (Some(element), Some(value)) = (named, files.defaults.get("variant")) {
        return Variant::parse(value, &files.place(element)).map_err(|why| files.refuse(element, why));
    }
    let mut variant = Variant {
        colour: Setting::new(ColourMode::Rgb, "default"),
        polarised: Setting::new(false, "default"),
    };
    for element in root.descendants() {
        let kind = element.attribute("type").unwrap_or_default();
        let value = element.attribute("value").unwrap_or_default();
        match (element.tag.as_str(), kind, element.attribute("name")) {
            ("integrator", "stokes", _) => variant.polarised = Setting::new(true, files.place(element)),
            ("film", "specfilm", _) => {
                variant.colour = Setting::new(ColourMode::Spectral, files.place(element))
            }
            ("string", _, Some("pixel_format")) if value.starts_with("luminance") => {
                variant.colour = Setting::new(ColourMode::Mono, files.place(element));
            }
            _ => {}
        }
    }
    Ok(variant)
}
