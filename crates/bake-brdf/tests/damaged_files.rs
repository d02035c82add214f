//! Every reader against the corpora in `fuzz/`: seeds are read, damaged files are refused in one line, mutations of
//! both panic nowhere, and no file makes a reader take more memory than a small machine has.

#[path = "../../../fuzz/readers.rs"]
mod readers;

use bake_brdf::bake::snapshot::{Snapshot, walk_shard};
use bake_brdf::bake::{Observer, Shard};
use bake_brdf::options::Target;
use bake_brdf::recipe::Recipe;
use lut_io::merl::Merl;
use lut_io::tensor_file::{self, Field};
use readers::{FEW_BINS, READERS, Reader};
use std::fs;
use std::panic::catch_unwind;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// Mutations tried on each reader in the ordinary tests; the ignored test takes as many as NACRE_EXECUTIONS says.
const MUTATIONS: u64 = 4_000;
/// Most memory that reading may take on top of the test itself, bytes.
const MOST_MEMORY: u64 = 256 << 20;

fn folder(kind: &str, target: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../fuzz").join(kind).join(target)
}

/// The files of a corpus by name, in order.
fn files(kind: &str, target: &str) -> Vec<(String, Vec<u8>)> {
    let folder = folder(kind, target);
    let entries = fs::read_dir(&folder).unwrap_or_else(|why| panic!("{}: {why}", folder.display()));
    let mut files: Vec<(String, Vec<u8>)> = entries
        .map(|entry| {
            let path = entry.expect("an entry").path();
            (path.display().to_string(), fs::read(&path).expect("a file"))
        })
        .collect();
    files.sort();
    assert!(!files.is_empty(), "{} is empty", folder.display());
    files
}

/// Largest resident memory of this process so far, bytes; `None` where the system does not say.
fn peak_memory() -> Option<u64> {
    let status = fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|line| line.starts_with("VmHWM:"))?;
    Some(line.split_whitespace().nth(1)?.parse::<u64>().ok()? << 10)
}

/// What a reader says of a file; a panic fails the test with the file's name.
fn outcome(reader: Reader, name: &str, bytes: &[u8]) -> Result<(), String> {
    catch_unwind(|| reader(bytes)).unwrap_or_else(|_| panic!("{name} made the reader panic"))
}

#[test]
fn every_seed_is_read() {
    for (target, reader) in READERS {
        for (name, bytes) in files("corpus", target) {
            assert_eq!(outcome(reader, &name, &bytes), Ok(()), "{name}");
        }
    }
}

#[test]
fn every_damaged_file_is_refused_without_a_panic_and_in_little_memory() {
    let before = peak_memory();
    for (target, reader) in READERS {
        for (name, bytes) in files("damaged", target) {
            let why = outcome(reader, &name, &bytes).expect_err(&name);
            assert!(why.len() < 1000, "{name}: a line nobody reads: {} bytes", why.len());
        }
    }
    if let (Some(before), Some(after)) = (before, peak_memory()) {
        assert!(after - before < MOST_MEMORY, "reading took {} MB", (after - before) >> 20);
    }
}

/// splitmix64: one stream of numbers from a seed.
struct Dice(u64);

impl Dice {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn below(&mut self, bound: usize) -> usize {
        (self.next() % bound.max(1) as u64) as usize
    }
}

/// One to four hurts: a bit, a byte, a run of one byte, a cut, a copy of another part, a number made huge.
fn mutate(bytes: &[u8], dice: &mut Dice) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    for _ in 0..=dice.below(4) {
        let (at, length) = (dice.below(bytes.len()), 1 + dice.below(16));
        let end = (at + length).min(bytes.len());
        match dice.below(7) {
            0 if !bytes.is_empty() => bytes[at] ^= 1 << dice.below(8),
            1 if !bytes.is_empty() => bytes[at] = dice.next() as u8,
            2 => bytes[at..end].fill([0, 0xff, 0x7f, b'9', b'['][dice.below(5)]),
            3 => bytes.truncate(at),
            4 => {
                let part = bytes[at..end].to_vec();
                let to = dice.below(bytes.len());
                bytes.splice(to..to, part);
            }
            5 => drop(bytes.drain(at..end)),
            _ => {
                let number = (dice.next() >> dice.below(64)).to_le_bytes();
                for (byte, new) in bytes[at..end].iter_mut().zip(number) {
                    *byte = new;
                }
            }
        }
    }
    bytes
}

