//! What doubling takes against what `Settings::cost` predicts: the measurements behind the constants of that prediction.
//!
//! `cargo run --release -p transport --example doubling_cost` solves a list of problems on one thread (half a minute on an
//! idle AVX-512 core) and prints a line for each: prediction, best of three, ratio.

#![allow(clippy::print_stdout)] // Its table is what it is for.

use std::error::Error;
use std::time::Instant;

use transport::doubling::{Settings, solve};
use transport::{Geometry, Transport};

fn main() -> Result<(), Box<dyn Error>> {
    rayon::ThreadPoolBuilder::new().num_threads(1).build_global()?;
    println!("geometry  layers  sigma  incidences  asked     nodes  modes  predicted s  measured s  ratio");
    for geometry in [Geometry::Plane, Geometry::Space] {
        for (layers, sigma_deg, incidences, asked) in [
            (500, 2.0, 91, 0.05),
            (500, 2.0, 91, 1e-2),
            (500, 2.0, 91, 1e-3),
            (500, 2.0, 1, 1e-3),
            (500, 2.0, 91, 1e-4),
            (500, 1.0, 3, 1e-2),
            (500, 5.0, 91, 1e-3),
            (500, 5.0, 3, 1e-6),
            (500, 15.0, 91, 1e-3),
            (3, 2.0, 91, 1e-3),
            (3, 2.0, 1, 1e-2),
            (100_000, 2.0, 10, 1e-3),
        ] {
            let stack = Transport::alternating(layers, 1.53, 1.43, 1.53, f64::to_radians(sigma_deg));
            let settings = Settings::for_accuracy(&stack, geometry, asked);
            let theta_i: Vec<f64> =
                (0..incidences).map(|k| f64::from(k) * 1.55 / f64::from(incidences)).collect();
            let predicted = settings.cost(&stack, geometry, theta_i.len()).seconds;
            let mut measured = f64::INFINITY;
            for _ in 0..3 {
                let started = Instant::now();
                solve(&stack, geometry, &theta_i, &settings)?;
                measured = measured.min(started.elapsed().as_secs_f64());
            }
            println!(
                "{:<9} {layers:>6}  {sigma_deg:>5}  {incidences:>10}  {asked:>7.0e}  {:>6}  {:>5}  {predicted:>11.3}  \
                 {measured:>10.3}  {:>5.2}",
                format!("{geometry:?}"),
                settings.nodes,
                settings.modes,
                predicted / measured
            );
        }
    }
    Ok(())
}
