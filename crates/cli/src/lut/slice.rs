//! `lut slice`

use crate::{FileArg, read_lobe};
use lut_io::both_sides::Passage;
use lut_io::slice::{self, ComponentSlice, Slice};
use lut_io::{FieldError, passage};
use std::fmt::Write as _;
use std::path::Path;
use terminal::{Outcome, Stop};

#[derive(clap::Args, Debug)]
#[command(
    after_help = "Values are f·cos θo in 1/sr. At a stored incidence, with --phi 0 or 180 (decay tables) or the centre
of a φ cell (space tables), they are the stored numbers bit by bit; elsewhere they are interpolated.

Examples:
  lut slice pearl.exr --theta-i 30 --phi 0 --csv
  lut slice pearl.exr --theta-i 32.5 --phi 20 --json
  lut slice both.exr --theta-i 30 --lobe transmitted"
)]
pub(crate) struct SliceArgs {
    #[command(flatten)]
    file: FileArg,
    /// Angle of incidence, degrees.
    #[arg(long, value_name = "DEG", allow_negative_numbers = true)]
    theta_i: f64,
    /// Azimuth of exit from the mirror direction, degrees: 0 is forward, 180 is back.
    #[arg(long, value_name = "DEG", default_value_t = 0.0, allow_negative_numbers = true)]
    phi: f64,
    /// Which light: what is reflected, or, in tables baked with --both-sides, what passes from above, and what comes from
    /// below (its θi in the substrate). Other than reflected, θi must be a stored one.
    #[arg(long, value_enum, default_value = "reflected")]
    lobe: LobeArg,
    /// Print comma-separated values with a header line (the default).
    #[arg(long, conflicts_with = "json")]
    csv: bool,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum LobeArg {
    Reflected,
    Transmitted,
    BelowReflected,
    BelowTransmitted,
}

pub(crate) fn run(args: &SliceArgs, json: bool) -> Outcome {
    match args.lobe {
        LobeArg::Reflected => reflected(args, json),
        LobeArg::Transmitted => passage(args, Passage::Transmitted, json),
        LobeArg::BelowReflected => passage(args, Passage::BelowReflected, json),
        LobeArg::BelowTransmitted => passage(args, Passage::BelowTransmitted, json),
    }
}

fn passage(args: &SliceArgs, passage: Passage, json: bool) -> Outcome {
    let table = crate::read(&args.file.file)?;
    let slice = passage::slice(&table, passage, args.theta_i, args.phi)
        .map_err(|error| refused(error, &args.file.file))?;
    let columns =
        [("theta_o_deg".to_owned(), slice.theta_o_deg.as_slice()), (passage.name().to_owned(), &slice.value)];
    if json {
        let mut object = serde_json::json!({
            "schema": "lut-slice/1",
            "lobe": passage.name(),
            "theta_i_deg": slice.theta_i_deg,
            "phi_deg": slice.phi_deg,
            "unit": "1/sr",
        });
        for (name, numbers) in columns {
            object[name] = numbers.into();
        }
        return terminal::print_json(&object);
    }
    terminal::print(&csv(&columns))
}

/// What the library says of a field, said of its flag.
fn refused(FieldError { field, problem }: FieldError, file: &Path) -> Stop {
    let field = match field.as_str() {
        "theta_i_deg" => "--theta-i",
        "phi_deg" => "--phi",
        other => other,
    };
    Stop::bad_input(format!("{}: {field}: {problem}", file.display()))
}

fn reflected(args: &SliceArgs, json: bool) -> Outcome {
    let lobe = read_lobe(&args.file.file)?;
    slice::check_angles(&lobe, args.theta_i, args.phi).map_err(|error| refused(error, &args.file.file))?;
    let slice = Slice::new(&lobe, args.theta_i, args.phi);
    if json {
        return terminal::print_json(&object(&slice));
    }
    terminal::print(&csv(&columns(&slice)))
}

/// The columns of a slice: name and numbers.
fn columns(slice: &Slice) -> Vec<(String, &[f64])> {
    let mut columns = vec![("theta_o_deg".to_owned(), slice.theta_o_deg.as_slice())];
    for ComponentSlice { component, value, std_error, count, .. } in &slice.components {
        columns.push((component.name().to_owned(), value));
        columns.push((format!("{}_std_error", component.name()), std_error));
        if let Some(count) = count {
            columns.push((format!("{}_count", component.name()), count));
        }
    }
    columns
}

fn object(slice: &Slice) -> serde_json::Value {
    let mut object = serde_json::json!({
        "schema": "lut-slice/1",
        "theta_i_deg": slice.theta_i_deg,
        "phi_deg": slice.phi_deg,
        "unit": "1/sr",
        "stored": slice.stored,
        "correction": slice.components.iter().map(|c| (c.component.name(), c.correction))
            .collect::<std::collections::BTreeMap<_, _>>(),
    });
    for (name, numbers) in columns(slice) {
        object[name] = numbers.into();
    }
    object
}

fn csv(columns: &[(String, &[f64])]) -> String {
    let names: Vec<&str> = columns.iter().map(|(name, _)| name.as_str()).collect();
    let mut text = names.join(",") + "\n";
    for row in 0..columns[0].1.len() {
        for (i, (_, numbers)) in columns.iter().enumerate() {
            let separator = if i == 0 { "" } else { "," };
            // The shortest text that reads back as the same f64 (and so as the same stored f32).
            let _ = write!(text, "{separator}{}", numbers[row]);
        }
        text.push('\n');
    }
    text
}
