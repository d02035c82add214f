//! What the library itself refuses, and plates thick enough that intensities add, against closed forms.

use num_complex::Complex64;
use thinfilm::ensemble::{self, Members};
use thinfilm::{
    Gain, Incidence, Layer, Material, Multilayer, Polarisation, Run, Stack, StackError, StackLayer, StackRun,
    WaveError, colour, dense, emission, intensity, line,
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
            // One interface or film by itself. Its phase is what the plate's k shifts in first order.
            let alone = |above: Complex64, layers: Vec<Layer>, below: Complex64| {
                let runs = vec![Run { unit: layers, repeat: 1 }];
                let multilayer = Multilayer { ambient: above, runs, substrate: below };
                multilayer.solve(wavelength, Incidence::InPlane(theta.sin()), pol).unwrap()
            };
            let layer = || vec![Layer { index: Complex64::new(2.0, 0.3), thickness: film }];
            let (air, inside) = (Complex64::from(1.0), Complex64::new(1.7, k));
            let (down, up) = (alone(air, layer(), inside), alone(inside, layer(), air));
            let bottom = alone(inside, Vec::new(), 1.5.into());
            let passed = (down.t * up.t).norm();
            assert!((down.reflectance - up.reflectance).abs() > 1e-3, "{theta}");
            let path = plate / (1.0 - (theta.sin() / 1.7).powi(2)).sqrt();
            let once = (-2.0 * std::f64::consts::TAU / wavelength * k * path).exp();
            let round_trips = 1.0 - up.reflectance * bottom.reflectance * once * once;
            let reflectance =
                down.reflectance + passed * bottom.reflectance * passed * once * once / round_trips;
            let transmittance = passed * once * bottom.transmittance / round_trips;
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

/// r₀₁ and the like of a plate of index N between two media, from complex admittances: the mean over the plate's phase is
/// |r₀₁|² + |t₀₁ t₁₀ r₁₂ τ|²/(1 − |r₁₀ r₁₂ τ|²), τ = |e^(2iδ)|.
fn mean_over_phase(
    media: [Complex64; 3],
    thickness: f64,
    wavelength: f64,
    theta: f64,
    pol: Polarisation,
) -> [f64; 2] {
    let kx = media[0].re * theta.sin();
    let kz = media.map(|n| (n * n - kx * kx).sqrt()); // principal: forward where light travels
    let q = match pol {
        Polarisation::S => kz,
        Polarisation::P => [0, 1, 2].map(|i| kz[i] / (media[i] * media[i])),
    };
    let r = |a: usize, b: usize| (q[a] - q[b]) / (q[a] + q[b]);
    let tau = f64::exp(-2.0 * std::f64::consts::TAU / wavelength * kz[1].im * thickness);
    let inner = 1.0 - (r(1, 0) * r(1, 2)).norm_sqr() * tau * tau;
    let through = (1.0 - r(0, 1) * r(0, 1)) * r(1, 2) * tau;
    let passed =
        (2.0 * q[0] / (q[0] + q[1]) * 2.0 * q[1] / (q[1] + q[2])).norm_sqr() * tau * q[2].re / q[0].re;
    [r(0, 1).norm_sqr() + through.norm_sqr() / inner, passed / inner]
}

/// From clear to metallic and from absorbing to amplifying, total reflection at either end among them.
#[test]
fn an_incoherent_plate_is_the_mean_over_its_phase() {
    let wavelength = 550.0 * NM;
    let index = Complex64::new;
    for (plate, substrate, thickness) in [
        (index(1.7, 0.0), index(1.5, 0.0), 1e-3),
        (index(4.0, 0.03), index(1.0, 0.0), 5e-6),
        (index(1.6, 0.2), index(0.06, 3.6), 1e-7),
        (index(2.1, 1.9), index(1.5, 0.4), 4e-8),
        (index(1.5, 1e-4), index(1.0, 1e-3), 3e-4),
        (index(1.5, -1e-3), index(1.0, 0.0), 2e-5),
        (index(1.7, -3e-3), index(0.1, 3.0), 2e-6),
    ] {
        let film = Stack {
            ambient: Material::constant(1.2),
            substrate: absorbing(substrate.re, substrate.im),
            ..stack(vec![absorbing(plate.re, plate.im)], &[thickness], Gain::Allowed)
        };
        for (theta, pol) in [0.0, 0.5, 1.1].into_iter().flat_map(|t| Polarisation::BOTH.map(|pol| (t, pol))) {
            let kx = 1.2 * f64::sin(theta);
            if plate.re * plate.re - plate.im * plate.im <= kx * kx {
                continue;
            }
            let [r, t] = mean_over_phase([1.2.into(), plate, substrate], thickness, wavelength, theta, pol);
            let whole = intensity::mixed(&film, |_| true, wavelength, theta, pol).unwrap();
            let off = ((whole.reflectance - r).abs() / r).max((whole.transmittance - t).abs());
            assert!(off < 1e-12, "{plate} {substrate} {theta} {pol:?}: {whole:?}, R {r}, T {t}");
            let sum = whole.reflectance + whole.transmittance + whole.absorptance;
            assert!((sum - 1.0).abs() < 1e-12 * r.max(1.0), "{whole:?}");
        }
    }
}

/// Opaque layers and those in which light does not travel: the incoherent stack is the coherent one.
#[test]
fn a_layer_that_light_does_not_cross_is_no_less_coherent() {
    let wavelength = 550.0 * NM;
    for (coating, thick, thickness) in [
        (absorbing(1.46, 0.0), absorbing(4.0, 0.03), 2e-4),
        (absorbing(2.3, 0.1), absorbing(0.06, 3.6), 2e-5),
        (absorbing(1.38, 0.0), absorbing(1.0, 1.0), 3e-8),
        (absorbing(1.46, -0.1), absorbing(0.9, 2.0), 5e-8),
    ] {
        let film = stack(vec![coating, thick], &[100.0 * NM, thickness], Gain::Allowed);
        for (theta, pol) in [0.0, 0.7, 1.3].into_iter().flat_map(|t| Polarisation::BOTH.map(|pol| (t, pol))) {
            let whole = intensity::mixed(&film, |l| l.material == 1, wavelength, theta, pol).unwrap();
            let incidence = Incidence::Angle(theta);
            let coherent = film.at(wavelength).unwrap().solve_with_gain(wavelength, incidence, pol).unwrap();
            assert!((whole.reflectance - coherent.reflectance).abs() < 1e-12, "{whole:?} {coherent:?}");
            assert!((whole.transmittance - coherent.transmittance).abs() < 1e-12, "{whole:?} {coherent:?}");
        }
    }
}

/// Gain that its mirrors do not let out: no steady state.
#[test]
fn a_plate_above_its_threshold_is_refused() {
    let plate = |k: f64| {
        let film = stack(vec![absorbing(1.7, k)], &[1e-3], Gain::Allowed);
        intensity::mixed(&film, |_| true, 550.0 * NM, 0.0, Polarisation::S)
    };
    // The ends reflect 0.0672 and 0.0039: gain of e^8.2 on the way to and fro.
    let threshold = 8.25 / (4.0 * std::f64::consts::TAU * 1e-3 / (550.0 * NM));
    assert!(plate(-0.9 * threshold).unwrap().reflectance > 1.0);
    // Far above, too, where T and A of a crossing leave no digits of 1 − R.
    for above in [1.1, 3.0, 8.0, 20.0, 300.0] {
        let refusal = plate(-above * threshold).unwrap_err();
        assert!(refusal.to_string().contains("lasing threshold"), "{above}: {refusal}");
    }
}

/// Half-spaces: the one below does not amplify, the one above is clear but at normal incidence. Every entrance refuses alike.
#[test]
fn half_spaces_neither_amplify_nor_absorb_light_that_comes_aslant() {
    let film = |ambient, substrate| Stack {
        ambient,
        substrate,
        ..stack(vec![absorbing(1.3, 0.0)], &[100.0 * NM], Gain::Allowed)
    };
    let clear = || Material::constant(1.5);
    let entrances = |film: &Stack, theta: f64| {
        let (wavelengths, members) = ([550.0 * NM], Members::Count(2));
        let line = line::Line { shape: line::Shape::Gaussian, width: NM };
        [
            film.at(wavelengths[0])
                .and_then(|m| {
                    Ok(m.solve_with_gain(wavelengths[0], Incidence::Angle(theta), Polarisation::P)?)
                })
                .err(),
            dense::spectra(film, &wavelengths, &[theta]).err(),
            ensemble::mean_of(film, 1, members, &wavelengths, &[theta], None).err(),
            line::mean(film, line, &wavelengths, &[theta], 1e-3).err(),
            colour::of_stack(film, 1, 1, &[theta], 1.0).err(),
            emission::radiance(film, emission::SourceProfile::Uniform, 1, 1, &wavelengths, &[theta]).err(),
        ]
    };
    for k in [1e-12, 1e-3, 0.5] {
        for refusal in entrances(&film(absorbing(1.5, k), clear()), 0.5) {
            assert!(
                matches!(refusal, Some(StackError::Wave(WaveError::AbsorbingAmbient { .. }))),
                "{k}: {refusal:?}"
            );
        }
        assert!(entrances(&film(absorbing(1.5, k), clear()), 0.0).iter().all(Option::is_none), "{k}");
        for film in [film(clear(), absorbing(1.5, -k)), film(absorbing(1.5, -k), clear())] {
            for refusal in entrances(&film, 0.0) {
                assert!(
                    matches!(refusal, Some(StackError::Wave(WaveError::HalfSpaceGain { .. }))),
                    "{k}: {refusal:?}"
                );
            }
        }
    }
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
