//! Mitsuba scenes: which pearls a scene shows, how, and a copy of it that points at their tables.
//!
//! Read are XML scenes with includes, defaults (`$name`), references, and pearls inside adapters (`twosided`,
//! `bumpmap`, `normalmap`, `mask`, `blendbsdf` and any other BSDF that holds BSDFs). Document types, and with them entities,
//! are refused; sizes, depth and counts are bounded.

mod copy;
mod pearl;
mod tree;
mod usage;
mod variant;

pub use variant::Variant;

use crate::effects::{EffectSet, Setting, View};
use crate::recipe::Recipe;
use std::path::{Path, PathBuf};
use tree::{Element, Files};

/// What is wrong with a scene: one line that starts with `file:line: `.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0}")]
pub struct SceneError(String);

/// A scene with the pearls in it.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Pearls in the order of the scene.
    pub pearls: Vec<Pearl>,
    path: PathBuf,
    files: Files,
    root: Element,
}

/// What a copy of a scene needs to know of a baked pearl.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Baked {
    /// The table's name, as the copy is to hold it.
    pub table: PathBuf,
    /// Effects that the pearl shows.
    pub effects: EffectSet,
}

/// One BSDF of type `pearl`.
#[derive(Clone, Debug)]
pub struct Pearl {
    /// Its `id`, or its place where it has none.
    pub id: String,
    /// Where it stands: `file:line`.
    pub place: String,
    /// The shapes that show it, each as `type (file:line)`; empty for an unused pearl.
    pub shapes: Vec<String>,
    /// What it is made of, and where that was found.
    pub recipe: Setting<Recipe>,
    /// How it is looked at.
    pub view: View,
    /// The table that the scene names, where that file exists.
    pub table: Option<PathBuf>,
    key: tree::Key,
}

impl Pearl {
    /// Whether any shape shows it.
    #[must_use]
    pub fn is_used(&self) -> bool {
        !self.shapes.is_empty()
    }
}

impl Scene {
    /// Reads a scene. `variant` is that of the renderer; without it the scene's own hints decide (a default named
    /// `variant`, the integrator `stokes`, the film), then RGB.
    ///
    /// # Errors
    /// A file that cannot be read, is not a scene, or asks for what no pearl has; one line that names the place.
    pub fn read(path: &Path, variant: Option<Variant>) -> Result<Self, SceneError> {
        Self::read_with(path, variant, &[])
    }

    /// As [`Self::read`], with values of `$name` that go before the scene's own defaults (Mitsuba's `-D name=value`, or the
    /// keyword arguments of `mi.load_file`).
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_with(
        path: &Path,
        variant: Option<Variant>,
        defaults: &[(String, String)],
    ) -> Result<Self, SceneError> {
        let (files, root) = tree::load(path, defaults)?;
        let variant = variant.map_or_else(|| variant::hinted(&files, &root), Ok)?;
        let usage = usage::of(&files, &root)?;
        let mut pearls = Vec::new();
        for element in root.descendants().filter(|element| element.is_pearl()) {
            pearls.push(pearl::read(&files, element, &variant, usage.get(&element.key()))?);
        }
        Ok(Self { pearls, path: path.to_owned(), files, root })
    }

    /// The text of a copy, for a file in `folder`: includes inlined, each used pearl pointing at its table (in the order of
    /// [`Self::pearls`]), unused pearls replaced by a diffuse placeholder, relative file names made to work from there. A
    /// control without effect in a pearl (depth without `emission`, coherence without `coherent`) becomes 0: its
    /// table has no data for it.
    #[must_use]
    pub fn copy(&self, folder: &Path, tables: &[Option<Baked>]) -> String {
        copy::of(self, folder, tables)
    }

    /// The folder that relative names in the scene start from.
    #[must_use]
    pub fn folder(&self) -> &Path {
        lut_io::atomic::folder_of(&self.path)
    }
}
