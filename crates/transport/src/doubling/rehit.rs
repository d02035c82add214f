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

/// How finely the chains are followed.
#[derive(Clone, Copy, Debug)]
struct Rule {
    /// Half period of a row's series in widths w: what lies beyond weighs e^(−half_period²/2).
    half_period: f64,
    /// Highest frequency in 1/w: chains have widths ≥ w/√2, so that e^(−highest²/4) is left out.
    highest: f64,
    /// Downward states on (0, ε), and as many points of the integral over the next one.
    states: usize,
    /// Exit rows.
    rows: usize,
}

impl Rule {
    /// Terms of a row's series.
    fn terms(&self) -> usize {
        (self.highest * self.half_period / PI) as usize + 1
    }
}

/// To 2e-9 of the light.
const FINE: Rule = Rule { half_period: 8.0, highest: 9.0, states: 12, rows: 44 };
/// To 1e-5 of the light, of facets that are not too steep: a few times cheaper.
const COARSE: Rule = Rule { half_period: 6.5, highest: 7.25, states: 8, rows: 32 };
/// [`Rule::terms`] of both, at least.
const FINE_TERMS: usize = 24;
const COARSE_TERMS: usize = 16;
/// Facets that a solution goes to, in σ, up to which the coarse rule is as good as the rest of it (a total variation of 2e-5).
const COARSE_ENOUGH: f64 = 6.45;
/// Steepest facets of the coarse rule, radians: of steeper ones rows of period π and others meet, which rows feel.
const COARSE_SLOPES: f64 = 0.14;

/// Rehit light below this share of all light is not resolved (its share and moments are kept).
const NEGLIGIBLE: f64 = 1e-9;

/// One reflection between two polar angles, sampled in azimuth: ∫ k cos(mφ) dφ = Σ samples·cos(m(p + ½)·step).
struct Turn {
    step: f64,
    /// Frequency from which on nothing is left.
    gone: f64,
    samples: Vec<f64>,
}

/// Direction by sine and cosine of θ; a negative cosine heads for the interface.
type Direction = (f64, f64);

impl Turn {
    fn new(rule: Rule, lobe: &SingleReflection, sigma: f64, from: Direction, to: Direction) -> Self {
        let Rule { half_period, highest, .. } = rule;
        let width = sigma * (to.1 + from.1) / (to.0 * from.0).sqrt().max(1e-12);
        let end = PI.min(half_period * width);
        // The midpoint rule is exact to e^(−half_period²/2) once 2π/step − highest/w exceeds half_period/w; the floor serves Fresnel's
        // factor when the lobe goes all the way round.
        let least = if end < PI { 8 } else { 24 };
        let count = ((end * (highest + half_period) / (2.0 * PI * width)).ceil() as usize).max(least);
        let step = end / count as f64;
        let around = |p: usize| Azimuth::new((p as f64 + 0.5) * step);
        let samples = (0..count).map(|p| 2.0 * step * lobe.towards(to, around(p))).collect();
        // A Gaussian: gone, and the rule no longer resolves it.
        Self { step, gone: 1.2 * highest / width, samples }
    }

