//! The distant light, the studio sky, and what the pearl and the ground send of them to the viewer.

use super::Pixel;
use super::scene::{Hit, Ray, Shape, sphere_distance};
use super::vector::{Frame, Vector, add, dot, mix, normalize, scale, smooth};
use pearl_bsdf::{Evaluation, PearlBsdf};
use std::f64::consts::PI;

/// Which light falls on the shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lighting {
    /// One direction, nothing else.
    Distant,
    /// A studio: a soft gradient and three windows.
    Sky,
}

impl Lighting {
    /// Name in file names.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Distant => "distant",
            Self::Sky => "sky",
        }
    }
}

/// Irradiance of the distant light on a surface that faces it.
const DISTANT_IRRADIANCE: f64 = 2.2;
/// Share of it that the surroundings send back from everywhere, so that the dark side is not black.
const DISTANT_FILL: f64 = 0.02;

/// Additive-recurrence sequence in ten dimensions (Roberts 2018, "R_d"), shifted by a hash of the pixel
/// (Cranley & Patterson 1976): a function of seed, pixel and sample number only.
pub(super) struct Sequence {
    shift: u64,
    number: f64,
}

impl Sequence {
    pub(super) fn new(seed: u64, pixel: u32, number: u32) -> Self {
        Self { shift: mix64(seed ^ mix64(u64::from(pixel))), number: f64::from(number) }
    }

    /// The number of one dimension, in [0, 1).
    pub(super) fn at(&self, dimension: u32) -> f64 {
        // φ₁₀ solves x¹¹ = x + 1.
        const PHI: f64 = 1.063_031_012_893_138_4;
        let shift = mix64(self.shift ^ u64::from(dimension + 1)) as f64 / 18_446_744_073_709_551_616.0;
        let step = PHI.powi(-(dimension as i32 + 1));
        (shift + self.number * step).fract().min(1.0 - f64::EPSILON)
    }
}

