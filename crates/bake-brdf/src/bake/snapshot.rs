//! Checkpoints and shards on disk: the state of a bake with the request that it belongs to.
//!
//! Layout: the magic `nacre-state/1\n`, a little-endian u32 CRC-32 of what follows, then the [`Snapshot`] in the
//! postcard encoding. Sums are integers, so a bake that goes on from a snapshot, or shards that are merged, give
//! the same bits as one uninterrupted bake.

use super::sampling::{Sampling, Shard, State};
use super::{BakeError, Grid, NEVER, Observer, Request, assemble};
use crate::effects::{EffectSet, Effects};
use crate::options::{OptionError, Options, SolverChoice, Target};
use crate::recipe::Recipe;
use crate::tally::{CHUNK, MAX_PATHS, Tally};
use lut_io::dispersion::MOST_BANDS;
use lut_io::table::Table;
use serde::{Deserialize, Serialize};
use std::io::{self, Read as _};
use std::path::Path;

const MAGIC: &[u8] = b"nacre-state/1\n";
/// Longest snapshot that is read, bytes.
const MAX_BYTES: u64 = 1 << 32;
/// Most shards of a bake.
pub const MOST_SHARDS: u32 = 100_000;

/// The state of a bake, whole or one shard of it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Snapshot {
    /// `crate version` of the writer: other versions may draw other numbers.
    pub writer: String,
    /// What is baked (the recipe as JSON text).
    pub recipe: String,
    /// The effects that are baked.
    pub effects: EffectSet,
    /// How well.
    pub options: Options,
    /// Rows and cells (a [`Grid`] as JSON text).
    pub grid: String,
    /// Which part of the bake this is.
    pub shard: Shard,
    /// What has been walked.
    pub state: State,
}

