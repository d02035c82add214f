//! What every reader of a file must do with any bytes: refuse them in one line, or read something sound.
//!
//! Shared by the fuzz targets (`fuzz_targets/`) and by the replay of `corpus/` and `damaged/` in the ordinary tests
//! (`crates/bake-brdf/tests/damaged_files.rs`). A function here panics where a reader breaks its promise.

use bake_brdf::bake::snapshot::{self, Snapshot};
use bake_brdf::bake::{self, BakeError, Observer, Request, Shard};
use bake_brdf::effects::{Effect, Effects};
use bake_brdf::options::{Options, Target};
use bake_brdf::recipe::Recipe;
use lut_io::exr_file;
use lut_io::lobe::Interpolant;
use lut_io::merl::Merl;
use lut_io::table::Component;
use lut_io::tensor_file::{self, Field};
use std::sync::OnceLock;
use std::sync::atomic::AtomicBool;

/// A reader: `Err` is the line a user would see.
pub(crate) type Reader = fn(&[u8]) -> Result<(), String>;

/// Every reader by the name of its target.
pub(crate) const READERS: [(&str, Reader); 7] = [
    ("table", table),
    ("bsdf", bsdf),
    ("merl", merl),
    ("recipe", recipe),
    ("state", state),
    ("checkpoint", checkpoint),
    ("shard", shard),
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
        Err(error) => return refused(error),
    };
    let again = exr_file::encode(&table).expect("what was read can be written");
    assert_eq!(exr_file::decode(&again).expect("what was written can be read"), table);
    if table.lobe(Component::Interior).value.len() <= MOST_CELLS {
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
        Err(error) => return refused(error),
    };
    let again = tensor_file::encode(&fields).expect("what was read can be written");
    let back = tensor_file::decode(&again).expect("what was written can be read");
    // By their bits: a NaN is a value of this format.
    let bits = |fields: &[Field]| tensor_file::encode(fields).expect("fields that were read");
    assert_eq!(bits(&back), again);
    Ok(())
}

/// Bins of the small MERL files that are tried here: a whole file is 33 MB, which no mutation gets through in time.
pub(crate) const FEW_BINS: [usize; 3] = [3, 2, 4];

/// MERL files: what is read is written to the same bins again, and no pair of directions falls beyond the last.
pub(crate) fn merl(bytes: &[u8]) -> Result<(), String> {
    // As the tools read: of these bytes only header and length can be judged, unless they are a whole file.
    let merl = match Merl::decode(bytes).or_else(|_| Merl::decode_bins(FEW_BINS, bytes)) {
        Ok(merl) => merl,
        Err(error) => return refused(error),
    };
    let again = merl.encode();
    assert_eq!(again.len(), bytes.len());
    let directions =
        [[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.6, 0.0, 0.8], [0.0, 1.0, 5e-324], [1.0, 0.0, 0.0]];
    for wi in directions {
        for wo in directions {
            let value = merl.eval(wi, wo);
            assert!(value.is_none_or(|rgb| rgb.iter().all(|x| *x >= 0.0 && x.is_finite())), "{value:?}");
        }
    }
    Ok(())
}

/// Checkpoints and shards as they lie on disk.
pub(crate) fn state(bytes: &[u8]) -> Result<(), String> {
    match Snapshot::decode(bytes) {
        Ok(snapshot) => {
            snapshot.same_bake(&snapshot).expect("a state belongs to its own bake");
            Ok(())
        }
        Err(why) => refused(why),
    }
}

/// What stands behind the checksum of a state, which no mutation of a whole file would ever hit.
fn behind_checksum(body: &[u8]) -> Result<Snapshot, String> {
    let bytes = with_checksum(body);
    state(&bytes)?;
    Snapshot::decode(&bytes).map_err(|why| why.to_string())
}

/// A state file around a body.
pub(crate) fn with_checksum(body: &[u8]) -> Vec<u8> {
    let mut bytes = b"nacre-state/1\n".to_vec();
    bytes.extend(crc32fast::hash(body).to_le_bytes());
    bytes.extend_from_slice(body);
    bytes
}

/// Checkpoints behind a right checksum: a bake goes on from what is read, up to its first path.
pub(crate) fn checkpoint(body: &[u8]) -> Result<(), String> {
    static STOP: AtomicBool = AtomicBool::new(true);
    let snapshot = behind_checksum(body)?;
    let request = match snapshot.request() {
        Ok(request) if request.recipe.stack.layer_count() <= MOST_LAYERS => request,
        Ok(_) => return Ok(()),
        Err(why) => return refused(why),
    };
    let observer = Observer { stop: &STOP, ..Observer::idle() };
    match request.bands().and_then(|bands| bake::walk(&request, &bands, &observer, Some(snapshot))) {
        Ok(_) => Ok(()),
        Err(BakeError::Interrupted) => Ok(()),
        Err(why) => refused(why),
    }
}

/// Shards behind a right checksum: what is read is merged, a half with the other [`half`].
pub(crate) fn shard(body: &[u8]) -> Result<(), String> {
    static HALVES: OnceLock<[Snapshot; 2]> = OnceLock::new();
    let snapshot = behind_checksum(body)?;
    match snapshot.request() {
        Ok(request) if request.recipe.stack.layer_count() <= MOST_LAYERS => (),
        Ok(_) => return Ok(()),
        Err(why) => return refused(why),
    }
    let mut shards = vec![("this".to_owned(), snapshot)];
    if let Shard { index, count: 2 } = shards[0].1.shard {
        let other = HALVES.get_or_init(|| [1, 2].map(half))[2 - index as usize].clone();
        shards.push(("other".to_owned(), other));
    }
    match snapshot::merge(&shards) {
        Ok(_) => Ok(()),
        Err(why) => refused(why),
    }
}

/// A small bake, to be halved: two blocks of paths through three layers.
pub(crate) fn small_bake(target: Target) -> Request {
    let recipe = Recipe::from_json(r#"{"stack":{"layers":3}}"#).expect("a recipe");
    // Colours take longer than all the rest.
    let effects = [Effect::Surface, Effect::Blur, Effect::Azimuth].into_iter().collect();
    let options = Options {
        effects: Effects::Listed(effects),
        incident_deg: Some(vec![40.0]),
        target,
        seed: 3,
        event_cap: 1000,
        ..Options::default()
    };
    Request::of(recipe, effects, options).expect("a request")
}

/// Shard 1 or 2 of 2 of the small bake.
pub(crate) fn half(index: u32) -> Snapshot {
    snapshot::walk_shard(&small_bake(Target::Paths(40_000)), Shard { index, count: 2 }, &Observer::idle())
        .expect("a shard")
}
