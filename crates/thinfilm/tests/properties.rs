//! Properties that every stack must have.
#![allow(clippy::print_stdout)] // figures, for `--nocapture`

use num_complex::Complex64;
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand::rngs::StdRng;
use rayon::prelude::*;
use std::sync::atomic::AtomicBool;
use thinfilm::emission::SourceProfile;
use thinfilm::{
    Gain, Incidence, Layer, Material, Multilayer, Polarisation, Response, Run, Stack, StackLayer, StackRun,
    colour, dense, emission, ensemble, intensity, line, modulation,
};

fn real(n: f64) -> Complex64 {
    Complex64::new(n, 0.0)
}

fn explicit(ambient: Complex64, unit: Vec<Layer>, substrate: Complex64) -> Multilayer {
    Multilayer { ambient, runs: vec![Run { unit, repeat: 1 }], substrate }
}

fn random_layers(random: &mut StdRng, count: usize, largest_k: f64) -> Vec<Layer> {
    let contrast = random.random_range(0.0..1.0);
    let thickness = random.random_range(1e-9..600e-9);
    (0..count)
        .map(|_| Layer {
            index: Complex64::new(
                1.3 + contrast * random.random_range(0.0..1.2),
                largest_k * random.random_range(0.0..1.0),
            ),
            thickness: thickness * random.random_range(0.5..1.5),
        })
        .collect()
}

fn log_uniform(random: &mut StdRng, low: f64, high: f64) -> f64 {
    (random.random_range(low.ln()..high.ln())).exp()
}

fn solve(stack: &Multilayer, wavelength: f64, theta: f64, polarisation: Polarisation) -> Response {
    stack.solve(wavelength, Incidence::Angle(theta), polarisation).unwrap()
}

/// R + T, and |r|² + T from the amplitude itself, which no normalisation has touched.
#[test]
fn lossless_stacks_conserve_energy_to_1e_13() {
    const STACKS: u64 = 100_000;
    let errors: Vec<EnergyError> = (0..STACKS)
        .into_par_iter()
        .map(|seed| {
            let mut random = StdRng::seed_from_u64(seed);
            let count = log_uniform(&mut random, 1.0, 2000.0) as usize;
            let stack = explicit(
                real(1.0),
                random_layers(&mut random, count, 0.0),
                real(random.random_range(1.0..2.0)),
            );
            let (theta, wavelength) =
                (random.random_range(0.0..90f64).to_radians(), random.random_range(380e-9..780e-9));
            let pol = Polarisation::BOTH[random.random_range(0..2usize)];
            let response = solve(&stack, wavelength, theta, pol);
            let stated = (response.reflectance + response.transmittance - 1.0).abs();
            let raw = (response.r.norm_sqr() + response.transmittance - 1.0).abs();
            let bound = if raw > 1e-13 { rounding_bound(&stack, wavelength, theta, pol) } else { 1e-13 };
            EnergyError { seed, stated, raw, bound }
        })
        .collect();
    let worst = |of: fn(&EnergyError) -> f64| errors.iter().map(of).fold(0.0, f64::max);
    let resonant = errors.iter().filter(|error| error.raw > 1e-13).count();
    println!(
        "{STACKS} stacks: R + T off 1 by {:.1e}; |r|² + T by {:.1e}, by more than 1e-13 in {resonant}, where by {:.2} of the bound",
        worst(|error| error.stated),
        worst(|error| error.raw),
        worst(|error| if error.raw > 1e-13 { error.raw / error.bound } else { 0.0 }),
    );
    let failures: Vec<&EnergyError> =
        errors.iter().filter(|error| error.stated > 1e-13 || error.raw > error.bound).collect();
    assert!(failures.is_empty(), "{failures:?}");
}

#[derive(Debug)]
#[allow(dead_code)] // `seed` is for the message
struct EnergyError {
    seed: u64,
    /// |R + T − 1|.
    stated: f64,
    /// ||r|² + T − 1|.
    raw: f64,
    /// What rounding may make of `raw`.
    bound: f64,
}

