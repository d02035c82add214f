//! The pearl as three microfacet lobes and a diffuse one, for renderers that know nothing else.
//!
//! At each viewing angle the lobe is the sum of three Beckmann lobes in the frame of the plane of incidence, each with a
//! weight, two roughnesses (along the plane and across it) and a normal of its own, tilted in that plane towards the mirror
//! direction: f·cos θo = Σ weight·D(m)·G/(4 wi·n), with Smith's height-correlated G. Where wo is below the surface, or either
//! direction below a lobe's own horizon, a lobe is dark. The colour of the lobes, and what the diffuse light shows, depend on
//! the viewing angle alone.
//!
//! Each angle starts from the fit of the angle before, so that the numbers are smooth from one to the next. The weights are
//! scaled so that the albedo is the table's.

use crate::round_trip::point;
use crate::{Components, Controls, Direction, PearlBsdf};
use lut_io::FieldError;
use rayon::prelude::*;
use rmpfit::{MPConfig, MPFitter, MPPar, MPResult};
use serde_json::{Value, json};
use std::f64::consts::{FRAC_1_PI, FRAC_PI_2, PI};

/// Viewing angles, degrees: from, to and step. Beyond the last one its lobes are used.
const ANGLES_DEG: [[f64; 3]; 3] = [[0.0, 60.0, 2.5], [60.0, 80.0, 2.0], [80.0, 89.5, 0.5]];
/// Directions that a lobe is fitted at, and that its albedo is compared at.
const FITTED: u32 = 1024;
const COMPARED: u32 = 8192;
/// Differences are counted over the root of the lobe plus this share of its peak: nearly as much light as there is.
const FLOOR: f64 = 0.01;
/// Roughnesses of the three lobes to start from, over that of interface 0.
const STARTS: [[f64; 3]; 3] = [[1.0, 2.5, 5.0], [1.0, 3.5, 8.0], [1.0, 2.0, 3.0]];
/// Weights to start from, as shares of the albedo.
const START_SHARES: [f64; 3] = [0.2, 0.5, 0.3];
/// Logarithms of weights and roughnesses are within these, tilts within this (radians); no pearl's are out of them.
const LOG_RANGE: [f64; 2] = [-12.0, 3.0];
const MOST_TILT: f64 = 1.2;
const LOBES: usize = 3;
/// Of a lobe: logarithms of weight and of both roughnesses, tilt.
const NUMBERS: usize = 4;
/// A fit has settled where a step changes no more than this.
const CONFIG: MPConfig = MPConfig { ftol: 1e-8, xtol: 1e-7, epsfcn: 1e-12, max_iter: 80, ..MPConfig::new() };

/// All lobes of an angle, [`NUMBERS`] each.
type Parameters = [f64; LOBES * NUMBERS];

/// The pearl at one viewing angle.
#[derive(Clone, Debug)]
struct Node {
    theta: f64,
    parameters: Parameters,
    /// Albedo of the lobes without colour, and how far they are from the table's, total variation.
    albedo: f64,
    total_variation: f64,
    /// What the lobes and the base show of a white surrounding, linear sRGB, over the albedo for the lobes.
    colour: [f64; 3],
    base: [f64; 3],
}

/// The fitted pearl.
#[derive(Clone, Debug)]
pub(super) struct Microfacets(Vec<Node>);

impl Microfacets {
    /// Fits the lobes of a BSDF at every angle, in seconds.
    pub(super) fn new(bsdf: &PearlBsdf) -> Result<Self, FieldError> {
        let plain = plain_lobes(bsdf)?;
        let angles = ANGLES_DEG.iter().flat_map(|[from, to, step]| {
            (0..((to - from) / step).round() as usize).map(move |i| from + step * i as f64)
        });
        let angles = angles.chain(std::iter::once(ANGLES_DEG[2][1])).map(f64::to_radians);
        let problems: Vec<Problem> =
            angles.collect::<Vec<_>>().into_par_iter().map(|theta| Problem::new(&plain, theta)).collect();
        let mut last = None;
        let fits: Vec<Parameters> = problems
            .iter()
            .map(|problem| {
                let fitted = match last {
                    Some(parameters) => problem.fitted(parameters).1,
                    None => problem.best(bsdf.slope_sd()),
                };
                *last.insert(fitted)
            })
            .collect();
        let node = |(problem, parameters): (Problem, Parameters)| problem.node(&plain, bsdf, parameters);
        Ok(Self(problems.into_iter().zip(fits).collect::<Vec<_>>().into_par_iter().map(node).collect()))
    }

