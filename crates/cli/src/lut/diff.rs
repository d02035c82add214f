//! `lut diff`

use crate::read_lobe;
use lut_io::diff::{self, Difference, SIGNIFICANCE};
use std::fmt::Write as _;
use std::path::PathBuf;
use terminal::{Outcome, Stop};

#[derive(clap::Args, Debug)]
#[command(
    after_help = "Exit codes: 0 identical, or no further apart than their stored errors explain; 3 significantly
different (family-wise significance 0.001 over all albedo z tests and chi² tests of the lobes; tables
without statistical errors: total variation beyond the sum of their accuracies); 2 bad input."
)]
pub(crate) struct DiffArgs {
    /// The first table; its incidences are compared.
    #[arg(value_name = "A")]
    a: PathBuf,
    /// The second table, read between its nodes where it has no such incidence or other cells.
    #[arg(value_name = "B")]
    b: PathBuf,
}

pub(crate) fn run(args: &DiffArgs, json: bool) -> Outcome {
    let difference = diff::diff(&read_lobe(&args.a)?, &read_lobe(&args.b)?);
    let (a, b) = (args.a.display(), args.b.display());
    if difference.per_incidence.is_empty() {
        return Err(Stop::bad_input(format!("{a}: per_incidence: has no angle within those of {b}")));
    }
    if json {
        let mut object = serde_json::to_value(&difference).map_err(Stop::failure)?;
        object["schema"] = "lut-diff/1".into();
        object["significance"] = SIGNIFICANCE.into();
        terminal::print_json(&object)?;
    } else {
        terminal::print(&text(&difference))?;
    }
    if !difference.significant {
        return Ok(());
    }
    let worst = difference.worst_total_variation_percent;
    let at = difference.worst_theta_i_deg;
    Err(Stop::check_failed(format!(
        "{a} and {b} differ significantly (total variation {worst:.3} % at {at}°)"
    )))
}

fn text(difference: &Difference) -> String {
    if difference.identical {
        return "identical\n".to_owned();
    }
    let mut text =
        String::from("  theta_i   total variation   albedo A-B       z   chi2/cells interior      p\n");
    for at in &difference.per_incidence {
        let albedo = at.shares.iter().find(|share| share.field == "albedo");
        let delta = albedo.map_or(0.0, |share| share.difference);
        let z = albedo.and_then(|share| share.z).map_or_else(|| "-".to_owned(), |z| format!("{z:.2}"));
        let (chi2, p) = at.lobes.first().map_or_else(
            || ("-".to_owned(), "-".to_owned()),
            |lobe| (format!("{:.1}/{}", lobe.chi2, lobe.cells), format!("{:.3}", lobe.p)),
        );
        let _ = writeln!(
            text,
            "{:>8.3}°  {:>12.4} %   {delta:>+11.6}  {z:>6}   {chi2:>20}  {p:>5}",
            at.theta_i_deg, at.total_variation_percent
        );
    }
    let verdict = if difference.significant { "significant" } else { "within the stored errors" };
    let evidence = difference.smallest_p.map_or_else(
        || "no statistical errors: judged by the accuracies".to_owned(),
        |p| format!("smallest p of {} tests {p:.2e}, threshold {SIGNIFICANCE} over all", difference.tests),
    );
    let _ = writeln!(text, "{verdict} ({evidence})");
    text
}
