//! `lut`: what is in a pearl table, is it sound, how far is it from another.

mod check;
mod diff;
mod export;
mod fit;
mod info;
mod merge;
mod plot;
mod slice;

use clap::{Args, Parser, Subcommand};
use lut_io::lobe::Interpolant;
use lut_io::{LutError, Table};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use terminal::{Outcome, Stop};

/// Looks into pearl tables: summary, slices, plots, comparison, checks.
#[derive(Debug, Parser)]
#[command(name = "lut", version)]
#[command(after_help = "Examples:
  lut info pearl.exr                                 what it is, albedo and moments per incidence
  lut info pearl.exr --json | jq .per_incidence[0]
  lut slice pearl.exr --theta-i 30 --phi 0 --csv     the lobe in the plane of incidence
  lut plot pearl.exr -o figures                      Figs. 6, 7 and 10 of the paper, SVG and PNG
  lut diff pearl.exr other.exr                       exit 3 if they differ by more than their errors
  lut export pearl.exr --to bsdf-rgb -o pearl.bsdf   for Mitsuba's `measured` and pbrt-v4; says its own error
  lut fit pearl.exr -o small.exr                     ten times smaller; says what that costs
  lut check pearl.exr                                exit 3 if something that must hold does not
  lut check pearl.exr --against other_seed.exr       and are its error bars honest?")]
struct Cli {
    #[command(subcommand)]
    command: Command,
    #[command(flatten)]
    manners: terminal::Manners,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Print what a table holds and where its light goes.
    Info(info::InfoArgs),
    /// Print the lobe along θo at one angle of incidence and one azimuth.
    Slice(slice::SliceArgs),
    /// Draw the paper's Figs. 6, 7 and 10 as SVG and PNG.
    Plot(plot::PlotArgs),
    /// Compare two tables; exit 3 if they differ by more than their stored errors explain.
    Diff(diff::DiffArgs),
    /// Try on a table what must hold of every table; exit 3 if something does not.
    Check(check::CheckArgs),
    /// Write the table, with the look of its recipe, for other programs; prints the error of the round trip.
    Export(export::ExportArgs),
    /// Write a compact form that every reader of tables expands; prints its size and its error.
    Fit(fit::FitArgs),
    /// Make the table of a bake that was walked in shards, bit for bit that of one bake.
    Merge(merge::MergeArgs),
    /// Print a shell completion script.
    Completions {
        /// bash, elvish, fish, powershell or zsh.
        shell: terminal::Shell,
    },
    /// Print the manual page (roff).
    Man,
}

fn main() -> ExitCode {
    terminal::main(run)
}

fn run(cli: Cli) -> Outcome {
    let json = cli.manners.json;
    cli.manners.pool()?.install(|| match cli.command {
        Command::Info(args) => info::run(&args, json),
        Command::Slice(args) => slice::run(&args, json),
        Command::Plot(args) => plot::run(&args, &cli.manners),
        Command::Diff(args) => diff::run(&args, json),
        Command::Check(args) => check::run(&args, json),
        Command::Export(args) => export::run(&args, json),
        Command::Fit(args) => fit::run(&args, json),
        Command::Merge(args) => merge::run(&args, json),
        Command::Completions { shell } => terminal::completions::<Cli>(shell),
        Command::Man => terminal::manual::<Cli>(),
    })
}

fn stop(error: LutError) -> Stop {
    if error.is_bad_input() { Stop::bad_input(error) } else { Stop::failure(error) }
}

fn read(path: &Path) -> Result<Table, Stop> {
    nacre_cli::read_table(path)
}

fn read_lobe(path: &Path) -> Result<Interpolant, Stop> {
    read(path).map(Interpolant::new)
}

/// The table argument that every command starts with.
#[derive(Args, Debug)]
struct FileArg {
    /// The table (OpenEXR file written by `bake-brdf`).
    #[arg(value_name = "FILE")]
    file: PathBuf,
}
