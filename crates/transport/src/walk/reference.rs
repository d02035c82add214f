//! The reference walk: one path at a time in f64, written to be read beside the paper and the model.
//!
//! It shares no code with [`lanes`](super::lanes): unit normals, explicit Snell and Fresnel formulas, library
//! deviates. The production walk must agree with it within the statistical error.

use rand::rngs::SmallRng;
use rand::{Rng, RngExt, SeedableRng};
use rand_distr::{Distribution, Normal};
use thinfilm::intensity::{fresnel, fresnel_complex};

use super::{Exit, Fate};
use crate::{Geometry, Light, Normals, Transport};

/// How an event turns the Fresnel reflectance R into a choice and a weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Estimator {
    /// Reflect with probability R, else refract; the weight stays 1. Unbiased; the variance of the albedo A is that of
    /// a coin, A(1 − A) a path.
    Analog,
    /// Reflect or refract with probability ½ each and multiply the weight by 2R or 2(1 − R). Unbiased, but the weight
    /// is a product of factors, most of them near 0 or 2: after n events its variance grows like 2ⁿ. A path that
    /// refracts at R = 0 four hundred times must have won four hundred fair coins, so that nearly all the albedo sits
    /// in paths too rare to be seen. Useful for stacks of a few layers.
    FairCoin,
    /// The first facet lets the light in, with weight 1 − R, where it would have reflected it away: that light is left to
    /// the closed form of the single reflection. After that analog. Unbiased for all light but [`Fate::Single`]. No path ends at
    /// once, and the interior loses the variance of that coin; but paths that end at once cost next to nothing, so that
    /// variance × crossings stays what it was (`docs/WALK.md`).
    ForcedEntry,
    /// The paper's rules read literally: reflect with probability R *and* multiply by R, or refract *and* multiply by
    /// 1 − R; stop when the weight falls below the threshold. **Biased**: each event counts R twice, so the sum is of
    /// R² and (1 − R)², and energy is lost (for the paper's pearl at 30° it leaves an albedo near 0.002 instead of
    /// 0.386). The cut at the threshold is a further bias. Kept to show what the literal reading gives.
    PaperLiteral,
}

/// The walk of one stack.
#[derive(Clone, Debug)]
pub struct Reference<'a> {
    /// The stack.
    pub transport: &'a Transport,
    /// Tilts in the plane of incidence, or slopes in space.
    pub geometry: Geometry,
    /// Choice and weight at each event.
    pub estimator: Estimator,
    /// Weight (intensity) below which a path is played at Russian roulette: it goes on with probability
    /// weight/threshold at the threshold's weight, which is unbiased. [`Estimator::PaperLiteral`] stops it instead.
    pub threshold: f64,
    /// Crossings after which a path is cut.
    pub event_cap: u32,
}

/// A path's end, in full precision.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct End {
    /// Unit direction of travel; z is up.
    pub direction: [f64; 3],
    /// What is left of the unit of light that came in. 0 if roulette ended the path.
    pub weight: f64,
    /// How the path ended: [`Fate::Absorbed`] if roulette ended it.
    pub fate: Fate,
    /// Facets met.
    pub crossings: u32,
}

/// Slopes beyond this many deviations do not occur in 10¹⁰ draws; visible normals need a bound.
const SLOPE_BOUND: f64 = 7.0;

impl<'a> Reference<'a> {
    /// The analog walk, with a roulette threshold of 10⁻³ and a cap of 10⁷ crossings.
    #[must_use]
    pub fn new(transport: &'a Transport, geometry: Geometry) -> Self {
        Self { transport, geometry, estimator: Estimator::Analog, threshold: 1e-3, event_cap: 10_000_000 }
    }

    /// Walks `paths` paths at incidence `theta_i` (radians); returns their exits and the crossings in all.
    #[must_use]
    pub fn run(&self, theta_i: f64, seed: u64, paths: u64) -> (Vec<Exit>, u64) {
        let mut random = SmallRng::seed_from_u64(seed ^ theta_i.to_bits());
        let mut crossings = 0;
        let exits = (0..paths).map(|_| {
            let end = self.path(theta_i, &mut random);
            crossings += u64::from(end.crossings);
            Exit { direction: end.direction.map(|v| v as f32), weight: end.weight as f32, fate: end.fate }
        });
        (exits.collect(), crossings)
    }

    /// Walks one path.
    pub fn path(&self, theta_i: f64, random: &mut impl Rng) -> End {
        self.path_from(theta_i, None, random)
    }

    /// Walks two paths that meet the same first facet and share nothing else: the covariance of what they find is the
    /// variance that the first facet explains, the most that stratifying it could take away.
    pub fn twins(&self, theta_i: f64, random: &mut impl Rng) -> [End; 2] {
        let facet = self.facet(incident(theta_i), true, random);
        [0, 1].map(|_| self.path_from(theta_i, Some(facet), random))
    }

