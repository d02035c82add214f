//! Prices: every number that was fitted to a machine. Seconds are those of one core with AVX-512, bytes those of a file.
//!
//! They choose between solvers, decide what is cheap enough to be measured beside a bake, and foretell what bakes take.
//! `cargo run --release -p bake-brdf --example prices` measures them all again, in their order here, and those of doubling's own
//! operations, which are `transport::doubling::prices`.

use transport::Geometry;

/// What making rows of a table from a solution is counted in: incidences, half-way ones included, and values that
/// basis functions take in cells.
pub const ROWS: [&str; 2] = ["row", "basis value in a row"];
/// What a walk is counted in: crossings (weighted by the effects they carry), paths, and rows of the table.
pub const WALKED: [&str; 3] = ["crossing", "path", "row"];

/// Seconds for each of [`ROWS`]; what a row takes by itself is in the price of an incidence.
pub(crate) const fn rows(geometry: Geometry) -> [f64; ROWS.len()] {
    match geometry {
        Geometry::Plane => [0.0, 1.4e-8],
        Geometry::Space => [0.0, 5.6e-9],
    }
}

/// Seconds for each of [`WALKED`].
pub(crate) const fn walked(geometry: Geometry) -> [f64; WALKED.len()] {
    match geometry {
        Geometry::Plane => [1.9e-9, 2.6e-8, 2.8e-4],
        Geometry::Space => [2.2e-9, 3.1e-8, 4.5e-3],
    }
}

/// Seconds behind a crossing of the walk, for what may be measured beside it.
pub(crate) const CROSSING: f64 = 1.5e-9;

/// Factors of the effects on a crossing: 64-bit geometry, visible normals, absorption, faces of complex index.
pub(crate) const DOUBLE_PRECISION: f64 = 1.8;
pub(crate) const VISIBLE: f64 = 1.4;
pub(crate) const ABSORBING: f64 = 1.2;
pub(crate) const COMPLEX: f64 = 2.0;

/// Seconds of a wave through a stack by itself and for each layer, by whether the stack repeats and whether it absorbs.
pub(crate) const fn reflectance(repeats: bool, absorbs: bool) -> [f64; 2] {
    match (repeats, absorbs) {
        (true, false) => [6e-8, 1.7e-10],
        (true, true) => [2e-7, 5e-10],
        (false, false) => [5e-8, 6e-10],
        (false, true) => [6e-8, 2.5e-9],
    }
}
/// The same for stacks so deep that their periods are doubled.
pub(crate) const DOUBLED: [f64; 2] = [1.3e-5, 0.0];
/// The same for a wave with its field.
pub(crate) const FIELD: [f64; 2] = [4e-8, 2.5e-9];

/// Seconds that a row of a table takes beside its solution, most of them on one thread.
pub(crate) const fn row_beside(geometry: Geometry) -> f64 {
    match geometry {
        Geometry::Plane => 2.5e-4,
        Geometry::Space => 3e-3,
    }
}
/// Reading, assembling and writing a table beside its rows, seconds; the file's header and metadata, bytes.
pub(crate) const OVERHEAD_SECONDS: f64 = 0.01;
pub(crate) const HEADER_BYTES: u64 = 5_000;
/// Bytes of metadata an incidence, and compressed bytes a cell, by solver: of the paper's pearl.
pub(crate) const INCIDENCE_BYTES: u64 = 700;
pub(crate) const WALK_CELL_BYTES: f64 = 23.0;
pub(crate) const DOUBLING_CELL_BYTES: f64 = 16.0;
/// Bytes of M and Ê in the metadata: 91 and 19 angles of 80 bands as JSON text (a regular stack's M; an irregular one's
/// has 19 angles too).
pub(crate) const SPECTRUM_BYTES: [u64; 2] = [80_000, 17_000];
/// The same of what thickness as a control adds to either: wavelengths beyond the visible range, and RGB at scales.
pub(crate) const SCALED_BYTES: [u64; 2] = [600_000, 150_000];

/// Seconds that a cheap solution for the choice of bands takes beside its doubling (its lobes become cells), and a layer of the
/// smooth stack at an incidence.
pub(crate) const BAND_SOLVED: f64 = 2e-3;
pub(crate) const BAND_SMOOTH: f64 = 1e-7;

/// Seconds of so many things at their prices.
pub(crate) fn sum(counts: &[f64], prices: &[f64]) -> f64 {
    counts.iter().zip(prices).map(|(count, price)| count * price).sum()
}