    /// f·cos θ of the light, linear sRGB.
    pub(super) fn eval(&self, view: Direction, light: Direction) -> [f64; 3] {
        let theta = view[2].clamp(-1.0, 1.0).acos();
        let above = self.0.partition_point(|node| node.theta <= theta);
        let [a, b] = [above.saturating_sub(1), above.min(self.0.len() - 1)].map(|i| &self.0[i]);
        let share = if b.theta > a.theta { (theta - a.theta) / (b.theta - a.theta) } else { 0.0 };
        let mix = |a: f64, b: f64| a + share * (b - a);
        let parameters = std::array::from_fn(|i| mix(a.parameters[i], b.parameters[i]));
        let lobe = sum_towards(&lobes(&parameters, view[2].clamp(-1.0, 1.0)), in_plane(view, light));
        std::array::from_fn(|c| {
            lobe * mix(a.colour[c], b.colour[c]) + mix(a.base[c], b.base[c]) * light[2] * FRAC_1_PI
        })
    }

    /// The file.
    pub(super) fn encode(&self, name: &str) -> Vec<u8> {
        let nodes: Vec<Value> = self.0.iter().map(Node::describe).collect();
        let file = json!({ "schema": "pearl-microfacet/1", "name": name, "per_incidence": nodes });
        format!("{file:#}\n").into_bytes()
    }
}

/// The lobes alone, without colour.
pub(super) fn plain_lobes(bsdf: &PearlBsdf) -> Result<PearlBsdf, FieldError> {
    let lobes = Components { mirror: true, blur: true, ..Components::NONE };
    let plain = Controls {
        depth: 0.0,
        brightness: 1.0,
        coherence: 0.0,
        body_rgb: [0.0; 3],
        components: lobes,
        ..*bsdf.controls()
    };
    PearlBsdf::new(bsdf.prepared().clone(), plain).map_err(|why| FieldError::new("look", why.to_string()))
}

impl Node {
    fn describe(&self) -> Value {
        let round = |x: f64| (x * 1e6).round() / 1e6;
        let lobe = |p: &[f64]| {
            json!({
                "weight": round(p[0].exp()),
                "roughness": [round(p[1].exp()), round(p[2].exp())],
                "tilt_deg": round(p[3].to_degrees()),
            })
        };
        json!({
            "theta_i_deg": round(self.theta.to_degrees()),
            "albedo": round(self.albedo),
            "total_variation_percent": round(100.0 * self.total_variation),
            "lobes": self.parameters.chunks(NUMBERS).map(lobe).collect::<Vec<_>>(),
            "lobe_rgb": self.colour.map(round),
            "base_rgb": self.base.map(round),
        })
    }
}

/// A lobe at one viewing angle, at directions that it is drawn from.
#[derive(Clone, Debug)]
struct Problem {
    theta: f64,
    points: Vec<Point>,
    peak: f64,
}

/// A direction in the frame of the plane of incidence, f·cos θo there, and the solid angle that it stands for.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) wo: Direction,
    pub(super) value: f64,
    pub(super) solid_angle: f64,
}

impl Problem {
    fn new(plain: &PearlBsdf, theta: f64) -> Self {
        let points = drawn(plain, theta, FITTED);
        let peak = points.iter().map(|point| point.value).fold(f64::MIN_POSITIVE, f64::max);
        Self { theta, points, peak }
    }

    /// The best fit from any start.
    fn best(&self, slope_sd: f64) -> Parameters {
        let light = self.points.iter().map(|point| point.value * point.solid_angle).sum::<f64>().max(1e-9);
        let fits = STARTS.par_iter().map(|roughnesses| {
            let mut start = [0.0; LOBES * NUMBERS];
            for (k, lobe) in start.chunks_mut(NUMBERS).enumerate() {
                lobe[0] = (START_SHARES[k] * light).ln();
                // Slopes of standard deviation σ have Beckmann's α = √2·σ.
                lobe[1] = (roughnesses[k] * 2f64.sqrt() * slope_sd.max(1e-3)).ln();
                lobe[2] = lobe[1];
            }
            self.fitted(start)
        });
        let best = fits.min_by(|a, b| a.0.total_cmp(&b.0));
        best.map_or([0.0; LOBES * NUMBERS], |(_, parameters)| parameters)
    }

    /// The fit from a start, and how much of the squares is left; the start itself where there is none.
    fn fitted(&self, start: Parameters) -> (f64, Parameters) {
        let limits: Vec<MPPar> = self.limits().into_iter().flat_map(|limits| limits.map(bounded)).collect();
        let mut parameters = start;
        for (parameter, limit) in parameters.iter_mut().zip(&limits) {
            *parameter = parameter.clamp(limit.limit_low, limit.limit_up);
        }
        let start = parameters;
        match (Fit { problem: self, limits }).mpfit(&mut parameters) {
            Ok(status) if parameters.iter().all(|x| x.is_finite()) => (status.best_norm, parameters),
            _ => (f64::INFINITY, start),
        }
    }

