//! What the walk promises: the same light as the reference walk, the same bytes on every machine, no lost path.
//!
//! Statistical tests fix their seeds, so they pass or fail for ever; their bounds are five standard deviations
//! (two-sided p = 6·10⁻⁷ each), so that the hundred of them together had a chance of 10⁻⁴ to fail by luck.

#![allow(clippy::print_stderr)] // A skipped check says so.

use proptest::prelude::*;
use transport::walk::lanes::{Precision, SimdLevel, WalkError, Walker};
use transport::walk::reference::{Estimator, Reference};
use transport::walk::{Exit, Fate};
use transport::{Facets, Geometry, Light, Normals, Sheets, Transport};

const SIGMAS: f64 = 5.0;
const CAP: u32 = 1_000_000;
const NOTHING: Exit = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };
const GEOMETRIES: [Geometry; 2] = [Geometry::Plane, Geometry::Space];

fn walk_as(
    transport: &Transport,
    geometry: Geometry,
    (precision, level): (Precision, Option<SimdLevel>),
    theta_deg: f64,
    paths: std::ops::Range<u64>,
    cap: u32,
) -> (Vec<Exit>, u64) {
    let walker = Walker::new(transport, geometry, precision, level).unwrap();
    let mut out = vec![NOTHING; (paths.end - paths.start) as usize];
    let crossings = walker.run(theta_deg.to_radians(), 7, paths, cap, &mut out);
    (out, crossings)
}

fn walk(transport: &Transport, geometry: Geometry, theta_deg: f64, paths: u64) -> Vec<Exit> {
    walk_as(transport, geometry, (Precision::Auto, None), theta_deg, 0..paths, CAP).0
}

fn leaves_top(exit: &Exit) -> bool {
    matches!(exit.fate, Fate::Single | Fate::Rehit | Fate::Interior)
}

/// The signed exit angle (plane) or the polar one (space), degrees.
fn exit_angle(exit: &Exit, geometry: Geometry) -> f64 {
    let [x, y, z] = exit.direction.map(f64::from);
    match geometry {
        Geometry::Plane => x.atan2(z).to_degrees(),
        Geometry::Space => x.hypot(y).atan2(z).to_degrees(),
    }
}

/// Sums that two walks are compared by: fate by fate, and weight, angle, angle² and (space) x of what leaves the top.
fn statistics(exit: &Exit, geometry: Geometry) -> [f64; 10] {
    let mut sums = [0.0; 10];
    sums[exit.fate as usize] = 1.0;
    if leaves_top(exit) {
        let angle = exit_angle(exit, geometry);
        let [x, y, z] = exit.direction.map(f64::from);
        sums[6] = f64::from(exit.weight);
        sums[7] = sums[6] * angle;
        sums[8] = sums[6] * angle * angle;
        sums[9] = sums[6] * x / (x * x + y * y + z * z).sqrt();
    }
    sums
}

/// Standard scores of the difference of the means of two samples, statistic by statistic (0 where neither varies).
fn scores(a: &[Exit], b: &[Exit], geometry: Geometry) -> [f64; 10] {
    let moments = |exits: &[Exit], i: usize| {
        let values = || exits.iter().map(|exit| statistics(exit, geometry)[i]);
        let mean = values().sum::<f64>() / exits.len() as f64;
        let variance = values().map(|v| (v - mean).powi(2)).sum::<f64>() / exits.len() as f64;
        (mean, variance / exits.len() as f64)
    };
    std::array::from_fn(|i| {
        let ((mean_a, error_a), (mean_b, error_b)) = (moments(a, i), moments(b, i));
        let error = (error_a + error_b).sqrt();
        if error == 0.0 { (mean_a - mean_b) * 1e9 } else { (mean_a - mean_b) / error }
    })
}

fn with(mut transport: Transport, change: impl FnOnce(&mut Transport)) -> Transport {
    change(&mut transport);
    transport
}

