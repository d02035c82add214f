//! What one interface does to one ray: the integral over facets as a list of weighted outcomes.
//!
//! A ray travels along d = (sin θ, 0, −cos θ) in medium 1 towards the interface with medium 2; η = n₁/n₂ of the real indices. A facet
//! of slopes (x, q) has the normal m ∝ (x, q, 1) and a = cos θ − x sin θ ∝ −d·m > 0 when it faces the ray. The
//! integral runs along lines in the slope plane (rows x ∈ ℝ at fixed q, or rays from a pole), split where the
//! integrand has a break: the facing limit, the horizon of the reflected and of the refracted ray, and the
//! critical angle. On every line each of these is the root of a quadratic.

use std::f64::consts::{FRAC_PI_2, PI};

use super::grid::{LARGEST_SEGMENT_RULE, segment_rule};
use super::surface::steepest_visible_tilt;
use crate::problem::Face;
use crate::{Facets, Light, Normals};

/// Where light goes at an event, seen from the side that it came from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fate {
    /// Reflected away from the interface.
    Reflected = 0,
    /// Reflected onto the same interface again, from the same side.
    ReflectedBack = 1,
    /// Refracted away from the interface on the far side.
    Refracted = 2,
    /// Refracted, but heading back: meets the same interface from the far side.
    RefractedBack = 3,
}

impl Fate {
    pub(super) fn is_reflected(self) -> bool {
        matches!(self, Self::Reflected | Self::ReflectedBack)
    }
}

pub(super) const FATES: [Fate; 4] =
    [Fate::Reflected, Fate::ReflectedBack, Fate::Refracted, Fate::RefractedBack];

/// Weighted exit directions of one fate. Space: `argument` = μ' = |cos θ'|, `sine` = sin θ', `cosine` = cos Δφ.
/// Plane: `argument` = the signed angle θ', `sine` and `cosine` unused.
#[derive(Default, Debug)]
pub(super) struct Outcomes {
    pub(super) weight: Vec<f64>,
    pub(super) argument: Vec<f64>,
    pub(super) sine: Vec<f64>,
    pub(super) cosine: Vec<f64>,
}

impl Outcomes {
    fn push(&mut self, weight: f64, argument: f64, sine: f64, cosine: f64) {
        self.weight.push(weight);
        self.argument.push(argument);
        self.sine.push(sine);
        self.cosine.push(cosine);
    }

    fn clear(&mut self) {
        self.weight.clear();
        self.argument.clear();
        self.sine.clear();
        self.cosine.clear();
    }
}

/// The outcomes of all facets that one ray may meet, by [`Fate`], and the facets' total weight.
#[derive(Default, Debug)]
pub(super) struct Events {
    pub(super) by_fate: [Outcomes; 4],
    pub(super) total: f64,
}

impl Events {
    pub(super) fn clear(&mut self) {
        self.by_fate.iter_mut().for_each(Outcomes::clear);
        self.total = 0.0;
    }
}

/// Which part of an event a rule must integrate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Part {
    Both,
    ReflectedOnly,
    RefractedOnly,
}

/// How finely facets are sampled.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Sampling {
    /// Facets beyond this many σ are left out.
    pub(super) reach: f64,
    /// Degree of the polynomials (in the Legendre argument) that must be integrated.
    pub(super) degree: f64,
    /// Highest azimuthal mode that must be integrated, for the reflected and for the refracted light.
    pub(super) modes: [f64; 2],
    /// 1 resolves every basis function in full.
    pub(super) density: f64,
}

/// One side of one interface.
#[derive(Clone, Copy, Debug)]
pub(super) struct Interface {
    /// The medium the ray is in comes first.
    pub(super) face: Face,
    pub(super) facets: Facets,
    pub(super) light: Light,
    pub(super) sampling: Sampling,
}

/// Points at which a segment's oscillation is measured.
const PROBES: i32 = 6;

/// γ of the Legendre argument t = cos γ, the angle in which polynomials of degree n oscillate n times.
fn legendre_angle(t: f64) -> f64 {
    t.clamp(-1.0, 1.0).acos()
}

