//! A table baked again from its own metadata, and what is not the same bit for bit.
//!
//! The metadata hold the whole recipe, the seed, the solver and its settings, the incidences and the paths walked at
//! each, so that nothing else is needed. A bake to an accuracy goes through its decisions again; one to a time walks
//! the paths that the table says it holds.

use super::grid::{MOST_RAISED, MOST_REFINEMENTS};
use super::sampling::{Sampling, Shard};
use super::{BakeError, Grid, NEVER, Observer, Request, assemble};
use crate::effects::{Effect, EffectSet, Effects};
use crate::options::{DEFAULT_EVENT_CAP, Options, Sides, SolverChoice, Target};
use crate::recipe::Recipe;
use crate::tally::MAX_PATHS;
use lut_io::dispersion;
use lut_io::solver::{self, Solver, SolverSettings, Walk};
use lut_io::table::{Component, IncidenceSummary, Lobe, Meta, Table};
use serde::Serialize;
use serde_json::Value;
use std::time::Duration;
use transport::walk::lanes::Precision;

/// One place where two tables are not the same.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Difference {
    /// Key of the metadata (`per_incidence[3].albedo`) or channel (`channel interior_std_error`).
    pub field: String,
    /// What the first table holds.
    pub stored: String,
    /// What the second holds.
    pub again: String,
}

/// The request that makes this table again.
///
/// # Errors
/// Metadata that no bake of this version writes; the line names the key.
pub fn request(meta: &Meta) -> Result<Request, BakeError> {
    let recipe = Recipe::from_json(&meta.recipe.to_string())
        .map_err(|why| BakeError::Input(format!("recipe in the metadata: {why}")))?;
    let walked = meta.solver == Solver::Walk;
    let (precision, event_cap) = match &meta.solver_settings {
        SolverSettings::Walk(walk) => (exactly(walk.precision), walk.event_cap),
        _ => (Precision::Auto, DEFAULT_EVENT_CAP),
    };
    for at in meta.per_incidence.iter().filter(|_| walked) {
        if !(1..=MAX_PATHS).contains(&at.paths) {
            return Err(paths_refused(at, &format!("1 to {} in a walked table", MAX_PATHS)));
        }
    }
    let effect = |name: &String| {
        let unknown = || BakeError::Input(format!("effects: {name:?} is not an effect of this version"));
        Effect::from_name(name).ok_or_else(unknown)
    };
    let mut effects = meta.effects.iter().map(effect).collect::<Result<EffectSet, _>>()?;
    if meta.spectra_missing.is_some() {
        // Colours that this stack could not have were asked for by its look.
        effects = effects.union(EffectSet::by_look(&recipe));
    }
    let options = Options {
        cells: None,
        effects: Effects::Look,
        azimuth: None,
        incident_deg: None,
        target: target(meta)?,
        solver: Some(if walked { SolverChoice::Walk } else { SolverChoice::Doubling }),
        seed: meta.seed,
        event_cap,
        precision,
        sides: if meta.both_sides.is_some() { Sides::Both } else { Sides::Above },
    };
    options.check()?;
    let incident_deg = meta.per_incidence.iter().map(|at| at.theta_i_deg).collect();
    let [refinements, raised] = match &meta.solver_settings {
        SolverSettings::Doubling(doubling) => [doubling.refinements, doubling.raised],
        _ => [0, 0],
    };
    let grid = Grid {
        incident_deg,
        axis: meta.exit_axis,
        refinements: refinements.min(MOST_REFINEMENTS),
        raised: raised.min(MOST_RAISED),
    };
    Ok(Request { recipe, effects, options, grid, placed_by: Vec::new(), placing_seconds: 0.0 })
}

const fn exactly(precision: solver::Precision) -> Precision {
    match precision {
        solver::Precision::F32 => Precision::F32,
        solver::Precision::F64 => Precision::F64,
    }
}

fn paths_refused(at: &IncidenceSummary, right: &str) -> BakeError {
    let (theta, paths) = (at.theta_i_deg, at.paths);
    BakeError::Input(format!("per_incidence at {theta}°: paths is {paths}; expected {right}"))
}

