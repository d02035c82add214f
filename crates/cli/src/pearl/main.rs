//! The `pearl` tool: a table as a BSDF — values, samples, furnace, pictures, simulator.

mod args;
mod directions;
mod furnace;
mod preview;
mod studio;

use args::{Cli, Command};
use terminal::Outcome;

fn main() -> std::process::ExitCode {
    terminal::main(run)
}

fn run(cli: Cli) -> Outcome {
    let Cli { command, manners } = cli;
    if let Command::Studio(args) = &command {
        // It bakes on threads of its own.
        return studio::run(args, &manners);
    }
    manners.pool()?.install(|| match command {
        Command::Eval(args) => directions::eval(&args),
        Command::Sample(args) => directions::sample(&args),
        Command::Furnace(args) => furnace::run(&args, manners.json),
        Command::Preview(args) => preview::run(&args, &manners),
        Command::Page(args) => studio::write_page(&args, &manners),
        Command::Studio(args) => studio::run(&args, &manners),
        Command::Completions { shell } => terminal::completions::<Cli>(shell),
        Command::Man => terminal::manual::<Cli>(),
    })
}
