//! What the materials of scene formats are made of, and the fit of such a material to a pearl.
//!
//! Microfacets are GGX with Smith's height-correlated shadowing, α the square of a roughness; thin films are those of
//! Belcour and Barla, "A Practical Extension to Microfacet Theory for the Modeling of Varying Iridescence" (2017), which both
//! formats prescribe.

use crate::round_trip::point;
use crate::{Direction, PearlBsdf};
use rayon::prelude::*;
use rmpfit::{MPConfig, MPFitter, MPPar, MPResult};
use serde_json::{Map, Value, json};
use std::f64::consts::PI;

/// Viewing angles that a material is fitted at, degrees, and directions at each.
const FITTED_DEG: [f64; 9] = [0.0, 15.0, 28.0, 40.0, 50.0, 60.0, 68.0, 75.0, 81.0];
const FITTED: u32 = 160;
/// Differences are counted over the root of the light plus this share of its peak: nearly as much light as there is.
const FLOOR: f64 = 0.01;
/// A fit has settled where a step changes no more than this.
const CONFIG: MPConfig = MPConfig { ftol: 1e-6, xtol: 1e-6, max_iter: 60, ..MPConfig::new() };

/// A number of a material: its name, what it is kept to, where fits start from.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parameter {
    pub(super) name: &'static str,
    pub(super) range: [f64; 2],
    pub(super) starts: [f64; STARTS],
}

/// Fits that are tried: thin films of several thicknesses, and none.
const STARTS: usize = 5;

/// A number with these limits and one start.
pub(super) const fn number(name: &'static str, range: [f64; 2], start: f64) -> Parameter {
    Parameter { name, range, starts: [start; STARTS] }
}

/// f·cos θo of a material with these numbers, wi the viewer.
pub(super) type Model<const N: usize> = fn(&[f64; N], Direction, Direction) -> [f64; 3];

/// A fitted material.
#[derive(Clone, Debug)]
pub(super) struct Fitted<const N: usize> {
    pub(super) values: [f64; N],
    names: [&'static str; N],
    model: Model<N>,
}

impl<const N: usize> Fitted<N> {
    /// The material that is nearest to a pearl, of those that the starts lead to.
    pub(super) fn new(bsdf: &PearlBsdf, parameters: &[Parameter; N], model: Model<N>) -> Self {
        let points: Vec<Point> =
            FITTED_DEG.par_iter().flat_map_iter(|degrees| drawn(bsdf, degrees.to_radians())).collect();
        let limits: Vec<MPPar> = parameters.iter().map(|parameter| bounded(parameter.range)).collect();
        let from = |start: usize| {
            let mut values = parameters.map(|parameter| parameter.starts[start]);
            let fit = &mut Fit { points: &points, limits: &limits, model };
            let left = fit.mpfit(&mut values).map_or(f64::INFINITY, |status| status.best_norm);
            // Six digits, as they are written.
            (left, values.map(|x| (x * 1e6).round() / 1e6))
        };
        let best = (0..STARTS).into_par_iter().map(from).min_by(|a, b| a.0.total_cmp(&b.0));
        let start = parameters.map(|parameter| parameter.starts[0]);
        Self {
            values: best.map_or(start, |(_, values)| values),
            names: parameters.map(|parameter| parameter.name),
            model,
        }
    }

    /// f·cos θo, linear sRGB.
    pub(super) fn eval(&self, wi: Direction, wo: Direction) -> [f64; 3] {
        if wi[2] > 0.0 && wo[2] > 0.0 { (self.model)(&self.values, wi, wo) } else { [0.0; 3] }
    }

