//! Each effect of the walk against a computation that shares no code with it.

use bake_brdf::bake::{self, Bands, Observer, Request, Shard, snapshot};
use bake_brdf::effects::{Effect, Effects};
use bake_brdf::options::{Options, Target};
use bake_brdf::recipe::Recipe;
use lut_io::exr_file;
use lut_io::table::{Component, Table};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use thinfilm::{Incidence, Layer, Material, Multilayer, Polarisation, Run};

const PATHS: u64 = 200_000;
const ANGLES_DEG: [f64; 4] = [0.0, 30.0, 60.0, 80.0];

fn walked(text: &str, effects: &[Effect]) -> Table {
    let request = request(text, Target::Paths(PATHS), 3, effects);
    bake::walk(&request, &Bands::own(&request.recipe), &Observer::idle(), None).expect("it bakes")
}

/// A request for exactly these effects.
fn request(text: &str, target: Target, seed: u64, effects: &[Effect]) -> Request {
    let recipe = Recipe::from_json(text).expect("a valid recipe");
    let effects = effects.iter().copied().collect();
    let incident_deg = Some(ANGLES_DEG.to_vec());
    let effects_listed = Effects::Listed(effects);
    let options = Options { effects: effects_listed, incident_deg, target, seed, ..Options::default() };
    Request::of(recipe, effects, options).unwrap()
}

fn bands_of(request: &Request) -> Bands {
    request.bands().expect("bands")
}

/// Reflectance of films or faces one under another, intensities added: the star product.
fn star(faces: &[f64]) -> f64 {
    faces.iter().rev().fold(0.0, |below, &r| r + (1.0 - r) * (1.0 - r) * below / (1.0 - r * below))
}

/// (s, p) reflectances, by wave optics, of `film` (index, nm; none for a bare face) between two indices; the ray has the
/// angle θ in vacuum.
fn by_waves(above: f64, film: Option<(f64, f64)>, below: f64, theta: f64) -> [f64; 2] {
    let metres = 550e-9;
    let index = |n: f64| Material::constant(n).index(metres).expect("an index");
    let layer = film.map(|(n, nm)| Layer { index: index(n), thickness: nm * 1e-9 });
    let waves = Multilayer {
        ambient: index(above),
        runs: layer.into_iter().map(|layer| Run { unit: vec![layer], repeat: 1 }).collect(),
        substrate: index(below),
    };
    Polarisation::BOTH.map(|polarisation| {
        let response = waves.solve(metres, Incidence::InPlane(theta.sin()), polarisation);
        response.expect("it solves").reflectance
    })
}

/// Within five standard errors (6e-7 for one of the comparisons) of a share of the paths.
fn agrees(table: &Table, expected: impl Fn(f64) -> f64) {
    for row in &table.meta().per_incidence {
        let expected = expected(row.theta_i_deg.to_radians());
        let error = (expected * (1.0 - expected) / PATHS as f64).sqrt();
        let found = row.albedo;
        assert!(
            (found - expected).abs() < 5.0 * error,
            "{}°: {found} ± {error}, expected {expected}",
            row.theta_i_deg
        );
    }
}

const SMOOTH: &str = r#"{"stack":{"layers":60},"facets":{"slope_sd_deg":0}}"#;
const LOBE: [Effect; 3] = [Effect::Surface, Effect::Blur, Effect::Azimuth];

#[test]
fn a_smooth_polarised_bake_is_the_mean_of_the_star_products_of_s_and_p() {
    let table = walked(SMOOTH, &[&LOBE[..], &[Effect::Polarisation]].concat());
    assert!(table.meta().effects.contains(&"polarisation".to_owned()));
    let pile = |theta: f64, i: usize| {
        let top = by_waves(1.0, None, 1.53, theta)[i];
        let inner = by_waves(1.53, None, 1.43, theta)[i];
        star(&[&[top][..], &[inner; 60]].concat())
    };
    agrees(&table, |theta| 0.5 * (pile(theta, 0) + pile(theta, 1)));
    // Unpolarised light at every event is another answer: at 60° by more than ten standard errors.
    let theta = 60_f64.to_radians();
    let mean = |pair: [f64; 2]| 0.5 * (pair[0] + pair[1]);
    let unpolarised = star(
        &[&[mean(by_waves(1.0, None, 1.53, theta))][..], &[mean(by_waves(1.53, None, 1.43, theta)); 60]]
            .concat(),
    );
    let tracked = 0.5 * (pile(theta, 0) + pile(theta, 1));
    assert!(
        (unpolarised - tracked).abs() > 10.0 * (0.16_f64 * 0.84 / PATHS as f64).sqrt(),
        "{unpolarised} {tracked}"
    );
    agrees(&walked(SMOOTH, &LOBE), |theta| {
        let faces = [mean(by_waves(1.0, None, 1.53, theta)), mean(by_waves(1.53, None, 1.43, theta))];
        star(&[&faces[..1], &[faces[1]; 60]].concat())
    });
}