/// A line in the slope plane: (x, q) = base + r·(dx, dq).
#[derive(Clone, Copy)]
struct Line {
    base: (f64, f64),
    dir: (f64, f64),
    lo: f64,
    hi: f64,
}

/// A coordinate on a segment in which the integrand is smooth: the line's own, or u with r = c ± u² when the
/// refracted ray has its critical angle c (a square root) at the segment's end or not far beyond it.
#[derive(Clone, Copy)]
enum Chart {
    Straight { from: f64, length: f64 },
    Root { centre: f64, sign: f64, from: f64, length: f64 },
}

impl Chart {
    /// On the segment `from..to`, given the critical points of its line, if light refracts there.
    fn new(from: f64, to: f64, refracts: bool, critical: [f64; 2]) -> Self {
        let distance = |c: f64| if c <= from { from - c } else { c - to };
        // Points inside the segment would have split it; NaN marks none.
        let nearest = critical
            .into_iter()
            .filter(|c| *c <= from || *c >= to)
            .min_by(|a, b| distance(*a).total_cmp(&distance(*b)));
        match nearest {
            Some(centre) if refracts => {
                let sign = if centre <= from { 1.0 } else { -1.0 };
                let ends = [(sign * (from - centre)).max(0.0).sqrt(), (sign * (to - centre)).max(0.0).sqrt()];
                let low = ends[0].min(ends[1]);
                Self::Root { centre, sign, from: low, length: ends[0].max(ends[1]) - low }
            }
            _ => Self::Straight { from, length: to - from },
        }
    }

    /// r and dr of the unit coordinate.
    fn at(&self, unit: f64) -> (f64, f64) {
        match *self {
            Self::Straight { from, length } => (from + length * unit, length),
            Self::Root { centre, sign, from, length } => {
                let u = from + length * unit;
                (centre + sign * u * u, 2.0 * u * length)
            }
        }
    }

    /// Gauss–Legendre of about `count` points: `visit(r, weight)`.
    fn integrate(&self, count: f64, mut visit: impl FnMut(f64, f64)) {
        let pieces = (count / LARGEST_SEGMENT_RULE as f64).ceil().max(1.0);
        let rule = segment_rule((count / pieces).ceil() as usize + if pieces > 1.0 { 8 } else { 0 });
        for piece in 0..pieces as usize {
            for (t, w) in rule.nodes.iter().zip(&rule.weights) {
                let (r, dr) = self.at((piece as f64 + 0.5 * (t + 1.0)) / pieces);
                visit(r, dr * 0.5 * w / pieces);
            }
        }
    }
}

/// Where a line must be split, in order, and the critical points among them (NaN: none).
struct Breaks {
    at: Vec<f64>,
    critical: [f64; 2],
}

impl Breaks {
    /// Calls `visit(from, to)` for each segment of `lo..hi`; a refracting segment between two critical points is halved.
    fn segments(
        &self,
        lo: f64,
        hi: f64,
        refracts: impl Fn(f64) -> bool,
        mut visit: impl FnMut(f64, f64, Chart),
    ) {
        let mut from = lo;
        for &to in self.at.iter().chain([&hi]) {
            if to <= from {
                continue;
            }
            let middle = 0.5 * (from + to);
            let refracting = refracts(middle);
            let near = |c: f64| (c - from).abs().min((c - to).abs()) < to - from;
            if refracting && self.critical.into_iter().all(near) {
                visit(from, middle, Chart::new(from, middle, true, self.critical));
                visit(middle, to, Chart::new(middle, to, true, self.critical));
            } else {
                visit(from, to, Chart::new(from, to, refracting, self.critical));
            }
            from = to;
        }
    }
}

