//! Which program a recording is of, by what is in it.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use flate2::read::MultiGzDecoder;
use serde::Serialize;

use super::table::find;
use super::vrs::MAGIC;
use crate::Error;

/// A program, or a dataset, by the layout of its files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Format {
    /// EuRoC MAV and TUM-VI: `mav0/`.
    Euroc,
    /// Microsoft Indoor Location 2.0: one text per walk.
    IndoorLocation,
    /// ios_logger: `Accel.txt`, `Gyro.txt`, ….
    IosLogger,
    /// StrayScanner: `odometry.csv`, `rgb.mp4`.
    StrayScanner,
    /// MARSLogger: `gyro_accel.csv`, `movie.mp4`.
    MarsLogger,
    /// VideoIMUCapture: `video_meta.pb3`, `video_recording.mp4`.
    VideoImuCapture,
    /// Spectacular Rec: `data.jsonl`, `data.mkv`.
    SpectacularRec,
    /// kapture: `sensors/sensors.txt`.
    Kapture,
    /// A session of LaMAR's capture format: `sensors.txt`, `raw_data/`.
    Lamar,
    /// Glasses of Project Aria: a VRS file.
    AriaVrs,
}

/// How a walk of Indoor Location 2.0 begins.
const WALK_BEGINS: &[u8] = b"#\tstartTime:";
/// What some editors put before a text.
const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";

impl Format {
    /// Every format.
    pub const ALL: [Self; 10] = [
        Self::Euroc,
        Self::IndoorLocation,
        Self::IosLogger,
        Self::StrayScanner,
        Self::MarsLogger,
        Self::VideoImuCapture,
        Self::SpectacularRec,
        Self::Kapture,
        Self::Lamar,
        Self::AriaVrs,
    ];

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::Euroc => "euroc",
            Self::IndoorLocation => "indoor-location",
            Self::IosLogger => "ios-logger",
            Self::StrayScanner => "stray-scanner",
            Self::MarsLogger => "mars-logger",
            Self::VideoImuCapture => "video-imu-capture",
            Self::SpectacularRec => "spectacular-rec",
            Self::Kapture => "kapture",
            Self::Lamar => "lamar",
            Self::AriaVrs => "aria-vrs",
        }
    }

    /// Which format a file or folder is in.
    pub(super) fn of(source: &Path) -> Result<Self, Error> {
        std::fs::metadata(source).map_err(|e| super::io(source, e))?;
        let found: Vec<Self> = Self::ALL.into_iter().filter(|f| f.fits(source)).collect();
        match found[..] {
            [only] => Ok(only),
            _ => {
                let list = |formats: &[Self]| {
                    let names: Vec<&str> = formats.iter().map(|f| f.name()).collect();
                    names.join(", ")
                };
                Err(Error::Unrecognised {
                    path: source.to_owned(),
                    problem: match found.is_empty() {
                        true => format!(
                            "not a supported recording: supported are {}; name a LaMAR session itself (sessions/NAME)",
                            list(&Self::ALL)
                        ),
                        false => format!("it may be {}: choose one with --format", list(&found)),
                    },
                })
            }
        }
    }

    fn fits(self, source: &Path) -> bool {
        let has = |name: &str| find(source, name).is_some();
        match self {
            Self::Euroc => euroc_folder(source).is_some(),
            Self::IndoorLocation => source.is_file() && begins_with(source, WALK_BEGINS),
            // Half of a folder is told with what is missing.
            Self::IosLogger => has("Accel.txt") || has("Gyro.txt"),
            Self::StrayScanner => {
                (has("odometry.csv") || has("rgb.mp4"))
                    && (has("camera_matrix.csv") || has("imu.csv"))
            }
            Self::MarsLogger => has("gyro_accel.csv") || has("frame_timestamps.txt"),
            Self::VideoImuCapture => has("video_meta.pb3"),
            Self::SpectacularRec => has("data.jsonl"),
            Self::Kapture => source.join("sensors").join("sensors.txt").is_file(),
            Self::Lamar => {
                has("sensors.txt") && (has("images.txt") || source.join("raw_data").is_dir())
            }
            Self::AriaVrs => source.is_file() && begins_with(source, MAGIC),
        }
    }
}

/// `mav0` of a recording, whichever folder of it is named.
pub(super) fn euroc_folder(source: &Path) -> Option<PathBuf> {
    let holds_sensors = |folder: &Path| {
        ["imu0", "cam0"]
            .iter()
            .any(|sensor| folder.join(sensor).join("data.csv").is_file())
    };
    let candidates = [source.to_owned(), source.join("mav0")];
    candidates.into_iter().find(|folder| holds_sensors(folder))
}

fn begins_with(path: &Path, text: &[u8]) -> bool {
    let Ok(file) = std::fs::File::open(path) else {
        return false;
    };
    let limit = (BYTE_ORDER_MARK.len() + text.len()) as u64;
    let mut start = Vec::new();
    let read = match path.extension().is_some_and(|e| e == "gz") {
        true => MultiGzDecoder::new(file)
            .take(limit)
            .read_to_end(&mut start),
        false => file.take(limit).read_to_end(&mut start),
    };
    let start = start.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&start);
    read.is_ok() && start.starts_with(text)
}
