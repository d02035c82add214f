//! Layer evaluations per second (layers × wavelengths × angles × polarisations) of the dense path, of the robust form and of a
//! plain scalar loop, for 500 layers, 81 wavelengths and 90 angles:
//! `cargo run --release -p thinfilm --example dense_rate [-- THREADS [ROUNDS]]`.
//!
//! Prints one JSON object: by the clock (fastest and median round) and, on Linux, per second that its threads spent on
//! a processor, which a busy machine disturbs less. `tools/peers/thinfilm.py` runs it beside other programs.
#![allow(clippy::print_stdout)]

use num_complex::Complex64;
use serde_json::json;
use std::time::Instant;
use thinfilm::{Incidence, Material, Polarisation, Stack, StackError, dense, ensemble};

const LAYERS: u64 = 500;

fn pearl(k: f64, sd: f64) -> Result<Stack, StackError> {
    let material = |n| Material { k, ..Material::constant(n) };
    Stack::alternating(
        Material::constant(1.0),
        (material(1.53), 450e-9, 450e-9 * sd),
        (material(1.43), 25e-9, 25e-9 * sd),
        LAYERS,
        Material::constant(1.53),
    )
    .draw(1, 0)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let threads: usize = arguments.next().map_or(Ok(1), |text| text.parse())?;
    let rounds: usize = arguments.next().map_or(Ok(15), |text| text.parse())?;
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    let report = pool.install(|| measure(threads, rounds.max(1)))?;
    println!("{report:#}");
    Ok(())
}

fn measure(threads: usize, rounds: usize) -> Result<serde_json::Value, StackError> {
    let wavelengths: Vec<f64> = (0..81).map(|i| 380e-9 + 5e-9 * f64::from(i)).collect();
    let angles: Vec<f64> = (0..90).map(|deg| f64::from(deg).to_radians()).collect();
    let pairs = wavelengths.len() * angles.len();
    let mut rates = serde_json::Map::new();
    for (name, k, sd) in [
        ("lossless regular", 0.0, 0.0),
        ("lossless irregular", 0.0, 0.03),
        ("absorbing regular", 1e-3, 0.0),
        ("absorbing irregular", 1e-3, 0.03),
    ] {
        let stack = pearl(k, sd)?;
        let mut robust = 0;
        let seconds = timed(rounds, || {
            robust = dense::spectra(&stack, &wavelengths, &angles)?.robust_lanes();
            Ok(())
        })?;
        let mut rate = rate(LAYERS as usize * pairs * 2, &seconds);
        rate["robust_lanes"] = json!(robust);
        rate["lanes"] = json!(pairs);
        rates.insert(name.to_owned(), rate);
    }
    // A tenth of the waves is enough for the slow ones.
    let stack = pearl(0.0, 0.03)?;
    let (few, some) = (&wavelengths[..9], &angles[..81]);
    let evaluations = LAYERS as usize * few.len() * some.len() * 2;
    let films = few.iter().map(|w| stack.at(*w)).collect::<Result<Vec<_>, _>>()?;
    let each = |of: &dyn Fn(usize, f64, Polarisation) -> Result<f64, StackError>| -> Result<(), StackError> {
        let mut sum = 0.0;
        for theta in some {
            for at in 0..few.len() {
                for pol in Polarisation::BOTH {
                    sum += of(at, *theta, pol)?;
                }
            }
        }
        std::hint::black_box(sum);
        Ok(())
    };
    let seconds = timed(rounds.min(3), || {
        each(&|at, theta, pol| Ok(films[at].solve(few[at], Incidence::Angle(theta), pol)?.reflectance))
    })?;
    rates.insert("robust form, one thread".to_owned(), rate(evaluations, &seconds));
    let seconds =
        timed(rounds.min(3), || each(&|at, theta, pol| Ok(scalar(&films[at], few[at], theta, pol))))?;
    rates.insert("scalar loop, one thread".to_owned(), rate(evaluations, &seconds));
    Ok(json!({
        "threads": threads, "layers": LAYERS, "wavelengths": wavelengths.len(), "angles": angles.len(),
        "rates": rates, "ensemble_seconds": ensemble_seconds()?, "samples": samples()?,
    }))
}

