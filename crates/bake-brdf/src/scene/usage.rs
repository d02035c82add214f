//! Which shapes show which pearls.

use super::SceneError;
use super::tree::{Element, Files, Key};
use crate::effects::Setting;
use std::collections::HashMap;

/// Who shows a pearl.
#[derive(Clone, Debug, Default)]
pub(super) struct Usage {
    pub(super) shapes: Vec<String>,
    /// The first bump or normal map that a shape sees it through.
    pub(super) texture: Option<Setting<String>>,
}

/// The usage of every pearl that a shape shows.
pub(super) fn of(files: &Files, root: &Element) -> Result<HashMap<Key, Usage>, SceneError> {
    let mut search =
        Search { files, ids: HashMap::new(), path: Vec::new(), found: HashMap::new(), visits: 0 };
    for element in root.descendants() {
        let Some(id) = element.attribute("id").filter(|_| element.tag != "ref" && element.tag != "alias")
        else {
            continue;
        };
        if let Some(other) = search.ids.insert(id, element) {
            return Err(
                files.refuse(element, format!("id {id:?} again; it is at {} already", files.place(other)))
            );
        }
    }
    for element in root.descendants().filter(|element| element.tag == "alias") {
        let (Some(id), Some(other)) = (element.attribute("id"), element.attribute("as")) else {
            return Err(files.refuse(element, "<alias> needs the attributes id and as"));
        };
        let target = search.target(element, id)?;
        search.ids.insert(other, target);
    }
    for shape in shown(root) {
        search.shape(shape)?;
    }
    Ok(search.found)
}

/// The shapes of a scene that are shown by themselves: not what lies in a group, which only its instances show, nor the geometry
/// inside an object of another kind (an emitter is inside its shape, not around it).
fn shown(root: &Element) -> Vec<&Element> {
    root.children.iter().filter(|child| is_shape(child) && !is_group(child)).collect()
}

fn is_shape(element: &Element) -> bool {
    element.tag == "shape"
}

fn is_group(element: &Element) -> bool {
    is_shape(element) && element.attribute("type") == Some("shapegroup")
}

/// Most BSDFs that are looked into: references let a short scene stand for a tree that grows without bound.
const MAX_VISITS: usize = 100_000;

struct Search<'s> {
    files: &'s Files,
    ids: HashMap<&'s str, &'s Element>,
    /// BSDFs around the present one.
    path: Vec<&'s Element>,
    found: HashMap<Key, Usage>,
    visits: usize,
}

impl<'s> Search<'s> {
    /// Looks into a shape, and into the group that it is an instance of (or other shapes that it holds).
    fn shape(&mut self, shape: &'s Element) -> Result<(), SceneError> {
        self.visits += 1;
        if self.visits > MAX_VISITS {
            let problem = format!("the scene's instances hold more than {MAX_VISITS} shapes");
            return Err(self.files.refuse(shape, problem));
        }
        if self.path.iter().any(|open| open.key() == shape.key()) {
            return Err(self.files.refuse(shape, "instances go round in a circle"));
        }
        let name = format!("{} ({})", shape.attribute("type").unwrap_or("shape"), self.files.place(shape));
        self.children(shape, &name, None)?;
        self.path.push(shape);
        for inner in held(self, shape, is_shape)? {
            self.shape(inner)?;
        }
        self.path.pop();
        Ok(())
    }

    fn target(&self, reference: &'s Element, id: &str) -> Result<&'s Element, SceneError> {
        let found = self.ids.get(id).copied();
        found.ok_or_else(|| {
            self.files.refuse(reference, format!("{}: no object has the id {id:?}", reference.tag))
        })
    }

    /// Looks into the BSDFs that an element holds or refers to.
    fn children(
        &mut self,
        parent: &'s Element,
        shape: &str,
        texture: Option<&Setting<String>>,
    ) -> Result<(), SceneError> {
        for (index, child) in held(self, parent, |element| element.tag == "bsdf")?.into_iter().enumerate() {
            if !hidden(parent, index) {
                self.visit(child, shape, texture)?;
            }
        }
        Ok(())
    }

    fn visit(
        &mut self,
        bsdf: &'s Element,
        shape: &str,
        texture: Option<&Setting<String>>,
    ) -> Result<(), SceneError> {
        self.visits += 1;
        if self.visits > MAX_VISITS {
            let problem = format!("shapes refer to more than {MAX_VISITS} BSDFs");
            return Err(self.files.refuse(bsdf, problem));
        }
        if bsdf.is_pearl() {
            let usage = self.found.entry(bsdf.key()).or_default();
            usage.texture = usage.texture.take().or_else(|| texture.cloned());
            if !usage.shapes.iter().any(|known| known == shape) {
                usage.shapes.push(shape.to_owned());
            }
            return Ok(());
        }
        if self.path.iter().any(|open| open.key() == bsdf.key()) {
            let ring: Vec<&str> =
                self.path.iter().chain([&bsdf]).map(|e| e.attribute("id").unwrap_or("(no id)")).collect();
            return Err(self
                .files
                .refuse(bsdf, format!("references go round in a circle: {}", ring.join(" → "))));
        }
        self.path.push(bsdf);
        let kind = bsdf.attribute("type").unwrap_or_default();
        let own = matches!(kind, "bumpmap" | "normalmap")
            .then(|| Setting::new(kind.to_owned(), self.files.place(bsdf)));
        self.children(bsdf, shape, texture.or(own.as_ref()))?;
        self.path.pop();
        Ok(())
    }
}

/// The objects of a kind that an element holds, in place or by reference.
fn held<'s>(
    search: &Search<'s>,
    parent: &'s Element,
    is_kind: impl Fn(&Element) -> bool,
) -> Result<Vec<&'s Element>, SceneError> {
    let mut found = Vec::new();
    for child in &parent.children {
        if is_kind(child) {
            found.push(child);
        }
        if child.tag == "ref" {
            let Some(id) = child.attribute("id") else {
                return Err(search.files.refuse(child, "<ref> needs the attribute id"));
            };
            let target = search.target(child, id)?;
            if is_kind(target) {
                found.push(target);
            }
        }
    }
    Ok(found)
}

/// Whether an adapter never shows its child of that number: a mask of opacity 0, a blend of weight 0 or 1.
fn hidden(parent: &Element, index: usize) -> bool {
    let constant = |name: &str| {
        let found = parent.children.iter().find(|c| c.attribute("name") == Some(name) && c.tag == "float")?;
        found.attribute("value")?.trim().parse::<f64>().ok()
    };
    match parent.attribute("type") {
        Some("mask") => constant("opacity") == Some(0.0),
        Some("blendbsdf") => match constant("weight") {
            Some(0.0) => index == 1,
            Some(1.0) => index == 0,
            _ => false,
        },
        _ => false,
    }
}
