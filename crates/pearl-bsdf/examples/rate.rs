//! Nanoseconds a pair on one thread, as JSON: `rate TABLE PAIRS`. Of `eval_seen_many`, `pdf_many` and `sample_seen_many`, and (`…_one_ns`)
//! of `eval_seen`, `pdf` and `sample`, a pair at a call.
//!
//! The median of 15 rounds over the same directions, in pieces of 512 where many are asked for at a call.

#![allow(clippy::print_stdout)]

use pearl_bsdf::{Direction, Evaluation, PearlBsdf, Prepared};
use rand::{RngExt as _, SeedableRng as _};
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;

const PIECE: usize = 512;
const ROUNDS: usize = 15;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let usage = "rate TABLE PAIRS";
    let mut arguments = std::env::args().skip(1);
    let table = lut_io::exr_file::read(Path::new(&arguments.next().ok_or(usage)?))?;
    let count: usize = arguments.next().ok_or(usage)?.parse()?;
    let prepared = Arc::new(Prepared::new(table)?);
    let look = prepared.look();
    let bsdf = PearlBsdf::new(prepared, look)?;
    let mut random = rand::rngs::StdRng::seed_from_u64(1);
    let mut directions = || -> Vec<Direction> {
        let mut direction = || {
            let (z, phi): (f64, f64) = (random.random(), std::f64::consts::TAU * random.random::<f64>());
            let sin = (1.0 - z * z).sqrt();
            [sin * phi.cos(), sin * phi.sin(), z]
        };
        (0..count).map(|_| direction()).collect()
    };
    let (wi, wo) = (directions(), directions());
    let numbers: Vec<[f64; 3]> =
        directions().iter().map(|[x, y, z]| [*z, 0.5 + 0.5 * x, 0.5 + 0.5 * y]).collect();
    let pieces = || wi.chunks(PIECE).zip(wo.chunks(PIECE)).zip(numbers.chunks(PIECE));
    let mut values = vec![Evaluation::default(); PIECE];
    let mut densities = vec![0.0; PIECE];
    let mut samples = vec![None; PIECE];
    let eval = median(count, || {
        pieces().for_each(|((wi, wo), _)| bsdf.eval_seen_many(wi, wo, &mut values[..wi.len()]));
    });
    let pdf = median(count, || {
        pieces().for_each(|((wi, wo), _)| bsdf.pdf_many(wi, wo, &mut densities[..wi.len()]));
    });
    let sample = median(count, || {
        pieces().for_each(|((wi, _), u)| bsdf.sample_seen_many(wi, u, &mut samples[..wi.len()]));
    });
    let pairs = || wi.iter().zip(&wo);
    let eval_one = median(count, || {
        pairs().for_each(|(wi, wo)| {
            black_box(bsdf.eval_seen(*wi, *wo));
        })
    });
    let pdf_one = median(count, || {
        pairs().for_each(|(wi, wo)| {
            black_box(bsdf.pdf(*wi, *wo));
        })
    });
    let sample_one = median(count, || {
        let draws = wi.iter().zip(&numbers);
        draws.for_each(|(wi, [u, v, w])| {
            black_box(bsdf.sample(*wi, *u, *v, *w));
        });
    });
    println!(
        "{{\"eval_ns\": {eval}, \"pdf_ns\": {pdf}, \"sample_ns\": {sample}, \
         \"eval_one_ns\": {eval_one}, \"pdf_one_ns\": {pdf_one}, \"sample_one_ns\": {sample_one}}}"
    );
    Ok(())
}

/// Nanoseconds a pair.
fn median(count: usize, mut work: impl FnMut()) -> f64 {
    work();
    let mut rounds: Vec<f64> = (0..ROUNDS)
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64() * 1e9 / count as f64
        })
        .collect();
    rounds.sort_by(f64::total_cmp);
    rounds[ROUNDS / 2]
}
