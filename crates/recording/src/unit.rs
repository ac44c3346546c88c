//! What was recorded about the devices themselves, so that mocks can stand in for them.

use serde::{Deserialize, Serialize};

use crate::error::Error;
use crate::reader::Recording;

/// Attachment that lists the [`CameraUnit`]s of a recording.
const CAMERA_UNITS: &str = "camera_units.json";

/// A file inside a recording.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Attachment {
    /// Its name.
    pub name: String,
    /// Its media type.
    pub media_type: String,
    /// Its content.
    pub bytes: Vec<u8>,
}

/// Cameras in one housing: their images come in one frame, side by side.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct CameraUnit {
    /// Names of the cameras, left to right.
    pub cameras: Vec<String>,
    /// Size of a frame, pixels.
    pub frame_px: [u32; 2],
    /// Frames per second that were asked for.
    pub rate_hz: u32,
    /// Name of the unit's own IMU; its answers are on `/raw/<imu>`.
    pub imu: Option<String>,
    /// What the unit keeps.
    pub files: Vec<KeptFile>,
}

/// A file that a unit keeps, as it answered with it.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct KeptFile {
    /// The unit's number for it.
    pub id: u8,
    /// Name of the attachment with the answer.
    pub attachment: String,
}

impl CameraUnit {
    /// The attachment that lists `units`.
    pub fn attachment(units: &[Self]) -> Attachment {
        Attachment {
            name: CAMERA_UNITS.to_owned(),
            media_type: "application/json".to_owned(),
            // Numbers and strings always serialise.
            bytes: serde_json::to_vec_pretty(units).unwrap_or_default(),
        }
    }
}

impl Recording {
    /// The camera units; none where the recording does not list them.
    pub fn camera_units(&self) -> Result<Vec<CameraUnit>, Error> {
        let json = match self.attachment(CAMERA_UNITS) {
            Ok(json) => json,
            Err(Error::MissingAttachment { .. }) => return Ok(Vec::new()),
            Err(error) => return Err(error),
        };
        serde_json::from_slice(&json).map_err(|problem| Error::BadAttachment {
            path: self.path().to_owned(),
            name: CAMERA_UNITS.to_owned(),
            problem: problem.to_string(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Writer, WriterConfig};

    #[test]
    fn units_are_read_back_and_a_broken_list_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let units = vec![CameraUnit {
            cameras: vec!["cam0".to_owned(), "cam1".to_owned()],
            frame_px: [2560, 800],
            rate_hz: 20,
            imu: Some("imu1".to_owned()),
            files: vec![KeptFile {
                id: 1,
                attachment: "cam0/1.bin".to_owned(),
            }],
        }];
        let list = CameraUnit::attachment(&units);
        let broken = Attachment {
            bytes: b"[{".to_vec(),
            ..list.clone()
        };
        let read = |attachment: Option<&Attachment>| {
            let path = folder.path().join("scan.mcap");
            let mut writer = Writer::create(&path, &WriterConfig::default()).unwrap();
            if let Some(a) = attachment {
                writer.attach(&a.name, &a.media_type, &a.bytes).unwrap();
            }
            writer.finish().unwrap();
            Recording::open(&path).unwrap().camera_units()
        };
        assert_eq!(read(Some(&list)).unwrap(), units);
        assert_eq!(read(None).unwrap(), []);
        let error = read(Some(&broken)).unwrap_err().to_string();
        assert!(error.contains("camera_units.json"), "{error}");
    }
}