    /// The cosine moments at m = k·base, k < TERMS.
    #[inline(always)]
    fn moments<const TERMS: usize>(&self, base: f64) -> [f64; TERMS] {
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
            if k as f64 * base > self.gone {
                *sum = 0.0;
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
    half_period: f64,
    /// Columns: nodes of ln(1 + e/ε); rows: terms.
    series: Matrix,
    /// ln(1 + e/ε) of the highest exit that facets reach.
    range: f64,
}

impl RehitLobe {
    /// As fine as a solution with facets up to `reach` standard deviations. `None` if `share` of the light is too little to matter.
    pub(super) fn new(
        transport: &Transport,
        incident: &SingleReflection,
        theta_i: f64,
        share: f64,
        reach: f64,
    ) -> Option<Self> {
        if share < NEGLIGIBLE {
            return None;
        }
        let coarse = reach <= COARSE_ENOUGH && transport.facets.slope_sd <= COARSE_SLOPES;
        let rule = if coarse { COARSE } else { FINE };
        Some(Self::by(rule, transport, incident, theta_i))
    }

    fn by(rule: Rule, transport: &Transport, incident: &SingleReflection, theta_i: f64) -> Self {
        let (sine, cosine) = theta_i.sin_cos();
        // A grazing ray leaves at twice the facet's tilt.
        let sigma = transport.facets.slope_sd;
        let highest = (2.0 * rule.half_period * sigma).min(FRAC_PI_2).sin();
        let mut lobe = Self {
            sine,
            cosine,
            sigma,
            half_period: rule.half_period,
            series: Matrix::zeros(0, 0),
            range: (highest / cosine).ln_1p(),
        };
        lobe.series = Arch::new().dispatch(|| {
            if rule.terms() > COARSE_TERMS {
                lobe.chains::<FINE_TERMS>(rule, transport, incident)
            } else {
                lobe.chains::<COARSE_TERMS>(rule, transport, incident)
            }
        });
        lobe
    }

    /// The series of all exit rows.
    #[inline(always)]
    fn chains<const TERMS: usize>(
        &self,
        rule: Rule,
        transport: &Transport,
        incident: &SingleReflection,
    ) -> Matrix {
        let Self { sine, cosine, sigma, .. } = *self;
        let states = segment_rule(rule.states);
        let elevation: Vec<f64> = states.nodes.iter().map(|t| 0.5 * cosine * (t + 1.0)).collect();
        let weight: Vec<f64> = states.weights.iter().map(|w| 0.5 * cosine * w).collect();
        let along = |e: f64| ((1.0 - e * e).max(0.0).sqrt(), e);
        let lobes: Vec<SingleReflection> =
            elevation.iter().map(|e| SingleReflection::new(transport, Geometry::Space, e.acos())).collect();
        let first: Vec<Turn> = elevation
            .iter()
            .map(|e| Turn::new(rule, incident, sigma, (sine, cosine), (along(*e).0, -e)))
            .collect();
        let again = chain_steps(rule, &lobes, &elevation, sigma, cosine);
        let mut series = Matrix::zeros(TERMS, rule.rows);
        let mut known: Option<(f64, Matrix)> = None;
        for (row, t) in segment_rule(rule.rows).nodes.iter().enumerate() {
            let exit = along((cosine * (0.5 * self.range * (t + 1.0)).exp_m1()).min(1.0));
            let last: Vec<Turn> = lobes
                .iter()
                .zip(&elevation)
                .map(|(lobe, e)| Turn::new(rule, lobe, sigma, along(*e), exit))
                .collect();
            if last.iter().all(Turn::negligible) {
                continue;
            }
            let half_period = self.half_period(exit);
            let base = PI / half_period;
            if known.as_ref().is_none_or(|(at, _)| *at != base) {
                // Wide rows share Φ = π.
                known = Some((base, visits::<TERMS>(&first, &again, &weight, base)));
            }
            let Some((_, visits)) = &known else { continue };
            for (state, turn) in last.iter().enumerate() {
                for (k, moment) in turn.moments::<TERMS>(base).into_iter().enumerate() {
                    let norm = if k == 0 { 0.5 } else { 1.0 } / half_period;
                    series[(k, row)] += norm * visits[(state, k)] * moment;
                }
            }
        }
        series
    }

    fn half_period(&self, exit: Direction) -> f64 {
        let width = self.sigma * (exit.1 + self.cosine) / (exit.0 * self.sine).sqrt().max(1e-12);
        PI.min(self.half_period * width)
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
            let half_period = self.half_period(exit);
            for (f, &phi) in phi.iter().enumerate() {
                let phi = phi.abs();
                if phi < half_period {
                    values[(i, f)] = cosine_series(PI * phi / half_period, &row);
                }
            }
        }
        values
    }

    /// ∫ f·cos θo dω over cells: `columns` of them along θ, each with as many points and weights, between edges of φ; both mirror
    /// halves.
    pub(super) fn shares(&self, theta: &[f64], weights: &[f64], columns: usize, sectors: &[f64]) -> Matrix {
        let points = theta.len() / columns;
        let mut shares = Matrix::zeros(columns, sectors.len().saturating_sub(1));
        let mut below = Vec::new();
        for (k, (&theta, weight)) in theta.iter().zip(weights).enumerate() {
            let exit = theta.sin_cos();
            let t = 2.0 * (exit.1.max(0.0) / self.cosine).ln_1p() / self.range - 1.0;
            if t > 1.0 {
                continue;
            }
            let half_period = self.half_period(exit);
            integrate(&interpolate(&self.series, t), half_period, sectors, &mut below);
            for (f, pair) in below.windows(2).enumerate() {
                shares[(k / points, f)] += 2.0 * weight * (pair[1] - pair[0]);
            }
        }
        shares
    }
}

/// Integrals of a row's series from 0 to each edge, ascending: up to the first beyond its half period, where the row ends.
fn integrate(row: &[f64], half_period: f64, edges: &[f64], below: &mut Vec<f64>) {
    below.clear();
    let scale = half_period / PI;
    for &edge in edges {
        if edge >= half_period {
            below.push(row[0] * half_period);
            break;
        }
        let (sine, cosine) = (edge / scale).sin_cos();
        let (mut now, mut before) = (sine, 0.0);
        let mut sum = row[0] * edge;
        for (k, coefficient) in row.iter().enumerate().skip(1) {
            sum += coefficient * now * scale / k as f64;
            (now, before) = (2.0 * cosine * now - before, now);
        }
        below.push(sum);
    }
}

/// The rows' polynomial at t, by the barycentric formula of Gauss–Legendre nodes: weights (−1)ʲ·√((1 − x²)w).
fn interpolate(series: &Matrix, t: f64) -> Vec<f64> {
    let rule = segment_rule(series.columns());
    let mut sum = vec![0.0; series.rows()];
    let mut norm = 0.0;
    for (j, (x, w)) in rule.nodes.iter().zip(&rule.weights).enumerate() {
        let sign = if j % 2 == 0 { 1.0 } else { -1.0 };
        let distance = t - x;
        if distance == 0.0 {
            return series.column(j).to_vec();
        }
        let weight = sign * ((1.0 - x * x) * w).sqrt() / distance;
        norm += weight;
        sum.iter_mut().zip(series.column(j)).for_each(|(sum, value)| *sum += weight * value);
    }
    sum.iter_mut().for_each(|value| *value /= norm);
    sum
}

fn cosine_series(angle: f64, coefficients: &[f64]) -> f64 {
    let twice = 2.0 * angle.cos();
    let (mut now, mut before) = (1.0, angle.cos());
    let mut sum = 0.0;
    for coefficient in coefficients {
        sum += coefficient * now;
        (now, before) = (twice * now - before, now);
    }
    sum
}

/// From each state to the next one down: the turns at the points of a rule on (0, e), and the deposit of each point
/// on the states (weight included).
fn chain_steps(
    rule: Rule,
    lobes: &[SingleReflection],
    elevation: &[f64],
    sigma: f64,
    top: f64,
) -> Vec<Vec<(Turn, Vec<f64>)>> {
    let points = segment_rule(rule.states);
    let from = |e: f64| ((1.0 - e * e).max(0.0).sqrt(), e);
    lobes
        .iter()
        .zip(elevation)
        .map(|(lobe, &e)| {
            points
                .nodes
                .iter()
                .zip(&points.weights)
                .map(|(t, w)| {
                    let next = 0.5 * e * (t + 1.0);
                    let turn = Turn::new(rule, lobe, sigma, from(e), (from(next).0, -next));
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
#[inline(always)]
fn visits<const TERMS: usize>(
    first: &[Turn],
    again: &[Vec<(Turn, Vec<f64>)>],
    weight: &[f64],
    base: f64,
) -> Matrix {
    let mut arriving = Matrix::zeros(first.len(), TERMS);
    for (state, turn) in first.iter().enumerate() {
        for (k, moment) in turn.moments::<TERMS>(base).into_iter().enumerate() {
            arriving[(state, k)] = weight[state] * moment;
        }
    }
    let steps: Vec<Matrix> = again.iter().map(|step| step_matrix::<TERMS>(step, base)).collect();
    let mut all = arriving.clone();
    for _ in 0..60 {
        let mut next = Matrix::zeros(first.len(), TERMS);
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
fn step_matrix<const TERMS: usize>(step: &[(Turn, Vec<f64>)], base: f64) -> Matrix {
    let mut matrix = Matrix::zeros(step.first().map_or(0, |(_, deposit)| deposit.len()), TERMS);
    for (turn, deposit) in step {
        for (k, moment) in turn.moments::<TERMS>(base).into_iter().enumerate() {
            matrix.column_mut(k).iter_mut().zip(deposit).for_each(|(sum, value)| *sum += moment * value);
        }
    }
    matrix
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_coarse_rule_finds_the_lobes_of_the_fine_one() {
        const POINTS: usize = 600;
        // Graded towards the horizon and towards φ = 0.
        let grade = |k: f64, of: usize| (k / of as f64).powi(4);
        let elevations: Vec<f64> = (0..=POINTS).map(|k| FRAC_PI_2 * grade(k as f64, POINTS)).collect();
        let theta: Vec<f64> =
            elevations.windows(2).map(|pair| FRAC_PI_2 - 0.5 * (pair[0] + pair[1])).collect();
        let bands = elevations.windows(2).zip(&theta);
        let weights: Vec<f64> = bands.map(|(pair, theta)| (pair[1] - pair[0]) * theta.sin()).collect();
        let sectors: Vec<f64> = (0..=120).map(|k| PI * grade(f64::from(k), 120)).collect();
        for (sigma_deg, n) in [(0.3, 1.53), (2.0, 1.1), (2.0, 2.5), (8.0, 1.53)] {
            let transport = Transport::alternating(1, n, 1.43, 1.53, f64::to_radians(sigma_deg));
            for theta_i in [70.0, 80.0, 86.0, 89.0, 89.9].map(f64::to_radians) {
                let single = SingleReflection::new(&transport, Geometry::Space, theta_i);
                let [fine, coarse] = [FINE, COARSE].map(|rule| {
                    let lobe = RehitLobe::by(rule, &transport, &single, theta_i);
                    lobe.shares(&theta, &weights, 150, &sectors)
                });
                let light: f64 = fine.values().iter().sum();
                let pairs = fine.values().iter().zip(coarse.values());
                let apart = 0.5 * pairs.map(|(a, b)| (a - b).abs()).sum::<f64>();
                // Re-hits are judged by the root of their share.
                assert!(apart <= 1e-5 * light.max(1e-5), "{sigma_deg} {n} {theta_i}: {apart:e} of {light:e}");
            }
        }
    }
}
