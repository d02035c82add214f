//! Arrays of a prepared table: complete, finite, and enough for every look.

mod made_up;

use lut_io::table::Table;
use made_up::{direction, dispersed, random_controls, with_spectra};
use pearl_bsdf::{Array, BsdfError, PearlBsdf, Prepared};
use rand::rngs::StdRng;
use rand::{RngExt as _, SeedableRng as _};
use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

fn tables() -> Vec<Table> {
    let incidences: Vec<f64> = (0..=9).map(|i| 10.0 * f64::from(i)).collect();
    let (plane, space) = (specimen::plane(&incidences, 48), specimen::space(&incidences, 32, 16));
    vec![plane.clone(), with_spectra(plane.clone()), dispersed(with_spectra(plane)).0, with_spectra(space)]
}

fn by_name(arrays: &[Array]) -> HashMap<&str, &Array> {
    arrays.iter().map(|array| (array.name, array)).collect()
}

#[test]
fn every_array_has_a_name_of_its_own_and_as_many_finite_numbers_as_its_shape_says() {
    for table in tables() {
        let arrays = Prepared::new(table).unwrap().arrays();
        assert_eq!(by_name(&arrays).len(), arrays.len());
        for Array { name, shape, values, .. } in &arrays {
            assert_eq!(values.len(), shape.iter().product::<usize>(), "{name} {shape:?}");
            assert!(values.iter().all(|x| x.is_finite()), "{name}");
        }
    }
}

#[test]
fn what_is_not_wanted_any_more_is_not_prepared() {
    let table = specimen::plane(&[0.0, 60.0], 32);
    for spectral in [false, true] {
        let stopped = Prepared::unless(&AtomicBool::new(true), table.clone(), spectral);
        assert!(matches!(stopped, Err(BsdfError::Stopped)));
        assert!(Prepared::unless(&AtomicBool::new(false), table.clone(), spectral).is_ok());
    }
}

#[test]
fn arrays_have_an_entry_a_band_a_channel_a_span_and_a_cell() {
    let incidences = [0.0, 30.0, 60.0, 80.0];
    let (table, _) = dispersed(with_spectra(specimen::space(&incidences, 32, 16)));
    let arrays = Prepared::new(table).unwrap().arrays();
    let shape = |name: &str| by_name(&arrays)[name].shape.clone();
    assert_eq!(shape("cells"), [3, 4, 16, 32, 4]);
    assert_eq!(shape("cumulative"), [3, 2, 4, 16, 32]);
    // Between four incidences, and from the last to 90°.
    assert_eq!(shape("span_start"), [5]);
    assert_eq!(shape("span_curves")[..2], [3, 4]);
    assert_eq!(shape("albedo_spectral")[..3], [3, 7, 3]);
    assert_eq!(shape("modulation_rgb")[..2], [3, 3]);
    // The table's own band comes first.
    assert_eq!(by_name(&arrays)["wavelength_nm"].values, [550.0, 400.0, 700.0]);
}

/// What is not coloured is what is coloured by 1, and what is left is what the albedos leave.
#[test]
fn what_is_left_of_the_light_is_one_less_the_albedos() {
    for table in tables() {
        let arrays = Prepared::new(table).unwrap().arrays();
        let arrays = by_name(&arrays);
        for (albedos, rests) in
            [("albedo_plain", "rest_plain"), ("albedo_rgb", "rest_rgb"), ("albedo_spectral", "rest_spectral")]
        {
            let nodes = arrays["mean_weight"].values.len();
            for (albedos, rest) in
                arrays[albedos].values.chunks(3 * nodes).zip(arrays[rests].values.chunks(nodes))
            {
                for node in 0..nodes {
                    let sum: f32 = (0..3).map(|lobe| albedos[lobe * nodes + node]).sum();
                    assert!((sum + rest[node] - 1.0).abs() < 1e-6, "{rests} {node}: {sum} {}", rest[node]);
                }
            }
        }
    }
}

#[test]
fn a_look_on_a_prepared_table_is_that_look_on_the_table() {
    let mut random = StdRng::seed_from_u64(17);
    let table = dispersed(with_spectra(specimen::plane(&[0.0, 20.0, 45.0, 70.0, 90.0], 48))).0;
    let prepared = Arc::new(Prepared::new(table.clone()).unwrap());
    for _ in 0..2 {
        let controls = random_controls(&mut random);
        let shared = PearlBsdf::new(Arc::clone(&prepared), controls).unwrap();
        let alone = PearlBsdf::from_table(table.clone(), controls).unwrap();
        for _ in 0..100 {
            let wi = direction(1.5 * random.random::<f64>(), 6.0 * random.random::<f64>());
            let wo = direction(1.5 * random.random::<f64>(), 6.0 * random.random::<f64>());
            assert_eq!(shared.eval_pdf(wi, wo), alone.eval_pdf(wi, wo));
            assert_eq!(shared.eval_at(wi, wo, 480.0), alone.eval_at(wi, wo, 480.0));
        }
    }
}
