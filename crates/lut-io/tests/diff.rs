//! `diff` on pairs of every kind: what it finds, what it lets pass, and how often it is wrong.

#![allow(clippy::print_stdout)] // the figures are the point

use lut_io::diff::{Difference, diff};
use lut_io::lobe::Interpolant;
use lut_io::measure;
use lut_io::solver::{Doubling, Interpolation, Solver, SolverSettings};
use lut_io::table::{Component, ComponentAccuracy};
use lut_io::{Parts, Table};

const INCIDENCES: [f64; 5] = [5.0, 25.0, 45.0, 65.0, 80.0];

/// Paths of a made-up table are this many.
const PATHS: f64 = specimen::PATHS as f64;

/// Random numbers of a seed, SplitMix64.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    /// A number of paths with this mean: exact below 50, the nearest whole number to a normal deviate above.
    fn poisson(&mut self, mean: f64) -> f64 {
        if mean < 50.0 {
            let (limit, mut product, mut count) = ((-mean).exp(), self.uniform(), 0.0);
            while product > limit {
                product *= self.uniform();
                count += 1.0;
            }
            return count;
        }
        let radius = (-2.0 * self.uniform().max(1e-300).ln()).sqrt();
        (mean + mean.sqrt() * radius * (std::f64::consts::TAU * self.uniform()).cos()).round().max(0.0)
    }
}

/// A walk of so many paths whose truth is this table: cells are counted anew, shares are the counts.
fn walked(truth: &Table, paths: f64, seed: u64) -> Table {
    let mut random = Random(seed);
    specimen::changed(truth, |parts| {
        parts.meta.seed = seed;
        let axis = parts.meta.exit_axis;
        let cells = axis.cells();
        for (i, s) in parts.meta.per_incidence.iter_mut().enumerate() {
            let (theta_i, width) = (s.theta_i_deg.to_radians(), s.azimuth_width_deg.to_radians());
            let (extents, weights) =
                (measure::cell_extents(&axis, theta_i), measure::reading_weights(&axis, theta_i, width));
            let own = i * cells..(i + 1) * cells;
            // Surface is single and rehit: each is counted by itself.
            let count_of = |lobe: &lut_io::table::Lobe| -> Vec<f64> {
                lobe.count[own.clone()].iter().map(|count| f64::from(*count) / PATHS * paths).collect()
            };
            let means = parts.lobes.each_ref().map(count_of);
            let mut count =
                |means: &[f64]| -> Vec<f64> { means.iter().map(|mean| random.poisson(*mean)).collect() };
            let single: Vec<f64> =
                means[1].iter().zip(&means[2]).map(|(all, rehit)| (all - rehit).max(0.0)).collect();
            let [interior, single, rehit] = [&means[0], &single, &means[2]].map(|means| count(means));
            let surface: Vec<f64> = single.iter().zip(&rehit).map(|(a, b)| a + b).collect();
            let mut shares = [0.0; 3];
            for ((lobe, counts), share) in
                parts.lobes.iter_mut().zip([&interior, &surface, &rehit]).zip(&mut shares)
            {
                let light: Vec<f64> = counts.iter().map(|count| count / paths).collect();
                *share = light.iter().sum();
                for (k, factor) in measure::value_factors(&light, &extents, &weights).into_iter().enumerate()
                {
                    let error = (light[k] * (1.0 - light[k]) / paths).sqrt();
                    lobe.value[own.start + k] = (light[k] * factor) as f32;
                    lobe.std_error[own.start + k] = (error * factor) as f32;
                    lobe.count[own.start + k] = counts[k] as f32;
                }
            }
            // Every cell has its own number of paths: their sum is no binomial of all.
            let poisson = |share: f64| (share / paths).sqrt();
            (s.albedo, s.surface, s.rehit, s.paths) =
                (shares[0] + shares[1], shares[1], shares[2], paths as u64);
            s.transmitted = 1.0 - s.albedo;
            (s.std_error.albedo, s.std_error.transmitted) = (poisson(s.albedo), poisson(s.albedo));
            s.std_error.surface = poisson(s.surface);
            // The moments stay the truth's: they are tried on real walks.
            s.std_error.mean_theta_o_deg = 0.0;
            s.std_error.sd_theta_o_deg = 0.0;
        }
    })
}

