//! `thinfilm`: what waves do in a stack of layers.

mod colour;
mod input;
mod spectrum;
mod swatch;
mod verify;

use clap::{CommandFactory as _, Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;
use terminal::{Outcome, Stop};

/// Interference in multilayers: spectra and colours of a recipe's stack.
#[derive(Debug, Parser)]
#[command(name = "thinfilm", version)]
#[command(after_help = "Examples:
  thinfilm spectrum pearl.json --angles-deg 0,30 --wavelengths-nm 380:780:401 --pol u --json
  thinfilm spectrum pearl.json --members 64                mean over irregular thicknesses, with its standard error
  thinfilm colour pearl.json --angles-deg 0:60:15 --json
  thinfilm swatch pearl.json -o swatch.png
  thinfilm verify cases.json        exit 3 if a case misses its own tolerance")]
struct Cli {
    #[command(subcommand)]
    command: Command,
    /// Print one JSON object on stdout instead of text.
    #[arg(long, global = true)]
    json: bool,
    /// Say nothing on stderr but errors.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// Say more on stderr.
    #[arg(short, long, global = true)]
    verbose: bool,
    /// Threads to use [default: one per core].
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    threads: Option<u16>,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// R, T and A of a recipe's stack over wavelengths and angles.
    Spectrum(spectrum::SpectrumArgs),
    /// Colours of a recipe's stack under D65: XYZ, linear sRGB, L*a*b*.
    Colour(colour::ColourArgs),
    /// Picture of the colour against angle and layer thickness.
    Swatch(swatch::SwatchArgs),
    /// Compare with reference answers (the format of hard_cases.json).
    Verify {
        /// Cases with answers to many digits.
        cases: PathBuf,
    },
    /// Print a shell completion script.
    Completions {
        /// bash, elvish, fish, powershell or zsh.
        shell: clap_complete::Shell,
    },
    /// Print the manual page (roff).
    Man,
}

fn main() -> ExitCode {
    terminal::main(run)
}

fn run(cli: Cli) -> Outcome {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(cli.threads.unwrap_or(0).into()).build();
    pool.map_err(Stop::failure)?.install(|| match &cli.command {
        Command::Spectrum(args) => spectrum::spectrum(args, cli.json),
        Command::Colour(args) => colour::colours(args, cli.json, cli.quiet),
        Command::Swatch(args) => swatch::swatch(args, cli.quiet),
        Command::Verify { cases } => verify::verify(cases, cli.json),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(*shell, &mut Cli::command(), "thinfilm", &mut script);
            terminal::print(&String::from_utf8_lossy(&script))
        }
        Command::Man => {
            let mut page = Vec::new();
            clap_mangen::Man::new(Cli::command()).render(&mut page)?;
            terminal::print(&String::from_utf8_lossy(&page))
        }
    })
}

/// One line on stderr beside a result.
#[allow(clippy::print_stderr)] // a tool speaks to people there
fn note(line: &str) {
    eprintln!("thinfilm: {line}");
}
