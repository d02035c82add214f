//! The Python environment of the tests: pinned packages in `.venv`, and libLLVM for Dr.Jit.

use crate::{root, step};
use anyhow::{Context as _, Result, bail};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The environment of the tests; makes it if it is missing or its requirements changed, and gives its interpreter.
pub(crate) fn environment() -> Result<PathBuf> {
    let python = with_packages(".venv", "tests/python/requirements.txt")?;
    llvm(&python)?;
    chromium();
    Ok(python)
}

/// The environment with the programs that exported files are for, and the package `nacre`.
pub(crate) fn renderers() -> Result<PathBuf> {
    let python = with_packages("target/renderers-venv", "tests/renderers/requirements.txt")?;
    llvm(&python)?;
    chromium();
    node()?;
    package(&python)?;
    Ok(python)
}

/// Programs of JavaScript, in `target/renderers-node`.
fn node() -> Result<()> {
    let (folder, listed) = (root().join("target/renderers-node"), "tests/renderers/package.json");
    let wanted = std::fs::read_to_string(root().join(listed)).context(listed)?;
    let stamp = folder.join("package.json");
    if folder.join("node_modules").is_dir()
        && std::fs::read_to_string(&stamp).is_ok_and(|made| made == wanted)
    {
        return Ok(());
    }
    std::fs::create_dir_all(&folder)?;
    std::fs::write(&stamp, wanted)?;
    let mut install = Command::new("npm");
    install.args(["install", "--no-audit", "--no-fund", "--no-save"]).current_dir(&folder);
    step("packages of JavaScript", install)
}

/// A Python with Blender as a module for each version, as `VERSION=PYTHON` with commas between.
pub(crate) fn blenders() -> Result<String> {
    let mut pythons = Vec::new();
    for version in ["4.2", "4.5", "5.0"] {
        let (folder, packages) =
            (format!("target/renderers/blender-{version}"), format!("tests/renderers/blender-{version}.txt"));
        let python = with_packages(&folder, &packages)?;
        pythons.push(format!("{version}={}", python.display()));
    }
    Ok(pythons.join(","))
}

/// The interpreter of an environment in this folder of the checkout with these packages.
fn with_packages(folder: &str, requirements: &str) -> Result<PathBuf> {
    let venv = root().join(folder);
    let python = venv.join("bin/python");
    let wanted = listed(&root().join(requirements))?;
    let stamp = venv.join("requirements.txt");
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == wanted) {
        return Ok(python);
    }
    let mut make = Command::new("python3");
    make.args(["-m", "venv", "--clear"]).arg(&venv);
    step("python environment", make)?;
    let mut install = Command::new(&python);
    install.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"]);
    install.arg(root().join(requirements));
    step("python packages", install)?;
    std::fs::write(&stamp, wanted)?;
    Ok(python)
}

/// A list of packages, with the lists that it names.
fn listed(requirements: &Path) -> Result<String> {
    let own = std::fs::read_to_string(requirements).with_context(|| requirements.display().to_string())?;
    let mut all = own.clone();
    for other in own.lines().filter_map(|line| line.strip_prefix("-r ")) {
        all.push_str(&listed(&requirements.with_file_name(other))?);
    }
    Ok(all)
}

/// Format and lints of all Python in the checkout; types of the package `nacre`; that the names exist which tests, tools and
/// examples take of each other.
pub(crate) fn lints(python: &Path) -> Result<()> {
    let module = |arguments: &[&str], folder: &str| {
        let mut command = Command::new(python);
        command.arg("-m").args(arguments).current_dir(root().join(folder));
        command
    };
    step("python format", module(&["ruff", "format", "--check", "."], "."))?;
    step("python lints", module(&["ruff", "check", "."], "."))?;
    step("python types", module(&["mypy", "nacre"], "crates/python"))?;
    step("python names", module(&["mypy"], "."))
}

/// Builds the wheel of the package `nacre` from what is compiled already, and installs it.
pub(crate) fn package(python: &Path) -> Result<()> {
    let (folder, wheels) = (root().join("crates/python"), root().join("target/wheels"));
    let module = |arguments: &[&str]| {
        let mut command = Command::new(python);
        command.arg("-m").args(arguments).current_dir(&folder);
        command
    };
    // Of other versions, which pip would choose from.
    if wheels.exists() {
        std::fs::remove_dir_all(&wheels)?;
    }
    let mut build = module(&["maturin", "build", "--release", "--locked", "--quiet", "--out"]);
    build.arg(&wheels);
    step("wheel", build)?;
    let mut install = module(&[
        "pip",
        "install",
        "--quiet",
        "--disable-pip-version-check",
        "--no-deps",
        "--force-reinstall",
    ]);
    for wheel in std::fs::read_dir(&wheels).context("target/wheels")? {
        install.arg(wheel?.path());
    }
    step("package", install)
}

/// The page is tested in a real browser. Installs Debian's where that is permitted; else its tests say that they were skipped, and why.
fn chromium() {
    let works =
        || Command::new("chromium").arg("--version").output().is_ok_and(|output| output.status.success());
    if !works() && !installed("chromium") {
        println!("no chromium, and none could be installed: the tests of the page will be skipped");
    }
}

/// Whether Debian's package is there now.
fn installed(package: &str) -> bool {
    let apt = |arguments: &[&str]| {
        let mut apt = Command::new("apt-get");
        apt.arg("-qq").args(arguments).stdout(std::process::Stdio::null());
        apt.status().is_ok_and(|status| status.success())
    };
    apt(&["update"]) && apt(&["install", "-y", "--no-install-recommends", package])
}

/// Dr.Jit's LLVM variants need a libLLVM that knows the processor. Installs Debian's where that is permitted.
fn llvm(python: &Path) -> Result<()> {
    let works = || {
        let mut probe = Command::new(python);
        probe.arg(root().join("tests/python/llvm.py")).status().is_ok_and(|status| status.success())
    };
    if works() {
        return Ok(());
    }
    println!("no libLLVM that Dr.Jit can use (above: why); installing one");
    for package in ["libllvm19", "libllvm17"] {
        if installed(package) && works() {
            return Ok(());
        }
    }
    bail!(
        "the checks against Mitsuba need a libLLVM that Dr.Jit can use (Debian: apt-get install libllvm19), or DRJIT_LIBLLVM_PATH"
    )
}
