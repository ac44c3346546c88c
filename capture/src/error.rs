use std::path::PathBuf;

/// Why a recording could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A device could not be opened.
    #[error(transparent)]
    Device(#[from] lsfb_drivers::Error),
    /// The recording could not be written.
    #[error(transparent)]
    Recording(#[from] lsfb_recording::Error),
    /// The rig file is unusable.
    #[error(transparent)]
    Rig(#[from] lsfb_geometry::RigError),
    /// The list of devices is unusable.
    #[error("{}: {message}", path.display())]
    Config {
        /// The file.
        path: PathBuf,
        /// Line and reason.
        message: String,
    },
    /// A setting lies outside its bounds.
    #[error(transparent)]
    Setting(#[from] lsfb_types::OutOfBounds),
    /// A file could not be read.
    #[error("{}: {cause}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// Why.
        #[source]
        cause: std::io::Error,
    },
    /// A camera unit of the list of devices is unusable.
    #[error("camera unit [{names}]: {problem}")]
    Cameras {
        /// Names of its cameras.
        names: String,
        /// What is wrong.
        problem: String,
    },
    /// Two LiDARs would take each other's packets.
    #[error(
        "{first} and {second} listen on one port: set the address of each (`sensor`), or give each its own `data` and `position`, here and in the sensor"
    )]
    LidarPorts {
        /// One of them.
        first: String,
        /// The other.
        second: String,
    },
    /// Its settings cannot be used.
    #[error("{lidar}: {problem}")]
    LidarSettings {
        /// The LiDAR.
        lidar: String,
        /// What is wrong.
        problem: String,
    },
    /// Packets of two sensors that nothing tells apart.
    #[error(
        "{lidar}: packets of two sensors{} are mixed: capture each alone, or give each its own address; if there was only one sensor, its packets are of another model or return mode than the forced one",
        address.map_or(String::new(), |ip| format!(" at one address, {ip}"))
    )]
    TwoSensors {
        /// The LiDAR that they would be.
        lidar: String,
        /// Where both come from, where that is known.
        address: Option<std::net::IpAddr>,
    },
    /// The list of devices names none.
    #[error("no device is configured: add at least one of [lidar], [[camera]], [imu], [sidecar]")]
    NoDevice,
    /// A remark could not be recorded.
    #[error("the note was not recorded: {reason}")]
    Remark {
        /// Why.
        reason: &'static str,
    },
    /// The disk has no room for a recording.
    #[error(
        "{}: room for {:.1} minutes ({:.1} GB at {:.1} MB/s), but a recording needs {:.0}; free disk space, use another folder, or set recorder.least_space_secs",
        path.display(), secs / 60.0, *free_bytes as f64 / 1e9, bytes_per_sec / 1e6, needed_secs / 60.0
    )]
    NoSpace {
        /// The folder.
        path: PathBuf,
        /// Room on all disks together.
        free_bytes: u64,
        /// How long that lasts.
        secs: f64,
        /// At this rate.
        bytes_per_sec: f64,
        /// How long it should last.
        needed_secs: f64,
    },
    /// No thread could be started, or one ended without a word.
    #[error("thread {name}: {message}")]
    Thread {
        /// The thread.
        name: String,
        /// What happened.
        message: String,
    },
    /// The progress callback asked for an early end.
    #[error("{0}")]
    Stopped(#[from] lsfb_types::Stopped),
}
