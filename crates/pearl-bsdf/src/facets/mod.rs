//! The single reflection at interface 0 in closed form: facet density × Fresnel.
//!
//! In the frame where wi = (sin θi, 0, cos θi) a facet of slopes (p, q) ~ N(0, σ²) has the normal
//! m ∝ (−p, −q, 1). It sends light above the horizon where (p + tan θi)² + q² < 1/cos² θi, a disc in slopes;
//! every such facet also faces wi. Per solid angle of m the slope density is
//! P(m) = exp(−(p² + q²)/2σ²)/(2πσ² m_z³), and dωm = dωo/(4 wi·m).

pub(crate) mod many;

use crate::Direction;
use crate::numerics::angles::{Polar, greatest, least};
use crate::numerics::normal::{of_upper_tail, upper_tail};
use crate::numerics::quadrature::gauss_legendre;
use crate::numerics::single::exp;
use lut_io::table::{Normals, SurfaceModel};
use pulp::Arch;
use std::f64::consts::TAU;

/// Narrowest facets that are evaluated, radians: a renderer cannot meet a delta lobe by evaluation.
pub const MIN_SLOPE_SD: f64 = 1e-4;
/// Smallest wi·h: a mirror reflection along the surface grows like its inverse without end.
const GRAZING: f64 = 1e-12;
/// Below this a squared sum of two directions may have lost its digits.
pub(crate) const OPPOSITE: f64 = 1e-300;
/// Beyond this many σ the normal distribution has no mass that f64 sums would see.
const FAR: f64 = 8.0;
/// Integrals reach so many σ: 2e-9 of the facets are steeper.
const SUMMED: f64 = 6.0;

/// The facets of interface 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facets {
    sigma: f64,
    inverse_sigma: f64,
    /// −1/(2σ²), and 1/(2πσ²).
    exponent: f64,
    peak: f64,
    /// Index of the first layer over that of the ambient.
    pub(crate) index_ratio: f32,
    inverse_ratio2: f32,
    /// Whether facets are met in proportion to their projected area.
    pub(crate) visible: bool,
}

/// wi and wo with what both lobes need of their half vector.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Half {
    /// wi + wo, of any length.
    pub(crate) h: Direction,
    /// Square of its slope.
    pub(crate) slope2: f64,
    /// One over the z of the unit half vector, and one over that of `h`.
    pub(crate) steep: f64,
    pub(crate) inverse_z: f64,
    /// wi·h = cos θd.
    pub(crate) cos: f64,
}

impl Half {
    /// Of two unit vectors above the horizon.
    #[inline(always)]
    pub(crate) fn new(wi: Direction, wo: Direction) -> Self {
        let (this, length2) = Self::of_apart(wi, wo);
        if length2 < OPPOSITE { Self::of_opposites(this.h) } else { this }
    }

    /// The same where the square of their sum, which comes with it, is at least [`OPPOSITE`].
    #[inline(always)]
    pub(crate) fn of_apart(wi: Direction, wo: Direction) -> (Self, f64) {
        // A z below which no facet is so steep.
        const FLAT: f64 = 1e-90;
        let h = [wi[0] + wo[0], wi[1] + wo[1], wi[2] + wo[2]];
        let across2 = h[0] * h[0] + h[1] * h[1];
        let length2 = across2 + h[2] * h[2];
        // |wi + wo| = 2 cos θd.
        let length = length2.sqrt();
        let inverse_z = 1.0 / greatest(h[2], FLAT);
        let this = Self {
            h,
            slope2: across2 * inverse_z * inverse_z,
            steep: greatest(length * inverse_z, 1.0),
            inverse_z,
            cos: least(greatest(0.5 * length, GRAZING), 1.0),
        };
        (this, length2)
    }

    /// The slope q of its facet across a plane of incidence of this azimuth.
    #[inline(always)]
    pub(crate) fn slope_across(&self, (along, across): (f64, f64)) -> f64 {
        (self.h[1] * along - self.h[0] * across) * self.inverse_z
    }

    /// Of two directions within 1e-150 of opposite horizons, whose sum has a square of 0.
    #[cold]
    fn of_opposites(h: Direction) -> Self {
        let largest = h.iter().fold(0.0, |largest: f64, x| largest.max(x.abs())).max(f64::MIN_POSITIVE);
        let mut this = Self::new(h.map(|x| x / largest), [0.0; 3]);
        this.cos = GRAZING;
        this
    }
}

/// The slopes that reflect above the horizon, at one q: lo < p < hi.
#[derive(Clone, Copy, Debug)]
struct Limits {
    lo: f64,
    hi: f64,
}

/// Ends of a range of slopes in σ, mirrored so that the near one is the more likely: near < far.
#[derive(Clone, Copy, Debug)]
struct Ends {
    near: f64,
    far: f64,
    /// The slope of 1; negative if the range is mirrored.
    unit: f64,
}

