//! `thinfilm swatch`: colours of a recipe's stack against angle and thickness, as a labelled picture.

use clap::Args;
use kuva::backend::raster::RasterBackend;
use kuva::render::render::{Primitive, Scene, TextAnchor};
use serde_json::{Value, json};
use std::path::PathBuf;
use terminal::{Outcome, Stop};
use thinfilm::Stack;
use thinfilm::colour::{StackColour, srgb_bytes};

use crate::colour::{self, Precision};
use crate::input;

/// Arguments of `thinfilm swatch`.
#[derive(Args, Debug)]
pub(crate) struct SwatchArgs {
    /// Recipe: a file (JSON, - for stdin) or the name of a built-in one, such as akoya.
    recipe: PathBuf,
    /// PNG to write.
    #[arg(short, long, value_name = "PNG")]
    output: PathBuf,
    /// Angles of incidence in degrees: numbers and FROM:TO:STEP, separated by commas; one row each.
    #[arg(long, value_name = "LIST", default_value = "0:80:10")]
    angles_deg: String,
    /// Columns: all thicknesses of the recipe at A to B per cent, N samples.
    #[arg(long, value_name = "A:B:N", default_value = "70:130:21")]
    thickness_percent: String,
    #[command(flatten)]
    precision: Precision,
}

/// Most cells: a picture of more is neither drawn nor read.
const MOST_CELLS: usize = 10_000;

/// Draws the swatch to a PNG.
pub(crate) fn swatch(args: &SwatchArgs, as_json: bool, quiet: bool) -> Outcome {
    let recipe = nacre_cli::read_recipe(&args.recipe)?;
    let angles_deg = input::angles_deg(&args.angles_deg)?;
    let percents = input::samples("--thickness-percent", "per cent", &args.thickness_percent)?;
    args.precision.check()?;
    if angles_deg.len() * percents.len() > MOST_CELLS {
        return Err(Stop::BadInput(format!(
            "--thickness-percent: {} columns of {} angles are too many cells; expected at most {MOST_CELLS}",
            percents.len(),
            angles_deg.len()
        )));
    }
    nacre_cli::check_output("recipe", &args.recipe, &args.output)?;
    let stack = recipe.film_stack();
    let columns: Vec<Vec<StackColour>> = percents
        .iter()
        .map(|percent| args.precision.colours(&thickened(&stack, percent / 100.0), &angles_deg))
        .collect::<Result<_, _>>()
        .map_err(|why| Stop::BadInput(format!("{}: {why}", args.recipe.display())))?;
    if let Some(warning) = args.precision.warning(columns.iter().flatten()).filter(|_| !quiet) {
        crate::note(&warning);
    }
    let swatch =
        Swatch { name: &recipe.name, angles_deg: &angles_deg, percents: &percents, columns: &columns };
    let png = RasterBackend::new().with_scale(2.0).render_scene(&swatch.draw()).map_err(Stop::failure)?;
    nacre_cli::write_file(&args.output, &png)?;
    if !as_json {
        return Ok(());
    }
    let column = |(percent, colours): (&f64, &Vec<StackColour>)| {
        let cells = angles_deg.iter().zip(colours);
        let cells: Vec<Value> = cells.map(|(angle, c)| colour::entry(*angle, c, &args.precision)).collect();
        json!({ "thickness_percent": percent, "colours": cells })
    };
    terminal::print_json(&json!({
        "schema": "thinfilm-swatch/1", "output": args.output.display().to_string(), "exposure": swatch.exposure(),
        "columns": percents.iter().zip(&columns).map(column).collect::<Vec<_>>(),
    }))
}

fn thickened(stack: &Stack, share: f64) -> Stack {
    let mut stack = stack.clone();
    for layer in stack.runs.iter_mut().flat_map(|run| &mut run.unit) {
        layer.thickness *= share;
        layer.thickness_sd *= share;
    }
    stack
}

/// The picture's data.
struct Swatch<'a> {
    name: &'a str,
    angles_deg: &'a [f64],
    percents: &'a [f64],
    /// Colours by column, then row.
    columns: &'a [Vec<StackColour>],
}

/// Layout, in units of half a pixel.
const CELL: [f64; 2] = [36.0, 40.0];
const MARGIN: [f64; 2] = [96.0, 64.0];
const BELOW: f64 = 64.0;
/// No narrower than the title.
const NARROWEST: f64 = 560.0;

impl Swatch<'_> {
    fn draw(&self) -> Scene {
        let [left, top] = MARGIN;
        let (across, down) = (self.percents.len() as f64 * CELL[0], self.angles_deg.len() as f64 * CELL[1]);
        let mut scene = Scene::new((left + across + 30.0).max(NARROWEST), top + down + BELOW);
        let exposure = self.exposure();
        let name = if self.name.is_empty() { "stack" } else { self.name };
        let title = format!("{name}: colour reflected under D65, exposure x{exposure:.2}");
        scene.elements.push(text(left, 28.0, title, 16, TextAnchor::Start));
        scene.elements.push(text(
            left,
            50.0,
            "angle of incidence down, thickness across".to_owned(),
            12,
            TextAnchor::Start,
        ));
        // As many labels as fit beside each other.
        let labelled = self.percents.len().div_ceil((across / 52.0).max(1.0) as usize);
        for (column, (percent, colours)) in self.percents.iter().zip(self.columns).enumerate() {
            let x = left + column as f64 * CELL[0];
            for (row, colour) in colours.iter().enumerate() {
                scene.elements.push(cell(
                    x,
                    top + row as f64 * CELL[1],
                    colour.linear_srgb.map(|c| c * exposure),
                ));
            }
            if column % labelled == 0 {
                let label = format!("{percent:.0} %");
                scene.elements.push(text(
                    x + CELL[0] / 2.0,
                    top + down + 20.0,
                    label,
                    12,
                    TextAnchor::Middle,
                ));
            }
        }
        for (row, angle) in self.angles_deg.iter().enumerate() {
            let y = top + (row as f64 + 0.5) * CELL[1] + 4.0;
            scene.elements.push(text(left - 10.0, y, format!("{angle}\u{b0}"), 12, TextAnchor::End));
        }
        let axis = "thickness of every layer, share of the recipe's".to_owned();
        scene.elements.push(text(left + across / 2.0, top + down + 46.0, axis, 13, TextAnchor::Middle));
        scene
    }

    /// One exposure for the whole picture: a stack reflects a part of the light only.
    fn exposure(&self) -> f64 {
        let brightest = self.columns.iter().flatten().flat_map(|c| c.linear_srgb).fold(0.0, f64::max);
        if brightest > 0.0 { 1.0 / brightest } else { 1.0 }
    }
}

fn cell(x: f64, y: f64, linear: [f64; 3]) -> Primitive {
    let [r, g, b] = srgb_bytes(linear);
    Primitive::Rect {
        x,
        y,
        width: CELL[0],
        height: CELL[1],
        fill: format!("#{r:02x}{g:02x}{b:02x}").as_str().into(),
        stroke: None,
        stroke_width: None,
        opacity: None,
    }
}

fn text(x: f64, y: f64, content: String, size: u32, anchor: TextAnchor) -> Primitive {
    Primitive::Text { x, y, content, size, anchor, rotate: None, bold: false, color: None }
}
