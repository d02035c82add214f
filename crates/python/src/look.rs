//! How a pearl is looked at: what decides, beside its recipe, which effects are baked.

use crate::convert::to_python;
use crate::errors::field;
use crate::pearl::{rgb, shown};
use crate::recipe::Recipe;
use bake_brdf::effects::{ColourMode, Decisions, Setting, Shown, View};
use bake_brdf::recipe::Recipe as Ours;
use pearl_bsdf::Components;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::{Map, Value, json};
use std::collections::HashMap;

/// Where a value of a look was set, in the reasons that are given, unless its place is known.
const FROM: &str = "look";
/// The place of what the recipe's own look says.
pub(crate) const RECIPE: &str = "recipe";

#[doc = stub!("effects")]
#[pyfunction]
#[pyo3(signature = (recipe, look=None))]
pub(crate) fn effects<'py>(
    py: Python<'py>,
    recipe: &Bound<'py, PyAny>,
    look: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let recipe = Recipe::of(recipe)?.inner;
    let decisions = Decisions::by_view(&recipe, &view(&recipe, look, &HashMap::new())?);
    let effects: Map<String, Value> = decisions
        .all()
        .iter()
        .map(|decision| {
            (decision.effect.name().to_owned(), json!({ "on": decision.on, "why": decision.why }))
        })
        .collect();
    to_python(py, &effects)
}

/// The recipe's own look, and what a dict has in its place; `places` says where each value was set, and under `recipe` where the recipe was.
pub(crate) fn view(
    recipe: &Ours,
    look: Option<&Bound<'_, PyDict>>,
    places: &HashMap<String, String>,
) -> PyResult<View> {
    let mut view = View::of_look(&recipe.look);
    if let Some(from) = places.get(RECIPE) {
        for setting in [&mut view.depth, &mut view.brightness, &mut view.coherence] {
            setting.from.clone_from(from);
        }
        view.body.from.clone_from(from);
    }
    for (key, value) in look.into_iter().flatten() {
        let name: String = key.extract().map_err(|_| field("look", "has a key that is no name"))?;
        let from = places.get(&name).map_or(FROM, String::as_str);
        let number = || -> PyResult<Setting<f64>> {
            let number: f64 = value.extract().map_err(|_| field(&name, "is no number"))?;
            if !(0.0..=1.0).contains(&number) {
                return Err(field(
                    &name,
                    format_args!("{number} is not valid; expected a number from 0 to 1"),
                ));
            }
            Ok(Setting::new(number, from))
        };
        match name.as_str() {
            "depth" => view.depth = number()?,
            "brightness" => view.brightness = number()?,
            "coherence" => view.coherence = number()?,
            "body_color" if value.is_none() => view.body = Setting::new(None, from),
            "body_color" => view.body = Setting::new(Some(rgb(&name, &value)?), from),
            "components" => {
                let Components { diffuse, incoherent, mirror, blur } = shown(&value)?;
                view.shown = Setting::new(Shown { diffuse, incoherent, mirror, blur }, from);
            }
            "variant" => {
                let variant: String = value.extract().map_err(|_| field(&name, "is no name"))?;
                let (colour, polarised) = parse_variant(&variant)?;
                (view.colour, view.polarised) = (Setting::new(colour, from), Setting::new(polarised, from));
            }
            "texture" => {
                let texture: Option<String> = value.extract().map_err(|_| field(&name, "is no name"))?;
                view.texture = texture.map(|name| Setting::new(name, from));
            }
            "thickness" => {
                let asked: Option<String> = value.extract().map_err(|_| field(&name, "is no name"))?;
                view.thickness = asked.map(|what| Setting::new(what, from)).or(view.thickness);
            }
            _ => {
                let known =
                    "depth, brightness, coherence, body_color, components, variant, texture, thickness";
                return Err(field("look", format_args!("{name:?} is not one of {known}")));
            }
        }
    }
    Ok(view)
}

/// Colours of a variant of Mitsuba (`scalar_rgb`, `llvm_ad_spectral_polarized`) or of its colour part alone (`mono`, `rgb`, `spectral`,
/// `polarised`), and whether it is polarised.
fn parse_variant(name: &str) -> PyResult<(ColourMode, bool)> {
    let (mut colour, mut polarised, mut known) = (None, false, true);
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
    if known && (colour.is_some() || polarised) {
        return Ok((colour.unwrap_or_default(), polarised));
    }
    let right = "expected mono, rgb, spectral or polarised, or a variant of Mitsuba such as llvm_ad_spectral_polarized";
    Err(field("variant", format_args!("{name:?} is none; {right}")))
}
