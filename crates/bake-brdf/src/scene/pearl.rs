//! The parameters of a BSDF of type `pearl`.

use super::tree::{Element, Files};
use super::usage::Usage;
use super::{Pearl, SceneError, Variant};
use crate::effects::{Setting, Shown, View};
use crate::recipe::{self, Recipe};
use std::collections::HashMap;
use std::path::PathBuf;

/// Parameters of the plugin, and the scene's own `recipe`.
const PARAMETERS: [&str; 8] =
    ["filename", "recipe", "depth", "brightness", "coherence", "body_color", "tint", "components"];

/// Reads a pearl and what it is made of.
pub(super) fn read(
    files: &Files,
    element: &Element,
    variant: &Variant,
    usage: Option<&Usage>,
) -> Result<Pearl, SceneError> {
    let parameters = parameters(files, element)?;
    let string = |name: &str| parameters.get(name).copied().map(|p| text(files, p, name)).transpose();
    let table = string("filename")?;
    if let (Some(""), Some(parameter)) = (table, parameters.get("filename")) {
        return Err(
            files.refuse(parameter, "pearl: filename is empty; leave it out, or name the table".to_owned())
        );
    }
    let table = table.and_then(|name| files.find(name));
    let named = parameters.get("recipe").copied();
    let recipe = find_recipe(files, element, named, string("recipe")?, table.as_ref())?;
    let mut view = View::of_look(&recipe.value.look);
    let from = recipe.from.clone();
    view.depth.from.clone_from(&from);
    view.brightness.from.clone_from(&from);
    view.coherence.from.clone_from(&from);
    view.body.from = from;
    for (name, setting) in
        [("depth", &mut view.depth), ("brightness", &mut view.brightness), ("coherence", &mut view.coherence)]
    {
        if let Some(parameter) = parameters.get(name) {
            *setting = Setting::new(share(files, parameter, name)?, files.place(parameter));
        }
    }
    if let Some(parameter) = parameters.get("tint") {
        colour(files, parameter, "tint")?;
    }
    view.colour = variant.colour.clone();
    view.polarised = variant.polarised.clone();
    view.texture = usage.and_then(|usage| usage.texture.clone()).or(view.texture);
    if let Some(parameter) = parameters.get("body_color") {
        view.body = Setting::new(colour(files, parameter, "body_color")?, files.place(parameter));
        if matches!(parameter.tag.as_str(), "texture" | "ref") {
            let texture = Setting::new("body_color is a texture".to_owned(), files.place(parameter));
            view.texture = view.texture.or(Some(texture));
        }
    }
    if let Some(parameter) = parameters.get("components") {
        let shown = components(text(files, parameter, "components")?);
        let shown = shown.map_err(|problem| files.refuse(parameter, problem))?;
        view.shown = Setting::new(shown, files.place(parameter));
    }
    Ok(Pearl {
        id: element.attribute("id").map_or_else(|| files.place(element), str::to_owned),
        place: files.place(element),
        shapes: usage.map_or_else(Vec::new, |usage| usage.shapes.clone()),
        recipe,
        view,
        table,
        key: element.key(),
    })
}

/// The named children; one of an unknown name is refused.
fn parameters<'e>(files: &Files, element: &'e Element) -> Result<HashMap<&'e str, &'e Element>, SceneError> {
    let mut parameters = HashMap::new();
    for child in &element.children {
        let Some(name) = child.attribute("name") else {
            return Err(files.refuse(child, format!("pearl: <{}> needs the attribute name", child.tag)));
        };
        if !PARAMETERS.contains(&name) {
            let known = PARAMETERS.join(", ");
            let near = nearest(name).map_or(String::new(), |near| format!(" (did you mean {near:?}?)"));
            let problem = format!("pearl: {name:?} is no parameter{near}; expected one of {known}");
            return Err(files.refuse(child, problem));
        }
        if parameters.insert(name, child).is_some() {
            return Err(files.refuse(child, format!("pearl: {name} is given twice")));
        }
    }
    Ok(parameters)
}

/// The parameter that a misspelt name comes nearest to, if any is near: at most a third of its letters differ.
fn nearest(name: &str) -> Option<&'static str> {
    let lower = name.chars().take(64).collect::<String>().to_lowercase().replace("colour", "color");
    let known = PARAMETERS.into_iter().min_by_key(|known| edits(&lower, known))?;
    (3 * edits(&lower, known) <= known.len()).then_some(known)
}

/// Letters to insert, drop or replace (Levenshtein 1966).
fn edits(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.chars().count()).collect();
    for (i, from) in a.chars().enumerate() {
        let mut diagonal = std::mem::replace(&mut row[0], i + 1);
        for (j, to) in b.chars().enumerate() {
            let replaced = diagonal + usize::from(from != to);
            diagonal = row[j + 1];
            row[j + 1] = replaced.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.chars().count()]
}

