//! The built `pearl`, and a table for it.

use lut_io::exr_file;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

pub(crate) fn table(folder: &Path) -> PathBuf {
    let path = folder.join("table.exr");
    exr_file::write(&specimen::plane(&[0.0, 30.0, 60.0, 90.0], 16), &path).unwrap();
    path
}

pub(crate) fn pearl(args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_pearl")).args(args).output().unwrap()
}
