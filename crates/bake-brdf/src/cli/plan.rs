//! `bake-brdf plan`.

use super::args::{self, OptionsArgs};
use super::errors::refuse;
use super::progress::seconds_text;
use bake_brdf::plan::Plan;
use std::fmt::Write as _;
use std::path::PathBuf;
use terminal::{Manners, Outcome};

#[derive(clap::Args, Clone, Debug)]
pub(crate) struct PlanArgs {
    /// Recipe: a file (JSON, - for stdin) or the name of a built-in one, such as akoya [default: the paper's pearl].
    recipe: Option<PathBuf>,
    #[command(flatten)]
    options: OptionsArgs,
}

/// Runs the command.
pub(crate) fn run(args: &PlanArgs, manners: &Manners) -> Outcome {
    let pool = manners.pool()?;
    let (recipe, from) = args::recipe(args.recipe.as_deref())?;
    let options = args.options.options()?;
    let plan =
        pool.install(|| Plan::of_recipe(recipe, &from, &options)).map_err(|error| refuse(error.why))?;
    if manners.json {
        return terminal::print_json(&plan.report());
    }
    terminal::print(&table(&plan))
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
