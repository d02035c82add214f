//! Light that met interface 0 more than once and never entered, resolved in azimuth.
//!
//! Near grazing a reflection turns a ray by Δφ ≈ (e + ε)·σ·q only, ε and e being cos θ before and after: at 89° the
//! azimuth would need tens of thousands of modes. But every chain of reflections from ε to e has almost the same
//! width, between 1/√2 and 1 times w = σ(e + ε)/√(s s_i): so each exit row gets a cosine series of its own period
//! Φ = min(π, 8w), whose coefficients are smooth functions of ln(e + ε). Chains go through ever more grazing downward
//! states (facets that face a ray can only flatten it), so that a few nodes on (0, ε) hold them all.

use std::f64::consts::{FRAC_PI_2, PI};

use pulp::Arch;

use super::grid::segment_rule;
use super::matrix::Matrix;
use super::surface::{Azimuth, SingleReflection};
use crate::{Geometry, Transport};

/// Half period of a row's series in widths w: what lies beyond weighs e^(−32).
const HALF_PERIOD: f64 = 8.0;

/// Highest frequency in 1/w: chains have widths ≥ w/√2, so that e^(−20) is left out.
const HIGHEST: f64 = 9.0;

/// Terms of a row's series.
const TERMS: usize = 24; // HIGHEST·HALF_PERIOD/π and one

/// Downward states on (0, ε), and points of the integral over the next one.
const STATES: usize = 12;
const NEXT: usize = 12;

/// Exit rows.
const ROWS: usize = 44;

/// Rehit light below this share of all light is not resolved (its share and moments are kept).
const NEGLIGIBLE: f64 = 1e-9;

/// One reflection between two polar angles, sampled in azimuth: ∫ k cos(mφ) dφ = Σ samples·cos(m(p + ½)·step).
struct Turn {
    step: f64,
    width: f64,
    samples: Vec<f64>,
}

/// Direction by sine and cosine of θ; a negative cosine heads for the interface.
type Direction = (f64, f64);

impl Turn {
    fn new(lobe: &SingleReflection, sigma: f64, from: Direction, to: Direction) -> Self {
        let width = sigma * (to.1 + from.1) / (to.0 * from.0).sqrt().max(1e-12);
        let end = PI.min(HALF_PERIOD * width);
        // The midpoint rule is exact to e^(−32) once 2π/step − HIGHEST/w exceeds HALF_PERIOD/w; the floor serves
        // Fresnel's factor when the lobe goes all the way round.
        let count = ((end * (HIGHEST + HALF_PERIOD) / (2.0 * PI * width)).ceil() as usize).max(if end < PI {
            8
        } else {
            24
        });
        let step = end / count as f64;
        let around = |p: usize| Azimuth::new((p as f64 + 0.5) * step);
        let samples = (0..count).map(|p| 2.0 * step * lobe.towards(to, around(p))).collect();
        Self { step, width, samples }
    }

    /// The cosine moments at m = k·base, k < TERMS.
    fn moments(&self, base: f64) -> [f64; TERMS] {
        Arch::new().dispatch(|| self.moments_in_lanes(base))
    }

    #[inline(always)]
    fn moments_in_lanes(&self, base: f64) -> [f64; TERMS] {
        // cos(m(p + ½)step) by the three-term recurrence in p, for all k at once.
        let half = (0.5 * base * self.step).cos();
        let mut now = [1.0; TERMS];
        now[1] = half;
        for k in 2..TERMS {
            now[k] = 2.0 * half * now[k - 1] - now[k - 2];
        }
        let twice = now.map(|cosine| 2.0 * (2.0 * cosine * cosine - 1.0));
        let mut before = now;
        let mut sums = [0.0; TERMS];
        for &sample in &self.samples {
            for k in 0..TERMS {
                sums[k] += sample * now[k];
                let next = twice[k] * now[k] - before[k];
                before[k] = now[k];
                now[k] = next;
            }
        }
        for (k, sum) in sums.iter_mut().enumerate() {
            if k as f64 * base * self.width > 1.2 * HIGHEST {
                *sum = 0.0; // a Gaussian: gone, and the rule no longer resolves it
            }
        }
        sums
    }

    fn negligible(&self) -> bool {
        self.samples.iter().all(|sample| *sample < 1e-14)
    }
}

