use std::path::PathBuf;

/// What can go wrong in the simulator.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A setting lies outside its bounds.
    #[error("simulator: {0}")]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// A simulated device could not talk to its host.
    #[error("simulated device: {0}")]
    Device(#[from] lsfb_drivers::Error),
    /// A simulated device could not put its data into the wire format.
    #[error("simulated device: {0}")]
    Wire(#[from] lsfb_drivers::WireError),
    /// The host takes no more packets.
    #[error(
        "{device}: the host has received {received} of {sent} packets and accepts no more; is it still recording?"
    )]
    Stalled {
        /// Which device.
        device: &'static str,
        /// Packets sent.
        sent: u64,
        /// Packets that the host says it has.
        received: u64,
    },
    /// What is to be played cannot be read.
    #[error(transparent)]
    Recording(#[from] lsfb_recording::Error),
    /// What is to be played does not fit together.
    #[error("{}: {problem}", path.display())]
    Source {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// A thread of a device could not start, or died.
    #[error("thread {name} of the simulator: {problem}")]
    Thread {
        /// Its name.
        name: String,
        /// What happened.
        problem: String,
    },
    /// A truth file could not be written.
    #[error("cannot write {}: {source}; check that the folder exists and has space left", path.display())]
    Write {
        /// The file.
        path: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// A scene file could not be used.
    #[error("scene {}: {problem}", path.display())]
    Scene {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: String,
    },
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}
