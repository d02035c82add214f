#![doc = include_str!("../README.md")]
//!
//! # Modules
//!
//! - here: [`Settings`] and [`Start`] say what is served, [`Server`] serves it until it is told to stop;
//! - [`page`]: the page as one file, [`page::alone`].
//!
//! The crate has no features to choose.
//!
//! # Errors
//!
//! A [`StudioError`] is one line: a port that is taken, a recipe that cannot be baked, a table that makes no BSDF. What goes wrong while
//! a browser asks is answered to the browser, and the server goes on.

mod api;
mod bakery;
mod errors;
mod guard;
pub mod page;
mod server;

use bake_brdf::bake::BakeError;
use bake_brdf::recipe::Recipe;
use lut_io::table::Table;
use std::fmt;

pub use server::Server;

/// What the simulator opens with.
#[derive(Debug)]
#[allow(clippy::large_enum_variant)] // there is one
pub enum Start {
    /// A recipe, to be baked.
    Recipe(Recipe),
    /// A table; its recipe is the one in it.
    Table(Table),
}

/// How the simulator is served.
pub struct Settings {
    /// What it opens with.
    pub start: Start,
    /// The port; `None`: any that is free.
    pub port: Option<u16>,
    /// Threads that bake; `None`: all.
    pub threads: Option<rayon::ThreadPool>,
}

impl Settings {
    /// Any port, all threads.
    #[must_use]
    pub fn new(start: Start) -> Self {
        Self { start, port: None, threads: None }
    }
}

impl fmt::Debug for Settings {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Settings")
            .field("start", &self.start)
            .field("port", &self.port)
            .finish_non_exhaustive()
    }
}

/// Why there is no simulator; one line.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum StudioError {
    /// The port is taken, or the system lets none be had.
    #[error("port {port}: {source}")]
    Port {
        /// The port that was asked for, 0 for any.
        port: u16,
        /// What the system says.
        source: std::io::Error,
    },
    /// The system fails.
    #[error("{0}")]
    System(#[from] std::io::Error),
    /// The system has no random numbers.
    #[error("no random numbers for a token: {0}")]
    Random(getrandom::Error),
    /// The recipe or the table.
    #[error("{0}")]
    Bake(#[from] BakeError),
    /// A table that makes no BSDF.
    #[error("{0}")]
    Bsdf(#[from] pearl_bsdf::BsdfError),
    /// More than an archive holds.
    #[error("arrays: {0}")]
    Arrays(String),
    /// This build has no page.
    #[error("this build has no page (crates/studio/page)")]
    NoPage,
}