impl Interface {
    /// All facets for modes without a pole (or for modes 0 and 1, which a pole does not disturb).
    pub(super) fn rows(&self, theta: f64, part: Part, events: &mut Events) {
        let sigma = self.facets.slope_sd;
        let reach = self.sampling.reach * sigma;
        let step = self.row_step(theta, part);
        let rows = (reach / step).ceil() as usize;
        for k in 0..rows {
            let q = (k as f64 + 0.5) * step;
            let half = (reach * reach - q * q).max(0.0).sqrt();
            if half == 0.0 {
                continue;
            }
            let line = Line { base: (0.0, q), dir: (1.0, 0.0), lo: -half, hi: half };
            self.line(theta, part, line, step, false, events);
        }
    }

    /// All facets, in polar coordinates about the slope that sends the ray along the normal.
    pub(super) fn polar(&self, theta: f64, pole: f64, part: Part, events: &mut Events) {
        let sigma = self.facets.slope_sd;
        let reach = self.sampling.reach * sigma;
        // cos mΔφ, and the azimuthal harmonics of the facet density about the pole.
        let highest = self.sampling.modes[usize::from(part == Part::RefractedOnly)];
        let harmonics =
            highest + 10.0 + 1.2 * self.sampling.reach * (pole.abs() / sigma).min(self.sampling.reach);
        let rays = (0.5 * harmonics).ceil() as usize + 4;
        let step = PI / rays as f64;
        for k in 0..rays {
            let (sin, cos) = ((k as f64 + 0.5) * step).sin_cos();
            let hi = -pole * cos + (reach * reach - pole * pole * sin * sin).max(0.0).sqrt();
            let line = Line { base: (pole, 0.0), dir: (cos, sin), lo: 0.0, hi };
            self.line(theta, part, line, step, true, events);
        }
    }

    /// The slope x that reflects (or refracts) the ray along the normal, if facets reach it with a weight that matters.
    pub(super) fn pole(&self, theta: f64, part: Part) -> Option<f64> {
        let (s, c) = theta.sin_cos();
        let x = match part {
            Part::RefractedOnly => {
                let g = self.face.eta * c - 1.0;
                if g == 0.0 || (g > 0.0) != (self.face.eta > 1.0) {
                    return None;
                }
                -self.face.eta * s / g
            }
            _ => -(0.5 * theta).tan(),
        };
        let faces = c - x * s > 0.0;
        (faces && x.abs() < (self.sampling.reach - 0.3) * self.facets.slope_sd).then_some(x)
    }

    /// Distance of rows q: the midpoint rule of a Gaussian times an oscillation of rate k (radians per slope) is
    /// exact to exp(−reach²/2) once 2π/step − k > reach/σ.
    fn row_step(&self, theta: f64, part: Part) -> f64 {
        let sigma = self.facets.slope_sd;
        let edge = theta.cos() / theta.sin().max(1e-300);
        let mut rate: f64 = 0.0;
        for x in [-2.5 * sigma, 0.0, 2.5 * sigma] {
            let x = x.min(0.9 * edge);
            for q in [0.5 * sigma, 1.5 * sigma, 2.5 * sigma] {
                let delta = 0.5 * sigma;
                rate = rate.max(self.rate(theta, part, (x, q - delta), (x, q + delta)));
            }
        }
        2.0 * PI / (self.sampling.density * rate + self.sampling.reach / sigma)
    }

    /// Fastest oscillation of any basis function between two facets, radians per unit of slope.
    fn rate(&self, theta: f64, part: Part, from: (f64, f64), to: (f64, f64)) -> f64 {
        let (a, b) = (self.directions(theta, from), self.directions(theta, to));
        let distance = ((to.0 - from.0).powi(2) + (to.1 - from.1).powi(2)).sqrt();
        let between = |u: Option<(f64, f64)>, v: Option<(f64, f64)>, mode: f64| match (u, v) {
            (Some(u), Some(v)) => {
                let polar = self.sampling.degree * (u.0 - v.0).abs();
                let azimuth = mode * (u.1 - v.1).abs();
                polar.hypot(azimuth)
            }
            _ => 0.0,
        };
        let reflected =
            if part == Part::RefractedOnly { 0.0 } else { between(a.0, b.0, self.sampling.modes[0]) };
        let refracted =
            if part == Part::ReflectedOnly { 0.0 } else { between(a.1, b.1, self.sampling.modes[1]) };
        reflected.max(refracted) / distance
    }