/// Finaliser of splitmix64 (Steele et al. 2014).
fn mix64(x: u64) -> u64 {
    let mut z = x.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

/// A rectangular light at infinity with soft edges.
struct Window {
    frame: Frame,
    /// Half width and half height on the plane at distance 1.
    half: [f64; 2],
    radiance: Vector,
}

impl Window {
    fn new(towards: Vector, half: [f64; 2], radiance: Vector) -> Self {
        let z = normalize(towards);
        // Upright: x is level.
        let x = normalize([-z[1], z[0], 0.0]);
        let y = super::vector::cross(z, x);
        Self { frame: Frame { x, y, z }, half, radiance }
    }

    /// Coordinates from −1 to 1 inside the window.
    fn coordinates(&self, direction: Vector) -> Option<[f64; 2]> {
        let local = self.frame.to_local(direction);
        if local[2] <= 1e-3 {
            return None;
        }
        let at = [local[0] / local[2] / self.half[0], local[1] / local[2] / self.half[1]];
        (at[0].abs() < 1.0 && at[1].abs() < 1.0).then_some(at)
    }

    fn radiance(&self, direction: Vector) -> Vector {
        let Some([x, y]) = self.coordinates(direction) else { return [0.0; 3] };
        let edge = |x: f64| 1.0 - smooth(0.72, 1.0, x.abs());
        // A little brighter in the middle, as a lamp behind a diffuser is.
        scale(self.radiance, edge(x) * edge(y) * (1.0 - 0.25 * (x * x + y * y)))
    }

    fn sample(&self, u: f64, v: f64) -> Vector {
        let (x, y) = ((2.0 * u - 1.0) * self.half[0], (2.0 * v - 1.0) * self.half[1]);
        normalize(self.frame.to_world([x, y, 1.0]))
    }

    /// Density per steradian of [`Self::sample`].
    fn pdf(&self, direction: Vector) -> f64 {
        if self.coordinates(direction).is_none() {
            return 0.0;
        }
        let cos = dot(direction, self.frame.z);
        1.0 / (4.0 * self.half[0] * self.half[1] * cos * cos * cos)
    }
}

/// The lights.
pub(super) struct Studio {
    windows: [Window; 3],
    distant: Vector,
}

impl Studio {
    pub(super) fn new(shape: Shape) -> Self {
        Self {
            windows: [
                // Key: a large window at the upper left, a little warm.
                Window::new([-0.75, -0.62, 0.95], [0.36, 0.46], [5.6, 5.45, 5.2]),
                // Fill: a tall strip at the right, a little cool.
                Window::new([1.0, -0.35, 0.35], [0.16, 0.75], [1.5, 1.58, 1.7]),
                // Rim: low behind, for the silhouette.
                Window::new([0.35, 1.0, 0.5], [0.7, 0.2], [2.4, 2.4, 2.5]),
            ],
            distant: normalize(match shape {
                Shape::Sphere => [-0.55, -0.8, 0.9],
                // From behind, so that the folds mirror it towards the camera.
                Shape::Swatch => [-0.45, 0.5, 0.95],
            }),
        }
    }

    /// Radiance of the sky; below the horizon that of the ground far away.
    fn sky(&self, direction: Vector) -> Vector {
        let up = direction[2];
        let gradient = if up >= 0.0 {
            mix([0.2, 0.205, 0.215], [0.4, 0.41, 0.43], smooth(0.0, 1.0, up))
        } else {
            mix([0.2, 0.205, 0.215], [0.04, 0.041, 0.044], smooth(0.0, 0.35, -up))
        };
        self.windows.iter().fold(gradient, |sum, window| add(sum, window.radiance(direction)))
    }

    /// Irradiance of the ground z = −1 with the unit sphere on it.
    fn irradiance_on_ground(&self, lighting: Lighting, point: Vector, random: &Sequence) -> Vector {
        let open = |direction: Vector| f64::from(u8::from(sphere_distance((point, direction)).is_none()));
        // Cosine-weighted share of the sky that a sphere of radius 1 at height 1 hides: cos θ/D².
        let distance2 = point[0] * point[0] + point[1] * point[1] + 1.0;
        let ambient = 1.0 - distance2.powf(-1.5);
        match lighting {
            Lighting::Distant => {
                let sun = DISTANT_IRRADIANCE * self.distant[2] * open(self.distant);
                [sun + PI * DISTANT_FILL * ambient; 3]
            }
            Lighting::Sky => {
                let sky = scale([0.33, 0.335, 0.35], PI * ambient);
                self.windows.iter().fold(sky, |sum, window| {
                    let direction = window.sample(random.at(2), random.at(3));
                    let received = open(direction) * direction[2].max(0.0) / window.pdf(direction).max(1e-9);
                    add(sum, scale(window.radiance(direction), received))
                })
            }
        }
    }
}

/// Reflectance of the ground.
const GROUND: Vector = [0.115, 0.118, 0.124];
/// Radiance of the backdrop behind it.
const BACKDROP: Vector = [0.052, 0.054, 0.058];

/// Radiance of the ground that a ray meets, or of the backdrop; the sphere stands on it and shades it.
pub(super) fn ground(
    studio: &Studio,
    lighting: Lighting,
    (_, direction): Ray,
    point: Option<Vector>,
    random: &Sequence,
) -> Vector {
    let rise = smooth(-0.22, 0.25, direction[2]);
    let backdrop = scale(BACKDROP, 1.0 - 0.55 * rise);
    let Some(p) = point else { return backdrop };
    let away = (p[0] * p[0] + p[1] * p[1]).sqrt();
    let lit = studio.irradiance_on_ground(lighting, p, random);
    let diffuse: Vector = std::array::from_fn(|c| GROUND[c] / PI * lit[c]);
    mix(diffuse, backdrop, smooth(1.5, 9.0, away))
}

/// What the pearl sends to the viewer: diffuse, incoherent interference, lobes, and their sum; along directions of `sampler`.
pub(super) fn reflected(
    bsdf: &PearlBsdf,
    sampler: &PearlBsdf,
    studio: &Studio,
    lighting: Lighting,
    shape: Shape,
    hit: &Hit,
    random: &Sequence,
) -> Pixel {
    let frame = Frame::new(hit.normal);
    let view = frame.to_local(hit.view);
    match lighting {
        Lighting::Distant => {
            let mut pixel = Pixel::default();
            if !shape.shades(hit.point, studio.distant) {
                let value = bsdf.eval_seen(view, frame.to_local(studio.distant));
                collect(&mut pixel, &value, [DISTANT_IRRADIANCE; 3]);
            }
            if let Some(sample) = sampler.sample(view, random.at(4), random.at(5), random.at(6)) {
                let value = bsdf.eval_seen(view, sample.wo);
                collect(&mut pixel, &value, [DISTANT_FILL / sample.pdf; 3]);
            }
            pixel
        }
        Lighting::Sky => {
            let mut pixel = Pixel::default();
            let incoming = |direction: Vector| {
                if shape == Shape::Swatch && direction[2] < 0.12 {
                    // Another fold: about as bright as a fold under this sky.
                    return [0.16; 3];
                }
                studio.sky(direction)
            };
            if let Some(sample) = sampler.sample(view, random.at(4), random.at(5), random.at(6)) {
                let direction = frame.to_world(sample.wo);
                let value = bsdf.eval_seen(view, sample.wo);
                let pdf = sample.pdf + window_pdf(studio, direction);
                collect(&mut pixel, &value, incoming(direction).map(|l| l / pdf));
            }
            // Balance heuristic (Veach & Guibas 1995) with one sample of one window.
            let u = 3.0 * random.at(7);
            let window = &studio.windows[(u as usize).min(2)];
            let direction = window.sample(u.fract(), random.at(8));
            let light = frame.to_local(direction);
            let pdf = sampler.pdf(view, light) + window_pdf(studio, direction);
            collect(&mut pixel, &bsdf.eval_seen(view, light), incoming(direction).map(|l| l / pdf));
            pixel
        }
    }
}

fn window_pdf(studio: &Studio, direction: Vector) -> f64 {
    studio.windows.iter().map(|window| window.pdf(direction)).sum::<f64>() / studio.windows.len() as f64
}

fn collect(pixel: &mut Pixel, value: &Evaluation, weight: Vector) {
    let lobes = add(value.mirror, value.blur);
    for (sum, part) in pixel.iter_mut().zip([value.diffuse, value.incoherent, lobes, value.rgb()]) {
        *sum = add(*sum, std::array::from_fn(|c| part[c] * weight[c]));
    }
}
