//! Kernels of the walk: time a crossing, by geometry, incidence, instruction set, precision and effect.
//!
//! `cargo bench -p transport --bench walk`. Compare ratios within one run, not times between runs.

use std::hint::black_box;

use criterion::{
    BenchmarkGroup, Criterion, Throughput, criterion_group, criterion_main, measurement::WallTime,
};
use transport::walk::lanes::{Precision, SimdLevel, Walker};
use transport::walk::reference::Reference;
use transport::walk::{Exit, Fate};
use transport::{Geometry, Normals, Transport};

const NOTHING: Exit = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };
const PATHS: u64 = 16_384;

fn lanes(group: &mut BenchmarkGroup<'_, WallTime>, name: &str, walker: &Walker, theta_deg: f64, paths: u64) {
    let theta = theta_deg.to_radians();
    let mut out = vec![NOTHING; paths as usize];
    let crossings = walker.run(theta, 1, 0..paths, u32::MAX, &mut out);
    group.throughput(Throughput::Elements(crossings));
    group.bench_function(name, |b| {
        b.iter(|| walker.run(theta, 1, 0..paths, u32::MAX, black_box(&mut out)));
    });
}

/// Every instruction set, precision, geometry and two incidences.
fn kernels(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("crossing");
    group.sample_size(10);
    for geometry in [Geometry::Plane, Geometry::Space] {
        for theta_deg in [30.0, 85.0] {
            for level in SimdLevel::ALL.into_iter().filter(|level| level.is_supported()) {
                for precision in [Precision::F32, Precision::F64] {
                    let walker = Walker::new(&Transport::paper(), geometry, precision, Some(level))
                        .expect("the paper's pearl can be walked");
                    let paths = if level == SimdLevel::Portable { PATHS / 16 } else { PATHS };
                    let name = format!("{geometry:?}/{theta_deg}/{level}/{precision:?}").to_lowercase();
                    lanes(&mut group, &name, &walker, theta_deg, paths);
                }
            }
        }
    }
    let transport = Transport::paper();
    let reference = Reference::new(&transport, Geometry::Space);
    group.throughput(Throughput::Elements(reference.run(0.5, 1, 256).1));
    group.bench_function("space/30/reference", |b| b.iter(|| reference.run(black_box(0.5), 1, 256)));
    group.finish();
}

/// What each effect costs, against the plain walk, and what a path costs where few events hide its start and end.
fn effects(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("effect");
    group.sample_size(10);
    type Change = fn(&mut Transport);
    let stacks: [(&str, Change); 5] = [
        ("none", |_| {}),
        ("substrate", |t| *t.indices.last_mut().expect("media") = 1.0),
        ("visible", |t| t.facets.normals = Normals::Visible),
        ("absorption", |t| t.optical_depths.fill(1e-4)),
        ("explicit", |t| t.indices[250] = 1.5),
    ];
    for (name, change) in stacks {
        let mut transport = Transport::paper();
        change(&mut transport);
        for geometry in [Geometry::Plane, Geometry::Space] {
            let walker = Walker::new(&transport, geometry, Precision::F32, None).expect("a valid stack");
            lanes(&mut group, &format!("{geometry:?}/{name}").to_lowercase(), &walker, 30.0, PATHS);
        }
    }
    let single = Transport::alternating(1, 1.53, 1.43, 1.53, 0.035);
    let walker = Walker::new(&single, Geometry::Space, Precision::F32, None).expect("a valid stack");
    lanes(&mut group, "space/one layer", &walker, 30.0, 1 << 18);
    group.finish();
}

criterion_group!(benches, kernels, effects);
criterion_main!(benches);
