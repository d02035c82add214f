//! Time of eval, pdf and sample on one thread.

#[path = "../../lut-io/tests/specimen/mod.rs"]
mod specimen;

use criterion::{Criterion, criterion_group, criterion_main};
use pearl_bsdf::{Controls, Direction, PearlBsdf};
use rand::{RngExt as _, SeedableRng as _};
use std::hint::black_box;

fn directions(seed: u64) -> Vec<Direction> {
    let mut random = rand::rngs::StdRng::seed_from_u64(seed);
    let mut direction = || {
        let (z, phi): (f64, f64) = (random.random(), std::f64::consts::TAU * random.random::<f64>());
        let sin = (1.0 - z * z).sqrt();
        [sin * phi.cos(), sin * phi.sin(), z]
    };
    (0..1024).map(|_| direction()).collect()
}

fn bench(criterion: &mut Criterion) {
    let incidences: Vec<f64> = (0..=90).map(f64::from).collect();
    let plain = Controls { depth: 0.0, coherence: 0.0, ..Controls::default() };
    let (wi, wo) = (directions(1), directions(2));
    let numbers = directions(3);
    let tables =
        [("decay", specimen::plane(&incidences, 128)), ("walk", specimen::space(&incidences, 64, 48))];
    for (name, table) in tables {
        let Ok(bsdf) = PearlBsdf::from_table(table, plain) else { continue };
        let mut group = criterion.benchmark_group(name);
        let mut i = 0;
        let mut next = move || {
            i = (i + 1) % 1024;
            i
        };
        group.bench_function("eval", |b| {
            b.iter(|| {
                let k = next();
                black_box(bsdf.eval(wi[k], wo[k]))
            });
        });
        group.bench_function("pdf", |b| {
            b.iter(|| {
                let k = next();
                black_box(bsdf.pdf(wi[k], wo[k]))
            });
        });
        group.bench_function("sample", |b| {
            b.iter(|| {
                let k = next();
                let [u, v, w] = numbers[k];
                black_box(bsdf.sample(wi[k], w, u.abs(), v.abs()))
            });
        });
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
