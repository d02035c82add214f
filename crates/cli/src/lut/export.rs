//! `lut export`: a table in formats of other programs, with the error of the round trip.

use crate::read;
use clap::Args;
use clap::builder::PossibleValue;
use pearl_bsdf::export::{Content, Export, Format};
use pearl_bsdf::round_trip::{Preview, RoundTrip};
use pearl_bsdf::{Array, BsdfError, PearlBsdf, Prepared};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use terminal::{Outcome, Stop};

#[derive(Args, Debug)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    file: super::FileArg,
    /// Format (docs/HOSTS.md says what each host shows; docs/ARRAYS.md how arrays are evaluated).
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Named,
    /// File to write.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
}

/// A format by its name.
#[derive(Clone, Copy, Debug)]
struct Named(Format);

impl clap::ValueEnum for Named {
    fn value_variants<'a>() -> &'a [Self] {
        const {
            &{
                let mut all = [Self(Format::Arrays); Format::ALL.len()];
                let mut i = 0;
                while i < all.len() {
                    all[i] = Self(Format::ALL[i]);
                    i += 1;
                }
                all
            }
        }
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.0.name()).help(self.0.description()))
    }
}

/// Writes the table with the look of its recipe, and says what was written or how far it is from the table.
pub(crate) fn run(args: &ExportArgs, json: bool) -> Outcome {
    let path = &args.file.file;
    let table = read(path)?;
    nacre_cli::check_output("table", path, &args.output)?;
    let name = table.meta().recipe_name().unwrap_or("pearl").to_owned();
    let bad = |error: BsdfError| Stop::bad_input(format!("{}: {error}", path.display()));
    let prepared = Arc::new(Prepared::new(table).map_err(bad)?);
    let look = prepared.look();
    let bsdf = PearlBsdf::new(prepared, look).map_err(bad)?;
    let export = Export::new(&bsdf, &name, args.to.0).map_err(|why| bad(why.into()))?;
    nacre_cli::write_file(&args.output, &export.bytes)?;
    if json {
        return terminal::print_json(&export.report(&args.output));
    }
    terminal::print(&text(&export, &args.output))
}

fn text(export: &Export, output: &Path) -> String {
    let (file, format, megabytes) = (output.display(), export.format.name(), export.bytes.len() as f64 / 1e6);
    let mut text = format!("written: {file} ({format}, {megabytes:.1} MB)\n\n");
    match &export.content {
        Content::Arrays(arrays) => {
            for Array { name, shape, .. } in arrays {
                text.push_str(&format!("{name:<22} {shape:?}\n"));
            }
        }
        Content::Approximation(errors, preview) => text.push_str(&compared(errors, *preview)),
        Content::Material(errors, preview, numbers) => {
            text.push_str(&compared(errors, *preview));
            text.push('\n');
            for (name, value) in numbers {
                text.push_str(&format!("{name:<26} {value}\n"));
            }
        }
    }
    text
}

fn compared(errors: &[RoundTrip], preview: Option<Preview>) -> String {
    let mut text = String::from(
        "round trip: what the file says against the table, per cent of the reflected light\n   \
         θi   |difference|   surplus\n",
    );
    for RoundTrip { theta_i_deg, error_percent, bias_percent } in errors {
        text.push_str(&format!("{theta_i_deg:>5}°        {error_percent:>6.2}    {bias_percent:>+6.2}\n"));
    }
    if let Some(Preview { mean, most }) = preview {
        text.push_str(&format!(
            "\npreview, a sphere under a sky with two lamps: ΔE00 {mean:.2} in the mean, 95 % below {most:.2}\n"
        ));
    }
    text
}
