//! A sphere and a free-form swatch under a distant light and a sky.

mod light;
mod numbers;
mod scene;
pub mod tone;
mod vector;

pub use light::Lighting;
pub use scene::Shape;

use light::{Studio, White};
use numbers::{Choice, Numbers, Sobol};
use pearl_bsdf::PearlBsdf;
use rayon::prelude::*;
use scene::Surface;

/// What a picture shows: the paper's Fig. 4.
pub const VIEWS: [&str; 4] = ["diffuse", "incoherent", "lobes", "sum"];
/// The last of [`VIEWS`].
pub const SUM: usize = VIEWS.len() - 1;

/// Linear sRGB radiance of every view at one pixel.
pub type Pixel = [[f64; 3]; VIEWS.len()];

/// How finely a picture is drawn.
#[derive(Clone, Copy, Debug)]
pub struct Quality {
    /// Width and height, pixels.
    pub size: u32,
    /// Samples a pixel under the sky.
    pub samples: u32,
    /// Seed of the noise.
    pub seed: u64,
}

impl Quality {
    /// Rays from the camera a pixel: few smooth the edges, and a distant light then needs no more samples.
    fn rays(self) -> u32 {
        self.samples.min(MOST_RAYS)
    }
}

/// A square picture, row by row from the top.
#[derive(Clone, Debug)]
pub struct Rendered {
    /// Every view of every pixel.
    pub pixels: Vec<Pixel>,
    /// Whether some of the pixel shows the pearl.
    pub pearl: Vec<bool>,
}

impl Rendered {
    /// One view of all pixels.
    #[must_use]
    pub fn view(&self, view: usize) -> Vec<[f64; 3]> {
        self.pixels.iter().map(|pixel| pixel[view]).collect()
    }
}

/// Draws BSDFs beside each other, under each of some lights: a picture by light, then by BSDF.
///
/// Every pixel is a function of its coordinates and the seed: the same on any number of threads. All see the same light from the
/// same directions, which the first samples, so that the difference of their pictures has hardly any noise.
#[must_use]
pub fn render<const N: usize>(
    bsdfs: [&PearlBsdf; N],
    shape: Shape,
    lightings: &[Lighting],
    quality: Quality,
) -> Vec<[Rendered; N]> {
    let studio = Studio::new(shape);
    let whites = bsdfs.map(White::of);
    let bsdfs: [_; N] = std::array::from_fn(|n| (bsdfs[n], &whites[n]));
    let sobol = Sobol::new(quality.samples.next_multiple_of(quality.rays()));
    let size = quality.size;
    let tiles: Vec<Vec<[Tile; N]>> = (0..size * size)
        .step_by(TILE)
        .collect::<Vec<_>>()
        .into_par_iter()
        .map(|first| {
            let rays = rays(shape, quality, &sobol, first..(first + TILE as u32).min(size * size));
            let tile = |lighting: &Lighting| tile(bsdfs, &studio, *lighting, quality, &sobol, &rays);
            lightings.iter().map(tile).collect()
        })
        .collect();
    let whole = |light: usize, n: usize| Rendered {
        pixels: tiles.iter().flat_map(|tile| &tile[light][n].pixels).copied().collect(),
        pearl: tiles.iter().flat_map(|tile| &tile[light][n].pearl).copied().collect(),
    };
    (0..lightings.len()).map(|light| std::array::from_fn(|n| whole(light, n))).collect()
}

/// Pixels that are drawn together: many pairs of directions at a call cost less than half.
const TILE: usize = 32;
const MOST_RAYS: u32 = 8;

/// Part of a [`Rendered`].
type Tile = Rendered;

/// A ray from the camera and what it meets.
struct Seen {
    pixel: u32,
    numbers: Numbers,
    /// Which of the pixel's.
    number: u32,
    ray: scene::Ray,
    surface: Surface,
}

fn rays(shape: Shape, quality: Quality, sobol: &Sobol, pixels: std::ops::Range<u32>) -> Vec<Seen> {
    let (camera, size, rays) = (shape.camera(), quality.size, quality.rays());
    let at = |pixel: u32, jitter: f64| 2.0 * (f64::from(pixel) + jitter) / f64::from(size) - 1.0;
    let seen = |pixel: u32, number: u32| {
        let numbers = Numbers::new(quality.seed, pixel);
        let [x, y, _] = numbers.at(sobol, Choice::Film, number);
        let ray = camera.ray(at(pixel % size, x), -at(pixel / size, y));
        Seen { pixel, numbers, number, ray, surface: shape.hit(ray) }
    };
    pixels.flat_map(|pixel| (0..rays).map(move |number| (pixel, number))).map(|(p, n)| seen(p, n)).collect()
}

/// A tile under one light.
fn tile<const N: usize>(
    bsdfs: [(&PearlBsdf, &White); N],
    studio: &Studio,
    lighting: Lighting,
    quality: Quality,
    sobol: &Sobol,
    rays: &[Seen],
) -> [Tile; N] {
    let rays_of_pixel = quality.rays();
    let samples = match lighting {
        Lighting::Distant => 1,
        Lighting::Sky => quality.samples.div_ceil(rays_of_pixel),
    };
    let numbers =
        |seen: &Seen, choice: Choice, k: u32| seen.numbers.at(sobol, choice, seen.number * samples + k);
    let (on_pearl, points): (Vec<&Seen>, Vec<light::Lit<'_>>) = rays
        .iter()
        .filter_map(|seen| match &seen.surface {
            Surface::Pearl(hit) => Some((seen, light::Lit { hit, pixel: seen.pixel })),
            Surface::Ground(_) => None,
        })
        .unzip();
    let reflected = match lighting {
        Lighting::Distant => light::under_distant_light(bsdfs, studio, &points),
        Lighting::Sky => {
            let numbers = |point: usize, choice, k| numbers(on_pearl[point], choice, k);
            light::under_sky(bsdfs.map(|(bsdf, _)| bsdf), studio, &points, samples, numbers)
        }
    };
    reflected.map(|reflected| {
        let mut reflected = reflected.into_iter();
        let mut tile = Tile { pixels: Vec::new(), pearl: Vec::new() };
        for pixel in rays.chunks(rays_of_pixel as usize) {
            let mut sum = Pixel::default();
            for seen in pixel {
                let radiance = match &seen.surface {
                    Surface::Pearl(_) => reflected.next().unwrap_or_default(),
                    Surface::Ground(point) => {
                        let numbers = |k| numbers(seen, Choice::Light, k);
                        [light::ground(studio, lighting, seen.ray, *point, samples, numbers); VIEWS.len()]
                    }
                };
                for (sum, radiance) in sum.iter_mut().zip(radiance) {
                    *sum = vector::add(*sum, tone::without_fireflies(radiance));
                }
            }
            tile.pixels.push(sum.map(|rgb| rgb.map(|c| c / f64::from(rays_of_pixel))));
            tile.pearl.push(pixel.iter().any(|seen| matches!(seen.surface, Surface::Pearl(_))));
        }
        tile
    })
}
