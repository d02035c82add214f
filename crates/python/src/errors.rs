//! Errors of the libraries as Python's exceptions.

use bake_brdf::bake::BakeError;
use lut_io::LutError;
use pyo3::PyErr;
use pyo3::exceptions::{PyKeyboardInterrupt, PyOSError, PyRuntimeError, PyValueError};
use std::fmt::Display;
use std::path::Path;

pyo3::create_exception!(
    nacre,
    InputError,
    PyValueError,
    "Input that cannot be used: one line that names the field, the value and what would be right."
);

/// Input that cannot be used.
pub(crate) fn input(why: impl Display) -> PyErr {
    InputError::new_err(why.to_string())
}

/// A field of the caller's that cannot be used.
pub(crate) fn field(name: &str, why: impl Display) -> PyErr {
    input(format_args!("{name}: {why}"))
}

/// Something that should not happen.
pub(crate) fn failure(why: impl Display) -> PyErr {
    PyRuntimeError::new_err(why.to_string())
}

/// Why a bake gave no table.
pub(crate) fn of_bake(error: &BakeError) -> PyErr {
    match error {
        BakeError::Interrupted => PyKeyboardInterrupt::new_err(()),
        other => input(other),
    }
}

/// Why a table was not read or written.
pub(crate) fn of_file(error: LutError) -> PyErr {
    match error {
        bad if bad.is_bad_input() => input(bad),
        LutError::Io { path, source, .. } => of_io(&path, &source),
        other => PyOSError::new_err(other.to_string()),
    }
}

/// Python's own exception for an error of the system, with the file's name: `FileNotFoundError`, `PermissionError` …
pub(crate) fn of_io(path: &Path, error: &std::io::Error) -> PyErr {
    match error.raw_os_error() {
        Some(number) => PyOSError::new_err((number, error.to_string(), path.display().to_string())),
        None => std::io::Error::new(error.kind(), format!("{}: {error}", path.display())).into(),
    }
}
