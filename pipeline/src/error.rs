use std::path::{Path, PathBuf};

/// What can go wrong in this crate: what, where, and what to do about it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read or written.
    #[error("{path}: {source}", path = path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A configuration value has no meaning.
    #[error("configuration: {field} is {value}, must be {expected}")]
    Config {
        /// The field, with its section.
        field: &'static str,
        /// What was given.
        value: String,
        /// What is allowed.
        expected: &'static str,
    },
    /// A camera is used that the rig does not have.
    #[error("camera {camera} is not on rig {rig}: give the rig file that belongs to these images")]
    UnknownCamera {
        /// The camera asked for.
        camera: String,
        /// The rig's name.
        rig: String,
    },
}

impl Error {
    /// Names the path in an I/O error: `fs::read(path).map_err(Error::io(path))`.
    pub fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_owned();
        move |source| Self::Io { path, source }
    }
}
