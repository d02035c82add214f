//! `bake-brdf bake`.

use super::manners;
use super::plan::{SceneArgs, refuse, solver_name};
use super::terms::{self, TermsArgs, recipe};
use bake_brdf::bake::sampling::{Shard, State};
use bake_brdf::bake::snapshot::{self, MOST_SHARDS, Snapshot};
use bake_brdf::bake::{self, BakeError, Bands, Checkpoint, Observer, Progress, Request, Sides, SolverChoice};
use bake_brdf::effects::View;
use bake_brdf::plan::{self, Terms};
use lut_io::table::{Solver, Table};
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::time::{Duration, Instant};
use terminal::Manners;
use terminal::{Outcome, Stop};

/// Least time between two checkpoints unless asked otherwise.
pub(super) const CHECKPOINT_EVERY_SECONDS: f64 = 1.0;

#[derive(clap::Args, Clone, Debug)]
pub(crate) struct BakeArgs {
    /// Recipe (JSON) [default: the paper's pearl].
    #[arg(conflicts_with = "scene")]
    recipe: Option<PathBuf>,
    /// Table to write [default: pearl.exr; with --shard: pearl-I-of-N.shard]. With --scene: the copy of the scene that points
    /// at the tables [default: SCENE-baked.xml], or the folder for both; tables lie beside the copy.
    #[arg(short, long, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    scene: SceneArgs,
    #[command(flatten)]
    terms: TermsArgs,
    /// Keep a checkpoint beside the output (OUTPUT.checkpoint) from the start; without this flag, only when the bake is
    /// expected to take more than a minute. It is removed when the table is written.
    #[arg(long, conflicts_with_all = ["shard", "scene"])]
    checkpoint: bool,
    /// Least time between two checkpoints: what a SIGKILL can cost.
    #[arg(long, value_name = "SECONDS", default_value_t = CHECKPOINT_EVERY_SECONDS, conflicts_with = "shard")]
    checkpoint_every: f64,
    /// Go on from the checkpoint beside the output; start afresh where there is none.
    #[arg(long, conflicts_with_all = ["shard", "scene"])]
    resume: bool,
    /// Walk one share of the paths and write its state; `lut merge` makes the table of all shares.
    #[arg(long, value_name = "I/N", requires = "paths", conflicts_with = "scene")]
    shard: Option<String>,
    /// Also store what passes and what becomes of light from below, so that the body under the nacre can be changed without
    /// baking again; needs --solver doubling (or auto).
    #[arg(long, conflicts_with_all = ["paths", "time_budget", "shard", "resume", "scene"])]
    both_sides: bool,
    /// Make the table reciprocal: f(a → b) = f(b → a) at any pair of directions, every albedo kept. Decay tables get one azimuth
    /// width for all incidences.
    #[arg(long, conflicts_with_all = ["shard", "both_sides", "scene"])]
    reciprocal: bool,
    /// Say what the bake would cost and write nothing.
    #[arg(long)]
    dry_run: bool,
    /// Bake a table again from its own metadata and compare every bit; exit 3 if one differs. Writes nothing.
    #[arg(long, value_name = "FILE", conflicts_with_all = [
        "recipe", "output", "solver", "target", "seed", "azimuth", "effects", "incident_deg", "event_cap", "precision",
        "checkpoint", "checkpoint_every", "resume", "shard", "dry_run", "scene", "both_sides", "reciprocal",
    ])]
    reproduce: Option<PathBuf>,
}

