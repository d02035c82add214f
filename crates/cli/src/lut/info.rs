//! `lut info`

use crate::{FileArg, read};
use lut_io::axis::ExitAxis;
use lut_io::both_sides::BothSides;
use lut_io::spectra::{ColourError, Thickness, ThicknessError};
use lut_io::table::{AzimuthMode, IncidenceSummary, Meta};
use std::fmt::Write as _;
use terminal::{Outcome, Stop};

#[derive(clap::Args, Debug)]
pub(crate) struct InfoArgs {
    #[command(flatten)]
    file: FileArg,
}

pub(crate) fn run(args: &InfoArgs, json: bool) -> Outcome {
    let meta = read(&args.file.file)?.into_parts().meta;
    if json {
        return terminal::print_json(&object(&meta)?);
    }
    terminal::print(&text(&meta))
}

fn object(meta: &Meta) -> Result<serde_json::Value, Stop> {
    let mut object = serde_json::to_value(meta).map_err(Stop::failure)?;
    object["grids"] = grids(meta);
    Ok(object)
}

fn grids(meta: &Meta) -> serde_json::Value {
    let axis = &meta.exit_axis;
    serde_json::json!({
        "theta_i_deg": meta.per_incidence.iter().map(|s| s.theta_i_deg).collect::<Vec<f64>>(),
        "exit_axis": axis,
        "exit_width_deg": axis.width().to_degrees(),
        "columns": axis.columns(),
        "rows_per_incidence": axis.rows_per_incidence(),
        "image": [axis.columns(), axis.rows_per_incidence() * meta.per_incidence.len()],
    })
}

fn text(meta: &Meta) -> String {
    let mut text = String::new();
    let name = meta.recipe_name().unwrap_or("(unnamed)");
    // Writing to a String cannot fail.
    let mut line = |label: &str, value: String| {
        let _ = writeln!(text, "{label:<12} {value}");
    };
    line("table", format!("{} by {}", meta.schema, meta.writer));
    line("recipe", name.to_owned());
    line("solver", format!("{:?}, seed {}", meta.solver, meta.seed).to_lowercase());
    line("wavelength", format!("{} nm", meta.wavelength_nm));
    line("effects", meta.effects.join(", "));
    line("cells", cells(&meta.exit_axis));
    line("azimuth", azimuth(meta));
    line("accuracy", accuracy(meta));
    if let Some(spectra) = &meta.spectra {
        let errors = [
            ("coherent", spectra.coherent.as_ref().map(|part| part.delta_e00)),
            ("emission", spectra.emission.as_ref().map(|part| part.delta_e00)),
        ];
        let known = errors.iter().filter_map(|(name, error)| Some(colours(name, (*error)?)));
        line("colours", known.collect::<Vec<_>>().join("; "));
        if let Some(Thickness { scale, delta_e00, .. }) = &spectra.thickness {
            let (from, to) = (scale[0], scale[scale.len() - 1]);
            let ThicknessError { scales, scaling } = delta_e00;
            line(
                "thickness",
                format!(
                    "{from} to {to} at {} scales, to {scales} dE00 between them, {scaling} by what does not scale",
                    scale.len()
                ),
            );
        }
    }
    text.push_str("\n  theta_i   albedo    +-      surface  transmitted  absorbed  mean exit     sd    skew     paths\n");
    for summary in &meta.per_incidence {
        text.push_str(&row(summary));
    }
    if let Some(section) = &meta.both_sides {
        text.push_str(&from_below(section));
    }
    text
}

fn from_below(section: &BothSides) -> String {
    let mut text = format!(
        "\nlight from below, at the same angles in the substrate (n = {})\n  theta_i   reflected  transmitted  absorbed\n",
        section.n_substrate
    );
    for below in &section.from_below {
        let _ = writeln!(
            text,
            "{:>8.3}°  {:.5}    {:.5}      {:.5}",
            below.theta_i_deg, below.reflected, below.transmitted, below.absorbed
        );
    }
    text
}

fn cells(axis: &ExitAxis) -> String {
    let width = axis.width().to_degrees();
    match axis {
        ExitAxis::Plane { cells, .. } => {
            format!("{cells} over the signed exit angle, stretch width {width:.3}°")
        }
        ExitAxis::Space { theta_cells, phi_cells, .. } => {
            format!("{theta_cells} over θo × {phi_cells} over φ, stretch width {width:.3}°")
        }
    }
}

fn azimuth(meta: &Meta) -> String {
    match meta.azimuth {
        AzimuthMode::Decay => {
            "decay postulate on the plane walk; moments of the signed exit angle".to_owned()
        }
        AzimuthMode::Space => "walked in space; moments of the polar exit angle".to_owned(),
    }
}

fn accuracy(meta: &Meta) -> String {
    let accuracy = &meta.accuracy;
    let asked = accuracy.asked_percent.map_or_else(String::new, |asked| format!(" ({asked} % asked)"));
    let components = accuracy.components.map_or_else(String::new, |components| {
        format!(
            "; interior {:.3} %, re-hits {:.3} %, stored surface {:.3} % of √(all light · their own)",
            components.interior_percent, components.rehit_percent, components.surface_percent
        )
    });
    format!(
        "{:.3} % total variation as read{asked}: solver {:.3} % (at {}°), between rows {:.3} %, between cells {}{components}",
        accuracy.reached_percent,
        accuracy.solver_percent,
        accuracy.worst_theta_i_deg,
        accuracy.rows_percent,
        accuracy.cells_percent.map_or_else(|| "unknown".to_owned(), |percent| format!("{percent:.3} %")),
    )
}

fn colours(name: &str, error: ColourError) -> String {
    let sampling = error.sampling.map_or_else(|| "unknown".to_owned(), |error| error.to_string());
    format!(
        "{name} within ΔE00 {sampling} (waves), {} (between angles), {} (between bands)",
        error.angles, error.bands
    )
}

fn row(s: &IncidenceSummary) -> String {
    format!(
        "{:>8.3}°  {:.5}  {:.5}   {:.5}    {:.5}     {:.5}   {:>7.3}°  {:>6.3}° {:>6.3} {:>10}\n",
        s.theta_i_deg,
        s.albedo,
        s.std_error.albedo,
        s.surface,
        s.transmitted,
        s.absorbed,
        s.mean_theta_o_deg,
        s.sd_theta_o_deg,
        s.skew_theta_o,
        s.paths
    )
}
