use std::path::PathBuf;

/// What can go wrong in the simulator.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A parameter makes no sense.
    #[error("simulator config: {field} is {got}, expected {expected}")]
    Config {
        /// The field's name.
        field: &'static str,
        /// Its value.
        got: String,
        /// What it must be.
        expected: &'static str,
    },
    /// A truth file could not be written.
    #[error("cannot write {}: {source}; check that the folder exists and has space left", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
}