/// Runs the command.
pub(crate) fn run(args: &BakeArgs, manners: &Manners) -> Outcome {
    if let Some(table) = &args.reproduce {
        return super::reproduce::run(table, manners);
    }
    if let Some(scene) = &args.scene.scene {
        return super::scene::run(
            &args.scene,
            scene,
            &args.terms,
            args.output.as_deref(),
            args.dry_run,
            manners,
        );
    }
    let terms = args.terms.terms(None)?;
    let request = request(args, &terms)?;
    request.check().map_err(stop)?;
    let pool = manners.pool()?;
    let bands = || pool.install(|| bands(&request, args.reciprocal));
    if args.dry_run {
        let bands = bands()?;
        return pool
            .install(|| dry_run(&request, &bands, choose(&terms, &request, &bands, manners)?, manners));
    }
    let shard = args.shard.as_deref().map(parse_shard).transpose()?;
    let output = args.output.clone().unwrap_or_else(|| match shard {
        None => "pearl.exr".into(),
        Some(Shard { index, count }) => format!("pearl-{index}-of-{count}.shard").into(),
    });
    let sides = sides(args, &terms)?;
    not_the_recipe(args, &output)?;
    writable(&output)?;
    let started = Instant::now();
    if let Some(shard) = shard {
        terminal::interruption()?;
        let snapshot = pool
            .install(|| watched(manners, None, |observer| snapshot::walk_shard(&request, shard, observer)))?;
        return snapshot.write(&output).map_err(|why| Stop::failure(format!("{}: {why}", output.display())));
    }
    let every = terms::budget("checkpoint-every", args.checkpoint_every)?;
    let kept =
        Kept { from_the_start: args.checkpoint, every, resume: args.resume, reciprocal: args.reciprocal };
    let bands = bands()?;
    let table = pool.install(|| {
        if sides == Sides::Both {
            return keep(bake::doubling(&request, &bands, sides).map_err(stop)?, &output, false);
        }
        let solver = choose(&terms, &request, &bands, manners)?;
        if terms.solver == Some(SolverChoice::Auto) && solver == SolverChoice::Doubling {
            return double_or_walk(&request, &bands, &output, kept, manners);
        }
        bake_to(&request, &bands, solver, &output, kept, manners)
    })?;
    let seconds = started.elapsed().as_secs_f64();
    if manners.json {
        return terminal::print_json(&report(&table, &output, seconds));
    }
    terminal::print(&summary(&table, &output, seconds))
}

/// The wavelengths at which the lobe is solved.
fn bands(request: &Request, reciprocal: bool) -> Result<Bands, Stop> {
    let bands = request.bands().map_err(stop)?;
    if reciprocal {
        // Before anything is solved.
        bake::can_be_reciprocal(&bands).map_err(stop)?;
    }
    Ok(bands)
}

/// Which sides were asked for; only doubling has both.
fn sides(args: &BakeArgs, terms: &Terms) -> Result<Sides, Stop> {
    match (args.both_sides, terms.solver) {
        (false, _) => Ok(Sides::Above),
        (true, Some(SolverChoice::Doubling | SolverChoice::Auto)) => Ok(Sides::Both),
        (true, _) => Err(Stop::bad_input(
            "--both-sides: the walk comes from above only, expected --solver doubling or auto",
        )),
    }
}

/// Which checkpoints a bake keeps and reads.
#[derive(Clone, Copy)]
pub(super) struct Kept {
    pub(super) from_the_start: bool,
    pub(super) every: Duration,
    pub(super) resume: bool,
    /// Whether the table is made reciprocal before it is written.
    pub(super) reciprocal: bool,
}

/// Solves a request and writes the table; the checkpoint lies beside `output` until that is done.
pub(super) fn bake_to(
    request: &Request,
    bands: &Bands,
    solver: SolverChoice,
    output: &Path,
    kept: Kept,
    manners: &Manners,
) -> Result<Table, Stop> {
    let keeper = Keeper::new(output, kept.from_the_start, kept.every, request);
    let table = if solver == SolverChoice::Doubling {
        if (kept.resume || kept.from_the_start) && !manners.quiet {
            say("doubling keeps no checkpoint and goes on from none; solving from the start");
        }
        bake::doubling(request, bands, Sides::Above).map_err(stop)?
    } else {
        // Only the walk has something to keep when it is interrupted; doubling just ends.
        terminal::interruption()?;
        let resume = if kept.resume { keeper.load(manners)? } else { None };
        watched(manners, Some(&keeper), |observer| bake::walk(request, bands, observer, resume))?
    };
    let table = keep(table, output, kept.reciprocal)?;
    keeper.remove();
    Ok(table)
}

/// Doubling chosen by `auto`: where it does not reach what was asked for, the walk.
fn double_or_walk(
    request: &Request,
    bands: &Bands,
    output: &Path,
    kept: Kept,
    manners: &Manners,
) -> Result<Table, Stop> {
    match bake::doubling(request, bands, Sides::Above) {
        Err(why @ BakeError::Doubling(_)) => {
            if !manners.quiet {
                say(&format!("{why}; walking instead"));
            }
            bake_to(request, bands, SolverChoice::Walk, output, kept, manners)
        }
        table => keep(table.map_err(stop)?, output, kept.reciprocal),
    }
}

fn keep(table: Table, output: &Path, reciprocal: bool) -> Result<Table, Stop> {
    let table = if reciprocal { bake::reciprocal(&table).map_err(stop)? } else { table };
    lut_io::exr_file::write(&table, output).map_err(|why| Stop::failure(why.to_string()))?;
    Ok(table)
}

