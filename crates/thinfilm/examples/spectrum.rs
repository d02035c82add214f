//! An antireflection coating: R of a quarter wave of magnesium fluoride on glass, bare and coated.
//!
//! `cargo run --release -p thinfilm --example spectrum`
#![allow(clippy::print_stdout)]

use thinfilm::{Gain, Incidence, Material, Polarisation, Stack, StackLayer, StackRun, library};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let named = |name: &str| library::material(name).ok_or_else(|| format!("no material {name}"));
    let coated = |thickness: f64| -> Result<Stack, String> {
        Ok(Stack {
            ambient: Material::constant(1.0),
            materials: vec![named("magnesium-fluoride-o")?],
            runs: vec![StackRun {
                unit: vec![StackLayer { material: 0, thickness, thickness_sd: 0.0 }],
                repeat: 1,
            }],
            substrate: named("n-bk7")?,
            gain: Gain::Refused,
        })
    };
    // A quarter wave at 550 nm, n = 1.379.
    let (bare, coated) = (coated(0.0)?, coated(550e-9 / 4.0 / 1.379)?);
    println!("nm    R bare    R coated");
    for nm in (400..=700).step_by(50) {
        let wavelength = f64::from(nm) * 1e-9;
        let r = |stack: &Stack| -> Result<f64, Box<dyn std::error::Error>> {
            let film = stack.at(wavelength)?;
            Ok(film.solve(wavelength, Incidence::Angle(0.0), Polarisation::S)?.reflectance)
        };
        println!("{nm}   {:.5}   {:.5}", r(&bare)?, r(&coated)?);
    }
    Ok(())
}
