//! Time of a change of controls, and of eval, pdf and sample on one thread: a pair at a call, and 1024 pairs at a call (the rate is per pair).

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use pearl_bsdf::{Controls, Direction, Evaluation, PearlBsdf, Prepared};
use rand::{RngExt as _, SeedableRng as _};
use std::hint::black_box;
use std::sync::Arc;

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
    let numbers: Vec<[f64; 3]> = directions(3).iter().map(|[u, v, w]| [*w, u.abs(), v.abs()]).collect();
    let tables =
        [("decay", specimen::plane(&incidences, 128)), ("space", specimen::space(&incidences, 64, 48))];
    for (name, table) in tables {
        let prepared = Arc::new(Prepared::new(table).expect("the made-up table is one"));
        let look = || PearlBsdf::new(Arc::clone(&prepared), plain).expect("there are no colours to ask for");
        let bsdf = look();
        let mut group = criterion.benchmark_group(name);
        group.bench_function("controls", |b| b.iter(|| black_box(look())));
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
                black_box(bsdf.sample(wi[k], u, v, w))
            });
        });
        group.throughput(Throughput::Elements(wi.len() as u64));
        group.bench_function("eval_many", |b| {
            let mut values = vec![Evaluation::default(); wi.len()];
            b.iter(|| bsdf.eval_many(&wi, &wo, black_box(&mut values)));
        });
        group.bench_function("pdf_many", |b| {
            let mut densities = vec![0.0; wi.len()];
            b.iter(|| bsdf.pdf_many(&wi, &wo, black_box(&mut densities)));
        });
        group.bench_function("sample_many", |b| {
            let mut samples = vec![None; wi.len()];
            b.iter(|| bsdf.sample_many(&wi, &numbers, black_box(&mut samples)));
        });
    }
}

criterion_group!(benches, bench);
criterion_main!(benches);
