//! The `bake-brdf` tool: recipes in, pearl tables out.

mod cli;

fn main() -> std::process::ExitCode {
    terminal::main(cli::run)
}
