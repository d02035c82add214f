//! The distant light, the studio sky, and what the pearl and the ground send of them to the viewer.

use super::Pixel;
use super::numbers::Choice;
use super::scene::{Hit, Ray, Shape, sphere_distance};
use super::vector::{Frame, Vector, add, dot, mix, normalize, scale, smooth};
use pearl_bsdf::{Evaluation, PearlBsdf};
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI};

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

    /// Radiance from a direction, and the density per steradian of [`Self::sample`] there.
    #[inline]
    fn at(&self, direction: Vector) -> Option<(Vector, f64)> {
        let cos = dot(direction, self.frame.z);
        if cos <= 1e-3 {
            return None;
        }
        let x = dot(direction, self.frame.x) / (cos * self.half[0]);
        let y = dot(direction, self.frame.y) / (cos * self.half[1]);
        if x.abs() >= 1.0 || y.abs() >= 1.0 {
            return None;
        }
        let edge = |x: f64| 1.0 - smooth(0.72, 1.0, x.abs());
        // A little brighter in the middle, as a lamp behind a diffuser is.
        let brightness = edge(x) * edge(y) * (1.0 - 0.25 * (x * x + y * y));
        Some((scale(self.radiance, brightness), 1.0 / (self.area() * cos * cos * cos)))
    }

    /// The direction to where it is nearest to another direction, short of its soft edges.
    fn nearest(&self, to: Vector) -> Vector {
        const INSIDE: f64 = 0.6;
        let [x, y, z] = self.frame.to_local(to);
        let along = |x: f64, half: f64| (x / z.max(1e-3)).clamp(-INSIDE * half, INSIDE * half);
        normalize(self.frame.to_world([along(x, self.half[0]), along(y, self.half[1]), 1.0]))
    }

    fn sample(&self, u: f64, v: f64) -> Vector {
        let (x, y) = ((2.0 * u - 1.0) * self.half[0], (2.0 * v - 1.0) * self.half[1]);
        normalize(self.frame.to_world([x, y, 1.0]))
    }

    /// On the plane at distance 1: about its solid angle.
    const fn area(&self) -> f64 {
        4.0 * self.half[0] * self.half[1]
    }
}

/// How many windows there are.
const WINDOWS: usize = 3;

/// The lights.
pub(super) struct Studio {
    windows: [Window; WINDOWS],
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

    /// Radiance of the sky, below the horizon that of the ground far away; and the density per steradian of directions to the windows
    /// that are chosen with some chances.
    fn sky(&self, chances: &[f64; WINDOWS], direction: Vector) -> (Vector, f64) {
        let up = direction[2];
        let gradient = if up >= 0.0 {
            mix([0.2, 0.205, 0.215], [0.4, 0.41, 0.43], smooth(0.0, 1.0, up))
        } else {
            mix([0.2, 0.205, 0.215], [0.04, 0.041, 0.044], smooth(0.0, 0.35, -up))
        };
        let (mut radiance, mut density) = (gradient, 0.0);
        for (window, chance) in self.windows.iter().zip(chances) {
            if let Some((light, pdf)) = window.at(direction) {
                (radiance, density) = (add(radiance, light), density + chance * pdf);
            }
        }
        (radiance, density)
    }

    /// Radiance that arrives at a point of the pearl, and the density as of [`Self::sky`].
    fn incoming(&self, hit: &Hit, chances: &[f64; WINDOWS], direction: Vector) -> (Vector, f64) {
        let (radiance, density) = self.sky(chances, direction);
        // Another fold: about as bright as a fold under this sky.
        let hidden = hit.shape == Shape::Swatch && direction[2] < 0.12;
        (if hidden { [0.16; 3] } else { radiance }, density)
    }

    /// Irradiance of the ground z = −1 with the unit sphere on it, by a point of every window.
    fn irradiance_on_ground(&self, lighting: Lighting, point: Vector, [u, v, _]: [f64; 3]) -> Vector {
        let open = |direction: Vector| sphere_distance((point, direction)).is_none();
        // Cosine-weighted share of the sky that a sphere of radius 1 at height 1 hides: cos θ/D².
        let distance2 = point[0] * point[0] + point[1] * point[1] + 1.0;
        let ambient = 1.0 - 1.0 / (distance2 * distance2.sqrt());
        match lighting {
            Lighting::Distant => {
                let sun = if open(self.distant) { DISTANT_IRRADIANCE * self.distant[2] } else { 0.0 };
                [sun + PI * DISTANT_FILL * ambient; 3]
            }
            Lighting::Sky => {
                let sky = scale([0.33, 0.335, 0.35], PI * ambient);
                self.windows.iter().fold(sky, |sum, window| {
                    let direction = window.sample(u, v);
                    match window.at(direction) {
                        Some((radiance, pdf)) if direction[2] > 0.0 && open(direction) => {
                            add(sum, scale(radiance, direction[2] / pdf))
                        }
                        _ => sum,
                    }
                })
            }
        }
    }
}

