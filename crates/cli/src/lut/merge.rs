//! `lut merge`: the table of a bake that was walked in shards.

use bake_brdf::bake::snapshot::{self, Snapshot};
use lut_io::exr_file;
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
}

pub(crate) fn run(args: &MergeArgs) -> Outcome {
    let mut shards = Vec::with_capacity(args.shards.len());
    for path in &args.shards {
        let name = path.display().to_string();
        let snapshot = Snapshot::read(path).map_err(|why| Stop::bad_input(format!("{name}: {why}")))?;
        shards.push((name, snapshot));
    }
    let table = snapshot::merge(&shards).map_err(Stop::bad_input)?;
    exr_file::write(&table, &args.output).map_err(super::stop)
}
