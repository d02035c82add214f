//! Where light is absorbed: |E|² and absorption in a silver film under which a surface plasmon is excited (Kretschmann).
//!
//! `cargo run --release -p thinfilm --example field`
#![allow(clippy::print_stdout)]

use thinfilm::{Gain, Incidence, Material, Polarisation, Stack, StackLayer, StackRun, library};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let named = |name: &str| library::material(name).ok_or_else(|| format!("no material {name}"));
    let stack = Stack {
        ambient: named("n-bk7")?,
        materials: vec![named("silver")?],
        runs: vec![StackRun {
            unit: vec![StackLayer { material: 0, thickness: 50e-9, thickness_sd: 0.0 }],
            repeat: 1,
        }],
        substrate: Material::constant(1.0),
        gain: Gain::Refused,
    };
    let wavelength = 633e-9;
    let film = stack.at(wavelength)?;
    println!("degrees   R        absorbed in the silver   |E|^2 at its far face");
    // The resonance is a third of a degree wide.
    for tenths in (422..=440).step_by(2) {
        let degrees = f64::from(tenths) / 10.0;
        let incidence = Incidence::Angle(degrees.to_radians());
        let response = film.solve(wavelength, incidence, Polarisation::P)?;
        let field = film.field(wavelength, incidence, Polarisation::P)?;
        let absorbed: f64 = field.absorptances().iter().sum();
        let far = field.intensity(50e-9).unwrap_or(f64::NAN);
        println!("{degrees:7.1}   {:.5}  {absorbed:.5}                  {far:.3}", response.reflectance);
    }
    Ok(())
}
