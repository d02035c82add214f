//! Arguments that several commands share: the recipe, the options of a bake.

use bake_brdf::effects::Effects;
use bake_brdf::options::{DEFAULT_EVENT_CAP, Options, SolverChoice, Target};
use bake_brdf::recipe::{self, AzimuthMode, Recipe};
use clap::builder::{PossibleValuesParser, TypedValueParser};
use std::path::Path;
use std::time::Duration;
use terminal::Stop;
use transport::walk::lanes::Precision;

/// Flags that say what is baked, and how well.
#[derive(clap::Args, Clone, Debug)]
pub(crate) struct OptionsArgs {
    /// Who solves: walk, doubling or auto [default: the recipe's choice].
    ///
    /// The Monte Carlo walk, the deterministic doubling, or whichever is cheaper.
    #[arg(long, hide_possible_values = true, value_parser = one_of(&[
        ("walk", SolverChoice::Walk), ("doubling", SolverChoice::Doubling), ("auto", SolverChoice::Auto),
    ]))]
    solver: Option<SolverChoice>,
    /// Total variation of the lobe, per cent of the reflected light [default: 1].
    ///
    /// It is that of the lobe as it is read at any pair of angles.
    #[arg(long, value_name = "PERCENT", group = "target", allow_negative_numbers = true)]
    accuracy: Option<f64>,
    /// Paths per incidence.
    #[arg(long, value_name = "N", group = "target", allow_negative_numbers = true)]
    paths: Option<u64>,
    /// Wall-clock time to spend.
    #[arg(
        long,
        hide_short_help = true,
        value_name = "SECONDS",
        group = "target",
        allow_negative_numbers = true
    )]
    time_budget: Option<f64>,
    /// Seed: the same seed gives the same file.
    #[arg(long, value_name = "S", default_value_t = 1, allow_negative_numbers = true)]
    seed: u64,
    /// Azimuth mode, decay or space, in place of the recipe's.
    #[arg(long, hide_short_help = true, hide_possible_values = true, value_parser = one_of(&[("decay", AzimuthMode::Decay), ("space", AzimuthMode::Space)]))]
    azimuth: Option<AzimuthMode>,
    /// Effects to bake, in place of those that the look calls for (--help lists them).
    ///
    /// Names separated by commas: surface, blur, azimuth (azimuth:decay, azimuth:space), polarisation, absorption,
    /// dispersion, coherent, coherent_sheets, emission, irregularity, body, texture, thickness; or all that the recipe has
    /// matter for.
    #[arg(long, value_name = "LIST")]
    effects: Option<String>,
    /// Angles of incidence: numbers and FROM:TO:STEP [default: as few as it takes].
    ///
    /// Degrees, separated by commas. By default they stand where lobes change, as few as the accuracy takes.
    #[arg(long, value_name = "LIST")]
    incident_deg: Option<String>,
    /// Exit cells of an incidence: COLUMNS, or COLUMNSxROWS (azimuths) in space [default: as few as the accuracy takes].
    #[arg(long, hide_short_help = true, value_name = "CELLS", value_parser = cells)]
    cells: Option<[usize; 2]>,
    /// Events after which a path is given up and booked as truncated.
    #[arg(long, hide_short_help = true, value_name = "N", default_value_t = DEFAULT_EVENT_CAP)]
    event_cap: u32,
    /// Arithmetic of the walk's geometry; auto takes 32 bits where that is harmless.
    #[arg(long, hide_short_help = true, default_value = "auto", value_parser = one_of(&[
        ("auto", Precision::Auto), ("f32", Precision::F32), ("f64", Precision::F64),
    ]))]
    precision: Precision,
}

/// Takes one of some names for the value behind it.
fn one_of<T: Copy + Send + Sync>(values: &'static [(&'static str, T)]) -> impl TypedValueParser<Value = T> {
    PossibleValuesParser::new(values.iter().map(|(name, _)| *name)).try_map(|given| {
        values.iter().find(|(name, _)| *name == given).map(|(_, value)| *value).ok_or("not one of them")
    })
}

impl OptionsArgs {
    /// The options.
    pub(crate) fn options(&self) -> Result<Options, Stop> {
        let (effects, listed_azimuth) = match self.effects.as_deref().map(Effects::parse).transpose() {
            Ok(parsed) => parsed.unwrap_or_default(),
            Err(why) => return Err(Stop::BadInput(format!("--{why}"))),
        };
        if let (Some(flag), Some(listed)) = (self.azimuth, listed_azimuth)
            && flag != listed
        {
            let line = "--effects: its azimuth is not that of --azimuth; give one of the two";
            return Err(Stop::BadInput(line.to_owned()));
        }
        let default = Options::default();
        Ok(Options {
            effects,
            azimuth: self.azimuth.or(listed_azimuth),
            incident_deg: self.incident_deg.as_deref().map(incident_deg).transpose()?,
            target: match (self.accuracy, self.paths, self.time_budget) {
                (Some(percent), ..) => Target::AccuracyPercent(percent),
                (_, Some(paths), _) => Target::Paths(paths),
                (.., Some(seconds)) => Target::Time(duration("time-budget", seconds)?),
                _ => default.target,
            },
            cells: self.cells,
            solver: self.solver,
            seed: self.seed,
            event_cap: self.event_cap,
            precision: self.precision,
            ..default
        })
    }
}

/// `64x32`, or `64`, which has half as many rows.
fn cells(text: &str) -> Result<[usize; 2], String> {
    let number = |text: &str| text.parse().map_err(|_| format!("{text:?} is not a number of cells"));
    match text.split_once('x') {
        Some((columns, rows)) => Ok([number(columns)?, number(rows)?]),
        None => number(text).map(|columns| [columns, columns.div_ceil(2)]),
    }
}

/// A flag's time, in seconds.
pub(crate) fn duration(flag: &str, seconds: f64) -> Result<Duration, Stop> {
    if seconds > 0.0 && seconds <= 1e9 {
        return Ok(Duration::from_secs_f64(seconds));
    }
    Err(Stop::BadInput(format!("--{flag}: {seconds} is not a time; expected seconds, more than 0")))
}

/// Most angles of incidence of a list.
const MOST_ANGLES: usize = 100_000;

/// The angles of `--incident-deg`, ascending and distinct.
pub(crate) fn incident_deg(list: &str) -> Result<Vec<f64>, Stop> {
    let mut angles = terminal::angles_deg("--incident-deg", list, MOST_ANGLES)?;
    angles.sort_by(f64::total_cmp);
    angles.dedup();
    Ok(angles)
}

/// The recipe of a file or of a built-in name, or the paper's; and what a message calls it.
pub(crate) fn recipe(path: Option<&Path>) -> Result<(Recipe, String), Stop> {
    let Some(path) = path else { return Ok((Recipe::default(), "the paper's pearl".to_owned())) };
    let read = |path: &Path| terminal::read_text(path, recipe::MAX_BYTES);
    Ok((recipe::named(path, read, Stop::BadInput)?, path.display().to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_angles_take_numbers_and_ranges() {
        let angles = |list| incident_deg(list).unwrap();
        assert_eq!(angles("0:90:30,45,30"), [0.0, 30.0, 45.0, 60.0, 90.0]);
        assert_eq!(angles("89.9"), [89.9]);
    }
}
