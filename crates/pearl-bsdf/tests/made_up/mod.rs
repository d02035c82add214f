//! What the tests add to made-up tables, and what they ask of them.
#![allow(dead_code)] // each test program uses a part

use lut_io::dispersion::{Band, Dispersion};
use lut_io::spectra::{Coherent, ColourError, Emission, Spectra};
use lut_io::table::{Component, Table};
use pearl_bsdf::{Components, Controls, Direction};
use rand::RngExt as _;
use rand::rngs::StdRng;

/// Strong, wavy interference colours: M up to 1/R_incoherent = 2.5, Ê between 0 and 2.
pub(crate) fn with_spectra(table: Table) -> Table {
    with_waves(table, 0.11)
}

/// The same with waves of another pitch, radians a degree.
pub(crate) fn with_waves(table: Table, pitch: f64) -> Table {
    let theta_deg: Vec<f64> = (0..=30).map(|i| 3.0 * f64::from(i)).collect();
    let wavelength_nm: Vec<f64> = (0..7).map(|i| 400.0 + 50.0 * f64::from(i)).collect();
    let wave = |theta: f64, k: f64| (pitch * theta + 2.1 * k).sin();
    // 1/R_incoherent falls to 1 at grazing.
    let most = |theta: f64| 1.0 + 1.5 * (1.0 - (theta / 90.0).powi(4));
    let rows = |value: &dyn Fn(f64, f64) -> f64| -> Vec<Vec<f64>> {
        theta_deg.iter().map(|t| (0..7).map(|k| value(*t, f64::from(k))).collect()).collect()
    };
    let rgb = |value: &dyn Fn(f64, f64) -> f64| -> Vec<[f64; 3]> {
        theta_deg.iter().map(|t| [0.0, 1.0, 2.0].map(|k| value(*t, k))).collect()
    };
    let modulation = |t: f64, k: f64| most(t) * 0.5 * (1.0 + wave(t, k));
    let emission = |t: f64, k: f64| 1.0 + wave(0.7 * t, k + 0.3);
    let coherent = Coherent {
        modulation: rows(&modulation),
        modulation_rgb: rgb(&modulation),
        incoherent: theta_deg.iter().map(|t| 1.0 / most(*t)).collect(),
        theta_deg: theta_deg.clone(),
        delta_e00: ColourError::default(),
    };
    let radiance = (rows(&emission), rgb(&emission));
    let emission = Emission {
        radiance: radiance.0,
        radiance_rgb: radiance.1,
        theta_deg,
        delta_e00: ColourError::default(),
    };
    let spectra =
        Spectra { wavelength_nm, coherent: Some(coherent), emission: Some(emission), thickness: None };
    specimen::changed(&table, |parts| parts.meta.spectra = Some(spectra.rounded()))
}

/// A table at 550 nm with further lobes at 400 and 700 nm, whose interior is 1.2 and 0.7 times as bright; and those bands.
pub(crate) fn dispersed(table: Table) -> (Table, Vec<Table>) {
    let band = |nm: f64, factor: f32| {
        specimen::changed(&table, |parts| {
            parts.meta.wavelength_nm = nm;
            parts.lobes[0].value.iter_mut().for_each(|value| *value *= factor);
            for summary in &mut parts.meta.per_incidence {
                let interior = summary.albedo - summary.surface;
                summary.albedo = summary.surface + f64::from(factor) * interior;
                summary.transmitted = 1.0 - summary.albedo;
            }
        })
    };
    let bands = vec![band(400.0, 1.2), band(700.0, 0.7)];
    let coherent = table.meta().spectra.as_ref().and_then(|spectra| spectra.coherent.as_ref());
    let section = |band: &Table| {
        let meta = band.meta().clone();
        Band {
            wavelength_nm: meta.wavelength_nm,
            solver_settings: meta.solver_settings,
            accuracy: meta.accuracy,
            surface_model: meta.surface_model,
            incoherent: coherent.map(|coherent| coherent.incoherent.clone()),
            per_incidence: meta.per_incidence,
        }
    };
    let whole = specimen::changed(&table, |parts| {
        parts.meta.wavelength_nm = 550.0;
        parts.meta.dispersion = Some(Dispersion {
            interpolation_percent: 0.5,
            rgb_weights: vec![[0.3, 0.7, 0.4], [-0.1, 0.2, 0.7], [0.8, 0.1, -0.1]],
            bands: bands.iter().map(section).collect(),
        });
        parts.bands = bands.iter().map(|band| Component::ALL.map(|part| band.lobe(part).clone())).collect();
    });
    (whole, bands)
}

pub(crate) fn direction(theta: f64, phi: f64) -> Direction {
    [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
}

pub(crate) fn random_controls(random: &mut StdRng) -> Controls {
    // Ends of the ranges are where things go wrong: a third of the draws.
    let mut unit = || match random.random_range(0..6) {
        0 => 0.0,
        1 => 1.0,
        _ => random.random::<f64>(),
    };
    Controls {
        depth: unit(),
        brightness: unit(),
        coherence: unit(),
        body_rgb: [unit(), unit(), unit()],
        tint_rgb: [unit(), unit(), unit()],
        thickness: 1.0,
        components: Components::ALL,
    }
}