    /// (γ, Δφ) of the reflected and of the refracted ray.
    #[allow(clippy::type_complexity)] // two rays of two angles
    fn directions(&self, theta: f64, slope: (f64, f64)) -> (Option<(f64, f64)>, Option<(f64, f64)>) {
        let angles = |d: [f64; 3]| (legendre_angle(2.0 * d[2].abs() - 1.0), d[1].atan2(d[0]));
        let (s, c) = theta.sin_cos();
        let (reflected, refracted, _) = self.meet(s, c, slope.0, slope.1);
        (Some(angles(reflected)), refracted.map(angles))
    }

    /// Reflected direction, refracted direction (none past the critical angle), Fresnel reflectance.
    fn meet(&self, s: f64, c: f64, x: f64, q: f64) -> ([f64; 3], Option<[f64; 3]>, f64) {
        let square = 1.0 + x * x + q * q;
        let a = c - x * s;
        let twice = 2.0 * a / square;
        let reflected = [s + twice * x, twice * q, twice - c];
        let inverse = 1.0 / square.sqrt();
        let cos_i = a * inverse;
        let (fresnel, cos_t) = self.face.meet(cos_i, self.light);
        if cos_t == 0.0 {
            return (reflected, None, fresnel);
        }
        let g = (self.face.eta * cos_i - cos_t) * inverse;
        (reflected, Some([self.face.eta * s + g * x, g * q, g - self.face.eta * c]), fresnel)
    }

    /// Adds one line. `measure` is the width of the line (rows) or of its sector (rays, times r).
    fn line(&self, theta: f64, part: Part, line: Line, measure: f64, polar: bool, events: &mut Events) {
        let (s, c) = theta.sin_cos();
        let mut line = line;
        // Facing: a > 0.
        let facing = (c - s * line.base.0) / (s * line.dir.0);
        let mut cut = false;
        if s * line.dir.0 > 0.0 && facing < line.hi {
            line.hi = facing;
            cut = true;
        } else if s * line.dir.0 < 0.0 && facing > line.lo {
            line.lo = facing;
            cut = true;
        }
        if line.lo >= line.hi {
            return;
        }
        let breaks = self.breaks(s, c, &line);
        let add = |r: f64, weight: f64, events: &mut Events| {
            let (x, q) = (line.base.0 + r * line.dir.0, line.base.1 + r * line.dir.1);
            let measure = if polar { measure * r } else { measure };
            self.add(s, c, x, q, weight * measure, part, events);
        };
        if breaks.at.is_empty() && !polar && !cut {
            let rate = self.line_rate(theta, part, &line);
            let sigma = self.facets.slope_sd;
            let step = 2.0 * PI / (self.sampling.density * rate + self.sampling.reach / sigma);
            let half = (line.hi / step).ceil() as i64;
            for k in -half..half {
                add((k as f64 + 0.5) * step, step, events);
            }
            return;
        }
        let point = |r: f64| (line.base.0 + r * line.dir.0, line.base.1 + r * line.dir.1);
        let refracts = |r: f64| {
            let (x, q) = point(r);
            self.meet(s, c, x, q).1.is_some()
        };
        breaks.segments(line.lo, line.hi, refracts, |from, to, chart| {
            let mut turn = 0.0;
            let mut last = chart.at(1e-4).0;
            for k in 1..=PROBES {
                let next = chart.at(1e-4 + (1.0 - 2e-4) * f64::from(k) / f64::from(PROBES)).0;
                turn += self.rate(theta, part, point(last), point(next)) * (next - last).abs();
                last = next;
            }
            let smooth = 8.0 + self.sampling.reach * 0.25 * (to - from) / self.facets.slope_sd;
            let count = smooth + 0.5 * self.sampling.density * turn;
            chart.integrate(count, |r, weight| add(r, weight, events));
        });
    }

