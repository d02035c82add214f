//! What each effect of a plan changes in a picture, and what it costs.
//!
//! The picture is a sphere under one distant light and a white surrounding, without noise: the BSDF is evaluated for the light,
//! and its directional albedo stands for the surrounding.

use bake_brdf::bake::{self, BakeError, Observer, Request};
use bake_brdf::effects::{self, Effect, EffectSet, View};
use bake_brdf::options::Options;
use bake_brdf::plan::{self, Cost, Plan, PlannedPearl};
use lut_io::table::Table;
use pearl_bsdf::{Components, Controls, PearlBsdf};
use serde_json::{Value, json};
use thinfilm::colour;

/// Pixels along a side of the picture.
const SIDE: usize = 40;
/// Irradiance of the light, and direction to it (the viewer is at z).
const LIGHT: f64 = 2.0;
const TO_LIGHT: [f64; 3] = [-0.45, 0.55, 0.703_562_363_974];
/// Radiance of the surrounding.
const FILL: f64 = 0.4;

/// One effect, switched the other way.
struct Difference {
    effect: Effect,
    /// Whether the plan has it.
    on: bool,
    /// What cannot be shown, or else mean ΔE00 and the relative RMSE of the picture with and without it.
    changes: Result<(f64, f64), String>,
    /// What it costs, or would cost.
    cost: Cost,
}

/// The differences of every pearl that is shown.
pub(crate) fn report(plan: &Plan, observer: &Observer<'_>) -> Result<Value, BakeError> {
    let mut list = Vec::new();
    for pearl in &plan.pearls {
        let Some(table) = pearl.table.map(|table| &plan.tables[table]) else { continue };
        let mut effects = serde_json::Map::new();
        for Difference { effect, on, changes, cost } in differences(pearl, &table.request.options, observer)?
        {
            let entry = json!({
                "on": on,
                "delta_e": changes.as_ref().ok().map(|(delta_e, _)| delta_e),
                "relative_rmse": changes.as_ref().ok().map(|(_, rmse)| rmse),
                "seconds": cost.seconds,
                "bytes": cost.bytes,
                "not_shown": changes.err(),
            });
            effects.insert(effect.name().to_owned(), entry);
        }
        list.push(json!({ "id": pearl.id, "effects": effects }));
    }
    Ok(Value::Array(list))
}

fn differences(
    pearl: &PlannedPearl,
    options: &Options,
    observer: &Observer<'_>,
) -> Result<Vec<Difference>, BakeError> {
    let planned = pearl.decisions.set();
    let here = Shown::new(pearl, planned, options, observer)?;
    let mut differences = Vec::new();
    for effect in Effect::ALL {
        let on = planned.contains(effect);
        let other = if on { without(planned, effect) } else { planned.with(effect) };
        let nothing = |why: String| Difference { effect, on, changes: Err(why), cost: Cost::default() };
        if let Some(why) = not_shown(effect, on, pearl) {
            differences.push(nothing(why));
            continue;
        }
        let there = Shown::new(pearl, other, options, observer)?;
        let (with, less) = if on { (&here, &there) } else { (&there, &here) };
        differences.push(Difference {
            effect,
            on,
            changes: Ok(compare(&with.picture, &less.picture)),
            cost: Cost {
                seconds: (with.cost.seconds - less.cost.seconds).max(0.0),
                bytes: with.cost.bytes.saturating_sub(less.cost.bytes),
            },
        });
    }
    Ok(differences)
}

/// The set without an effect, and without those that cannot be without it.
fn without(set: EffectSet, effect: Effect) -> EffectSet {
    let blur = [Effect::Azimuth, Effect::Absorption, Effect::Polarisation, Effect::CoherentSheets];
    let set = set.without(effect);
    match effect {
        Effect::Blur => blur.into_iter().fold(set, EffectSet::without),
        // What does not pass the surface does not come back.
        Effect::Surface => {
            blur.into_iter().fold(set.without(Effect::Blur).without(Effect::Coherent), EffectSet::without)
        }
        _ => set,
    }
}

/// Why a picture cannot show what an effect changes.
fn not_shown(effect: Effect, on: bool, pearl: &PlannedPearl) -> Option<String> {
    match effect {
        Effect::Texture => Some("a texture costs no data; the picture has none".to_owned()),
        Effect::Thickness => Some("the picture is of the recipe's own thickness".to_owned()),
        Effect::Azimuth if on => Some("the blur has an azimuth always; the recipe chooses which".to_owned()),
        _ if on => None,
        Effect::Azimuth | Effect::Polarisation | Effect::CoherentSheets
            if !pearl.decisions.get(Effect::Blur).on =>
        {
            Some("it acts on blur alone, which is off".to_owned())
        }
        _ => effects::available(effect, &pearl.recipe).err(),
    }
}

/// A picture of a pearl with some of its effects, and what its table costs.
struct Shown {
    picture: Vec<[f64; 3]>,
    cost: Cost,
}