/// The recipe that a pearl names, else that of the table it names, else the paper's.
fn find_recipe(
    files: &Files,
    element: &Element,
    parameter: Option<&Element>,
    name: Option<&str>,
    table: Option<&PathBuf>,
) -> Result<Setting<Recipe>, SceneError> {
    if let (Some(parameter), Some(name)) = (parameter, name) {
        let refuse = |problem: String| files.refuse(parameter, format!("pearl: recipe {name:?}: {problem}"));
        let path = files.find(name).ok_or_else(|| refuse("no such file".to_owned()))?;
        let long = std::fs::metadata(&path).is_ok_and(|data| data.len() > recipe::MAX_BYTES);
        if long {
            return Err(refuse(format!("longer than {} bytes; a recipe is shorter", recipe::MAX_BYTES)));
        }
        let text = std::fs::read_to_string(&path).map_err(|error| refuse(error.to_string()))?;
        let recipe = Recipe::from_json(&text).map_err(|error| refuse(error.to_string()))?;
        return Ok(Setting::new(recipe, name));
    }
    if let Some(path) = table {
        let refuse =
            |problem: String| files.refuse(element, format!("pearl: table {}: {problem}", path.display()));
        let meta = lut_io::exr_file::read(path).map_err(|error| refuse(error.to_string()))?.into_parts().meta;
        let recipe =
            Recipe::from_json(&meta.recipe.to_string()).map_err(|error| refuse(error.to_string()))?;
        return Ok(Setting::new(recipe, path.display().to_string()));
    }
    Ok(Setting::new(Recipe::default(), "the paper's pearl: the scene names no recipe"))
}

fn expect_tag(files: &Files, parameter: &Element, name: &str, tags: &[&str]) -> Result<(), SceneError> {
    if tags.contains(&parameter.tag.as_str()) {
        return Ok(());
    }
    let right = tags.join("> or <");
    Err(files.refuse(parameter, format!("pearl: {name} is a <{}>; expected <{right}>", parameter.tag)))
}

fn value<'e>(files: &Files, parameter: &'e Element, name: &str) -> Result<&'e str, SceneError> {
    let missing = || files.refuse(parameter, format!("pearl: {name} needs the attribute value"));
    parameter.attribute("value").ok_or_else(missing)
}

fn text<'e>(files: &Files, parameter: &'e Element, name: &str) -> Result<&'e str, SceneError> {
    expect_tag(files, parameter, name, &["string"])?;
    value(files, parameter, name)
}

/// A number from 0 to 1.
fn share(files: &Files, parameter: &Element, name: &str) -> Result<f64, SceneError> {
    expect_tag(files, parameter, name, &["float", "integer"])?;
    let text = value(files, parameter, name)?;
    match text.trim().parse::<f64>() {
        Ok(number) if (0.0..=1.0).contains(&number) => Ok(number),
        _ => Err(files.refuse(
            parameter,
            format!("pearl: {name} {text:?} is not valid; expected a number from 0 to 1"),
        )),
    }
}

/// A colour of channels from 0 to 1; `None` for a texture or a spectrum of several values.
fn colour(files: &Files, parameter: &Element, name: &str) -> Result<Option<[f64; 3]>, SceneError> {
    expect_tag(files, parameter, name, &["rgb", "spectrum", "float", "texture", "ref"])?;
    if matches!(parameter.tag.as_str(), "texture" | "ref") {
        return Ok(None);
    }
    if parameter.tag == "spectrum" && parameter.attribute("filename").is_some() {
        return Ok(None);
    }
    let text = value(files, parameter, name)?;
    let refuse = || {
        let right = "expected one or three numbers from 0 to 1, or #rrggbb";
        files.refuse(parameter, format!("pearl: {name} {text:?} is not valid; {right}"))
    };
    if let Some(hex) = text.trim().strip_prefix('#') {
        let byte = |c: usize| hex.get(2 * c..2 * c + 2).and_then(|two| u8::from_str_radix(two, 16).ok());
        return match (hex.len(), byte(0), byte(1), byte(2)) {
            (6, Some(r), Some(g), Some(b)) => Ok(Some([r, g, b].map(|c| f64::from(c) / 255.0))),
            _ => Err(refuse()),
        };
    }
    let items: Vec<&str> = text.split([',', ' ', '\t', '\n']).filter(|item| !item.is_empty()).collect();
    let channel = |item: &&str| {
        let number = item.rsplit(':').next().and_then(|number| number.parse::<f64>().ok());
        number.filter(|number| (0.0..=1.0).contains(number))
    };
    let channels: Option<Vec<f64>> = items.iter().map(channel).collect();
    match (parameter.tag.as_str(), channels.as_deref()) {
        (_, Some([grey])) => Ok(Some([*grey; 3])),
        ("rgb", Some([r, g, b])) => Ok(Some([*r, *g, *b])),
        ("spectrum", Some([_, ..])) if items.iter().all(|item| item.contains(':')) => Ok(None),
        _ => Err(refuse()),
    }
}

/// The components that a list names.
fn components(list: &str) -> Result<Shown, String> {
    let mut shown = Shown { diffuse: false, incoherent: false, mirror: false, blur: false };
    let mut any = false;
    for name in list.split([',', ' ', '+']).filter(|name| !name.is_empty()) {
        any = true;
        match name {
            "all" | "sum" => shown = Shown::ALL,
            "diffuse" => shown.diffuse = true,
            "incoherent" => shown.incoherent = true,
            "mirror" => shown.mirror = true,
            "blur" => shown.blur = true,
            _ => {
                return Err(format!(
                    "pearl: components: {name:?} is none; expected a list of diffuse, incoherent, mirror, blur, or all"
                ));
            }
        }
    }
    if any {
        Ok(shown)
    } else {
        Err("pearl: components: an empty list; expected at least one of diffuse, incoherent, mirror, blur"
            .to_owned())
    }
}
