//! Speed of the walk, one JSON line: ns of CPU a crossing, and the moments that show it walks rightly.
//!
//! `cargo run --release -p transport --example walk_rate -- --theta 30 --dim 3 --paths 4e5`; the options are those of the
//! scripts in `tools/peers`, and `--walk lanes|reference`, `--level portable|avx2|avx512`, `--precision f32|f64`.
//! CPU time is that of `/proc` (Linux); elsewhere wall time stands in for it.

#![allow(clippy::print_stdout)] // Its line of output is what it is for.

use std::error::Error;

use rayon::prelude::*;
use transport::walk::lanes::{Precision, SimdLevel, Walker};
use transport::walk::reference::Reference;
use transport::walk::{Exit, Fate};
use transport::{Geometry, Transport};

/// Paths a call: long enough that lanes running empty at its end cost little.
const CHUNK: u64 = 1 << 16;

struct Options {
    paths: u64,
    theta_deg: f64,
    sigma_deg: f64,
    dim: u32,
    seed: u64,
    layers: usize,
    threads: usize,
    level: Option<SimdLevel>,
    precision: Precision,
    reference: bool,
}

fn options() -> Result<Options, Box<dyn Error>> {
    let mut options = Options {
        paths: 400_000,
        theta_deg: 30.0,
        sigma_deg: 2.0,
        dim: 3,
        seed: 1,
        layers: 500,
        threads: 1,
        level: None,
        precision: Precision::Auto,
        reference: false,
    };
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or(format!("{name} needs a value"))?;
        match name.as_str() {
            "--paths" => options.paths = value.parse::<f64>()? as u64,
            "--theta" => options.theta_deg = value.parse()?,
            "--sigma-deg" => options.sigma_deg = value.parse()?,
            "--dim" => options.dim = value.parse()?,
            "--seed" => options.seed = value.parse()?,
            "--layers" => options.layers = value.parse()?,
            "--threads" => options.threads = value.parse()?,
            "--walk" => options.reference = value == "reference",
            "--level" => {
                options.level =
                    Some(SimdLevel::ALL.into_iter().find(|l| l.to_string() == value).ok_or("no such level")?);
            }
            "--precision" => {
                options.precision = match value.as_str() {
                    "f32" => Precision::F32,
                    "f64" => Precision::F64,
                    _ => Precision::Auto,
                };
            }
            _ => return Err(format!("unknown option {name}").into()),
        }
    }
    Ok(options)
}

/// CPU seconds of all threads of this process so far, where the system tells.
fn cpu_seconds() -> Option<f64> {
    let mut nanoseconds = 0.0;
    for task in std::fs::read_dir("/proc/self/task").ok()?.flatten() {
        let text = std::fs::read_to_string(task.path().join("schedstat")).ok()?;
        nanoseconds += text.split(' ').next()?.parse::<f64>().ok()?;
    }
    Some(nanoseconds * 1e-9)
}

fn main() -> Result<(), Box<dyn Error>> {
    let o = options()?;
    rayon::ThreadPoolBuilder::new().num_threads(o.threads).build_global()?;
    let transport = Transport::alternating(o.layers, 1.53, 1.43, 1.53, o.sigma_deg.to_radians());
    let geometry = if o.dim == 2 { Geometry::Plane } else { Geometry::Space };
    let walker = Walker::new(&transport, geometry, o.precision, o.level)?;
    let theta = o.theta_deg.to_radians();
    let nothing = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };
    let mut exits = vec![nothing; o.paths as usize];
    let (cpu, wall) = (cpu_seconds(), std::time::Instant::now());
    let crossings: u64 = exits
        .par_chunks_mut(CHUNK as usize)
        .enumerate()
        .map(|(chunk, out)| {
            let first = chunk as u64 * CHUNK;
            if o.reference {
                let (ends, crossings) =
                    Reference::new(&transport, geometry).run(theta, o.seed + first, out.len() as u64);
                out.copy_from_slice(&ends);
                return crossings;
            }
            walker.run(theta, o.seed, first..first + out.len() as u64, u32::MAX, out)
        })
        .sum();
    let wall = wall.elapsed().as_secs_f64();
    let cpu = cpu_seconds().zip(cpu).map_or(wall, |(after, before)| after - before);
    let angles: Vec<f64> = exits
        .iter()
        .filter(|exit| matches!(exit.fate, Fate::Single | Fate::Rehit | Fate::Interior))
        .map(|exit| {
            let [x, y, z] = exit.direction.map(f64::from);
            if o.dim == 2 { x.atan2(z) } else { x.hypot(y).atan2(z) }.to_degrees()
        })
        .collect();
    let count = angles.len() as f64;
    let mean = angles.iter().sum::<f64>() / count;
    let sd = (angles.iter().map(|a| (a - mean).powi(2)).sum::<f64>() / count).sqrt();
    let name = if o.reference {
        "scalar_f64".to_string()
    } else {
        format!("nacre_{}_{:?}", walker.level(), walker.precision()).to_lowercase()
    };
    println!(
        "{}",
        serde_json::json!({
            "impl": name,
            "paths": o.paths, "crossings": crossings, "wall_s": wall, "cpu_s": cpu, "threads": o.threads,
            "albedo": count / o.paths as f64, "mean_theta": mean, "sd_theta": sd,
            "ns_per_crossing_cpu": cpu / crossings as f64 * 1e9,
        })
    );
    Ok(())
}
