//! `pearl preview`: pictures without a renderer.

mod image;
mod light;
mod scene;
mod vector;

use crate::args::PreviewArgs;
use image::Picture;
use light::{Lighting, Studio};
use pearl_bsdf::PearlBsdf;
use rayon::prelude::*;
use scene::{Shape, Surface};
use serde_json::json;
use terminal::Manners;
use terminal::{Outcome, Stop};

/// What a picture shows: the paper's Fig. 4.
const VIEWS: [&str; 4] = ["diffuse", "incoherent", "lobes", "sum"];

/// Linear radiance of every view at one pixel.
type Pixel = [[f64; 3]; VIEWS.len()];

pub(crate) fn run(args: &PreviewArgs, manners: &Manners) -> Outcome {
    let bsdf = args.pearl.bsdf()?;
    let folder = &args.output;
    std::fs::create_dir_all(folder)
        .map_err(|error| Stop::failure(format!("{}: {error}", folder.display())))?;
    let mut files = Vec::new();
    for shape in [Shape::Sphere, Shape::Swatch] {
        for lighting in [Lighting::Distant, Lighting::Sky] {
            let pixels = render(&bsdf, shape, lighting, args);
            for (view, name) in VIEWS.iter().enumerate() {
                let path = folder.join(format!("{}-{}-{name}.png", shape.name(), lighting.name()));
                let picture = Picture { size: args.size, pixels: pixels.iter().map(|p| p[view]).collect() };
                picture.write(&path)?;
                files.push(path.display().to_string());
            }
        }
    }
    if manners.json {
        return terminal::print_json(&json!({ "schema": "pearl-preview/1", "files": files }));
    }
    if manners.quiet {
        return Ok(());
    }
    terminal::print(&(files.join("\n") + "\n"))
}

/// Every pixel is a function of its coordinates and the seed: the same on any number of threads.
fn render(bsdf: &PearlBsdf, shape: Shape, lighting: Lighting, args: &PreviewArgs) -> Vec<Pixel> {
    let studio = Studio::new(shape);
    // Few rays from the camera smooth the edges; a distant light then needs hardly any samples.
    let rays = args.samples.min(8);
    let samples = match lighting {
        Lighting::Distant => 2,
        Lighting::Sky => args.samples.div_ceil(rays),
    };
    let size = args.size;
    (0..size * size)
        .into_par_iter()
        .with_min_len(64)
        .map(|index| {
            let (x, y) = (index % size, index / size);
            let mut sum = Pixel::default();
            for n in 0..rays {
                let random = light::Sequence::new(args.seed, index, n);
                let at = |pixel: u32, jitter: f64| 2.0 * (f64::from(pixel) + jitter) / f64::from(size) - 1.0;
                let ray = shape.camera().ray(at(x, random.at(0)), -at(y, random.at(1)));
                let surface = shape.hit(ray);
                for k in 0..samples {
                    let random = light::Sequence::new(args.seed, index, n * samples + k);
                    let radiance = match &surface {
                        Surface::Pearl(hit) => light::reflected(bsdf, &studio, lighting, shape, hit, &random),
                        Surface::Ground(point) => {
                            let radiance = scene::ground(&studio, lighting, ray, *point, &random);
                            [radiance; VIEWS.len()]
                        }
                    };
                    for (sum, radiance) in sum.iter_mut().zip(radiance) {
                        *sum = vector::add(*sum, image::without_fireflies(radiance));
                    }
                }
            }
            sum.map(|rgb| rgb.map(|c| c / f64::from(rays * samples)))
        })
        .collect()
}
