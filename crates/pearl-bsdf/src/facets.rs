//! The single reflection at interface 0 in closed form: facet density × Fresnel.
//!
//! In the frame where wi = (sin θi, 0, cos θi) a facet of slopes (p, q) ~ N(0, σ²) has the normal
//! m ∝ (−p, −q, 1). It sends light above the horizon where (p + tan θi)² + q² < 1/cos² θi, a disc in slopes;
//! every such facet also faces wi. Per solid angle of m the slope density is
//! P(m) = exp(−(p² + q²)/2σ²)/(2πσ² m_z³), and dωm = dωo/(4 wi·m).

use crate::Direction;
use crate::angles::{Polar, greatest, least};
use crate::normal::{of_upper_tail, upper_tail};
use crate::quadrature::gauss_legendre;
use crate::single::exp;
use lut_io::table::SurfaceModel;
use std::f64::consts::TAU;

/// Narrowest facets that are evaluated, radians: a renderer cannot meet a delta lobe by evaluation.
pub const MIN_SLOPE_SD: f64 = 1e-4;
/// Smallest wi·h: a mirror reflection along the surface grows like its inverse without end.
const GRAZING: f64 = 1e-12;
/// Below this a squared sum of two directions may have lost its digits.
pub(crate) const OPPOSITE: f64 = 1e-300;
/// Beyond this many σ the normal distribution has no mass that f64 sums would see.
const FAR: f64 = 8.0;

/// The facets of interface 0.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Facets {
    sigma: f64,
    /// −1/(2σ²), and 1/(2πσ²).
    exponent: f64,
    peak: f64,
    /// Index of the first layer over that of the ambient.
    index_ratio: f32,
    inverse_ratio2: f32,
    /// Whether facets are met in proportion to their projected area.
    visible: bool,
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