/// What the bake was asked for: an accuracy, a time, or else equally many paths everywhere.
fn target(meta: &Meta) -> Result<Target, BakeError> {
    if let Some(percent) = meta.accuracy.asked_percent {
        return Ok(Target::AccuracyPercent(percent));
    }
    if let SolverSettings::Walk(Walk { time_budget_seconds: Some(seconds), .. }) = meta.solver_settings {
        let budget = Duration::try_from_secs_f64(seconds);
        return budget.map(Target::Time).map_err(|_| {
            BakeError::Input(format!(
                "solver_settings.time_budget_seconds: {seconds} is longer than a bake can take"
            ))
        });
    }
    // A table without a lobe walked no paths; any number does.
    let paths = meta.per_incidence[0].paths.max(1);
    match meta.per_incidence.iter().find(|at| at.paths.max(1) != paths) {
        Some(at) => {
            Err(paths_refused(at, &format!("{paths} as at the first incidence, without accuracy or time")))
        }
        None => Ok(Target::Paths(paths)),
    }
}

/// Bakes a table again from its metadata.
///
/// # Errors
/// As [`request`], and those of the bake.
pub fn bake_again(meta: &Meta, observer: &Observer<'_>) -> Result<Table, BakeError> {
    let table = bake_as_walked(meta, observer)?;
    if meta.reciprocal.is_some() { super::reciprocal(&table) } else { Ok(table) }
}

fn bake_as_walked(meta: &Meta, observer: &Observer<'_>) -> Result<Table, BakeError> {
    let request = request(meta)?;
    let bands = request.bands()?;
    if meta.solver == Solver::Doubling {
        return super::doubling(&request, &bands);
    }
    if !matches!(request.options.target, Target::Time(_)) {
        return super::walk(&request, &bands, observer, None);
    }
    // A time gives other path counts every time: those of the table are walked.
    let further =
        meta.dispersion.iter().flat_map(|section| &section.bands).flat_map(|band| &band.per_incidence);
    let paths: Vec<u64> = meta.per_incidence.iter().chain(further).map(|at| at.paths).collect();
    let mut sampling = Sampling::of(&request, &bands, Shard::WHOLE)?;
    sampling.walk_to(&paths, observer)?;
    assemble::walk_table(&request, &bands, &sampling, &request.colours(&NEVER)?)
}

/// Every key of the metadata and every channel in which two tables are not the same bit for bit.
#[must_use]
pub fn differences(stored: &Table, again: &Table) -> Vec<Difference> {
    let mut found = Vec::new();
    let as_json = |meta: &Meta| serde_json::to_value(meta).unwrap_or_default();
    compare_json("", &as_json(stored.meta()), &as_json(again.meta()), &mut found);
    for component in Component::ALL {
        compare_lobes(component.name(), stored, stored.lobe(component), again.lobe(component), &mut found);
    }
    for (band, (one, other)) in stored.bands().iter().zip(again.bands()).enumerate() {
        for (i, component) in Component::ALL.into_iter().enumerate() {
            let name = dispersion::channel_name(component.name(), band);
            compare_lobes(&name, stored, &one[i], &other[i], &mut found);
        }
    }
    found
}

fn compare_json(field: &str, stored: &Value, again: &Value, found: &mut Vec<Difference>) {
    let below = |key: &str| if field.is_empty() { key.to_owned() } else { format!("{field}.{key}") };
    match (stored, again) {
        (Value::Object(a), Value::Object(b)) => {
            for (key, value) in a {
                compare_json(&below(key), value, b.get(key).unwrap_or(&Value::Null), found);
            }
            for (key, value) in b.iter().filter(|(key, _)| !a.contains_key(*key)) {
                compare_json(&below(key), &Value::Null, value, found);
            }
        }
        (Value::Array(a), Value::Array(b)) if a.len() == b.len() => {
            for (index, (a, b)) in a.iter().zip(b).enumerate() {
                compare_json(&format!("{field}[{index}]"), a, b, found);
            }
        }
        _ if stored == again => (),
        _ => found.push(Difference { field: field.to_owned(), stored: brief(stored), again: brief(again) }),
    }
}

/// A JSON value short enough for a line.
fn brief(value: &Value) -> String {
    const MOST: usize = 60;
    let text = value.to_string();
    if text.chars().count() <= MOST { text } else { text.chars().take(MOST).chain(['…']).collect() }
}

