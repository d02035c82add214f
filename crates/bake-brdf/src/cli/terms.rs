//! Flags that say how to bake: shared by `bake` and `plan`.

use super::bake::angles;
use bake_brdf::bake::{self, SolverChoice, Target};
use bake_brdf::effects::Asked;
use bake_brdf::plan::Terms;
use bake_brdf::recipe::{self, AzimuthMode, Recipe};
use std::path::Path;
use std::time::Duration;
use terminal::Stop;
use transport::walk::lanes::Precision;

/// Accuracy of a bake that asks for none, per cent: about half a minute for the paper's pearl on two cores.
const DEFAULT_ACCURACY_PERCENT: f64 = 1.0;

#[derive(clap::Args, Clone, Debug)]
pub(crate) struct TermsArgs {
    /// Who solves: the Monte Carlo walk, the deterministic doubling, or whichever is cheaper [default: walk; doubling where
    /// the effects leave only the surface; auto for a scene].
    #[arg(long, value_enum)]
    solver: Option<SolverArg>,
    /// Total variation to reach at the worst incidence, per cent of the reflected light [default: 1].
    #[arg(long, value_name = "PERCENT", group = "target", allow_negative_numbers = true)]
    accuracy: Option<f64>,
    /// Paths per incidence.
    #[arg(long, value_name = "N", group = "target", allow_negative_numbers = true)]
    paths: Option<u64>,
    /// Wall-clock time to spend.
    #[arg(long, value_name = "SECONDS", group = "target", allow_negative_numbers = true)]
    time_budget: Option<f64>,
    /// Seed: the same seed gives the same file.
    #[arg(long, value_name = "S", default_value_t = 1, allow_negative_numbers = true)]
    seed: u64,
    /// Azimuth mode, in place of the recipe's.
    #[arg(long, value_enum)]
    azimuth: Option<AzimuthArg>,
    /// Effects to bake, separated by commas, in place of those that the look calls for: surface, blur, azimuth
    /// (azimuth:decay, azimuth:space), polarisation, absorption, dispersion, coherent, coherent_sheets, emission,
    /// irregularity, body, texture; or all that the recipe has matter for.
    #[arg(long, value_name = "LIST")]
    effects: Option<String>,
    /// Angles of incidence in degrees: numbers and FROM:TO:STEP, separated by commas [default: 0:90:1].
    #[arg(long, value_name = "LIST")]
    incident_deg: Option<String>,
    /// Events after which a path is given up and booked as truncated.
    #[arg(long, value_name = "N", default_value_t = bake::DEFAULT_EVENT_CAP)]
    event_cap: u32,
    /// Arithmetic of the walk's geometry; auto takes 32 bits where that is harmless.
    #[arg(long, value_enum, default_value = "auto")]
    precision: PrecisionArg,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum SolverArg {
    Walk,
    Doubling,
    Auto,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum PrecisionArg {
    Auto,
    F32,
    F64,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum AzimuthArg {
    Decay,
    Space,
}

impl TermsArgs {
    /// The terms; `default_solver` is what no `--solver` means.
    pub(crate) fn terms(&self, default_solver: Option<SolverChoice>) -> Result<Terms, Stop> {
        let azimuth = self.azimuth.map(|mode| match mode {
            AzimuthArg::Decay => AzimuthMode::Decay,
            AzimuthArg::Space => AzimuthMode::Space,
        });
        let asked = self.effects.as_deref().map(Asked::parse).transpose();
        let asked = asked.map_err(|why| Stop::BadInput(format!("--{why}")))?;
        if let (Some(flag), Some(listed)) = (azimuth, asked.and_then(|asked| asked.azimuth))
            && flag != listed
        {
            let line = "--effects: its azimuth is not that of --azimuth; give one of the two";
            return Err(Stop::BadInput(line.to_owned()));
        }
        Ok(Terms {
            incident_deg: match &self.incident_deg {
                None => bake::default_incident_deg(),
                Some(list) => angles(list)?,
            },
            target: match (self.accuracy, self.paths, self.time_budget) {
                (_, Some(paths), _) => Target::Paths(paths),
                (_, _, Some(seconds)) => Target::Time(budget("time-budget", seconds)?),
                (accuracy, _, _) => Target::AccuracyPercent(accuracy.unwrap_or(DEFAULT_ACCURACY_PERCENT)),
            },
            seed: self.seed,
            event_cap: self.event_cap,
            precision: match self.precision {
                PrecisionArg::Auto => Precision::Auto,
                PrecisionArg::F32 => Precision::F32,
                PrecisionArg::F64 => Precision::F64,
            },
            solver: match self.solver {
                None => default_solver,
                Some(SolverArg::Walk) => Some(SolverChoice::Walk),
                Some(SolverArg::Doubling) => Some(SolverChoice::Doubling),
                Some(SolverArg::Auto) => Some(SolverChoice::Auto),
            },
            azimuth,
            asked,
        })
    }
}

/// A flag's time, in seconds.
pub(crate) fn budget(flag: &str, seconds: f64) -> Result<Duration, Stop> {
    if seconds > 0.0 && seconds <= 1e9 {
        return Ok(Duration::from_secs_f64(seconds));
    }
    Err(Stop::BadInput(format!("--{flag}: {seconds} is not a time; expected seconds, more than 0")))
}

/// The recipe of a file, or the paper's; and what a message calls it.
pub(crate) fn recipe(path: Option<&Path>) -> Result<(Recipe, String), Stop> {
    let Some(path) = path else { return Ok((Recipe::default(), "the paper's pearl".to_owned())) };
    let recipe = Recipe::from_json(&terminal::read_text(path, recipe::MAX_BYTES)?)
        .map_err(|why| Stop::BadInput(format!("{}: {why}", path.display())))?;
    Ok((recipe, path.display().to_string()))
}