/// Stacks that between them take every way through the walk.
fn stacks() -> Vec<(&'static str, Transport)> {
    let degrees = f64::to_radians;
    let visible = |t: &mut Transport| t.facets.normals = Normals::Visible;
    let dark = |t: &mut Transport| t.optical_depths.fill(0.05);
    vec![
        ("one layer", Transport::alternating(1, 1.53, 1.43, 1.53, degrees(2.0))),
        ("two layers", Transport::alternating(2, 1.53, 1.43, 1.0, degrees(5.0))),
        ("37 of 1.9/1.2", Transport::alternating(37, 1.9, 1.2, 1.53, degrees(8.0))),
        ("twelve, as the substrate", Transport::alternating(12, 1.53, 1.43, 1.53, degrees(2.0))),
        ("rough", Transport::alternating(9, 1.53, 1.33, 1.0, degrees(25.0))),
        ("below 1", Transport::alternating(4, 0.9, 1.3, 1.0, degrees(3.0))),
        ("visible", with(Transport::alternating(6, 1.53, 1.43, 1.0, degrees(10.0)), visible)),
        ("absorbing", with(Transport::alternating(20, 1.53, 1.43, 1.53, degrees(2.0)), dark)),
        (
            "black",
            with(Transport::alternating(4, 1.53, 1.43, 1.53, degrees(2.0)), |t| t.optical_depths.fill(2.5)),
        ),
        (
            "explicit",
            Transport {
                indices: vec![1.0, 1.6, 1.5, 1.4, 1.8, 1.3],
                optical_depths: vec![0.1, 0.0, 0.3, 0.02],
                facets: Facets { slope_sd: degrees(4.0), normals: Normals::Unweighted },
                ..Transport::paper()
            },
        ),
        (
            "on a metal",
            Transport {
                indices: vec![1.0, 1.6, 1.4, 0.6],
                extinctions: vec![0.0, 0.0, 0.02, 6.7],
                optical_depths: vec![0.0, 0.05],
                facets: Facets { slope_sd: degrees(4.0), normals: Normals::Unweighted },
                ..Transport::paper()
            },
        ),
        (
            "dark layers, visible",
            Transport {
                indices: vec![1.3, 1.6, 1.2, 1.6, 1.2, 1.9],
                extinctions: vec![0.0, 0.01, 0.2, 0.01, 0.2, 3.4],
                optical_depths: vec![0.02, 0.1, 0.02, 0.1],
                facets: Facets { slope_sd: degrees(12.0), normals: Normals::Visible },
                ..Transport::paper()
            },
        ),
        (
            "explicit, visible",
            Transport {
                indices: vec![1.33, 1.6, 1.6, 1.4, 1.8],
                optical_depths: vec![0.0; 3],
                facets: Facets { slope_sd: degrees(12.0), normals: Normals::Visible },
                ..Transport::paper()
            },
        ),
    ]
}

#[test]
fn lanes_agree_with_the_reference_walk() {
    const PATHS: u64 = 40_000;
    for (name, transport) in stacks() {
        for geometry in GEOMETRIES {
            for theta_deg in [20.0, 80.0] {
                let (reference, _) =
                    Reference::new(&transport, geometry).run(f64::to_radians(theta_deg), 3, PATHS);
                let lanes = walk(&transport, geometry, theta_deg, PATHS);
                let mut scores = scores(&lanes, &reference, geometry);
                if transport.absorbs() {
                    // How absorption is shared between weight and death is each walk's own affair.
                    scores[..6].fill(0.0);
                }
                let worst = scores.iter().fold(0.0, |worst: f64, score| worst.max(score.abs()));
                assert!(worst < SIGMAS, "{name}, {geometry:?}, {theta_deg} degrees: {scores:.1?}");
            }
        }
    }
}

/// (geometry, θi, albedo, surface, mean, sd) of the paper's pearl by a converged deterministic solution.
const CONVERGED: [(Geometry, f64, f64, f64, f64, f64); 4] = [
    (Geometry::Plane, 30.0, 0.385_638_135, 0.045_524_496, 30.375_534_489, 8.723_936_393),
    (Geometry::Plane, 85.0, 0.702_082_236, 0.606_168_528, 82.201_552_215, 8.321_051_319),
    (Geometry::Space, 30.0, 0.385_457_666, 0.045_538_690, 31.499_074_750, 8.648_841_032),
    (Geometry::Space, 85.0, 0.696_397_900, 0.606_339_460, 82.418_456_741, 7.983_842_017),
];

