//! `thinfilm materials`: the library of optical constants.

use terminal::Outcome;
use thinfilm::library;

pub(crate) fn materials(json: bool) -> Outcome {
    let entries = library::entries();
    if json {
        let rows: Vec<serde_json::Value> = entries
            .iter()
            .map(|entry| {
                serde_json::json!({
                    "name": entry.name, "n": entry.n, "from_nm": entry.from_nm, "to_nm": entry.to_nm, "source": entry.source,
                })
            })
            .collect();
        return terminal::print_json(
            &serde_json::json!({ "schema": "thinfilm-materials/1", "materials": rows }),
        );
    }
    let mut text = format!("{:<22} {:>14}  source\n", "name", "nm");
    for entry in entries {
        let range = format!("{} - {}", entry.from_nm, entry.to_nm);
        text.push_str(&format!("{:<22} {range:>14}  {}\n", entry.name, entry.source));
    }
    terminal::print(&text)
}
