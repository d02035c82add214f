//! `pearl furnace`: how much of the light of a white surrounding the pearl sends back.

use crate::args::FurnaceArgs;
use pearl_bsdf::{Components, PearlBsdf};
use rayon::prelude::*;
use serde_json::{Value, json};
use terminal::{Outcome, Stop};

/// Directional albedo above 1 that passes: quadrature and interpolation errors.
const TOLERANCE: f64 = 1e-4;

/// Directional albedo at one incidence: rows of linear sRGB, the components and then their sum.
type Albedo = [[f64; 3]; 5];

pub(crate) fn run(args: &FurnaceArgs, json: bool) -> Outcome {
    let bsdf = args.pearl.bsdf()?;
    let steps = args.steps;
    // At 90° nothing is evaluated: the last step stops a little before.
    let thetas: Vec<f64> = (0..=steps).map(|i| (90.0 * f64::from(i) / f64::from(steps)).min(89.99)).collect();
    let albedos: Vec<Albedo> = thetas.par_iter().map(|theta| albedo(&bsdf, theta.to_radians())).collect();
    let worst = albedos.iter().flat_map(|albedo| albedo[4]).fold(0.0, f64::max);
    if json {
        let rows: Vec<Value> =
            thetas.iter().zip(&albedos).map(|(theta, albedo)| describe(*theta, albedo)).collect();
        terminal::print_json(&json!({
            "schema": "pearl-furnace/1", "lut": args.pearl.table.display().to_string(), "tolerance": TOLERANCE,
            "largest_albedo": worst, "pass": worst <= 1.0 + TOLERANCE, "per_incidence": rows,
        }))?;
    } else {
        let mut text = String::from(
            "theta_i_deg  albedo r      g        b     | diffuse  incoherent mirror   blur (g)\n",
        );
        for (theta, [d, i, m, b, sum]) in thetas.iter().zip(&albedos) {
            text += &format!(
                "{theta:9.2}   {:8.5} {:8.5} {:8.5}  | {:8.5} {:8.5} {:8.5} {:8.5}\n",
                sum[0], sum[1], sum[2], d[1], i[1], m[1], b[1]
            );
        }
        terminal::print(&text)?;
    }
    if worst > 1.0 + TOLERANCE {
        let table = args.pearl.table.display();
        return Err(Stop::check_failed(format!(
            "{table}: the directional albedo reaches {worst}, expected at most {}",
            1.0 + TOLERANCE
        )));
    }
    Ok(())
}

fn describe(theta_deg: f64, albedo: &Albedo) -> Value {
    let parts: serde_json::Map<String, Value> =
        Components::NAMES.into_iter().zip(albedo).map(|(name, rgb)| (name.to_owned(), json!(rgb))).collect();
    json!({ "theta_i_deg": theta_deg, "albedo": albedo[4], "components": parts })
}

/// What is not shown sends nothing back.
fn albedo(bsdf: &PearlBsdf, theta_i: f64) -> Albedo {
    let shown = bsdf.controls().components;
    let mut parts = bsdf.directional_albedo(theta_i);
    for (part, shown) in parts.iter_mut().zip([shown.diffuse, shown.incoherent, shown.mirror, shown.blur]) {
        if !shown {
            *part = [0.0; 3];
        }
    }
    let [diffuse, incoherent, mirror, blur] = parts;
    let sum = std::array::from_fn(|c| diffuse[c] + incoherent[c] + mirror[c] + blur[c]);
    [diffuse, incoherent, mirror, blur, sum]
}
