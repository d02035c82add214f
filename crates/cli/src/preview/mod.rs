//! A sphere and a free-form swatch under a distant light and a sky.

mod light;
mod scene;
pub mod tone;
mod vector;

pub use light::Lighting;
pub use scene::Shape;

use light::Studio;
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

/// Draws a BSDF.
///
/// Every pixel is a function of its coordinates and the seed: the same on any number of threads. Directions are sampled
/// by `sampler`: two BSDFs drawn with one sampler see the same light from the same directions, and the difference of
/// their pictures has hardly any noise.
#[must_use]
pub fn render(
    bsdf: &PearlBsdf,
    sampler: &PearlBsdf,
    shape: Shape,
    lighting: Lighting,
    quality: Quality,
) -> Rendered {
    let studio = Studio::new(shape);
    // Few rays from the camera smooth the edges; a distant light then needs hardly any samples.
    let rays = quality.samples.min(8);
    let samples = match lighting {
        Lighting::Distant => 2,
        Lighting::Sky => quality.samples.div_ceil(rays),
    };
    let size = quality.size;
    let (pixels, pearl) = (0..size * size)
        .into_par_iter()
        .with_min_len(64)
        .map(|index| {
            let (x, y) = (index % size, index / size);
            let (mut sum, mut pearl) = (Pixel::default(), false);
            for n in 0..rays {
                let random = light::Sequence::new(quality.seed, index, n);
                let at = |pixel: u32, jitter: f64| 2.0 * (f64::from(pixel) + jitter) / f64::from(size) - 1.0;
                let ray = shape.camera().ray(at(x, random.at(0)), -at(y, random.at(1)));
                let surface = shape.hit(ray);
                pearl |= matches!(surface, Surface::Pearl(_));
                for k in 0..samples {
                    let random = light::Sequence::new(quality.seed, index, n * samples + k);
                    let radiance = match &surface {
                        Surface::Pearl(hit) => {
                            light::reflected(bsdf, sampler, &studio, lighting, shape, hit, &random)
                        }
                        Surface::Ground(point) => {
                            let radiance = light::ground(&studio, lighting, ray, *point, &random);
                            [radiance; VIEWS.len()]
                        }
                    };
                    for (sum, radiance) in sum.iter_mut().zip(radiance) {
                        *sum = vector::add(*sum, tone::without_fireflies(radiance));
                    }
                }
            }
            (sum.map(|rgb| rgb.map(|c| c / f64::from(rays * samples))), pearl)
        })
        .unzip();
    Rendered { pixels, pearl }
}
