//! Reading input files, the progress bar, interruption.

use indicatif::{ProgressBar, ProgressStyle};
use std::io::Read as _;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use terminal::Stop;

/// Set by Ctrl-C.
pub(crate) static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Lets Ctrl-C and SIGTERM end the bake between two tasks instead of in the middle of a write. A scene of several tables asks
/// for it several times.
pub(crate) fn watch_for_interrupts() -> Result<(), Stop> {
    static WATCHED: AtomicBool = AtomicBool::new(false);
    if WATCHED.swap(true, Ordering::Relaxed) {
        return Ok(());
    }
    ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Relaxed)).map_err(Stop::failure)
}

/// Reads a text file of at most `most` bytes; an unreadable or oversized one is bad input.
pub(crate) fn read_text(path: &Path, most: u64) -> Result<String, Stop> {
    let named = |why: String| Stop::BadInput(format!("{}: {why}", path.display()));
    let file = std::fs::File::open(path).map_err(|error| named(error.to_string()))?;
    let mut text = String::new();
    let read = file.take(most + 1).read_to_string(&mut text).map_err(|error| named(error.to_string()))?;
    if read as u64 > most {
        return Err(named(format!("longer than {most} bytes; a recipe is shorter")));
    }
    Ok(text)
}

/// A progress bar on a terminal, nothing elsewhere. Colours follow `NO_COLOR`.
pub(crate) fn progress_bar(quiet: bool) -> ProgressBar {
    if quiet {
        return ProgressBar::hidden();
    }
    let bar = ProgressBar::new(1000);
    if let Ok(style) =
        ProgressStyle::with_template("{bar:32} {percent:>3} %  error {msg}  {elapsed} + {eta} left")
    {
        bar.set_style(style);
    }
    bar
}

/// A duration for people.
pub(crate) fn seconds_text(seconds: f64) -> String {
    match seconds {
        s if s < 1.0 => format!("{:.0} ms", 1000.0 * s),
        s if s < 120.0 => format!("{s:.1} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.1} h", s / 3600.0),
    }
}
