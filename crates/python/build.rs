//! The documentation of what Python sees, a file a name, from the stubs: `help(nacre.bake)` says what an editor says.

use std::path::{Path, PathBuf};
use std::{env, fs, io};

const STUBS: &str = "nacre/_nacre.pyi";

fn main() -> io::Result<()> {
    println!("cargo:rerun-if-changed={STUBS}");
    let stubs =
        fs::read_to_string(Path::new(&env::var("CARGO_MANIFEST_DIR").unwrap_or_default()).join(STUBS))?;
    let out = PathBuf::from(env::var("OUT_DIR").unwrap_or_default());
    let (mut class, mut name) = (String::new(), String::new());
    let mut lines = stubs.lines();
    while let Some(line) = lines.next() {
        let (text, indented) = (line.trim_start(), line.starts_with(' '));
        if let Some(named) = defined(text, "class ") {
            class = format!("{named}.");
            named.clone_into(&mut name);
        } else if let Some(named) = defined(text, "def ") {
            name = if indented { format!("{class}{named}") } else { named.to_owned() };
        } else if let Some(first) = text.strip_prefix("\"\"\"").filter(|_| !name.is_empty()) {
            let margin = line.len() - text.len();
            let mut documentation = vec![first];
            while !documentation.last().is_some_and(|last| last.ends_with("\"\"\"")) {
                let Some(next) = lines.next() else { break };
                documentation.push(next.get(margin..).unwrap_or_default());
            }
            let documentation = documentation.join("\n");
            let documentation = documentation.trim_end_matches("\"\"\"").trim_end();
            fs::write(out.join(&name), documentation)?;
        }
    }
    Ok(())
}

/// The name behind `class ` or `def `.
fn defined<'a>(line: &'a str, keyword: &str) -> Option<&'a str> {
    line.strip_prefix(keyword)?.split(['(', ':']).next()
}
