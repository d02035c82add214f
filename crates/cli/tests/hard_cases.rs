//! The catalogue of hard cases (`tests/data/hard_transport.json`): walk, doubling, table and BSDF where floating point
//! and geometry are at their worst, each with what naive code makes of it.
//!
//! `NACRE_WRITE_DOCS=1 cargo test --release -p nacre-cli --test hard_cases` writes `docs/HARD-CASES.md` anew.

#[path = "hard_cases/naive.rs"]
mod naive;

use bake_brdf::bake::{self, Bands, Observer, Request};
use bake_brdf::effects::{Effect, EffectSet, Effects};
use bake_brdf::options::{DEFAULT_EVENT_CAP, Options, Target};
use bake_brdf::recipe::Recipe;
use bake_brdf::tally::{CHUNK, Cells, Tally};
use lut_io::axis::ExitAxis;
use lut_io::lobe::Interpolant;
use lut_io::measure;
use lut_io::table::{Component, Table};
use pearl_bsdf::{Components, Controls, PearlBsdf};
use rand::rngs::SmallRng;
use rand::{Rng as _, SeedableRng as _, TryRng};
use serde::Deserialize;
use std::convert::Infallible;
use std::fmt::Write as _;
use std::path::PathBuf;
use std::sync::{Mutex, OnceLock};
use transport::walk::lanes::{Precision, Walker};
use transport::walk::reference::{Estimator, Reference};
use transport::walk::{Exit, Fate};
use transport::{Facets, Geometry, Normals, Transport, doubling};

/// The file.
#[derive(Deserialize)]
struct Catalogue {
    cases: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    id: String,
    subject: String,
    /// Why it is hard.
    why: String,
    /// Where the answer comes from.
    answer: String,
    /// What naive code does.
    naive: String,
    /// Largest error that passes.
    tolerance: f64,
    measure: Measure,
}

#[derive(Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
enum Measure {
    Albedo {
        solver: Solver,
        stack: Stack,
        theta_i_deg: f64,
        against: Against,
        naive: Naive,
        paths: u64,
        geometry: Shape,
        seed: u64,
    },
    Ledger {
        solver: Solver,
        stack: Stack,
        theta_i_deg: f64,
        paths: u64,
        cap: u32,
    },
    Absorbed {
        solver: Solver,
        stack: Stack,
        theta_i_deg: f64,
        paths: u64,
    },
    Sum {
        weight: f64,
        doublings: u32,
    },
    Precision {
        stack: Stack,
        theta_i_deg: f64,
        paths: u64,
        geometry: Shape,
    },
    Storage,
    Integral {
        theta_i_deg: f64,
    },
    Between,
    Bsdf {
        wi: [Number; 3],
        wo: [Number; 3],
        like_wi: Option<[f64; 3]>,
        like_wo: Option<[f64; 3]>,
    },
    Sample {
        wi: [f64; 3],
        component: Shown,
    },
    CornerWords {
        stack: Stack,
        theta_i_deg: f64,
        geometry: Shape,
        estimator: Sampling,
    },
    Moments,
    ReadingF32,
    EvalF32,
    SampleF32,
    Refused {
        stack: Stack,
        theta_i_deg: f64,
    },
}

