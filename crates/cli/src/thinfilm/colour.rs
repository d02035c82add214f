//! `thinfilm colour`: colours of a recipe's stack as numbers.

use clap::Args;
use serde_json::{Value, json};
use std::path::PathBuf;
use terminal::{Outcome, Stop};
use thinfilm::Stack;
use thinfilm::colour::{self, StackColour};

use crate::input;

/// Arguments of `thinfilm colour`.
#[derive(Args, Debug)]
pub(crate) struct ColourArgs {
    /// Recipe: a file (JSON, - for stdin) or the name of a built-in one, such as akoya.
    recipe: PathBuf,
    /// Angles of incidence in degrees: numbers and FROM:TO:STEP, separated by commas.
    #[arg(long, value_name = "LIST", default_value = "0:60:15")]
    angles_deg: String,
    #[command(flatten)]
    precision: Precision,
}

/// How well the colours are known.
#[derive(Args, Debug)]
pub(crate) struct Precision {
    /// Largest colour difference (CIEDE2000) that more wavelengths may still make; their number follows from it.
    #[arg(long, value_name = "DELTA_E", default_value_t = colour::DEFAULT_ACCURACY)]
    accuracy: f64,
    /// Stacks drawn and averaged where the recipe's thicknesses are irregular.
    #[arg(long, value_name = "N", default_value_t = colour::DEFAULT_MEMBERS)]
    members: u64,
    /// Seed of the drawn stacks.
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

impl Precision {
    pub(crate) fn check(&self) -> Outcome {
        input::members(self.members)?;
        if self.accuracy >= 1e-6 && self.accuracy <= 100.0 {
            return Ok(());
        }
        Err(Stop::BadInput(format!(
            "--accuracy: {} is not a colour difference; expected 1e-6 to 100 (CIEDE2000)",
            self.accuracy
        )))
    }

    /// Colours at angles in degrees.
    pub(crate) fn colours(
        &self,
        stack: &Stack,
        angles_deg: &[f64],
    ) -> Result<Vec<StackColour>, thinfilm::StackError> {
        let angles: Vec<f64> = angles_deg.iter().map(|angle| angle.to_radians()).collect();
        colour::of_stack(stack, self.seed, self.members, &angles, self.accuracy)
    }

    /// What a reader should know before trusting colours that have not converged.
    pub(crate) fn warning<'a>(&self, colours: impl IntoIterator<Item = &'a StackColour>) -> Option<String> {
        let worst = colours.into_iter().map(|c| c.change).fold(0.0, f64::max);
        (worst > self.accuracy).then(|| {
            format!(
                "a colour still changes by {worst:.2} (CIEDE2000) at {} wavelengths, more than the accuracy of {}",
                colour::MOST_WAVELENGTHS,
                self.accuracy
            )
        })
    }
}

/// Colours as JSON or CSV.
pub(crate) fn colours(args: &ColourArgs, as_json: bool, quiet: bool) -> Outcome {
    let recipe = nacre_cli::read_recipe(&args.recipe)?;
    let angles_deg = input::angles_deg(&args.angles_deg)?;
    let precision = &args.precision;
    precision.check()?;
    let colours = precision
        .colours(&recipe.film_stack(), &angles_deg)
        .map_err(|why| Stop::BadInput(format!("{}: {why}", args.recipe.display())))?;
    if let Some(warning) = precision.warning(&colours).filter(|_| !quiet) {
        crate::note(&warning);
    }
    if as_json {
        let list: Vec<Value> =
            angles_deg.iter().zip(&colours).map(|(angle, c)| entry(*angle, c, precision)).collect();
        return terminal::print_json(&json!({
            "schema": "thinfilm-colour/1", "recipe": recipe.name, "observer": "CIE 1931 2 deg", "illuminant": "D65",
            "members": colours.first().map_or(1, |c| c.members), "seed": precision.seed, "accuracy": precision.accuracy,
            "angles_deg": angles_deg, "colours": list,
        }));
    }
    let mut text = "angle_deg,X,Y,Z,R,G,B,wavelengths,ensemble_std_error\n".to_owned();
    for (angle, c) in angles_deg.iter().zip(&colours) {
        let ([x, y, z], [r, g, b]) = (c.xyz, c.linear_srgb);
        // Of one irregular stack the error is not known.
        let error = c.ensemble_error.map_or_else(String::new, |error| error.to_string());
        text.push_str(&format!("{angle},{x},{y},{z},{r},{g},{b},{},{error}\n", c.wavelengths));
    }
    terminal::print(&text)
}

pub(crate) fn entry(angle_deg: f64, c: &StackColour, precision: &Precision) -> Value {
    json!({
        "angle_deg": angle_deg, "xyz": c.xyz, "linear_srgb": c.linear_srgb, "lab": c.lab,
        "srgb": colour::srgb_bytes(c.linear_srgb), "wavelengths": c.wavelengths,
        "delta_e_of_last_doubling": c.change, "converged": c.change <= precision.accuracy,
        "ensemble_std_error_delta_e": c.ensemble_error,
    })
}
