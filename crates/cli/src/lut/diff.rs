//! `lut diff`

use crate::read_lobe;
use lut_io::diff::{self, Difference, LobeDifference, SIGNIFICANCE};
use std::fmt::Write as _;
use std::path::PathBuf;
use terminal::{Outcome, Stop};

#[derive(clap::Args, Debug)]
#[command(after_help = "How it judges, for each incidence, wavelength and component:
  the cells of a walk against those of another walk, or of a table without noise: chi², what that table states of
    its accuracy taken off (a walk and a doubling of the same incidences and cells show most);
  every lobe: total variation against the sum of what both tables state;
  shares and moments by their standard errors; those of doubling, whose errors have no law, by their size;
  interface 0 and colours, which have no error, must be the same.
All tests together call two walks of one recipe different once in a thousand. The last line says which change would
have been found 99 times in a hundred.
Exit codes: 0 identical, or no further apart than their errors explain; 3 significantly different; 2 bad input.")]
pub(crate) struct DiffArgs {
    /// The first table; its incidences are compared (those of the second if that alone is a walk).
    #[arg(value_name = "A")]
    a: PathBuf,
    /// The second table, read between its nodes where it has no such incidence or other cells.
    #[arg(value_name = "B")]
    b: PathBuf,
}

/// Lines of a kind before the rest is only counted.
const MOST_LISTED: usize = 10;

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
    let beyond = difference.beyond.first().map_or_else(String::new, |line| format!("; {line}"));
    Err(Stop::check_failed(format!(
        "{a} and {b} differ significantly (total variation {worst:.3} % at {at}°{beyond})"
    )))
}

fn text(difference: &Difference) -> String {
    if difference.identical {
        return "identical\n".to_owned();
    }
    let mut text = String::from(
        "  theta_i   nm      total variation   albedo A-B       z   interior: apart   stated    chi2/groups      p\n",
    );
    for at in &difference.per_incidence {
        let albedo = at.shares.iter().find(|share| share.field == "albedo");
        let delta = albedo.map_or(0.0, |share| share.difference);
        let z = albedo.and_then(|share| share.z).map_or_else(|| "-".to_owned(), |z| format!("{z:.2}"));
        let none = || "-".to_owned();
        let interior = at.lobes.iter().find(|lobe| lobe.component == "interior");
        let chi2 =
            interior.and_then(|lobe| Some(format!("{:.1}/{}", lobe.chi2?, lobe.cells))).unwrap_or_else(none);
        let p = interior.and_then(|lobe| Some(format!("{:.3}", lobe.p?))).unwrap_or_else(none);
        let percent =
            |of: fn(&LobeDifference) -> f64| interior.map_or_else(none, |lobe| format!("{:.3} %", of(lobe)));
        let (apart, stated) =
            (percent(|lobe| lobe.total_variation_percent), percent(|lobe| lobe.allowed_percent));
        let _ = writeln!(
            text,
            "{:>8.3}°  {:<7.1} {:>13.4} %   {delta:>+10.6}  {z:>6}   {apart:>15}  {stated:>9}   {chi2:>12}  {p:>5}",
            at.theta_i_deg, at.wavelength_nm, at.total_variation_percent
        );
    }
    for (what, lines) in
        [("beyond what is stated", &difference.beyond), ("not compared", &difference.not_compared)]
    {
        for line in lines.iter().take(MOST_LISTED) {
            let _ = writeln!(text, "{what}: {line}");
        }
        if let Some(more) = lines.len().checked_sub(MOST_LISTED).filter(|more| *more > 0) {
            let _ = writeln!(text, "{what}: {more} more");
        }
    }
    let verdict = if difference.significant { "significant" } else { "within the stored errors" };
    let evidence = difference.smallest_p.map_or_else(
        || "no noise to test by: judged by what both state".to_owned(),
        |p| format!("smallest p of {} tests {p:.2e}, threshold {SIGNIFICANCE} over all", difference.tests),
    );
    let _ = writeln!(
        text,
        "{verdict} ({evidence}); finds a change of {:.2} % in any component (of √(all light · its own), total variation)",
        difference.smallest_change_percent
    );
    text
}