#[test]
fn a_smooth_bake_of_coherent_sheets_is_the_star_product_of_films() {
    let film = Some((1.43, 25.0));
    let pile = |theta: f64, i: usize| {
        let top = by_waves(1.0, None, 1.53, theta)[i];
        star(&[&[top][..], &[by_waves(1.53, film, 1.53, theta)[i]; 30]].concat())
    };
    let tracked = walked(SMOOTH, &[&LOBE[..], &[Effect::Polarisation, Effect::CoherentSheets]].concat());
    agrees(&tracked, |theta| 0.5 * (pile(theta, 0) + pile(theta, 1)));
    let mean = |pair: [f64; 2]| 0.5 * (pair[0] + pair[1]);
    let unpolarised = walked(SMOOTH, &[&LOBE[..], &[Effect::CoherentSheets]].concat());
    agrees(&unpolarised, |theta| {
        let top = mean(by_waves(1.0, None, 1.53, theta));
        star(&[&[top][..], &[mean(by_waves(1.53, film, 1.53, theta)); 30]].concat())
    });
    // An odd number of layers ends on aragonite, whose face with the substrate is no sheet.
    let text = r#"{"stack":{"layers":61,"substrate":{"n":1.8}},"facets":{"slope_sd_deg":0}}"#;
    agrees(&walked(text, &[&LOBE[..], &[Effect::CoherentSheets]].concat()), |theta| {
        let ends = [mean(by_waves(1.0, None, 1.53, theta)), mean(by_waves(1.53, None, 1.8, theta))];
        star(&[&ends[..1], &[mean(by_waves(1.53, film, 1.53, theta)); 30], &ends[1..]].concat())
    });
}

#[test]
fn absorption_follows_beer_and_wave_optics() {
    let text = r#"{"stack":{"explicit":[{"n":1.0,"k":2e-6,"thickness_nm":2e7}],"substrate":{"n":1.0}},"facets":{"slope_sd_deg":0}}"#;
    let table = walked(text, &[&LOBE[..], &[Effect::Absorption]].concat());
    let recipe = Recipe::from_json(text).expect("valid");
    let waves = recipe.film_stack().at(550e-9).expect("an index at 550 nm");
    for row in &table.meta().per_incidence {
        let theta = row.theta_i_deg.to_radians();
        let beer = (-4.0 * std::f64::consts::PI * 2e-6 * 2e7 / 550.0 / theta.cos()).exp();
        // Every path is weighted alike up to τ = 6: exact but for rounding.
        assert!((row.transmitted - beer).abs() < 1e-5, "{row:?} {beer}");
        let by_waves =
            waves.solve(550e-9, Incidence::Angle(theta), Polarisation::BOTH[0]).expect("it solves");
        // n + ik differs from n by k² and the refraction of a complex index.
        assert!((row.transmitted - by_waves.transmittance).abs() < 2e-3, "{row:?} {by_waves:?}");
    }
}

/// Aragonite that disperses far more than conchiolin, so that what an interface reflects depends on the wavelength.
const DISPERSIVE: &str = r#"{"stack":{"layers":30,"aragonite":{"n":{"cauchy":[1.50,0.015]}},"conchiolin":{"n":1.43}},"look":{"coherence":0.5}}"#;

fn dispersive(target: Target, effects: &[Effect]) -> Request {
    request(DISPERSIVE, target, 7, effects)
}

