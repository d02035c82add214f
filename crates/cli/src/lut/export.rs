//! `lut export`: a table in formats of other programs, with the error of the round trip.

mod npz;

use crate::read;
use clap::Args;
use lut_io::merl::Merl;
use lut_io::tensor_file;
use pearl_bsdf::measured::{self, Channels, Reader};
use pearl_bsdf::round_trip::{self, RoundTrip};
use pearl_bsdf::{Array, PearlBsdf, Prepared};
use serde_json::json;
use std::path::PathBuf;
use std::sync::Arc;
use terminal::{Outcome, Stop};

/// Wavelengths that a spectral file is compared at, spread evenly from the first to the last of the table: of the file and between.
const COMPARED: usize = 37;

#[derive(Args, Debug)]
pub(crate) struct ExportArgs {
    #[command(flatten)]
    file: super::FileArg,
    /// Format: arrays for whatever evaluates the pearl by itself (docs/ARRAYS.md), bsdf-rgb and bsdf-spectral for Mitsuba's `measured` (pbrt-v4 reads the spectral one only), merl for the MERL database's readers.
    #[arg(long, value_enum, value_name = "FORMAT")]
    to: Format,
    /// File to write.
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
}

#[derive(clap::ValueEnum, Clone, Copy, Debug)]
enum Format {
    /// All that the evaluation reads, as named arrays (.npz).
    Arrays,
    /// Tensor file (.bsdf) for RGB renderers.
    BsdfRgb,
    /// Tensor file (.bsdf) for spectral renderers.
    BsdfSpectral,
    /// MERL .binary; made reciprocal, as the format demands.
    Merl,
}

impl Format {
    const fn name(self) -> &'static str {
        match self {
            Self::Arrays => "arrays",
            Self::BsdfRgb => "bsdf-rgb",
            Self::BsdfSpectral => "bsdf-spectral",
            Self::Merl => "merl",
        }
    }
}

/// What was written.
enum Written {
    Arrays(Vec<Array>),
    /// How far it is from the table.
    Approximation(Vec<RoundTrip>),
}

/// Writes the table with the look of its recipe, and says what was written or how far it is from the table.
pub(crate) fn run(args: &ExportArgs, json: bool) -> Outcome {
    let path = &args.file.file;
    let table = read(path)?;
    crate::check_output(path, &args.output)?;
    let name = table.meta().recipe_name().unwrap_or("pearl").to_owned();
    let bad = |error| Stop::bad_input(format!("{}: {error}", path.display()));
    let prepared = Arc::new(Prepared::new(table).map_err(bad)?);
    let look = prepared.look();
    let bsdf = PearlBsdf::new(prepared, look).map_err(bad)?;
    let (bytes, written) = match args.to {
        Format::Arrays => {
            let arrays = bsdf.prepared().arrays();
            (npz::encode(&arrays).map_err(Stop::failure)?, Written::Arrays(arrays))
        }
        Format::BsdfRgb => tensor(&bsdf, &Channels::Rgb, &name)?,
        Format::BsdfSpectral => tensor(&bsdf, &Channels::Spectral(measured::wavelengths_nm(&bsdf)), &name)?,
        Format::Merl => merl(&bsdf)?,
    };
    nacre_cli::write_file(&args.output, &bytes)?;
    if json {
        return terminal::print_json(&report(args, bytes.len(), &written));
    }
    terminal::print(&text(args, bytes.len(), &written))
}

