//! Reciprocal tables: the same both ways wherever they are read, and as bright as before.

use lut_io::Table;
use lut_io::lobe::Interpolant;
use lut_io::measure;
use lut_io::reciprocal::KEY;
use lut_io::reciprocity;
use lut_io::symmetrise;
use lut_io::table::Component;

const EVERY_5_DEG: [f64; 19] =
    [0., 5., 10., 15., 20., 25., 30., 35., 40., 45., 50., 55., 60., 65., 70., 75., 80., 85., 90.];

fn tables() -> [Table; 2] {
    [specimen::plane(&EVERY_5_DEG, 64), specimen::space(&EVERY_5_DEG, 32, 16)]
}

/// Worst |F(a → b) − F(b → a)| over the larger of both, F = f·cos θi·cos θo, off the table's nodes.
fn worst(lobe: &Interpolant) -> f64 {
    let angles: Vec<f64> = (0..30).map(|k| (0.37 + 3.07 * f64::from(k)).to_radians()).collect();
    let mut worst = 0f64;
    for (a, b) in angles.iter().flat_map(|a| angles.iter().map(move |b| (*a, *b))) {
        for phi in [0.0, 0.3, 2.0, 3.1] {
            for component in Component::ALL {
                let there = lobe.eval(component, a, b, phi) * a.cos();
                let back = lobe.eval(component, b, a, phi) * b.cos();
                if there.max(back) > 0.0 {
                    worst = worst.max((there - back).abs() / there.max(back));
                }
            }
        }
    }
    worst
}

#[test]
fn a_table_made_reciprocal_is_the_same_both_ways_between_its_nodes_too() {
    for table in tables() {
        assert!(worst(&Interpolant::new(table.clone())) > 0.1, "the table was reciprocal already");
        let made = Interpolant::new(symmetrise::symmetrised(&table).unwrap());
        // A few roundings of f64.
        assert!(worst(&made) < 1e-12, "{}", worst(&made));
        let angles: Vec<f64> = (0..45).map(|k| (2.0 * f64::from(k) + 0.9).to_radians()).collect();
        assert!(reciprocity::defect(&made, &angles, 0.0).total < 1e-12);
        assert!(reciprocity::defect(&Interpolant::new(table), &angles, 0.0).total > 1e-3);
    }
}

#[test]
fn every_lobe_keeps_its_share_of_the_light() {
    for table in tables() {
        let made = symmetrise::symmetrised(&table).unwrap();
        let axis = made.meta().exit_axis;
        for (i, summary) in made.meta().per_incidence.iter().enumerate() {
            assert_eq!(summary.albedo, table.meta().per_incidence[i].albedo);
            let width = summary.azimuth_width_deg.to_radians();
            let weights = measure::reading_weights(&axis, summary.theta_i_deg.to_radians(), width);
            for component in Component::ALL {
                let row = &made.lobe(component).value[i * axis.cells()..(i + 1) * axis.cells()];
                let light: f64 = weights.iter().zip(row).map(|(w, v)| w * f64::from(*v)).sum();
                let share = summary.share(component);
                // Values are rounded to f32.
                assert!((light - share).abs() <= 1e-6 * share, "{component:?} at {i}: {light} of {share}");
            }
        }
    }
}

#[test]
fn the_single_azimuth_width_is_demanded_of_a_reciprocal_table() {
    let mut parts = symmetrise::symmetrised(&tables()[0]).unwrap().into_parts();
    parts.meta.per_incidence[3].azimuth_width_deg *= 1.01;
    let error = Table::new(parts).unwrap_err();
    assert!(error.field == "reciprocal.azimuth_width_deg", "{error}");
}

#[test]
fn a_reciprocal_table_is_another_bake_and_is_not_made_so_again() {
    let table = specimen::changed(&tables()[0], |parts| parts.meta.content_hash = Some("ab".to_owned()));
    let made = symmetrise::symmetrised(&table).unwrap();
    assert_eq!(made.meta().content_hash.as_deref(), Some("ab-reciprocal"));
    assert_eq!(symmetrise::symmetrised(&made).unwrap_err().field, KEY);
}
