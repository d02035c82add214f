//! A copy of a scene that points at baked tables.

use super::tree::{Element, Key};
use super::{Baked, Scene};
use crate::effects::Effect;
use lut_io::atomic::folder_of;
use std::collections::HashMap;
use std::ops::Range;
use std::path::Path;

/// Replacements by file: bytes and what stands there instead.
type Edits = HashMap<usize, Vec<(Range<usize>, String)>>;

pub(super) fn of(scene: &Scene, target: &Path, tables: &[Option<Baked>]) -> String {
    let mut edits = Edits::new();
    let moved = !same_folder(folder_of(&scene.path), target);
    let pearls: HashMap<Key, &Option<Baked>> =
        scene.pearls.iter().map(|pearl| pearl.key).zip(tables).collect();
    edit(scene, &scene.root, &pearls, moved, &mut edits);
    let mut text = String::new();
    render(scene, (0, 0..scene.files.text(0).len()), &mut edits, &mut text);
    text
}

fn same_folder(a: &Path, b: &Path) -> bool {
    match (a.canonicalize(), b.canonicalize()) {
        (Ok(a), Ok(b)) => a == b,
        _ => a == b,
    }
}

fn edit(
    scene: &Scene,
    element: &Element,
    pearls: &HashMap<Key, &Option<Baked>>,
    moved: bool,
    edits: &mut Edits,
) {
    if let Some(table) = pearls.get(&element.key()) {
        match table {
            Some(table) => point(scene, element, table, edits),
            None => replace_unused(element, edits),
        }
        // Textures of a pearl are files too.
        if table.is_none() {
            return;
        }
    } else if moved {
        rebase(scene, element, edits);
    }
    for child in &element.children {
        if element.is_pearl() && matches!(child.attribute("name"), Some("filename" | "recipe")) {
            continue;
        }
        edit(scene, child, pearls, moved, edits);
    }
}

/// Makes a pearl's `filename` the table, and drops its `recipe`, which the plugin does not know.
fn point(scene: &Scene, element: &Element, baked: &Baked, edits: &mut Edits) {
    let list = edits.entry(element.file).or_default();
    let value = escape(&baked.table.display().to_string());
    let named = |name: &str| element.children.iter().find(move |c| c.attribute("name") == Some(name));
    if let Some(recipe) = named("recipe") {
        list.push((recipe.range.clone(), String::new()));
    }
    for (control, effect) in [("depth", Effect::Emission), ("coherence", Effect::Coherent)] {
        let set = named(control).and_then(|c| c.attributes.iter().find(|a| a.name == "value"));
        if let Some(attribute) = set.filter(|_| !baked.effects.contains(effect)) {
            list.push((attribute.range.clone(), "0".to_owned()));
        }
    }
    let old = named("filename").and_then(|c| c.attributes.iter().find(|a| a.name == "value"));
    if let Some(attribute) = old {
        list.push((attribute.range.clone(), value));
        return;
    }
    let line = format!("<string name=\"filename\" value=\"{value}\"/>");
    let text = &scene.files.text(element.file)[element.range.clone()];
    let end = element.range.end;
    if text.ends_with("/>") {
        list.push((end - 2..end, format!(">{line}</bsdf>")));
    } else {
        // "</bsdf>" closes it.
        let close = element.range.start + text.rfind("</").unwrap_or(text.len());
        list.push((close..close, line));
    }
}

/// A pearl that no shape shows has no table; whatever refers to it still finds a BSDF.
fn replace_unused(element: &Element, edits: &mut Edits) {
    let attribute = |name: &str| {
        element.attribute(name).map_or(String::new(), |value| format!(" {name}=\"{}\"", escape(value)))
    };
    let text = format!("<bsdf type=\"diffuse\"{}{}/>", attribute("id"), attribute("name"));
    edits.entry(element.file).or_default().push((element.range.clone(), text));
}

/// Relative names of files that exist become absolute, for a copy in another folder.
fn rebase(scene: &Scene, element: &Element, edits: &mut Edits) {
    let names_a_file = match element.tag.as_str() {
        "string" => element.attribute("name") == Some("filename"),
        "path" => true,
        _ => element.attribute("filename").is_some(),
    };
    let wanted = if matches!(element.tag.as_str(), "string" | "path") { "value" } else { "filename" };
    let Some(attribute) = element.attributes.iter().find(|a| names_a_file && a.name == wanted) else {
        return;
    };
    let found = match element.tag.as_str() {
        "path" => Some(scene.folder().join(&attribute.value)),
        _ => scene.files.find(&attribute.value),
    };
    if let Some(path) = found.and_then(|path| path.canonicalize().ok())
        && !Path::new(&attribute.value).is_absolute()
    {
        let list = edits.entry(element.file).or_default();
        list.push((attribute.range.clone(), escape(&path.display().to_string())));
    }
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('"', "&quot;").replace('\'', "&apos;")
}

/// What stands in the place of some bytes of a file.
enum Change {
    Text(String),
    /// Bytes of another file.
    Include(usize, Range<usize>),
}

/// Writes part of a file with its edits, includes in place.
fn render(scene: &Scene, (file, range): (usize, Range<usize>), edits: &mut Edits, out: &mut String) {
    let mut list: Vec<(Range<usize>, Change)> = edits
        .remove(&file)
        .unwrap_or_default()
        .into_iter()
        .map(|(at, text)| (at, Change::Text(text)))
        .collect();
    let includes = scene.files.inclusions.iter().filter(|i| i.at.0 == file);
    list.extend(includes.map(|i| (i.at.1.clone(), Change::Include(i.of.0, i.of.1.clone()))));
    list.sort_by_key(|(at, _)| at.start);
    let text = scene.files.text(file);
    let mut from = range.start;
    for (at, change) in list {
        if at.start < from || at.end > range.end {
            continue; // inside something that was replaced whole
        }
        out.push_str(&text[from..at.start]);
        match change {
            Change::Text(text) => out.push_str(&text),
            Change::Include(file, range) => render(scene, (file, range), edits, out),
        }
        from = at.end;
    }
    out.push_str(&text[from..range.end]);
}
