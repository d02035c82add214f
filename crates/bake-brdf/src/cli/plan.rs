//! `bake-brdf plan`.

use super::args::{self, OptionsArgs, SceneArgs};
use super::errors::refuse_plan;
use super::progress::seconds_text;
use bake_brdf::plan::{Plan, UNUSED};
use std::fmt::Write as _;
use std::path::PathBuf;
use terminal::{Manners, Outcome};

#[derive(clap::Args, Clone, Debug)]
pub(crate) struct PlanArgs {
    /// Recipe: a file (JSON, - for stdin) or the name of a built-in one, such as akoya [default: the paper's pearl].
    #[arg(conflicts_with = "scene")]
    recipe: Option<PathBuf>,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    options: OptionsArgs,
    /// Also bake each pearl with every effect switched the other way, and say what that changes in a picture and what it costs.
    #[arg(long)]
    why_not: bool,
}

/// Runs the command.
pub(crate) fn run(args: &PlanArgs, manners: &Manners) -> Outcome {
    let pool = manners.pool()?;
    let plan = match &args.scene.scene {
        Some(path) => {
            let scene = args.scene.read(path)?;
            let options = args.options.options()?;
            pool.install(|| Plan::of_scene(&scene, &options))
        }
        None => {
            let (recipe, from) = args::recipe(args.recipe.as_deref())?;
            let options = args.options.options()?;
            pool.install(|| Plan::of_recipe(recipe, &from, &options))
        }
    };
    let plan = plan.map_err(refuse_plan)?;
    let why_not = args.why_not.then(|| pool.install(|| super::why_not::report(&plan))).transpose()?;
    if manners.json {
        let mut report = plan.report();
        if let Some((differences, _)) = why_not {
            report["why_not"] = differences;
        }
        return terminal::print_json(&report);
    }
    let text = table(&plan) + &why_not.map_or_else(String::new, |(_, text)| format!("\n{text}"));
    terminal::print(&text)
}

/// The plan for people: a table a pearl.
fn table(plan: &Plan) -> String {
    let mut text = String::new();
    for pearl in &plan.pearls {
        let _ = writeln!(
            text,
            "{} ({}): {} from {}",
            pearl.id, pearl.place, pearl.recipe.name, pearl.recipe_from
        );
        if pearl.table.is_none() {
            let _ = writeln!(text, "  unused: {UNUSED}; nothing is baked for it\n");
            continue;
        }
        if !pearl.shapes.is_empty() {
            let _ = writeln!(text, "  shown by {}", pearl.shapes.join(", "));
        }
        text.push_str("  effect           on   seconds      bytes  why\n");
        for decision in pearl.decisions.all() {
            let cost = pearl.costs[decision.effect as usize];
            let (seconds, bytes) = if decision.on {
                (format!("{:.3}", cost.seconds), cost.bytes.to_string())
            } else {
                (String::new(), String::new())
            };
            let on = if decision.on { "on" } else { "–" };
            let _ = writeln!(
                text,
                "  {:<15}  {on:<3} {seconds:>8} {bytes:>10}  {}",
                decision.effect.name(),
                decision.why
            );
        }
        text.push('\n');
    }
    if plan.tables.is_empty() {
        text.push_str("no pearl is shown: nothing to bake\n");
        return text;
    }
    for table in &plan.tables {
        let _ = writeln!(
            text,
            "table of {}: {} by {}, about {}, {:.0} kB",
            table.request.recipe.name,
            table.request.effects.names().join(", "),
            table.solver.name(),
            seconds_text(table.cost.seconds),
            table.cost.bytes as f64 / 1e3,
        );
    }
    text
}