/// Mutates seeds and damaged files of every reader; gives what was refused and what was read of each.
fn mutations(count: u64) -> Vec<(&'static str, u64, u64)> {
    let mut seen = Vec::new();
    for (target, reader) in READERS {
        let seeds = [files("corpus", target), files("damaged", target)].concat();
        let (mut refused, mut read) = (0, 0);
        for execution in 0..count {
            let mut dice = Dice(execution);
            let bytes = mutate(&seeds[dice.below(seeds.len())].1, &mut dice);
            let name = format!("{target}, mutation {execution},");
            match outcome(reader, &name, &bytes) {
                Ok(()) => read += 1,
                Err(_) => refused += 1,
            }
        }
        seen.push((target, refused, read));
    }
    seen
}

#[test]
fn thousands_of_mutations_panic_nowhere() {
    for (target, refused, _) in mutations(MUTATIONS) {
        assert!(
            refused > MUTATIONS / 3,
            "{target}: mutations that hurt nothing: {refused} of {MUTATIONS} refused"
        );
    }
}

#[test]
#[ignore = "a million mutations a reader unless NACRE_EXECUTIONS says otherwise: tens of minutes"]
#[allow(clippy::print_stdout)] // the figures are the point
fn a_million_mutations_panic_nowhere() {
    let count = std::env::var("NACRE_EXECUTIONS").ok().and_then(|n| n.parse().ok()).unwrap_or(1_000_000);
    for (target, refused, read) in mutations(count) {
        println!("{target:<12} {count} executions, {refused} refused, {read} read");
    }
    let peak = peak_memory();
    println!("peak memory {:?} MB", peak.map(|bytes| bytes >> 20));
}

#[test]
#[ignore = "writes fuzz/corpus and fuzz/damaged anew, for when a format changes"]
fn write_the_corpora() {
    for (target, reader) in READERS {
        let seeds = seeds(target);
        let write = |kind: &str, name: &str, bytes: &[u8]| {
            fs::create_dir_all(folder(kind, target)).expect("a folder");
            fs::write(folder(kind, target).join(name), bytes).expect("a file");
        };
        for (name, bytes) in &seeds {
            write("corpus", name, bytes);
        }
        for (name, bytes) in made_up(target) {
            assert!(reader(&bytes).is_err(), "{target}/{name} is not refused");
            write("damaged", name, &bytes);
        }
        // Random hurts that are noticed, a dozen a seed.
        for (name, bytes) in &seeds {
            let mut dice = Dice(bytes.len() as u64);
            let hurt = std::iter::repeat_with(|| mutate(bytes, &mut dice));
            for (index, hurt) in hurt.filter(|hurt| reader(hurt).is_err()).take(12).enumerate() {
                write("damaged", &format!("{name}.{index}"), &hurt);
            }
        }
    }
}

fn small_state(paths: u64) -> Snapshot {
    let request = readers::small_bake(Target::Paths(paths));
    walk_shard(&request, Shard::WHOLE, &Observer::idle()).expect("a shard")
}

/// A state from which there is still something to walk.
fn begun(target: Target) -> Snapshot {
    let mut snapshot = small_state(8192);
    snapshot.options.target = target;
    snapshot
}

fn body(snapshot: &Snapshot) -> Vec<u8> {
    let file = tempfile::NamedTempFile::new().expect("a temporary file");
    snapshot.write(file.path()).expect("a state is written");
    let whole = fs::read(file.path()).expect("a file");
    whole[b"nacre-state/1\n".len() + 4..].to_vec()
}

