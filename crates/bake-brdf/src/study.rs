//! What accuracy costs in time: both solvers at many settings against the finest doubling solution.

use crate::bake::cells::cell_shares;
use crate::bake::sampling::{Sampling, Shard};
use crate::bake::{BakeError, Bands, Observer, Request};
use crate::effects::{Effect, EffectSet};
use crate::options::Options;
use crate::recipe::{AzimuthMode, Recipe};
use crate::tally::CHUNK;
use lut_io::axis::ExitAxis;
use serde::Serialize;
use std::time::Instant;
use transport::doubling::{self, Settings};
use transport::walk::lanes::Precision;

/// Total variation that the truth is solved to.
const TRUTH: f64 = 1e-7;
/// Accuracies that doubling is set for.
const DOUBLING_TARGETS: [f64; 6] = [3e-2, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6];
/// Repeats of a timed solve, of which the fastest counts: what else the machine does only adds.
const REPEATS: usize = 3;
/// Repeats of a long walk: with one, what else the machine does for a while bends the slope.
const LONG_REPEATS: usize = 2;

/// A solver as it is compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
#[allow(missing_docs)] // the names say it
pub enum Contender {
    WalkF32,
    WalkF64,
    Doubling,
}

/// One solver at one setting.
#[derive(Clone, Debug, Serialize)]
pub struct Point {
    /// Who.
    pub contender: Contender,
    /// `decay` (plane) or `space`.
    pub azimuth: AzimuthMode,
    /// Paths per incidence (walk), else 0.
    pub paths: u64,
    /// Nodes and modes (doubling), else 0.
    pub nodes: usize,
    /// Azimuthal modes (doubling).
    pub modes: usize,
    /// Wall-clock seconds for all incidences, fastest of the repeats.
    pub seconds: f64,
    /// Total variation of the worst incidence against the truth, share of the reflected light.
    pub worst_error: f64,
    /// Mean over the incidences of the same.
    pub mean_error: f64,
    /// Memory that the solver's own data need, bytes (walk: tallies; doubling: its plan).
    pub bytes: f64,
}

/// A power law error = a·seconds^slope through the points of one walk.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Slope {
    /// Who.
    pub contender: Contender,
    /// Plane or space.
    pub azimuth: AzimuthMode,
    /// Exponent; −0.5 for any Monte Carlo method.
    pub slope: f64,
    /// Error after one second.
    pub error_at_one_second: f64,
    /// Error below which doubling is faster, from this line and the doubling points; none if there is no crossing.
    pub break_even_error: Option<f64>,
}

/// What an effect adds to the time of the walk: ratios of nanoseconds a crossing, measured in turn.
#[derive(Clone, Debug, Serialize)]
pub struct EffectCost {
    /// Name of the effect.
    pub effect: &'static str,
    /// Nanoseconds of wall-clock time a crossing without it, all threads together.
    pub base_ns: f64,
    /// The same with it.
    pub with_ns: f64,
    /// Their ratio, median of the repeats.
    pub ratio: f64,
}

/// The whole study.
#[derive(Clone, Debug, Serialize)]
pub struct Study {
    /// `pearl-study/1`.
    pub schema: &'static str,
    /// The recipe.
    pub recipe: serde_json::Value,
    /// Threads in use.
    pub threads: usize,
    /// Angles of incidence, degrees.
    pub incident_deg: Vec<f64>,
    /// Every measurement.
    pub points: Vec<Point>,
    /// Fitted walks.
    pub slopes: Vec<Slope>,
    /// What each further effect costs.
    pub effects: Vec<EffectCost>,
}

/// Paths per incidence of the walks: enough that most of the light is in cells with many paths, where the error
/// falls as 1/√paths.
fn path_counts(azimuth: AzimuthMode, precision: Precision) -> &'static [u64] {
    match (azimuth, precision) {
        (AzimuthMode::Decay, Precision::F64) => &[4 * CHUNK, 16 * CHUNK, 48 * CHUNK],
        (AzimuthMode::Decay, _) => &[4 * CHUNK, 16 * CHUNK, 64 * CHUNK],
        (AzimuthMode::Space, Precision::F64) => &[16 * CHUNK, 48 * CHUNK, 96 * CHUNK],
        (AzimuthMode::Space, _) => &[16 * CHUNK, 48 * CHUNK, 144 * CHUNK],
    }
}

