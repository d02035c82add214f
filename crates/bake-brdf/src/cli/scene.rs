//! `bake-brdf --scene`: bakes the tables that a scene calls for, and a copy of the scene that points at them.

use super::bake::{BakeArgs, bake_to, writable};
use super::checkpoint::Checkpoints;
use super::errors::refuse_plan;
use super::progress::seconds_text;
use bake_brdf::options::Target;
use bake_brdf::plan::{Plan, PlannedTable};
use bake_brdf::scene::{Baked, Scene};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::time::Instant;
use terminal::{Manners, Outcome, Stop};

/// A table on disk.
struct Done {
    /// File name, in the folder of the copy.
    name: String,
    reused: bool,
    seconds: f64,
    bytes: u64,
}

/// Runs the command.
pub(crate) fn run(args: &BakeArgs, path: &Path, manners: &Manners) -> Outcome {
    let started = Instant::now();
    let scene = args.scene.read(path)?;
    let options = args.options.options()?;
    let pool = manners.pool()?;
    let plan = pool.install(|| Plan::of_scene(&scene, &options)).map_err(refuse_plan)?;
    if args.dry_run || plan.tables.is_empty() {
        return print(&plan, &[], None, started.elapsed().as_secs_f64(), manners);
    }
    let (copy, table_name) = targets(path, args.output.as_deref(), plan.tables.len())?;
    if lut_io::atomic::same_file(&copy, path) {
        let line = format!(
            "{}: the copy would take the place of the scene; name another file with -o",
            copy.display()
        );
        return Err(Stop::BadInput(line));
    }
    writable(&copy)?;
    let folder = lut_io::atomic::folder_of(&copy);
    terminal::interruption()?;
    let mut tables = Vec::new();
    for table in &plan.tables {
        let name = table_name.clone().unwrap_or_else(|| name_of(table));
        tables.push(pool.install(|| bake(table, folder, name, manners))?);
    }
    write_copy(&scene, &plan, &tables, &copy, folder)?;
    print(&plan, &tables, Some(&copy), started.elapsed().as_secs_f64(), manners)
}

/// The copy of the scene, and the table's file name where `-o` names that: `-o` is a folder, a scene, or (for a scene of one
/// table) a table.
fn targets(scene: &Path, output: Option<&Path>, tables: usize) -> Result<(PathBuf, Option<String>), Stop> {
    let stem = scene.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    let copy = format!("{stem}-baked.xml");
    let Some(output) = output else { return Ok((copy.into(), None)) };
    if output.is_dir() {
        return Ok((output.join(copy), None));
    }
    if output.extension().is_some_and(|extension| extension == "exr") {
        if tables > 1 {
            return Err(Stop::BadInput(format!(
                "--output: {}: the scene needs {tables} tables; name a folder, or the copy of the scene (.xml)",
                output.display()
            )));
        }
        let name = output.file_name().unwrap_or_default().to_string_lossy().into_owned();
        return Ok((output.with_extension("xml"), Some(name)));
    }
    Ok((output.to_owned(), None))
}

/// File name of a table: the recipe's name and the content's hash, so that other contents never take its place.
fn name_of(table: &PlannedTable) -> String {
    let tame = |c: char| if c.is_ascii_alphanumeric() || c == '-' || c == '_' { c } else { '-' };
    let name: String = table.request.recipe.name.chars().take(40).map(tame).collect();
    // A name that begins with a dash reads like a flag.
    let name = match name.trim_matches('-') {
        "" => "pearl",
        name => name,
    };
    format!("{name}-{}.exr", &table.request.content_hash(table.solver)[..12])
}

/// Bakes a table, unless it is there already.
fn bake(table: &PlannedTable, folder: &Path, name: String, manners: &Manners) -> Result<Done, Stop> {
    let path = folder.join(&name);
    let started = Instant::now();
    let hash = table.request.content_hash(table.solver);
    // What a time budget reaches is another table every time.
    let timed = matches!(table.request.options.target, Target::Time(_));
    let reused = !timed && path.is_file() && stored_hash(&path) == Some(hash);
    if !reused {
        writable(&path)?;
        let checkpoints = Checkpoints::default();
        bake_to(&table.request, &table.bands, table.solver, &path, checkpoints, false, manners)?;
    }
    let bytes = std::fs::metadata(&path).map_or(0, |data| data.len());
    Ok(Done { name, reused, seconds: started.elapsed().as_secs_f64(), bytes })
}

/// The content hash of a whole and valid table.
fn stored_hash(path: &Path) -> Option<String> {
    lut_io::exr_file::read(path).ok()?.into_parts().meta.content_hash
}

fn write_copy(scene: &Scene, plan: &Plan, tables: &[Done], copy: &Path, folder: &Path) -> Outcome {
    let baked = |pearl: &bake_brdf::plan::PlannedPearl| {
        let table = &tables[pearl.table?];
        Some(Baked { table: PathBuf::from(&table.name), effects: pearl.decisions.set() })
    };
    let pointers: Vec<Option<Baked>> = plan.pearls.iter().map(baked).collect();
    let text = scene.copy(folder, &pointers);
    lut_io::atomic::write(copy, text.as_bytes())
        .map_err(|why| Stop::failure(format!("{}: {why}", copy.display())))
}

fn print(plan: &Plan, tables: &[Done], copy: Option<&Path>, seconds: f64, manners: &Manners) -> Outcome {
    if manners.json {
        let done: Vec<Value> = plan
            .tables
            .iter()
            .zip(tables)
            .map(|(planned, done)| {
                json!({
                    "file": done.name, "reused": done.reused, "seconds": done.seconds, "bytes": done.bytes,
                    "predicted_seconds": planned.cost.seconds, "solver": planned.solver.name(),
                    "effects": planned.request.effects.names(),
                })
            })
            .collect();
        let mut whole = plan.report();
        whole["schema"] = json!("bake-scene-report/1");
        whole["scene"] = json!(copy.map(|path| path.display().to_string()));
        whole["baked"] = json!(done);
        whole["total_seconds"] = json!(seconds);
        return terminal::print_json(&whole);
    }
    let mut text = String::new();
    if plan.tables.is_empty() {
        let pearls = match plan.pearls.len() {
            0 => "the scene has no pearl".to_owned(),
            n => format!("no shape shows the scene's pearls ({n} unused)"),
        };
        let _ = writeln!(text, "{pearls}: nothing baked, nothing written");
    }
    for (planned, done) in plan.tables.iter().zip(tables) {
        let how = if done.reused {
            "reused".to_owned()
        } else {
            format!("baked in {}", seconds_text(done.seconds))
        };
        let effects = planned.request.effects.names().join(", ");
        let _ = writeln!(text, "{}: {how} ({effects})", done.name);
    }
    match copy {
        Some(copy) => {
            let _ = writeln!(text, "scene: {}", copy.display());
        }
        None if !plan.tables.is_empty() => {
            let _ = writeln!(
                text,
                "{} tables, about {}; nothing written",
                plan.tables.len(),
                seconds_text(plan.cost().seconds)
            );
        }
        None => {}
    }
    terminal::print(&text)
}
