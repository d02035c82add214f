//! Automation: the same commands locally and in CI.
//!
//! `cargo xtask test` sets up what the tests need (a Python environment inside the checkout, libLLVM where it is
//! missing and installing it is permitted) and runs every check. Nothing is skipped silently: a step that cannot run
//! says why and is counted.

#![allow(clippy::print_stdout, clippy::print_stderr)] // a command for people

mod python;

use anyhow::{Context as _, Result, bail};
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};
use std::time::Instant;

const USAGE: &str = "\
cargo xtask test       set up and run every check (what CI runs)
cargo xtask setup      only set up: Python environment, libLLVM
cargo xtask rust       only the Rust checks: format, lints, docs, tests
cargo xtask python     only the checks against Python readers and renderers
cargo xtask renderers  exported files in the programs that they are for (downloads those programs)
cargo xtask long       the studies that take minutes to an hour: the main job against its truths";

fn main() -> ExitCode {
    let command = std::env::args().nth(1).unwrap_or_default();
    let outcome = match command.as_str() {
        "test" => test(),
        "setup" => python::environment().map(drop),
        "rust" => rust(),
        "python" => python_checks("tests/python"),
        "renderers" => renderers(),
        "long" => long(),
        _ => {
            eprintln!("{USAGE}");
            return ExitCode::from(2);
        }
    };
    match outcome {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("xtask: {error:#}");
            ExitCode::FAILURE
        }
    }
}

/// The root of the checkout.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).unwrap_or(Path::new(".")).to_owned()
}

fn test() -> Result<()> {
    // Python's packages come over the network while the compiler works.
    let python = std::thread::scope(|scope| {
        let environment = scope.spawn(python::environment);
        checks()?;
        environment.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })?;
    // A checker of Python takes one core, and so does the end of a build.
    std::thread::scope(|scope| {
        let lints = scope.spawn(|| python::lints(&python));
        step("release build", cargo(&EVERYTHING))?;
        lints.join().unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })?;
    // Neither keeps two cores busy by itself. What the one says comes after what the other says.
    let said = root().join("target/python-tests.txt");
    let mut pytest = pytest(&python, "tests/python");
    let output = std::fs::File::create(&said).context("target/python-tests.txt")?;
    pytest.stderr(output.try_clone()?).stdout(output);
    let (rust, python) = std::thread::scope(|scope| {
        let python = scope.spawn(|| {
            python::package(&python)?;
            step("python", pytest)
        });
        (step("tests", tests()), python.join())
    });
    print!("{}", String::from_utf8_lossy(&std::fs::read(&said)?));
    rust?;
    python.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
}

fn rust() -> Result<()> {
    checks()?;
    step("tests", tests())
}

/// Optimised: the statistical tests walk billions of crossings.
fn tests() -> Command {
    cargo(&["test", "--release", "--workspace"])
}

/// All that `cargo test` builds: the tools alone would be compiled once more, with fewer features of their dependencies.
const EVERYTHING: [&str; 6] = ["build", "--release", "--workspace", "--bins", "--tests", "--examples"];

fn checks() -> Result<()> {
    step("format", cargo(&["fmt", "--all", "--check"]))?;
    step(
        "lints",
        cargo(&["clippy", "--release", "--workspace", "--all-targets", "--", "--deny", "warnings"]),
    )?;
    let mut docs = cargo(&["doc", "--release", "--workspace", "--no-deps", "--document-private-items"]);
    // Private modules have pages too, so links to them lead somewhere.
    docs.env("RUSTDOCFLAGS", "--deny warnings --allow rustdoc::private_intra_doc_links");
    step("docs", docs)?;
    // What the registry would take: everything in the packages, every dependency with a version.
    let mut packages = vec!["package", "--workspace", "--no-verify", "--allow-dirty", "--quiet"];
    for ours_alone in ["xtask", "specimen", "nacre-python"] {
        packages.extend(["--exclude", ours_alone]);
    }
    step("packages", cargo(&packages))
}

fn renderers() -> Result<()> {
    step("release build", cargo(&EVERYTHING))?;
    let mut radiance = pytest(&python::renderers()?, "tests/renderers");
    radiance.args(["--ignore", "tests/renderers/test_blender.py"]);
    step("renderers", radiance)?;
    // Pictures of Mitsuba to compare with are the plugin's, which is in the environment of the tests.
    let python = python::environment()?;
    python::package(&python)?;
    let mut blender = pytest(&python, "tests/renderers/test_blender.py");
    blender.env("NACRE_BLENDERS", python::blenders()?);
    step("blender", blender)
}

fn long() -> Result<()> {
    step("long tests", cargo(&["test", "--release", "--workspace", "--", "--ignored", "long_"]))?;
    python_checks("tests/long")
}

fn python_checks(folder: &str) -> Result<()> {
    let python = python::environment()?;
    python::lints(&python)?;
    step("release build", cargo(&EVERYTHING))?;
    python::package(&python)?;
    step("python", pytest(&python, folder))
}

fn pytest(python: &Path, folder: &str) -> Command {
    let mut pytest = Command::new(python);
    // Three files at a time: a test seldom keeps two cores busy by itself, some wait for a browser.
    pytest
        .args(["-m", "pytest", "-q", "-rsP", "--durations", "25", "-n", "3", "--dist", "loadfile", folder])
        .current_dir(root());
    pytest.env("NACRE_BIN", root().join("target/release"));
    pytest
}

fn cargo(args: &[&str]) -> Command {
    let mut command = Command::new(std::env::var_os("CARGO").unwrap_or_else(|| "cargo".into()));
    command.args(args).current_dir(root());
    command
}

fn step(name: &str, mut command: Command) -> Result<()> {
    println!("\n== {name}");
    let started = Instant::now();
    let status =
        command.status().with_context(|| format!("{name}: cannot start {:?}", command.get_program()))?;
    if !status.success() {
        bail!("{name} failed ({status})");
    }
    println!("== {name}: {:.0} s", started.elapsed().as_secs_f64());
    Ok(())
}
