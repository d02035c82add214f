//! The plan of a bake: which effects each pearl calls for, which tables hold them, and what that costs.
//!
//! Pearls of one recipe that show the same effects share a table.

use crate::bake::{self, BakeError, Bands, NEVER, Observer, Request};
use crate::effects::{Decision, Decisions, Effect, EffectError, EffectSet, Setting, View};
use crate::options::{Options, SolverChoice};
use crate::prices;
use crate::recipe::{AzimuthMode, Recipe};
use crate::spectra::{self, Wanted};
use serde::Serialize;
use serde_json::{Map, Value, json};

/// Why the effects of a pearl that no shape shows are off.
const UNUSED: &str = "no shape shows this pearl";

/// What something costs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Cost {
    /// Wall-clock seconds with the threads in use.
    pub seconds: f64,
    /// Bytes in the file.
    pub bytes: u64,
}

impl std::ops::Add for Cost {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self { seconds: self.seconds + other.seconds, bytes: self.bytes + other.bytes }
    }
}

/// A pearl of a scene, as it is looked at.
#[derive(Clone, Debug)]
pub struct ScenePearl {
    /// Its name.
    pub id: String,
    /// Where it stands: `file:line`.
    pub place: String,
    /// The shapes that show it, each as `type (file:line)`.
    pub shapes: Vec<String>,
    /// Whether it is shown; nothing is baked for one that is not.
    pub used: bool,
    /// What it is made of, and where that was found.
    pub recipe: Setting<Recipe>,
    /// How it is looked at.
    pub view: View,
}

/// One pearl's part of a plan.
#[derive(Clone, Debug)]
pub struct PlannedPearl {
    /// Its name: the scene's `id`, or the recipe's name.
    pub id: String,
    /// Where it stands in the scene; the recipe's file for a plan without a scene.
    pub place: String,
    /// Shapes that show it.
    pub shapes: Vec<String>,
    /// What it is made of.
    pub recipe: Recipe,
    /// Where that was found.
    pub recipe_from: String,
    /// How it is looked at.
    pub view: View,
    /// Its effects and why.
    pub decisions: Decisions,
    /// What each effect costs, in the model's order; 0 for one that is off, or that another pearl's table holds anyway.
    pub costs: [Cost; Effect::ALL.len()],
    /// The table that holds it, an index of [`Plan::tables`]; `None` for a pearl that no shape shows.
    pub table: Option<usize>,
}

/// One table to bake.
#[derive(Clone, Debug)]
pub struct PlannedTable {
    /// What is baked.
    pub request: Request,
    /// Where its lobe is solved.
    pub bands: Bands,
    /// Who solves.
    pub solver: SolverChoice,
    /// What it costs in all.
    pub cost: Cost,
}

/// A plan.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Pearls, in the order of the scene.
    pub pearls: Vec<PlannedPearl>,
    /// Tables, in the order of the pearls that first need them.
    pub tables: Vec<PlannedTable>,
}

/// Why there is no plan.
#[derive(Debug, thiserror::Error)]
#[error("{place}{why}")]
pub struct PlanError {
    /// Which pearl of a scene, followed by `: `; empty without a scene.
    pub place: String,
    /// What stands in the way of its bake.
    #[source]
    pub why: BakeError,
}

impl Plan {
    /// The plan of one recipe, looked at as its own look says.
    ///
    /// # Errors
    /// What the bake would refuse.
    pub fn of_recipe(recipe: Recipe, from: &str, options: &Options) -> Result<Self, PlanError> {
        let view = View::of_look(&recipe.look);
        let pearl = PlannedPearl::new(recipe, from, &view, options)?;
        Self::tabled(vec![(pearl, true)], options)
    }

    /// The plan of a scene's pearls.
    ///
    /// # Errors
    /// What a bake would refuse.
    pub fn of_pearls(pearls: Vec<ScenePearl>, options: &Options) -> Result<Self, PlanError> {
        let planned = |pearl: ScenePearl| {
            let ScenePearl { id, place, shapes, used, recipe, view } = pearl;
            let planned = PlannedPearl::new(recipe.value, &recipe.from, &view, options)?;
            Ok((PlannedPearl { id, place, shapes, ..planned }, used))
        };
        let pearls: Result<Vec<_>, PlanError> = pearls.into_iter().map(planned).collect();
        Self::tabled(pearls?, options)
    }

