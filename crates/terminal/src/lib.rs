#![doc = include_str!("../README.md")]
//!
//! # What is here
//!
//! - [`main`] parses arguments, runs a tool and turns its [`Outcome`] into an exit code; [`Stop`] says why a tool ends without its result;
//! - [`Manners`]: `--json`, `--quiet`, `--threads`, alike for all tools; [`completions`] and [`manual`] for shells and `man`;
//! - [`print()`], [`print_json`] and [`stdout_error`] for results; [`one_line`] for what is said of them;
//! - [`open_text`], [`read_text`] and [`angles_deg`] for input; [`make_folder`] for output; [`interruption`] for Ctrl-C.
//!
//! The crate has no features to choose.
//!
//! # Errors
//!
//! All are a [`Stop`], whose variant is the exit code and whose text is one line.
#![allow(clippy::print_stderr, clippy::print_stdout)] // this crate is the terminal

pub use clap_complete::Shell;
pub use lists::angles_deg;
pub use signals::interruption;
pub use text::{open_text, read_text};

mod lists;
mod signals;
mod text;

use clap::Args;
use std::io::Write as _;
use std::path::Path;
use std::process::ExitCode;

/// Why a tool stops without its result; the variant decides the exit code.
#[derive(Debug)]
pub enum Stop {
    /// Wrong usage or a bad input file: exit 2. The text is one line.
    BadInput(String),
    /// Input/output or another runtime failure: exit 1. The text is one line.
    Failure(String),
    /// A check was run and failed: exit 3. The text is one line.
    CheckFailed(String),
    /// The reader of our stdout went away (`| head -1`): exit 0, silently.
    BrokenPipe,
}

/// What every tool's main function returns.
pub type Outcome = Result<(), Stop>;

impl Stop {
    /// Wrong usage or bad input, exit 2.
    pub fn bad_input(why: impl std::fmt::Display) -> Self {
        Self::BadInput(why.to_string())
    }

    /// Runtime failure, exit 1.
    pub fn failure(why: impl std::fmt::Display) -> Self {
        Self::Failure(why.to_string())
    }

    /// A check was run and failed, exit 3.
    pub fn check_failed(why: impl std::fmt::Display) -> Self {
        Self::CheckFailed(why.to_string())
    }
}

/// Why standard output took no more: a closed pipe is [`Stop::BrokenPipe`], all else a failure.
#[must_use]
pub fn stdout_error(error: &std::io::Error) -> Stop {
    match error.kind() {
        std::io::ErrorKind::BrokenPipe => Stop::BrokenPipe,
        _ => Stop::failure(format!("standard output: {error}")),
    }
}

/// Writes a text to stdout and flushes it.
///
/// # Errors
/// [`stdout_error`].
pub fn print(text: &str) -> Outcome {
    let mut out = std::io::stdout().lock();
    out.write_all(text.as_bytes()).and_then(|()| out.flush()).map_err(|error| stdout_error(&error))
}

/// Writes one JSON value and a newline to stdout.
///
/// # Errors
/// As [`print()`].
pub fn print_json(value: &serde_json::Value) -> Outcome {
    print(&format!("{value:#}\n"))
}

/// Flags that every command of every tool shares.
#[derive(Args, Clone, Copy, Debug)]
pub struct Manners {
    /// Print one JSON object on stdout instead of text.
    #[arg(long, global = true)]
    pub json: bool,
    /// Say nothing on stderr but errors.
    #[arg(short, long, global = true)]
    pub quiet: bool,
    /// Threads to use [default: one per core].
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=4096))]
    pub threads: Option<u16>,
}

impl Manners {
    /// The threads that were asked for.
    ///
    /// # Errors
    /// The system has none to give.
    pub fn pool(&self) -> Result<rayon::ThreadPool, Stop> {
        let threads = self.threads.unwrap_or(0).into();
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().map_err(Stop::failure)
    }
}

/// Makes a folder for what a tool writes, unless it is there.
///
/// # Errors
/// There is something else of that name, or the system makes none.
pub fn make_folder(folder: &Path) -> Outcome {
    std::fs::create_dir_all(folder).map_err(|error| {
        let why = if folder.exists() { "is no folder; name one".to_owned() } else { error.to_string() };
        Stop::failure(format!("{}: {why}", folder.display()))
    })
}

/// Prints the completion script of a tool.
///
/// # Errors
/// As [`print()`].
pub fn completions<Cli: clap::CommandFactory>(shell: Shell) -> Outcome {
    let mut command = Cli::command();
    let tool = command.get_name().to_owned();
    let mut script = Vec::new();
    clap_complete::generate(shell, &mut command, tool, &mut script);
    print(&String::from_utf8_lossy(&script))
}

/// Prints the manual page of a tool (roff).
///
/// # Errors
/// As [`print()`].
pub fn manual<Cli: clap::CommandFactory>() -> Outcome {
    let mut page = Vec::new();
    clap_mangen::Man::new(Cli::command()).render(&mut page).map_err(Stop::failure)?;
    print(&String::from_utf8_lossy(&page))
}

/// Runs a tool: parses the command line with clap, calls `run`, maps the outcome to the exit code.
///
/// clap's own usage errors are folded into one line and exit 2; `--help` and `--version` exit 0.
pub fn main<Cli: clap::Parser>(run: impl FnOnce(Cli) -> Outcome) -> ExitCode {
    signals::survive_file_size_limits();
    let tool = Cli::command().get_name().to_owned();
    let args = match Cli::try_parse() {
        Ok(args) => args,
        Err(error) if !error.use_stderr() => {
            return finish(&tool, print(&error.render().to_string()));
        }
        Err(error) => {
            let line = one_line(&error.render().to_string());
            let line = line.strip_prefix("error: ").unwrap_or(&line).to_owned();
            return finish(&tool, Err(Stop::BadInput(line)));
        }
    };
    finish(&tool, run(args))
}

fn finish(tool: &str, outcome: Outcome) -> ExitCode {
    let (code, why) = match outcome {
        Ok(()) | Err(Stop::BrokenPipe) => return ExitCode::SUCCESS,
        Err(Stop::Failure(why)) => (1, why),
        Err(Stop::BadInput(why)) => (2, why),
        Err(Stop::CheckFailed(why)) => (3, why),
    };
    // Nobody is left to tell when stderr is closed too.
    let _ = writeln!(std::io::stderr(), "{tool}: {}", one_line(&why));
    ExitCode::from(code)
}

/// Folds a message into one line: paragraphs after the first blank line (clap's usage hint) are dropped,
/// other line breaks become spaces, control characters are escaped.
#[must_use]
pub fn one_line(text: &str) -> String {
    let head = text.split("\n\n").next().unwrap_or_default();
    let words: Vec<&str> = head.split_whitespace().collect();
    words
        .join(" ")
        .chars()
        .flat_map(|c| if c.is_control() { c.escape_default().collect() } else { vec![c] })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_of_many_lines_becomes_one() {
        assert_eq!(one_line("error: a\n  b\n\nUsage: x"), "error: a b");
    }

    #[test]
    fn a_control_character_cannot_forge_a_second_line() {
        assert_eq!(one_line("bad \u{1b}[2J key"), "bad \\u{1b}[2J key");
    }

    #[test]
    fn a_broken_pipe_is_not_a_failure() {
        let error = std::io::Error::from(std::io::ErrorKind::BrokenPipe);
        assert!(matches!(stdout_error(&error), Stop::BrokenPipe));
    }
}
