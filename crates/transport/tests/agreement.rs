//! The production walk against the deterministic solver, cell by cell: two programs that share no code and no method.
//!
//! For each stack, geometry and incidence the paths that end in each cell of exit directions (surface and interior
//! apart, transmitted light as one cell more) are compared with the solver's shares by Pearson's chi². Each gives one
//! p-value. Under agreement p-values are uniform: that is tried by the Kolmogorov–Smirnov test, and the smallest by
//! Bonferroni's bound. The seed is fixed, so a run passes or fails for good.

#![allow(clippy::print_stdout)] // every p-value, for those who look

use std::f64::consts::{FRAC_PI_2, PI};

use statrs::distribution::{ChiSquared, ContinuousCDF as _};
use transport::doubling::{Solution, solve_to};
use transport::walk::lanes::{Precision, Walker};
use transport::walk::{Exit, Fate};
use transport::{Facets, Geometry, Normals, Transport};

/// Level of both tests: a right program fails one of them with a probability of 2e-3 a seed.
const SIGNIFICANCE: f64 = 1e-3;
const SEED: u64 = 20_261_125;
/// Fewest paths expected in a cell that enters chi² by itself.
const LEAST: f64 = 25.0;
/// Total variation of the solver: its part of chi² at 10⁶ paths is below 0.1 of a cell's.
const SOLVED_TO: f64 = 1e-5;

