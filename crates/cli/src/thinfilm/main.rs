//! `thinfilm`: what waves do in a stack of layers.

mod colour;
mod input;
mod materials;
mod spectrum;
mod swatch;
mod verify;

use clap::{Parser, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;
use terminal::Outcome;

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
    #[command(flatten)]
    manners: terminal::Manners,
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
    /// List the optical constants that a recipe can name as {"material": NAME}, with their sources.
    Materials,
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
    let terminal::Manners { json, quiet, .. } = cli.manners;
    cli.manners.pool()?.install(|| match &cli.command {
        Command::Spectrum(args) => spectrum::spectrum(args, json, quiet),
        Command::Colour(args) => colour::colours(args, json, quiet),
        Command::Swatch(args) => swatch::swatch(args, json, quiet),
        Command::Verify { cases } => verify::verify(cases, json),
        Command::Materials => materials::materials(json),
        Command::Completions { shell } => terminal::completions::<Cli>(*shell),
        Command::Man => terminal::manual::<Cli>(),
    })
}

/// One line on stderr beside a result.
#[allow(clippy::print_stderr)] // a tool speaks to people there
fn note(line: &str) {
    eprintln!("thinfilm: {line}");
}
