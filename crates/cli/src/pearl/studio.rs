//! `pearl studio` and `pearl page`: the simulator, served or as one file.

use crate::args::{PageArgs, StudioArgs};
use pearl_bsdf::Prepared;
use std::path::Path;
use std::sync::Arc;
use studio::{Server, Settings, Start, StudioError, page};
use terminal::{Manners, Outcome, Stop};

/// Serves until Ctrl-C.
pub(crate) fn run(args: &StudioArgs, manners: &Manners) -> Outcome {
    let stop = terminal::interruption()?;
    let settings =
        Settings { port: args.port, threads: Some(manners.pool()?), ..Settings::new(start(&args.start)?) };
    let server = Server::bind(settings).map_err(|error| match &error {
        StudioError::Port { .. } => Stop::failure(format!("--{error}")),
        _ => Stop::failure(error),
    })?;
    let url = server.url();
    terminal::print(&format!("{url}\n"))?;
    if !args.no_browser
        && let Err(error) = open::that_detached(&url)
    {
        note(&format!("no browser could be opened ({error}): open the URL above"));
    }
    server.run(stop).map_err(Stop::failure)
}

/// A table by its ending, else a recipe.
fn start(path: &Path) -> Result<Start, Stop> {
    if path.extension().is_some_and(|ending| ending.eq_ignore_ascii_case("exr")) {
        return nacre_cli::read_table(path).map(Start::Table);
    }
    nacre_cli::read_recipe(path).map(Start::Recipe)
}

/// Writes the page.
pub(crate) fn write_page(args: &PageArgs, manners: &Manners) -> Outcome {
    nacre_cli::check_output("table", &args.table, &args.output)?;
    let table = Arc::new(nacre_cli::read_table(&args.table)?);
    let bad = |why: &dyn std::fmt::Display| Stop::bad_input(format!("{}: {why}", args.table.display()));
    let prepared = Prepared::new(Arc::clone(&table)).map_err(|why| bad(&why))?;
    let html = page::alone(&table, &prepared).map_err(Stop::failure)?;
    nacre_cli::write_file(&args.output, html.as_bytes())?;
    nacre_cli::print_files("pearl-page/1", std::slice::from_ref(&args.output), manners)
}

/// One line on stderr beside a result.
#[allow(clippy::print_stderr)] // a tool speaks to people there
fn note(line: &str) {
    eprintln!("pearl: {line}");
}