/// Runs the study on the threads in use; `say` is told what runs next. Of the options it takes the incidences and the event cap:
/// geometries, solvers, targets, seeds and precisions are what it compares.
///
/// # Errors
/// A recipe that doubling cannot solve finely enough to be the truth.
pub fn run(recipe: &Recipe, options: &Options, say: &dyn Fn(&str)) -> Result<Study, BakeError> {
    let mut points = Vec::new();
    for azimuth in [AzimuthMode::Decay, AzimuthMode::Space] {
        let bench = Bench::new(recipe, options, azimuth, say)?;
        for target in DOUBLING_TARGETS {
            say(&format!("{azimuth:?}: doubling for {target:.0e}"));
            points.push(bench.doubling(target)?);
        }
        for (contender, precision) in
            [(Contender::WalkF32, Precision::F32), (Contender::WalkF64, Precision::F64)]
        {
            for &paths in path_counts(azimuth, precision) {
                say(&format!("{azimuth:?}: {contender:?}, {paths} paths an incidence"));
                points.push(bench.walk(contender, precision, paths)?);
            }
        }
    }
    say("cost of effects");
    Ok(Study {
        schema: "pearl-study/1",
        recipe: recipe.to_json(),
        threads: rayon::current_num_threads(),
        incident_deg: request(recipe, options, AzimuthMode::Decay)?.grid.incident_deg,
        slopes: slopes(&points),
        effects: effects(recipe, options)?,
        points,
    })
}

/// One geometry with its truth.
struct Bench {
    request: Request,
    axis: ExitAxis,
    truth: Vec<Vec<f64>>,
}

impl Bench {
    fn new(
        recipe: &Recipe,
        options: &Options,
        azimuth: AzimuthMode,
        say: &dyn Fn(&str),
    ) -> Result<Self, BakeError> {
        let request = request(recipe, options, azimuth)?;
        request.options.check()?;
        let transport = request.transport()?;
        let axis = request.exit_axis();
        say(&format!("{azimuth:?}: truth"));
        let solution = doubling::solve_to(&transport, request.geometry(), &request.theta_i(), TRUTH, false)
            .map_err(|why| BakeError::Input(format!("study: no truth to compare with: {why}")))?;
        let truth = (0..request.grid.incident_deg.len())
            .map(|i| reflected(cell_shares(&axis, &solution, i)))
            .collect();
        Ok(Self { request, axis, truth })
    }

    fn doubling(&self, target: f64) -> Result<Point, BakeError> {
        let transport = self.request.transport()?;
        let geometry = self.request.geometry();
        let settings = Settings::for_accuracy(&transport, geometry, target);
        let mut seconds = Vec::new();
        let mut shares = Vec::new();
        for _ in 0..REPEATS {
            let started = Instant::now();
            let solution = doubling::solve(&transport, geometry, &self.request.theta_i(), &settings)
                .map_err(|why| BakeError::Input(format!("study: {why}")))?;
            shares =
                (0..self.truth.len()).map(|i| reflected(cell_shares(&self.axis, &solution, i))).collect();
            seconds.push(started.elapsed().as_secs_f64());
        }
        let (worst_error, mean_error) = self.errors(&shares);
        Ok(Point {
            contender: Contender::Doubling,
            azimuth: self.request.recipe.azimuth.mode,
            paths: 0,
            nodes: settings.nodes,
            modes: settings.modes,
            seconds: fastest(&seconds),
            worst_error,
            mean_error,
            bytes: settings.cost(&transport, geometry, self.truth.len()).bytes,
        })
    }