fn tensor(bsdf: &PearlBsdf, channels: &Channels, name: &str) -> Result<(Vec<u8>, Written), Stop> {
    let description = format!("{name}, exported by nacre");
    let bytes =
        tensor_file::encode(&measured::fields(bsdf, channels, &description)).map_err(Stop::failure)?;
    // What is compared is what was written.
    let reader = Reader::new(&tensor_file::decode(&bytes).map_err(Stop::failure)?).map_err(Stop::failure)?;
    let errors = match channels {
        Channels::Rgb => round_trip::measure(
            bsdf,
            |wi, wo| bsdf.eval_seen(wi, wo).rgb().to_vec(),
            |wi, wo| reader.eval(wi, wo),
        ),
        Channels::Spectral(_) => {
            let compared = compared_nm(&reader.wavelengths_nm);
            round_trip::measure(
                bsdf,
                |wi, wo| bsdf.eval_seen_spectrum(wi, wo, &compared),
                |wi, wo| reader.eval_spectrum(wi, wo, &compared),
            )
        }
    };
    Ok((bytes, Written::Approximation(errors)))
}

fn compared_nm(nodes: &[f64]) -> Vec<f64> {
    let (first, last) = (nodes[0], nodes[nodes.len() - 1]);
    // Some offset: bands are evenly spaced, and not all are to be met alike.
    (0..COMPARED).map(|i| first + (last - first) * (i as f64 + 0.37) / COMPARED as f64).collect()
}

fn merl(bsdf: &PearlBsdf) -> Result<(Vec<u8>, Written), Stop> {
    let merl = Merl::tabulate(|wi, wo| {
        let (there, back) = (bsdf.eval_seen(wi, wo).rgb(), bsdf.eval_seen(wo, wi).rgb());
        // Reciprocal, as the format demands, by the mean of both ways weighted by the light that each stands for. The plain mean
        // of both f grows without limit where one direction nears the horizon, and such a pearl shines.
        std::array::from_fn(|c| (there[c] + back[c]) / (wo[2] + wi[2]))
    });
    let bytes = merl.encode();
    let merl = Merl::decode(&bytes).map_err(Stop::failure)?;
    let errors = round_trip::measure(
        bsdf,
        |wi, wo| bsdf.eval_seen(wi, wo).rgb().to_vec(),
        |wi, wo| merl.eval(wi, wo).map_or([0.0; 3], |rgb| rgb.map(|x| x * wo[2])).to_vec(),
    );
    Ok((bytes, Written::Approximation(errors)))
}

fn worst(errors: &[RoundTrip]) -> f64 {
    errors.iter().map(|error| error.error_percent).fold(0.0, f64::max)
}

fn report(args: &ExportArgs, bytes: usize, written: &Written) -> serde_json::Value {
    let (key, said) = match written {
        Written::Arrays(arrays) => {
            let shapes = arrays.iter().map(|array| (array.name.to_owned(), json!(array.shape)));
            ("arrays", serde_json::Value::Object(shapes.collect()))
        }
        Written::Approximation(errors) => {
            let rows = errors.iter().map(|error| {
                json!({
                    "theta_i_deg": error.theta_i_deg,
                    "error_percent": error.error_percent,
                    "bias_percent": error.bias_percent,
                })
            });
            let rows: Vec<_> = rows.collect();
            ("round_trip", json!({ "worst_percent": worst(errors), "per_incidence": rows }))
        }
    };
    json!({
        "schema": "lut-export/1",
        "format": args.to.name(),
        "output": args.output.display().to_string(),
        "bytes": bytes,
        key: said,
    })
}

fn text(args: &ExportArgs, bytes: usize, written: &Written) -> String {
    let (file, format, megabytes) = (args.output.display(), args.to.name(), bytes as f64 / 1e6);
    let mut text = format!("written: {file} ({format}, {megabytes:.1} MB)\n\n");
    match written {
        Written::Arrays(arrays) => {
            for Array { name, shape, .. } in arrays {
                text.push_str(&format!("{name:<22} {shape:?}\n"));
            }
        }
        Written::Approximation(errors) => {
            text.push_str(
                "round trip: what the file says against the table, per cent of the reflected light\n   \
                 θi   |difference|   surplus\n",
            );
            for RoundTrip { theta_i_deg, error_percent, bias_percent } in errors {
                text.push_str(&format!(
                    "{theta_i_deg:>5}°        {error_percent:>6.2}    {bias_percent:>+6.2}\n"
                ));
            }
        }
    }
    text
}