#[test]
fn the_pearl_agrees_with_converged_solutions() {
    const PATHS: f64 = 20_000.0;
    for (geometry, theta_deg, albedo, surface, mean, sd) in CONVERGED {
        let exits = walk(&Transport::paper(), geometry, theta_deg, PATHS as u64);
        let share = |count: usize, expected: f64| {
            (count as f64 / PATHS - expected) / (expected * (1.0 - expected) / PATHS).sqrt()
        };
        let angles: Vec<f64> =
            exits.iter().filter(|e| leaves_top(e)).map(|e| exit_angle(e, geometry)).collect();
        let single = exits.iter().filter(|e| matches!(e.fate, Fate::Single | Fate::Rehit)).count();
        let average = angles.iter().sum::<f64>() / angles.len() as f64;
        let scores = [
            share(angles.len(), albedo),
            share(single, surface),
            (average - mean) / sd * (angles.len() as f64).sqrt(),
        ];
        assert!(
            scores.iter().all(|score| score.abs() < SIGMAS),
            "{geometry:?}, {theta_deg} degrees: {scores:.1?}"
        );
    }
}

fn bytes(exits: &[Exit]) -> Vec<[u32; 5]> {
    exits
        .iter()
        .map(|e| {
            let [x, y, z] = e.direction.map(f32::to_bits);
            [x, y, z, e.weight.to_bits(), e.fate as u32]
        })
        .collect()
}

#[test]
fn every_instruction_set_gives_the_same_bytes() {
    for level in SimdLevel::ALL {
        if !level.is_supported() {
            eprintln!("skipped {level}: this processor lacks it");
            continue;
        }
        for (name, transport) in stacks() {
            for geometry in GEOMETRIES {
                for precision in [Precision::F32, Precision::F64] {
                    let of =
                        |level| walk_as(&transport, geometry, (precision, Some(level)), 50.0, 5..1500, CAP);
                    let (portable, forced) = (of(SimdLevel::Portable), of(level));
                    assert_eq!(portable.1, forced.1, "{name}, {geometry:?}, {precision:?}, {level}");
                    assert!(
                        bytes(&portable.0) == bytes(&forced.0),
                        "{name}, {geometry:?}, {precision:?}, {level}"
                    );
                }
            }
        }
    }
}

#[test]
fn any_split_of_the_path_numbers_gives_the_same_bytes() {
    for (name, transport) in stacks() {
        for geometry in GEOMETRIES {
            let (whole, crossings) =
                walk_as(&transport, geometry, (Precision::Auto, None), 65.0, 0..900, CAP);
            let mut joined = Vec::new();
            let mut sum = 0;
            for part in [0..1, 1..1, 1..130, 130..131, 131..900] {
                let (exits, met) = walk_as(&transport, geometry, (Precision::Auto, None), 65.0, part, CAP);
                joined.extend(exits);
                sum += met;
            }
            assert!(bytes(&whole) == bytes(&joined), "{name}, {geometry:?}");
            assert_eq!(crossings, sum, "{name}, {geometry:?}");
        }
    }
}

#[test]
fn a_clear_layer_of_the_ambients_index_absorbs_by_beers_law() {
    for (theta_deg, depth) in [(0.0, 0.5), (60.0, 1.0), (75.0, 1.5), (30.0, 5.0), (60.0, 4.0)] {
        let transport = Transport {
            indices: vec![1.0; 3],
            optical_depths: vec![depth],
            facets: Facets { slope_sd: 0.0, normals: Normals::Unweighted },
            ..Transport::paper()
        };
        let expected = (-depth / f64::to_radians(theta_deg).cos()).exp();
        for geometry in GEOMETRIES {
            let paths = 200_000.0;
            let exits = walk(&transport, geometry, theta_deg, paths as u64);
            assert!(exits.iter().all(|e| matches!(e.fate, Fate::Transmitted | Fate::Absorbed)));
            let through = |e: &&Exit| e.fate == Fate::Transmitted;
            let weight = exits.iter().filter(through).map(|e| f64::from(e.weight)).sum::<f64>() / paths;
            // Beyond an optical depth of 6 the weight stays and paths die instead.
            let survive = (expected / (-6.0_f64).exp()).min(1.0);
            let error = (-6.0_f64).exp() * (survive * (1.0 - survive) / paths).sqrt();
            // 10⁻⁶: the weight is stored in 24 bits.
            let bound = SIGMAS * error + 1e-6 * expected;
            assert!(
                (weight - expected).abs() < bound,
                "{theta_deg} degrees, depth {depth}: {weight} not {expected}"
            );
        }
    }
}