#[derive(Clone, Copy, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase")]
enum Solver {
    Walk,
    Doubling,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Against {
    Star,
    Walk,
    Doubling,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Naive {
    Angles,
    Single,
    Literal,
    Clear,
    Pairs,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Shown {
    All,
    Diffuse,
    Mirror,
    Blur,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Sampling {
    Analog,
    Forced,
    Visible,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Shape {
    Plane,
    Space,
}

/// JSON has no NaN.
#[derive(Clone, Deserialize)]
#[serde(untagged)]
enum Number {
    Finite(f64),
    Named(String),
}

impl Number {
    fn get(&self) -> f64 {
        match self {
            Self::Finite(value) => *value,
            Self::Named(name) => name.parse().expect("a number by name"),
        }
    }
}

#[derive(Clone, Deserialize)]
#[serde(deny_unknown_fields)]
struct Stack {
    layers: usize,
    odd: f64,
    even: f64,
    substrate: f64,
    sigma_deg: f64,
    #[serde(default = "vacuum")]
    ambient: f64,
    #[serde(default)]
    k_odd: f64,
}

fn vacuum() -> f64 {
    1.0
}

impl Stack {
    /// The paper's pearl.
    fn paper() -> Self {
        Self { layers: 500, odd: 1.53, even: 1.43, substrate: 1.53, sigma_deg: 2.0, ambient: 1.0, k_odd: 0.0 }
    }

    fn transport(&self) -> Transport {
        let sigma = self.sigma_deg.to_radians();
        let mut transport = Transport::alternating(self.layers, self.odd, self.even, self.substrate, sigma);
        transport.indices[0] = self.ambient;
        for depth in transport.optical_depths.iter_mut().step_by(2) {
            // 450 nm at 550 nm.
            *depth = 4.0 * std::f64::consts::PI * self.k_odd * 450.0 / 550.0;
        }
        transport.facets = Facets { slope_sd: sigma, normals: Normals::Unweighted };
        transport
    }
}

/// Shares of the light, and the standard error of each (0 for what is not sampled).
#[derive(Clone, Copy, Default)]
struct Shares {
    albedo: f64,
    transmitted: f64,
    absorbed: f64,
    truncated: f64,
    error: f64,
}

fn geometry(shape: Shape) -> Geometry {
    match shape {
        Shape::Plane => Geometry::Plane,
        Shape::Space => Geometry::Space,
    }
}

fn exits(
    transport: &Transport,
    shape: Shape,
    theta_i: f64,
    precision: Precision,
    paths: u64,
    seed: u64,
) -> Vec<Exit> {
    let walker =
        Walker::new(transport, geometry(shape), precision, None).expect("a stack that can be walked");
    let mut exits = vec![Exit { direction: [0.0; 3], weight: 0.0, fate: Fate::Truncated }; paths as usize];
    walker.run(theta_i, seed, 0..paths, DEFAULT_EVENT_CAP, &mut exits);
    exits
}

/// The production walk through the production sums.
fn walked(
    transport: &Transport,
    shape: Shape,
    theta_i_deg: f64,
    precision: Precision,
    paths: u64,
    seed: u64,
) -> Shares {
    let theta_i = theta_i_deg.to_radians();
    let axis = bake::exit_axis(geometry(shape), transport.facets.slope_sd);
    let cells = Cells::new(&axis, theta_i);
    let mut tally = Tally::new(cells.count());
    for chunk in exits(transport, shape, theta_i, precision, paths, seed).chunks(CHUNK as usize) {
        tally.add_chunk(&cells, chunk);
    }
    let summary = tally.summary(theta_i_deg);
    Shares {
        albedo: summary.albedo,
        transmitted: summary.transmitted,
        absorbed: summary.absorbed,
        truncated: summary.truncated,
        error: summary.std_error.albedo,
    }
}

fn doubled(transport: &Transport, shape: Shape, theta_i_deg: f64) -> Result<Shares, String> {
    let theta_i = [theta_i_deg.to_radians()];
    if transport.facets.slope_sd == 0.0 {
        let lobes = doubling::smooth(transport, &theta_i).map_err(|why| why.to_string())?;
        return Ok(shares(&lobes[0]));
    }
    // A walk and a doubling of the same stack are each other's answer.
    static SOLVED: Mutex<Vec<(Transport, Geometry, f64, Shares)>> = Mutex::new(Vec::new());
    let is_it = |(of, in_, at, _): &&(Transport, Geometry, f64, Shares)| {
        (of, *in_, *at) == (transport, geometry(shape), theta_i[0])
    };
    if let Some((.., shares)) = SOLVED.lock().unwrap().iter().find(is_it) {
        return Ok(*shares);
    }
    let solution = doubling::solve_to(transport, geometry(shape), &theta_i, 1e-6, false);
    let found = shares(&solution.map_err(|why| why.to_string())?.lobes[0]);
    SOLVED.lock().unwrap().push((transport.clone(), geometry(shape), theta_i[0], found));
    Ok(found)
}

fn shares(lobe: &doubling::Lobe) -> Shares {
    Shares {
        albedo: lobe.albedo,
        transmitted: lobe.transmitted,
        absorbed: lobe.absorbed,
        ..Shares::default()
    }
}

fn solved(
    solver: Solver,
    transport: &Transport,
    shape: Shape,
    theta_i_deg: f64,
    paths: u64,
    seed: u64,
) -> Result<Shares, String> {
    match solver {
        Solver::Walk => Ok(walked(transport, shape, theta_i_deg, Precision::Auto, paths, seed)),
        Solver::Doubling => doubled(transport, shape, theta_i_deg),
    }
}

/// Stands for a refusal in one line.
const REFUSED: f64 = f64::MIN;

/// What a case came to.
struct Found {
    answer: f64,
    naive: f64,
    ours: f64,
    /// In the unit that the case's tolerance has.
    error: f64,
    unit: &'static str,
}

impl Found {
    fn absolute(answer: f64, naive: f64, ours: f64) -> Self {
        Self { answer, naive, ours, error: (ours - answer).abs(), unit: "" }
    }
}

fn run(measure: &Measure) -> Result<Found, String> {
    match measure {
        Measure::Albedo { solver, stack, theta_i_deg, against, naive, paths, geometry, seed } => {
            let transport = stack.transport();
            let theta = *theta_i_deg;
            let ours = solved(*solver, &transport, *geometry, theta, *paths, *seed)?;
            let answer = match against {
                Against::Star => {
                    let [albedo, ..] = naive::star(&transport, theta.to_radians());
                    Shares { albedo, ..Shares::default() }
                }
                Against::Doubling => doubled(&transport, *geometry, theta)?,
                Against::Walk => walked(&transport, *geometry, theta, Precision::F64, *paths, *seed),
            };
            let naive = match naive {
                Naive::Angles => naive::star_by_angles_in_f32(&transport, theta.to_radians()),
                Naive::Single => naive::each_interface_once(&transport, theta.to_radians()),
                Naive::Pairs => naive::whole_pairs(&transport, theta.to_radians()),
                Naive::Literal => naive::literal_walk(&transport, theta.to_radians()),
                Naive::Clear => {
                    let clear =
                        Transport { optical_depths: vec![0.0; transport.layers()], ..transport.clone() };
                    naive::star(&clear, theta.to_radians())[0]
                }
            };
            let spread = ours.error.hypot(answer.error);
            let difference = (ours.albedo - answer.albedo).abs();
            let found = Found::absolute(answer.albedo, naive, ours.albedo);
            // Where every path has the same end there is no spread to measure by: the digits themselves.
            Ok(if spread > 0.0 {
                Found { error: difference / spread, unit: " s.e.", ..found }
            } else {
                found
            })
        }
        Measure::Ledger { solver, stack, theta_i_deg, paths, cap } => {
            let transport = stack.transport();
            let ours = solved(*solver, &transport, Shape::Plane, *theta_i_deg, *paths, 1)?;
            if ours.truncated > 0.0 {
                return Err(format!("{} of the light was truncated", ours.truncated));
            }
            let sum = ours.albedo + ours.transmitted + ours.absorbed;
            let naive = naive::walk_that_forgets_long_paths(&transport, theta_i_deg.to_radians(), *cap);
            Ok(Found::absolute(1.0, naive, sum))
        }
        Measure::Absorbed { solver, stack, theta_i_deg, paths } => {
            let transport = stack.transport();
            let ours = solved(*solver, &transport, Shape::Plane, *theta_i_deg, *paths, 1)?;
            let [_, _, absorbed] = naive::star(&transport, theta_i_deg.to_radians());
            let naive = f64::from(1.0_f32 - (-transport.optical_depths[0] as f32).exp());
            Ok(Found::absolute(absorbed, naive, ours.absorbed))
        }
        Measure::Sum { weight, doublings } => Ok(sum(*weight, *doublings)),
        Measure::Precision { stack, theta_i_deg, paths, geometry } => {
            let transport = stack.transport();
            let albedo = |precision| walked(&transport, *geometry, *theta_i_deg, precision, *paths, 7).albedo;
            let naive = naive::star_by_angles_in_f32(&transport, theta_i_deg.to_radians());
            Ok(Found::absolute(albedo(Precision::F64), naive, albedo(Precision::F32)))
        }
        Measure::Storage => Ok(storage()),
        Measure::Integral { theta_i_deg } => Ok(integral(*theta_i_deg)),
        Measure::Between => Ok(between()),
        Measure::Bsdf { wi, wo, like_wi, like_wo } => {
            let [wi, wo] = [wi, wo].map(|w| w.each_ref().map(Number::get));
            let luminance = |wi, wo| bsdf().eval(wi, wo).rgb()[1];
            let answer = match (like_wi, like_wo) {
                (Some(wi), Some(wo)) => luminance(unit(*wi), unit(*wo)),
                _ => 0.0,
            };
            let (ours, naive) = (luminance(wi, wo), naive::cosine_of_azimuth(wi, wo));
            let error = (ours - answer).abs() / if answer > 0.0 { answer } else { 1.0 };
            Ok(Found { answer, naive, ours, error, unit: if answer > 0.0 { " relative" } else { "" } })
        }
        Measure::Sample { wi, component } => Ok(sample(unit(*wi), *component)),
        Measure::CornerWords { stack, theta_i_deg, geometry, estimator } => {
            Ok(corner_words(stack.transport(), theta_i_deg.to_radians(), *geometry, *estimator))
        }
        Measure::Moments => Ok(moments()),
        Measure::ReadingF32 => Ok(reading_in_f32()),
        Measure::EvalF32 => Ok(eval_in_f32()),
        Measure::SampleF32 => Ok(sample_in_f32()),
        Measure::Refused { stack, theta_i_deg } => {
            match doubled(&stack.transport(), Shape::Plane, *theta_i_deg) {
                // One line that names a number and its range; no number is better than a smeared one.
                Err(why) if why.lines().count() == 1 && why.contains('=') => {
                    let sigma = stack.sigma_deg.to_radians();
                    let naive = naive::lobe_on_a_grid(sigma, theta_i_deg.to_radians());
                    // Where a number would stand there is none.
                    Ok(Found { answer: 2.0 * sigma, naive, ours: REFUSED, error: 0.0, unit: "" })
                }
                Err(why) => Err(format!("refused without a reason: {why}")),
                Ok(shares) => Err(format!("not refused: albedo {}", shares.albedo)),
            }
        }
    }
}

fn unit(w: [f64; 3]) -> [f64; 3] {
    let length = w.iter().map(|v| v * v).sum::<f64>().sqrt();
    w.map(|v| v / length)
}

/// A tally of one chunk, added to itself until it holds 2³⁰ paths.
fn sum(weight: f64, doublings: u32) -> Found {
    let axis = ExitAxis::Plane { cells: 2, width: 0.1 };
    let cells = Cells::new(&axis, 0.5);
    let exit = Exit { direction: [0.5, 0.0, 0.8], weight: weight as f32, fate: Fate::Interior };
    let mut tally = Tally::new(cells.count());
    tally.add_chunk(&cells, &vec![exit; CHUNK as usize]);
    for _ in 0..doublings {
        let same = tally.clone();
        tally.add(&same);
    }
    let paths = CHUNK << doublings;
    assert_eq!(tally.paths, paths);
    assert_eq!(tally.component(Component::Interior).count.iter().sum::<u64>(), paths, "a path was lost");
    let naive = naive::f32_sum(weight as f32, paths) / paths as f64;
    // Sums of angles take part: the moments of so many equal paths are those of one chunk.
    let mut chunk = Tally::new(cells.count());
    chunk.add_chunk(&cells, &vec![exit; CHUNK as usize]);
    assert_eq!(tally.moments(0.5), chunk.moments(0.5), "a sum of angles lost a unit");
    // The walk's weights are f32: a third is the nearest of those.
    Found::absolute(f64::from(weight as f32), naive, tally.summary(0.0).albedo)
}

fn paper(incident_deg: &[f64], target: Target) -> Request {
    let effects = [Effect::Surface, Effect::Blur, Effect::Azimuth].into_iter().collect();
    request(Recipe::default(), effects, incident_deg, target)
}

fn request(recipe: Recipe, effects: EffectSet, incident_deg: &[f64], target: Target) -> Request {
    let incident_deg = Some(incident_deg.to_vec());
    let options = Options { effects: Effects::Listed(effects), incident_deg, target, ..Options::default() };
    Request::of(recipe, effects, options).unwrap()
}

fn solution(incident_deg: &[f64]) -> Table {
    let request = paper(incident_deg, Target::AccuracyPercent(0.01));
    bake::doubling(&request, &Bands::own(&request.recipe)).expect("the paper's pearl")
}

/// The paper's pearl at every 5°.
fn lobe() -> &'static Interpolant {
    static LOBE: OnceLock<Interpolant> = OnceLock::new();
    LOBE.get_or_init(|| Interpolant::new(solution(&(0..=18).map(|i| 5.0 * f64::from(i)).collect::<Vec<_>>())))
}

fn bsdf() -> &'static PearlBsdf {
    static BSDF: OnceLock<PearlBsdf> = OnceLock::new();
    BSDF.get_or_init(|| {
        let table = lobe().table().clone();
        let controls = Controls { depth: 0.0, coherence: 0.0, ..Controls::of(table.meta()) };
        PearlBsdf::from_table(table, controls).expect("a BSDF")
    })
}

/// Worst relative difference between Σ value·weight and the ledger over the stored rows.
fn storage() -> Found {
    // A walk: its shares are whole numbers of paths.
    let request = paper(&[10.0, 30.0, 60.0, 85.0], Target::Paths(20_000));
    let table = bake::walk(&request, &Bands::own(&request.recipe), &Observer::idle(), None).expect("a walk");
    let cells = table.meta().exit_axis.cells();
    let (mut ours, mut naive) = (0.0_f64, 0.0_f64);
    for (i, at) in table.meta().per_incidence.iter().enumerate() {
        let weights = measure::reading_weights(
            &table.meta().exit_axis,
            at.theta_i_deg.to_radians(),
            at.azimuth_width_deg.to_radians(),
        );
        let values = &table.lobe(Component::Interior).value[i * cells..(i + 1) * cells];
        let share = at.albedo - at.surface;
        let read = |stored: fn(f32) -> f64| {
            weights.iter().zip(values).map(|(w, v)| w * stored(*v)).sum::<f64>() / share - 1.0
        };
        ours = ours.max(read(f64::from).abs());
        naive = naive.max(read(naive::half).abs());
    }
    Found { answer: 0.0, naive, ours, error: ours, unit: " relative" }
}

/// The hemispherical integral of the interior as it is read, against its albedo.
fn integral(theta_i_deg: f64) -> Found {
    let lobe = lobe();
    let theta_i = theta_i_deg.to_radians();
    let albedo = lobe.albedo(Component::Interior, theta_i);
    let ours = lobe.row(theta_i).integrals()[0];
    let naive = naive::integral_of_rows_mixed_at_equal_angle(lobe, theta_i_deg);
    Found { answer: albedo, naive, ours, error: (ours / albedo - 1.0).abs(), unit: " relative" }
}

/// Just short of 90°, radians.
const HORIZON: f64 = 1.57;

/// Total variation of the lobe read at 42.5° against its own solution.
fn between() -> Found {
    let truth = Interpolant::new(solution(&[42.5]));
    let theta_i = 42.5_f64.to_radians();
    let distance = |read: &dyn Fn(f64) -> f64| {
        let (mut difference, mut total) = (0.0, 0.0);
        let row = truth.row(theta_i);
        for k in 0..4000 {
            let s = HORIZON * (2.0 * (f64::from(k) + 0.5) / 4000.0 - 1.0);
            let exact = naive::in_plane(&row, s);
            difference += 0.5 * (read(s) - exact).abs() * s.sin().abs();
            total += exact * s.sin().abs();
        }
        difference / total
    };
    let [low, middle, high] = [40.0_f64, 42.5, 45.0].map(|theta| lobe().row(theta.to_radians()));
    let ours = distance(&|s| naive::in_plane(&middle, s));
    let naive = distance(&|s| 0.5 * (naive::in_plane(&low, s) + naive::in_plane(&high, s)));
    Found { answer: 0.0, naive, ours, error: ours, unit: " total variation" }
}

/// The BSDF with one component shown.
fn showing(component: Shown) -> PearlBsdf {
    let none = Components { diffuse: false, incoherent: false, mirror: false, blur: false };
    let components = match component {
        Shown::All => Components::ALL,
        Shown::Diffuse => Components { diffuse: true, ..none },
        Shown::Mirror => Components { mirror: true, ..none },
        Shown::Blur => Components { blur: true, ..none },
    };
    let controls = Controls { components, ..*bsdf().controls() };
    PearlBsdf::new(bsdf().prepared().clone(), controls).expect("a BSDF")
}

/// Largest departure from a unit vector with its own density over the corners of the unit cube.
fn sample(wi: [f64; 3], component: Shown) -> Found {
    let corners = [
        0.0,
        f64::MIN_POSITIVE,
        2f64.powi(-32),
        0.5,
        1.0 - f64::from(f32::EPSILON),
        1.0 - f64::EPSILON / 2.0,
    ];
    let bsdf = showing(component);
    let mut worst = 0.0_f64;
    let mut naive = 0.0_f64;
    let mut nan = false;
    let mut found_any = false;
    for u1 in corners {
        for u2 in corners {
            let departure = (naive::box_muller_length(u1, u2) - 1.0).abs();
            naive = if departure.is_nan() { departure } else { naive.max(departure) };
            nan |= naive.is_nan();
            for u3 in corners {
                let Some(found) = bsdf.sample(wi, u1, u2, u3) else { continue };
                found_any = true;
                let length = found.wo.iter().map(|v| v * v).sum::<f64>().sqrt();
                let density = bsdf.pdf(wi, found.wo);
                let departures = [length - 1.0, density / found.pdf - 1.0, (-found.wo[2]).max(0.0)];
                for departure in departures {
                    worst = if departure.is_nan() { f64::NAN } else { worst.max(departure.abs()) };
                }
            }
        }
    }
    assert!(found_any, "no corner of the cube has a direction");
    let naive = if nan { f64::NAN } else { naive };
    Found { answer: 0.0, naive, ours: worst, error: worst, unit: "" }
}

/// Random numbers of which one is at an end of its range.
struct Cornered {
    random: SmallRng,
    left: usize,
    word: u64,
}

impl TryRng for Cornered {
    type Error = Infallible;

    fn try_next_u32(&mut self) -> Result<u32, Infallible> {
        Ok((self.try_next_u64()? >> 32) as u32)
    }

    fn try_next_u64(&mut self) -> Result<u64, Infallible> {
        let word = self.random.next_u64();
        let at_corner = self.left == 0;
        self.left = self.left.wrapping_sub(1);
        Ok(if at_corner { self.word } else { word })
    }

    fn try_fill_bytes(&mut self, bytes: &mut [u8]) -> Result<(), Infallible> {
        self.random.fill_bytes(bytes);
        Ok(())
    }
}

/// Largest departure of the walk's exits from unit vectors of weight 0 … 1, with each of the first 40 random words of a
/// path in turn at an end of its range.
fn corner_words(mut transport: Transport, theta_i: f64, geometry: Shape, estimator: Sampling) -> Found {
    if matches!(estimator, Sampling::Visible) {
        transport.facets.normals = Normals::Visible;
    }
    let reference = Reference {
        estimator: match estimator {
            Sampling::Forced => Estimator::ForcedEntry,
            _ => Estimator::Analog,
        },
        ..Reference::new(&transport, self::geometry(geometry))
    };
    let mut worst = 0.0_f64;
    for left in 0..40 {
        for word in [0, 1, u64::from(u32::MAX), 1 << 63, u64::MAX - 1, u64::MAX] {
            let mut random = Cornered { random: SmallRng::seed_from_u64(left as u64), left, word };
            let end = reference.path(theta_i, &mut random);
            let length = end.direction.iter().map(|v| v * v).sum::<f64>().sqrt();
            for departure in [length - 1.0, (end.weight - 1.0).max(0.0), (-end.weight).max(0.0)] {
                worst = if departure.is_nan() { f64::NAN } else { worst.max(departure.abs()) };
            }
        }
    }
    Found { answer: 0.0, naive: naive::box_muller_length(0.0, 0.5), ours: worst, error: worst, unit: "" }
}

/// Skewness of the exit angle from the production sums, against two passes in 64 bits.
fn moments() -> Found {
    let transport = Stack::paper().transport();
    let theta_i = 30_f64.to_radians();
    let exits = exits(&transport, Shape::Plane, theta_i, Precision::Auto, 200_000, 5);
    let axis = bake::exit_axis(Geometry::Plane, transport.facets.slope_sd);
    let cells = Cells::new(&axis, theta_i);
    let mut tally = Tally::new(cells.count());
    for chunk in exits.chunks(CHUNK as usize) {
        tally.add_chunk(&cells, chunk);
    }
    let up = |exit: &&Exit| matches!(exit.fate, Fate::Single | Fate::Rehit | Fate::Interior);
    let angles: Vec<f64> = exits.iter().filter(up).map(|exit| cells.locate(exit.direction).0).collect();
    let n = angles.len() as f64;
    let mean = angles.iter().sum::<f64>() / n;
    let central = |power| angles.iter().map(|s| (s - mean).powi(power)).sum::<f64>() / n;
    let answer = central(3) / central(2).powf(1.5);
    Found::absolute(answer, naive::skewness_in_f32(&angles), tally.moments(theta_i).skew)
}

/// Directions over both hemispheres, up to 89.9°, and near each other: where renderers ask.
fn pairs() -> impl Iterator<Item = ([f64; 3], [f64; 3])> {
    let angles = [1e-4_f64, 0.02, 0.5, 5.0, 20.0, 45.0, 70.0, 85.0, 89.9];
    let at = |theta: f64, phi: f64| {
        let (theta, phi) = (theta.to_radians(), phi.to_radians());
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
    };
    angles.into_iter().flat_map(move |theta_i| {
        angles.into_iter().flat_map(move |theta_o| {
            [180.0, 178.0, 150.0, 90.0, 1.0].into_iter().map(move |phi| (at(theta_i, 0.0), at(theta_o, phi)))
        })
    })
}

fn narrow(w: [f64; 3]) -> [f64; 3] {
    w.map(|v| f64::from(v as f32))
}

/// Largest relative difference of `read` at directions of 32 bits from 64 bits, among values above a thousandth of the largest.
fn largest_difference(
    read: impl Fn([f64; 3], [f64; 3]) -> f64,
    other: impl Fn([f64; 3], [f64; 3]) -> f64,
) -> f64 {
    let values: Vec<(f64, f64)> = pairs().map(|(wi, wo)| (read(wi, wo), other(wi, wo))).collect();
    let largest = values.iter().map(|(value, _)| *value).fold(0.0, f64::max);
    let mut worst = 0.0_f64;
    for (value, other) in values.iter().filter(|(value, _)| *value > 1e-3 * largest) {
        let difference = (other / value - 1.0).abs();
        worst = if difference.is_nan() { f64::NAN } else { worst.max(difference) };
    }
    worst
}

/// The table between its nodes at angles of 32 bits.
fn reading_in_f32() -> Found {
    let angle = |w: [f64; 3]| w[0].hypot(w[1]).atan2(w[2]);
    // φ is counted from the mirror direction.
    let phi =
        |wi: [f64; 3], wo: [f64; 3]| (wi[0] * wo[1] - wi[1] * wo[0]).atan2(-(wi[0] * wo[0] + wi[1] * wo[1]));
    let read = |theta_i, theta_o, phi: f64| lobe().eval(Component::Interior, theta_i, theta_o, phi);
    let exact = |wi, wo| read(angle(wi), angle(wo), phi(wi, wo));
    let narrow = |value: f64| f64::from(value as f32);
    let ours =
        largest_difference(exact, |wi, wo| read(narrow(angle(wi)), narrow(angle(wo)), narrow(phi(wi, wo))));
    let naive = largest_difference(exact, |wi, wo| {
        read(naive::angle_in_f32(wi), naive::angle_in_f32(wo), phi(wi, wo))
    });
    Found { answer: 0.0, naive, ours, error: ours, unit: " relative" }
}

/// The BSDF at directions of 32 bits.
fn eval_in_f32() -> Found {
    let luminance = |wi, wo| bsdf().eval(wi, wo).rgb()[1];
    let ours = largest_difference(luminance, |wi, wo| luminance(narrow(wi), narrow(wo)));
    let by_acos = |w: [f64; 3]| {
        let theta = naive::angle_in_f32(w);
        let phi = w[1].atan2(w[0]);
        [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
    };
    let naive = largest_difference(luminance, |wi, wo| luminance(by_acos(wi), by_acos(wo)));
    Found { answer: 0.0, naive, ours, error: ours, unit: " relative" }
}

/// A sampled direction handed on in 32 bits: its density there against the one that it was sampled with.
fn sample_in_f32() -> Found {
    let mut random = SmallRng::seed_from_u64(9);
    let mut number = || (random.next_u64() >> 11) as f64 * 2f64.powi(-53);
    let (mut ours, mut naive) = (0.0_f64, 0.0_f64);
    for theta_i in [0.5_f64, 30.0, 60.0, 85.0] {
        let wi = [theta_i.to_radians().sin(), 0.0, theta_i.to_radians().cos()];
        for _ in 0..500 {
            let Some(found) = bsdf().sample(wi, number(), number(), number()) else { continue };
            let departure = |wo| (bsdf().pdf(narrow(wi), wo) / found.pdf - 1.0).abs();
            // Within a hundredth of a degree of the horizon the last place of an f32 is a share of cos θo itself.
            if found.wo[2] > 2e-4 {
                ours = ours.max(departure(narrow(found.wo)));
                naive = naive.max(departure(found.wo.map(naive::half_float)));
            }
        }
    }
    Found { answer: 0.0, naive, ours, error: ours, unit: " relative" }
}

fn root(path: &str) -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..").join(path)
}

fn catalogue() -> Vec<Case> {
    let text = std::fs::read_to_string(root("tests/data/hard_transport.json")).expect("the catalogue");
    serde_json::from_str::<Catalogue>(&text).expect("a valid catalogue").cases
}

fn number(value: f64) -> String {
    match value {
        v if v.is_nan() => "NaN".to_owned(),
        REFUSED => "refused".to_owned(),
        f64::INFINITY => "∞".to_owned(),
        f64::NEG_INFINITY => "−∞".to_owned(),
        v if v == 0.0 || (1e-3..1e4).contains(&v.abs()) => format!("{v:.6}"),
        v => format!("{v:.2e}"),
    }
}

const DOCS: &str = "docs/HARD-CASES.md";
/// What it begins with.
const INTRODUCTION: &str = "\
# Hard cases

Where straightforward code breaks, what it says there, and what this program says. For whoever
writes a solver or a reader of tables, and for whoever doubts ours. A row has the right *answer*
and where it is from, then what *naive code* of the kind that is named *gives*. Then come what
*ours* says, and its *error* (s.e.: in standard errors of the difference). Albedos are at σ = 2° in
the plane unless the case says otherwise.

The cases are in `tests/data/hard_transport.json`, the naive variants in
`crates/cli/tests/hard_cases/naive.rs`. The table is written by
`NACRE_WRITE_DOCS=1 cargo test --release -p nacre-cli --test hard_cases`.";
/// Where another part of it begins.
const PLUGIN: &str = "## The Mitsuba plugin";

#[test]
#[allow(clippy::print_stdout)] // the figures are the point
fn every_hard_case_has_its_answer() {
    let cases = catalogue();
    let mut table = format!(
        "{INTRODUCTION}\n\n\
         | case | why it is hard | answer | from | naive code | gives | ours | error |\n|---|---|---|---|---|---|---|---|\n",
    );
    let mut failed = Vec::new();
    for case in &cases {
        let Case { id, why, answer: source, naive: naive_does, tolerance, .. } = case;
        assert!(
            ["walk", "doubling", "table", "bsdf"].contains(&case.subject.as_str()),
            "{id}: {}",
            case.subject
        );
        match run(&case.measure) {
            // Written so that a NaN fails.
            Ok(found) => {
                let pass = found.error <= *tolerance;
                let (answer, naive, ours) = (number(found.answer), number(found.naive), number(found.ours));
                let error = format!("{:.1e}{}", found.error, found.unit);
                println!(
                    "{} {id}: {answer} ({source}); naive {naive}; ours {ours}; error {error} of {tolerance:e}",
                    if pass { "ok    " } else { "FAILED" }
                );
                let _ = writeln!(
                    table,
                    "| {id} | {why} | {answer} | {source} | {naive_does} | {naive} | {ours} | {error} |"
                );
                if !pass {
                    failed.push(id);
                }
            }
            Err(why) => {
                println!("FAILED {id}: {why}");
                failed.push(id);
            }
        }
    }
    assert!(failed.is_empty(), "{} of {} cases: {failed:?}", failed.len(), cases.len());
    if std::env::var_os("NACRE_WRITE_DOCS").is_some() {
        // The plugin's part is written by the Python tests.
        let old = std::fs::read_to_string(root(DOCS)).unwrap_or_default();
        let plugin = old.find(PLUGIN).map_or("", |at| &old[at..]);
        let page = if plugin.is_empty() { table } else { format!("{table}\n{plugin}") };
        std::fs::write(root(DOCS), page).expect("the documentation is written");
    }
}

#[test]
fn the_documentation_has_every_case() {
    let text = std::fs::read_to_string(root(DOCS)).expect("docs/HARD-CASES.md");
    for case in catalogue() {
        assert!(text.contains(&format!("| {} |", case.id)), "{} is not in {DOCS}: write it anew", case.id);
    }
}

#[test]
fn naive_sums_lose_paths_that_ours_keep() {
    let found = sum(1.0, 18);
    assert_eq!(found.ours, 1.0);
    assert!(found.naive < 0.02, "an f32 counter stands still at 2^24 of 2^30: {}", found.naive);
}

/// What `lut check` says of a table that a hard stack bakes to by either solver.
#[test]
fn tables_of_hard_stacks_keep_what_every_table_keeps() {
    let stacks = [
        r#"{"stack":{"layers":20},"facets":{"slope_sd_deg":0}}"#,
        r#"{"stack":{"layers":20},"facets":{"slope_sd_deg":0},"azimuth":{"mode":"space"}}"#,
        r#"{"stack":{"layers":20},"facets":{"slope_sd_deg":1e-6}}"#,
        r#"{"stack":{"layers":20},"facets":{"slope_sd_deg":25},"azimuth":{"mode":"space"}}"#,
        r#"{"stack":{"layers":3},"azimuth":{"mode":"space"}}"#,
        r#"{"stack":{"conchiolin":{"n":1.5300000015}}}"#,
        r#"{"stack":{"layers":50,"aragonite":{"n":0.9},"conchiolin":{"n":0.8},"substrate":{"n":1.0}}}"#,
        r#"{"stack":{"layers":4,"ambient":{"n":1.9},"aragonite":{"n":1.2},"conchiolin":{"n":1.0},"substrate":{"n":1.0}}}"#,
        r#"{"stack":{"layers":5,"aragonite":{"n":1.0},"conchiolin":{"n":1.0},"substrate":{"n":1.0}}}"#,
        // As black as a layer may be.
        r#"{"stack":{"layers":10,"conchiolin":{"n":1.43,"k":0.28,"thickness_nm":100000}}}"#,
        r#"{"stack":{"layers":10,"aragonite":{"n":1.53,"k":1e-12}}}"#,
        // Total reflection from 30° on: what a lobe of few nodes makes of the edge rings.
        r#"{"stack":{"layers":10,"substrate":{"n":0.5}}}"#,
    ];
    for json in stacks {
        let recipe = Recipe::from_json(json).expect(json);
        let narrow = recipe.facets.slope_sd_deg == 1e-6;
        let effects = [Effect::Surface, Effect::Blur, Effect::Azimuth, Effect::Absorption];
        let effects: EffectSet = effects.into_iter().collect();
        let request = |target| request(recipe.clone(), effects, &[0.0, 30.0, 80.0, 89.9999], target);
        let bands = Bands::own(&recipe);
        let walked =
            bake::walk(&request(Target::Paths(20_000)), &bands, &Observer::idle(), None).expect(json);
        let doubled = bake::doubling(&request(Target::AccuracyPercent(1.0)), &bands);
        if let Err(why) = &doubled {
            let line = why.to_string();
            assert!(narrow && line.lines().count() == 1 && line.contains("use the walk"), "{json}: {line}");
        }
        for table in std::iter::once(walked).chain(doubled) {
            for finding in lut_io::check::check(&Interpolant::new(table)) {
                assert_ne!(finding.pass, Some(false), "{json}: {finding:?}");
            }
        }
    }
}
