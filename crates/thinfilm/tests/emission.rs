//! The emission by reciprocity against sheets of current that radiate.

use num_complex::Complex64;
use std::sync::atomic::AtomicBool;
use thinfilm::emission::{SourceProfile, radiance};
use thinfilm::modulation::{self, Sampling};
use thinfilm::{Incidence, Layer, Material, Multilayer, Polarisation, Run, Stack, StackError};

fn pearl(sd: f64, k: f64) -> Stack {
    let material = |n| Material { k, ..Material::constant(n) };
    Stack::alternating(
        Material::constant(1.0),
        (material(1.53), 450e-9, 450e-9 * sd),
        (material(1.43), 25e-9, 25e-9 * sd),
        40,
        Material::constant(1.33),
    )
}

/// Power per solid angle (up to one constant) that unit sheets of current at a height in a layer send into the ambient at θ:
/// outgoing waves on both sides, reflected by what the solver says of each side. J_y for s: E continuous, H jumps by J. For p, J_x: E_x
/// continuous, H jumps by J; and, not in step with it, J_z: H continuous, E_x jumps by J kₓ/ε.
fn radiated(
    layers: &[Layer],
    substrate: f64,
    at: usize,
    height: f64,
    wave: (f64, f64),
    polarisation: Polarisation,
) -> f64 {
    let (wavelength, theta) = wave;
    let real = |n: f64| Complex64::new(n, 0.0);
    let host = layers[at];
    let kx = theta.sin();
    let cut = |thickness: f64| Layer { thickness, ..host };
    let stack = |unit: Vec<Layer>, substrate: f64| Multilayer {
        ambient: host.index,
        runs: vec![Run { unit, repeat: 1 }],
        substrate: real(substrate),
    };
    let solve = |stack: &Multilayer| stack.solve(wavelength, Incidence::InPlane(kx), polarisation).unwrap();
    let mut up: Vec<Layer> = vec![cut(host.thickness - height)];
    up.extend(layers[..at].iter().rev());
    let mut down = vec![cut(height)];
    down.extend(&layers[at + 1..]);
    let (above, below) = (solve(&stack(up, 1.0)), solve(&stack(down, substrate)));
    let kz = (host.index * host.index - kx * kx).sqrt();
    let echoes = 1.0 - above.r * below.r;
    // Wave upwards at the sheet, its echoes summed: a (1 + r_above) and b (1 + r_below) meet the conditions above.
    let power = match polarisation {
        Polarisation::S => (above.t * (1.0 + below.r) / echoes / kz).norm_sqr(),
        Polarisation::P => {
            // r is the ratio of H, t that of E.
            let t = above.t / host.index;
            let along = t * (1.0 - below.r) / echoes;
            let across = t * (1.0 + below.r) / echoes * kx / kz;
            along.norm_sqr() + across.norm_sqr()
        }
    };
    // Flux cos θ |ψ|² per cell of kₓ-space, d²kₓ = cos θ dω.
    power * theta.cos() * theta.cos()
}

#[test]
fn emission_by_reciprocity_is_what_sheets_of_current_radiate() {
    let mut ratios = Vec::new();
    for (sd, k) in [(0.0, 0.0), (0.05, 0.0), (0.05, 3e-3)] {
        let stack = pearl(sd, k).draw(3, 0).unwrap();
        for wave in [(450e-9, 0.0f64), (550e-9, 0.5), (600e-9, 1.1), (700e-9, 1.4)] {
            for polarisation in Polarisation::BOTH {
                let (wavelength, theta) = wave;
                let film = stack.at(wavelength).unwrap();
                let layers: Vec<Layer> = film.layers().collect();
                let mut direct = 0.0;
                for (at, layer) in layers.iter().enumerate() {
                    const SHEETS: usize = 60;
                    let step = layer.thickness / SHEETS as f64;
                    for i in 0..SHEETS {
                        let height = step * (i as f64 + 0.5);
                        direct += radiated(&layers, 1.33, at, height, wave, polarisation) * step;
                    }
                }
                let field = film.field(wavelength, Incidence::Angle(theta), polarisation).unwrap();
                // Radiance = power per solid angle over cos θ; by reciprocity (1/cos θ)·∫|E|² dz.
                ratios.push(direct / field.integrals().iter().sum::<f64>());
            }
        }
    }
    // One constant for stacks, wavelengths, angles and polarisations; 60 midpoints on at most 6 rad of phase: 1e-4.
    for ratio in &ratios {
        assert!((ratio / ratios[0] - 1.0).abs() < 1e-3, "{ratios:?}");
    }
}

#[test]
fn sources_below_the_stack_are_seen_through_it() {
    let stack = pearl(0.0, 0.0);
    let seen = radiance(&stack, SourceProfile::Substrate, 0, 1, &[500e-9], &[0.4]).unwrap()[0][0];
    let solve =
        |pol| stack.at(500e-9).unwrap().solve(500e-9, Incidence::Angle(0.4), pol).unwrap().transmittance;
    let mean = 0.5 * (solve(Polarisation::S) + solve(Polarisation::P));
    // Means are right to 1e-9.
    assert!((seen - mean).abs() < 1e-9);
}

/// One layer whose sources fall off within it: their mean strength is that of the exponential over the layer.
#[test]
fn sources_that_fall_off_count_as_their_mean_in_each_layer() {
    let film = Stack::alternating(
        Material::constant(1.0),
        (Material::constant(1.5), 800e-9, 0.0),
        (Material::constant(1.5), 0.0, 0.0),
        1,
        Material::constant(1.3),
    );
    let of = |profile| radiance(&film, profile, 0, 1, &[500e-9], &[0.4]).unwrap()[0][0];
    let share = of(SourceProfile::Exponential { depth: 400e-9 }) / of(SourceProfile::Uniform);
    assert!((share - (1.0 - (-2f64).exp()) / 2.0).abs() < 1e-12, "{share}");
}

#[test]
fn the_emission_has_unit_mean_and_the_modulation_is_bounded_to_grazing() {
    let stack = pearl(0.03, 0.0);
    let sampling = Sampling { bands: 10, beyond: [0; 2], per_band: 4, members: 4, seed: 1 };
    let profile = SourceProfile::Exponential { depth: 5e-6 };
    let never = AtomicBool::new(false);
    for row in modulation::emission(&never, &stack, profile, &[0.0, 1.2], sampling).unwrap() {
        assert!((row.bands.iter().sum::<f64>() / 10.0 - 1.0).abs() < 1e-12);
        assert!(row.bands.iter().all(|e| *e > 0.0));
    }
    let (angles, incoherent) = ([0.0, 1.0, std::f64::consts::FRAC_PI_2], [0.2, 0.3, 1.0]);
    let rows = modulation::modulation(&never, &stack, &incoherent, &angles, sampling).unwrap();
    for (row, incoherent) in rows.iter().zip(incoherent) {
        let reflected = row.bands.iter().chain(&row.rgb).map(|m| m * incoherent);
        assert!(reflected.into_iter().all(|r| (0.0..=1.0 + 1e-12).contains(&r)), "{row:?}");
    }
    let stopped = modulation::modulation(&AtomicBool::new(true), &stack, &incoherent, &angles, sampling);
    assert!(matches!(stopped, Err(StackError::Stopped)));
    // All light is reflected at 90°.
    assert!(rows[2].bands.iter().all(|m| (m - 1.0).abs() < 1e-9), "{:?}", rows[2]);
}
