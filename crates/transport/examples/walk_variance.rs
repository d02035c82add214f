//! Does variance reduction pay? Forced entry against the analog walk, judged by variance × work.
//!
//! `cargo run --release -p transport --example walk_variance [PATHS]`: for each geometry and incidence of the paper's
//! pearl, the variance of the interior's cells (3° in θo, all azimuths; summed over cells) and the crossings a path,
//! for both estimators, and the ratio of their products: below 1 the estimator pays at equal time. Work is counted in
//! crossings, so that the ratio does not depend on the machine.

#![allow(clippy::print_stdout)] // Its table is what it is for.

use rand::SeedableRng;
use rand::rngs::StdRng;
use transport::walk::Fate;
use transport::walk::reference::{Estimator, Reference};
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
        if end.fate == Fate::Interior {
            let [x, y, z] = end.direction;
            let angle = if geometry == Geometry::Plane { x.atan2(z) } else { x.hypot(y).atan2(z) };
            let cell = ((0.5 + angle / std::f64::consts::PI) * CELLS as f64) as usize;
            sums[cell.min(CELLS - 1)] += end.weight;
            squares[cell.min(CELLS - 1)] += end.weight * end.weight;
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
        }
    }
}