    /// Puts pearls of one recipe and one set of effects into one table, and finds the costs.
    fn tabled(pearls: Vec<(PlannedPearl, bool)>, options: &Options) -> Result<Self, PlanError> {
        let mut plan = Self { pearls: Vec::new(), tables: Vec::new() };
        for (mut pearl, used) in pearls {
            if used {
                let set = pearl.decisions.set();
                // A texture is the renderer's: no table holds it.
                let stored = |effects: EffectSet| effects.without(Effect::Texture);
                let same = |table: &PlannedTable| {
                    table.request.recipe == pearl.recipe && stored(table.request.effects) == stored(set)
                };
                let index = plan.tables.iter().position(same).unwrap_or(plan.tables.len());
                if index == plan.tables.len() {
                    plan.tables.push(PlannedTable {
                        bands: Bands::own(&pearl.recipe),
                        request: Request::of(pearl.recipe.clone(), set, options.clone())
                            .map_err(|why| PlanError { place: String::new(), why })?,
                        solver: SolverChoice::Walk,
                        cost: Cost::default(),
                    });
                }
                pearl.table = Some(index);
            }
            plan.pearls.push(pearl);
        }
        for (index, table) in plan.tables.iter_mut().enumerate() {
            // Each table is paid for once, by the first pearl that shows it.
            let Some(first) = plan.pearls.iter_mut().find(|pearl| pearl.table == Some(index)) else {
                continue;
            };
            let named = |why: BakeError| {
                let scene = first.place != first.recipe_from;
                let place =
                    if scene { format!("{}: pearl {:?}: ", first.place, first.id) } else { String::new() };
                PlanError { place, why }
            };
            table.bands = table.request.bands().map_err(named)?;
            table.solver = bake::solver(&table.request, &table.bands).map_err(named)?;
            let costs = costs(&table.request, &table.bands, table.solver).map_err(named)?;
            table.cost = costs.iter().copied().fold(Cost::default(), |sum, cost| sum + cost);
            for effect in first.decisions.set().iter() {
                first.costs[effect as usize] = costs[effect as usize];
            }
        }
        Ok(plan)
    }

    /// What all tables cost.
    #[must_use]
    pub fn cost(&self) -> Cost {
        self.tables.iter().fold(Cost::default(), |sum, table| sum + table.cost)
    }

    /// The plan as JSON, schema `bake-plan/1`.
    #[must_use]
    pub fn report(&self) -> Value {
        let pearl = |pearl: &PlannedPearl| {
            let effect = |decision: &Decision| {
                let cost = pearl.costs[decision.effect as usize];
                let used = pearl.table.is_some();
                let value = json!({
                    "on": decision.on && used,
                    "why": if used { decision.why.as_str() } else { UNUSED },
                    "seconds": cost.seconds,
                    "bytes": cost.bytes,
                });
                (decision.effect.name().to_owned(), value)
            };
            json!({
                "id": pearl.id,
                "used": pearl.table.is_some(),
                "place": pearl.place,
                "shapes": pearl.shapes,
                "recipe": pearl.recipe.to_json(),
                "recipe_from": pearl.recipe_from,
                "azimuth": pearl.recipe.azimuth.mode,
                "table": pearl.table,
                "effects": pearl.decisions.all().iter().map(effect).collect::<Map<String, Value>>(),
            })
        };
        let tables: Vec<Value> = self
            .tables
            .iter()
            .map(|table| {
                json!({
                    "recipe": table.request.recipe.name,
                    "effects": table.request.effects.names(),
                    "solver": table.solver.name(),
                    "seconds": table.cost.seconds,
                    "bytes": table.cost.bytes,
                })
            })
            .collect();
        let cost = self.cost();
        json!({
            "schema": "bake-plan/1",
            "pearls": self.pearls.iter().map(pearl).collect::<Vec<_>>(),
            "tables": tables,
            "seconds": cost.seconds,
            "bytes": cost.bytes,
        })
    }
}

impl PlannedPearl {
    /// A pearl without a scene, its costs and table not yet known.
    fn new(recipe: Recipe, from: &str, view: &View, options: &Options) -> Result<Self, PlanError> {
        let refuse = |why: EffectError| PlanError { place: String::new(), why: why.into() };
        let (recipe, decisions) = options.decide(recipe, view).map_err(refuse)?;
        Ok(Self {
            id: recipe.name.clone(),
            place: from.to_owned(),
            shapes: Vec::new(),
            recipe,
            recipe_from: from.to_owned(),
            view: view.clone(),
            decisions,
            costs: [Cost::default(); Effect::ALL.len()],
            table: None,
        })
    }
}

