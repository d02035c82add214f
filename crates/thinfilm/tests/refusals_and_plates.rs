//! What the library itself refuses, and plates thick enough that intensities add, against closed forms.

use num_complex::Complex64;
use thinfilm::ensemble::{self, Members};
use thinfilm::{
    Gain, Incidence, Layer, Material, Multilayer, Polarisation, Run, Stack, StackLayer, StackRun, WaveError,
    intensity, line,
};

const NM: f64 = 1e-9;

fn absorbing(n: f64, k: f64) -> Material {
    Material { k, ..Material::constant(n) }
}

fn stack(materials: Vec<Material>, thicknesses: &[f64], gain: Gain) -> Stack {
    let layer = |(material, &thickness)| StackLayer { material, thickness, thickness_sd: 0.0 };
    Stack {
        ambient: Material::constant(1.0),
        runs: vec![StackRun { unit: thicknesses.iter().enumerate().map(layer).collect(), repeat: 1 }],
        materials,
        substrate: Material::constant(1.5),
        gain,
    }
}

#[test]
fn gain_is_refused_unless_the_stack_allows_it() {
    let amplifier = |gain| stack(vec![absorbing(1.6, -1e-9)], &[100.0 * NM], gain);
    let refusal = amplifier(Gain::Refused).at(550.0 * NM).unwrap_err().to_string();
    assert!(refusal.contains("k = -0.000000001"), "{refusal}");
    amplifier(Gain::Allowed).at(550.0 * NM).unwrap();
}

#[test]
fn the_solver_refuses_angles_wavelengths_thicknesses_and_gain() {
    let film = |index: Complex64, thickness: f64| {
        let runs = vec![Run { unit: vec![Layer { index, thickness }], repeat: 1 }];
        Multilayer { ambient: 1.0.into(), runs, substrate: 1.5.into() }
    };
    let solve = |thickness: f64, wavelength: f64, theta: f64| {
        film(1.6.into(), thickness).solve(wavelength, Incidence::Angle(theta), Polarisation::S)
    };
    let (thickness, wavelength, theta) = (100.0 * NM, 550.0 * NM, 0.5);
    solve(thickness, wavelength, theta).unwrap();
    for angle in [91_f64.to_radians(), -1e-3, f64::NAN, f64::INFINITY] {
        let refusal = solve(thickness, wavelength, angle).unwrap_err();
        assert!(matches!(refusal, WaveError::Angle { .. }), "{angle}: {refusal}");
    }
    for length in [0.0, -wavelength, f64::NAN, f64::INFINITY] {
        let refusal = solve(thickness, length, theta).unwrap_err();
        assert!(matches!(refusal, WaveError::Wavelength { .. }), "{length}: {refusal}");
    }
    for length in [-1e-12, f64::NAN, f64::INFINITY] {
        let refusal = solve(length, wavelength, theta).unwrap_err();
        assert!(matches!(refusal, WaveError::Thickness { .. }), "{length}: {refusal}");
    }
    let amplifier = film(Complex64::new(1.6, -1e-9), thickness);
    let (incidence, pol) = (Incidence::Angle(theta), Polarisation::P);
    let refusal = amplifier.solve(wavelength, incidence, pol).unwrap_err();
    assert!(matches!(refusal, WaveError::Gain { .. }), "{refusal}");
    amplifier.solve_with_gain(wavelength, incidence, pol).unwrap();
}