/// First-order bound on the rounding error of r: each layer's matrix errs by a few 2⁻⁵³, and r feels layer j by the |E|²
/// that it holds (a resonance holds much). They add up at random: half a rounding a layer is several times what is met.
fn rounding_bound(stack: &Multilayer, wavelength: f64, theta: f64, pol: Polarisation) -> f64 {
    let field = stack.field(wavelength, Incidence::Angle(theta), pol).unwrap();
    let held: f64 = stack
        .layers()
        .zip(field.integrals())
        .map(|(layer, e2)| e2 / layer.thickness * layer.index.norm_sqr())
        .sum();
    0.5 * 2f64.powi(-53) * held / theta.cos()
}

#[test]
fn layers_of_a_long_run_doubled_and_one_by_one_agree() {
    for seed in 0..200 {
        let mut random = StdRng::seed_from_u64(seed);
        let k = [0.0, 1e-3, 0.3][random.random_range(0..3usize)];
        let count = random.random_range(1..4usize);
        let unit = random_layers(&mut random, count, k);
        let repeat = random.random_range(16..400u64);
        let run = Multilayer {
            ambient: real(1.0),
            runs: vec![Run { unit: unit.clone(), repeat }],
            substrate: real(1.53),
        };
        let listed = explicit(real(1.0), run.layers().collect(), real(1.53));
        for pol in Polarisation::BOTH {
            let (a, b) = (solve(&run, 550e-9, 0.7, pol), solve(&listed, 550e-9, 0.7, pol));
            // N rounding errors on either way, magnified where a band edge stores light.
            assert!((a.r - b.r).norm() < 1e-10, "seed {seed} {pol:?}: {a:?} {b:?}");
            assert!(
                (a.ln_transmittance - b.ln_transmittance).abs() < 1e-9,
                "seed {seed} {pol:?}: {a:?} {b:?}"
            );
            assert!((a.t - b.t).norm() < 1e-10, "seed {seed} {pol:?}: {a:?} {b:?}");
        }
    }
}

fn any_layer() -> impl Strategy<Value = Layer> {
    (1.2..2.6f64, prop_oneof![Just(0.0), 0.0..0.5f64], 0.0..800e-9f64)
        .prop_map(|(n, k, thickness)| Layer { index: Complex64::new(n, k), thickness })
}

fn any_layers() -> impl Strategy<Value = Vec<Layer>> {
    prop::collection::vec(any_layer(), 1..40)
}

fn any_pol() -> impl Strategy<Value = Polarisation> {
    prop_oneof![Just(Polarisation::S), Just(Polarisation::P)]
}