/// What each effect of a request costs: the bake with it less the bake without it, the lobe's rest under `blur` (under
/// `surface` where there is no blur). In the order of [`Effect::ALL`].
///
/// # Errors
/// As the bake's own checks.
pub fn costs(
    request: &Request,
    bands: &Bands,
    solver: SolverChoice,
) -> Result<[Cost; Effect::ALL.len()], BakeError> {
    let mut costs = [Cost::default(); Effect::ALL.len()];
    let set = request.effects;
    let file = Cost { seconds: prices::OVERHEAD_SECONDS, bytes: prices::HEADER_BYTES };
    let body = if set.has_lobe() { Effect::Surface } else { Effect::Body };
    costs[body as usize] = file;
    interference_costs(request, &mut costs);
    if set.has_lobe() {
        let whole = lobe_cost(request, bands, solver)?;
        let mut left = whole;
        let mut take = |effect: Effect, without: Request, bands: &Bands| {
            let without = lobe_cost(&without, bands, solver)?;
            let part = Cost {
                seconds: (whole.seconds - without.seconds).clamp(0.0, left.seconds),
                bytes: whole.bytes.saturating_sub(without.bytes).min(left.bytes),
            };
            left = Cost { seconds: left.seconds - part.seconds, bytes: left.bytes - part.bytes };
            costs[effect as usize] = costs[effect as usize] + part;
            Ok::<(), BakeError>(())
        };
        if set.contains(Effect::Absorption) {
            let without = Request { effects: set.without(Effect::Absorption), ..request.clone() };
            // Clear layers may call for other bands.
            take(Effect::Absorption, without.clone(), &without.bands()?)?;
        }
        if set.contains(Effect::Dispersion) {
            let without = Request { effects: set.without(Effect::Dispersion), ..request.clone() };
            take(Effect::Dispersion, without, &Bands::own(&request.recipe))?;
        }
        if set.contains(Effect::Azimuth) && request.recipe.azimuth.mode == AzimuthMode::Space {
            let mut plane = request.recipe.clone();
            plane.azimuth.mode = AzimuthMode::Decay;
            let plane = Request::of(plane, set, request.options.clone())?;
            // Bands are chosen in the plane anyway.
            take(Effect::Azimuth, plane, bands)?;
        }
        let rest = if set.contains(Effect::Blur) { Effect::Blur } else { Effect::Surface };
        costs[rest as usize] = costs[rest as usize] + left;
    }
    Ok(costs)
}

/// Adds what the interference colours cost; of it, what irregular thicknesses add is `irregularity`'s.
fn interference_costs(request: &Request, costs: &mut [Cost; Effect::ALL.len()]) {
    let set = request.effects;
    let threads = rayon::current_num_threads() as f64;
    let seconds = |set: EffectSet| {
        let wanted = Wanted::by_effects(set, false);
        let accuracy = request.colour_accuracy();
        spectra::forecast(&NEVER, &request.recipe, wanted, accuracy).map(|seconds| seconds / threads)
    };
    let fixed = set.without(Effect::Thickness);
    let whole = seconds(fixed);
    let regular = seconds(fixed.without(Effect::Irregularity));
    if set.contains(Effect::Thickness) {
        let more = seconds(set).iter().sum::<f64>() - whole.iter().sum::<f64>();
        let colours = [Effect::Coherent, Effect::Emission].into_iter().zip(prices::SCALED_BYTES);
        let bytes = colours.filter(|(effect, _)| set.contains(*effect)).map(|(_, bytes)| bytes).sum();
        costs[Effect::Thickness as usize] = Cost { seconds: more.max(0.0), bytes };
    }
    for (i, effect) in [Effect::Coherent, Effect::Emission].into_iter().enumerate() {
        if set.contains(effect) {
            let own = whole[i].min(regular[i]);
            costs[effect as usize] = Cost { seconds: own, bytes: prices::SPECTRUM_BYTES[i] };
            costs[Effect::Irregularity as usize].seconds += whole[i] - own;
        }
    }
}

/// What the lobe costs: the walk from a pilot, doubling from its operation count.
fn lobe_cost(request: &Request, bands: &Bands, solver: SolverChoice) -> Result<Cost, BakeError> {
    let forecast = bake::lobe_forecast(request, bands, solver, &Observer::idle())?;
    let cells = forecast.cells as f64;
    let each =
        if solver == SolverChoice::Doubling { prices::DOUBLING_CELL_BYTES } else { prices::WALK_CELL_BYTES };
    let bytes = prices::INCIDENCE_BYTES * request.grid.incident_deg.len() as u64 + (cells * each) as u64;
    Ok(Cost { seconds: forecast.seconds, bytes })
}
