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
    /// All there are.
    pub const ALL: [Self; 2] = [Self::Distant, Self::Sky];

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
    pub(super) fn at(&self, dimension: usize) -> f64 {
        let shift = mix64(self.shift ^ (dimension as u64 + 1)) as f64 / 18_446_744_073_709_551_616.0;
        (shift + self.number * STEPS[dimension]).fract().min(1.0 - f64::EPSILON)
    }
}

/// Powers of 1/φ₁₀, which solves x¹¹ = x + 1.
const STEPS: [f64; 10] = {
    const PHI: f64 = 1.063_031_012_893_138_4;
    let mut steps = [1.0 / PHI; 10];
    let mut k = 1;
    while k < steps.len() {
        steps[k] = steps[k - 1] / PHI;
        k += 1;
    }
    steps
};

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

    /// Radiance that arrives at a point of the pearl.
    fn incoming(&self, hit: &Hit, direction: Vector) -> Vector {
        if hit.shape == Shape::Swatch && direction[2] < 0.12 {
            // Another fold: about as bright as a fold under this sky.
            return [0.16; 3];
        }
        self.sky(direction)
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

/// What the pearl sends to the viewer at each of many points: diffuse, incoherent interference, lobes, and their sum; along
/// directions that the first BSDF samples.
pub(super) fn reflected<const N: usize>(
    bsdfs: [&PearlBsdf; N],
    studio: &Studio,
    lighting: Lighting,
    points: &[(&Hit, Sequence)],
) -> [Vec<Pixel>; N] {
    let frames: Vec<Frame> = points.iter().map(|(hit, _)| Frame::new(hit.normal)).collect();
    let views: Vec<Vector> =
        points.iter().zip(&frames).map(|((hit, _), frame)| frame.to_local(hit.view)).collect();
    let mut pixels = [(); N].map(|()| vec![Pixel::default(); points.len()]);
    // Towards the lights.
    let mut pairs = Pairs::default();
    match lighting {
        Lighting::Distant => {
            for (k, (hit, _)) in points.iter().enumerate() {
                if !hit.shades(studio.distant) {
                    pairs.push(k, views[k], frames[k].to_local(studio.distant), [DISTANT_IRRADIANCE; 3]);
                }
            }
        }
        Lighting::Sky => {
            // Balance heuristic (Veach & Guibas 1995) with one sample of one window.
            let towards = points.iter().map(|(_, random)| {
                let u = 3.0 * random.at(7);
                studio.windows[(u as usize).min(2)].sample(u.fract(), random.at(8))
            });
            let towards: Vec<Vector> = towards.collect();
            let lights: Vec<Vector> =
                towards.iter().zip(&frames).map(|(towards, frame)| frame.to_local(*towards)).collect();
            let mut densities = vec![0.0; points.len()];
            bsdfs[0].pdf_many(&views, &lights, &mut densities);
            for (k, (hit, _)) in points.iter().enumerate() {
                let pdf = densities[k] + window_pdf(studio, towards[k]);
                pairs.push(k, views[k], lights[k], studio.incoming(hit, towards[k]).map(|l| l / pdf));
            }
        }
    }
    for (bsdf, pixels) in bsdfs.iter().zip(&mut pixels) {
        pairs.collect(bsdf, pixels);
    }
    // Where the lobes point.
    let numbers: Vec<[f64; 3]> = points.iter().map(|(_, random)| [4, 5, 6].map(|d| random.at(d))).collect();
    let mut samples = vec![None; points.len()];
    bsdfs[0].sample_seen_many(&views, &numbers, &mut samples);
    let mut pairs = Pairs::default();
    for (k, sample) in samples.iter().enumerate() {
        let Some(sample) = sample else { continue };
        let weight = match lighting {
            Lighting::Distant => [DISTANT_FILL / sample.pdf; 3],
            Lighting::Sky => {
                let direction = frames[k].to_world(sample.wo);
                let pdf = sample.pdf + window_pdf(studio, direction);
                studio.incoming(points[k].0, direction).map(|l| l / pdf)
            }
        };
        add_light(&mut pixels[0][k], &sample.value, weight);
        if N > 1 {
            pairs.push(k, views[k], sample.wo, weight);
        }
    }
    for (bsdf, pixels) in bsdfs.iter().zip(&mut pixels).skip(1) {
        pairs.collect(bsdf, pixels);
    }
    pixels
}

/// Pairs of directions at some of the points, and what the value there counts.
#[derive(Default)]
struct Pairs {
    point: Vec<usize>,
    view: Vec<Vector>,
    light: Vec<Vector>,
    weight: Vec<Vector>,
}

impl Pairs {
    fn push(&mut self, point: usize, view: Vector, light: Vector, weight: Vector) {
        self.point.push(point);
        self.view.push(view);
        self.light.push(light);
        self.weight.push(weight);
    }

    fn collect(&self, bsdf: &PearlBsdf, pixels: &mut [Pixel]) {
        let mut values = vec![Evaluation::default(); self.point.len()];
        bsdf.eval_seen_many(&self.view, &self.light, &mut values);
        for ((point, value), weight) in self.point.iter().zip(&values).zip(&self.weight) {
            add_light(&mut pixels[*point], value, *weight);
        }
    }
}

fn window_pdf(studio: &Studio, direction: Vector) -> f64 {
    studio.windows.iter().map(|window| window.pdf(direction)).sum::<f64>() / studio.windows.len() as f64
}

fn add_light(pixel: &mut Pixel, value: &Evaluation, weight: Vector) {
    let lobes = add(value.mirror, value.blur);
    for (sum, part) in pixel.iter_mut().zip([value.diffuse, value.incoherent, lobes, value.rgb()]) {
        *sum = add(*sum, std::array::from_fn(|c| part[c] * weight[c]));
    }
}
