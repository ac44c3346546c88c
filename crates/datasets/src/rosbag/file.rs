//! What the files of all formats have in common.

use std::path::Path;

use crate::Error;

/// What a bag gives its messages to, with those that it cannot read. Answered with an error it gives no more.
pub(super) type Visit<'a> = &'a mut dyn FnMut(Result<&[u8], String>) -> Result<(), String>;

/// That a file cannot be read, and why.
pub(super) fn unreadable(path: &Path, problem: impl std::fmt::Display) -> Error {
    Error::Bag {
        path: path.to_owned(),
        problem: problem.to_string(),
    }
}