    /// Walks one path, whose first facet may be given.
    fn path_from(&self, theta_i: f64, mut first: Option<[f64; 3]>, random: &mut impl Rng) -> End {
        let layers = self.transport.layers();
        let mut direction = incident(theta_i);
        let (mut medium, mut interface) = (0, 0);
        let (mut weight, mut crossings, mut entered) = (1.0, 0, false);
        // Share of s in the light that every event of this path meets.
        let share = match self.transport.light {
            Light::Unpolarised => 0.5,
            Light::Tracked => f64::from(u8::from(random.random::<bool>())),
            Light::S => 1.0,
            Light::P => 0.0,
        };
        loop {
            if crossings == self.event_cap {
                return End { direction, weight, fate: Fate::Truncated, crossings };
            }
            let above = medium == interface;
            let other = if above { interface + 1 } else { interface };
            let normal = first.take().unwrap_or_else(|| self.facet(direction, above, random));
            crossings += 1;

            let (n1, n2) = (self.transport.indices[medium], self.transport.indices[other]);
            let cos_i = -dot(direction, normal);
            let sin_t = n1 / n2 * (1.0 - cos_i * cos_i).max(0.0).sqrt();
            let cos_t = (1.0 - sin_t * sin_t).max(0.0).sqrt();
            let sheet = self.transport.sheets.filter(|sheets| (1..=sheets.last).contains(&interface));
            let (s, p) = match sheet {
                Some(sheet) => sheet.reflectance(n1, cos_i),
                None if self.transport.has_complex_faces() => {
                    fresnel_complex(self.transport.index(medium), cos_i, self.transport.index(other))
                }
                None => fresnel(n1, cos_i, n2, cos_t),
            };
            let reflectance = share * s + (1.0 - share) * p;
            let would_leave = direction[2] + 2.0 * cos_i * normal[2] > 0.0;
            let forced = self.estimator == Estimator::ForcedEntry && crossings == 1 && would_leave;
            if forced {
                weight *= 1.0 - reflectance;
            }
            if !forced && self.reflects(reflectance, &mut weight, random) {
                direction = add_scaled(direction, 1.0, normal, 2.0 * cos_i);
            } else if cos_t == 0.0 {
                // Total reflection that absorbs: no ray goes on.
                return End { direction, weight: 0.0, fate: Fate::Absorbed, crossings };
            } else {
                direction = add_scaled(direction, n1 / n2, normal, n1 / n2 * cos_i - cos_t);
                medium = other;
                entered = true;
            }

            let above = medium == interface;
            let heads_up = direction[2] > 0.0;
            if above != heads_up {
                // Still, or again, on its way to the same interface.
            } else if above && interface == 0 {
                let fate = match (entered, crossings) {
                    (true, _) => Fate::Interior,
                    (false, 1) => Fate::Single,
                    (false, _) => Fate::Rehit,
                };
                return End { direction, weight, fate, crossings };
            } else if !above && interface == layers {
                return End { direction, weight, fate: Fate::Transmitted, crossings };
            } else {
                let depth = self.transport.optical_depths[medium - 1];
                if depth > 0.0 {
                    weight *= (-depth / direction[2].abs()).exp();
                }
                interface = if above { interface - 1 } else { interface + 1 };
            }

            if weight < self.threshold {
                if self.estimator == Estimator::PaperLiteral {
                    return End { direction, weight, fate: Fate::Truncated, crossings };
                }
                if random.random::<f64>() * self.threshold >= weight {
                    return End { direction, weight: 0.0, fate: Fate::Absorbed, crossings };
                }
                weight = self.threshold;
            }
        }
    }

    /// Whether the light is reflected; multiplies the weight as the estimator asks.
    fn reflects(&self, reflectance: f64, weight: &mut f64, random: &mut impl Rng) -> bool {
        let (chance, reflected, refracted) = match self.estimator {
            Estimator::Analog | Estimator::ForcedEntry => (reflectance, 1.0, 1.0),
            Estimator::FairCoin => (0.5, 2.0 * reflectance, 2.0 * (1.0 - reflectance)),
            Estimator::PaperLiteral => (reflectance, reflectance, 1.0 - reflectance),
        };
        let reflects = random.random::<f64>() < chance;
        *weight *= if reflects { reflected } else { refracted };
        reflects
    }

    /// The unit normal of a fresh facet, on the side of the ray and facing it.
    fn facet(&self, direction: [f64; 3], above: bool, random: &mut impl Rng) -> [f64; 3] {
        let sd = self.transport.facets.slope_sd;
        let side = if above { 1.0 } else { -1.0 };
        let law = Normal::new(0.0, sd).expect("slope_sd is not negative");
        loop {
            let (slope, normal) = match self.geometry {
                Geometry::Plane => {
                    let tilt: f64 = law.sample(random);
                    (tilt, [-tilt.sin(), 0.0, tilt.cos()])
                }
                Geometry::Space => {
                    let (p, q) = (law.sample(random), law.sample(random));
                    let length = (1.0 + p * p + q * q).sqrt();
                    (p.hypot(q), [-p / length, -q / length, 1.0 / length])
                }
            };
            let normal = normal.map(|v| v * side);
            let cos_i = -dot(direction, normal);
            if cos_i > 0.0 && self.takes(slope, direction, cos_i / normal[2].abs(), random) {
                return normal;
            }
        }
    }

    /// Visible normals: accepts a facet in proportion to its projected area −d·m/m_z.
    fn takes(&self, slope: f64, direction: [f64; 3], area: f64, random: &mut impl Rng) -> bool {
        let sd = self.transport.facets.slope_sd;
        if self.transport.facets.normals == Normals::Unweighted || sd == 0.0 {
            return true;
        }
        let (reach, steepest) = match self.geometry {
            Geometry::Space => (SLOPE_BOUND * sd, SLOPE_BOUND * sd),
            Geometry::Plane => {
                let reach = (6.5 * sd).min(80_f64.to_radians());
                (reach, reach.tan())
            }
        };
        let largest = direction[2].abs() + direction[0].hypot(direction[1]) * steepest;
        slope.abs() <= reach && random.random::<f64>() * largest < area
    }
}

/// Direction of travel of light that comes in at `theta_i` (radians).
fn incident(theta_i: f64) -> [f64; 3] {
    [theta_i.sin(), 0.0, -theta_i.cos()]
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// k·a + l·b.
fn add_scaled(a: [f64; 3], k: f64, b: [f64; 3], l: f64) -> [f64; 3] {
    [0, 1, 2].map(|i| k * a[i] + l * b[i])
}