/// A plate of 1 mm under a coating that absorbs, so that its two faces reflect differently: light that goes to and fro in the
/// plate is a geometric series of the coating's response from either side.
#[test]
fn a_plate_under_an_absorbing_coating_is_a_geometric_series() {
    let (coating, k, wavelength) = (absorbing(2.0, 0.3), 2e-5, 550.0 * NM);
    let [film, plate] = [80.0 * NM, 1e-3];
    let coated = stack(vec![coating, absorbing(1.7, k)], &[film, plate], Gain::Refused);
    for theta in [0.0_f64, 0.7, 1.3] {
        for pol in Polarisation::BOTH {
            // One interface or film by itself, from a medium of real index.
            let alone = |above: f64, layers: Vec<Layer>, below: f64| {
                let runs = vec![Run { unit: layers, repeat: 1 }];
                let multilayer = Multilayer { ambient: above.into(), runs, substrate: below.into() };
                multilayer.solve(wavelength, Incidence::InPlane(theta.sin()), pol).unwrap()
            };
            let layer = || vec![Layer { index: Complex64::new(2.0, 0.3), thickness: film }];
            let (down, up, bottom) =
                (alone(1.0, layer(), 1.7), alone(1.7, layer(), 1.0), alone(1.7, Vec::new(), 1.5));
            assert!((down.reflectance - up.reflectance).abs() > 1e-3, "{theta}");
            let path = plate / (1.0 - (theta.sin() / 1.7).powi(2)).sqrt();
            let once = (-2.0 * std::f64::consts::TAU / wavelength * k * path).exp();
            let round_trips = 1.0 - up.reflectance * bottom.reflectance * once * once;
            let reflectance = down.reflectance
                + down.transmittance * bottom.reflectance * up.transmittance * once * once / round_trips;
            let transmittance = down.transmittance * once * bottom.transmittance / round_trips;
            let whole =
                intensity::mixed(&coated, |layer| layer.thickness > 1e-4, wavelength, theta, pol).unwrap();
            // The path takes k as a perturbation of cos θ: k² = 4e-10.
            assert!(
                (whole.reflectance - reflectance).abs() < 1e-8,
                "{theta} {pol:?}: {whole:?} {reflectance}"
            );
            assert!(
                (whole.transmittance - transmittance).abs() < 1e-8,
                "{theta} {pol:?}: {whole:?} {transmittance}"
            );
        }
    }
}

/// An incoherent layer that amplifies has no sum of intensities.
#[test]
fn gain_is_refused_where_intensities_add() {
    let plate = stack(vec![absorbing(1.7, -1e-6)], &[1e-3], Gain::Allowed);
    let refusal = intensity::mixed(&plate, |_| true, 550.0 * NM, 0.0, Polarisation::S).unwrap_err();
    assert!(refusal.to_string().contains("layer 1"), "{refusal}");
}

/// Every layer incoherent: one absorbing plate between unlike media.
#[test]
fn an_incoherent_plate_absorbs_on_every_crossing() {
    let depth = 0.4;
    let face = |a: f64, b: f64| ((a - b) / (a + b)).powi(2);
    let (top, bottom) = (face(1.0, 1.7), face(1.7, 1.5));
    let once = f64::exp(-depth);
    let round_trips = 1.0 - top * bottom * once * once;
    let whole = intensity::incoherent(&[1.0, 1.7, 1.5], &[depth], 0.0, 0.5, |_, _| None);
    let reflectance = top + (1.0 - top).powi(2) * bottom * once * once / round_trips;
    let transmittance = (1.0 - top) * once * (1.0 - bottom) / round_trips;
    assert!((whole.reflectance - reflectance).abs() < 1e-14, "{whole:?} {reflectance}");
    assert!((whole.transmittance - transmittance).abs() < 1e-14, "{whole:?} {transmittance}");
}

/// Rounding makes no absorption: of a stack without loss it is 0, of one that hardly absorbs not negative. Gain stays.
#[test]
fn absorption_is_0_without_loss_and_negative_only_with_gain() {
    let wavelengths: Vec<f64> = (0..40).map(|i| (400.0 + 10.0 * f64::from(i)) * NM).collect();
    let angles = [0.0, 0.6, 1.2];
    let line = line::Line { shape: line::Shape::Gaussian, width: 1.0 * NM };
    let found = |k: f64| -> Vec<f64> {
        let film = Stack::alternating(
            Material::constant(1.0),
            (absorbing(1.53, k), 450.0 * NM, 20.0 * NM),
            (Material::constant(1.43), 25.0 * NM, 1.0 * NM),
            40,
            Material::constant(1.53),
        );
        let film = Stack { gain: Gain::Allowed, ..film };
        let of = |pol| ensemble::mean_of(&film, 1, Members::Count(3), &wavelengths, &angles, pol).unwrap();
        let ensembles = [None, Some(Polarisation::P)].map(|pol| of(pol).absorptance);
        let lines = line::mean(&film, line, &wavelengths[..2], &angles, 1e-2).unwrap().absorptance;
        let solved = film.at(wavelengths[0]).unwrap();
        let alone = Polarisation::BOTH.map(|pol| {
            solved.solve_with_gain(wavelengths[0], Incidence::Angle(0.6), pol).unwrap().absorptance
        });
        ensembles.into_iter().chain(lines).flatten().flatten().chain(alone).collect()
    };
    assert!(found(0.0).iter().all(|a| a.to_bits() == 0));
    assert!(found(1e-18).iter().all(|a| *a >= 0.0));
    assert!(found(1e-3).iter().all(|a| *a > 1e-3));
    assert!(found(-1e-3).iter().all(|a| *a < -1e-3));
}