impl Facets {
    pub(crate) fn new(model: &SurfaceModel) -> Self {
        let sigma = model.slope_sd.max(MIN_SLOPE_SD);
        Self {
            sigma,
            inverse_sigma: 1.0 / sigma,
            exponent: -0.5 / (sigma * sigma),
            peak: 1.0 / (TAU * sigma * sigma),
            index_ratio: (model.n_first / model.n_ambient) as f32,
            inverse_ratio2: (model.n_ambient / model.n_first).powi(2) as f32,
            visible: model.normals == Normals::Visible,
        }
    }

    /// Standard deviation of a slope, radians.
    pub(crate) const fn slope_sd(&self) -> f64 {
        self.sigma
    }

    /// P(m)/(4 wi·m): density of facets in solid angle of wo.
    #[inline(always)]
    pub(crate) fn facing(&self, half: &Half) -> f64 {
        let density = self.peak * f64::from(exp((self.exponent * half.slope2) as f32));
        density * (half.steep * half.steep * half.steep) / (4.0 * half.cos)
    }

    /// f·cos θo short of the factor that depends on θi alone: P(m)·F/(4 wi·m), times wi·m/m_z for visible facets;
    /// `facing` is [`Self::facing`].
    #[inline(always)]
    pub(crate) fn reflection(&self, half: &Half, facing: f64) -> f64 {
        let reflected = facing * self.fresnel(half.cos);
        if self.visible { reflected * (half.cos * half.steep) } else { reflected }
    }

    /// ∫ [`Self::reflection`] over the exit hemisphere, handed out piece by piece as (mass, cos θd, cos θo).
    pub(crate) fn integrate(&self, rules: &Rules, cos_i: f64, visit: impl FnMut(f64, f64, f64)) {
        Arch::new().dispatch(many::Integral { facets: self, rules, cos_i, visit });
    }

    /// Points p with weights along one q. Where light may be reflected totally, the reflectance has the slope of a root beside the
    /// critical angle: pieces end there, and points crowd towards it as their squares.
    fn along(
        &self,
        rules: &Rules,
        cos_i: f64,
        sin_i: f64,
        q2: f64,
        (lo, hi): (f64, f64),
        mut visit: impl FnMut(f64, f64),
    ) {
        let critical2 = 1.0 - f64::from(self.index_ratio).powi(2);
        if critical2 <= 0.0 {
            return rules.along.iter().for_each(|(x, weight)| {
                visit(lo + 0.5 * (hi - lo) * (1.0 + x), 0.5 * (hi - lo) * weight);
            });
        }
        // (cos θi − p sin θi)² = critical2·(1 + p² + q²), both roots; none of them within is as well as at an end.
        let (a, b, c) = (sin_i * sin_i - critical2, -cos_i * sin_i, cos_i * cos_i - critical2 * (1.0 + q2));
        let turned = -(b + (b * b - a * c).sqrt().copysign(b));
        let within = |root: f64| if root.is_finite() { root.clamp(lo, hi) } else { lo };
        let (first, second) = (within(turned / a), within(c / turned));
        let (first, second) = (first.min(second), first.max(second));
        let middle = 0.5 * (first + second);
        for (from, to) in [(first, lo), (first, middle), (second, middle), (second, hi)] {
            for (x, weight) in &rules.along {
                let t = 0.5 * (1.0 + x);
                visit(from + (to - from) * t * t, (to - from).abs() * t * weight);
            }
        }
    }

    /// Density per steradian with which [`Self::sample`] finds the direction; `facing` is [`Self::facing`].
    #[inline(always)]
    pub(crate) fn pdf(&self, at: &Polar, half: &Half, facing: f64) -> f64 {
        let q = half.slope_across(at.azimuth);
        let limits = limits(at.cos, at.sin, q * q);
        facet_between(facing, self.kept(-1.0 / at.cos, 1.0 / at.cos) * self.kept(limits.lo, limits.hi))
    }

    /// A direction above the horizon: slopes from the normal distribution cut to the disc of the module's head. Where no facet
    /// sends light there, what is found is no direction.
    #[inline(always)]
    pub(crate) fn sample(&self, wi: Direction, at: &Polar, u: f64, v: f64) -> Direction {
        let q = self.slope_between(-1.0 / at.cos, 1.0 / at.cos, u);
        let limits = limits(at.cos, at.sin, q * q);
        reflected(wi, at.azimuth, (self.slope_between(limits.lo, limits.hi, v), q))
    }

    #[inline(always)]
    fn slope_density(&self, slope: f64) -> f64 {
        f64::from(exp((self.exponent * slope * slope) as f32)) * self.peak.sqrt()
    }

    /// Probability that a slope lies between the limits.
    #[inline(always)]
    fn kept(&self, lo: f64, hi: f64) -> f64 {
        let ends = self.ends(lo, hi);
        ends.tail_of_near() - ends.tail_of_far()
    }

    /// A slope between the limits by a uniform number; NaN where none lies there.
    #[inline(always)]
    fn slope_between(&self, lo: f64, hi: f64, u: f64) -> f64 {
        let ends = self.ends(lo, hi);
        ends.slope(Ends::tail_at([ends.tail_of_near(), ends.tail_of_far()], u))
    }

