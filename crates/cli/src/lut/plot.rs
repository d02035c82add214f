//! `lut plot`

use crate::{FileArg, Manners, read_lobe};
use std::path::PathBuf;
use terminal::Outcome;

#[derive(clap::Args, Debug)]
pub(crate) struct PlotArgs {
    #[command(flatten)]
    file: FileArg,
    /// Folder for the figures; made if it does not exist.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

pub(crate) fn run(args: &PlotArgs, _manners: Manners) -> Outcome {
    let _lobe = read_lobe(&args.file.file)?;
    Ok(())
}