    /// Numbers by name.
    pub(super) fn describe(&self) -> Map<String, Value> {
        self.names.iter().zip(self.values).map(|(name, value)| ((*name).to_owned(), json!(value))).collect()
    }
}

/// A pair of directions, f·cos θo of the pearl, and the root of the weight of each channel.
struct Point {
    wi: Direction,
    wo: Direction,
    value: [f64; 3],
    weight: [f64; 3],
}

/// Directions that the pearl draws at a viewing angle.
fn drawn(bsdf: &PearlBsdf, theta: f64) -> Vec<Point> {
    let wi = [theta.sin(), 0.0, theta.cos()];
    let of = |n: u32| {
        let [u, v, w] = point(n);
        let sample = bsdf.sample(wi, u, v, w)?;
        Some((sample.wo, bsdf.eval_seen(wi, sample.wo).rgb(), 1.0 / (sample.pdf * f64::from(FITTED))))
    };
    let found: Vec<_> = (0..FITTED).filter_map(of).collect();
    let peak = found.iter().flat_map(|(_, value, _)| *value).fold(f64::MIN_POSITIVE, f64::max);
    let weighed = |(wo, value, solid_angle): (Direction, [f64; 3], f64)| Point {
        wi,
        wo,
        value,
        weight: value.map(|x| (solid_angle / (x + FLOOR * peak)).sqrt()),
    };
    found.into_iter().map(weighed).collect()
}

/// A problem as the library asks for it.
struct Fit<'a, const N: usize> {
    points: &'a [Point],
    limits: &'a [MPPar],
    model: Model<N>,
}

fn bounded([limit_low, limit_up]: [f64; 2]) -> MPPar {
    MPPar { limited_low: true, limited_up: true, limit_low, limit_up, ..MPPar::new() }
}

impl<const N: usize> MPFitter for Fit<'_, N> {
    fn eval(&mut self, parameters: &[f64], deviates: &mut [f64]) -> MPResult<()> {
        let parameters: [f64; N] = std::array::from_fn(|i| parameters[i]);
        for (deviates, point) in deviates.chunks_mut(3).zip(self.points) {
            let found = (self.model)(&parameters, point.wi, point.wo);
            for (c, deviate) in deviates.iter_mut().enumerate() {
                *deviate = (found[c] - point.value[c]) * point.weight[c];
            }
        }
        Ok(())
    }

    fn number_of_points(&self) -> usize {
        3 * self.points.len()
    }

    fn parameters(&self) -> &[MPPar] {
        self.limits
    }

    fn config(&self) -> &MPConfig {
        static SETTLED: MPConfig = CONFIG;
        &SETTLED
    }
}

/// A pair of directions as microfacets see it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Facing {
    pub(super) cos_i: f64,
    pub(super) cos_o: f64,
    /// Of the half vector with the normal, and with either direction.
    cos_half: f64,
    pub(super) cos_difference: f64,
}

impl Facing {
    pub(super) fn new(wi: Direction, wo: Direction) -> Self {
        let half: Direction = std::array::from_fn(|i| wi[i] + wo[i]);
        let length = half.iter().map(|h| h * h).sum::<f64>().sqrt();
        Self { cos_i: wi[2], cos_o: wo[2], cos_half: half[2] / length, cos_difference: 0.5 * length }
    }

    /// D·G/(4 cos θi) of GGX: f·cos θo of facets that reflect all.
    pub(super) fn ggx(self, alpha: f64) -> f64 {
        let a2 = alpha * alpha;
        let spread = self.cos_half * self.cos_half * (a2 - 1.0) + 1.0;
        let shadow = |x: f64, y: f64| x * (a2 + (1.0 - a2) * y * y).sqrt();
        let (i, o) = (self.cos_i, self.cos_o);
        a2 / (PI * spread * spread) * 0.5 * o / (shadow(o, i) + shadow(i, o))
    }
}

pub(super) fn mix(a: f64, b: f64, share: f64) -> f64 {
    a + share * (b - a)
}

/// F at normal incidence of an index over that before it.
pub(super) fn at_normal(ratio: f64) -> f64 {
    ((ratio - 1.0) / (ratio + 1.0)).powi(2)
}

/// The index over that before it of such an F at normal incidence: [`at_normal`] turned round.
pub(super) fn index_of(normal: f64) -> f64 {
    let root = normal.sqrt();
    (1.0 + root) / (1.0 - root)
}