impl Shown {
    fn new(
        pearl: &PlannedPearl,
        effects: EffectSet,
        options: &Options,
        observer: &Observer<'_>,
    ) -> Result<Self, BakeError> {
        let effects = if effects.contains(Effect::Blur) {
            effects.with(Effect::Surface).with(Effect::Azimuth)
        } else {
            effects
        };
        let request = Request::of(pearl.recipe.clone(), effects, options.clone())?;
        let bands = request.bands()?;
        let costs = plan::costs(&request, &bands, bake::solver(&request, &bands)?)?;
        let table = bake::bake(&request, observer)?;
        let controls = controls(&pearl.view, effects, &table);
        let bsdf = PearlBsdf::from_table(table, controls).map_err(|why| BakeError::Input(why.to_string()))?;
        Ok(Self {
            picture: picture(&bsdf, controls.components),
            cost: costs.into_iter().fold(Cost::default(), |sum, cost| sum + cost),
        })
    }
}

/// The pearl's controls, those of effects left out at 0.
fn controls(view: &View, effects: EffectSet, table: &Table) -> Controls {
    let has = |effect| if effects.contains(effect) { 1.0 } else { 0.0 };
    let recipe = Controls::of(table.meta());
    let shown = view.shown.value;
    Controls {
        depth: view.depth.value * has(Effect::Emission),
        coherence: view.coherence.value * has(Effect::Coherent),
        brightness: view.brightness.value,
        body_rgb: view.body.value.unwrap_or(recipe.body_rgb).map(|channel| channel * has(Effect::Body)),
        tint_rgb: [1.0; 3],
        thickness: 1.0,
        components: Components {
            diffuse: shown.diffuse,
            incoherent: shown.incoherent,
            mirror: shown.mirror,
            blur: shown.blur,
        },
    }
}

/// Radiance of a sphere, linear sRGB, pixels on the sphere only.
fn picture(bsdf: &PearlBsdf, components: Components) -> Vec<[f64; 3]> {
    let albedos: Vec<[f64; 3]> = (0..90)
        .map(|degrees| {
            let [diffuse, incoherent, mirror, blur] =
                bsdf.directional_albedo_seen(f64::from(degrees).to_radians());
            let shown = [
                (components.diffuse, diffuse),
                (components.incoherent, incoherent),
                (components.mirror, mirror),
                (components.blur, blur),
            ];
            std::array::from_fn(|c| shown.iter().filter(|(on, _)| *on).map(|(_, rgb)| rgb[c]).sum())
        })
        .collect();
    let mut pixels = Vec::new();
    for row in 0..SIDE {
        for column in 0..SIDE {
            let at = |i: usize| (2.0 * i as f64 + 1.0) / SIDE as f64 - 1.0;
            let (x, y) = (at(column), at(row));
            let z2 = 1.0 - x * x - y * y;
            if z2 <= 0.0 {
                continue;
            }
            let normal = [x, y, z2.sqrt()];
            let (view, light) = frame(normal);
            let direct = bsdf.eval_seen(view, light).rgb();
            let degrees = (normal[2].acos().to_degrees() as usize).min(89);
            pixels.push(std::array::from_fn(|c| LIGHT * direct[c] + FILL * albedos[degrees][c]));
        }
    }
    pixels
}

/// Directions to the viewer and the light in a frame about a normal: the view lies in its xz plane.
fn frame(normal: [f64; 3]) -> ([f64; 3], [f64; 3]) {
    let dot = |a: [f64; 3], b: [f64; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    let cos = normal[2];
    let sin = (1.0 - cos * cos).max(0.0).sqrt();
    let away = (normal[0] * normal[0] + normal[1] * normal[1]).sqrt().max(1e-12);
    // The view (0, 0, 1) less its part along the normal.
    let x = [-normal[0] * cos / away, -normal[1] * cos / away, sin];
    let y = [
        normal[1] * x[2] - normal[2] * x[1],
        normal[2] * x[0] - normal[0] * x[2],
        normal[0] * x[1] - normal[1] * x[0],
    ];
    ([sin, 0.0, cos], [dot(TO_LIGHT, x), dot(TO_LIGHT, y), dot(TO_LIGHT, normal)])
}

/// Mean ΔE00 and relative RMSE of two pictures, the first the reference.
fn compare(with: &[[f64; 3]], less: &[[f64; 3]]) -> (f64, f64) {
    let n = with.len() as f64;
    let (mut delta_e, mut square, mut mean) = (0.0, 0.0, 0.0);
    for (a, b) in with.iter().zip(less) {
        delta_e += colour::delta_e_2000(lab(*a), lab(*b)) / n;
        square += (0..3).map(|c| (a[c] - b[c]).powi(2)).sum::<f64>() / (3.0 * n);
        mean += a.iter().sum::<f64>() / (3.0 * n);
    }
    (delta_e, if mean > 0.0 { square.sqrt() / mean } else { square.sqrt() })
}

/// CIELAB of a linear sRGB radiance; white is radiance 1.
fn lab(rgb: [f64; 3]) -> [f64; 3] {
    // IEC 61966-2-1.
    const XYZ: [[f64; 3]; 3] = [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]];
    let rgb = rgb.map(|channel| channel.clamp(0.0, 1.0));
    colour::lab(XYZ.map(|row| row[0] * rgb[0] + row[1] * rgb[1] + row[2] * rgb[2]))
}
