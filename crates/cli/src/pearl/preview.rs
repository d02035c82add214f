//! `pearl preview`: pictures without a renderer.

mod image;

use crate::args::PreviewArgs;
use image::Picture;
use nacre_cli::preview::{Lighting, Quality, Shape, VIEWS, render};
use terminal::{Manners, Outcome, Stop};

pub(crate) fn run(args: &PreviewArgs, manners: &Manners) -> Outcome {
    let bsdf = args.pearl.bsdf()?;
    let folder = &args.output;
    std::fs::create_dir_all(folder)
        .map_err(|error| Stop::failure(format!("{}: {error}", folder.display())))?;
    let quality = Quality { size: args.size, samples: args.samples, seed: args.seed };
    let mut files = Vec::new();
    for shape in [Shape::Sphere, Shape::Swatch] {
        let rendered = render([&bsdf], shape, &Lighting::ALL, quality);
        for (lighting, [rendered]) in Lighting::ALL.into_iter().zip(rendered) {
            for (view, name) in VIEWS.iter().enumerate() {
                let path = folder.join(format!("{}-{}-{name}.png", shape.name(), lighting.name()));
                let picture = Picture { size: args.size, pixels: rendered.view(view) };
                picture.write(&path)?;
                files.push(path);
            }
        }
    }
    nacre_cli::print_files("pearl-preview/1", &files, manners)
}
