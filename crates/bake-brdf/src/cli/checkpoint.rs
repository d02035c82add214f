//! The checkpoint beside the output of a walk.

use super::say;
use bake_brdf::bake::snapshot::{Snapshot, SnapshotError};
use bake_brdf::bake::{BakeError, Request, Shard, State};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;
use terminal::{Manners, Stop};

/// When checkpoints are written, and whether one is read.
#[derive(Clone, Copy)]
pub(super) struct Checkpoints {
    pub(super) from_the_start: bool,
    /// Least time between two.
    pub(super) every: Duration,
    pub(super) resume: bool,
}

impl Checkpoints {
    /// Least time between two checkpoints unless another is given, seconds.
    pub(super) const EVERY_SECONDS: f64 = 1.0;
}

impl Default for Checkpoints {
    fn default() -> Self {
        let every = Duration::from_secs_f64(Self::EVERY_SECONDS);
        Self { from_the_start: false, every, resume: false }
    }
}

/// The checkpoint beside an output.
pub(super) struct Keeper<'a> {
    path: PathBuf,
    request: &'a Request,
    checkpoints: Checkpoints,
    /// Set from the start by `--checkpoint`, or by [`Self::expect`].
    on: AtomicBool,
    failed: AtomicBool,
}

impl<'a> Keeper<'a> {
    pub(super) fn new(output: &Path, checkpoints: Checkpoints, request: &'a Request) -> Self {
        let mut path = output.as_os_str().to_owned();
        path.push(".checkpoint");
        Self {
            path: path.into(),
            request,
            checkpoints,
            on: AtomicBool::new(checkpoints.from_the_start),
            failed: AtomicBool::new(false),
        }
    }

    /// Least time between two checkpoints.
    pub(super) const fn every(&self) -> Duration {
        self.checkpoints.every
    }

    /// A bake that is expected to take longer than a minute is worth keeping.
    pub(super) fn expect(&self, seconds: f64) {
        if seconds > 60.0 {
            self.on.store(true, Ordering::Relaxed);
        }
    }

    /// The state to go on from, if there is one and it is wanted.
    pub(super) fn load(&self, manners: &Manners) -> Result<Option<Snapshot>, Stop> {
        if !self.checkpoints.resume {
            return Ok(None);
        }
        self.on.store(true, Ordering::Relaxed);
        if !self.path.exists() {
            if !manners.quiet {
                say(&format!("{}: no checkpoint; starting afresh", self.path.display()));
            }
            return Ok(None);
        }
        let named = |why: SnapshotError| Stop::BadInput(format!("{}: {why}", self.path.display()));
        let snapshot = Snapshot::read(&self.path).map_err(named)?;
        let here = Snapshot::new(self.request, Shard::WHOLE, snapshot.state.clone());
        here.same_bake(&snapshot).map_err(named)?;
        Ok(Some(snapshot))
    }

    pub(super) fn keep(&self, state: &State) {
        if !self.on.load(Ordering::Relaxed) {
            return;
        }
        let snapshot = Snapshot::new(self.request, Shard::WHOLE, state.clone());
        // A full disk need not end a bake that is still going well: said once, tried again next time.
        if let Err(why) = snapshot.write(&self.path)
            && !self.failed.swap(true, Ordering::Relaxed)
        {
            say(&format!("{}: no checkpoint kept: {why}", self.path.display()));
        }
    }

    /// What an interrupted bake has to say.
    pub(super) fn interrupted(&self) -> Stop {
        let path = self.path.display();
        if self.on.load(Ordering::Relaxed) && self.path.exists() {
            return Stop::failure(format!("interrupted; {path} keeps the work: go on with --resume"));
        }
        Stop::failure(BakeError::Interrupted)
    }

    pub(super) fn remove(&self) {
        if self.on.load(Ordering::Relaxed) {
            // It may never have been written.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}