/// Reflectance of the ground.
const GROUND: Vector = [0.115, 0.118, 0.124];
/// Radiance of the backdrop behind it.
const BACKDROP: Vector = [0.052, 0.054, 0.058];

/// Radiance of the ground that a ray meets, or of the backdrop, the mean over samples; the sphere stands on it and shades it.
pub(super) fn ground(
    studio: &Studio,
    lighting: Lighting,
    (_, direction): Ray,
    point: Option<Vector>,
    samples: u32,
    numbers: impl Fn(u32) -> [f64; 3],
) -> Vector {
    let rise = smooth(-0.22, 0.25, direction[2]);
    let backdrop = scale(BACKDROP, 1.0 - 0.55 * rise);
    let Some(p) = point else { return backdrop };
    let away = (p[0] * p[0] + p[1] * p[1]).sqrt();
    let share = 1.0 / f64::from(samples);
    let lit = (0..samples).fold([0.0; 3], |sum, sample| {
        add(sum, scale(studio.irradiance_on_ground(lighting, p, numbers(sample)), share))
    });
    let diffuse: Vector = std::array::from_fn(|c| GROUND[c] / PI * lit[c]);
    mix(diffuse, backdrop, smooth(1.5, 9.0, away))
}

/// A point of the pearl, and the pixel that shows it.
pub(super) struct Lit<'a> {
    pub(super) hit: &'a Hit,
    pub(super) pixel: u32,
}

/// What a viewer sees of a white surrounding over the viewing angle, in equal steps of it.
pub(super) struct White(Vec<Pixel>);

impl White {
    const STEPS: usize = 128;

    pub(super) fn of(bsdf: &PearlBsdf) -> Self {
        let at = |step: usize| {
            let theta = (FRAC_PI_2 * step as f64 / Self::STEPS as f64).min(FRAC_PI_2 - 1e-6);
            let [diffuse, incoherent, mirror, blur] = bsdf.directional_albedo_seen(theta);
            let mut pixel = Pixel::default();
            add_light(&mut pixel, &Evaluation { diffuse, incoherent, mirror, blur }, [1.0; 3]);
            pixel
        };
        Self((0..=Self::STEPS).into_par_iter().map(at).collect())
    }

    fn add(&self, pixel: &mut Pixel, cos: f64, weight: f64) {
        let steps = cos.clamp(0.0, 1.0).acos() / FRAC_PI_2 * Self::STEPS as f64;
        let step = (steps as usize).min(Self::STEPS - 1);
        let t = steps - step as f64;
        let seen = self.0[step].iter().zip(&self.0[step + 1]);
        for (sum, (a, b)) in pixel.iter_mut().zip(seen) {
            *sum = add(*sum, scale(mix(*a, *b, t), weight));
        }
    }
}