/// Why a snapshot cannot be used; one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SnapshotError {
    /// The file cannot be read or written.
    #[error("{0}")]
    Io(#[from] io::Error),
    /// Not a snapshot, or a damaged one.
    #[error("not a usable bake state: {0}")]
    Damaged(String),
    /// A snapshot of another bake.
    #[error("belongs to another bake: {0} differs")]
    Other(&'static str),
}

fn writer() -> String {
    concat!(env!("CARGO_PKG_NAME"), " ", env!("CARGO_PKG_VERSION")).to_owned()
}

impl Snapshot {
    /// The state of `request`'s bake.
    #[must_use]
    pub fn new(request: &Request, shard: Shard, state: State) -> Self {
        Self {
            writer: writer(),
            recipe: request.recipe.to_json().to_string(),
            effects: request.effects,
            options: request.options.clone(),
            grid: serde_json::json!(request.grid).to_string(),
            shard,
            state,
        }
    }

    /// The request that the snapshot belongs to.
    ///
    /// # Errors
    /// The recipe or the grid inside is not valid.
    pub fn request(&self) -> Result<Request, SnapshotError> {
        let recipe = Recipe::from_json(&self.recipe)
            .map_err(|why| SnapshotError::Damaged(format!("its recipe: {why}")))?;
        let grid = Grid::from_json(&self.grid).map_err(SnapshotError::Damaged)?;
        Ok(Request {
            recipe,
            effects: self.effects,
            options: self.options.clone(),
            grid,
            placed_by: Vec::new(),
            placing_seconds: 0.0,
        })
    }

    /// Whether `other` is a part of the same bake; names the first difference.
    ///
    /// # Errors
    /// [`SnapshotError::Other`].
    pub fn same_bake(&self, other: &Self) -> Result<(), SnapshotError> {
        // Who solves, and by which list the effects came, makes no other paths.
        let (ours, theirs) = (&self.options, &other.options);
        let differences = [
            (self.writer == other.writer, "the version of bake-brdf"),
            (self.recipe == other.recipe, "the recipe"),
            (self.effects == other.effects, "the list of effects"),
            (self.grid == other.grid, "the grid of incidences and cells"),
            (ours.target == theirs.target, "the accuracy, path count or time"),
            (ours.seed == theirs.seed, "the seed"),
            (ours.event_cap == theirs.event_cap, "the event cap"),
            (ours.precision == theirs.precision, "the precision"),
            (self.shard.count == other.shard.count, "the number of shards"),
        ];
        match differences.iter().find(|(same, _)| !same) {
            Some((_, what)) => Err(SnapshotError::Other(what)),
            None => Ok(()),
        }
    }

    /// Writes the snapshot; the file appears whole or not at all.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&self, path: &Path) -> Result<(), SnapshotError> {
        Ok(lut_io::atomic::write(path, &self.encode()?)?)
    }

    /// The bytes of its file.
    ///
    /// # Errors
    /// None that is known.
    pub fn encode(&self) -> Result<Vec<u8>, SnapshotError> {
        let body = postcard::to_stdvec(self).map_err(|why| SnapshotError::Damaged(why.to_string()))?;
        let mut bytes = MAGIC.to_vec();
        bytes.extend(crc32fast::hash(&body).to_le_bytes());
        bytes.extend(body);
        Ok(bytes)
    }

    /// Reads a snapshot.
    ///
    /// # Errors
    /// The file cannot be read, or is not a whole snapshot.
    pub fn read(path: &Path) -> Result<Self, SnapshotError> {
        let mut file = std::fs::File::open(path)?;
        let too_long = || Err(SnapshotError::Damaged(format!("longer than {MAX_BYTES} bytes")));
        if file.metadata()?.len() > MAX_BYTES {
            return too_long();
        }
        // What says by its first bytes that it is something else is not read: a device has no end.
        let mut bytes = Vec::new();
        (&mut file).take(MAGIC.len() as u64).read_to_end(&mut bytes)?;
        if bytes == MAGIC {
            file.take(MAX_BYTES).read_to_end(&mut bytes)?;
        }
        if bytes.len() as u64 > MAX_BYTES {
            return too_long();
        }
        Self::decode(&bytes)
    }

    /// Decodes the bytes of a snapshot file.
    ///
    /// # Errors
    /// Not a whole snapshot.
    pub fn decode(bytes: &[u8]) -> Result<Self, SnapshotError> {
        let damaged = |why: &str| SnapshotError::Damaged(why.to_owned());
        let rest =
            bytes.strip_prefix(MAGIC).ok_or_else(|| damaged("it does not start with nacre-state/1"))?;
        let (crc, body) = rest.split_first_chunk::<4>().ok_or_else(|| damaged("it is cut short"))?;
        if crc32fast::hash(body) != u32::from_le_bytes(*crc) {
            return Err(damaged("its checksum is wrong (cut short or altered)"));
        }
        let snapshot: Self = postcard::from_bytes(body).map_err(|why| damaged(&why.to_string()))?;
        let grid = Grid::from_json(&snapshot.grid).map_err(|why| damaged(&why))?;
        snapshot.check(&grid).map_err(damaged)?;
        Ok(snapshot)
    }

    /// Whether a snapshot from a file can be gone on from: a right checksum only says that the file is as it was
    /// written.
    fn check(&self, grid: &Grid) -> Result<(), &'static str> {
        let Shard { index, count } = self.shard;
        let State { tallies, position, targets, .. } = &self.state;
        if index == 0 || index > count || count > MOST_SHARDS {
            return Err("its shard number is out of range");
        }
        // One tally an incidence and band.
        let (lobes, incidences) = (tallies.len(), grid.incident_deg.len());
        let bands = lobes.checked_div(incidences).unwrap_or(0);
        if bands * incidences != lobes
            || bands > MOST_BANDS + 1
            || [position.len(), targets.len()] != [lobes; 2]
        {
            return Err("it has other numbers of tallies than of incidences");
        }
        if tallies.iter().any(|tally| tally.cells() != grid.axis.cells()) {
            return Err("it has other cells than its grid");
        }
        // A NaN would make a state that does not even belong to its own bake.
        if matches!(self.options.target, Target::AccuracyPercent(percent) if percent.is_nan()) {
            return Err("it has an accuracy that no bake can have");
        }
        if position.iter().chain(targets).any(|&paths| paths > MAX_PATHS) {
            return Err("it claims more paths than a bake can have");
        }
        // A chunk is rounded as a whole: only the last one of a round may be shorter than the others.
        let chunks = position.iter().zip(targets);
        if chunks.into_iter().any(|(position, target)| position < target && !position.is_multiple_of(CHUNK)) {
            return Err("it stopped inside a chunk of paths");
        }
        // A whole bake has walked every path up to its position, a shard its blocks of them.
        let walked = tallies.iter().zip(position).all(|(tally, &position)| {
            if self.shard == Shard::WHOLE { tally.paths == position } else { tally.paths <= position }
        });
        if !walked || !tallies.iter().all(Tally::is_consistent) {
            return Err("its sums do not add up");
        }
        Ok(())
    }
}