impl Facets {
    pub(crate) fn new(model: &SurfaceModel) -> Self {
        let sigma = model.slope_sd.max(MIN_SLOPE_SD);
        Self {
            sigma,
            exponent: -0.5 / (sigma * sigma),
            peak: 1.0 / (TAU * sigma * sigma),
            index_ratio: (model.n_first / model.n_ambient) as f32,
            inverse_ratio2: (model.n_ambient / model.n_first).powi(2) as f32,
            visible: model.normals == "visible",
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

    /// ∫ [`Self::reflection`] over the exit hemisphere, handed out piece by piece as (mass, cos θd).
    pub(crate) fn integrate(&self, rules: &Rules, cos_i: f64, mut visit: impl FnMut(f64, f64)) {
        self.integrate_exits(rules, cos_i, |mass, cos, _| visit(mass, cos));
    }

    /// The same with cos θo: (mass, cos θd, cos θo).
    pub(crate) fn integrate_exits(&self, rules: &Rules, cos_i: f64, mut visit: impl FnMut(f64, f64, f64)) {
        let sin_i = (1.0 - cos_i * cos_i).max(0.0).sqrt();
        let q_end = (FAR * self.sigma).min(1.0 / cos_i.max(1e-300));
        for &(x, weight) in &rules.across {
            // Even in q: one half of it, twice.
            let q = 0.5 * q_end * (1.0 + x);
            let across = weight * q_end * self.slope_density(q);
            let limits = limits(cos_i, sin_i, q * q);
            let (lo, hi) = (limits.lo.max(-FAR * self.sigma), limits.hi.min(FAR * self.sigma));
            if lo >= hi {
                continue;
            }
            for &(x, weight) in &rules.along {
                let p = lo + 0.5 * (hi - lo) * (1.0 + x);
                let slant = 1.0 + p * p + q * q;
                let projected = cos_i - p * sin_i;
                let cos = (projected / slant.sqrt()).clamp(0.0, 1.0);
                let seen = if self.visible { projected } else { 1.0 };
                let mass = 0.5 * (hi - lo) * weight * across * self.slope_density(p) * seen;
                // wo = 2(wi·m)m − wi.
                visit(mass * self.fresnel(cos), cos, (2.0 * projected / slant - cos_i).max(0.0));
            }
        }
    }

    /// Density per steradian with which [`Self::sample`] finds the direction; `facing` is [`Self::facing`].
    #[inline(always)]
    pub(crate) fn pdf(&self, at: &Polar, half: &Half, facing: f64) -> f64 {
        let q = across(at, half);
        let kept = self.kept_across(at.cos) * self.kept_along(at.cos, at.sin, q * q);
        if facing > 0.0 && kept > 0.0 { facing / kept } else { 0.0 }
    }

    /// The same where [`Self::keeps_all_across`].
    #[inline(always)]
    pub(crate) fn pdf_of_narrow(&self, at: &Polar, half: &Half, facing: f64) -> f64 {
        let q = across(at, half);
        let kept = self.kept_along(at.cos, at.sin, q * q);
        if (facing > 0.0) & (kept > 0.0) { facing / kept } else { 0.0 }
    }

    /// Probability that q of a facet lies within the disc.
    #[inline(always)]
    fn kept_across(&self, cos_i: f64) -> f64 {
        if self.keeps_all_across(cos_i) { 1.0 } else { self.kept(-1.0 / cos_i, 1.0 / cos_i) }
    }

    /// Whether no facet is too steep across the plane of incidence.
    #[inline(always)]
    pub(crate) fn keeps_all_across(&self, cos_i: f64) -> bool {
        FAR * self.sigma * cos_i <= 1.0
    }

    /// Probability that p of a facet lies within the disc, at one q.
    #[inline(always)]
    fn kept_along(&self, cos_i: f64, sin_i: f64, q2: f64) -> f64 {
        let limits = limits(cos_i, sin_i, q2);
        self.kept(limits.lo, limits.hi)
    }

    /// A direction above the horizon: slopes from the normal distribution cut to the disc of the module's head.
    pub(crate) fn sample(&self, wi: Direction, at: &Polar, u: f64, v: f64) -> Option<Direction> {
        let Polar { cos: cos_i, sin: sin_i, azimuth: (along, across), .. } = *at;
        let q = self.truncated_normal(-1.0 / cos_i, 1.0 / cos_i, u)?;
        let limits = limits(cos_i, sin_i, q * q);
        let p = self.truncated_normal(limits.lo, limits.hi, v)?;
        let z = 1.0 / (1.0 + p * p + q * q).sqrt();
        let m = [z * (q * across - p * along), -z * (p * across + q * along), z];
        let twice = 2.0 * (wi[0] * m[0] + wi[1] * m[1] + wi[2] * m[2]);
        let wo: Direction = std::array::from_fn(|i| twice * m[i] - wi[i]);
        (wo[2] > 0.0).then_some(wo)
    }

    #[inline]
    fn slope_density(&self, slope: f64) -> f64 {
        let x = slope / self.sigma;
        (-0.5 * x * x).exp() / (TAU.sqrt() * self.sigma)
    }

    /// Probability that a slope lies between the limits.
    #[inline(always)]
    fn kept(&self, lo: f64, hi: f64) -> f64 {
        let far = FAR * self.sigma;
        if lo <= -far && hi >= far {
            return 1.0;
        }
        // The smaller tails are subtracted, so that nothing cancels on either side.
        let (a, b) = (lo / self.sigma, hi / self.sigma);
        let (near, far) = if a > 0.0 { (a, b) } else { (-b, -a) };
        let near_tail = upper_tail(near as f32);
        let kept = if nothing_beyond(near, far) { near_tail } else { near_tail - upper_tail(far as f32) };
        f64::from(kept)
    }

    fn truncated_normal(&self, lo: f64, hi: f64, u: f64) -> Option<f64> {
        let (a, b) = (lo / self.sigma, hi / self.sigma);
        // In the variable that falls towards the tail: the far side of both limits keeps its digits.
        let (a, b, sign) = if a > 0.0 { (a, b, 1.0) } else { (-b, -a, -1.0) };
        let near = if a <= -FAR { 1.0 } else { f64::from(upper_tail(a as f32)) };
        let far = if nothing_beyond(a, b) { 0.0 } else { f64::from(upper_tail(b as f32)) };
        if near - far <= 0.0 {
            return None;
        }
        let tail = near + u * (far - near);
        let x = of_upper_tail(tail.clamp(f64::MIN_POSITIVE, 1.0 - 1e-16));
        Some(sign * x.clamp(a, b) * self.sigma)
    }

    /// Unpolarised Fresnel reflectance at the cosine of the local angle of incidence.
    #[inline(always)]
    pub(crate) fn fresnel(&self, cos: f64) -> f64 {
        let (cos, ratio) = (cos as f32, self.index_ratio);
        let cos_t2 = 1.0 - (1.0 - cos * cos) * self.inverse_ratio2;
        if cos_t2 <= 0.0 {
            return 1.0;
        }
        let cos_t = cos_t2.sqrt();
        let (s, s_sum) = (cos - ratio * cos_t, cos + ratio * cos_t);
        let (p, p_sum) = (ratio * cos - cos_t, ratio * cos + cos_t);
        // (s/s_sum)² + (p/p_sum)² with one division.
        let (both, crossed) = (s_sum * p_sum, [s * p_sum, p * s_sum]);
        f64::from(0.5 * (crossed[0] * crossed[0] + crossed[1] * crossed[1]) / (both * both))
    }
}

/// Whether the normal distribution has nothing worth counting beyond the farther of two limits, in σ.
#[inline(always)]
fn nothing_beyond(near: f64, far: f64) -> bool {
    (far >= FAR) & (near <= FAR)
}

/// The slope q across the plane of incidence of the facet that reflects one direction to the other.
#[inline(always)]
fn across(at: &Polar, half: &Half) -> f64 {
    let (along, across) = at.azimuth;
    (half.h[1] * along - half.h[0] * across) * half.inverse_z
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
    /// Enough points for Gaussians of ± 8σ to 1e-9.
    pub(crate) fn new() -> Self {
        Self { along: gauss_legendre(48), across: gauss_legendre(24) }
    }
}