/// Every further band of a table against a bake of its wavelength alone: the same bits, lobes and statistics.
fn bands_are_single_bakes(whole: &Table, request: &Request, bake: impl Fn(&Request) -> Table) {
    let further = whole.further_bands().expect("valid bands");
    assert!(further.len() >= 2, "{} further bands", further.len());
    let own = specimen::changed(whole, |parts| {
        parts.meta.dispersion = None;
        parts.bands.clear();
    });
    for band in std::iter::once(&own).chain(&further) {
        let mut alone = request.at_wavelength(band.meta().wavelength_nm);
        alone.effects = alone.effects.without(Effect::Dispersion);
        let alone = bake(&alone);
        assert!(alone.bands().is_empty());
        assert_eq!(Component::ALL.map(|part| band.lobe(part)), Component::ALL.map(|part| alone.lobe(part)));
        assert_eq!(band.meta().per_incidence, alone.meta().per_incidence);
        assert_eq!(band.meta().surface_model, alone.meta().surface_model);
        assert_eq!(band.meta().solver_settings, alone.meta().solver_settings);
        assert_eq!(band.meta().accuracy, alone.meta().accuracy);
        let colours =
            |table: &Table| table.meta().spectra.clone().and_then(|s| s.coherent).expect("coherent");
        for (found, expected) in colours(band).modulation.iter().zip(colours(&alone).modulation) {
            // Seven digits are stored.
            let near = |(a, b): (&f64, &f64)| (a - b).abs() <= 1e-5 * b.abs();
            assert!(found.iter().zip(&expected).all(near), "{} nm: M", band.meta().wavelength_nm);
        }
    }
    // They are not all the same lobe.
    let albedos: Vec<f64> = further.iter().map(|band| band.meta().per_incidence[1].albedo).collect();
    assert!((albedos[0] / albedos[albedos.len() - 1] - 1.0).abs() > 0.05, "{albedos:?}");
    // And survive the file.
    let read = exr_file::decode(&exr_file::encode(whole).expect("valid")).expect("it reads back");
    assert_eq!(&read, whole);
}

const DISPERSED: [Effect; 5] =
    [Effect::Surface, Effect::Blur, Effect::Azimuth, Effect::Dispersion, Effect::Coherent];

#[test]
fn every_band_of_a_dispersed_walk_is_the_walk_of_that_wavelength() {
    for target in [Target::Paths(30_000), Target::AccuracyPercent(3.0)] {
        let request = dispersive(target, &DISPERSED);
        let walk = |request: &Request| {
            bake::walk(request, &bands_of(request), &Observer::idle(), None).expect("it bakes")
        };
        bands_are_single_bakes(&walk(&request), &request, walk);
    }
}

#[test]
fn every_band_of_a_dispersed_solution_is_the_solution_of_that_wavelength() {
    let request = dispersive(Target::AccuracyPercent(1.0), &DISPERSED);
    let solve = |request: &Request| bake::doubling(request, &bands_of(request)).expect("it solves");
    bands_are_single_bakes(&solve(&request), &request, solve);
}

#[test]
fn shards_of_a_dispersed_walk_merge_into_its_bits() {
    let request = dispersive(Target::Paths(40_000), &DISPERSED);
    let whole = bake::walk(&request, &bands_of(&request), &Observer::idle(), None).expect("it bakes");
    let shard = |index| {
        let shard = Shard { index, count: 3 };
        (index.to_string(), snapshot::walk_shard(&request, shard, &Observer::idle()).expect("it walks"))
    };
    assert_eq!(snapshot::merge(&[shard(2), shard(3), shard(1)]).expect("it merges"), whole);
    // Again from its own metadata.
    let again = bake::reproduce::bake_again(whole.meta(), &Observer::idle()).expect("it bakes again");
    assert_eq!(bake::reproduce::differences(&whole, &again), []);
}

