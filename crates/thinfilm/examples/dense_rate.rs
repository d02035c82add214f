//! Layer evaluations per second of the dense path: `cargo run --release -p thinfilm --example dense_rate [THREADS]`.
#![allow(clippy::print_stdout)]

use thinfilm::{Material, Stack, StackError, dense};

fn main() -> Result<(), StackError> {
    let wanted = std::env::args().nth(1).unwrap_or_default();
    for (name, k, sd) in [
        ("lossless regular", 0.0, 0.0),
        ("lossless irregular", 0.0, 0.03),
        ("absorbing regular", 1e-3, 0.0),
        ("absorbing irregular", 1e-3, 0.03),
    ] {
        if !name.contains(&wanted) {
            continue;
        }
        let material = |n| Material { k, ..Material::constant(n) };
        let stack = Stack::alternating(
            Material::constant(1.0),
            (material(1.53), 450e-9, 450e-9 * sd),
            (material(1.43), 25e-9, 25e-9 * sd),
            500,
            Material::constant(1.53),
        )
        .draw(1, 0)?;
        let wavelengths: Vec<f64> = (0..81).map(|i| 380e-9 + 5e-9 * f64::from(i)).collect();
        let angles: Vec<f64> = (0..90).map(|deg| f64::from(deg).to_radians()).collect();
        let evaluations = 500.0 * 81.0 * 90.0 * 2.0;
        let mut rates: Vec<f64> = Vec::new();
        let mut robust = 0;
        for _ in 0..15 {
            let start = cpu_seconds();
            robust = dense::spectra(&stack, &wavelengths, &angles)?.robust_lanes();
            rates.push(evaluations / (cpu_seconds() - start));
        }
        rates.sort_by(f64::total_cmp);
        println!(
            "{name}: median {:.3e}, best {:.3e} layer evaluations/s, {robust} robust lanes of {}",
            rates[7],
            rates[14],
            81 * 90
        );
    }
    Ok(())
}

/// Time that this process's threads have spent on a processor, from Linux's scheduler.
fn cpu_seconds() -> f64 {
    let tasks = std::fs::read_dir("/proc/self/task").into_iter().flatten().flatten();
    let of = |task: std::fs::DirEntry| std::fs::read_to_string(task.path().join("schedstat")).ok();
    let nanoseconds = |text: String| text.split_whitespace().next().and_then(|n| n.parse::<f64>().ok());
    tasks.filter_map(of).filter_map(nanoseconds).sum::<f64>() * 1e-9
}