/// Rehit light of one incidence.
#[derive(Clone, Debug)]
pub(super) struct RehitLobe {
    sine: f64,
    cosine: f64,
    sigma: f64,
    /// Rows: nodes of ln(1 + e/ε); columns: terms.
    series: Matrix,
    /// ln(1 + e/ε) of the highest exit that facets reach.
    range: f64,
}

impl RehitLobe {
    /// `None` if `share` of the light is too little to matter.
    pub(super) fn new(
        transport: &Transport,
        incident: &SingleReflection,
        theta_i: f64,
        share: f64,
    ) -> Option<Self> {
        if share < NEGLIGIBLE {
            return None;
        }
        let sigma = transport.facets.slope_sd;
        let (sine, cosine) = theta_i.sin_cos();
        let states = segment_rule(STATES);
        let elevation: Vec<f64> = states.nodes.iter().map(|t| 0.5 * cosine * (t + 1.0)).collect();
        let weight: Vec<f64> = states.weights.iter().map(|w| 0.5 * cosine * w).collect();
        let along = |e: f64| ((1.0 - e * e).max(0.0).sqrt(), e);
        let lobes: Vec<SingleReflection> =
            elevation.iter().map(|e| SingleReflection::new(transport, Geometry::Space, e.acos())).collect();
        let first: Vec<Turn> =
            elevation.iter().map(|e| Turn::new(incident, sigma, (sine, cosine), (along(*e).0, -e))).collect();
        let again = chain_steps(&lobes, &elevation, sigma, cosine);

        // A grazing ray leaves at twice the facet's tilt.
        let highest = (2.0 * HALF_PERIOD * sigma).min(FRAC_PI_2).sin();
        let range = (highest / cosine).ln_1p();
        let mut series = Matrix::zeros(ROWS, TERMS);
        let mut known: Option<(f64, Matrix)> = None;
        for (row, t) in segment_rule(ROWS).nodes.iter().enumerate() {
            let exit = along((cosine * (0.5 * range * (t + 1.0)).exp_m1()).min(1.0));
            let last: Vec<Turn> = lobes
                .iter()
                .zip(&elevation)
                .map(|(lobe, e)| Turn::new(lobe, sigma, along(*e), exit))
                .collect();
            if last.iter().all(Turn::negligible) {
                continue;
            }
            let half_period = half_period(sigma, (sine, cosine), exit);
            let base = PI / half_period;
            if known.as_ref().is_none_or(|(at, _)| *at != base) {
                known = Some((base, visits(&first, &again, &weight, base))); // wide rows share Φ = π
            }
            let Some((_, visits)) = &known else { continue };
            for (state, turn) in last.iter().enumerate() {
                for (k, moment) in turn.moments(base).into_iter().enumerate() {
                    let norm = if k == 0 { 0.5 } else { 1.0 } / half_period;
                    series[(row, k)] += norm * visits[(state, k)] * moment;
                }
            }
        }
        Some(Self { sine, cosine, sigma, series, range })
    }

    /// f·cos θo at θ × φ.
    pub(super) fn values(&self, theta: &[f64], phi: &[f64]) -> Matrix {
        let mut values = Matrix::zeros(theta.len(), phi.len());
        for (i, &theta) in theta.iter().enumerate() {
            let exit = theta.sin_cos();
            let t = 2.0 * (exit.1.max(0.0) / self.cosine).ln_1p() / self.range - 1.0;
            if t > 1.0 {
                continue;
            }
            let row = interpolate(&self.series, t);
            let half_period = half_period(self.sigma, (self.sine, self.cosine), exit);
            for (f, &phi) in phi.iter().enumerate() {
                let phi = phi.abs();
                if phi < half_period {
                    values[(i, f)] = cosine_series(PI * phi / half_period, &row);
                }
            }
        }
        values
    }
}

/// The rows' polynomial at t, by the barycentric formula of Gauss–Legendre nodes: weights (−1)ʲ·√((1 − x²)w).
fn interpolate(series: &Matrix, t: f64) -> [f64; TERMS] {
    let rule = segment_rule(ROWS);
    let mut sum = [0.0; TERMS];
    let mut norm = 0.0;
    for (j, (x, w)) in rule.nodes.iter().zip(&rule.weights).enumerate() {
        let sign = if j % 2 == 0 { 1.0 } else { -1.0 };
        let distance = t - x;
        let exact = distance == 0.0;
        let weight = if exact { 1.0 } else { sign * ((1.0 - x * x) * w).sqrt() / distance };
        if exact {
            (sum, norm) = ([0.0; TERMS], 0.0);
        }
        norm += weight;
        for (k, value) in sum.iter_mut().enumerate() {
            *value += weight * series[(j, k)];
        }
        if exact {
            break;
        }
    }
    sum.map(|value| value / norm)
}