#[test]
fn extreme_incidences_and_slopes_end_finite() {
    for slope_deg in [0.0, 0.01, 2.0, 25.0, 54.0] {
        for normals in [Normals::Unweighted, Normals::Visible] {
            for (odd, even, substrate) in
                [(1.53, 1.43, 1.53), (0.7, 1.9, 1.0), (1.0, 1.0, 1.0), (1.000_001, 1.0, 1.0)]
            {
                let mut transport =
                    Transport::alternating(5, odd, even, substrate, f64::to_radians(slope_deg));
                transport.facets.normals = normals;
                for theta_deg in [0.0, 1e-9, 45.0, 89.9999, 90.0] {
                    for geometry in GEOMETRIES {
                        for exit in walk(&transport, geometry, theta_deg, 200) {
                            let length = exit.direction.iter().map(|v| v * v).sum::<f32>().sqrt();
                            let context = format!(
                                "{exit:?}, {slope_deg}, {normals:?}, {odd}, {theta_deg}, {geometry:?}"
                            );
                            assert!(exit.fate != Fate::Truncated, "{context}");
                            assert!((length - 1.0).abs() < 1e-3, "{context}");
                            assert!(!leaves_top(&exit) || exit.direction[2] >= 0.0, "{context}");
                            assert!(exit.weight == 1.0, "{context}");
                        }
                    }
                }
            }
        }
    }
}

#[test]
fn a_flat_face_reflects_everything_past_the_critical_angle_and_at_90_degrees() {
    let dense = Transport {
        indices: vec![1.5, 1.0, 1.5],
        optical_depths: vec![0.0],
        facets: Facets { slope_sd: 0.0, normals: Normals::Unweighted },
        ..Transport::paper()
    };
    let pearl = Transport::alternating(500, 1.53, 1.43, 1.53, 0.0);
    for (transport, theta_deg) in [(&dense, 60.0), (&dense, 90.0), (&pearl, 90.0)] {
        for geometry in GEOMETRIES {
            let exits = walk(transport, geometry, theta_deg, 1000);
            assert!(exits.iter().all(|e| e.fate == Fate::Single), "{theta_deg} degrees");
            assert!(
                exits.iter().all(|e| (exit_angle(e, geometry) - theta_deg).abs() < 1e-4),
                "{theta_deg} degrees"
            );
        }
    }
}

#[test]
fn a_path_meets_no_more_facets_than_the_cap() {
    // Eleven interfaces.
    let stack = Transport::alternating(10, 1.6, 1.3, 1.0, 0.09);
    for geometry in GEOMETRIES {
        for (cap, passes) in [(9, false), (10, false), (11, true)] {
            let (exits, _) = walk_as(&stack, geometry, (Precision::Auto, None), 60.0, 0..20_000, cap);
            let any = exits.iter().any(|exit| exit.fate == Fate::Transmitted);
            assert_eq!(any, passes, "{geometry:?}, {cap}");
        }
        let (exits, _) = walk_as(&stack, geometry, (Precision::Auto, None), 60.0, 0..20_000, 1);
        let single_or_cut = |exit: &Exit| matches!(exit.fate, Fate::Single | Fate::Truncated);
        assert!(exits.iter().all(single_or_cut), "{geometry:?}");
    }
}