fn close(a: &Response, b: &Response, tolerance: f64) -> Result<(), TestCaseError> {
    let ln = (a.ln_transmittance - b.ln_transmittance).abs();
    prop_assert!(
        (a.r - b.r).norm() < tolerance && (a.t - b.t).norm() < tolerance && ln < 10.0 * tolerance,
        "{a:?}\n{b:?}"
    );
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// T is the same from both sides, in media where power is defined (real index), whatever the layers absorb.
    #[test]
    fn transmittance_is_reciprocal(layers in any_layers(), n in 1.0..2.0f64, theta in 0.0..1.4f64, pol in any_pol()) {
        let forward = explicit(real(1.0), layers.clone(), real(n));
        let backward = explicit(real(n), layers.into_iter().rev().collect(), real(1.0));
        let a = solve(&forward, 550e-9, theta, pol);
        let b = backward.solve(550e-9, Incidence::InPlane(theta.sin()), pol).unwrap();
        // 40 layers; a resonance of 40 layers magnifies rounding by less than 1e3.
        prop_assert!((a.ln_transmittance - b.ln_transmittance).abs() < 1e-11, "{a:?}\n{b:?}");
    }

    #[test]
    fn s_and_p_are_one_at_normal_incidence_but_for_the_sign_of_r(layers in any_layers(), n in 1.0..2.0f64) {
        let stack = explicit(real(1.0), layers, real(n));
        let (s, p) = (solve(&stack, 550e-9, 0.0, Polarisation::S), solve(&stack, 550e-9, 0.0, Polarisation::P));
        prop_assert!((s.r + p.r).norm() < 1e-11 && (s.t - p.t).norm() < 1e-11, "{s:?}\n{p:?}");
    }

    #[test]
    fn a_layer_of_no_thickness_changes_nothing(
        layers in any_layers(), at in any::<prop::sample::Index>(), theta in 0.0..1.57f64, pol in any_pol(), n in 0.5..3.0f64, k in 0.0..4.0f64
    ) {
        let stack = explicit(real(1.0), layers.clone(), real(1.5));
        let mut more = layers;
        more.insert(at.index(more.len()), Layer { index: Complex64::new(n, k), thickness: 0.0 });
        close(&solve(&stack, 550e-9, theta, pol), &solve(&explicit(real(1.0), more, real(1.5)), 550e-9, theta, pol), 1e-13)?;
    }

    #[test]
    fn splitting_a_layer_changes_nothing(
        layers in any_layers(), at in any::<prop::sample::Index>(), share in 0.0..1.0f64, theta in 0.0..1.57f64, pol in any_pol()
    ) {
        let stack = explicit(real(1.0), layers.clone(), real(1.5));
        let mut more = layers;
        let at = at.index(more.len());
        let whole = more[at];
        more[at].thickness = whole.thickness * share;
        more.insert(at + 1, Layer { thickness: whole.thickness - whole.thickness * share, ..whole });
        close(&solve(&stack, 550e-9, theta, pol), &solve(&explicit(real(1.0), more, real(1.5)), 550e-9, theta, pol), 1e-11)?;
    }

    /// Layers of the ambient's own index reflect nothing more; they only shift phase.
    #[test]
    fn layers_of_the_ambients_index_change_no_power(layers in any_layers(), d in 0.0..1e-5f64, theta in 0.0..1.57f64, pol in any_pol()) {
        let stack = explicit(real(1.0), layers.clone(), real(1.5));
        let mut more = vec![Layer { index: real(1.0), thickness: d }];
        more.extend(layers);
        let (a, b) = (solve(&stack, 550e-9, theta, pol), solve(&explicit(real(1.0), more, real(1.5)), 550e-9, theta, pol));
        // d is up to 18 wavelengths: 120 rad of phase known to 1e-14.
        prop_assert!((a.reflectance - b.reflectance).abs() < 1e-12, "{a:?}\n{b:?}");
        prop_assert!((a.ln_transmittance - b.ln_transmittance).abs() < 1e-11, "{a:?}\n{b:?}");
    }

    /// |r| from below equals |r| from above for lossless layers between real media.
    #[test]
    fn a_lossless_stack_reflects_the_same_share_when_reversed(mut layers in any_layers(), n in 1.0..2.0f64, theta in 0.0..1.4f64, pol in any_pol()) {
        for layer in &mut layers {
            layer.index.im = 0.0;
        }
        let forward = explicit(real(1.0), layers.clone(), real(n));
        let backward = explicit(real(n), layers.into_iter().rev().collect(), real(1.0));
        let a = solve(&forward, 550e-9, theta, pol);
        let b = backward.solve(550e-9, Incidence::InPlane(theta.sin()), pol).unwrap();
        prop_assert!((a.reflectance - b.reflectance).abs() < 1e-11, "{a:?}\n{b:?}");
    }

    #[test]
    fn absorption_by_the_field_integral_is_what_is_missing(layers in any_layers(), theta in 0.0..1.55f64, pol in any_pol(), n in 1.0..2.0f64, k in 0.0..1.0f64) {
        let stack = explicit(real(1.0), layers, Complex64::new(n, k));
        let response = solve(&stack, 550e-9, theta, pol);
        let by_field: f64 = stack.field(550e-9, Incidence::Angle(theta), pol).unwrap().absorptances().iter().sum();
        let missing = 1.0 - response.reflectance - response.transmittance;
        prop_assert!((by_field - missing).abs() < 1e-11, "{by_field} {missing} {response:?}");
    }

    /// Field integrals against Simpson's rule on the field itself.
    #[test]
    fn the_integral_of_the_field_is_the_integral_of_the_field(layers in prop::collection::vec(any_layer(), 1..6), theta in 0.0..1.55f64, pol in any_pol()) {
        let stack = explicit(real(1.0), layers.clone(), real(1.5));
        let field = stack.field(550e-9, Incidence::Angle(theta), pol).unwrap();
        let mut top = 0.0;
        for (layer, integral) in layers.iter().zip(field.integrals()) {
            const HALVES: u32 = 400;
            // The very faces belong to both layers; step inside by a hair.
            let at = |i: u32| field.intensity(top + layer.thickness * (1e-9 + (1.0 - 2e-9) * f64::from(i) / f64::from(2 * HALVES))).unwrap();
            let sum: f64 = (0..HALVES).map(|i| at(2 * i) + 4.0 * at(2 * i + 1) + at(2 * i + 2)).sum();
            let simpson = sum * layer.thickness / f64::from(6 * HALVES);
            // Simpson with 800 steps on at most 24 rad: 1e-8; the hair costs 2e-9.
            prop_assert!((simpson - integral).abs() <= 1e-7 * integral + 1e-22, "{simpson:e} {integral:e} {layer:?}");
            top += layer.thickness;
        }
    }

    /// Any finite input gives an answer or an error, never a panic, NaN or infinity.
    #[test]
    fn no_finite_input_panics_or_gives_nan(
        n in prop::array::uniform8(any::<f64>()), d in prop::array::uniform3(any::<f64>()), wavelength in any::<f64>(), theta in any::<f64>(),
        exact in any::<bool>(), repeat in any::<u64>(), pol in any_pol(), tame in any::<bool>()
    ) {
        let finite = |x: f64| if x.is_finite() { x } else { 1.0 };
        let tamed = |x: f64| if tame { 1.0 + finite(x).sin().abs() } else { finite(x) };
        let index = |i: usize| Complex64::new(tamed(n[i]), if tame { finite(n[i + 1]).cos() } else { finite(n[i + 1]) });
        let layers = d.iter().enumerate().map(|(i, d)| Layer { index: index(i), thickness: finite(*d) * if tame { 1e-7 } else { 1.0 } });
        let stack = Multilayer {
            ambient: real(tamed(n[6])),
            runs: vec![Run { unit: layers.collect(), repeat }],
            substrate: index(4),
        };
        let (wavelength, theta) = (tamed(wavelength), tamed(theta));
        let incidence = if exact { Incidence::Angle(theta) } else { Incidence::InPlane(theta) };
        for result in [stack.solve(wavelength, incidence, pol), stack.solve_with_gain(wavelength, incidence, pol)].into_iter().flatten() {
            prop_assert!(result.r.is_finite() && result.t.is_finite() && result.reflectance.is_finite() && result.transmittance.is_finite());
            prop_assert!(!result.ln_transmittance.is_nan() && !result.ln_abs_t.is_nan());
        }
        let short = Multilayer { runs: vec![Run { unit: stack.runs[0].unit.clone(), repeat: repeat % 50 }], ..stack };
        if let Ok(field) = short.field(wavelength, incidence, pol) {
            prop_assert!(field.integrals().iter().all(|x| !x.is_nan()));
        }
    }

    /// The same for everything that is built on it: fast path, intensities, ensembles, lines.
    #[test]
    fn no_finite_stack_panics_or_gives_nan(
        n in prop::array::uniform4(any::<f64>()), k in prop::array::uniform4(any::<f64>()), d in prop::array::uniform3(any::<f64>()),
        sd in any::<f64>(), wavelength in any::<f64>(), theta in any::<f64>(), width in any::<f64>(), seed in any::<u64>(), tame in any::<bool>(),
        repeat in 0..200u64, pol in any_pol()
    ) {
        let finite = |x: f64| if x.is_finite() { x } else { 1.0 };
        let tamed = |x: f64, scale: f64| if tame { scale * (1.0 + finite(x).sin().abs()) } else { finite(x) };
        let material = |i: usize| Material { k: if tame { tamed(k[i], 0.1) - 0.1 } else { finite(k[i]) }, ..Material::constant(tamed(n[i], 1.0)) };
        let layer = |i: usize| StackLayer { material: i % 2, thickness: tamed(d[i], 1e-7), thickness_sd: tamed(sd, 1e-8) };
        let stack = Stack {
            ambient: Material { k: 0.0, ..material(2) },
            materials: vec![material(0), material(1)],
            runs: vec![StackRun { unit: (0..3).map(layer).collect(), repeat }],
            substrate: material(3),
            gain: Gain::Refused,
        };
        let (wavelength, theta) = (tamed(wavelength, 5e-7), if tame { tamed(theta, 0.78) } else { finite(theta) });
        let waves = [wavelength, 1.3 * wavelength];
        if let Ok(mean) = ensemble::mean(&stack, seed, 2, &waves, &[theta]) {
            prop_assert!(mean.reflectance.iter().chain(&mean.transmittance).flatten().all(|x| x.is_finite()));
            // Nothing amplifies.
            prop_assert!(mean.absorptance.iter().flatten().all(|a| *a >= 0.0));
        }
        if let Ok(spectra) = dense::spectra(&stack, &waves, &[theta]) {
            for pol in Polarisation::BOTH {
                prop_assert!(spectra.reflectance(0, pol).iter().chain(spectra.transmittance(0, pol)).all(|x| x.is_finite()));
            }
        }
        let sampling = modulation::Sampling { bands: 3, beyond: [0; 2], per_band: 2, members: 2, seed };
        let never = AtomicBool::new(false);
        for profile in [SourceProfile::Uniform, SourceProfile::Substrate, SourceProfile::Exponential { depth: finite(width) }] {
            let rows = [
                modulation::modulation(&never, &stack, &[0.5], &[theta], sampling),
                modulation::emission(&never, &stack, profile, &[theta], sampling),
            ];
            prop_assert!(rows.iter().flatten().flatten().all(|row| row.bands.iter().chain(&row.rgb).all(|x| !x.is_nan())));
            if let Ok(emission) = emission::radiance(&stack, profile, seed, 2, &waves, &[theta]) {
                prop_assert!(emission.iter().flatten().all(|x| !x.is_nan()));
            }
        }
        if let Ok(whole) = intensity::mixed(&stack, |layer| layer.material == 1, wavelength, theta, pol) {
            prop_assert!(whole.reflectance.is_finite() && whole.transmittance.is_finite() && whole.absorptance.is_finite(), "{whole:?}");
        }
        let line = line::Line { shape: line::Shape::Lorentzian, width: if tame { tamed(width, 1e-9) } else { finite(width) } };
        if let Ok(mean) = line::mean(&stack, line, &[wavelength], &[theta], 1.0) {
            prop_assert!(mean.reflectance.iter().flatten().flatten().all(|x| x.is_finite()));
            prop_assert!(mean.absorptance.iter().flatten().flatten().all(|a| *a >= 0.0));
        }
    }

    /// Colours of any finite numbers, none included.
    #[test]
    fn no_finite_reflectance_panics_a_colour(values in prop::collection::vec(any::<f64>(), 0..40), count in 0..5usize) {
        let finite: Vec<f64> = values.into_iter().filter(|x| x.is_finite()).collect();
        let xyz = colour::xyz(&finite);
        let rgb = colour::linear_srgb(xyz);
        let _ = colour::srgb_bytes(rgb);
        let _ = colour::delta_e_2000(colour::lab(xyz), rgb);
        let _ = colour::wavelengths(count);
    }
}
