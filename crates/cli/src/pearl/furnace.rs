//! `pearl furnace`: how bright the pearl shows a white surrounding, and how much of the light that arrives it sends back.

use crate::args::FurnaceArgs;
use pearl_bsdf::{Components, PearlBsdf};
use rayon::prelude::*;
use serde_json::{Value, json};
use terminal::{Outcome, Stop};

/// Directional albedo above 1 that passes: quadrature and interpolation errors.
const TOLERANCE: f64 = 1e-4;

/// Linear sRGB of the components and then of their sum.
type Albedo = [[f64; 3]; 5];

/// One angle.
struct Row {
    theta_deg: f64,
    /// The integral of what `pearl eval` prints: what a viewer at this angle sees.
    seen: Albedo,
    /// What becomes of light that arrives at this angle. The emission goes by the viewer, so that this is another number.
    sent: Albedo,
}

pub(crate) fn run(args: &FurnaceArgs, json: bool) -> Outcome {
    let bsdf = args.pearl.bsdf()?;
    let steps = args.steps;
    // At 90° nothing is evaluated: the last step stops a little before.
    let thetas: Vec<f64> = (0..=steps).map(|i| (90.0 * f64::from(i) / f64::from(steps)).min(89.99)).collect();
    let row = |theta_deg: &f64| {
        let theta = theta_deg.to_radians();
        let [seen, sent] = [bsdf.directional_albedo_seen(theta), bsdf.directional_albedo(theta)];
        Row { theta_deg: *theta_deg, seen: shown(&bsdf, seen), sent: shown(&bsdf, sent) }
    };
    let rows: Vec<Row> = thetas.par_iter().map(row).collect();
    let worst = rows.iter().flat_map(|row| [row.seen[4], row.sent[4]]).flatten().fold(0.0, f64::max);
    if json {
        let rows: Vec<Value> = rows.iter().map(describe).collect();
        terminal::print_json(&json!({
            "schema": "pearl-furnace/1", "lut": args.pearl.table.display().to_string(), "tolerance": TOLERANCE,
            "largest_albedo": worst, "pass": worst <= 1.0 + TOLERANCE, "per_incidence": rows,
        }))?;
    } else {
        let mut text = String::from(
            "seen: what a viewer at theta sees of a white surrounding, the integral of what `pearl eval` prints\n\
             sent: what leaves of light that arrives at theta\n\
             theta_deg  seen r      g        b     | diffuse  incoherent mirror   blur (g) | sent r      g        b\n",
        );
        for Row { theta_deg, seen: [d, i, m, b, seen], sent: [.., sent] } in &rows {
            text += &format!(
                "{theta_deg:9.2} {:8.5} {:8.5} {:8.5}  | {:8.5} {:8.5} {:8.5} {:8.5}     | {:8.5} {:8.5} {:8.5}\n",
                seen[0], seen[1], seen[2], d[1], i[1], m[1], b[1], sent[0], sent[1], sent[2]
            );
        }
        terminal::print(&text)?;
    }
    if worst > 1.0 + TOLERANCE {
        let table = args.pearl.table.display();
        return Err(Stop::check_failed(format!(
            "{table}: the albedo reaches {worst}, expected at most {}",
            1.0 + TOLERANCE
        )));
    }
    Ok(())
}

fn describe(row: &Row) -> Value {
    let parts: serde_json::Map<String, Value> = Components::NAMES
        .into_iter()
        .zip(&row.seen)
        .map(|(name, rgb)| (name.to_owned(), json!(rgb)))
        .collect();
    json!({ "theta_i_deg": row.theta_deg, "albedo": row.seen[4], "components": parts, "albedo_of_light": row.sent[4] })
}

/// What is not shown sends nothing back.
fn shown(bsdf: &PearlBsdf, mut parts: [[f64; 3]; 4]) -> Albedo {
    let shown = bsdf.controls().components;
    for (part, shown) in parts.iter_mut().zip([shown.diffuse, shown.incoherent, shown.mirror, shown.blur]) {
        if !shown {
            *part = [0.0; 3];
        }
    }
    let [diffuse, incoherent, mirror, blur] = parts;
    let sum = std::array::from_fn(|c| diffuse[c] + incoherent[c] + mirror[c] + blur[c]);
    [diffuse, incoherent, mirror, blur, sum]
}