#[test]
fn the_cap_cuts_paths_and_leaves_the_others_alone() {
    for geometry in GEOMETRIES {
        let free = walk(&Transport::paper(), geometry, 30.0, 500);
        for cap in [1, 7, 50] {
            let (capped, crossings) =
                walk_as(&Transport::paper(), geometry, (Precision::Auto, None), 30.0, 0..500, cap);
            assert!(crossings <= 500 * u64::from(cap + 1));
            assert!(capped.iter().any(|e| e.fate == Fate::Truncated));
            for (a, b) in free.iter().zip(&capped) {
                assert!(b.fate == Fate::Truncated || a == b);
            }
        }
    }
}

#[test]
fn a_single_layer_and_a_hundred_thousand_both_end() {
    for layers in [0, 1, 100_000] {
        let transport = Transport::alternating(layers, 1.53, 1.43, 1.53, f64::to_radians(2.0));
        for geometry in GEOMETRIES {
            let exits = walk(&transport, geometry, 30.0, 64);
            assert!(exits.iter().any(|e| leaves_top(e) || e.fate == Fate::Transmitted), "{layers} layers");
        }
    }
}

#[test]
fn seeds_incidences_and_paths_differ() {
    let walker = Walker::new(&Transport::paper(), Geometry::Space, Precision::Auto, None).unwrap();
    let run = |theta: f64, seed: u64, first: u64| {
        let mut out = vec![NOTHING; 64];
        walker.run(theta, seed, first..first + 64, CAP, &mut out);
        bytes(&out)
    };
    let base = run(0.5, 1, 0);
    assert_eq!(base, run(0.5, 1, 0));
    for other in [run(0.5, 2, 0), run(0.5 + 1e-15, 1, 0), run(0.5, 1, 64)] {
        let same = base.iter().zip(&other).filter(|(a, b)| a == b).count();
        // Transmitted paths share weight and fate, but never all bits of the direction.
        assert_eq!(same, 0);
    }
}

#[test]
fn thirty_two_bits_are_given_up_where_they_are_too_coarse() {
    let resolve = |odd: f64, slope_deg: f64| {
        Precision::Auto.resolve(&Transport::alternating(3, odd, 1.43, 1.53, f64::to_radians(slope_deg)))
    };
    assert_eq!(resolve(1.53, 2.0), Precision::F32);
    assert_eq!(resolve(1.53, 0.01), Precision::F64);
    assert_eq!(resolve(1.43 * (1.0 + 1e-6), 2.0), Precision::F64);
    assert_eq!(resolve(1.43, 2.0), Precision::F32);
}

#[test]
fn values_out_of_range_are_refused() {
    let new =
        |transport: &Transport| Walker::new(transport, Geometry::Space, Precision::Auto, None).unwrap_err();
    let paper = Transport::paper;
    assert!(matches!(new(&with(paper(), |t| t.indices[3] = -1.0)), WalkError::Index { medium: 3, .. }));
    assert!(matches!(new(&with(paper(), |t| t.indices[0] = f64::NAN)), WalkError::Index { medium: 0, .. }));
    assert!(matches!(new(&with(paper(), |t| t.optical_depths[1] = -0.1)), WalkError::Depth { layer: 2, .. }));
    assert!(matches!(new(&with(paper(), |t| t.facets.slope_sd = 1.5)), WalkError::SlopeSd(_)));
    assert!(matches!(new(&with(paper(), |t| t.indices.truncate(9))), WalkError::Media { .. }));
}