fn cosine_series(angle: f64, coefficients: &[f64; TERMS]) -> f64 {
    let twice = 2.0 * angle.cos();
    let (mut now, mut before) = (1.0, angle.cos());
    let mut sum = 0.0;
    for coefficient in coefficients {
        sum += coefficient * now;
        (now, before) = (twice * now - before, now);
    }
    sum
}

fn half_period(sigma: f64, incident: Direction, exit: Direction) -> f64 {
    PI.min(HALF_PERIOD * sigma * (exit.1 + incident.1) / (exit.0 * incident.0).sqrt().max(1e-12))
}

/// From each state to the next one down: the turns at the points of a rule on (0, e), and the deposit of each point
/// on the states (weight included).
fn chain_steps(
    lobes: &[SingleReflection],
    elevation: &[f64],
    sigma: f64,
    top: f64,
) -> Vec<Vec<(Turn, Vec<f64>)>> {
    let rule = segment_rule(NEXT);
    let from = |e: f64| ((1.0 - e * e).max(0.0).sqrt(), e);
    lobes
        .iter()
        .zip(elevation)
        .map(|(lobe, &e)| {
            rule.nodes
                .iter()
                .zip(&rule.weights)
                .map(|(t, w)| {
                    let next = 0.5 * e * (t + 1.0);
                    let turn = Turn::new(lobe, sigma, from(e), (from(next).0, -next));
                    let mut deposit = lagrange(elevation, top, next);
                    deposit.iter_mut().for_each(|value| *value *= 0.5 * e * w);
                    (turn, deposit)
                })
                .collect()
        })
        .collect()
}

/// Cardinal polynomials of the states at `at`.
fn lagrange(nodes: &[f64], top: f64, at: f64) -> Vec<f64> {
    (0..nodes.len())
        .map(|j| {
            let others = nodes.iter().enumerate().filter(|(k, _)| *k != j);
            others.map(|(_, node)| ((at - node) / top) / ((nodes[j] - node) / top)).product()
        })
        .collect()
}

/// Light in each state (rows) at m = k·base (columns): all chains that end there.
fn visits(first: &[Turn], again: &[Vec<(Turn, Vec<f64>)>], weight: &[f64], base: f64) -> Matrix {
    Arch::new().dispatch(|| visits_in_lanes(first, again, weight, base))
}

#[inline(always)]
fn visits_in_lanes(first: &[Turn], again: &[Vec<(Turn, Vec<f64>)>], weight: &[f64], base: f64) -> Matrix {
    let mut arriving = Matrix::zeros(STATES, TERMS);
    for (state, turn) in first.iter().enumerate() {
        for (k, moment) in turn.moments_in_lanes(base).into_iter().enumerate() {
            arriving[(state, k)] = weight[state] * moment;
        }
    }
    let steps: Vec<Matrix> = again.iter().map(|step| step_matrix(step, base)).collect();
    let mut all = arriving.clone();
    for _ in 0..60 {
        let mut next = Matrix::zeros(STATES, TERMS);
        for k in 0..TERMS {
            for (step, arriving) in steps.iter().zip(arriving.column(k)) {
                next.column_mut(k)
                    .iter_mut()
                    .zip(step.column(k))
                    .for_each(|(next, step)| *next += step * arriving);
            }
        }
        all += &next;
        let size = |a: &Matrix| a.column(0).iter().map(|value| value.abs()).sum::<f64>();
        if size(&next) < 1e-13 * size(&all) {
            break;
        }
        arriving = next;
    }
    all
}

/// Deposit (rows) of one step down at m = k·base (columns).
#[inline(always)]
fn step_matrix(step: &[(Turn, Vec<f64>)], base: f64) -> Matrix {
    let mut matrix = Matrix::zeros(STATES, TERMS);
    for (turn, deposit) in step {
        for (k, moment) in turn.moments_in_lanes(base).into_iter().enumerate() {
            matrix.column_mut(k).iter_mut().zip(deposit).for_each(|(sum, value)| *sum += moment * value);
        }
    }
    matrix
}
