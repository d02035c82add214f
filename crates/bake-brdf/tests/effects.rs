//! Each effect of the walk against a computation that shares no code with it.

use bake_brdf::bake::{self, Observer, Request, Target};
use bake_brdf::effects::{Effect, EffectSet};
use bake_brdf::recipe::Recipe;
use lut_io::table::Table;
use thinfilm::{Incidence, Layer, Material, Multilayer, Polarisation, Run};
use transport::walk::lanes::Precision;

const PATHS: u64 = 200_000;
const ANGLES_DEG: [f64; 4] = [0.0, 30.0, 60.0, 80.0];

fn walked(text: &str, effects: &[Effect]) -> Table {
    let request = Request {
        recipe: Recipe::from_json(text).expect("a valid recipe"),
        effects: effects.iter().copied().collect::<EffectSet>(),
        listed: true,
        incident_deg: ANGLES_DEG.to_vec(),
        target: Target::Paths(PATHS),
        seed: 3,
        event_cap: bake::DEFAULT_EVENT_CAP,
        precision: Precision::Auto,
    };
    bake::walk(&request, &Observer::idle(), None).expect("it bakes")
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
    for row in &table.meta.per_incidence {
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
    assert!(table.meta.effects.contains(&"polarisation".to_owned()));
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
    let text = r#"{"stack":{"explicit":[{"n":1.0,"k":0.002,"thickness_nm":20000}],"substrate":{"n":1.0}},"facets":{"slope_sd_deg":0}}"#;
    let table = walked(text, &[&LOBE[..], &[Effect::Absorption]].concat());
    let recipe = Recipe::from_json(text).expect("valid");
    let waves = recipe.film_stack().at(550e-9).expect("an index at 550 nm");
    for row in &table.meta.per_incidence {
        let theta = row.theta_i_deg.to_radians();
        let beer = (-4.0 * std::f64::consts::PI * 0.002 * 20_000.0 / 550.0 / theta.cos()).exp();
        // Every path is weighted alike up to τ = 6: exact but for rounding.
        assert!((row.transmitted - beer).abs() < 1e-5, "{row:?} {beer}");
        let by_waves =
            waves.solve(550e-9, Incidence::Angle(theta), Polarisation::BOTH[0]).expect("it solves");
        // n + ik differs from n by k² and the refraction of a complex index, some 1e-4 here.
        assert!((row.transmitted - by_waves.transmittance).abs() < 2e-3, "{row:?} {by_waves:?}");
    }
}
