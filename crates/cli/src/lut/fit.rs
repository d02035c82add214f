//! `lut fit`: a table in compact form, with what that costs in accuracy.

use crate::FileArg;
use lut_io::compact::{Compact, DeltaE, Form, Loss, MAX_ORDER};
use lut_io::lobe::Interpolant;
use lut_io::{FieldError, Table, diff, exr_file, fit};
use nacre_cli::preview::{Lighting, Quality, SUM, Shape, render, tone};
use pearl_bsdf::{Controls, PearlBsdf};
use serde_json::json;
use std::path::{Path, PathBuf};
use terminal::{Outcome, Stop};

/// Total variation that the fewer cells and incidences of a table may cost unless asked otherwise, per cent.
const DEFAULT_TOTAL_VARIATION_PERCENT: f64 = 0.3;
/// Order of the analytic distribution unless asked otherwise: 16 coefficients in decay tables, 72 in space tables.
const DEFAULT_ORDER: u16 = 15;
/// The pictures that colours are compared on.
const PREVIEW: Quality = Quality { size: 128, samples: 32, seed: 1 };

#[derive(clap::Args, Debug)]
#[command(
    after_help = "A compact file is read wherever a table is: by `lut`, `pearl` and the Mitsuba plugin. It holds no error bars.

Examples:
  lut fit pearl.exr -o small.exr                          every lobe as exp(polynomial): 16 coefficients an incidence
  lut fit pearl.exr --form table -o small.exr             fewer cells and incidences, half precision
  lut fit pearl.exr --form table --total-variation 0 -o half.exr     all cells and incidences, half precision"
)]
pub(crate) struct FitArgs {
    #[command(flatten)]
    file: FileArg,
    /// Compact file to write.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Analytic reflection distribution, or a smaller table.
    #[arg(long, value_enum, default_value = "analytic")]
    form: FormArg,
    /// analytic: order of the polynomial along θo (in space tables half of it along φ) [default: 15].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(0..=i64::from(MAX_ORDER)))]
    order: Option<u16>,
    /// table: what fewer cells and incidences may cost, total variation in per cent of the reflected light; 0 keeps all
    /// [default: 0.3].
    #[arg(long, value_name = "PERCENT", allow_negative_numbers = true)]
    total_variation: Option<f64>,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
enum FormArg {
    /// Every lobe as the exponential of a polynomial.
    Analytic,
    /// Fewer cells and incidences in half precision.
    Table,
}

/// Writes the compact form, and says how far it is from the table.
pub(crate) fn run(args: &FitArgs, json: bool) -> Outcome {
    let path = &args.file.file;
    let permitted = permitted(args)?;
    let lobe = crate::read_lobe(path)?;
    nacre_cli::check_output("table", path, &args.output)?;
    let invalid = |error: FieldError| Stop::bad_input(format!("{}: {error}", path.display()));
    let source_bytes = std::fs::metadata(path)
        .map_err(|why| Stop::failure(format!("{}: cannot read the file: {why}", path.display())))?
        .len();
    let compact = match args.form {
        FormArg::Analytic => {
            let terms = fit::terms(&lobe.table().meta().exit_axis, args.order.unwrap_or(DEFAULT_ORDER));
            fit::fitted(lobe.table(), terms, source_bytes).map_err(invalid)?
        }
        FormArg::Table => {
            let thin = if permitted > 0.0 {
                fit::thinned(&lobe, permitted).map_err(invalid)?
            } else {
                lobe.table().clone()
            };
            fit::halved(&thin, source_bytes).map_err(invalid)?
        }
    };
    let compact = with_loss(compact, &lobe, path)?;
    let bytes = exr_file::encode_compact(&compact).map_err(invalid)?;
    nacre_cli::write_file(&args.output, &bytes)?;
    let uniform = (args.form == FormArg::Table).then(|| uniform(&lobe, compact.meta())).transpose();
    let report = Report { compact: &compact, bytes: bytes.len() as u64, uniform: uniform.map_err(invalid)? };
    if json { terminal::print_json(&report.json(args)) } else { terminal::print(&report.text(args)) }
}

fn permitted(args: &FitArgs) -> Result<f64, Stop> {
    let given = |flag: &str, form: &str| Err(Stop::bad_input(format!("--{flag}: is for --form {form} only")));
    if args.form == FormArg::Table && args.order.is_some() {
        return given("order", "analytic");
    }
    if args.form == FormArg::Analytic && args.total_variation.is_some() {
        return given("total-variation", "table");
    }
    let percent = args.total_variation.unwrap_or(DEFAULT_TOTAL_VARIATION_PERCENT);
    if (0.0..=100.0).contains(&percent) {
        return Ok(percent);
    }
    Err(Stop::bad_input(format!("--total-variation: {percent} is not a share; expected 0 to 100 per cent")))
}

/// Measures what the compact form lost, as it is read back from its bytes, and states it.
fn with_loss(compact: Compact, lobe: &Interpolant, path: &Path) -> Result<Compact, Stop> {
    let invalid = |error: FieldError| Stop::bad_input(format!("{}: {error}", path.display()));
    let decoded =
        exr_file::encode_compact(&compact).and_then(|bytes| exr_file::decode(&bytes)).map_err(invalid)?;
    let read_back = Interpolant::new(decoded);
    let delta_e_2000 = preview_difference(lobe.table(), read_back.table(), path)?;
    fit::with_loss(compact, &diff::diff(lobe, &read_back), delta_e_2000).map_err(invalid)
}

/// ΔE00 over the pearl's pixels of all four pictures of `pearl preview`, with the look of the recipe.
fn preview_difference(table: &Table, compact: &Table, path: &Path) -> Result<Option<DeltaE>, Stop> {
    let controls = Controls::of(table.meta());
    let bsdf = |table: &Table| {
        PearlBsdf::from_table(table.clone(), controls)
            .map_err(|error| Stop::bad_input(format!("{}: {error}", path.display())))
    };
    let (whole, small) = (bsdf(table)?, bsdf(compact)?);
    let mut differences = Vec::new();
    for shape in Shape::ALL {
        for [a, b] in render([&whole, &small], shape, &Lighting::ALL, PREVIEW) {
            differences.extend(tone::delta_e(&a.view(SUM), &b.view(SUM), &a.pearl));
        }
    }
    Ok(tone::summary(differences))
}

/// Total variation of a table of as many incidences and cells, but evenly spaced: what choosing them is worth.
fn uniform(lobe: &Interpolant, meta: &lut_io::table::Meta) -> Result<f64, FieldError> {
    let (kept, all) = (meta.per_incidence.len(), lobe.table().meta().per_incidence.len());
    let even = |k: usize| (k * (all - 1) + (kept - 1) / 2) / (kept - 1).max(1);
    let incidences: Vec<usize> = (0..kept).map(even).collect();
    let thin = Interpolant::new(fit::resampled(lobe, &meta.exit_axis, &incidences)?);
    Ok(diff::diff(lobe, &thin).worst_total_variation_percent)
}

/// What is said of a compact file.
struct Report<'a> {
    compact: &'a Compact,
    bytes: u64,
    uniform: Option<f64>,
}

