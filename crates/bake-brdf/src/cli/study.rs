//! `bake-brdf study`: runs the study, writes `study.json`, `study.csv`, `study.svg`, `study.png`.

use super::{args, errors};
use bake_brdf::options::Options;
use bake_brdf::recipe::AzimuthMode;
use bake_brdf::study::{self, Contender, Point, Study};
use kuva::backend::raster::RasterBackend;
use kuva::backend::svg::SvgBackend;
use kuva::plot::{LegendPosition, LinePlot, ScatterPlot};
use kuva::render::layout::{AxisLine, Layout};
use kuva::render::plots::Plot;
use kuva::render::render::{Scene, render_multiple};
use std::fmt::Write as _;
use std::path::PathBuf;
use terminal::Manners;
use terminal::{Outcome, Stop};

#[derive(clap::Args, Clone, Debug)]
pub(crate) struct StudyArgs {
    /// Recipe: a file (JSON, - for stdin) or the name of a built-in one, such as akoya [default: the paper's pearl].
    recipe: Option<PathBuf>,
    /// Folder for study.json, study.csv, study.svg and study.png; made if it does not exist.
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Angles of incidence in degrees: numbers and FROM:TO:STEP [default: 0:90:1].
    #[arg(long, value_name = "LIST")]
    incident_deg: Option<String>,
}

pub(crate) fn run(study: &StudyArgs, manners: &Manners) -> Outcome {
    let (recipe, _) = args::recipe(study.recipe.as_deref())?;
    let incident_deg = study.incident_deg.as_deref().map(args::incident_deg).transpose()?;
    let options = Options { incident_deg, ..Options::default() };
    let folder = &study.output;
    terminal::make_folder(folder)?;
    let pool = manners.pool()?;
    let say = |line: &str| {
        if !manners.quiet {
            super::say(line);
        }
    };
    let study = pool.install(|| study::run(&recipe, &options, &say)).map_err(errors::refuse)?;
    let scene = figure(&study);
    let png = RasterBackend::new().with_scale(2.5).render_scene(&scene).map_err(Stop::failure)?;
    let json = serde_json::to_value(&study).map_err(Stop::failure)?;
    for (name, bytes) in [
        ("study.json", format!("{json:#}\n").into_bytes()),
        ("study.csv", csv(&study).into_bytes()),
        ("study.svg", SvgBackend.render_scene(&scene).into_bytes()),
        ("study.png", png),
    ] {
        let path = folder.join(name);
        lut_io::atomic::write(&path, &bytes)
            .map_err(|why| Stop::failure(format!("{}: {why}", path.display())))?;
    }
    if manners.json { terminal::print_json(&json) } else { terminal::print(&summary(&study)) }
}

fn csv(study: &Study) -> String {
    let mut text =
        "solver,azimuth,paths,nodes,modes,seconds,worst_total_variation,mean_total_variation,bytes\n"
            .to_owned();
    for p in &study.points {
        let _ = writeln!(
            text,
            "{},{},{},{},{},{:.6},{:.6e},{:.6e},{:.0}",
            name(p.contender),
            mode(p.azimuth),
            p.paths,
            p.nodes,
            p.modes,
            p.seconds,
            p.worst_error,
            p.mean_error,
            p.bytes
        );
    }
    text
}

const fn name(contender: Contender) -> &'static str {
    match contender {
        Contender::WalkF32 => "walk f32",
        Contender::WalkF64 => "walk f64",
        Contender::Doubling => "doubling",
    }
}

const fn mode(azimuth: AzimuthMode) -> &'static str {
    match azimuth {
        AzimuthMode::Decay => "plane",
        AzimuthMode::Space => "space",
    }
}

