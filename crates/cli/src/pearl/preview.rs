//! `pearl preview`: pictures without a renderer.

mod image;

use crate::args::{PictureName, PreviewArgs};
use image::Picture;
use nacre_cli::preview::{Lighting, Quality, Shape, render};
use rayon::prelude::*;
use std::path::PathBuf;
use terminal::{Manners, Outcome, Stop};

pub(crate) fn run(args: &PreviewArgs, manners: &Manners) -> Outcome {
    let bsdf = args.pearl.bsdf()?;
    let folder = &args.output;
    terminal::make_folder(folder)?;
    let quality = Quality { size: args.size, samples: args.samples, seed: args.seed };
    let names: Vec<PictureName> = args.only.map_or_else(|| PictureName::all().collect(), |only| vec![only]);
    let mut files = Vec::new();
    for shape in Shape::ALL {
        let of_shape: Vec<PictureName> = names.iter().copied().filter(|name| name.shape == shape).collect();
        let lit = |lighting: &Lighting| of_shape.iter().any(|name| name.lighting == *lighting);
        let lightings: Vec<Lighting> = Lighting::ALL.into_iter().filter(lit).collect();
        if lightings.is_empty() {
            continue;
        }
        let rendered = render([&bsdf], shape, &lightings, quality);
        let write = |name: &PictureName| -> Result<PathBuf, Stop> {
            let under = lightings.iter().position(|lighting| *lighting == name.lighting).unwrap_or(0);
            let [rendered] = &rendered[under];
            let path = folder.join(format!("{name}.png"));
            Picture { size: args.size, pixels: rendered.view(name.view) }.write(&path)?;
            Ok(path)
        };
        files.extend(of_shape.par_iter().map(write).collect::<Result<Vec<_>, Stop>>()?);
    }
    nacre_cli::print_files("pearl-preview/1", &files, manners)
}