    /// What the numbers of each lobe are kept to: the view stays above the horizon of a tilted lobe.
    fn limits(&self) -> [[[f64; 2]; NUMBERS]; LOBES] {
        let most = (0.8 * (FRAC_PI_2 - self.theta)).min(MOST_TILT);
        [[LOG_RANGE, LOG_RANGE, LOG_RANGE, [-MOST_TILT, most]]; LOBES]
    }

    /// With the table's albedo, its error, and the colours of the look.
    fn node(self, plain: &PearlBsdf, bsdf: &PearlBsdf, mut parameters: Parameters) -> Node {
        let (theta, cos) = (self.theta, self.theta.cos());
        let points = drawn(plain, theta, COMPARED);
        let total = |of: &dyn Fn(&Point) -> f64| points.iter().map(|p| of(p) * p.solid_angle).sum::<f64>();
        let light = total(&|point| point.value);
        let unscaled = lobes(&parameters, cos);
        let fitted = total(&|point| sum_towards(&unscaled, point.wo));
        if fitted > 0.0 {
            parameters.iter_mut().step_by(NUMBERS).for_each(|weight| *weight += (light / fitted).ln());
        }
        let scaled = lobes(&parameters, cos);
        let apart = total(&|point| (sum_towards(&scaled, point.wo) - point.value).abs());
        let sum = |parts: &[[f64; 3]]| -> [f64; 3] {
            std::array::from_fn(|c| parts.iter().map(|rgb| rgb[c]).sum())
        };
        let albedo = sum(&plain.directional_albedo_seen(theta)[2..])[1];
        let [diffuse, incoherent, mirror, blur] = bsdf.directional_albedo_seen(theta);
        Node {
            theta,
            parameters,
            albedo,
            total_variation: if light > 0.0 { 0.5 * apart / light } else { 0.0 },
            colour: sum(&[mirror, blur]).map(|rgb| if albedo > 0.0 { rgb / albedo } else { 0.0 }),
            base: sum(&[diffuse, incoherent]),
        }
    }
}

/// A problem as the library asks for it.
struct Fit<'a> {
    problem: &'a Problem,
    limits: Vec<MPPar>,
}

pub(super) fn bounded([limit_low, limit_up]: [f64; 2]) -> MPPar {
    MPPar { limited_low: true, limited_up: true, limit_low, limit_up, ..MPPar::new() }
}

impl MPFitter for Fit<'_> {
    fn eval(&mut self, parameters: &[f64], deviates: &mut [f64]) -> MPResult<()> {
        let parameters: Parameters = std::array::from_fn(|i| parameters[i]);
        let Problem { theta, points, peak } = self.problem;
        let lobes = lobes(&parameters, theta.cos());
        for (deviate, Point { wo, value, solid_angle }) in deviates.iter_mut().zip(points) {
            let scale = (solid_angle / (value + FLOOR * peak)).sqrt();
            *deviate = (sum_towards(&lobes, *wo) - value) * scale;
        }
        Ok(())
    }

    fn number_of_points(&self) -> usize {
        self.problem.points.len()
    }

    fn parameters(&self) -> &[MPPar] {
        &self.limits
    }

    fn config(&self) -> &MPConfig {
        static SETTLED: MPConfig = CONFIG;
        &SETTLED
    }
}

/// Directions that the BSDF draws.
fn drawn(plain: &PearlBsdf, theta: f64, count: u32) -> Vec<Point> {
    let wi = [theta.sin(), 0.0, theta.cos()];
    let of = |n: u32| {
        let [u, v, w] = point(n);
        let sample = plain.sample(wi, u, v, w)?;
        let value = plain.eval_seen(wi, sample.wo).rgb()[1];
        Some(Point { wo: sample.wo, value, solid_angle: 1.0 / (sample.pdf * f64::from(count)) })
    };
    (0..count).filter_map(of).collect()
}

/// A direction in the frame in which the view is in the plane of x and z, x > 0.
pub(super) fn in_plane(view: Direction, light: Direction) -> Direction {
    let sin = view[0].hypot(view[1]);
    let [x, y] = if sin > 0.0 { [view[0] / sin, view[1] / sin] } else { [1.0, 0.0] };
    [light[0] * x + light[1] * y, light[1] * x - light[0] * y, light[2]]
}

/// The lobes at a viewing angle, each with its weight; wi is in the plane of x and z.
fn lobes(parameters: &Parameters, cos_i: f64) -> [(f64, Beckmann); LOBES] {
    let wi = [(1.0 - cos_i * cos_i).max(0.0).sqrt(), 0.0, cos_i];
    std::array::from_fn(|k| {
        let [weight, along, across, tilt] = std::array::from_fn(|i| parameters[k * NUMBERS + i]);
        (weight.exp(), Beckmann::new(wi, [along.exp(), across.exp()], [tilt, 0.0]))
    })
}