/// Schlick's (1 − cos)⁵ from F at normal incidence to F at grazing.
pub(super) fn schlick(normal: f64, grazing: f64, cos: f64) -> f64 {
    mix(normal, grazing, (1.0 - cos.clamp(0.0, 1.0)).powi(5))
}

/// Colour, XYZ, of cos(2π·path/λ + shift) over the wavelength (Belcour and Barla, with their Gaussians); the path in metres.
/// A shift for each of X, Y and Z.
pub(super) fn sensitivity(path: f64, shift: [f64; 3]) -> [f64; 3] {
    const GAUSSIANS: [[f64; 3]; 3] = [
        [5.4856e-13, 1.6810e6, 4.3278e9],
        [4.4201e-13, 1.7953e6, 9.3046e9],
        [5.2481e-13, 2.2084e6, 6.6121e9],
    ];
    /// The second maximum of X.
    const BLUE: [f64; 3] = [9.7470e-14, 2.2399e6, 4.5282e9];
    const SCALE: f64 = 1.0685e-7;
    let phase = 2.0 * PI * path;
    let of = |[value, position, variance]: [f64; 3], shift: f64| {
        value
            * (2.0 * PI * variance).sqrt()
            * (position * phase + shift).cos()
            * (-variance * phase * phase).exp()
            / SCALE
    };
    let mut xyz: [f64; 3] = std::array::from_fn(|c| of(GAUSSIANS[c], shift[c]));
    xyz[0] += of(BLUE, shift[0]);
    xyz
}

/// What a film adds to the mean of its reflectance, XYZ: orders 1 and 2 of the interference of `first` and `second` interfaces.
/// `second` and `shift` are of each channel.
pub(super) fn film(first: f64, second: [f64; 3], path: f64, shift: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let through = 1.0 - first;
    let both = second.map(|second| (first * second).clamp(1e-5, 0.9999));
    let after: [f64; 3] = std::array::from_fn(|c| through * through * second[c] / (1.0 - both[c]));
    let mean = after.map(|after| first + after);
    let mut waves = [0.0; 3];
    for order in 1..=2 {
        let order = f64::from(order);
        let seen = sensitivity(order * path, shift.map(|shift| order * shift));
        for c in 0..3 {
            waves[c] += (after[c] - through) * both[c].sqrt().powf(order) * 2.0 * seen[c];
        }
    }
    (mean, waves)
}

pub(super) fn times(matrix: &[[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|row| (0..3).map(|k| matrix[row][k] * v[k]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn facets_send_back_what_sampled_facets_do() {
        // Expected: the mean of G·(wi·m)/(cos θi·m_z) over 400,000 facets m drawn from D·m_z.
        for (alpha, theta, expected) in [(0.05, 0.3f64, 0.9971), (0.3, 0.3, 0.8736), (0.3, 1.2, 0.8143)] {
            let wi = [theta.sin(), 0.0, theta.cos()];
            let steps = 900;
            let mut sum = 0.0;
            for i in 0..steps {
                for j in 0..steps {
                    let z = (f64::from(i) + 0.5) / f64::from(steps);
                    let phi = PI * (2.0 * (f64::from(j) + 0.5) / f64::from(steps) - 1.0);
                    let sin = (1.0 - z * z).sqrt();
                    sum += Facing::new(wi, [sin * phi.cos(), sin * phi.sin(), z]).ggx(alpha);
                }
            }
            let albedo = sum * 2.0 * PI / f64::from(steps * steps);
            assert!((albedo - expected).abs() < 3e-3, "{alpha} {theta}: {albedo} for {expected}");
        }
    }

    #[test]
    fn a_film_of_no_thickness_is_an_interface_and_thick_ones_are_grey() {
        // Equal path of all wavelengths: X, Y and Z of an equal-energy white.
        let still = sensitivity(0.0, [0.0; 3]);
        assert!(still.iter().all(|x| (x - 1.0).abs() < 2e-2), "{still:?}");
        assert!(sensitivity(2e-5, [0.0; 3]).iter().all(|x| x.abs() < 1e-3));
    }
}