fn compare_lobes(name: &str, table: &Table, stored: &Lobe, again: &Lobe, found: &mut Vec<Difference>) {
    let pairs = [
        (name.to_owned(), &stored.value, &again.value),
        (format!("{name}_std_error"), &stored.std_error, &again.std_error),
        (format!("{name}_count"), &stored.count, &again.count),
    ];
    for (channel, a, b) in pairs {
        let field = format!("channel {channel}");
        if a.len() != b.len() {
            let cells = |samples: &[f32]| format!("{} cells", samples.len());
            found.push(Difference { field, stored: cells(a), again: cells(b) });
            continue;
        }
        let differing = |(a, b): (&f32, &f32)| a.to_bits() != b.to_bits();
        let Some(first) = a.iter().zip(b).position(differing) else { continue };
        let count = a.iter().zip(b).filter(|&(a, b)| differing((a, b))).count();
        let per_incidence = table.meta().exit_axis.cells();
        let theta_i = table.meta().per_incidence[first / per_incidence].theta_i_deg;
        let cell = first % per_incidence;
        found.push(Difference {
            field: format!("{field}, {count} of {} cells, first at {theta_i}° cell {cell}", a.len()),
            stored: a[first].to_string(),
            again: b[first].to_string(),
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake;

    fn baked(target: Target, incident_deg: &[f64]) -> Table {
        let recipe = Recipe::from_json(r#"{"stack":{"layers":6}}"#).unwrap();
        let incident_deg = Some(incident_deg.to_vec());
        let options = Options { incident_deg, target, seed: 5, event_cap: 1000, ..Options::default() };
        let request = Request::new(recipe, options).unwrap();
        bake::walk(&request, &request.bands().unwrap(), &Observer::idle(), None).unwrap()
    }

    fn again(table: &Table) -> Vec<Difference> {
        differences(table, &bake_again(table.meta(), &Observer::idle()).unwrap())
    }

    #[test]
    fn a_walk_to_any_target_is_made_again_from_its_metadata() {
        for target in
            [Target::Paths(50_001), Target::AccuracyPercent(2.0), Target::Time(Duration::from_millis(300))]
        {
            assert_eq!(again(&baked(target, &[0.0, 30.0, 80.0])), [], "{target:?}");
        }
    }

    #[test]
    fn what_differs_is_named_by_key_and_by_channel() {
        let mut parts = baked(Target::Paths(9000), &[10.0, 70.0]).into_parts();
        let cells = parts.meta.exit_axis.cells();
        let values = &mut parts.lobes[0].value;
        let at = cells + values[cells..].iter().position(|value| *value > 0.0).unwrap();
        values[at] = values[at].next_up();
        parts.meta.per_incidence[1].skew_theta_o += 1e-9;
        let table = Table::new(parts).unwrap();
        let found = again(&table);
        let fields: Vec<&str> = found.iter().map(|difference| difference.field.as_str()).collect();
        let channel = format!("channel interior, 1 of {} cells, first at 70° cell {}", 2 * cells, at - cells);
        assert_eq!(fields, ["per_incidence[1].skew_theta_o", &channel]);
        let table = specimen::changed(&table, |parts| parts.meta.seed = 6);
        assert!(again(&table).len() > 10, "another seed differs nearly everywhere");
    }

    #[test]
    fn metadata_that_cannot_be_baked_are_refused_by_key() {
        let table = baked(Target::Paths(5000), &[10.0]);
        let refusal = |change: &dyn Fn(&mut Meta)| {
            let mut meta = table.meta().clone();
            change(&mut meta);
            request(&meta).unwrap_err().to_string()
        };
        assert!(refusal(&|meta| meta.recipe["stack"]["layers"] = "six".into()).contains("stack.layers"));
        let walk = |meta: &mut Meta, change: &dyn Fn(&mut Walk)| match &mut meta.solver_settings {
            SolverSettings::Walk(walk) => change(walk),
            other => panic!("{other:?}"),
        };
        assert!(refusal(&|meta| walk(meta, &|walk| walk.event_cap = 0)).contains("event_cap: 0"));
        let long = |walk: &mut Walk| walk.time_budget_seconds = Some(1e300);
        assert!(refusal(&|meta| walk(meta, &long)).contains("time_budget_seconds"));
        assert!(refusal(&|meta| meta.per_incidence[0].paths = u64::MAX).contains("paths is"));
        assert!(refusal(&|meta| meta.effects.push("glitter".to_owned())).contains("effects: \"glitter\""));
    }
}