/// f·cos θo of all lobes.
fn sum_towards(lobes: &[(f64, Beckmann)], wo: Direction) -> f64 {
    if wo[2] > 0.0 { lobes.iter().map(|(weight, lobe)| weight * lobe.towards(wo)).sum() } else { 0.0 }
}

/// D·G/(4 wi·n) about a normal that is tilted in the plane of x and z, away from wi, and then turned towards y.
#[derive(Clone, Copy, Debug)]
pub(super) struct Beckmann {
    /// Along, across, normal.
    frame: [Direction; 3],
    /// In that frame.
    wi: Direction,
    roughness: [f64; 2],
    /// Λ(wi).
    shadow: f64,
    /// 1/(4π·αx·αy·wi·n), 0 where the normal is turned away.
    scale: f64,
}

impl Beckmann {
    pub(super) fn new(wi: Direction, [along, across]: [f64; 2], [tilt, turn]: [f64; 2]) -> Self {
        let [(sin, cos), (side, up)] = [tilt.sin_cos(), turn.sin_cos()];
        let normal = [-sin * up, side, cos * up];
        // Across, and what is along of the plane of x and z.
        let flat = side.hypot(normal[2]);
        let [y, z] = [side / flat, normal[2] / flat];
        let frame = [[flat, -normal[0] * y, -normal[0] * z], [0.0, z, -y], normal];
        let wi = in_frame(&frame, wi);
        let scale = if wi[2] > 0.0 { 1.0 / (4.0 * PI * along * across * wi[2]) } else { 0.0 };
        Self { frame, wi, roughness: [along, across], shadow: shadow(wi, [along, across]), scale }
    }

    pub(super) fn towards(&self, wo: Direction) -> f64 {
        let Self { wi, roughness, .. } = *self;
        let wo = in_frame(&self.frame, wo);
        if self.scale == 0.0 || wo[2] <= 0.0 {
            return 0.0;
        }
        let half: Direction = std::array::from_fn(|i| wi[i] + wo[i]);
        let [x, y] = [0, 1].map(|i| half[i] / (half[2] * roughness[i]));
        let cos2 = half[2] * half[2] / half.iter().map(|h| h * h).sum::<f64>();
        let density = (-(x * x + y * y)).exp() / (cos2 * cos2);
        self.scale * density / (1.0 + self.shadow + shadow(wo, roughness))
    }
}

fn in_frame(frame: &[Direction; 3], d: Direction) -> Direction {
    frame.map(|axis| axis[0] * d[0] + axis[1] * d[1] + axis[2] * d[2])
}

/// Λ by Walter et al. (2007), as renderers have it.
fn shadow(d: Direction, [along, across]: [f64; 2]) -> f64 {
    let (x, y) = (d[0] * along, d[1] * across);
    let a = d[2] / (x * x + y * y).sqrt().max(1e-12);
    if a < 1.6 { (1.0 - 1.259 * a + 0.396 * a * a) / (3.535 * a + 2.181 * a * a) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The distribution of a mirror's normals: Σ over the sphere of D·cos is 1, so that at normal incidence and without shadows
    /// the lobe sends back all.
    #[test]
    fn a_narrow_lobe_of_weight_1_sends_back_all_light() {
        for (theta, tilt) in [(0.0f64, 0.0), (0.5, 0.0), (0.5, 0.1), (0.9, -0.1)] {
            let wi = [theta.sin(), 0.0, theta.cos()];
            let lobe = Beckmann::new(wi, [0.04, 0.06], [tilt, 0.0]);
            let (mut sum, steps) = (0.0, 1000);
            for i in 0..steps {
                for j in 0..steps {
                    // Over slopes of the half vector about the tilted normal, ± 5 α.
                    let [p, q] = [i, j].map(|i| (f64::from(i) + 0.5) / f64::from(steps) * 10.0 - 5.0);
                    let (x, y) = (0.04 * p, 0.06 * q);
                    let (s, c) = f64::sin_cos(tilt);
                    let length = (x * x + y * y + 1.0).sqrt();
                    let m = [(x * c - s) / length, y / length, (c + x * s) / length];
                    let d = 2.0 * (wi[0] * m[0] + wi[2] * m[2]);
                    let wo: Direction = std::array::from_fn(|k| d * m[k] - wi[k]);
                    // dωo = 4 (wi·m) dωm, dωm = dslopes·cos³.
                    let measure = 2.0 * d * length.powi(-3) * 0.04 * 0.06 * 1e-4;
                    sum += lobe.towards(wo) * measure;
                }
            }
            assert!((sum - 1.0).abs() < 2e-3, "{theta} {tilt}: {sum}");
        }
    }
}
