//! Criterion benches of the deterministic solver: `cargo bench -p transport --bench doubling`.
//!
//! The first group is the promise (91 incidences of the paper's pearl), the second the cost against the number of
//! layers, the third one product of matrices of the same size, against which the doubling phase is judged.

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use transport::doubling::{Matrix, Settings, solve, solve_to};
use transport::{Geometry, Transport};

fn incidences() -> Vec<f64> {
    (0..=90).map(|degree| f64::from(degree).min(89.99).to_radians()).collect()
}

fn accuracy(c: &mut Criterion) {
    let mut group = c.benchmark_group("paper, 91 incidences");
    group.sample_size(10);
    let pearl = Transport::paper();
    for (name, geometry) in [("plane", Geometry::Plane), ("space", Geometry::Space)] {
        for total_variation in [1e-3, 1e-6] {
            let settings = Settings::for_accuracy(&pearl, geometry, total_variation);
            group.bench_function(format!("{name} {total_variation:e}"), |b| {
                b.iter(|| solve(black_box(&pearl), geometry, &incidences(), &settings));
            });
            group.bench_function(format!("{name} {total_variation:e} with its error estimate"), |b| {
                b.iter(|| solve_to(black_box(&pearl), geometry, &incidences(), total_variation, false));
            });
        }
    }
    group.finish();
}

fn layers(c: &mut Criterion) {
    let mut group = c.benchmark_group("layers, space, 91 incidences, 1e-3");
    group.sample_size(10);
    for layers in [1, 500, 10_000, 100_000] {
        let stack = Transport::alternating(layers, 1.53, 1.43, 1.53, 2_f64.to_radians());
        let settings = Settings::for_accuracy(&stack, Geometry::Space, 1e-3);
        group.bench_function(layers.to_string(), |b| {
            b.iter(|| solve(black_box(&stack), Geometry::Space, &incidences(), &settings));
        });
    }
    group.finish();
}

/// What 2¹⁶ layers cost over what 2⁶ cost is ten doublings: two solves and two products of n × n in each of the two
/// parities, 28/3·n³ operations each.
fn doubling_phase(c: &mut Criterion) {
    let mut group = c.benchmark_group("doubling phase");
    group.sample_size(10);
    for nodes in [96, 160, 320] {
        let settings = Settings { nodes, modes: 2, reach: 5.0, density: 0.5, both_sides: false };
        for power in [6, 16] {
            let stack = Transport::alternating(1 << power, 1.53, 1.43, 1.53, 2_f64.to_radians());
            group.bench_function(format!("plane, {nodes} nodes, 2^{power} layers"), |b| {
                b.iter(|| solve(black_box(&stack), Geometry::Plane, &[0.5], &settings));
            });
        }
        let a = Matrix::from_fn(nodes, nodes, |i, j| 1.0 / (i + j + 1) as f64);
        group.bench_function(format!("dgemm, n = {nodes}"), |b| b.iter(|| a.times(black_box(&a))));
    }
    group.finish();
}

criterion_group!(benches, accuracy, layers, doubling_phase);
criterion_main!(benches);
