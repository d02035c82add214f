//! `lut merge`: the table of a bake that was walked in shards.

use bake_brdf::bake::snapshot::{self, Snapshot, SnapshotError};
use bake_brdf::options::SolverChoice;
use lut_io::{atomic, exr_file};
use std::path::PathBuf;
use terminal::{Outcome, Stop};

#[derive(clap::Args, Debug)]
pub(crate) struct MergeArgs {
    /// Every shard of one bake (`bake-brdf --shard I/N`), in any order.
    #[arg(value_name = "SHARD", required = true)]
    shards: Vec<PathBuf>,
    /// Table to write.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
    /// Merge only shards of the bake that has this content hash (`bake-brdf … --dry-run --json` says it).
    #[arg(long, value_name = "HASH")]
    content_hash: Option<String>,
}

pub(crate) fn run(args: &MergeArgs, json: bool) -> Outcome {
    let mut shards = Vec::with_capacity(args.shards.len());
    for path in &args.shards {
        let name = path.display().to_string();
        if atomic::same_file(path, &args.output) {
            return Err(Stop::BadInput(format!(
                "--output: {name} is one of the shards, expected a file of its own for the table"
            )));
        }
        let named = |why: SnapshotError| Stop::bad_input(format!("{name}: {why}"));
        let snapshot = Snapshot::read(path).map_err(named)?;
        if let Some(wanted) = &args.content_hash {
            let found = snapshot.request().map_err(named)?.content_hash(SolverChoice::Walk);
            if found != *wanted {
                return Err(Stop::BadInput(format!(
                    "{name}: belongs to another bake: its content hash is {found}, expected {wanted}"
                )));
            }
        }
        shards.push((name, snapshot));
    }
    let table = snapshot::merge(&shards).map_err(Stop::bad_input)?;
    exr_file::write(&table, &args.output).map_err(super::stop)?;
    if !json {
        return Ok(());
    }
    terminal::print_json(&serde_json::json!({
        "schema": "lut-merge/1", "output": args.output.display().to_string(), "shards": shards.len(),
    }))
}