/// The table as a doubling states it: so many per cent of error in every component, none of noise.
fn doubled(truth: &Table, percent: f64) -> Table {
    specimen::changed(truth, |parts| {
        parts.meta.solver = Solver::Doubling;
        parts.meta.solver_settings = SolverSettings::Doubling(Doubling {
            density: 1.0,
            interpolation: Interpolation::Measured,
            modes: 8,
            nodes: 64,
            reach: 5.0,
            refinements: 0,
            raised: 0,
        });
        let accuracy = &mut parts.meta.accuracy;
        (accuracy.solver_percent, accuracy.rows_percent, accuracy.cells_percent) = (percent, 0.0, Some(0.0));
        accuracy.reached_percent = percent;
        accuracy.components = Some(ComponentAccuracy {
            interior_percent: percent,
            rehit_percent: percent,
            surface_percent: percent,
        });
        let cells = parts.meta.exit_axis.cells();
        for (i, s) in parts.meta.per_incidence.iter_mut().enumerate() {
            (s.paths, s.accuracy_percent) = (0, percent);
            s.std_error = lut_io::table::SummaryErrors { albedo: 1e-9, ..Default::default() };
            for (component, lobe) in Component::ALL.into_iter().zip(&mut parts.lobes) {
                let own = s.share(component);
                let relative = 0.02 * percent * (s.albedo / own.max(1e-12)).sqrt();
                for k in i * cells..(i + 1) * cells {
                    lobe.std_error[k] = (relative * f64::from(lobe.value[k])) as f32;
                    lobe.count[k] = 0.0;
                }
            }
        }
    })
}

fn found(a: &Table, b: &Table) -> Difference {
    diff(&Interpolant::new(a.clone()), &Interpolant::new(b.clone()))
}

/// What made a difference significant.
fn evidence(difference: &Difference) -> String {
    let least = difference.smallest_p;
    let places = difference.per_incidence.iter().flat_map(|at| {
        let shares = at.shares.iter().filter(move |s| s.p == least).map(|s| format!("{s:?}"));
        shares.chain(at.lobes.iter().filter(move |l| l.p == least).map(|l| format!("{l:?}")))
    });
    format!("{:?} {} tests {}", difference.beyond, difference.tests, places.collect::<Vec<_>>().join(" "))
}

/// What may be wrong with a table.
#[derive(Clone, Copy, Debug)]
enum Change {
    /// The interior times 1 + size.
    Scale,
    /// Every lobe moved by so many cells.
    Shift,
    /// The interior times a ramp over the columns from 1 − size to 1 + size, its light kept.
    Tilt,
    /// Every other azimuth width, or in space the interior pressed towards the plane of incidence.
    Width,
    /// A share of interior and surface swapped.
    Swap,
    /// Lobes as of another σ: wider by 1 + size about the middle of the columns.
    Sigma,
}

const CHANGES: [Change; 6] =
    [Change::Scale, Change::Shift, Change::Tilt, Change::Width, Change::Swap, Change::Sigma];

/// The made-up table with this change of the truth, counts and ledger included.
fn changed(truth: &Table, change: Change, size: f64) -> Table {
    specimen::changed(truth, |parts| {
        let axis = parts.meta.exit_axis;
        let (cells, columns) = (axis.cells(), axis.columns());
        for i in 0..parts.meta.per_incidence.len() {
            let own = i * cells..(i + 1) * cells;
            let before = parts.lobes.each_ref().map(|lobe| lobe.value[own.clone()].to_vec());
            let mixed = |values: &[f32], k: usize, from: f64| {
                let (row, x) = (k / columns, from.clamp(0.0, (columns - 1) as f64));
                let (low, t) = ((x as usize).min(columns - 2), x - f64::min(x.floor(), (columns - 2) as f64));
                let at = |column: usize| f64::from(values[row * columns + column]);
                at(low) * (1.0 - t) + at(low + 1) * t
            };
            for k in 0..cells {
                let (column, row) = ((k % columns) as f64, (k / columns) as f64);
                let middle = 0.5 * (columns - 1) as f64;
                let [interior, surface, rehit] = [0, 1, 2].map(|c: usize| f64::from(before[c][k]));
                let read = |from: f64| [0, 1, 2].map(|c: usize| mixed(&before[c], k, from));
                let new = match change {
                    Change::Scale => [interior * (1.0 + size), surface, rehit],
                    Change::Shift => read(column - size),
                    Change::Tilt => [interior * (1.0 + size * (column - middle) / middle), surface, rehit],
                    Change::Width if cells == columns => [interior, surface, rehit],
                    Change::Width => [
                        interior * (1.0 + size * (1.0 - row * columns as f64 * 2.0 / cells as f64)),
                        surface,
                        rehit,
                    ],
                    Change::Swap => [
                        interior + size * (surface - rehit - interior),
                        surface + size * (interior - surface + rehit),
                        rehit,
                    ],
                    Change::Sigma => read(middle + (column - middle) / (1.0 + size)),
                };
                for (lobe, value) in parts.lobes.iter_mut().zip(new) {
                    lobe.value[own.start + k] = value.max(0.0) as f32;
                }
            }
            restate(
                parts,
                i,
                matches!(change, Change::Scale | Change::Swap),
                if matches!(change, Change::Width) { size } else { 0.0 },
            );
        }
    })
}