/// The solver asked for, or the cheaper one with the reason on stderr.
fn choose(terms: &Terms, request: &Request, bands: &Bands, manners: &Manners) -> Result<SolverChoice, Stop> {
    if terms.solver == Some(SolverChoice::Auto) && request.effects.has_lobe() {
        let (choice, reason) = bake::choose_solver(request, bands).map_err(stop)?;
        if !manners.quiet {
            say(&format!("solver {}: {reason}", solver_name(choice)));
        }
        return Ok(choice);
    }
    plan::solver(request, bands, terms.solver).map_err(stop)
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

/// The checkpoint beside an output.
pub(super) struct Keeper<'a> {
    path: PathBuf,
    request: &'a Request,
    /// Least time between two checkpoints.
    every: Duration,
    /// Set from the start by `--checkpoint`, or by a forecast of more than a minute.
    on: AtomicBool,
    failed: AtomicBool,
}

impl<'a> Keeper<'a> {
    fn new(output: &Path, from_the_start: bool, every: Duration, request: &'a Request) -> Self {
        let mut path = output.as_os_str().to_owned();
        path.push(".checkpoint");
        Self {
            path: path.into(),
            request,
            every,
            on: AtomicBool::new(from_the_start),
            failed: AtomicBool::new(false),
        }
    }

    fn load(&self, manners: &Manners) -> Result<Option<Snapshot>, Stop> {
        self.on.store(true, Ordering::Relaxed);
        if !self.path.exists() {
            if !manners.quiet {
                say(&format!("{}: no checkpoint; starting afresh", self.path.display()));
            }
            return Ok(None);
        }
        let snapshot = Snapshot::read(&self.path)
            .map_err(|why| Stop::BadInput(format!("{}: {why}", self.path.display())))?;
        let here = Snapshot::new(self.request, Shard::WHOLE, snapshot.state.clone());
        here.same_bake(&snapshot).map_err(|why| Stop::BadInput(format!("{}: {why}", self.path.display())))?;
        Ok(Some(snapshot))
    }

    fn keep(&self, state: &State) {
        if !self.on.load(Ordering::Relaxed) {
            return;
        }
        let snapshot = Snapshot::new(self.request, Shard::WHOLE, state.clone());
        // A full disk need not end a bake that is still going well: said once, tried again next time.
        if let Err(why) = snapshot.write(&self.path)
            && !self.failed.swap(true, Ordering::Relaxed)
        {
            say(&format!("{}: no checkpoint kept: {why}", self.path.display()));
        }
    }

    /// What an interrupted bake has to say.
    fn interrupted(&self) -> Stop {
        let path = self.path.display();
        if self.on.load(Ordering::Relaxed) && self.path.exists() {
            return Stop::failure(format!("interrupted; {path} keeps the work: go on with --resume"));
        }
        Stop::failure(BakeError::Interrupted)
    }

    fn remove(&self) {
        if self.on.load(Ordering::Relaxed) {
            // It may never have been written.
            let _ = std::fs::remove_file(&self.path);
        }
    }
}

fn request(args: &BakeArgs, terms: &Terms) -> Result<Request, Stop> {
    let (recipe, _) = recipe(args.recipe.as_deref())?;
    let view = View::of_look(&recipe.look);
    let (recipe, decisions) = terms.decide(recipe, &view).map_err(|why| refuse(why.into()))?;
    Ok(terms.request(recipe, decisions.set()))
}

/// Most angles of incidence of a list.
const MOST_ANGLES: usize = 100_000;

/// Parses `0:90:10,45` into ascending distinct angles.
pub(super) fn angles(list: &str) -> Result<Vec<f64>, Stop> {
    let mut angles = terminal::angles_deg("--incident-deg", list, MOST_ANGLES)?;
    angles.sort_by(f64::total_cmp);
    angles.dedup();
    Ok(angles)
}

pub(super) fn stop(error: BakeError) -> Stop {
    match error {
        BakeError::Interrupted => Stop::failure(error),
        _ => Stop::bad_input(error),
    }
}

