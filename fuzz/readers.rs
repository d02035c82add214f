//! What every reader of a file must do with any bytes: refuse them in one line, or read something sound.
//!
//! Shared by the fuzz targets (`fuzz_targets/`) and by the replay of `corpus/` and `damaged/` in the ordinary tests
//! (`crates/bake-brdf/tests/damaged_files.rs`). A function here panics where a reader breaks its promise.

use bake_brdf::bake::snapshot::{self, Snapshot};
use bake_brdf::recipe::Recipe;
use bake_brdf::scene::Scene;
use lut_io::exr_file;
use lut_io::lobe::Interpolant;
use lut_io::table::Component;
use lut_io::tensor_file::{self, Field};
use std::path::Path;

/// A reader: `Err` is the line a user would see.
pub(crate) type Reader = fn(&[u8]) -> Result<(), String>;

/// Every reader by the name of its target.
pub(crate) const READERS: [(&str, Reader); 6] = [
    ("table", table),
    ("recipe", recipe),
    ("state", state),
    ("state_body", state_body),
    ("scene", scene),
    ("bsdf", bsdf),
];

/// Layers beyond which a valid recipe is not turned into a stack here: that is memory by request, not by accident.
const MOST_LAYERS: usize = 100_000;
/// Cells beyond which a valid table is not read between its nodes: it only takes long.
const MOST_CELLS: usize = 1 << 16;

fn refused(why: impl std::fmt::Display) -> Result<(), String> {
    let line = why.to_string();
    assert!(!line.trim().is_empty(), "a refusal without a reason");
    // What the terminal prints is one line: line breaks and control characters are folded there.
    Err(line)
}

/// `pearl-lut/1` tables: what is read is written to the same table again, and every direction has a finite answer.
pub(crate) fn table(bytes: &[u8]) -> Result<(), String> {
    let table = match exr_file::decode(bytes) {
        Ok(table) => table,
        Err(flaw) => return refused(flaw),
    };
    let again = exr_file::encode(&table).expect("what was read can be written");
    assert_eq!(exr_file::decode(&again).expect("what was written can be read"), table);
    if table.interior.value.len() <= MOST_CELLS {
        let lobe = Interpolant::new(table);
        for (theta_i, theta_o, phi) in [(0.0, 0.0, 0.0), (0.6, 0.5, 0.1), (1.5, 1.57, 3.1)] {
            for component in Component::ALL {
                let value = lobe.eval(component, theta_i, theta_o, phi);
                assert!(
                    value.is_finite() && value >= 0.0,
                    "{component:?} {theta_i} {theta_o} {phi}: {value}"
                );
            }
        }
    }
    Ok(())
}

/// Recipes: what is read survives being written, and makes a stack or says why not.
pub(crate) fn recipe(bytes: &[u8]) -> Result<(), String> {
    let Ok(text) = std::str::from_utf8(bytes) else { return refused("not UTF-8") };
    let recipe = match Recipe::from_json(text) {
        Ok(recipe) => recipe,
        Err(why) => return refused(why),
    };
    let again = Recipe::from_json(&recipe.to_json().to_string()).expect("a recipe survives being written");
    assert_eq!(again, recipe);
    if recipe.stack.layer_count() <= MOST_LAYERS
        && let Err(why) = recipe.transport(recipe.wavelength())
    {
        return refused(why);
    }
    Ok(())
}

/// Tensor files (`.bsdf`): what is read is written to the same fields again.
pub(crate) fn bsdf(bytes: &[u8]) -> Result<(), String> {
    let fields = match tensor_file::decode(bytes) {
        Ok(fields) => fields,
        Err(flaw) => return refused(flaw),
    };
    let again = tensor_file::encode(&fields).expect("what was read can be written");
    let back = tensor_file::decode(&again).expect("what was written can be read");
    // By their bits: a NaN is a value of this format.
    let bits = |fields: &[Field]| tensor_file::encode(fields).expect("fields that were read");
    assert_eq!(bits(&back), again);
    Ok(())
}

/// Checkpoints and shards as they lie on disk.
pub(crate) fn state(bytes: &[u8]) -> Result<(), String> {
    match Snapshot::decode(bytes) {
        Ok(snapshot) => sound(snapshot),
        Err(why) => refused(why),
    }
}

/// The same behind a right checksum, which no mutation of a whole file would ever hit.
pub(crate) fn state_body(body: &[u8]) -> Result<(), String> {
    state(&with_checksum(body))
}

/// A state file around a body.
pub(crate) fn with_checksum(body: &[u8]) -> Vec<u8> {
    let mut bytes = b"nacre-state/1\n".to_vec();
    bytes.extend(crc32fast::hash(body).to_le_bytes());
    bytes.extend_from_slice(body);
    bytes
}

fn sound(snapshot: Snapshot) -> Result<(), String> {
    snapshot.same_bake(&snapshot).expect("a state belongs to its own bake");
    match snapshot.request() {
        Ok(request) if request.recipe.stack.layer_count() <= MOST_LAYERS => (),
        Ok(_) => return Ok(()),
        Err(why) => return refused(why),
    }
    match snapshot::merge(&[("shard".to_owned(), snapshot)]) {
        Ok(table) => {
            table.validate().expect("a merged table is valid");
            Ok(())
        }
        Err(why) => refused(why),
    }
}

/// Mitsuba scenes: what is read can be copied.
pub(crate) fn scene(bytes: &[u8]) -> Result<(), String> {
    // Includes and recipes are looked for beside the scene: in a folder of its own there are none.
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("scene.xml");
    std::fs::write(&path, bytes).expect("a temporary file");
    match Scene::read(&path, None) {
        Ok(scene) => {
            let copy = scene.copy(Path::new("."), &vec![None; scene.pearls.len()]);
            assert!(!copy.is_empty());
            Ok(())
        }
        Err(why) => refused(why),
    }
}
