use std::path::PathBuf;

use lsfb_recording::cloud::CloudError;

/// Why what another program recorded could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The operating system refused.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// Why not.
        source: std::io::Error,
    },
    /// A bag is damaged, or has not what is looked for.
    #[error("{}: {problem}", path.display())]
    Bag {
        /// The file or folder.
        path: PathBuf,
        /// Where in it, what is wrong and what was expected.
        problem: String,
    },
    /// A file of a cloud is not what its ending says.
    #[error("{}: {problem}", path.display())]
    CloudFile {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        problem: String,
    },
    /// What a file packs is no cloud of a sensor.
    #[error("{}: {source}", path.display())]
    Cloud {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: CloudError,
    },
    /// A file of an unknown kind.
    #[error("{}: no cloud by its ending: {endings} are read", path.display())]
    UnknownEnding {
        /// The file.
        path: PathBuf,
        /// The endings that are known.
        endings: String,
    },
    /// A folder holds no cloud.
    #[error("{}: no cloud in this folder: files {endings} are read", path.display())]
    NoClouds {
        /// The folder.
        path: PathBuf,
        /// The endings that are known.
        endings: String,
    },
    /// Clouds go back in time.
    #[error("{}: its points are not later than those of the file before it: names are not in order of time, or some files carry times since an epoch and some do not", path.display())]
    CloudOrder {
        /// The file.
        path: PathBuf,
    },
}