impl Report<'_> {
    fn ratio(&self) -> f64 {
        self.compact.section().source_bytes as f64 / self.bytes as f64
    }

    fn size(&self) -> (usize, usize) {
        let meta = self.compact.meta();
        match &self.compact.section().form {
            Form::Analytic { terms } => (meta.per_incidence.len(), terms.len()),
            Form::Half { .. } => (meta.per_incidence.len(), meta.exit_axis.cells()),
        }
    }

    fn json(&self, args: &FitArgs) -> serde_json::Value {
        let (incidences, numbers) = self.size();
        let mut report = json!({
            "schema": "lut-fit/1",
            "form": if args.form == FormArg::Analytic { "analytic" } else { "table" },
            "output": args.output.display().to_string(),
            "bytes": self.bytes,
            "source_bytes": self.compact.section().source_bytes,
            "ratio": self.ratio(),
            "incidences": incidences,
            "error": self.compact.section().error,
        });
        let of_incidence =
            if args.form == FormArg::Analytic { "coefficients_per_incidence" } else { "cells_per_incidence" };
        report[of_incidence] = numbers.into();
        if let Some(uniform) = self.uniform {
            report["evenly_spaced_total_variation_percent"] = uniform.into();
        }
        report
    }

    fn text(&self, args: &FitArgs) -> String {
        let (incidences, numbers) = self.size();
        let what = if args.form == FormArg::Analytic { "coefficients" } else { "cells" };
        let Loss { total_variation_percent, mean_total_variation_percent, delta_e_2000 } =
            self.compact.section().error;
        let DeltaE { mean, percentile_99, largest } = delta_e_2000.unwrap_or_default();
        let mut text = format!(
            "written: {} ({:.1} kB, {:.1} times smaller): {incidences} incidences of {numbers} {what} a lobe\n\
             total variation against the table: {mean_total_variation_percent:.3} % on average, {total_variation_percent:.3} % at worst\n\
             preview, ΔE00: {mean:.3} on average, {percentile_99:.3} in 99 of 100 pixels, {largest:.3} at worst\n",
            args.output.display(),
            self.bytes as f64 / 1e3,
            self.ratio(),
        );
        if let Some(uniform) = self.uniform {
            text.push_str(&format!("as many incidences evenly spaced: {uniform:.3} % at worst\n"));
        }
        text
    }
}
