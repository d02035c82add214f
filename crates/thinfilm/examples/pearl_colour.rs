//! Colour of 100 layers of nacre against the angle: a regular stack, and the mean of irregular ones with its error.
//!
//! `cargo run --release -p thinfilm --example pearl_colour`
#![allow(clippy::print_stdout)]

use thinfilm::{Material, Stack, StackError, colour};

fn main() -> Result<(), StackError> {
    let pearl = |spread: f64| {
        Stack::alternating(
            Material::constant(1.0),
            (Material::constant(1.53), 450e-9, 450e-9 * spread),
            (Material::constant(1.43), 25e-9, 25e-9 * spread),
            100,
            Material::constant(1.53),
        )
    };
    let degrees = [0.0, 20.0, 40.0, 60.0];
    let angles = degrees.map(f64::to_radians);
    for spread in [0.0, 0.03] {
        println!("thicknesses irregular by {:.0} %", 100.0 * spread);
        for (degrees, c) in degrees.iter().zip(colour::of_stack(&pearl(spread), 1, 16, &angles, 0.3)?) {
            let [l, a, b] = c.lab;
            println!(
                "  {degrees:2.0} deg: L* {l:5.1}  a* {a:6.1}  b* {b:6.1}, +- {:.2} (dE00), {} wavelengths",
                c.ensemble_error.unwrap_or(f64::NAN),
                c.wavelengths
            );
        }
    }
    Ok(())
}