fn stacks() -> [(&'static str, Transport); 3] {
    let d = f64::to_radians;
    let mut thin = Transport::alternating(3, 1.6, 1.4, 1.33, d(6.0));
    thin.facets.normals = Normals::Visible;
    [
        ("the paper's pearl", Transport::paper()),
        ("37 layers of high contrast on air", Transport::alternating(37, 1.9, 1.2, 1.0, d(4.0))),
        ("three layers, visible normals", thin),
    ]
}

/// Nodes and weights of the ten-point Gauss–Legendre rule on [0, 1] (Abramowitz & Stegun table 25.4).
fn gauss() -> [(f64, f64); 10] {
    const X: [f64; 5] = [
        0.148_874_338_981_631_2,
        0.433_395_394_129_247_2,
        0.679_409_568_299_024_4,
        0.865_063_366_688_984_5,
        0.973_906_528_517_171_7,
    ];
    const W: [f64; 5] = [
        0.295_524_224_714_752_9,
        0.269_266_719_309_996_4,
        0.219_086_362_515_982_04,
        0.149_451_349_150_580_6,
        0.066_671_344_308_688_14,
    ];
    std::array::from_fn(|k| {
        let (x, w) = (X[k / 2], W[k / 2]);
        (0.5 + if k % 2 == 0 { 0.5 * x } else { -0.5 * x }, 0.5 * w)
    })
}

/// Cells of exit directions: edges in θo (plane: signed s) and |φ|, radians.
struct Cells {
    theta: Vec<f64>,
    phi: Vec<f64>,
}

impl Cells {
    fn new(geometry: Geometry) -> Self {
        match geometry {
            Geometry::Plane => Self {
                theta: (0..=90).map(|k| -FRAC_PI_2 + PI * f64::from(k) / 90.0).collect(),
                phi: vec![0.0, PI],
            },
            // φ: geometric, since lobes near grazing are a fraction of a degree wide in azimuth.
            Geometry::Space => Self {
                theta: (0..=30).map(|k| FRAC_PI_2 * f64::from(k) / 30.0).collect(),
                phi: [0.0, 0.5, 1.5, 4.0, 8.0, 15.0, 30.0, 60.0, 100.0, 180.0].map(f64::to_radians).to_vec(),
            },
        }
    }

    fn count(&self) -> usize {
        (self.theta.len() - 1) * (self.phi.len() - 1)
    }

    fn locate(&self, theta: f64, phi: f64) -> usize {
        let index = |edges: &[f64], value: f64| {
            edges.partition_point(|edge| *edge <= value).clamp(1, edges.len() - 1) - 1
        };
        index(&self.theta, theta) * (self.phi.len() - 1) + index(&self.phi, phi)
    }

    /// Points of a product rule: angle, weight, cell index along the axis.
    fn points(edges: &[f64]) -> Vec<(f64, f64, usize)> {
        let cells = edges.windows(2).enumerate();
        let point = |cell: usize, low: f64, high: f64| {
            gauss().map(|(t, w)| (low + (high - low) * t, w * (high - low), cell))
        };
        cells.flat_map(|(cell, ends)| point(cell, ends[0], ends[1])).collect()
    }

    /// The solver's shares: surface cells, then interior cells, then all that is transmitted.
    fn shares(&self, solution: &Solution, incidence: usize) -> Vec<f64> {
        let plane = solution.geometry() == Geometry::Plane;
        let thetas = Self::points(&self.theta);
        let phis = if plane { vec![(0.0, 1.0, 0)] } else { Self::points(&self.phi) };
        let (theta, phi): (Vec<f64>, Vec<f64>) =
            (thetas.iter().map(|p| p.0).collect(), phis.iter().map(|p| p.0).collect());
        let basis = solution.basis(&theta, &phi);
        let interior = solution.interior(incidence, &basis);
        let mut surface = solution.single(incidence, &basis);
        surface += &solution.rehit(incidence, &basis);
        let mut shares = vec![0.0; 2 * self.count() + 1];
        for (f, (_, turn, column)) in phis.iter().enumerate() {
            for (k, (angle, rise, row)) in thetas.iter().enumerate() {
                // Both mirror halves of φ.
                let weight = rise * if plane { 1.0 } else { 2.0 * turn * angle.sin() };
                let cell = row * (self.phi.len() - 1) + column;
                shares[cell] += weight * surface[(k, f)];
                shares[self.count() + cell] += weight * interior[(k, f)];
            }
        }
        shares[2 * self.count()] = solution.lobes[incidence].transmitted;
        shares
    }

    fn counts(&self, exits: &[Exit], geometry: Geometry) -> Vec<f64> {
        let mut counts = vec![0.0; 2 * self.count() + 1];
        for exit in exits {
            let [x, y, z] = exit.direction.map(f64::from);
            let (theta, phi) = match geometry {
                Geometry::Plane => (x.atan2(z), 0.0),
                Geometry::Space => (x.hypot(y).atan2(z), y.abs().atan2(x)),
            };
            let cell = match exit.fate {
                Fate::Single | Fate::Rehit => self.locate(theta, phi),
                Fate::Interior => self.count() + self.locate(theta, phi),
                _ => 2 * self.count(),
            };
            counts[cell] += 1.0;
        }
        counts
    }
}

/// p of Pearson's chi²; cells that expect few paths are one cell together.
fn chi_square_p(counts: &[f64], shares: &[f64], paths: f64) -> f64 {
    let (mut statistic, mut cells) = (0.0, 0.0);
    let mut rest = (0.0, 0.0);
    let mut add = |count: f64, expected: f64| {
        statistic += (count - expected).powi(2) / expected;
        cells += 1.0;
    };
    for (count, share) in counts.iter().zip(shares) {
        let expected = share * paths;
        if expected < LEAST {
            rest = (rest.0 + count, rest.1 + expected);
        } else {
            add(*count, expected);
        }
    }
    if rest.1 > 5.0 {
        add(rest.0, rest.1);
    }
    // The solver knows every share, so that only the number of paths binds the cells.
    1.0 - ChiSquared::new(cells - 1.0).unwrap().cdf(statistic)
}

/// p of the Kolmogorov–Smirnov test for uniform numbers (Stephens 1970: good to 1e-3 for any count).
fn kolmogorov_smirnov_p(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    let apart = |(k, p): (usize, &f64)| f64::max((k + 1) as f64 / n - p, p - k as f64 / n);
    let distance = sorted.iter().enumerate().map(apart).fold(0.0, f64::max);
    let x = distance * (n.sqrt() + 0.12 + 0.11 / n.sqrt());
    let term = |k: i32| f64::from(1 - 2 * ((k - 1) % 2)) * (-2.0 * f64::from(k * k) * x * x).exp();
    (2.0 * (1..=100).map(term).sum::<f64>()).clamp(0.0, 1.0)
}

fn p_values(theta_i_deg: &[f64], paths: u64) -> Vec<f64> {
    let theta_i: Vec<f64> = theta_i_deg.iter().map(|angle| angle.to_radians()).collect();
    let nothing = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };
    let mut exits = vec![nothing; paths as usize];
    let mut values = Vec::new();
    for (name, transport) in stacks() {
        for geometry in [Geometry::Plane, Geometry::Space] {
            let cells = Cells::new(geometry);
            let solution = solve_to(&transport, geometry, &theta_i, SOLVED_TO, false).unwrap();
            let walker = Walker::new(&transport, geometry, Precision::Auto, None).unwrap();
            for (i, &theta) in theta_i.iter().enumerate() {
                walker.run(theta, SEED, 0..paths, u32::MAX, &mut exits);
                let (counts, shares) = (cells.counts(&exits, geometry), cells.shares(&solution, i));
                // Quadrature and energy of the shares together.
                assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-5, "{name}, {geometry:?}, {theta}");
                let p = chi_square_p(&counts, &shares, paths as f64);
                println!("{name}, {geometry:?}, {:.1}°: p = {p:.4}", theta_i_deg[i]);
                values.push(p);
            }
        }
    }
    values
}

