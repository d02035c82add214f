//! The Python environment of the tests: pinned packages in `.venv`, and libLLVM for Dr.Jit.

use crate::{root, step};
use anyhow::{Context as _, Result, bail};
use std::path::{Path, PathBuf};
use std::process::Command;

/// Oldest libLLVM that Dr.Jit 1.5 accepts.
const OLDEST_LLVM: u32 = 15;

/// Makes the environment if it is missing or its requirements changed; gives its interpreter.
pub(crate) fn environment() -> Result<PathBuf> {
    let venv = root().join(".venv");
    let python = venv.join("bin/python");
    let requirements = std::fs::read_to_string(root().join("tests/python/requirements.txt"))
        .context("tests/python/requirements.txt")?;
    let stamp = venv.join("requirements.txt");
    if std::fs::read_to_string(&stamp).is_ok_and(|installed| installed == requirements) {
        llvm()?;
        return Ok(python);
    }
    let mut make = Command::new("python3");
    make.args(["-m", "venv", "--clear"]).arg(&venv);
    step("python environment", make)?;
    let mut install = Command::new(&python);
    install.args(["-m", "pip", "install", "--quiet", "--disable-pip-version-check", "-r"]);
    install.arg(root().join("tests/python/requirements.txt"));
    step("python packages", install)?;
    std::fs::write(&stamp, requirements)?;
    llvm()?;
    Ok(python)
}

/// Dr.Jit's LLVM variants need libLLVM. Installs Debian's where that is permitted.
fn llvm() -> Result<()> {
    if llvm_found() {
        return Ok(());
    }
    println!("libLLVM {OLDEST_LLVM} or newer not found; installing it");
    for package in ["libllvm19", "libllvm16", "libllvm15"] {
        let update = Command::new("apt-get").args(["-qq", "update"]).status();
        let install = Command::new("apt-get").args(["-qq", "install", "-y", package]).status();
        if update.is_ok_and(|s| s.success()) && install.is_ok_and(|s| s.success()) && llvm_found() {
            return Ok(());
        }
    }
    bail!(
        "the checks against Mitsuba need libLLVM {OLDEST_LLVM} or newer (Debian: apt-get install libllvm19), or DRJIT_LIBLLVM_PATH"
    )
}

fn llvm_found() -> bool {
    if std::env::var_os("DRJIT_LIBLLVM_PATH").is_some() {
        return true;
    }
    let folders = [
        "/usr/lib/x86_64-linux-gnu",
        "/usr/lib/aarch64-linux-gnu",
        "/usr/lib64",
        "/usr/lib",
        "/usr/local/lib",
    ];
    folders.iter().any(|folder| newest_llvm(Path::new(folder)).is_some_and(|version| version >= OLDEST_LLVM))
}

fn newest_llvm(folder: &Path) -> Option<u32> {
    let names =
        std::fs::read_dir(folder).ok()?.filter_map(|entry| entry.ok()?.file_name().into_string().ok());
    let version = |name: String| {
        let rest = name.strip_prefix("libLLVM-").or_else(|| name.strip_prefix("libLLVM.so."))?.to_owned();
        rest.chars().take_while(char::is_ascii_digit).collect::<String>().parse().ok()
    };
    names.filter_map(version).max()
}
