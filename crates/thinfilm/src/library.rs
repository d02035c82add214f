//! Materials with sources: `data/materials/materials.json` of this crate.

use std::sync::LazyLock;

use serde::Deserialize;

use crate::material::{Dispersion, Material};

/// A material of the library.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// Its index.
    pub n: Dispersion,
    /// First vacuum wavelength that the source measured or fitted, nm.
    pub from_nm: f64,
    /// Last of them, nm. A formula or a constant is not cut off there: outside it is an extrapolation.
    pub to_nm: f64,
    /// Where the numbers come from.
    pub source: String,
}

static ENTRIES: LazyLock<Vec<Entry>> = LazyLock::new(|| {
    // A malformed file would fail the test below, never a user.
    serde_json::from_str(include_str!("../data/materials/materials.json")).unwrap_or_default()
});

/// All of them.
#[must_use]
pub fn entries() -> &'static [Entry] {
    &ENTRIES
}

/// A material by its name.
///
/// ```
/// let silica = thinfilm::library::material("fused-silica").ok_or("no such material")?;
/// // Malitson's n at the sodium D line.
/// assert!((silica.index(587.6e-9)?.re - 1.458_46).abs() < 1e-5);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[must_use]
pub fn material(name: &str) -> Option<Material> {
    let entry = entries().iter().find(|entry| entry.name == name)?;
    Some(Material { n: entry.n.clone(), k: 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// (name, nm, n, k) as the sources print them.
    #[test]
    fn indices_are_the_published_ones() {
        for (name, nm, n, k, digits) in [
            ("fused-silica", 587.5618, 1.458_46, 0.0, 1e-5),
            ("n-bk7", 587.5618, 1.516_80, 0.0, 5e-6),
            ("magnesium-fluoride-o", 587.5618, 1.3777, 0.0, 5e-5),
            ("calcite-o", 589.3, 1.6584, 0.0, 5e-4),
            ("calcite-e", 589.3, 1.4864, 0.0, 5e-4),
            ("water", 589.3, 1.333_4, 0.0, 2e-4),
            ("silver", 520.9, 0.05, 3.324, 1e-12),
            ("aragonite-beta-gamma", 589.3, 1.683, 0.0, 1e-12),
        ] {
            let index = material(name).unwrap().index(nm * 1e-9).unwrap();
            assert!((index.re - n).abs() <= digits && (index.im - k).abs() <= digits, "{name}: {index}");
        }
    }

    #[test]
    fn every_entry_is_usable_over_its_range_and_names_its_source() {
        assert_eq!(entries().len(), 10);
        for entry in entries() {
            assert!(entry.source.len() > 10 && entry.from_nm < entry.to_nm, "{}", entry.name);
            entry.n.check().unwrap();
            for nm in [entry.from_nm, 0.5 * (entry.from_nm + entry.to_nm), entry.to_nm] {
                // The table's ends in nm and metres differ in the last bit.
                let inside = nm.clamp(entry.from_nm * (1.0 + 1e-12), entry.to_nm * (1.0 - 1e-12));
                assert!(entry.n.at(inside * 1e-9).is_ok(), "{} {nm}", entry.name);
            }
        }
    }
}
