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
    #[error("{}: not a point cloud by its extension: supported are {endings}", path.display())]
    UnknownEnding {
        /// The file.
        path: PathBuf,
        /// The endings that are known.
        endings: String,
    },
    /// A folder holds no cloud.
    #[error("{}: no point cloud in this folder: supported are {endings}", path.display())]
    NoClouds {
        /// The folder.
        path: PathBuf,
        /// The endings that are known.
        endings: String,
    },
    /// Clouds go back in time.
    #[error("{}: its points are not later than those of the previous file: names are not in order of time, or only some files have times since an epoch", path.display())]
    CloudOrder {
        /// The file.
        path: PathBuf,
    },
    /// Nobody knows which program a recording is of.
    #[error("{}: {problem}", path.display())]
    Unrecognised {
        /// The file or folder.
        path: PathBuf,
        /// What was looked for.
        problem: String,
    },
    /// A recording of another program is damaged, or not what it seems to be.
    #[error("{}: {problem}", path.display())]
    Recorded {
        /// The file or folder.
        path: PathBuf,
        /// What is wrong, and where.
        problem: String,
    },
    /// Stamps follow each other as those of no such sensor do.
    #[error("{}: {what}: its records are {period_s:e} s apart, which is implausible: its stamps are in another unit; if the format leaves it open, give it with --stamp-unit", path.display())]
    StampUnit {
        /// The file or folder.
        path: PathBuf,
        /// Which records.
        what: String,
        /// Median time between two of them, seconds.
        period_s: f64,
    },
    /// Records of one source were stamped by clocks that have nothing to do with each other.
    #[error("{}: {early} is at {early_s:.3} s but {late} at {late_s:.3} s: they were stamped by different clocks, or in different units", path.display())]
    ClocksApart {
        /// The file or folder.
        path: PathBuf,
        /// The records with the earliest stamps.
        early: String,
        /// The middle of them, seconds.
        early_s: f64,
        /// The records with the latest stamps.
        late: String,
        /// The middle of them, seconds.
        late_s: f64,
    },
    /// The recording could not be written.
    #[error(transparent)]
    Recording(#[from] lsfb_recording::Error),
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}