/// 90 angles × 801 wavelengths × s, p × 500 layers × 64 irregular stacks.
fn ensemble_seconds() -> Result<f64, StackError> {
    let material = Material::constant;
    let stack = Stack::alternating(
        material(1.0),
        (material(1.53), 450e-9, 13.5e-9),
        (material(1.43), 25e-9, 0.75e-9),
        LAYERS,
        material(1.53),
    );
    let wavelengths: Vec<f64> = (0..801).map(|i| 380e-9 + 0.5e-9 * f64::from(i)).collect();
    let angles: Vec<f64> = (0..90).map(|deg| f64::from(deg).to_radians()).collect();
    let start = Instant::now();
    std::hint::black_box(ensemble::mean(&stack, 1, 64, &wavelengths, &angles)?);
    Ok(start.elapsed().as_secs_f64())
}

/// R of the regular pearl at a few waves, for the peers to agree with: `[nm, degrees, R_s, R_p]`.
fn samples() -> Result<Vec<[f64; 4]>, StackError> {
    let stack = pearl(0.0, 0.0)?;
    let mut samples = Vec::new();
    for nm in [420.0, 550.0, 655.0] {
        for degrees in [0.0f64, 31.0, 64.0] {
            let spectra = dense::spectra(&stack, &[nm * 1e-9], &[degrees.to_radians()])?;
            let [s, p] = Polarisation::BOTH.map(|pol| spectra.reflectance(0, pol)[0]);
            samples.push([nm, degrees, s, p]);
        }
    }
    Ok(samples)
}

/// Seconds of each round, by the clock and on processors, ascending.
struct Seconds {
    clock: Vec<f64>,
    processor: Vec<f64>,
}

fn timed(rounds: usize, mut job: impl FnMut() -> Result<(), StackError>) -> Result<Seconds, StackError> {
    let mut seconds = Seconds { clock: Vec::with_capacity(rounds), processor: Vec::with_capacity(rounds) };
    for _ in 0..rounds {
        let (clock, processor) = (Instant::now(), processor_seconds());
        job()?;
        seconds.clock.push(clock.elapsed().as_secs_f64());
        seconds.processor.push(processor_seconds() - processor);
    }
    seconds.clock.sort_by(f64::total_cmp);
    seconds.processor.sort_by(f64::total_cmp);
    Ok(seconds)
}

fn rate(evaluations: usize, seconds: &Seconds) -> serde_json::Value {
    let of = |seconds: &[f64], at: usize| (seconds[at] > 0.0).then(|| evaluations as f64 / seconds[at]);
    json!({
        "best": of(&seconds.clock, 0),
        "median": of(&seconds.clock, seconds.clock.len() / 2),
        "median_per_processor_second": of(&seconds.processor, seconds.processor.len() / 2),
    })
}

/// Time that this process's threads have spent on a processor, from Linux's scheduler; 0 elsewhere.
fn processor_seconds() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let of = |task: std::fs::DirEntry| std::fs::read_to_string(task.path().join("schedstat")).ok();
    let nanoseconds = |text: String| text.split_whitespace().next().and_then(|n| n.parse::<f64>().ok());
    tasks.filter_map(of).filter_map(nanoseconds).sum::<f64>() * 1e-9
}

/// What one writes first: the admittance recursion, one wave at a time, nothing scaled.
fn scalar(film: &thinfilm::Multilayer, wavelength: f64, theta: f64, pol: Polarisation) -> f64 {
    let kx = film.ambient * theta.sin();
    let admittance = |n: Complex64| {
        let kz = (n * n - kx * kx).sqrt();
        match pol {
            Polarisation::S => (kz, kz),
            Polarisation::P => (kz, kz / (n * n)),
        }
    };
    let (mut b, mut c) = (Complex64::new(1.0, 0.0), admittance(film.substrate).1);
    for layer in film.layers().collect::<Vec<_>>().into_iter().rev() {
        let (kz, q) = admittance(layer.index);
        let delta = kz * (std::f64::consts::TAU / wavelength * layer.thickness);
        let (sin, cos) = (delta.sin() * Complex64::i(), delta.cos());
        (b, c) = (cos * b - sin / q * c, cos * c - sin * q * b);
    }
    let q = admittance(film.ambient).1;
    ((q * b - c) / (q * b + c)).norm_sqr()
}
