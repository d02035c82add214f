//! The progress bar, and what is said meanwhile.

use super::checkpoint::Keeper;
use super::errors::refuse;
use super::say;
use bake_brdf::bake::{BakeError, Checkpoint, Observer, Progress, State};
use indicatif::{ProgressBar, ProgressStyle};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;
use terminal::{Manners, Stop};

/// A progress bar on a terminal, nothing elsewhere. Colours follow `NO_COLOR`.
fn progress_bar(quiet: bool) -> ProgressBar {
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

/// Runs a bake with a progress bar, a forecast and, where there is a keeper, checkpoints.
pub(super) fn watched<T>(
    manners: &Manners,
    keeper: Option<&Keeper<'_>>,
    work: impl FnOnce(&Observer<'_>) -> Result<T, BakeError>,
) -> Result<T, Stop> {
    let bar = progress_bar(manners.quiet);
    let said = AtomicU64::new(0);
    let started = Instant::now();
    let progress = |progress: &Progress<'_>| {
        let done = progress.crossings() as f64 / progress.expected_crossings.max(1.0);
        bar.set_position((1000.0 * done) as u64);
        // The error sums over all cells of all incidences: four times a second is enough.
        let tick = started.elapsed().as_millis() as u64 / 250;
        if !bar.is_hidden() && said.fetch_max(tick, Ordering::Relaxed) < tick {
            bar.set_message(format!("{:.2} %", progress.error_percent()));
        }
    };
    let forecast = |seconds: f64| {
        if let Some(keeper) = keeper {
            keeper.expect(seconds);
        }
        if !manners.quiet {
            bar.suspend(|| say(&format!("expected to take {}", seconds_text(seconds))));
            bar.reset();
        }
    };
    let keep = |state: &State| {
        if let Some(keeper) = keeper {
            keeper.keep(state);
        }
    };
    let checkpoint = keeper.map(|keeper| Checkpoint { every: keeper.every(), keep: &keep });
    let observer =
        Observer { stop: terminal::interruption()?, progress: &progress, forecast: &forecast, checkpoint };
    let result = work(&observer).map_err(|why| match (&why, keeper) {
        (BakeError::Interrupted, Some(keeper)) => keeper.interrupted(),
        _ => refuse(why),
    });
    bar.finish_and_clear();
    result
}