/// Ledger, errors and counts of an incidence from its values; where the light is not to change, it is restored.
fn restate(parts: &mut Parts, i: usize, new_light: bool, wider: f64) {
    let axis = parts.meta.exit_axis;
    let cells = axis.cells();
    let s = &mut parts.meta.per_incidence[i];
    let before = Component::ALL.map(|component| s.share(component));
    let (theta_i, width) = (s.theta_i_deg.to_radians(), s.azimuth_width_deg.to_radians());
    let extents = measure::cell_extents(&axis, theta_i);
    s.azimuth_width_deg *= 1.0 + wider;
    let weights =
        [width, s.azimuth_width_deg.to_radians()].map(|w| measure::reading_weights(&axis, theta_i, w));
    let mut shares = [0.0; 3];
    for (c, lobe) in parts.lobes.iter_mut().enumerate() {
        let own = i * cells..(i + 1) * cells;
        let values: Vec<f64> = lobe.value[own.clone()].iter().map(|v| f64::from(*v)).collect();
        let read: f64 = values.iter().zip(&weights[0]).map(|(v, w)| v * w).sum();
        shares[c] = if new_light { read } else { before[c] };
        let counted: f64 = values.iter().zip(&extents).map(|(v, x)| v * x).sum();
        let light: Vec<f64> =
            values.iter().zip(&extents).map(|(v, x)| v * x * shares[c] / counted.max(1e-300)).collect();
        for (k, factor) in measure::value_factors(&light, &extents, &weights[1]).into_iter().enumerate() {
            lobe.value[own.start + k] = (light[k] * factor) as f32;
            lobe.count[own.start + k] = (light[k] * PATHS) as f32;
        }
    }
    (s.albedo, s.surface, s.rehit) = (shares[0] + shares[1], shares[1], shares[2]);
    s.transmitted = 1.0 - s.albedo;
}

fn plane() -> Table {
    specimen::plane(&INCIDENCES, 64)
}

fn space() -> Table {
    specimen::space(&INCIDENCES, 24, 12)
}

#[test]
fn walks_of_one_truth_are_called_different_no_oftener_than_stated() {
    let (mut smallest, mut alarms) = (Vec::new(), 0);
    for (truth, paths) in [(plane(), 3e3), (plane(), 1e5), (space(), 3e4), (space(), 1e6)] {
        for seed in 0..25 {
            // Not equally many.
            let pair = [walked(&truth, paths, 2 * seed), walked(&truth, 3.0 * paths, 2 * seed + 1)];
            let difference = found(&pair[0], &pair[1]);
            if difference.significant {
                println!("{paths} {seed}: {}", evidence(&difference));
                alarms += 1;
            }
            smallest.push((difference.smallest_p.unwrap() * difference.tests as f64).min(1.0));
        }
    }
    // Of 100 smallest p times their number a tenth may be below 0.1: more than 20 by chance once in a thousand.
    let below = smallest.iter().filter(|p| **p < 0.1).count();
    println!("100 pairs of walks: {alarms} called different, {below} with a family-wise p below 0.1");
    // Once in a thousand each: two of a hundred by chance once in two hundred.
    assert!(below <= 20 && alarms <= 1, "{below} {alarms}");
}

#[test]
fn a_walk_of_what_a_doubling_states_passes_and_so_does_its_stated_error() {
    let mut below = 0;
    for (k, truth) in [plane(), space()].iter().enumerate() {
        for seed in 0..25 {
            let paths = [3e3, 1e5][seed as usize % 2];
            // Off by all that it states, where that is hardest to allow for.
            let off = changed(truth, Change::Tilt, 0.01);
            for (doubling, percent) in [(truth, 0.0), (truth, 0.2), (&off, 1.0)] {
                let difference = found(&walked(truth, paths, seed), &doubled(doubling, percent));
                assert!(!difference.significant, "{k} {seed} {percent}: {}", evidence(&difference));
                below += usize::from(
                    percent == 0.0 && difference.smallest_p.unwrap() * (difference.tests as f64) < 0.1,
                );
            }
        }
    }
    println!("50 walks against their truth: {below} with a family-wise p below 0.1");
    assert!(below <= 13, "{below}");
}

