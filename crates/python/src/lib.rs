//! The compiled half of the Python package `nacre`: what Python sees of it is described in `nacre/_nacre.pyi`.
//!
//! A file a subject: each turns Python's arguments into those of a library, runs it without the interpreter's lock, and hands the result
//! back as NumPy arrays. What the libraries refuse becomes `InputError` with their own line.

/// What the stubs say of a name (build.rs).
macro_rules! stub {
    ($name:literal) => {
        include_str!(concat!(env!("OUT_DIR"), "/", $name))
    };
}

mod bake;
mod convert;
mod errors;
mod look;
mod ops;
mod pearl;
mod recipe;
mod table;
mod thinfilm;
mod why_not;

/// The extension module.
#[pyo3::pymodule]
mod _nacre {
    #[pymodule_export]
    use crate::bake::{bake, merge, walk_shard};
    #[pymodule_export]
    use crate::errors::InputError;
    #[pymodule_export]
    use crate::look::effects;
    #[pymodule_export]
    use crate::ops::{arrays, check, diff, export, plan_pearls};
    #[pymodule_export]
    use crate::pearl::Pearl;
    #[pymodule_export]
    use crate::recipe::{Recipe, recipes};
    #[pymodule_export]
    use crate::table::Table;
    #[pymodule_export]
    use crate::thinfilm::{
        film_amplitudes, film_colours, film_ensemble, film_field, film_intensity, film_spectrum,
    };
    #[pymodule_export]
    #[allow(non_upper_case_globals)] // Python's name for it
    const __version__: &str = env!("CARGO_PKG_VERSION");
}
