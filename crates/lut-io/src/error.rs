//! What can be wrong with a table or its file, said in one line.

use std::io;
use std::path::{Path, PathBuf};

/// One thing that is wrong with a table: where, and what would be right.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct FieldError {
    /// The offending field, channel or attribute (`per_incidence[3].albedo`, `channel interior`, …).
    pub field: String,
    /// The value found and what would be right.
    pub problem: String,
}

impl FieldError {
    /// An error of `field`.
    pub fn new(field: impl Into<String>, problem: impl Into<String>) -> Self {
        Self { field: field.into(), problem: problem.into() }
    }

    /// The same error of a field that lies in `parent`.
    #[must_use]
    pub fn within(self, parent: &str) -> Self {
        Self { field: format!("{parent}.{}", self.field), problem: self.problem }
    }
}

/// An error of `field` unless its value is finite and as it should be (`right`, in words).
pub(crate) fn check(field: &str, value: f64, ok: bool, right: &str) -> Result<(), FieldError> {
    ensure(field, ok && value.is_finite(), || format!("is {value}, expected {right}"))
}

/// An error of `field` unless all is well.
pub(crate) fn ensure(field: &str, ok: bool, problem: impl FnOnce() -> String) -> Result<(), FieldError> {
    if ok { Ok(()) } else { Err(FieldError::new(field, problem())) }
}

/// Why a table file could not be read or written. `Display` is one line that names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LutError {
    /// The operating system said no.
    #[error("{}: cannot {action}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What was tried (`read the file`, …).
        action: &'static str,
        /// The operating system's reason.
        source: io::Error,
    },
    /// The file is not a table, is damaged, or the table to be written is not valid.
    #[error("{}: {error}", path.display())]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        error: FieldError,
    },
}

impl LutError {
    pub(crate) fn io(path: &Path, action: &'static str, source: io::Error) -> Self {
        Self::Io { path: path.to_owned(), action, source }
    }

    pub(crate) fn invalid(path: &Path, error: FieldError) -> Self {
        Self::Invalid { path: path.to_owned(), error }
    }

    /// Whether the fault lies in what the caller named (a bad or missing file) rather than in the machine.
    #[must_use]
    pub fn is_bad_input(&self) -> bool {
        match self {
            Self::Invalid { .. } => true,
            Self::Io { action, source, .. } => {
                *action == READING
                    && matches!(
                        source.kind(),
                        io::ErrorKind::NotFound | io::ErrorKind::IsADirectory | io::ErrorKind::NotADirectory
                    )
            }
        }
    }
}

pub(crate) const READING: &str = "read the file";
