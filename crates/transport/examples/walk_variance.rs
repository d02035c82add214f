//! Does variance reduction pay? Forced entry, and a stratified first facet, against the analog walk, judged by variance × work.
//!
//! `cargo run --release -p transport --example walk_variance [PATHS]`: for each geometry and incidence of the paper's
//! pearl, the variance of the interior's cells (3° in θo, all azimuths; summed over cells) and the crossings a path,
//! for both estimators, and the ratio of their products: below 1 the estimator pays at equal time. Work is counted in
//! crossings, so that the ratio does not depend on the machine.
//!
//! A stratified first facet is judged by its bound: the share of the analog variance that the first facet explains, from
//! pairs of paths that share it and nothing else. No stratification takes away more; the work stays the same.

#![allow(clippy::print_stdout)] // Its table is what it is for.

use rand::SeedableRng;
use rand::rngs::StdRng;
use transport::walk::Fate;
use transport::walk::reference::{End, Estimator, Reference};
use transport::{Geometry, Transport};

const CELLS: usize = 60;

/// Share and summed cell variance of the interior a path, and crossings a path.
struct Measured {
    share: f64,
    share_error: f64,
    variance: f64,
    crossings: f64,
}

fn measure(geometry: Geometry, theta_i: f64, estimator: Estimator, paths: u64) -> Measured {
    let pearl = Transport::paper();
    let walk = Reference { estimator, ..Reference::new(&pearl, geometry) };
    let mut random = StdRng::seed_from_u64(20_261_125);
    let (mut sums, mut squares) = (vec![0.0; CELLS], vec![0.0; CELLS]);
    let mut crossings = 0;
    for _ in 0..paths {
        let end = walk.path(theta_i, &mut random);
        crossings += u64::from(end.crossings);
        if let Some(cell) = cell_of(geometry, &end) {
            sums[cell] += end.weight;
            squares[cell] += end.weight * end.weight;
        }
    }
    let n = paths as f64;
    let variance = |sum: f64, square: f64| square / n - (sum / n).powi(2);
    let (share, square): (f64, f64) = (sums.iter().sum::<f64>() / n, squares.iter().sum());
    Measured {
        share,
        share_error: (variance(share * n, square) / n).sqrt(),
        variance: sums.iter().zip(&squares).map(|(sum, square)| variance(*sum, *square)).sum(),
        crossings: crossings as f64 / n,
    }
}

/// Share of the interior's summed cell variance that the first facet explains, and its standard error, from pairs that
/// share it. A cell's covariance comes from the products of a pair; the expectation, from all paths.
fn explained_by_first_facet(geometry: Geometry, theta_i: f64, pairs: u64) -> (f64, f64) {
    let pearl = Transport::paper();
    let walk = Reference::new(&pearl, geometry);
    let mut random = StdRng::seed_from_u64(20_261_126);
    let (mut counts, mut together) = (vec![0.0_f64; CELLS], 0.0_f64);
    for _ in 0..pairs {
        let [a, b] = walk.twins(theta_i, &mut random).map(|end| cell_of(geometry, &end));
        a.into_iter().chain(b).for_each(|cell| counts[cell] += 1.0);
        together += f64::from(u8::from(a.is_some() && a == b));
    }
    let n = pairs as f64;
    let shares = counts.iter().map(|count| count / (2.0 * n));
    let (sum, squares) = shares.fold((0.0_f64, 0.0_f64), |(sum, squares), p| (sum + p, squares + p * p));
    let variance = sum - squares;
    ((together / n - squares) / variance, (together / n * (1.0 - together / n) / n).sqrt() / variance)
}

/// The cell of a path that ended in the interior's lobe.
fn cell_of(geometry: Geometry, end: &End) -> Option<usize> {
    let [x, y, z] = end.direction;
    let angle = if geometry == Geometry::Plane { x.atan2(z) } else { x.hypot(y).atan2(z) };
    let cell = ((0.5 + angle / std::f64::consts::PI) * CELLS as f64) as usize;
    (end.fate == Fate::Interior).then_some(cell.min(CELLS - 1))
}

fn main() {
    let paths = std::env::args().nth(1).and_then(|text| text.parse::<f64>().ok()).unwrap_or(2e5) as u64;
    println!("geometry  incidence  estimator     interior             variance  crossings  variance x work");
    for geometry in [Geometry::Plane, Geometry::Space] {
        for degrees in [0.0, 30.0, 60.0, 85.0] {
            let theta_i = f64::to_radians(degrees);
            let analog = measure(geometry, theta_i, Estimator::Analog, paths);
            let forced = measure(geometry, theta_i, Estimator::ForcedEntry, paths);
            for (name, m) in [("analog", &analog), ("forced entry", &forced)] {
                let ratio = m.variance * m.crossings / (analog.variance * analog.crossings);
                println!(
                    "{:<9} {degrees:>8}°  {name:<12}  {:.5} ± {:.5}  {:>9.4}  {:>9.1}  {ratio:>15.3}",
                    format!("{geometry:?}"),
                    m.share,
                    m.share_error,
                    m.variance,
                    m.crossings
                );
            }
            let (share, error) = explained_by_first_facet(geometry, theta_i, paths);
            println!(
                "{:<9} {degrees:>8}°  a stratified first facet takes away at most {:.2} ± {:.2} % of the variance",
                format!("{geometry:?}"),
                100.0 * share,
                100.0 * error
            );
        }
    }
}
