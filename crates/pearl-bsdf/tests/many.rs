//! Many pairs at a call: the bits of one pair at a call, whatever the table, the controls and the directions.

mod made_up;

use lut_io::Parts;
use lut_io::axis::ExitAxis;
use lut_io::symmetrise;
use lut_io::table::Table;
use made_up::{direction, dispersed, random_controls, with_spectra};
use pearl_bsdf::{Components, Controls, Direction, Evaluation, PearlBsdf, Prepared, Sample};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use std::f64::consts::{FRAC_PI_2, TAU};
use std::sync::Arc;

/// Of both kinds: plain, with incidences at odd angles and lobes narrow or wide, reciprocal, and of several bands.
fn tables(random: &mut StdRng) -> Vec<Table> {
    let every = |step: f64| -> Vec<f64> { (0..=(90.0 / step) as u32).map(|i| step * f64::from(i)).collect() };
    let odd = [3.0, 3.1, 20.0, 47.5, 88.0, 89.0];
    let axes = |width: f64| {
        [ExitAxis::Plane { cells: 96, width }, ExitAxis::Space { theta_cells: 32, phi_cells: 24, width }]
    };
    let mut tables = Vec::new();
    for axis in axes(4f64.to_radians()) {
        let plain = specimen::table(&every(7.5), axis);
        tables.push(symmetrise::symmetrised(&plain).unwrap());
        tables.push(dispersed(with_spectra(plain.clone())).0);
        tables.push(plain);
    }
    for degrees in [0.02, 0.3 + random.random::<f64>(), 14.0] {
        // The closed form of interface 0 gets facets as wide as the lobe: at 14° some are cut off at every incidence.
        for (axis, incidences) in axes(f64::to_radians(degrees)).into_iter().zip([&odd[..], &every(15.0)]) {
            let table = specimen::table(incidences, axis);
            let wide = |parts: &mut Parts| parts.meta.surface_model.slope_sd = axis.width();
            tables.push(with_spectra(specimen::changed(&table, wide)));
        }
    }
    tables
}

/// Directions of every kind: above the horizon, close to it and to the pole, below, opposite to the one before, and none at all.
fn directions(random: &mut StdRng, count: usize) -> Vec<Direction> {
    let mut directions: Vec<Direction> = Vec::new();
    for _ in 0..count {
        let phi = TAU * random.random::<f64>();
        let last = directions.last().copied().unwrap_or([0.0, 0.0, 1.0]);
        directions.push(match random.random_range(0..16) {
            0 => direction(FRAC_PI_2 - 1e-3 * random.random::<f64>(), phi),
            1 => direction(FRAC_PI_2 - 10f64.powf(-15.0 * random.random::<f64>()), phi),
            2 => direction(10f64.powf(-18.0 * random.random::<f64>()), phi),
            3 => [0.0, 0.0, 1.0],
            4 => direction(FRAC_PI_2 + random.random::<f64>(), phi),
            5 => [-last[0], -last[1], last[2]],
            6 => [1.0, 0.0, 1e-200],
            7 => [-1.0, 0.0, 1e-200],
            8 => [f64::NAN, 0.0, 1.0],
            9 => [0.0, 0.0, f64::INFINITY],
            10 => direction(0.5, phi).map(|x| 1.02 * x),
            _ => direction(FRAC_PI_2 * random.random::<f64>(), phi),
        });
    }
    directions
}

fn controls(random: &mut StdRng, table: &Table) -> Controls {
    let names = Components::NAMES.into_iter().filter(|_| random.random::<f64>() < 0.8);
    let components = Components::from_names(names.collect::<Vec<_>>()).unwrap();
    let plain = Controls::of(table.meta());
    let drawn = random_controls(random);
    // Without interference colours there is nothing to ask for.
    let (depth, coherence) =
        (drawn.depth * f64::from(plain.depth > 0.0), drawn.coherence * f64::from(plain.coherence > 0.0));
    Controls { depth, coherence, components, ..drawn }
}

#[test]
fn many_pairs_at_a_call_have_the_bits_of_one_at_a_call() {
    let mut random = StdRng::seed_from_u64(31);
    for table in tables(&mut random) {
        let prepared = Arc::new(Prepared::new(table.clone()).unwrap());
        for _ in 0..3 {
            let bsdf = PearlBsdf::new(prepared.clone(), controls(&mut random, &table)).unwrap();
            for count in [0, 1, 5, 16, 17, 700] {
                let (wi, wo) = (directions(&mut random, count), directions(&mut random, count));
                let numbers: Vec<[f64; 3]> = (0..count).map(|_| random.random()).collect();
                assert_same(&bsdf, &wi, &wo, &numbers);
            }
        }
    }
}

fn assert_same(bsdf: &PearlBsdf, wi: &[Direction], wo: &[Direction], numbers: &[[f64; 3]]) {
    let mut values = vec![Evaluation::default(); wi.len()];
    let mut seen = values.clone();
    let mut densities = vec![f64::NAN; wi.len()];
    let mut samples = vec![None; wi.len()];
    bsdf.eval_many(wi, wo, &mut values);
    bsdf.eval_seen_many(wi, wo, &mut seen);
    bsdf.pdf_many(wi, wo, &mut densities);
    bsdf.sample_many(wi, numbers, &mut samples);
    let mut looked_at = vec![None; wi.len()];
    bsdf.sample_seen_many(wi, numbers, &mut looked_at);
    for (k, (&wi, &wo)) in wi.iter().zip(wo).enumerate() {
        assert_eq!(bits(&values[k]), bits(&bsdf.eval(wi, wo)), "eval {wi:?} {wo:?}");
        assert_eq!(bits(&seen[k]), bits(&bsdf.eval_seen(wi, wo)), "eval_seen {wi:?} {wo:?}");
        assert_eq!(densities[k].to_bits(), bsdf.pdf(wi, wo).to_bits(), "pdf {wi:?} {wo:?}");
        let [u, v, w] = numbers[k];
        let of_sample = |sample: Option<Sample>| {
            sample.map(|s| (s.wo.map(f64::to_bits), s.pdf.to_bits(), bits(&s.value)))
        };
        let sample = bsdf.sample(wi, u, v, w);
        assert_eq!(of_sample(samples[k]), of_sample(sample), "sample {wi:?} {u} {v} {w}");
        let sample = sample.map(|s| Sample { value: bsdf.eval_seen(wi, s.wo), ..s });
        assert_eq!(of_sample(looked_at[k]), of_sample(sample), "sample_seen {wi:?} {u} {v} {w}");
    }
}

fn bits(value: &Evaluation) -> [[u64; 3]; 4] {
    value.parts().map(|rgb| rgb.map(f64::to_bits))
}

#[test]
#[should_panic(expected = "slices of 2, 1 and 2 do not go together")]
fn slices_of_several_lengths_are_refused() {
    let table = specimen::plane(&[0.0, 45.0, 90.0], 48);
    let controls = Controls::of(table.meta());
    let bsdf = PearlBsdf::from_table(table, controls).unwrap();
    bsdf.pdf_many(&[[0.0, 0.0, 1.0]; 2], &[[0.0, 0.0, 1.0]], &mut [0.0; 2]);
}
