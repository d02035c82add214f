//! `thinfilm colour` and `thinfilm swatch`: colours of a recipe's stack, as numbers and as a picture.

use bake_brdf::recipe::Recipe;
use clap::Args;
use kuva::backend::raster::RasterBackend;
use kuva::render::render::{Primitive, Scene, TextAnchor};
use rayon::prelude::*;
use serde_json::json;
use std::path::{Path, PathBuf};
use terminal::{Outcome, Stop};
use thinfilm::Stack;
use thinfilm::colour::{self, StackColour};

/// Most angles, thicknesses or members of an ensemble.
const MOST: usize = 4096;

/// What both commands ask.
#[derive(Args, Debug)]
pub(crate) struct ColourArgs {
    /// Recipe (JSON).
    pub(crate) recipe: PathBuf,
    /// Angles of incidence in degrees, separated by commas.
    #[arg(long, value_name = "LIST", value_delimiter = ',', default_value = "0,15,30,45,60")]
    angles_deg: Vec<f64>,
    /// Largest colour difference (CIEDE2000) that more wavelengths may still make.
    #[arg(long, value_name = "DELTA_E", default_value_t = colour::DEFAULT_ACCURACY)]
    accuracy: f64,
    /// Stacks drawn where the recipe's thicknesses are irregular.
    #[arg(long, value_name = "N", default_value_t = 16)]
    members: usize,
    /// Seed of the drawn stacks.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl ColourArgs {
    fn check(&self) -> Result<Vec<f64>, Stop> {
        if let Some(angle) = self.angles_deg.iter().find(|angle| !(0.0..=90.0).contains(*angle)) {
            return Err(Stop::BadInput(format!(
                "--angles-deg: {angle} is not an angle of incidence; expected 0 to 90"
            )));
        }
        if !(1..=MOST).contains(&self.angles_deg.len()) {
            return Err(Stop::BadInput(format!("--angles-deg: expected 1 to {MOST} angles")));
        }
        if !(1..=MOST).contains(&self.members) {
            return Err(Stop::BadInput(format!("--members: {} is not from 1 to {MOST}", self.members)));
        }
        if !(self.accuracy >= 1e-3 && self.accuracy.is_finite()) {
            return Err(Stop::BadInput(format!(
                "--accuracy: {} is not a colour difference; expected 0.001 or more",
                self.accuracy
            )));
        }
        Ok(self.angles_deg.iter().map(|angle| angle.to_radians()).collect())
    }

    fn colours(&self, stack: &Stack, angles: &[f64]) -> Result<Vec<StackColour>, Stop> {
        colour::of_stack(stack, self.seed, self.members as u64, angles, self.accuracy)
            .map_err(|why| Stop::BadInput(format!("{}: {why}", self.recipe.display())))
    }
}

/// Colours as JSON or CSV.
pub(crate) fn colours(recipe: &Recipe, args: &ColourArgs, as_json: bool) -> Outcome {
    let angles = args.check()?;
    let colours = args.colours(&recipe.film_stack(), &angles)?;
    if as_json {
        let list: Vec<_> = args
            .angles_deg
            .iter()
            .zip(&colours)
            .map(|(angle, c)| {
                json!({
                    "angle_deg": angle, "xyz": c.xyz, "linear_srgb": c.linear_srgb, "lab": c.lab,
                    "wavelengths": c.wavelengths, "delta_e_of_last_doubling": c.change,
                })
            })
            .collect();
        return terminal::print_json(&json!({
            "schema": "thinfilm-colour/1", "recipe": recipe.name, "observer": "CIE 1931 2 deg", "illuminant": "D65",
            "members": args.members, "seed": args.seed, "accuracy": args.accuracy, "colours": list,
        }));
    }
    let mut text = "angle_deg,X,Y,Z,R,G,B,wavelengths\n".to_owned();
    for (angle, c) in args.angles_deg.iter().zip(&colours) {
        let ([x, y, z], [r, g, b]) = (c.xyz, c.linear_srgb);
        text.push_str(&format!("{angle},{x},{y},{z},{r},{g},{b},{}\n", c.wavelengths));
    }
    terminal::print(&text)
}

