//! What 32 bits do to the walk: the same paths, with the same random numbers, walked in f32 and in f64.
//!
//! `cargo run --release -p transport --example walk_precision [PATHS]` prints a line for each geometry and incidence:
//! the share of paths that end otherwise, and the difference of the albedos with its standard error, which is that of
//! the differing paths alone.

#![allow(clippy::print_stdout)] // Its line of output is what it is for.

use std::error::Error;

use rayon::prelude::*;
use transport::walk::lanes::{Precision, Walker};
use transport::walk::{Exit, Fate};
use transport::{Geometry, Transport};

const CHUNK: u64 = 1 << 16;
const NOTHING: Exit = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };

fn is_reflected(exit: &Exit) -> bool {
    matches!(exit.fate, Fate::Single | Fate::Rehit | Fate::Interior)
}

/// (up, down): paths that only f32 sends out of the top, and that only f64 does.
fn disagreements(walkers: &[Walker; 2], theta: f64, first: u64) -> (u64, u64) {
    let [narrow, wide] = walkers.each_ref().map(|walker| {
        let mut out = vec![NOTHING; CHUNK as usize];
        walker.run(theta, 1, first..first + CHUNK, u32::MAX, &mut out);
        out
    });
    let count = |up: bool| {
        let differs = |(a, b): &(&Exit, &Exit)| is_reflected(a) == up && is_reflected(b) != up;
        narrow.iter().zip(&wide).filter(differs).count() as u64
    };
    (count(true), count(false))
}

fn main() -> Result<(), Box<dyn Error>> {
    let paths: f64 = std::env::args().nth(1).map_or(Ok(1e7), |text| text.parse())?;
    let chunks = (paths / CHUNK as f64).ceil() as u64;
    for geometry in [Geometry::Plane, Geometry::Space] {
        let new = |precision| Walker::new(&Transport::paper(), geometry, precision, None);
        let walkers = [new(Precision::F32)?, new(Precision::F64)?];
        for theta_deg in [30.0_f64, 85.0] {
            let (up, down) = (0..chunks)
                .into_par_iter()
                .map(|chunk| disagreements(&walkers, theta_deg.to_radians(), chunk * CHUNK))
                .reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
            let total = (chunks * CHUNK) as f64;
            println!(
                "{geometry:?} {theta_deg:>2} degrees: {total:.3e} paths, {:.2e} differ in fate, \
                 albedo f32 - f64 = {:+.2e} ± {:.1e}",
                (up + down) as f64 / total,
                (up as f64 - down as f64) / total,
                ((up + down) as f64).sqrt() / total,
            );
        }
    }
    Ok(())
}