    /// Repeats with other seeds: the least time, the mean of the errors.
    fn walk(&self, contender: Contender, precision: Precision, paths: u64) -> Result<Point, BakeError> {
        let (mut seconds, mut worst, mut mean, mut bytes) = (Vec::new(), 0.0, 0.0, 0.0);
        let repeats = if paths > 16 * CHUNK { LONG_REPEATS } else { REPEATS };
        for repeat in 0..repeats {
            let mut request = self.request.clone();
            request.options.precision = precision;
            request.options.seed = 1 + repeat as u64;
            let started = Instant::now();
            let sampling = walk(&request, paths)?;
            seconds.push(started.elapsed().as_secs_f64());
            let shares: Vec<Vec<f64>> = sampling.tallies().iter().map(|t| t.reflected_shares()).collect();
            let (worst_error, mean_error) = self.errors(&shares);
            worst += worst_error / repeats as f64;
            mean += mean_error / repeats as f64;
            bytes = sampling.tallies().iter().map(|tally| 72.0 * tally.cells() as f64).sum();
        }
        Ok(Point {
            contender,
            azimuth: self.request.recipe.azimuth.mode,
            paths,
            nodes: 0,
            modes: 0,
            seconds: fastest(&seconds),
            worst_error: worst,
            mean_error: mean,
            bytes,
        })
    }

    /// Worst and mean total variation over the incidences.
    fn errors(&self, shares: &[Vec<f64>]) -> (f64, f64) {
        let each: Vec<f64> = shares
            .iter()
            .zip(&self.truth)
            .map(|(found, truth)| {
                let apart: f64 = found.iter().zip(truth).map(|(a, b)| (a - b).abs()).sum();
                0.5 * apart / truth.iter().sum::<f64>()
            })
            .collect();
        (each.iter().copied().fold(0.0, f64::max), each.iter().sum::<f64>() / each.len() as f64)
    }
}

/// The recipe's effects without interference colours, which cost the same with every solver.
fn lobe_effects(recipe: &Recipe) -> EffectSet {
    EffectSet::by_look(recipe).without(Effect::Coherent).without(Effect::Emission)
}

/// Contenders are compared on the same rows and cells, whatever their accuracy.
fn request(recipe: &Recipe, options: &Options, azimuth: AzimuthMode) -> Result<Request, BakeError> {
    let mut recipe = recipe.clone();
    recipe.azimuth.mode = azimuth;
    Request::of(recipe.clone(), lobe_effects(&recipe), options.clone())
}

fn walk(request: &Request, paths: u64) -> Result<Sampling, BakeError> {
    let mut sampling = Sampling::of(request, &Bands::own(&request.recipe), Shard::WHOLE)?;
    sampling.walk_to_paths(paths, &Observer::idle())?;
    Ok(sampling)
}

/// All that leaves the top: interior and surface.
fn reflected([interior, surface, _]: [Vec<f64>; 3]) -> Vec<f64> {
    interior.iter().zip(&surface).map(|(a, b)| a + b).collect()
}

