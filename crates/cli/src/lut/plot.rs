//! `lut plot`: the paper's Figs. 6, 7 and 10, and the defect of reciprocity over angles.

mod azimuth;
mod incidences;
mod reciprocity;

use crate::{FileArg, read_lobe};
use kuva::backend::raster::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::render::layout::{AxisLine, Layout, TickFormat};
use kuva::render::render::Scene;
use lut_io::lobe::Interpolant;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use terminal::{Manners, Outcome, Stop};

/// Pixels of the PNG a unit of the SVG: 300 dpi at the SVG's 100 units an inch.
const PNG_SCALE: f32 = 3.0;
/// Colours that readers with any colour vision tell apart (Okabe & Ito 2008).
const BLACK: &str = "#000000";
const BLUE: &str = "#0072b2";
const ORANGE: &str = "#d55e00";

#[derive(clap::Args, Debug)]
#[command(
    after_help = "Writes fig6-incidence-30, fig7-incidences, fig10-azimuth and reciprocity, each as .svg and .png. Bands are
two standard errors each way. `reciprocity` maps |F(a, b) - F(b, a)|, F = f cos a cos b, in the plane of incidence; its numbers
are in reciprocity.json.

Example:
  lut plot pearl.exr -o figures"
)]
pub(crate) struct PlotArgs {
    #[command(flatten)]
    file: FileArg,
    /// Folder for the figures; made if it does not exist.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
}

pub(crate) fn run(args: &PlotArgs, manners: &Manners) -> Outcome {
    let lobe = read_lobe(&args.file.file)?;
    let output = &args.output;
    terminal::make_folder(output)?;
    let theta_i_deg = nearest_known(&lobe, 30.0);
    let map = reciprocity::map(&lobe);
    let figures = [
        (format!("fig6-incidence-{theta_i_deg:.0}"), incidences::one(&lobe, theta_i_deg)),
        ("fig7-incidences".to_owned(), incidences::many(&lobe)),
        ("fig10-azimuth".to_owned(), azimuth::map_and_cuts(&lobe, theta_i_deg)),
        ("reciprocity".to_owned(), reciprocity::scene(&map)),
    ];
    let mut files = Vec::new();
    for (name, scene) in figures {
        files.extend(save(output, &name, &scene)?);
    }
    let numbers = output.join("reciprocity.json");
    reciprocity::write(&map, &numbers)?;
    files.push(numbers);
    nacre_cli::print_files("lut-plot/1", &files, manners)
}

/// The angle asked for if the table covers it, else the nearest that it covers.
fn nearest_known(lobe: &Interpolant, theta_i_deg: f64) -> f64 {
    let per_incidence = &lobe.table().meta().per_incidence;
    theta_i_deg.clamp(per_incidence[0].theta_i_deg, per_incidence[per_incidence.len() - 1].theta_i_deg)
}

fn save(folder: &Path, name: &str, scene: &Scene) -> Result<[PathBuf; 2], Stop> {
    let png = RasterBackend::new().with_scale(PNG_SCALE).render_scene(scene).map_err(Stop::failure)?;
    let svg = SvgBackend.render_scene(scene);
    let paths = [folder.join(format!("{name}.svg")), folder.join(format!("{name}.png"))];
    for (path, bytes) in paths.iter().zip([svg.as_bytes(), &png]) {
        nacre_cli::write_file(path, bytes)?;
    }
    Ok(paths)
}

/// Tick labels with a true minus sign and no more digits than needed.
fn plain() -> TickFormat {
    TickFormat::Custom(Arc::new(|value: f64| {
        // Ticks are sums of steps: 0.30000000000000004 is 0.3.
        let rounded = (value * 1e9).round() / 1e9;
        format!("{}", rounded + 0.0).replace('-', "\u{2212}")
    }))
}

/// What all panels share: a closed frame, no grid, type that stays readable in a column.
fn styled(layout: Layout) -> Layout {
    layout
        .with_axis_line(AxisLine::Box)
        .with_show_grid(false)
        .with_title_size(15)
        .with_label_size(14)
        .with_tick_size(12)
        .with_body_size(12)
        .with_legend_box(false)
        .with_tick_format(plain())
}