    fn line_rate(&self, theta: f64, part: Part, line: &Line) -> f64 {
        let sigma = self.facets.slope_sd;
        let at = |r: f64| (line.base.0 + r * line.dir.0, line.base.1 + r * line.dir.1);
        let mut rate: f64 = 0.0;
        for k in -3..3 {
            let r = f64::from(k) * sigma;
            if r >= line.lo && r + sigma <= line.hi {
                rate = rate.max(self.rate(theta, part, at(r), at(r + sigma)));
            }
        }
        rate
    }

    /// Breaks strictly inside the line.
    fn breaks(&self, s: f64, c: f64, line: &Line) -> Breaks {
        let (bx, bq) = line.base;
        let (dx, dq) = line.dir;
        let square = bx * bx + bq * bq;
        let along = bx * dx + bq * dq;
        // Reflected along the horizon: cos θ (x² + q² − 1) + 2x sin θ = 0.
        let horizon = roots(c, 2.0 * (c * along + s * dx), c * (square - 1.0) + 2.0 * s * bx).0;
        let mut at = horizon.to_vec();
        let mut critical = [f64::NAN; 2];
        if self.face.eta > 1.0 {
            // Critical angle: a² = cos²θ_c (1 + x² + q²).
            let cos_critical = 1.0 - 1.0 / (self.face.eta * self.face.eta);
            let a = c - s * bx;
            let (pair, real) = roots(
                s * s * dx * dx - cos_critical,
                -2.0 * (a * s * dx + cos_critical * along),
                a * a - cos_critical * (1.0 + square),
            );
            if real {
                critical = pair;
            }
            at.extend(pair);
            // Refracted along the horizon: η²c²(1 + x² + q²) − 2η²c·a − (1 − η²) = 0.
            let e = self.face.eta * self.face.eta;
            let horizon = roots(
                e * c * c,
                2.0 * e * c * (c * along + s * dx),
                e * c * c * (1.0 + square) - 2.0 * e * c * a - (1.0 - e),
            );
            at.extend(horizon.0);
        }
        at.retain(|r| *r > line.lo && *r < line.hi);
        at.sort_by(f64::total_cmp);
        Breaks { at, critical }
    }

    /// Adds the outcomes of one facet. `measure` holds the area in slope space that it stands for.
    fn add(&self, s: f64, c: f64, x: f64, q: f64, measure: f64, part: Part, events: &mut Events) {
        let a = c - x * s;
        if a <= 0.0 {
            return;
        }
        let sigma = self.facets.slope_sd;
        let mut weight = measure * (-0.5 * (x * x + q * q) / (sigma * sigma)).exp();
        if self.facets.normals == Normals::Visible {
            weight *= a;
        }
        events.total += weight;
        let (reflected, refracted, fresnel) = self.meet(s, c, x, q);
        let mut push = |fate: Fate, weight: f64, d: [f64; 3]| {
            let sine = d[0].hypot(d[1]);
            let cosine = if sine > 0.0 { d[0] / sine } else { 1.0 };
            events.by_fate[fate as usize].push(weight, d[2].abs().min(1.0), sine.min(1.0), cosine);
        };
        if part != Part::RefractedOnly {
            let fate = if reflected[2] > 0.0 { Fate::Reflected } else { Fate::ReflectedBack };
            push(fate, weight * fresnel, reflected);
        }
        if let (Some(d), true) = (refracted, part != Part::ReflectedOnly) {
            let fate = if d[2] < 0.0 { Fate::Refracted } else { Fate::RefractedBack };
            push(fate, weight * (1.0 - fresnel), d);
        }
    }