    /// Limits of a slope in units of σ.
    #[inline(always)]
    fn ends(&self, lo: f64, hi: f64) -> Ends {
        let (a, b) = (lo * self.inverse_sigma, hi * self.inverse_sigma);
        // In the variable that falls towards the tail: the far side of both limits keeps its digits.
        if a > 0.0 {
            Ends { near: a, far: b, unit: self.sigma }
        } else {
            Ends { near: -b, far: -a, unit: -self.sigma }
        }
    }

    /// Unpolarised Fresnel reflectance at the cosine of the local angle of incidence.
    #[inline(always)]
    pub(crate) fn fresnel(&self, cos: f64) -> f64 {
        let (cos, ratio) = (cos as f32, self.index_ratio);
        let cos_t2 = 1.0 - (1.0 - cos * cos) * self.inverse_ratio2;
        let cos_t = greatest(cos_t2, 0.0).sqrt();
        let (s, s_sum) = (cos - ratio * cos_t, cos + ratio * cos_t);
        let (p, p_sum) = (ratio * cos - cos_t, ratio * cos + cos_t);
        // (s/s_sum)² + (p/p_sum)² with one division.
        let (both, crossed) = (s_sum * p_sum, [s * p_sum, p * s_sum]);
        let partial = 0.5 * (crossed[0] * crossed[0] + crossed[1] * crossed[1]) / (both * both);
        // A choice and no branch: loops over many pairs stay vectors.
        f64::from(if cos_t2 > 0.0 { partial } else { 1.0 })
    }
}

impl Ends {
    /// Probability of more than the near end.
    #[inline(always)]
    fn tail_of_near(&self) -> f64 {
        if self.near <= -FAR { 1.0 } else { f64::from(upper_tail(self.near as f32)) }
    }

    /// Probability of more than the far end.
    #[inline(always)]
    fn tail_of_far(&self) -> f64 {
        if self.nothing_beyond() { 0.0 } else { f64::from(upper_tail(self.far as f32)) }
    }

    /// Whether there is nothing worth counting beyond the far end.
    #[inline(always)]
    fn nothing_beyond(&self) -> bool {
        (self.far >= FAR) & (self.near <= FAR)
    }

    /// The tail at the share u of what lies between two ends of these tails; NaN if nothing does.
    #[inline(always)]
    fn tail_at([near, far]: [f64; 2], u: f64) -> f64 {
        if near > far { near + u * (far - near) } else { f64::NAN }
    }

    /// The slope beyond which there is this tail; NaN of NaN.
    #[inline(always)]
    fn slope(&self, tail: f64) -> f64 {
        let x = f64::from(of_upper_tail(least(greatest(tail, f64::MIN_POSITIVE), 1.0 - 1e-16)));
        let slope = least(greatest(x, self.near), self.far) * self.unit;
        if tail.is_nan() { tail } else { slope }
    }
}

/// Density of a facet among those that are kept.
#[inline(always)]
fn facet_between(facing: f64, kept: f64) -> f64 {
    if (facing > 0.0) & (kept > 0.0) { facing / kept } else { 0.0 }
}

/// What a facet of the slopes (p, q) reflects wi to, by the cos and sin of the azimuth of wi.
#[inline(always)]
fn reflected(wi: Direction, (along, across): (f64, f64), (p, q): (f64, f64)) -> Direction {
    let z = 1.0 / (1.0 + p * p + q * q).sqrt();
    let m = [z * (q * across - p * along), -z * (p * across + q * along), z];
    let twice = 2.0 * (wi[0] * m[0] + wi[1] * m[1] + wi[2] * m[2]);
    [twice * m[0] - wi[0], twice * m[1] - wi[1], twice * m[2] - wi[2]]
}

/// Where along p the disc of upward reflection lies, at one q.
#[inline(always)]
fn limits(cos_i: f64, sin_i: f64, q2: f64) -> Limits {
    let chord = greatest(1.0 - q2 * cos_i * cos_i, 0.0).sqrt();
    // −tan θ + √(sec²θ − q²) without its cancellation at grazing.
    Limits { lo: -(sin_i + chord) / cos_i, hi: cos_i * (1.0 - q2) / greatest(sin_i + chord, 1e-300) }
}

/// Quadrature rules over the slopes.
pub(crate) struct Rules {
    along: Vec<(f64, f64)>,
    across: Vec<(f64, f64)>,
}

impl Rules {
    /// Gaussians of ± 6σ need a third as many points. Narrow fringes of M under wide facets need these: a third as many miss the albedo of a
    /// band by 2e-3, and leave the scale of reciprocal tables rough by 2e-4.
    pub(crate) fn new() -> Self {
        Self { along: gauss_legendre(96), across: gauss_legendre(24) }
    }

    /// For light whose colour does not matter.
    pub(crate) fn without_fringes() -> Self {
        Self { along: gauss_legendre(36), across: gauss_legendre(12) }
    }
}