/// The table of all shards of one bake, in any order.
///
/// # Errors
/// A shard is missing, doubled or of another bake; the error starts with the name of the shard at fault.
pub fn merge(shards: &[(String, Snapshot)]) -> Result<Table, BakeError> {
    let refuse = |line: String| Err(BakeError::Input(line));
    let Some((first_name, first)) = shards.first() else {
        return refuse("no shards to merge".to_owned());
    };
    if first.writer != writer() {
        let line =
            format!("{first_name}: walked by {}, this is {}; merge it with that", first.writer, writer());
        return refuse(line);
    }
    let mut seen: Vec<Option<&str>> = vec![None; first.shard.count as usize];
    for (name, shard) in shards {
        if let Err(why) = first.same_bake(shard) {
            return refuse(format!("{name}: {why} (compared with {first_name})"));
        }
        let place = &mut seen[shard.shard.index as usize - 1];
        if let Some(other) = place {
            return refuse(format!("{name}: shard {} again; {other} is the same", shard.shard.index));
        }
        *place = Some(name);
        if shard.state.position != shard.state.targets {
            return refuse(format!("{name}: shard {} is not finished; resume it", shard.shard.index));
        }
    }
    let missing: Vec<String> =
        seen.iter().zip(1..).filter(|(place, _)| place.is_none()).map(|(_, i)| format!("{i}")).collect();
    if !missing.is_empty() {
        return refuse(format!("shard {} of {} missing", missing.join(", "), first.shard.count));
    }
    let request = first.request().map_err(|why| BakeError::Input(format!("{first_name}: {why}")))?;
    let bands = request.bands()?;
    let mut sampling = Sampling::of(&request, &bands, Shard::WHOLE)?;
    let mut state = first.state.clone();
    for (name, shard) in &shards[1..] {
        for (sum, tally) in state.tallies.iter_mut().zip(&shard.state.tallies) {
            if sum.cells() != tally.cells() {
                return refuse(format!("{name}: its tallies have other cells than those of {first_name}"));
            }
            sum.add(tally);
        }
    }
    let idle = Observer::idle();
    sampling.resume(state, &idle)?;
    assemble::walk_table(&request, &bands, &sampling, &request.colours(&NEVER)?)
}

/// Walks one shard of a bake and gives its snapshot.
///
/// # Errors
/// As [`super::walk`]; a shard needs a path count.
pub fn walk_shard(request: &Request, shard: Shard, observer: &Observer<'_>) -> Result<Snapshot, BakeError> {
    let refuse = |why: String| Err(OptionError::new("shard", why).into());
    if !request.effects.has_lobe() {
        return refuse("a bake without surface and blur walks no paths: it has no shards".to_owned());
    }
    let Target::Paths(paths) = request.options.target else {
        return refuse(
            "the path counts of an accuracy or a time follow from whole tallies; expected paths".to_owned(),
        );
    };
    if request.options.solver == Some(SolverChoice::Doubling) {
        return refuse(
            "a share of the paths is walked; expected solver walk or auto, not doubling".to_owned(),
        );
    }
    let Shard { index, count } = shard;
    if !(1..=count).contains(&index) {
        return refuse(format!("{index}/{count} is out of range; expected 1/{count} to {count}/{count}"));
    }
    if matches!(request.options.effects, Effects::Listed(_)) {
        // A listed colour that the stack cannot have is refused here, not after all shards are walked.
        request.colours(&NEVER)?;
    }
    let mut sampling = Sampling::of(request, &request.bands()?, shard)?;
    sampling.walk_to_paths(paths, observer)?;
    Ok(Snapshot::new(request, shard, sampling.state()))
}

#[cfg(test)]
mod tests {
    use super::super::{Checkpoint, walk};
    use super::*;
    use proptest::prelude::*;
    use std::sync::atomic::{AtomicBool, Ordering};
    use std::sync::{Mutex, OnceLock};
    use std::time::Duration;