fn summary(study: &Study) -> String {
    let mut text = format!(
        "{} incidences, {} threads; error = mean total variation, share of the reflected light\n\n",
        study.incident_deg.len(),
        study.threads
    );
    text.push_str("solver    geometry  setting                 seconds      error      worst     MB\n");
    for p in &study.points {
        let setting = match p.contender {
            Contender::Doubling => format!("{} nodes, {} modes", p.nodes, p.modes),
            _ => format!("{} paths", p.paths),
        };
        let _ = writeln!(
            text,
            "{:<9} {:<9} {:<22} {:>8.3}   {:>8.2e}   {:>8.2e}  {:>5.1}",
            name(p.contender),
            mode(p.azimuth),
            setting,
            p.seconds,
            p.mean_error,
            p.worst_error,
            p.bytes / 1e6
        );
    }
    text.push('\n');
    for s in &study.slopes {
        let even = match s.break_even_error {
            Some(error) => format!("doubling is faster below an error of {:.2} %", 100.0 * error),
            None => "doubling is not faster at any error tried".to_owned(),
        };
        let _ = writeln!(
            text,
            "{} {}: error ∝ seconds^{:.3}; {even}",
            name(s.contender),
            mode(s.azimuth),
            s.slope
        );
    }
    text.push_str("\neffect            ns a crossing without → with    ratio\n");
    for e in &study.effects {
        let _ = writeln!(text, "{:<17} {:.3} → {:.3}    {:.2}", e.effect, e.base_ns, e.with_ns, e.ratio);
    }
    text
}

/// Seconds up to which the walks' fitted lines are drawn: about a quarter of an hour.
const LINES_END: f64 = 1000.0;

/// Error against time, both axes logarithmic: measurements as points, the walks' fitted power laws as dashed lines.
fn figure(study: &Study) -> Scene {
    let styles = [
        (Contender::WalkF32, AzimuthMode::Decay, "#0072b2", "walk, plane"),
        (Contender::WalkF64, AzimuthMode::Decay, "#7f7f7f", "walk, plane, 64 bits"),
        (Contender::WalkF32, AzimuthMode::Space, "#56b4e9", "walk, space"),
        (Contender::WalkF64, AzimuthMode::Space, "#b3b3b3", "walk, space, 64 bits"),
        (Contender::Doubling, AzimuthMode::Decay, "#d55e00", "doubling, plane"),
        (Contender::Doubling, AzimuthMode::Space, "#e69f00", "doubling, space"),
    ];
    let mut plots: Vec<Plot> = Vec::new();
    for (contender, azimuth, colour, label) in styles {
        let points: Vec<(f64, f64)> = study
            .points
            .iter()
            .filter(|p: &&Point| p.contender == contender && p.azimuth == azimuth)
            .map(|p| (p.seconds, p.mean_error))
            .collect();
        let fitted = study.slopes.iter().find(|s| s.contender == contender && s.azimuth == azimuth);
        let line = match (fitted, points.first()) {
            (Some(fit), Some(&(start, _))) => {
                let at = |seconds: f64| (seconds, fit.error_at_one_second * seconds.powf(fit.slope));
                let label = format!("{label} (slope {:.2})", fit.slope);
                LinePlot::new().with_data([at(start), at(LINES_END)]).with_dashed().with_legend(label)
            }
            _ => LinePlot::new().with_data(points.clone()).with_legend(label),
        };
        plots.push(line.with_color(colour).with_stroke_width(2.0).into());
        plots.push(ScatterPlot::new().with_data(points).with_color(colour).with_size(4.0).into());
    }
    let layout = Layout::auto_from_plots(&plots)
        .with_log_scale()
        .with_axis_line(AxisLine::Box)
        .with_x_label(format!(
            "seconds for {} incidences, {} threads",
            study.incident_deg.len(),
            study.threads
        ))
        .with_y_label("total variation, mean over incidences")
        .with_title("What accuracy costs in time")
        .with_legend_position(LegendPosition::OutsideRightTop)
        .with_legend_box(false)
        .with_title_size(15)
        .with_label_size(14)
        .with_tick_size(12)
        .with_body_size(12)
        .with_width(800.0)
        .with_height(460.0);
    render_multiple(plots, layout)
}