/// Irregular thicknesses, drawn here layer by layer and solved one stack at a time.
#[test]
fn irregularity_is_the_mean_of_explicit_stacks() {
    const LAYERS: usize = 20;
    const DRAWS: usize = 1500;
    const BANDS: [usize; 5] = [5, 17, 33, 50, 70];
    const DEGREES: [f64; 3] = [0.0, 30.0, 60.0];
    let (means, sds) = ([450.0, 25.0], [30.0, 4.0]);
    let text = r#"{"stack":{"layers":20,"aragonite":{"thickness_nm":450,"thickness_sd_nm":30},"conchiolin":{"thickness_nm":25,"thickness_sd_nm":4}},"facets":{"slope_sd_deg":0}}"#;
    let baked = |irregular: bool| {
        let effects = [Effect::Surface, Effect::Blur, Effect::Azimuth, Effect::Coherent];
        let effects = effects.into_iter().chain(irregular.then_some(Effect::Irregularity));
        let effects: Vec<Effect> = effects.collect();
        let request = request(text, Target::AccuracyPercent(1.0), 1, &effects);
        let table = bake::doubling(&request, &bands_of(&request)).expect("a closed form");
        let spectra = table.meta().spectra.clone().expect("colours");
        (spectra.wavelength_nm, spectra.coherent.expect("coherent"))
    };
    let index = |n: f64| Material::constant(n).index(550e-9).expect("an index");
    let (wavelength_nm, irregular) = baked(true);
    let (_, regular) = baked(false);
    let mut random = StdRng::seed_from_u64(20);
    let mut normal = || {
        // Box and Muller.
        let (u, v): (f64, f64) = (random.random(), random.random());
        (-2.0 * (1.0 - u).ln()).sqrt() * (std::f64::consts::TAU * v).cos()
    };
    let (mut sum, mut square) = ([[0.0; BANDS.len()]; DEGREES.len()], [[0.0; BANDS.len()]; DEGREES.len()]);
    for _ in 0..DRAWS {
        let layer = |i: usize, z: f64| Layer {
            index: index([1.53, 1.43][i % 2]),
            thickness: 1e-9 * (means[i % 2] + sds[i % 2] * z).max(0.0),
        };
        let stack = Multilayer {
            ambient: index(1.0),
            runs: vec![Run { unit: (0..LAYERS).map(|i| layer(i, normal())).collect(), repeat: 1 }],
            substrate: index(1.53),
        };
        for (a, degrees) in DEGREES.iter().enumerate() {
            for (b, band) in BANDS.iter().enumerate() {
                let mut mean = 0.0;
                for step in [-1.875, -0.625, 0.625, 1.875] {
                    let metres = 1e-9 * (wavelength_nm[*band] + step);
                    for polarisation in Polarisation::BOTH {
                        let theta = Incidence::Angle(degrees.to_radians());
                        mean +=
                            stack.solve(metres, theta, polarisation).expect("it solves").reflectance / 8.0;
                    }
                }
                sum[a][b] += mean;
                square[a][b] += mean * mean;
            }
        }
    }
    let draws = DRAWS as f64;
    // The bake's own ensemble has at least 15 members at this cost.
    let z = |coherent: &lut_io::spectra::Coherent, a: usize, b: usize| {
        let angle = coherent.theta_deg.iter().position(|t| *t == DEGREES[a]).expect("a stored angle");
        let found = coherent.modulation[angle][BANDS[b]] * coherent.incoherent[angle];
        let mean = sum[a][b] / draws;
        let variance = square[a][b] / draws - mean * mean;
        (found - mean) / (variance * (1.0 / 15.0 + 1.0 / draws)).sqrt()
    };
    let all = || (0..DEGREES.len()).flat_map(|a| (0..BANDS.len()).map(move |b| (a, b)));
    let rms = |coherent: &lut_io::spectra::Coherent| {
        (all().map(|(a, b)| z(coherent, a, b).powi(2)).sum::<f64>() / 15.0).sqrt()
    };
    for (a, b) in all() {
        let z = z(&irregular, a, b);
        // 15 correlated draws of a fixed seed; 4.5 has p = 1e-4 for all of them.
        assert!(z.abs() < 4.5, "{}° band {}: z {z}", DEGREES[a], BANDS[b]);
    }
    assert!(rms(&irregular) < 1.6, "{}", rms(&irregular));
    assert!(rms(&regular) > 2.0 * rms(&irregular), "a regular stack is another: {}", rms(&regular));
}
