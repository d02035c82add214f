//! The `pearl` tool: a table as a BSDF — values, samples, furnace, pictures.

mod args;
mod directions;
mod furnace;
mod preview;

use args::{Cli, Command};
use terminal::Outcome;

fn main() -> std::process::ExitCode {
    terminal::main(run)
}

fn run(cli: Cli) -> Outcome {
    cli.manners.pool()?.install(|| match cli.command {
        Command::Eval(args) => directions::eval(&args),
        Command::Sample(args) => directions::sample(&args),
        Command::Furnace(args) => furnace::run(&args, cli.manners.json),
        Command::Preview(args) => preview::run(&args, &cli.manners),
        Command::Completions { shell } => terminal::completions::<Cli>(shell),
        Command::Man => terminal::manual::<Cli>(),
    })
}
