//! `bake-brdf bake` of one recipe.

use super::args::{self, OptionsArgs};
use super::checkpoint::{Checkpoints, Keeper};
use super::errors::refuse;
use super::progress::{seconds_text, watched};
use super::say;
use bake_brdf::bake::snapshot::{self, MOST_SHARDS};
use bake_brdf::bake::{self, BakeError, Bands, Observer, Request, Shard};
use bake_brdf::options::{Options, Sides, SolverChoice, Target};
use lut_io::Table;
use lut_io::both_sides::Passage;
use lut_io::solver::Solver;
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;
use terminal::{Manners, Outcome, Stop};

#[derive(clap::Args, Clone, Debug)]
pub(crate) struct BakeArgs {
    /// Recipe: a JSON file, - for stdin, or a built-in name such as akoya [default: paper].
    recipe: Option<PathBuf>,
    /// Table to write [default: pearl.exr].
    ///
    /// With --shard the default is pearl-I-of-N.shard.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    options: OptionsArgs,
    /// Keep a checkpoint beside the output (OUTPUT.checkpoint) from the start; without this flag, only when the bake is
    /// expected to take more than a minute. It is removed when the table is written.
    #[arg(long, hide_short_help = true, conflicts_with = "shard")]
    checkpoint: bool,
    /// Least time between two checkpoints: what a SIGKILL can cost.
    #[arg(long, hide_short_help = true, value_name = "SECONDS", default_value_t = Checkpoints::EVERY_SECONDS, conflicts_with = "shard")]
    checkpoint_every: f64,
    /// Go on from the checkpoint beside the output, if there is one.
    #[arg(long, hide_short_help = true, conflicts_with = "shard")]
    resume: bool,
    /// Walk one share of the paths and write its state; `lut merge` makes the table of all shares.
    #[arg(long, hide_short_help = true, value_name = "I/N", requires = "paths")]
    shard: Option<String>,
    /// Also store what passes and what becomes of light from below, so that the body under the nacre can be changed without
    /// baking again; solved by doubling.
    #[arg(long, hide_short_help = true, conflicts_with_all = ["paths", "time_budget", "shard", "resume"])]
    both_sides: bool,
    /// Make the table reciprocal: f(a → b) = f(b → a) at any pair of directions, every albedo kept. Decay tables get one azimuth
    /// width for all incidences.
    #[arg(long, hide_short_help = true, conflicts_with_all = ["shard", "both_sides"])]
    reciprocal: bool,
    /// Say what the bake would cost and write nothing.
    #[arg(long)]
    dry_run: bool,
    /// Bake a table again from its metadata and compare every bit.
    ///
    /// Exit 3 if one differs. Writes nothing.
    #[arg(long, hide_short_help = true, value_name = "FILE", conflicts_with_all = [
        "recipe", "output", "solver", "target", "seed", "azimuth", "effects", "incident_deg", "cells", "event_cap", "precision",
        "checkpoint", "checkpoint_every", "resume", "shard", "dry_run", "both_sides", "reciprocal",
    ])]
    pub(super) reproduce: Option<PathBuf>,
}

/// Runs the command.
pub(super) fn run(args: &BakeArgs, manners: &Manners) -> Outcome {
    let request = request(args)?;
    let shard = args.shard.as_deref().map(parse_shard).transpose()?;
    let pool = manners.pool()?;
    let bands = || pool.install(|| bands(&request, args.reciprocal));
    if args.dry_run {
        let bands = bands()?;
        return pool.install(|| dry_run(&request, &bands, choose(&request, &bands, manners)?, manners));
    }
    let output = args.output.clone().unwrap_or_else(|| match shard {
        None => "pearl.exr".into(),
        Some(Shard { index, count }) => format!("pearl-{index}-of-{count}.shard").into(),
    });
    not_the_recipe(args, &output)?;
    writable(&output)?;
    let started = Instant::now();
    if let Some(shard) = shard {
        terminal::interruption()?;
        let snapshot = pool
            .install(|| watched(manners, None, |observer| snapshot::walk_shard(&request, shard, observer)))?;
        return snapshot.write(&output).map_err(|why| Stop::failure(format!("{}: {why}", output.display())));
    }
    let checkpoints = Checkpoints {
        from_the_start: args.checkpoint,
        every: args::duration("checkpoint-every", args.checkpoint_every)?,
        resume: args.resume,
    };
    let bands = bands()?;
    let table = pool.install(|| {
        let solver = choose(&request, &bands, manners)?;
        if solver == SolverChoice::Doubling && (args.resume || args.checkpoint) && !manners.quiet {
            say("doubling keeps no checkpoint and goes on from none; solving from the start");
        }
        bake_to(&request, &bands, solver, &output, checkpoints, args.reciprocal, manners)
    })?;
    let seconds = started.elapsed().as_secs_f64();
    if manners.json {
        return terminal::print_json(&report(&table, &output, seconds));
    }
    terminal::print(&summary(&table, request.options.incident_deg.is_some(), &output, seconds))
}

