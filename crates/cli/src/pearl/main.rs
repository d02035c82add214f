//! The `pearl` tool: a table as a BSDF — values, samples, furnace, pictures.

mod args;
mod directions;
mod furnace;
mod preview;

use args::{Cli, Command};
use clap::CommandFactory as _;
use terminal::{Outcome, Stop};

fn main() -> std::process::ExitCode {
    terminal::main(run)
}

fn run(cli: Cli) -> Outcome {
    if let Some(threads) = cli.manners.threads {
        rayon::ThreadPoolBuilder::new()
            .num_threads(usize::from(threads))
            .build_global()
            .map_err(Stop::failure)?;
    }
    match cli.command {
        Command::Eval(args) => directions::eval(&args),
        Command::Sample(args) => directions::sample(&args),
        Command::Furnace(args) => furnace::run(&args, cli.manners.json),
        Command::Preview(args) => preview::run(&args, &cli.manners),
        Command::Completions { shell } => {
            let mut script = Vec::new();
            clap_complete::generate(shell, &mut Cli::command(), "pearl", &mut script);
            terminal::print(&String::from_utf8_lossy(&script))
        }
        Command::Man => {
            let mut page = Vec::new();
            clap_mangen::Man::new(Cli::command()).render(&mut page)?;
            terminal::print(&String::from_utf8_lossy(&page))
        }
    }
}