/// What the pearls send to the viewer at points under the distant light: diffuse, incoherent interference, lobes, and their sum.
pub(super) fn under_distant_light<const N: usize>(
    bsdfs: [(&PearlBsdf, &White); N],
    studio: &Studio,
    points: &[Lit<'_>],
) -> [Vec<Pixel>; N] {
    let mut pairs = Pairs::default();
    let mut cosines = Vec::with_capacity(points.len());
    for (k, Lit { hit, .. }) in points.iter().enumerate() {
        let frame = Frame::new(hit.normal);
        let view = frame.to_local(hit.view);
        cosines.push(view[2]);
        if !hit.shades(studio.distant) {
            pairs.push(k, view, frame.to_local(studio.distant), [DISTANT_IRRADIANCE; 3]);
        }
    }
    bsdfs.map(|(bsdf, white)| {
        let mut pixels = vec![Pixel::default(); points.len()];
        pairs.collect(bsdf, &mut pixels);
        for (pixel, cos) in pixels.iter_mut().zip(&cosines) {
            white.add(pixel, *cos, DISTANT_FILL);
        }
        pixels
    })
}

/// The same under the sky, the mean of `samples` of every point, along directions that the first pearl samples. `numbers` has three
/// random numbers of a sample of a point.
pub(super) fn under_sky<const N: usize>(
    bsdfs: [&PearlBsdf; N],
    studio: &Studio,
    points: &[Lit<'_>],
    samples: u32,
    numbers: impl Fn(usize, Choice, u32) -> [f64; 3],
) -> [Vec<Pixel>; N] {
    let frames: Vec<Frame> = points.iter().map(|point| Frame::new(point.hit.normal)).collect();
    let views: Vec<Vector> =
        points.iter().zip(&frames).map(|(point, frame)| frame.to_local(point.hit.view)).collect();
    let all = points.len() * samples as usize;
    let share = 1.0 / f64::from(samples);
    let chances = window_chances(bsdfs[0], studio, points, &frames, &views);
    // Towards the windows; balance heuristic (Veach & Guibas 1995).
    let mut pairs = Pairs::with_capacity(all);
    let mut pdfs = Vec::with_capacity(all);
    for (k, point) in points.iter().enumerate() {
        for sample in 0..samples {
            let direction = sample_windows(studio, &chances[k], numbers(k, Choice::Light, sample));
            let (light, pdf) = studio.incoming(point.hit, &chances[k], direction);
            pairs.push(k, views[k], frames[k].to_local(direction), scale(light, share));
            pdfs.push(pdf);
        }
    }
    let mut densities = vec![0.0; all];
    bsdfs[0].pdf_many(&pairs.view, &pairs.light, &mut densities);
    for ((weight, pdf), density) in pairs.weight.iter_mut().zip(&pdfs).zip(densities) {
        *weight = scale(*weight, 1.0 / (pdf + density));
    }
    let mut pixels = [(); N].map(|()| vec![Pixel::default(); points.len()]);
    for (bsdf, pixels) in bsdfs.iter().zip(&mut pixels) {
        pairs.collect(bsdf, pixels);
    }
    // Where the lobes point.
    let of_points = |k: usize| (0..samples).map(move |sample| (k, sample));
    let drawn: Vec<[f64; 3]> =
        (0..points.len()).flat_map(of_points).map(|(k, sample)| numbers(k, Choice::Lobes, sample)).collect();
    let mut found = vec![None; all];
    bsdfs[0].sample_seen_many(&pairs.view, &drawn, &mut found);
    let mut pairs = Pairs::with_capacity(if N > 1 { all } else { 0 });
    for ((k, _), sample) in (0..points.len()).flat_map(of_points).zip(&found) {
        let Some(sample) = sample else { continue };
        let direction = frames[k].to_world(sample.wo);
        let (light, pdf) = studio.incoming(points[k].hit, &chances[k], direction);
        let weight = scale(light, share / (sample.pdf + pdf));
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

/// With what chances a point sends a ray to each window: mostly by what light from where it is nearest to the normal, and to the mirror
/// direction, would send to the viewer, at the first point of the pixel.
fn window_chances(
    bsdf: &PearlBsdf,
    studio: &Studio,
    points: &[Lit<'_>],
    frames: &[Frame],
    views: &[Vector],
) -> Vec<[f64; WINDOWS]> {
    /// Shared out evenly, for windows of which these places say little.
    const EVENLY: f64 = 0.3;
    const PLACES: usize = 2;
    let firsts: Vec<usize> =
        (0..points.len()).filter(|k| *k == 0 || points[k - 1].pixel != points[*k].pixel).collect();
    let seen: Vec<Vector> = firsts.iter().flat_map(|k| [views[*k]; PLACES * WINDOWS]).collect();
    let towards = |k: &usize| {
        let (frame, [x, y, z]) = (&frames[*k], views[*k]);
        let mirror = frame.to_world([-x, -y, z]);
        studio.windows.each_ref().map(|window| [frame.z, mirror].map(|to| frame.to_local(window.nearest(to))))
    };
    let lights: Vec<Vector> = firsts.iter().flat_map(towards).flatten().collect();
    let mut values = vec![Evaluation::default(); lights.len()];
    bsdf.eval_seen_many(&seen, &lights, &mut values);
    let mut of_pixels = values.chunks(PLACES * WINDOWS).map(|values| {
        let sent: [f64; WINDOWS] = std::array::from_fn(|k| {
            let (window, places) = (&studio.windows[k], &values[PLACES * k..][..PLACES]);
            let sent = places.iter().map(|value| dot(window.radiance, value.rgb())).sum::<f64>();
            window.area() * sent
        });
        let all = sent.iter().sum::<f64>();
        let even = 1.0 / WINDOWS as f64;
        sent.map(|sent| if all > 0.0 { EVENLY * even + (1.0 - EVENLY) * sent / all } else { even })
    });
    let mut chances = [0.0; WINDOWS];
    let mut firsts = firsts.into_iter().peekable();
    let of_point = |k: usize| {
        if firsts.next_if_eq(&k).is_some() {
            chances = of_pixels.next().unwrap_or(chances);
        }
        chances
    };
    (0..points.len()).map(of_point).collect()
}

/// A direction to one of the windows.
fn sample_windows(studio: &Studio, chances: &[f64; WINDOWS], [u, v, w]: [f64; 3]) -> Vector {
    let (mut window, mut left) = (0, u * chances.iter().sum::<f64>());
    while window + 1 < WINDOWS && left >= chances[window] {
        left -= chances[window];
        window += 1;
    }
    studio.windows[window].sample(v, w)
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
    fn with_capacity(count: usize) -> Self {
        Self {
            point: Vec::with_capacity(count),
            view: Vec::with_capacity(count),
            light: Vec::with_capacity(count),
            weight: Vec::with_capacity(count),
        }
    }

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

#[inline]
fn add_light(pixel: &mut Pixel, value: &Evaluation, weight: Vector) {
    let [diffuse, incoherent, lobes, sum] = pixel;
    for c in 0..3 {
        let base = [value.diffuse[c] * weight[c], value.incoherent[c] * weight[c]];
        let of_lobes = (value.mirror[c] + value.blur[c]) * weight[c];
        diffuse[c] += base[0];
        incoherent[c] += base[1];
        lobes[c] += of_lobes;
        sum[c] += base[0] + base[1] + of_lobes;
    }
}