    /// All facets of the plane problem: one signed tilt α in the plane of incidence.
    pub(super) fn tilts(&self, theta: f64, events: &mut Events) {
        let sigma = self.facets.slope_sd;
        let mut reach = self.sampling.reach * sigma;
        if self.facets.normals == Normals::Visible {
            reach = steepest_visible_tilt(sigma);
        }
        let (lo, hi) = ((-FRAC_PI_2 - theta).max(-reach), (FRAC_PI_2 - theta).min(reach));
        let mut at = vec![0.5 * (FRAC_PI_2 - theta), 0.5 * (-FRAC_PI_2 - theta)];
        let mut critical = [f64::NAN; 2];
        if self.face.eta > 1.0 {
            let angle = (1.0 / self.face.eta).asin();
            critical = [angle - theta, -angle - theta];
            at.extend(critical);
        }
        // Refracted along the horizon: t − α = ±π/2, so sin t = ±cos α = η sin(θ + α).
        for sign in [1.0, -1.0] {
            let alpha = ((sign / self.face.eta - theta.sin()) / theta.cos()).atan();
            at.extend([alpha, alpha - PI, alpha + PI]);
        }
        at.retain(|alpha| *alpha > lo && *alpha < hi);
        at.sort_by(f64::total_cmp);
        let refracts = |alpha: f64| self.face.eta * (theta + alpha).sin().abs() < 1.0;
        Breaks { at, critical }.segments(lo, hi, refracts, |from, to, chart| {
            let mut turn = 0.0;
            let mut last = chart.at(1e-4).0;
            for k in 1..=PROBES {
                let next = chart.at(1e-4 + (1.0 - 2e-4) * f64::from(k) / f64::from(PROBES)).0;
                turn += self.tilt_turn(theta, last, next);
                last = next;
            }
            let smooth = 8.0 + self.sampling.reach * 0.25 * (to - from) / self.facets.slope_sd;
            let count = smooth + 0.5 * self.sampling.density * self.sampling.degree * turn;
            chart.integrate(count, |alpha, weight| self.tilt(theta, alpha, weight, events));
        });
    }

    /// How far the Legendre angle γ of the reflected or the refracted ray turns between two tilts.
    fn tilt_turn(&self, theta: f64, from: f64, to: f64) -> f64 {
        let gamma = |angle: f64| legendre_angle(angle.sin().asin() / FRAC_PI_2);
        let refraction = |alpha: f64| (self.face.eta * (theta + alpha).sin()).clamp(-1.0, 1.0).asin() - alpha;
        let reflected = gamma(theta + 2.0 * from) - gamma(theta + 2.0 * to);
        let refracted = gamma(refraction(from)) - gamma(refraction(to));
        reflected.abs().max(refracted.abs())
    }

    fn tilt(&self, theta: f64, alpha: f64, measure: f64, events: &mut Events) {
        let sigma = self.facets.slope_sd;
        let cos_i = (theta + alpha).cos();
        if cos_i <= 0.0 {
            return;
        }
        let mut weight = measure * (-0.5 * (alpha / sigma).powi(2)).exp();
        if self.facets.normals == Normals::Visible {
            weight *= cos_i / alpha.cos();
        }
        events.total += weight;
        let (fresnel, cos_t) = self.face.meet(cos_i, self.light);
        let mut push = |away: Fate, back: Fate, weight: f64, angle: f64| {
            let (fate, angle) = if angle > FRAC_PI_2 {
                (back, PI - angle)
            } else if angle < -FRAC_PI_2 {
                (back, -PI - angle)
            } else {
                (away, angle)
            };
            events.by_fate[fate as usize].push(weight, angle, 0.0, 1.0);
        };
        push(Fate::Reflected, Fate::ReflectedBack, weight * fresnel, theta + 2.0 * alpha);
        if cos_t > 0.0 {
            let refraction = (self.face.eta * (theta + alpha).sin()).atan2(cos_t);
            push(Fate::Refracted, Fate::RefractedBack, weight * (1.0 - fresnel), refraction - alpha);
        }
    }
}

/// Real roots of a·r² + b·r + c, or twice the real part of a complex pair (a good place to split all the same);
/// NaN where there is none. The flag says whether they are real.
fn roots(a: f64, b: f64, c: f64) -> ([f64; 2], bool) {
    if a == 0.0 {
        return ([-c / b, f64::NAN], true);
    }
    let discriminant = b * b - 4.0 * a * c;
    if discriminant < 0.0 {
        return ([-0.5 * b / a, f64::NAN], false);
    }
    let q = -0.5 * (b + discriminant.sqrt().copysign(b));
    ([q / a, c / q], true)
}
