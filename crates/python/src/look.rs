//! How a pearl is looked at: what decides, beside its recipe, which effects are baked.

use crate::convert::to_python;
use crate::errors::{field, input};
use crate::pearl::{rgb, shown};
use crate::recipe::Recipe;
use bake_brdf::effects::{Decisions, Setting, Shown, View};
use bake_brdf::recipe::Recipe as Ours;
use bake_brdf::scene::Variant;
use pearl_bsdf::Components;
use pyo3::prelude::*;
use pyo3::types::{PyAny, PyDict};
use serde_json::{Map, Value, json};

/// Where a value of a look was set, in the reasons that are given.
const FROM: &str = "look";

/// Which effects a recipe calls for as it is looked at, and why.
#[pyfunction]
#[pyo3(signature = (recipe, look=None))]
pub(crate) fn effects<'py>(
    py: Python<'py>,
    recipe: &Bound<'py, PyAny>,
    look: Option<&Bound<'py, PyDict>>,
) -> PyResult<Bound<'py, PyAny>> {
    let recipe = Recipe::of(recipe)?.inner;
    let decisions = Decisions::by_view(&recipe, &view(&recipe, look)?);
    let effects: Map<String, Value> = decisions
        .all()
        .iter()
        .map(|decision| {
            (decision.effect.name().to_owned(), json!({ "on": decision.on, "why": decision.why }))
        })
        .collect();
    to_python(py, &effects)
}

/// The recipe's own look, and what a dict has in its place.
pub(crate) fn view(recipe: &Ours, look: Option<&Bound<'_, PyDict>>) -> PyResult<View> {
    let mut view = View::of_look(&recipe.look);
    for (key, value) in look.into_iter().flatten() {
        let name: String = key.extract().map_err(|_| field("look", "has a key that is no name"))?;
        let number = || -> PyResult<Setting<f64>> {
            let number: f64 = value.extract().map_err(|_| field(&name, "is no number"))?;
            if !(0.0..=1.0).contains(&number) {
                return Err(field(
                    &name,
                    format_args!("{number} is not valid; expected a number from 0 to 1"),
                ));
            }
            Ok(Setting::new(number, FROM))
        };
        match name.as_str() {
            "depth" => view.depth = number()?,
            "brightness" => view.brightness = number()?,
            "coherence" => view.coherence = number()?,
            "body_color" if value.is_none() => view.body = Setting::new(None, FROM),
            "body_color" => view.body = Setting::new(Some(rgb(&name, &value)?), FROM),
            "components" => {
                let Components { diffuse, incoherent, mirror, blur } = shown(&value)?;
                view.shown = Setting::new(Shown { diffuse, incoherent, mirror, blur }, FROM);
            }
            "variant" => {
                let variant: String = value.extract().map_err(|_| field(&name, "is no name"))?;
                let variant = Variant::parse(&variant, FROM).map_err(input)?;
                (view.colour, view.polarised) = (variant.colour, variant.polarised);
            }
            "texture" => {
                let texture: Option<String> = value.extract().map_err(|_| field(&name, "is no name"))?;
                view.texture = texture.map(|name| Setting::new(name, FROM));
            }
            _ => {
                let known = "depth, brightness, coherence, body_color, components, variant, texture";
                return Err(field("look", format_args!("{name:?} is not one of {known}")));
            }
        }
    }
    Ok(view)
}