fn request(args: &BakeArgs) -> Result<Request, Stop> {
    let sides = if args.both_sides { Sides::Both } else { Sides::Above };
    let options = Options { sides, ..args.options.options()? };
    let (recipe, _) = args::recipe(args.recipe.as_deref())?;
    Request::new(recipe, options).map_err(refuse)
}

/// The wavelengths at which the lobe is solved.
fn bands(request: &Request, reciprocal: bool) -> Result<Bands, Stop> {
    let bands = request.bands().map_err(refuse)?;
    if reciprocal {
        // Before anything is solved.
        bake::can_be_reciprocal(&bands).map_err(refuse)?;
    }
    Ok(bands)
}

/// The solver of a request, with the reason on stderr where it is chosen.
fn choose(request: &Request, bands: &Bands, manners: &Manners) -> Result<SolverChoice, Stop> {
    if bake::may_walk(request) && request.effects.has_lobe() {
        let (choice, reason) = bake::choose_solver(request, bands).map_err(refuse)?;
        // Without an accuracy there was no choice, which who asked for one is told.
        let asked = request.options.solver.is_some();
        if !manners.quiet && (asked || matches!(request.options.target, Target::AccuracyPercent(_))) {
            say(&format!("solver {}: {reason}", choice.name()));
        }
        return Ok(choice);
    }
    let solver = bake::solver(request, bands).map_err(refuse)?;
    if solver == SolverChoice::Walk
        && !manners.quiet
        && request.effects.has_lobe()
        && let Some(line) = bake::advice(request, bands).map_err(refuse)?
    {
        say(&format!("{line} (--solver doubling)"));
    }
    Ok(solver)
}

/// Solves a request and writes the table; the checkpoint of a walk lies beside `output` until that is done.
fn bake_to(
    request: &Request,
    bands: &Bands,
    solver: SolverChoice,
    output: &Path,
    checkpoints: Checkpoints,
    reciprocal: bool,
    manners: &Manners,
) -> Result<Table, Stop> {
    let keeper = Keeper::new(output, checkpoints, request);
    let mut table = solve(request, bands, solver, &keeper, manners)?;
    if reciprocal {
        table = bake::reciprocal(&table).map_err(refuse)?;
    }
    lut_io::exr_file::write(&table, output).map_err(|why| Stop::failure(why.to_string()))?;
    keeper.remove();
    Ok(table)
}

/// Solves; where a doubling that was chosen does not reach its target, the walk does.
fn solve(
    request: &Request,
    bands: &Bands,
    solver: SolverChoice,
    keeper: &Keeper<'_>,
    manners: &Manners,
) -> Result<Table, Stop> {
    if solver == SolverChoice::Doubling {
        match bake::doubling(request, bands) {
            Err(why @ BakeError::Doubling(_)) if bake::may_walk(request) => {
                if !manners.quiet {
                    say(&format!("{why}; walking instead"));
                }
            }
            table => return table.map_err(refuse),
        }
    }
    // Only the walk has something to keep when it is interrupted; doubling just ends.
    terminal::interruption()?;
    let resume = keeper.load(manners)?;
    watched(manners, Some(keeper), |observer| bake::walk(request, bands, observer, resume))
}

fn parse_shard(text: &str) -> Result<Shard, Stop> {
    let parsed = text.split_once('/').and_then(|(i, n)| Some((i.parse().ok()?, n.parse().ok()?)));
    match parsed {
        Some((index, count)) if (1..=count).contains(&index) && count <= MOST_SHARDS => {
            Ok(Shard { index, count })
        }
        _ => Err(Stop::BadInput(format!("--shard: {text:?} is not I/N with 1 <= I <= N <= {MOST_SHARDS}"))),
    }
}

/// Finds out that the output cannot be written before the work rather than after it.
fn writable(output: &Path) -> Outcome {
    let named = |why: String| Stop::failure(format!("{}: cannot be written: {why}", output.display()));
    if output.is_dir() {
        return Err(named("it is a folder; name a file".to_owned()));
    }
    lut_io::atomic::check(output).map_err(|error| named(error.to_string()))
}

/// Refuses an output that would take the place of the recipe.
fn not_the_recipe(args: &BakeArgs, output: &Path) -> Outcome {
    match &args.recipe {
        Some(recipe) if lut_io::atomic::same_file(recipe, output) => Err(Stop::BadInput(format!(
            "--output: {} is the recipe itself, expected a file of its own for the table",
            output.display()
        ))),
        _ => Ok(()),
    }
}