/// Finds out that the output cannot be written before the work rather than after it.
pub(super) fn writable(output: &Path) -> Outcome {
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

/// Runs a bake with a progress bar, a forecast and, where there is a keeper, checkpoints.
pub(super) fn watched<T>(
    manners: &Manners,
    keeper: Option<&Keeper<'_>>,
    work: impl FnOnce(&Observer<'_>) -> Result<T, BakeError>,
) -> Result<T, Stop> {
    let bar = manners::progress_bar(manners.quiet);
    let said = AtomicU64::new(0);
    let started = Instant::now();
    let progress = |progress: &Progress<'_>| {
        let done = progress.crossings() as f64 / progress.expected_crossings.max(1.0);
        bar.set_position((1000.0 * done) as u64);
        // The error sums over all cells of all incidences: four times a second is enough.
        let tick = started.elapsed().as_millis() as u64 / 250;
        if !bar.is_hidden() && said.fetch_max(tick, Ordering::Relaxed) < tick {
            bar.set_message(format!("{:.2} %", progress.error_percent()));
        }
    };
    let forecast = |seconds: f64| {
        if let Some(keeper) = keeper
            && seconds > 60.0
        {
            keeper.on.store(true, Ordering::Relaxed);
        }
        if !manners.quiet {
            bar.suspend(|| say(&format!("expected to take {}", manners::seconds_text(seconds))));
            bar.reset();
        }
    };
    let keep = |state: &State| {
        if let Some(keeper) = keeper {
            keeper.keep(state);
        }
    };
    let checkpoint = keeper.map(|keeper| Checkpoint { every: keeper.every, keep: &keep });
    let observer =
        Observer { stop: terminal::interruption()?, progress: &progress, forecast: &forecast, checkpoint };
    let result = work(&observer).map_err(|why| match (&why, keeper) {
        (BakeError::Interrupted, Some(keeper)) => keeper.interrupted(),
        _ => stop(why),
    });
    bar.finish_and_clear();
    result
}

#[allow(clippy::print_stderr)] // the tool's voice
pub(super) fn say(line: &str) {
    eprintln!("bake-brdf: {line}");
}

fn dry_run(request: &Request, bands: &Bands, solver: SolverChoice, manners: &Manners) -> Outcome {
    let forecast = bake::forecast(request, bands, solver, &Observer::idle()).map_err(stop)?;
    if manners.json {
        return terminal::print_json(&json!({
            "schema": "bake-forecast/1",
            "solver": solver_name(solver),
            "seconds": forecast.seconds,
            "paths": forecast.paths,
            "bytes": forecast.bytes,
            "incidences": request.incident_deg.len(),
            "content_hash": bake::content_hash(request, solver),
        }));
    }
    let how = match solver {
        SolverChoice::Doubling => "doubling".to_owned(),
        _ => format!("{:.2e} paths", forecast.paths as f64),
    };
    terminal::print(&format!(
        "{}: {} incidences, {how}, about {}, at most {:.1} MB; nothing written\n",
        request.recipe.name,
        request.incident_deg.len(),
        manners::seconds_text(forecast.seconds),
        forecast.bytes as f64 / 1e6,
    ))
}

fn report(table: &Table, output: &Path, seconds: f64) -> serde_json::Value {
    json!({
        "schema": "bake-report/1",
        "output": output.display().to_string(),
        "seconds": seconds,
        "seed": table.meta.seed,
        "solver": table.meta.solver,
        "solver_settings": table.meta.solver_settings,
        "accuracy": table.meta.accuracy,
        "effects": table.meta.effects,
        "paths": table.meta.per_incidence.iter().map(|incidence| incidence.paths).sum::<u64>(),
        "per_incidence": table.meta.per_incidence,
    })
}

/// A readable summary: a handful of incidences, the accuracy reached.
fn summary(table: &Table, output: &Path, seconds: f64) -> String {
    let meta = &table.meta;
    let name = meta.recipe.get("name").and_then(|name| name.as_str()).unwrap_or_default();
    let paths: u64 = meta.per_incidence.iter().map(|incidence| incidence.paths).sum();
    let how = match meta.solver {
        Solver::Walk => format!("{:.2e} paths", paths as f64),
        Solver::Doubling => "doubling".to_owned(),
    };
    let mut text = format!("{name}: {how} in {}\n\n", manners::seconds_text(seconds));
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
        "\ntotal variation ≤ {:.2} %{asked}, worst at {}°; reading between incidences adds ≈ {:.2} %\nwritten: {}",
        accuracy.reached_percent,
        accuracy.worst_theta_i_deg,
        accuracy.interpolation_percent,
        output.display(),
    );
    if accuracy.asked_percent.is_some_and(|asked| accuracy.interpolation_percent > asked) {
        text.push_str("between incidences the error is larger than asked for: give a finer --incident-deg\n");
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_of_angles_take_numbers_and_ranges() {
        assert_eq!(angles("0:90:30,45,30").unwrap(), [0.0, 30.0, 45.0, 60.0, 90.0]);
        assert_eq!(angles("89.9").unwrap(), [89.9]);
    }
}
