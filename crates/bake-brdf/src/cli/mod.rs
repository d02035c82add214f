//! Arguments of `bake-brdf` and what they call.

mod args;
mod bake;
mod checkpoint;
mod errors;
mod plan;
mod progress;
mod reproduce;
mod study;

use clap::{Parser, Subcommand};
use terminal::{Manners, Outcome};

/// Bakes a pearl: walks light through 500 layers of nacre and writes the table of where it goes.
#[derive(Debug, Parser)]
#[command(name = "bake-brdf", version, args_conflicts_with_subcommands = true)]
#[command(after_help = "Examples:
  bake-brdf                         the paper's pearl into pearl.exr, about 15 seconds
  bake-brdf akoya -o akoya.exr      a built-in recipe, or a file
  bake-brdf --accuracy 0.3          0.3 % total variation at the worst incidence
  bake-brdf --dry-run               what would that cost?
  bake-brdf plan akoya              what is simulated, why, and at what cost

--help has more options and examples.")]
#[command(after_long_help = "Examples:
  bake-brdf                                  the paper's pearl into pearl.exr, about 15 seconds
  bake-brdf akoya -o akoya.exr               a built-in recipe, or a file
  bake-brdf --accuracy 0.3 -o fine.exr       0.3 % total variation at the worst incidence
  bake-brdf --paths 1000000 --seed 7 --json  a million paths per incidence, report as JSON
  bake-brdf --incident-deg 0:90:10,45        a few incidences
  bake-brdf --dry-run --accuracy 0.1         what would that cost?
  bake-brdf --reproduce pearl.exr            bake it again from its metadata: the same bits?
  bake-brdf plan akoya                       what is simulated, why, and at what cost
  bake-brdf study -o study                   what accuracy costs in time, with a figure
  bake-brdf schema                           the JSON Schema of a recipe")]
pub(crate) struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    bake: bake::BakeArgs,
    #[command(flatten)]
    manners: Manners,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Bake a table (the default command).
    Bake(bake::BakeArgs),
    /// Say which effects a recipe calls for, why, and what each costs.
    Plan(plan::PlanArgs),
    /// Measure what accuracy costs in time: study.json, study.csv and a figure.
    Study(study::StudyArgs),
    /// Print the JSON Schema of a recipe.
    Schema,
    /// Print a shell completion script.
    Completions {
        /// bash, elvish, fish, powershell or zsh.
        shell: terminal::Shell,
    },
    /// Print the manual page (roff).
    Man,
}

/// Runs the tool.
pub(crate) fn run(cli: Cli) -> Outcome {
    let manners = cli.manners;
    match cli.command {
        None => bake(&cli.bake, &manners),
        Some(Command::Bake(args)) => bake(&args, &manners),
        Some(Command::Plan(args)) => plan::run(&args, &manners),
        Some(Command::Study(args)) => study::run(&args, &manners),
        Some(Command::Schema) => terminal::print_json(&bake_brdf::recipe::Recipe::json_schema()),
        Some(Command::Completions { shell }) => terminal::completions::<Cli>(shell),
        Some(Command::Man) => terminal::manual::<Cli>(),
    }
}

/// Bakes a recipe, or a table again.
fn bake(args: &bake::BakeArgs, manners: &Manners) -> Outcome {
    match &args.reproduce {
        Some(table) => reproduce::run(table, manners),
        None => bake::run(args, manners),
    }
}

#[allow(clippy::print_stderr)] // the tool's voice
fn say(line: &str) {
    eprintln!("bake-brdf: {line}");
}
