//! The fast path against the robust form.

use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use rayon::prelude::*;
use thinfilm::{Incidence, Material, Polarisation, Stack, StackLayer, StackRun, dense};

/// The promise of `dense`: R and T as the robust form to 1e-12.
const PROMISE: f64 = 1e-12;

fn random_stack(random: &mut StdRng) -> Stack {
    let k = if random.random_bool(0.5) { 0.0 } else { 10f64.powf(random.random_range(-6.0..0.5)) };
    let materials: Vec<Material> = (0..random.random_range(1..4usize))
        .map(|_| Material {
            k: k * random.random_range(0.0..1.0),
            ..Material::constant(random.random_range(1.05..2.4))
        })
        .collect();
    let unit = |random: &mut StdRng| StackLayer {
        material: random.random_range(0..materials.len()),
        thickness: random.random_range(0.0..500e-9),
        thickness_sd: 0.0,
    };
    let count = (random.random_range(0.0..7.0f64)).exp() as usize;
    let runs = if random.random_bool(0.5) {
        vec![StackRun { unit: (0..count.max(1)).map(|_| unit(random)).collect(), repeat: 1 }]
    } else {
        vec![StackRun { unit: vec![unit(random), unit(random)], repeat: (count as u64 / 2).max(1) }]
    };
    Stack {
        ambient: Material::constant(if random.random_bool(0.7) {
            1.0
        } else {
            random.random_range(1.0..1.8)
        }),
        materials,
        runs,
        substrate: Material {
            k: if random.random_bool(0.3) { 2.0 } else { 0.0 },
            ..Material::constant(random.random_range(1.0..2.0))
        },
        gain: thinfilm::Gain::Refused,
    }
}

#[test]
fn the_fast_path_agrees_with_the_robust_form_to_1e_12() {
    let wavelengths: Vec<f64> = (0..41).map(|i| 380e-9 + 10e-9 * f64::from(i)).collect();
    let angles: Vec<f64> =
        [0.0, 20.0, 45.0, 60.0, 75.0, 85.0, 89.0, 89.9, 90.0].map(f64::to_radians).to_vec();
    let worst = (0..300u64)
        .into_par_iter()
        .map(|seed| {
            let mut random = StdRng::seed_from_u64(seed);
            let stack = random_stack(&mut random);
            let spectra = dense::spectra(&stack, &wavelengths, &angles).unwrap();
            let mut worst: (f64, String) = (0.0, String::new());
            for (a, &theta) in angles.iter().enumerate() {
                for (w, &wavelength) in wavelengths.iter().enumerate() {
                    for pol in Polarisation::BOTH {
                        let robust = stack.at(wavelength).unwrap().solve(wavelength, Incidence::Angle(theta), pol).unwrap();
                        let error = (spectra.reflectance(a, pol)[w] - robust.reflectance)
                            .abs()
                            .max((spectra.transmittance(a, pol)[w] - robust.transmittance).abs());
                        if error.is_nan() || error > worst.0 {
                            worst = (error, format!("seed {seed} angle {theta} wavelength {wavelength} {pol:?} robust lanes {}", spectra.robust_lanes()));
                        }
                    }
                }
            }
            worst
        })
        .reduce(|| (0.0, String::new()), |a, b| if a.0 >= b.0 { a } else { b });
    assert!(worst.0 <= PROMISE, "{worst:?}");
}

/// Otherwise the promise would be kept by doing all lanes the slow way.
#[test]
fn a_pearl_is_done_by_the_fast_path() {
    let wavelengths: Vec<f64> = (0..401).map(|i| 380e-9 + 1e-9 * f64::from(i)).collect();
    let angles: Vec<f64> = (0..90).map(|deg| f64::from(deg).to_radians()).collect();
    for (k, sd) in [(0.0, 0.03), (1e-3, 0.03), (0.0, 0.1)] {
        let material = |n| Material { k, ..Material::constant(n) };
        let stack = Stack::alternating(
            Material::constant(1.0),
            (material(1.53), 450e-9, 450e-9 * sd),
            (material(1.43), 25e-9, 25e-9 * sd),
            500,
            Material::constant(1.53),
        )
        .draw(5, 0)
        .unwrap();
        let robust = dense::spectra(&stack, &wavelengths, &angles).unwrap().robust_lanes();
        // 1 % of lanes at 50 × the cost would halve the speed.
        assert!(robust * 200 < wavelengths.len() * angles.len(), "k {k}, sd {sd}: {robust} robust lanes");
    }
}

#[test]
fn indices_that_are_given_stand_for_those_of_the_materials() {
    let mut random = StdRng::seed_from_u64(5);
    let wavelengths = [400e-9, 550e-9, 700e-9];
    let angles = [0.0, 0.7];
    for _ in 0..50 {
        let stack = random_stack(&mut random);
        let indices: Vec<_> = wavelengths.iter().map(|w| stack.indices(*w).unwrap()).collect();
        let expected = dense::spectra(&stack, &wavelengths, &angles).unwrap();
        let blank =
            Stack { materials: vec![Material::constant(9.0); stack.materials.len()], ..stack.clone() };
        assert_eq!(dense::spectra_of(&blank, &wavelengths, indices.clone(), &angles).unwrap(), expected);
        // One for each wavelength, and for each material.
        assert!(dense::spectra_of(&blank, &wavelengths[..2], indices.clone(), &angles).is_err());
        let mut short = indices.clone();
        short[1].materials.pop();
        assert!(dense::spectra_of(&blank, &wavelengths, short, &angles).is_err());
        for wrong in [num_complex::Complex64::new(0.0, 0.0), num_complex::Complex64::new(1.5, -0.1)] {
            let mut bad = indices.clone();
            bad[2].materials[0] = wrong;
            assert!(dense::spectra_of(&blank, &wavelengths, bad, &angles).is_err(), "{wrong}");
        }
    }
}