fn fastest(seconds: &[f64]) -> f64 {
    seconds.iter().copied().fold(f64::INFINITY, f64::min)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

fn slopes(points: &[Point]) -> Vec<Slope> {
    let mut slopes = Vec::new();
    for azimuth in [AzimuthMode::Decay, AzimuthMode::Space] {
        for contender in [Contender::WalkF32, Contender::WalkF64] {
            let line: Vec<(f64, f64)> = points
                .iter()
                .filter(|p| p.contender == contender && p.azimuth == azimuth)
                .map(|p| (p.seconds.ln(), p.mean_error.ln()))
                .collect();
            let (slope, intercept) = least_squares(&line);
            let solved: Vec<&Point> = points
                .iter()
                .filter(|p| p.contender == Contender::Doubling && p.azimuth == azimuth)
                .collect();
            // The loosest doubling setting that beats the walk at its own error.
            let beats = |p: &&&Point| (p.mean_error.ln() - intercept) / slope > p.seconds.ln();
            let break_even = solved.iter().find(beats).map(|p| (intercept + slope * p.seconds.ln()).exp());
            slopes.push(Slope {
                contender,
                azimuth,
                slope,
                error_at_one_second: intercept.exp(),
                break_even_error: break_even,
            });
        }
    }
    slopes
}

/// Slope and intercept of y over x.
fn least_squares(points: &[(f64, f64)]) -> (f64, f64) {
    let n = points.len() as f64;
    let (mx, my) = (points.iter().map(|p| p.0).sum::<f64>() / n, points.iter().map(|p| p.1).sum::<f64>() / n);
    let covariance: f64 = points.iter().map(|p| (p.0 - mx) * (p.1 - my)).sum();
    let variance: f64 = points.iter().map(|p| (p.0 - mx).powi(2)).sum();
    let slope = covariance / variance;
    (slope, my - slope * mx)
}

/// What each effect adds to a crossing, measured in turn with and without it. Of the options it takes the event cap.
///
/// # Errors
/// A bad recipe.
pub fn effects(recipe: &Recipe, options: &Options) -> Result<Vec<EffectCost>, BakeError> {
    let options = Options { incident_deg: Some(vec![30.0]), ..options.clone() };
    let base = request(recipe, &options, AzimuthMode::Decay)?;
    let mut absorbing = base.clone();
    absorbing.recipe.stack.aragonite.k += 1e-5;
    if let Some(layers) = &mut absorbing.recipe.stack.explicit {
        layers.iter_mut().for_each(|layer| layer.k += 1e-5);
    }
    absorbing.effects = lobe_effects(&absorbing.recipe);
    let mut visible = base.clone();
    visible.recipe.facets.normals = transport::Normals::Visible;
    let space = request(recipe, &options, AzimuthMode::Space)?;
    let mut double = base.clone();
    double.options.precision = Precision::F64;
    [
        ("azimuth:space", space),
        ("absorption", absorbing),
        ("visible normals", visible),
        ("64-bit geometry", double),
    ]
    .into_iter()
    .map(|(effect, with)| {
        let (mut base_ns, mut with_ns, mut ratios) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..5 {
            let (a, b) = (nanoseconds(&base)?, nanoseconds(&with)?);
            base_ns.push(a);
            with_ns.push(b);
            ratios.push(b / a);
        }
        Ok(EffectCost {
            effect,
            base_ns: median(&mut base_ns),
            with_ns: median(&mut with_ns),
            ratio: median(&mut ratios),
        })
    })
    .collect()
}

fn nanoseconds(request: &Request) -> Result<f64, BakeError> {
    let started = Instant::now();
    let sampling = walk(request, 64 * CHUNK)?;
    let seconds = started.elapsed().as_secs_f64();
    let crossings: u64 = sampling.tallies().iter().map(|tally| tally.crossings).sum();
    Ok(1e9 * seconds / crossings as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_power_law_is_found_again() {
        let points: Vec<(f64, f64)> =
            [1.0_f64, 3.0, 8.0].iter().map(|t| (t.ln(), (0.02 * t.powf(-0.5)).ln())).collect();
        let (slope, intercept) = least_squares(&points);
        assert!((slope + 0.5).abs() < 1e-12 && (intercept.exp() - 0.02).abs() < 1e-12);
    }

    #[test]
    fn the_break_even_lies_where_doubling_starts_to_win() {
        let point = |contender, seconds: f64, mean_error| Point {
            contender,
            azimuth: AzimuthMode::Decay,
            paths: 0,
            nodes: 0,
            modes: 0,
            seconds,
            worst_error: mean_error,
            mean_error,
            bytes: 0.0,
        };
        let points = [
            point(Contender::Doubling, 0.5, 1e-2),
            point(Contender::Doubling, 1.0, 1e-3),
            point(Contender::WalkF32, 0.1, 1e-2),
            point(Contender::WalkF32, 10.0, 1e-3),
            point(Contender::WalkF64, 0.1, 1e-2),
            point(Contender::WalkF64, 10.0, 1e-3),
        ];
        let slope = slopes(&points)[0];
        assert!((slope.slope + 0.5).abs() < 1e-12);
        // In one second the walk reaches 1e-2·√0.1.
        assert!((slope.break_even_error.unwrap() - 1e-2 * 0.1_f64.sqrt()).abs() < 1e-9);
    }
}