fn dry_run(request: &Request, bands: &Bands, solver: SolverChoice, manners: &Manners) -> Outcome {
    let forecast = bake::forecast(request, bands, solver, &Observer::idle()).map_err(refuse)?;
    if manners.json {
        return terminal::print_json(&json!({
            "schema": "bake-forecast/1",
            "solver": solver.name(),
            "seconds": forecast.seconds,
            "paths": forecast.paths,
            "bytes": forecast.bytes,
            "incidences": request.grid.incident_deg.len(),
            "content_hash": request.content_hash(solver),
        }));
    }
    let how = match solver {
        SolverChoice::Doubling => "doubling".to_owned(),
        _ => format!("{:.2e} paths", forecast.paths as f64),
    };
    terminal::print(&format!(
        "{}: {} incidences, {how}, about {}, at most {:.1} MB; nothing written\n",
        request.recipe.name,
        request.grid.incident_deg.len(),
        seconds_text(forecast.seconds),
        forecast.bytes as f64 / 1e6,
    ))
}

fn report(table: &Table, output: &Path, seconds: f64) -> serde_json::Value {
    json!({
        "schema": "bake-report/1",
        "output": output.display().to_string(),
        "seconds": seconds,
        "seed": table.meta().seed,
        "solver": table.meta().solver,
        "solver_settings": table.meta().solver_settings,
        "accuracy": table.meta().accuracy,
        "effects": table.meta().effects,
        "paths": table.meta().per_incidence.iter().map(|incidence| incidence.paths).sum::<u64>(),
        "per_incidence": table.meta().per_incidence,
    })
}

/// A readable summary: a handful of incidences, the accuracy reached.
fn summary(table: &Table, incidences_given: bool, output: &Path, seconds: f64) -> String {
    let meta = table.meta();
    let name = meta.recipe_name().unwrap_or_default();
    let paths: u64 = meta.per_incidence.iter().map(|incidence| incidence.paths).sum();
    let how = match meta.solver {
        Solver::Walk => format!("{:.2e} paths", paths as f64),
        Solver::Doubling => "doubling".to_owned(),
    };
    let mut text = format!("{name}: {how} in {}\n\n", seconds_text(seconds));
    text.push_str("   θi   albedo            surface  transmitted  absorbed  mean θo   sd θo   skew\n");
    let every = meta.per_incidence.len().div_ceil(10);
    for row in meta.per_incidence.iter().step_by(every) {
        let _ = writeln!(
            text,
            "{:>5}° {:.5} ± {:.5}  {:.5}      {:.5}   {:.5}  {:>6.2}°  {:>5.2}°  {:>5.2}",
            row.theta_i_deg,
            row.albedo,
            row.std_error.albedo,
            row.surface,
            row.transmitted,
            row.absorbed,
            row.mean_theta_o_deg,
            row.sd_theta_o_deg,
            row.skew_theta_o,
        );
    }
    let accuracy = &meta.accuracy;
    let asked = accuracy.asked_percent.map_or(String::new(), |asked| format!(" (asked: {asked} %)"));
    let _ = writeln!(
        text,
        "\ntotal variation as read ≤ {}{asked}: solver {}, between {} rows {}, between {} cells {}",
        percent(accuracy.reached_percent),
        percent(accuracy.solver_percent),
        meta.per_incidence.len(),
        percent(accuracy.rows_percent),
        meta.exit_axis.cells(),
        accuracy.cells_percent.map_or_else(|| "unknown".to_owned(), percent),
    );
    if let Some(sides) = &meta.both_sides {
        let [through, back, out] = Passage::ALL.map(|passage| sides.accuracy_percent(passage));
        let _ = writeln!(
            text,
            "at the rows, what passes ≤ {}; from below, what returns ≤ {}, what passes ≤ {}",
            percent(through),
            percent(back),
            percent(out)
        );
    }
    if accuracy.asked_percent.is_some_and(|asked| accuracy.reached_percent > asked) {
        text.push_str(if incidences_given {
            "that is more than was asked for: leave out --incident-deg, or give it more angles\n"
        } else {
            "that is more than was asked for: lobes this narrow cost too much to place incidences by; give --incident-deg more angles\n"
        });
    }
    let file = output.display();
    let _ = writeln!(text, "written: {file}");
    text.push_str(&next(&file.to_string()));
    text
}

/// What to look at now, as commands.
fn next(file: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "/._-".contains(c);
    let file =
        if file.chars().all(plain) { file.to_owned() } else { format!("'{}'", file.replace('\'', r"'\''")) };
    [
        ("where its light goes", format!("lut info {file}")),
        ("pictures of a sphere", format!("pearl preview {file} -o pictures")),
        ("in the browser", format!("pearl studio {file}")),
    ]
    .map(|(what, command)| format!("  {what:<22}{command}\n"))
    .concat()
}

/// To two significant digits, rounded up: it is a bound.
fn percent(percent: f64) -> String {
    if percent <= 0.0 {
        return "0 %".to_owned();
    }
    let digits = (1.0 - percent.log10().floor()).max(0.0) as usize;
    let unit = 10_f64.powi(digits as i32);
    format!("{:.digits$} %", (percent * unit).ceil() / unit)
}