/// Share of the recipe's thicknesses in the swatch's columns.
const THICKNESS_SHARES: [f64; 13] =
    [0.70, 0.75, 0.80, 0.85, 0.90, 0.95, 1.0, 1.05, 1.10, 1.15, 1.20, 1.25, 1.30];
const CELL: f64 = 56.0;
const MARGIN: [f64; 2] = [110.0, 70.0];

/// Colour against angle (rows) and thickness (columns), drawn to a PNG.
pub(crate) fn swatch(recipe: &Recipe, args: &ColourArgs, output: &Path) -> Outcome {
    let angles = args.check()?;
    let stack = recipe.film_stack();
    let columns: Vec<Vec<StackColour>> = THICKNESS_SHARES
        .par_iter()
        .map(|&share| args.colours(&thickened(&stack, share), &angles))
        .collect::<Result<_, _>>()?;
    let brightest = columns.iter().flatten().flat_map(|c| c.linear_srgb).fold(0.0, f64::max);
    // One exposure for the whole picture: a stack reflects a part of the light only.
    let exposure = if brightest > 0.0 { 1.0 / brightest } else { 1.0 };
    let scene = draw(recipe, args, &columns, exposure);
    let png = RasterBackend::new().with_scale(2.0).render_scene(&scene).map_err(Stop::failure)?;
    lut_io::atomic::write(output, &png)
        .map_err(|why| Stop::failure(format!("{}: cannot write the file: {why}", output.display())))
}

fn thickened(stack: &Stack, share: f64) -> Stack {
    let mut stack = stack.clone();
    for layer in stack.runs.iter_mut().flat_map(|run| &mut run.unit) {
        layer.thickness *= share;
        layer.thickness_sd *= share;
    }
    stack
}

fn draw(recipe: &Recipe, args: &ColourArgs, columns: &[Vec<StackColour>], exposure: f64) -> Scene {
    let [left, top] = MARGIN;
    let (across, down) = (columns.len() as f64 * CELL, args.angles_deg.len() as f64 * CELL);
    let mut scene = Scene::new(left + across + 30.0, top + down + 70.0);
    let text = |x: f64, y: f64, content: String, size: u32, anchor: TextAnchor| Primitive::Text {
        x,
        y,
        content,
        size,
        anchor,
        rotate: None,
        bold: false,
        color: None,
    };
    let title = format!("{}: reflected colour, D65, exposure x{exposure:.2}", recipe.name);
    scene.elements.push(text(left, 34.0, title, 16, TextAnchor::Start));
    for (column, (share, colours)) in THICKNESS_SHARES.iter().zip(columns).enumerate() {
        let x = left + column as f64 * CELL;
        for (row, colour) in colours.iter().enumerate() {
            let [r, g, b] = colour::srgb_bytes(colour.linear_srgb.map(|c| c * exposure));
            scene.elements.push(Primitive::Rect {
                x,
                y: top + row as f64 * CELL,
                width: CELL,
                height: CELL,
                fill: format!("#{r:02x}{g:02x}{b:02x}").as_str().into(),
                stroke: None,
                stroke_width: None,
                opacity: None,
            });
        }
        let label = format!("{:.0} %", share * 100.0);
        scene.elements.push(text(x + CELL / 2.0, top + down + 20.0, label, 12, TextAnchor::Middle));
    }
    for (row, angle) in args.angles_deg.iter().enumerate() {
        let y = top + (row as f64 + 0.5) * CELL + 4.0;
        scene.elements.push(text(left - 10.0, y, format!("{angle} deg"), 12, TextAnchor::End));
    }
    let below = top + down + 46.0;
    scene.elements.push(text(
        left + across / 2.0,
        below,
        "layer thickness / recipe's".to_owned(),
        14,
        TextAnchor::Middle,
    ));
    scene.elements.push(text(
        left - 10.0,
        top - 14.0,
        "angle of incidence".to_owned(),
        12,
        TextAnchor::Middle,
    ));
    scene
}
