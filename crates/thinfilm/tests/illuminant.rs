//! The illuminant by reciprocity against sheets of current that radiate.

use num_complex::Complex64;
use thinfilm::illuminant::{SourceProfile, emission};
use thinfilm::{Incidence, Layer, Material, Multilayer, Polarisation, Run, Stack, modulation};

fn pearl(sd: f64) -> Stack {
    Stack::alternating(
        Material::constant(1.0),
        (Material::constant(1.53), 450e-9, 450e-9 * sd),
        (Material::constant(1.43), 25e-9, 25e-9 * sd),
        40,
        Material::constant(1.33),
    )
}

/// Power per solid angle (up to a constant) that a unit sheet current J_y at a depth sends into the ambient at θ: outgoing
/// waves on both sides, E continuous and H jumping by J, each side's admittance from the solver itself.
fn radiated(layers: &[Layer], substrate: f64, at: usize, height: f64, wavelength: f64, theta: f64) -> f64 {
    let real = |n: f64| Complex64::new(n, 0.0);
    let host = layers[at];
    let kx = theta.sin();
    let cut = |thickness: f64| Layer { thickness, ..host };
    let stack = |unit: Vec<Layer>, substrate: f64| Multilayer {
        ambient: host.index,
        runs: vec![Run { unit, repeat: 1 }],
        substrate: real(substrate),
    };
    let solve =
        |stack: &Multilayer| stack.solve(wavelength, Incidence::InPlane(kx), Polarisation::S).unwrap();
    let mut up: Vec<Layer> = vec![cut(host.thickness - height)];
    up.extend(layers[..at].iter().rev());
    let mut down = vec![cut(height)];
    down.extend(&layers[at + 1..]);
    let (above, below) = (solve(&stack(up, 1.0)), solve(&stack(down, substrate)));
    // E at the sheet: waves a (up) and b (down) leave it; a = s + r_below b', … summed: E_out = t_above s (1 + r_below)/(1 − r_above r_below).
    let kz = (host.index.re.powi(2) - kx * kx).sqrt();
    let amplitude = above.t * (1.0 + below.r) / (1.0 - above.r * below.r) / kz;
    // Flux n cosθ|E|² per kx-space cell, d²kx = cos θ dω.
    amplitude.norm_sqr() * theta.cos() * theta.cos()
}

#[test]
fn emission_by_reciprocity_is_what_sheets_of_current_radiate() {
    let stack = pearl(0.05).draw(3, 0).unwrap();
    let total: f64 = stack.layers().map(|l| l.thickness).sum();
    let mut ratios = Vec::new();
    for (wavelength, theta) in [(450e-9, 0.0f64), (550e-9, 0.5), (600e-9, 1.1), (700e-9, 1.4)] {
        let layers: Vec<Layer> = stack.at(wavelength).unwrap().layers().collect();
        let mut direct = 0.0;
        for (at, layer) in layers.iter().enumerate() {
            const SHEETS: usize = 60;
            for i in 0..SHEETS {
                let height = layer.thickness * (i as f64 + 0.5) / SHEETS as f64;
                direct +=
                    radiated(&layers, 1.33, at, height, wavelength, theta) * layer.thickness / SHEETS as f64;
            }
        }
        let field = stack
            .at(wavelength)
            .unwrap()
            .field(wavelength, Incidence::Angle(theta), Polarisation::S)
            .unwrap();
        // Radiance = power per solid angle over cos θ; by reciprocity (1/cos θ)·∫|E|² dz.
        let reciprocal = field.integrals().iter().sum::<f64>() / theta.cos();
        ratios.push(direct / theta.cos() / reciprocal);
    }
    // One constant for all wavelengths and angles; 60 midpoints on at most 3 rad of standing wave: 1e-4.
    for ratio in &ratios {
        assert!((ratio / ratios[0] - 1.0).abs() < 1e-3, "{ratios:?} {total}");
    }
}

#[test]
fn sources_below_the_stack_are_seen_through_it() {
    let stack = pearl(0.0);
    let seen = emission(&stack, SourceProfile::Substrate, &[500e-9], &[0.4]).unwrap()[0][0];
    let solve =
        |pol| stack.at(500e-9).unwrap().solve(500e-9, Incidence::Angle(0.4), pol).unwrap().transmittance;
    let mean = 0.5 * (solve(Polarisation::S) + solve(Polarisation::P));
    // The fast path agrees with the robust one to 1e-12.
    assert!((seen - mean).abs() < 1e-12);
}

#[test]
fn the_illuminant_has_unit_mean_and_the_modulation_is_finite_to_grazing() {
    let stack = pearl(0.03);
    let wavelengths: Vec<f64> = (0..41).map(|i| 380e-9 + 10e-9 * f64::from(i)).collect();
    let rows = modulation::illuminant(
        &stack,
        SourceProfile::Exponential { depth: 5e-6 },
        1,
        4,
        &wavelengths,
        &[0.0, 1.2],
    )
    .unwrap();
    for row in rows {
        assert!((row.iter().sum::<f64>() / 41.0 - 1.0).abs() < 1e-12 && row.iter().all(|e| *e > 0.0));
    }
    let rows =
        modulation::modulation(&stack, 1, 4, &wavelengths, &[0.0, 1.0, std::f64::consts::FRAC_PI_2]).unwrap();
    assert!(rows.iter().flatten().all(|m| m.is_finite() && *m >= 0.0));
}