#[test]
fn the_fair_coin_is_unbiased_and_the_papers_literal_rule_is_not() {
    // Three interfaces: few enough events for the fair coin's variance.
    let transport = Transport::alternating(2, 1.9, 1.3, 1.0, f64::to_radians(3.0));
    let run = |estimator, transport: &Transport, paths: u64| {
        let reference =
            Reference { estimator, threshold: 1e-4, ..Reference::new(transport, Geometry::Space) };
        let (exits, _) = reference.run(30_f64.to_radians(), 5, paths);
        let weights: Vec<f64> =
            exits.iter().map(|e| if leaves_top(e) { f64::from(e.weight) } else { 0.0 }).collect();
        let mean = weights.iter().sum::<f64>() / paths as f64;
        let variance = weights.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / paths as f64;
        (mean, (variance / paths as f64).sqrt())
    };
    let (analog, analog_error) = run(Estimator::Analog, &transport, 200_000);
    let (coin, coin_error) = run(Estimator::FairCoin, &transport, 200_000);
    let (literal, literal_error) = run(Estimator::PaperLiteral, &transport, 200_000);
    assert!((coin - analog).abs() < SIGMAS * analog_error.hypot(coin_error), "{coin} not {analog}");
    assert!(analog - literal > 20.0 * analog_error.hypot(literal_error), "{literal}, {analog}");
    // MODEL: about 0.002 for the pearl at 30 degrees, where the unbiased albedo is 0.385.
    let (pearl, error) = run(Estimator::PaperLiteral, &Transport::paper(), 4_000);
    assert!((pearl - 0.002).abs() < 0.0005 + SIGMAS * error, "{pearl} ± {error}");
}

/// Shares of the interior and of transmitted light within 4.5 standard errors of doubling's (p = 7e-6 each), seed 7.
#[test]
fn forced_entry_is_unbiased_for_all_but_the_single_reflection() {
    let stack = Transport::alternating(20, 1.53, 1.43, 1.0, f64::to_radians(5.0));
    let theta_i = [0.5, 1.4, 1.52];
    let solved = transport::doubling::solve_to(&stack, Geometry::Space, &theta_i, 1e-3, false).unwrap();
    let reference =
        Reference { estimator: Estimator::ForcedEntry, ..Reference::new(&stack, Geometry::Space) };
    for (lobe, theta) in solved.lobes.iter().zip(theta_i) {
        let (exits, _) = reference.run(theta, 7, 40_000);
        assert!(exits.iter().all(|exit| exit.fate != Fate::Single));
        let expected = [
            (Fate::Interior, lobe.albedo - lobe.surface),
            (Fate::Rehit, lobe.rehit),
            (Fate::Transmitted, lobe.transmitted),
        ];
        for (fate, share) in expected {
            let weights =
                exits.iter().map(|exit| if exit.fate == fate { f64::from(exit.weight) } else { 0.0 });
            let (sum, square) = weights.fold((0.0, 0.0), |(s, q), w| (s + w, q + w * w));
            let (n, mean) = (exits.len() as f64, sum / exits.len() as f64);
            let error = ((square / n - mean * mean) / n).sqrt();
            assert!(
                (mean - share).abs() < 4.5 * error + 1e-6,
                "{fate:?} at {theta}: {mean} ± {error}, {share}"
            );
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, ..ProptestConfig::default() })]

    #[test]
    fn any_stack_ends_every_path_in_a_finite_direction(
        media in prop::collection::vec((0.5_f64..4.0, prop_oneof![Just(0.0), 0.0_f64..3.0]), 1..9),
        ends in (0.5_f64..4.0, 0.5_f64..4.0),
        slope_deg in prop_oneof![Just(0.0), 0.001_f64..54.0],
        theta_deg in prop_oneof![Just(0.0), Just(90.0), 0.0_f64..90.0],
        visible: bool,
        space: bool,
        alternate: bool,
    ) {
        let mut indices = vec![ends.0];
        let mut optical_depths = Vec::new();
        for i in 0..media.len() {
            let (index, depth) = media[if alternate { i % 2.min(media.len()) } else { i }];
            indices.push(index);
            optical_depths.push(depth);
        }
        indices.push(ends.1);
        let normals = if visible { Normals::Visible } else { Normals::Unweighted };
        let facets = Facets { slope_sd: slope_deg.to_radians(), normals };
        let transport = Transport { indices, optical_depths, facets, ..Transport::paper() };
        let geometry = if space { Geometry::Space } else { Geometry::Plane };
        let (exits, _) = walk_as(&transport, geometry, (Precision::Auto, None), theta_deg, 0..150, 20_000);
        for exit in exits {
            let length = exit.direction.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt();
            prop_assert!((length - 1.0).abs() < 0.01, "{exit:?}");
            prop_assert!((0.0..=1.0).contains(&exit.weight), "{exit:?}");
            prop_assert!(transport.absorbs() || exit.weight == 1.0, "{exit:?}");
            prop_assert!(!leaves_top(&exit) || exit.direction[2] >= 0.0, "{exit:?}");
        }
    }
}