fn are_uniform(values: &[f64]) {
    let smallest = values.iter().copied().fold(1.0, f64::min);
    let p = kolmogorov_smirnov_p(values);
    println!("{} p-values: Kolmogorov–Smirnov p = {p:.3}, smallest {smallest:.1e}", values.len());
    assert!(p > SIGNIFICANCE, "p-values are not uniform: Kolmogorov–Smirnov p = {p:e}");
    assert!(smallest * values.len() as f64 > SIGNIFICANCE, "smallest p of {}: {smallest:e}", values.len());
}

#[test]
fn the_walk_fills_the_cells_that_doubling_predicts() {
    are_uniform(&p_values(&[0.0, 30.0, 60.0, 85.0], 50_000));
}

/// 20 incidences and 10⁶ paths: `cargo test --release -p transport --test agreement -- --ignored --nocapture`.
#[test]
#[ignore = "two minutes; the short version always runs"]
fn the_walk_fills_the_cells_at_twenty_incidences() {
    let theta_i_deg: Vec<f64> = (0..20).map(|k| 4.5 * f64::from(k)).collect();
    are_uniform(&p_values(&theta_i_deg, 1_000_000));
}

/// Numbers that are not uniform, and counts that do not follow their shares, are found out.
#[test]
fn the_statistics_see_what_is_wrong() {
    let even: Vec<f64> = (0..120).map(|k| (f64::from(k) + 0.5) / 120.0).collect();
    let bent: Vec<f64> = even.iter().map(|p| p * p).collect();
    assert!(kolmogorov_smirnov_p(&even) > 0.99 && kolmogorov_smirnov_p(&bent) < SIGNIFICANCE);
    let shares = [0.5, 0.3, 0.2];
    assert!(chi_square_p(&[500.0, 300.0, 200.0], &shares, 1000.0) > 0.99);
    assert!(chi_square_p(&[550.0, 270.0, 180.0], &shares, 1000.0) < 0.01);
}