#[test]
fn a_change_of_the_size_that_is_named_is_found_and_small_ones_pass() {
    // The least change found, by kind of pair; with what a table of that kind is known to need.
    for (name, truth) in [("decay", plane()), ("space", space())] {
        for change in CHANGES {
            let sizes = [0.002, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, 0.5];
            let least = |pair: &dyn Fn(&Table) -> Difference| {
                sizes.into_iter().find(|size| pair(&changed(&truth, change, *size)).significant)
            };
            let walks = least(&|other| found(&walked(&truth, 1e5, 1), &walked(other, 1e5, 2)));
            let mixed = least(&|other| found(&walked(other, 1e5, 3), &doubled(&truth, 0.2)));
            let doubling = least(&|other| found(&doubled(&truth, 0.2), &doubled(other, 0.2)));
            println!(
                "{name:<6} {change:?}: walk×walk {walks:?}, walk×doubling {mixed:?}, doubling×doubling {doubling:?}"
            );
            for (least, most) in [(walks, 0.5), (mixed, 0.5), (doubling, 0.05)] {
                assert!(least.is_some_and(|least| least <= most), "{name} {change:?}");
            }
        }
    }
}

#[test]
fn the_power_that_is_named_is_kept() {
    for truth in [plane(), space()] {
        let named = found(&walked(&truth, 1e5, 1), &walked(&truth, 1e5, 2));
        let interior = |difference: &Difference| {
            let lobes = difference.per_incidence.iter().flat_map(|at| &at.lobes);
            lobes.filter(|l| l.component == "interior").map(|l| l.smallest_change_percent).fold(0.0, f64::max)
        };
        let least = interior(&named);
        // A tilt of the interior as large as that, and one half as large.
        let tilt = |percent: f64| {
            let own = found(&doubled(&truth, 0.0), &doubled(&changed(&truth, Change::Tilt, 0.1), 0.0));
            let lobes =
                own.per_incidence.iter().flat_map(|at| &at.lobes).filter(|l| l.component == "interior");
            let apart = lobes.map(|l| l.total_variation_percent).fold(f64::INFINITY, f64::min);
            changed(&truth, Change::Tilt, 0.1 * percent / apart)
        };
        let large = tilt(least);
        let hits = (0..20).filter(|seed| {
            found(&walked(&truth, 1e5, 100 + seed), &walked(&large, 1e5, 200 + seed)).significant
        });
        let hits = hits.count();
        println!("named {least:.2} %: found {hits} of 20");
        assert!(hits >= 19, "{hits}");
    }
}

#[test]
fn what_has_no_error_must_be_the_same() {
    let truth = plane();
    for change in [
        &(|parts: &mut Parts| parts.meta.surface_model.n_first = 1.54) as &dyn Fn(&mut Parts),
        &|parts: &mut Parts| parts.meta.surface_model.slope_sd *= 1.01,
        &|parts: &mut Parts| parts.meta.surface_model.normals = lut_io::table::Normals::Visible,
        &|parts: &mut Parts| parts.meta.per_incidence.iter_mut().for_each(|s| s.azimuth_width_deg *= 1.001),
    ] {
        let other = specimen::changed(&truth, change);
        assert!(
            found(&truth, &other).significant
                && found(&doubled(&truth, 1.0), &doubled(&other, 1.0)).significant
        );
    }
    // Another seed or name is no other table.
    let named = specimen::changed(&truth, |parts| parts.meta.recipe["name"] = "other".into());
    assert!(found(&truth, &named).identical);
}

#[test]
fn doublings_are_held_to_what_both_state() {
    let truth = plane();
    let other = changed(&truth, Change::Scale, 0.01);
    // Of the interior half of 1 %: as a share of √(all · interior) a little less.
    assert!(found(&doubled(&truth, 0.1), &doubled(&other, 0.1)).significant);
    assert!(!found(&doubled(&truth, 0.3), &doubled(&other, 0.3)).significant);
    // A share that is 1e-6 apart is no news from two resolutions that are 1e-9 apart.
    let resolved =
        specimen::changed(&doubled(&truth, 0.1), |parts| parts.meta.per_incidence[2].transmitted += 1e-6);
    assert!(!found(&doubled(&truth, 0.1), &resolved).significant);
    // Read between its incidences.
    let fewer = specimen::plane(&[5.0, 35.0, 80.0], 64);
    let difference = found(&doubled(&fewer, 30.0), &doubled(&truth, 30.0));
    assert!(!difference.significant && difference.per_incidence.len() == 3, "{:?}", difference.beyond);
}