/// Reflectance and transmittance of a pile of smooth faces, intensities added: the star product of one face after another.
fn star(faces: &[f64]) -> (f64, f64) {
    faces.iter().rev().fold((0.0, 1.0), |(below, through), &r| {
        let loops = 1.0 / (1.0 - r * below);
        (r + (1.0 - r) * (1.0 - r) * below * loops, (1.0 - r) * through * loops)
    })
}

/// cos of the angle in a medium of index n of a ray that has the angle θ in vacuum.
fn cosine_in(n: f64, theta: f64) -> f64 {
    (1.0 - (theta.sin() / n).powi(2)).sqrt()
}

/// (s, p) reflectances of a face between indices, the ray at θ in vacuum.
fn face(n1: f64, n2: f64, theta: f64) -> [f64; 2] {
    let (c1, c2) = (cosine_in(n1, theta), cosine_in(n2, theta));
    let s = (n1 * c1 - n2 * c2) / (n1 * c1 + n2 * c2);
    let p = (n2 * c1 - n1 * c2) / (n2 * c1 + n1 * c2);
    [s * s, p * p]
}

/// Five standard errors of a share (6e-7 for one comparison), and rounding.
fn agrees(exits: &[Exit], expected: f64) {
    let n = exits.len() as f64;
    let out =
        exits.iter().filter(|exit| matches!(exit.fate, Fate::Single | Fate::Rehit | Fate::Interior)).count();
    let error = (expected * (1.0 - expected) / n).sqrt();
    let found = out as f64 / n;
    assert!((found - expected).abs() <= 5.0 * error + 1e-12, "{found} ± {error}, expected {expected}");
}

#[test]
fn polarised_walks_of_smooth_faces_are_the_star_products_of_s_and_p() {
    for theta_deg in [0.0, 30.0, 56.8, 75.0, 85.0] {
        let theta = f64::to_radians(theta_deg);
        let stack = Transport::alternating(60, 1.53, 1.43, 1.6, 0.0);
        let faces: Vec<[f64; 2]> =
            stack.indices.windows(2).map(|pair| face(pair[0], pair[1], theta)).collect();
        let [s, p] = [0, 1].map(|i| star(&faces.iter().map(|f| f[i]).collect::<Vec<_>>()).0);
        for (light, expected) in [(Light::S, s), (Light::P, p), (Light::Tracked, 0.5 * (s + p))] {
            let stack = Transport { light, ..stack.clone() };
            for precision in [Precision::F32, Precision::F64] {
                let (exits, _) =
                    walk_as(&stack, Geometry::Plane, (precision, None), theta_deg, 0..200_000, 1_000_000);
                agrees(&exits, expected);
            }
            let (exits, _) = Reference::new(&stack, Geometry::Plane).run(theta, 5, 50_000);
            agrees(&exits, expected);
        }
    }
    let stack = Transport { light: Light::Tracked, ..Transport::paper() };
    let refused = Walker::new(&stack, Geometry::Space, Precision::Auto, None);
    assert!(matches!(refused, Err(WalkError::TrackedInSpace)));
}