/// Shares within 4.5 standard errors (p = 7e-6 each of about 150).
#[test]
fn hard_settings_are_solved_as_they_are_walked() {
    let d = f64::to_radians;
    let mut dark = Transport::alternating(5, 1.53, 1.43, 1.53, d(4.0));
    dark.optical_depths = vec![10.0, 3.0, 10.0, 0.0, 1e3];
    let facets = Facets { slope_sd: d(4.0), normals: Normals::Unweighted };
    let metal = Transport {
        indices: vec![1.0, 1.6, 1.4, 0.6],
        extinctions: vec![0.0, 0.0, 0.02, 6.7],
        optical_depths: vec![0.0, 0.05],
        facets,
        ..Transport::paper()
    };
    let pigments = Transport {
        indices: vec![1.3, 1.7, 1.2, 1.7, 1.2, 1.9],
        extinctions: vec![0.0, 0.01, 0.2, 0.01, 0.2, 3.4],
        optical_depths: vec![0.02, 0.1, 0.02, 0.1],
        facets: Facets { slope_sd: d(8.0), normals: Normals::Visible },
        ..Transport::paper()
    };
    let mut narrow = Transport::alternating(8, 1.53, 1.43, 1.53, d(1.0));
    narrow.optical_depths[3] = 0.01;
    for (name, transport, paths) in [
        ("one layer", Transport::alternating(1, 1.53, 1.43, 1.43, d(2.0)), 60_000),
        ("100,000 layers", Transport::alternating(100_000, 1.53, 1.43, 1.53, d(3.0)), 600),
        ("slopes of 25 degrees", Transport::alternating(20, 1.53, 1.43, 1.53, d(25.0)), 60_000),
        ("slopes of 1 degree, not periodic", narrow, 60_000),
        ("contrast of 1e-6", Transport::alternating(100, 1.53, 1.529_999, 1.53, d(4.0)), 20_000),
        ("black layers", dark, 60_000),
        ("on a metal", metal, 60_000),
        ("pigments on carbon, visible normals", pigments, 60_000),
    ] {
        for geometry in [Geometry::Plane, Geometry::Space] {
            let theta_i = [0.0, d(60.0), d(89.0), d(89.99)];
            let solution = solve_to(&transport, geometry, &theta_i, 5e-3, false).unwrap();
            let walker = Walker::new(&transport, geometry, Precision::Auto, None).unwrap();
            let nothing = Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated };
            let mut exits = vec![nothing; paths];
            for (lobe, theta) in solution.lobes.iter().zip(theta_i) {
                walker.run(theta, SEED, 0..paths as u64, u32::MAX, &mut exits);
                for (what, share, fates) in [
                    ("surface", lobe.surface, &[Fate::Single, Fate::Rehit][..]),
                    ("interior", lobe.albedo - lobe.surface, &[Fate::Interior]),
                    ("transmitted", lobe.transmitted, &[Fate::Transmitted]),
                ] {
                    let weights =
                        exits.iter().map(|e| if fates.contains(&e.fate) { f64::from(e.weight) } else { 0.0 });
                    let (sum, square) = weights.fold((0.0, 0.0), |(s, q), w| (s + w, q + w * w));
                    let (n, mean) = (paths as f64, sum / paths as f64);
                    // Of a few paths' share the sample says too little: Poisson's law of the expected count instead.
                    let faint = if share * n < LEAST { share } else { 0.0 };
                    let error = ((square / n - mean * mean).max(faint) / n).sqrt();
                    assert!(
                        (mean - share).abs() < 4.5 * error + 1e-6,
                        "{name}, {geometry:?}, {:.2}°: {what} {share} solved, {mean} ± {error} walked",
                        theta.to_degrees()
                    );
                }
            }
        }
    }
}

/// What one affordable plan cannot hold is refused before any work, with what would do.
#[test]
fn a_tenth_of_a_degree_in_space_is_refused_with_its_price() {
    let narrow = Transport::alternating(500, 1.53, 1.43, 1.53, 0.1_f64.to_radians());
    let refused = solve_to(&narrow, Geometry::Space, &[0.5], 1e-3, false).unwrap_err().to_string();
    assert!(
        refused.contains("0.1°") && refused.contains("GiB") && refused.contains("use the walk"),
        "{refused}"
    );
}