    fn request(paths: u64) -> Request {
        let recipe = Recipe::from_json(r#"{"stack":{"layers":6}}"#).unwrap();
        let options = Options {
            incident_deg: Some(vec![0.0, 40.0, 80.0]),
            target: Target::Paths(paths),
            seed: 3,
            event_cap: 1000,
            ..Options::default()
        };
        Request::new(recipe, options).unwrap()
    }

    fn shards(paths: u64, count: u32) -> Vec<(String, Snapshot)> {
        let request = request(paths);
        let one = |index| walk_shard(&request, Shard { index, count }, &Observer::idle()).unwrap();
        (1..=count).map(|index| (format!("s{index}"), one(index))).collect()
    }

    #[test]
    fn any_split_and_order_of_shards_gives_the_bits_of_one_bake() {
        let request = request(150_001);
        let bands = request.bands().unwrap();
        let whole = walk(&request, &bands, &Observer::idle(), None).unwrap();
        for count in [1, 2, 7, 64] {
            let mut parts = shards(150_001, count);
            parts.reverse();
            assert_eq!(merge(&parts).unwrap(), whole, "{count} shards");
        }
    }

    #[test]
    fn a_walk_stopped_at_every_state_ends_with_the_same_bits() {
        let stopped = |request: &Request| {
            let bands = request.bands().unwrap();
            let mut stops = 0;
            let mut resume = None;
            loop {
                let (kept, stop) = (Mutex::new(None), AtomicBool::new(false));
                let keep = |state: &State| {
                    *kept.lock().unwrap() = Some(Snapshot::new(request, Shard::WHOLE, state.clone()));
                    stop.store(true, Ordering::Relaxed);
                };
                let checkpoint = Checkpoint { every: Duration::ZERO, keep: &keep };
                let observer = Observer { stop: &stop, checkpoint: Some(checkpoint), ..Observer::idle() };
                match walk(request, &bands, &observer, resume.take()) {
                    Ok(table) => return (table, stops),
                    Err(BakeError::Interrupted) => (resume, stops) = (kept.lock().unwrap().take(), stops + 1),
                    Err(why) => panic!("{why}"),
                }
            }
        };
        // One thread: the fewest tasks between two states.
        let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
        for target in [Target::Paths(300_001), Target::AccuracyPercent(1.5)] {
            let mut request = request(1);
            request.options.target = target;
            let whole = walk(&request, &request.bands().unwrap(), &Observer::idle(), None).unwrap();
            let (table, stops) = pool.install(|| stopped(&request));
            assert!(table == whole && stops > 2, "{target:?}, {stops} stops");
        }
    }

    #[test]
    fn a_missing_doubled_or_foreign_shard_is_named() {
        let parts = shards(40_000, 3);
        let refusal = |parts: &[(String, Snapshot)]| merge(parts).unwrap_err().to_string();
        assert!(refusal(&parts[..2]).contains("shard 3 of 3 missing"));
        let doubled = [parts.as_slice(), &parts[1..2]].concat();
        assert!(refusal(&doubled).contains("s2: shard 2 again"));
        let mut foreign = parts.clone();
        foreign[1].1.recipe = Recipe::default().to_json().to_string();
        assert!(refusal(&foreign).contains("s2: belongs to another bake: the recipe differs"));
        let mut older = parts.clone();
        older.iter_mut().for_each(|(_, shard)| shard.writer = "bake-brdf 0.0.9".to_owned());
        assert!(refusal(&older).contains("s1: walked by bake-brdf 0.0.9, this is bake-brdf"));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn a_device_without_end_is_refused_by_its_first_bytes() {
        let refusal = Snapshot::read(Path::new("/dev/zero")).unwrap_err().to_string();
        assert!(refusal.contains("does not start with nacre-state/1"), "{refusal}");
    }

    /// Walked once for all that is tried on it.
    fn small() -> &'static Snapshot {
        static SMALL: OnceLock<Snapshot> = OnceLock::new();
        SMALL.get_or_init(|| walk_shard(&request(10), Shard::WHOLE, &Observer::idle()).unwrap())
    }

    proptest! {
        #[test]
        fn damage_is_noticed(flip in 0_usize..400, bit in 0_u8..8) {
            let folder = tempfile::tempdir().unwrap();
            let path = folder.path().join("s");
            let snapshot = small();
            snapshot.write(&path).unwrap();
            prop_assert_eq!(&Snapshot::read(&path).unwrap(), snapshot);
            let mut bytes = std::fs::read(&path).unwrap();
            bytes[flip] ^= 1 << bit;
            prop_assert!(Snapshot::decode(&bytes).is_err());
            prop_assert!(Snapshot::decode(&bytes[..flip]).is_err());
        }
    }
}