#[test]
fn walks_at_coherent_sheets_are_star_products_of_films() {
    // 25 nm of 1.43 in 1.53 at 400 nm; 40 sheets on an aragonite substrate; also a light index, so that inside angles
    // pass the critical one (frustrated total reflection).
    for (outer, sheet, phase) in [(1.53, 1.43, 0.39), (1.53, 1.0, 0.6)] {
        for theta_deg in [0.0, 40.0, 80.0] {
            let theta = f64::to_radians(theta_deg);
            let mut stack = Transport::alternating(40, outer, outer, outer, 0.0);
            let sheets = Sheets { index: sheet, phase, last: 40 };
            stack.sheets = Some(sheets);
            let film = sheets.reflectance(outer, cosine_in(outer, theta));
            let top = face(1.0, outer, theta);
            let whole = |top: f64, film: f64| star(&[&[top][..], &[film; 40]].concat()).0;
            let [s, p] = [whole(top[0], film.0), whole(top[1], film.1)];
            // Unpolarised at every event: means of each face.
            let mean = whole(0.5 * (top[0] + top[1]), 0.5 * (film.0 + film.1));
            for (light, expected) in
                [(Light::Unpolarised, mean), (Light::S, s), (Light::P, p), (Light::Tracked, 0.5 * (s + p))]
            {
                let stack = Transport { light, ..stack.clone() };
                for geometry in GEOMETRIES {
                    if geometry == Geometry::Space && light != Light::Unpolarised {
                        continue;
                    }
                    let (exits, _) =
                        walk_as(&stack, geometry, (Precision::Auto, None), theta_deg, 0..200_000, 1_000_000);
                    agrees(&exits, expected);
                }
            }
        }
    }
}

#[test]
fn rough_walks_of_tracked_light_and_sheets_agree_with_the_reference() {
    let sheets = Sheets { index: 1.43, phase: 0.39, last: 30 };
    let pile = Transport::alternating(30, 1.53, 1.53, 1.53, 6.0_f64.to_radians());
    let tracked = Transport {
        light: Light::Tracked,
        ..Transport::alternating(30, 1.7, 1.4, 1.5, 6.0_f64.to_radians())
    };
    let mut absorbing = Transport { sheets: Some(sheets), ..pile.clone() };
    absorbing.optical_depths.fill(0.01);
    for (stack, geometry) in [
        (tracked, Geometry::Plane),
        (Transport { sheets: Some(sheets), ..pile.clone() }, Geometry::Space),
        (Transport { sheets: Some(sheets), light: Light::Tracked, ..pile }, Geometry::Plane),
        (absorbing, Geometry::Plane),
    ] {
        for theta_deg in [20.0, 70.0] {
            let (fast, _) =
                walk_as(&stack, geometry, (Precision::Auto, None), theta_deg, 0..200_000, 1_000_000);
            let (slow, _) = Reference::new(&stack, geometry).run(theta_deg.to_radians(), 9, 100_000);
            // Albedo and mean sine of the exit angle, light weighted: 4.5 standard errors, 7e-6 for one comparison.
            for value in [|_: &Exit| 1.0, |exit: &Exit| f64::from(exit.direction[0])] {
                let [(a, va), (b, vb)] = [&fast, &slow].map(|exits| {
                    let values: Vec<f64> = exits
                        .iter()
                        .map(|exit| match exit.fate {
                            Fate::Single | Fate::Rehit | Fate::Interior => {
                                f64::from(exit.weight) * value(exit)
                            }
                            _ => 0.0,
                        })
                        .collect();
                    let n = values.len() as f64;
                    let mean = values.iter().sum::<f64>() / n;
                    (mean, values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n * n))
                });
                assert!(
                    (a - b).abs() < 4.5 * (va + vb).sqrt(),
                    "{theta_deg}: {a} {b} ± {}",
                    (va + vb).sqrt()
                );
            }
        }
    }
}

#[test]
fn sheets_that_are_no_thin_films_are_refused() {
    let stack = Transport::alternating(4, 1.53, 1.43, 1.53, 0.03);
    for (sheets, said) in [
        (Sheets { index: 1.43, phase: 0.3, last: 1 }, "sheet 1 lies between indices 1.53 and 1.43"),
        (Sheets { index: 1.43, phase: 1.2, last: 0 }, "at most a quarter of a wave"),
        (Sheets { index: 1.43, phase: 0.3, last: 9 }, "below the last interface"),
        (Sheets { index: 1.43, phase: 0.3, last: 0 }, "layers that are all alike"),
    ] {
        let stack = Transport { sheets: Some(sheets), ..stack.clone() };
        let line = Walker::new(&stack, Geometry::Plane, Precision::Auto, None).unwrap_err().to_string();
        assert!(line.contains(said), "{line}");
    }
}
