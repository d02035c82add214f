//! Lists the files of the page, to be embedded.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

fn main() -> io::Result<()> {
    let page = Path::new(&env::var("CARGO_MANIFEST_DIR").unwrap_or_default()).join("page");
    println!("cargo:rerun-if-changed=page");
    let mut files = Vec::new();
    if page.is_dir() {
        collect(&page, &mut files)?;
    }
    files.sort();
    let mut text = String::from("&[\n");
    for file in files {
        let name = file.strip_prefix(&page).unwrap_or(&file).to_string_lossy().replace('\\', "/");
        text += &format!("    ({name:?}, include_bytes!({:?})),\n", file.to_string_lossy());
    }
    fs::write(Path::new(&env::var("OUT_DIR").unwrap_or_default()).join("page.rs"), text + "]\n")
}

fn collect(folder: &Path, files: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        let served = path
            .extension()
            .is_some_and(|extension| ["html", "js", "css", "svg"].iter().any(|kind| extension == *kind));
        if path.is_dir() {
            collect(&path, files)?;
        } else if served {
            files.push(path);
        }
    }
    Ok(())
}
