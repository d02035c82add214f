//! The built `bake-brdf`, for tests from end to end.

use std::path::Path;
use std::process::{Command, Output};

/// Runs the tool in a folder.
pub(crate) fn tool(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bake-brdf"))
        .current_dir(folder)
        .args(args)
        .output()
        .expect("the tool starts")
}