type Named = (&'static str, Vec<u8>);

/// Whole files that a reader must take.
fn seeds(target: &str) -> Vec<Named> {
    let text = |name, text: &str| (name, text.as_bytes().to_vec());
    match target {
        "table" => {
            let encode = |table| lut_io::exr_file::encode(&table).expect("a table");
            vec![
                ("plane", encode(specimen::plane(&[0.0, 45.0], 4))),
                ("space", encode(specimen::space(&[0.0, 60.0], 4, 2))),
                ("one", encode(specimen::plane(&[30.0], 2))),
            ]
        }
        "bsdf" => {
            let fields = [
                Field::u8("description", b"a pearl"),
                Field::f32("theta_i", &[3], vec![0.0, 0.5, 1.0]),
                Field::f32("vndf", &[1, 2, 3], vec![0.25; 6]),
            ];
            vec![
                ("fields", tensor_file::encode(&fields).expect("a tensor file")),
                ("none", tensor_file::encode(&[]).expect("a tensor file")),
            ]
        }
        "recipe" => vec![
            text("empty", "{}"),
            ("full", Recipe::default().to_json().to_string().into_bytes()),
            text(
                "dispersive",
                r#"{"stack":{"explicit":[{"n":{"cauchy":[1.5,0.004]},"thickness_nm":300},{"n":1.4,"k":0.01,"thickness_nm":20}]}}"#,
            ),
            text(
                "pairs",
                r#"{"schema":"pearl-recipe/1","stack":{"layers":9,"count":"pairs"},"facets":{"normals":"visible"}}"#,
            ),
        ],
        "merl" => vec![
            ("grey", Merl::tabulate_bins(FEW_BINS, |_, _| [0.25; 3]).encode()),
            ("mirror", Merl::tabulate_bins(FEW_BINS, |wi, wo| [wi[2], wo[2], wi[0] * wi[0]]).encode()),
        ],
        "state" => vec![
            ("whole", readers::with_checksum(&body(&small_state(3000)))),
            ("half", readers::with_checksum(&body(&readers::half(1)))),
        ],
        "checkpoint" => vec![
            ("finished", body(&small_state(3000))),
            ("accuracy", body(&begun(Target::AccuracyPercent(0.5)))),
            ("time", body(&begun(Target::Time(Duration::from_secs(5))))),
        ],
        "shard" => vec![
            ("whole", body(&small_state(3000))),
            ("empty", body(&small_state(1))),
            ("first", body(&readers::half(1))),
            ("second", body(&readers::half(2))),
        ],
        other => panic!("{other} has no seeds"),
    }
}

/// Files that somebody thought of.
fn made_up(target: &str) -> Vec<Named> {
    let text = |name, text: &str| (name, text.as_bytes().to_vec());
    match target {
        "table" => {
            let whole = &seeds(target)[0].1;
            let claim = |name: &str, bytes: [u8; 4]| {
                let at = whole.windows(name.len()).position(|w| w == name.as_bytes()).expect("an attribute");
                let mut file = whole.clone();
                file[at + name.len()..at + name.len() + 4].copy_from_slice(&bytes);
                file
            };
            vec![
                ("nothing", Vec::new()),
                ("magic", whole[..4].to_vec()),
                ("half", whole[..whole.len() / 2].to_vec()),
                ("huge-attribute", claim("pearl\0string\0", i32::MAX.to_le_bytes())),
                ("negative-attribute", claim("pearl\0string\0", (-1_i32).to_le_bytes())),
                ("huge-channels", claim("channels\0chlist\0", i32::MAX.to_le_bytes())),
                ("huge-window", {
                    let mut file = claim("dataWindow\0box2i\0", 16_i32.to_le_bytes());
                    let at =
                        file.windows(17).position(|w| w == b"dataWindow\0box2i\0").expect("it is there") + 21;
                    file[at + 8..at + 16].fill(0x7f);
                    file
                }),
                ("png", b"\x89PNG\r\n\x1a\n0000000000".to_vec()),
            ]
        }
        "bsdf" => {
            let whole = &seeds(target)[0].1;
            // The first field: its name, its extents.
            let name = whole.windows(11).position(|w| w == b"description").expect("a name");
            let hurt = |at: usize, bytes: &[u8]| overwritten(whole, at, bytes);
            vec![
                ("nothing", Vec::new()),
                ("magic", whole[..14].to_vec()),
                ("half", whole[..whole.len() / 2].to_vec()),
                ("many-fields", hurt(14, &u32::MAX.to_le_bytes())),
                ("long-name", hurt(name - 2, &u16::MAX.to_le_bytes())),
                ("name-not-utf8", hurt(name, &[0xff; 11])),
                ("many-dimensions", hurt(name + 11, &u16::MAX.to_le_bytes())),
                ("unknown-type", hurt(name + 13, &[42])),
                ("far-offset", hurt(name + 14, &u64::MAX.to_le_bytes())),
                ("huge-extent", hurt(name + 22, &u64::MAX.to_le_bytes())),
            ]
        }
        "recipe" => vec![
            ("nothing", Vec::new()),
            ("not-utf8", vec![0xff, 0xfe, 0x00]),
            ("deep", b"[".repeat(100_000)),
            ("deep-object", br#"{"stack":"#.repeat(20_000)),
            text("huge-number", r#"{"stack":{"aragonite":{"n":1e999}}}"#),
            text("nan", r#"{"stack":{"aragonite":{"n":NaN}}}"#),
            text("twice", r#"{"name":"a","name":"b"}"#),
            text("many-layers", r#"{"stack":{"layers":18446744073709551615}}"#),
            text("negative-layers", r#"{"stack":{"layers":-1}}"#),
            text("unknown", r#"{"stack":{"layer":500}}"#),
            text("newer", r#"{"schema":"pearl-recipe/2"}"#),
        ],
        "state" => {
            let whole = &seeds(target)[0].1;
            let mut flipped = whole.clone();
            let middle = whole.len() / 2;
            flipped[middle] ^= 1;
            vec![
                ("nothing", Vec::new()),
                ("magic", b"nacre-state/1\n".to_vec()),
                ("newer", b"nacre-state/2\n0000".to_vec()),
                ("half", whole[..middle].to_vec()),
                ("flipped", flipped),
            ]
        }
        "merl" => {
            let whole = &seeds(target)[0].1;
            let hurt = |at: usize, bytes: &[u8]| overwritten(whole, at, bytes);
            vec![
                ("nothing", Vec::new()),
                ("header", whole[..12].to_vec()),
                ("half", whole[..whole.len() / 2].to_vec()),
                ("one-byte-more", [whole.as_slice(), &[0]].concat()),
                ("real-header", hurt(0, &[90_i32, 90, 180].map(i32::to_le_bytes).concat())),
                ("huge-header", hurt(0, &[0x7f; 12])),
                ("negative-header", hurt(0, &[0xff; 12])),
                ("nan", hurt(12, &f64::NAN.to_le_bytes())),
                ("infinity", hurt(12, &f64::INFINITY.to_le_bytes())),
            ]
        }
        "checkpoint" => {
            let changed = |change: fn(&mut Snapshot)| {
                let mut snapshot = begun(Target::AccuracyPercent(0.5));
                change(&mut snapshot);
                body(&snapshot)
            };
            [
                damaged_state(changed),
                vec![
                    // Of a whole bake nothing is left out.
                    ("position-past-the-paths", changed(|s| s.state.position[0] *= 2)),
                    (
                        "position-inside-a-chunk",
                        changed(|s| {
                            *s = small_state(3000);
                            s.options.target = Target::AccuracyPercent(0.5);
                            s.state.targets[0] = 8192;
                        }),
                    ),
                    (
                        "accuracy-not-a-number",
                        changed(|s| s.options.target = Target::AccuracyPercent(f64::NAN)),
                    ),
                    ("no-time", changed(|s| s.options.target = Target::Time(Duration::ZERO))),
                ],
            ]
            .concat()
        }
        "shard" => damaged_state(|change| {
            let mut snapshot = small_state(3000);
            change(&mut snapshot);
            body(&snapshot)
        }),
        other => panic!("{other} has no damaged files"),
    }
}

/// The file with some of its bytes replaced.
fn overwritten(file: &[u8], at: usize, bytes: &[u8]) -> Vec<u8> {
    let mut file = file.to_vec();
    file[at..at + bytes.len()].copy_from_slice(bytes);
    file
}

/// Bodies that neither a checkpoint nor a shard may have.
fn damaged_state(changed: impl Fn(fn(&mut Snapshot)) -> Vec<u8>) -> Vec<Named> {
    vec![
        ("nothing", Vec::new()),
        ("huge-length", vec![0xff; 64]),
        ("shards-without-end", changed(|s| s.shard.count = u32::MAX)),
        ("shard-zero", changed(|s| s.shard.index = 0)),
        ("no-tallies", changed(|s| s.state.tallies.clear())),
        ("no-positions", changed(|s| s.state.position.clear())),
        ("endless-target", changed(|s| s.state.targets[0] = u64::MAX)),
        ("more-paths-than-walked", changed(|s| s.state.tallies[0].paths += 1)),
        ("paths-without-end", changed(|s| s.state.tallies[0].paths = u64::MAX)),
        ("other-recipe", changed(|s| s.recipe = r#"{"stack":{"layers":0}}"#.to_owned())),
        ("bad-incidence", changed(|s| s.grid = s.grid.replace("40.0", "91.0"))),
        (
            "other-cells",
            changed(|s| {
                s.grid = r#"{"incident_deg":[40.0],"axis":{"kind":"plane","cells":2,"width":0.1}}"#.to_owned()
            }),
        ),
    ]
}
