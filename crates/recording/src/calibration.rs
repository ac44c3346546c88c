//! Which calibration a recording carries: its rig, and the hash that names it.

use std::collections::BTreeMap;

use lsfb_geometry::Rig;

use crate::error::Error;
use crate::hash::sha256_of_bytes;
use crate::reader::Recording;

/// Attachment with the rig.
pub(crate) const RIG_ATTACHMENT: &str = "rig.toml";
/// Metadata record about the rig, for readers that do not know the attachment.
const RIG_METADATA: &str = "lsfb.rig";

/// The calibration in a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct RecordedCalibration {
    /// The rig.
    pub rig: Rig,
    /// SHA-256 of the rig's text as it lies in the recording, in hexadecimal.
    pub sha256: String,
    /// The hash that the recorder wrote beside it; `None` in recordings without one.
    pub stated_sha256: Option<String>,
}

/// SHA-256 of a rig's text in hexadecimal: the name of a calibration. That of a rig in a recording is the same.
pub fn rig_sha256(rig: &Rig) -> String {
    sha256_of_bytes(rig.to_toml().as_bytes())
}

/// What the metadata record about a rig says.
pub(crate) fn rig_metadata(rig: &Rig) -> (&'static str, BTreeMap<String, String>) {
    let mut entries = BTreeMap::from([
        ("name".to_owned(), rig.name.clone()),
        ("sha256".to_owned(), rig_sha256(rig)),
    ]);
    if let Some(time) = rig.calibrated_unix_s {
        entries.insert("calibrated_unix_s".to_owned(), time.to_string());
    }
    (RIG_METADATA, entries)
}

impl Recording {
    /// The rig that was attached.
    pub fn rig(&self) -> Result<Rig, Error> {
        Ok(self.calibration()?.rig)
    }

    /// The rig that was attached, and its hash.
    pub fn calibration(&self) -> Result<RecordedCalibration, Error> {
        let text = self.attachment(RIG_ATTACHMENT)?;
        let origin = format!("{} (attachment {RIG_ATTACHMENT})", self.path().display());
        Ok(RecordedCalibration {
            rig: Rig::from_toml(&String::from_utf8_lossy(&text), &origin)?,
            sha256: sha256_of_bytes(&text),
            // A rig can be used without it.
            stated_sha256: self
                .metadata(RIG_METADATA)
                .unwrap_or_default()
                .remove("sha256"),
        })
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, ImuNoiseModel, RigCamera, Se3};

    use super::*;

    /// The text is part of the format: another one would rename every calibration there is. Hash by `sha256sum`.
    #[test]
    fn the_text_that_is_hashed_and_its_hash() {
        let mut rig = Rig {
            calibrated_unix_s: Some(1_772_359_200),
            imus: lsfb_geometry::RigImu::from(ImuNoiseModel {
                gyro_noise_density: 1e-3,
                accel_noise_density: 1e-2,
                gyro_bias_walk: 1e-5,
                accel_bias_walk: 1e-4,
            })
            .alone(),
            ..Rig::empty("backpack")
        };
        rig.cameras.insert(
            "cam0".to_owned(),
            RigCamera {
                camera: Camera::pinhole(640, 400, [350.0, 350.25], [319.5, 199.5]),
                rig_from_camera: Se3::identity(),
                timing: Default::default(),
                sigmas: Default::default(),
            },
        );
        let expected = r#"calibrated_unix_s = 1772359200
name = "backpack"

[cameras.cam0.camera]
height = 400
width = 640

[cameras.cam0.camera.lens]
distortion = [0.0, 0.0, 0.0, 0.0, 0.0]
focal_px = [350.0, 350.25]
model = "pinhole-radtan"
principal_px = [319.5, 199.5]

[cameras.cam0.rig_from_camera]
rotation_xyzw = [0.0, 0.0, 0.0, 1.0]
translation_m = [0.0, 0.0, 0.0]

[imu]
accel_bias_walk = 0.0001
accel_noise_density = 0.01
gyro_bias_walk = 0.00001
gyro_noise_density = 0.001
"#;
        assert_eq!(rig.to_toml(), expected);
        assert_eq!(
            rig_sha256(&rig),
            "e18e32bd00b693158dd6feff3b06aa4429625f4457116d9c7fe614c6d1062695"
        );
        assert_eq!(rig_metadata(&rig).1["calibrated_unix_s"], "1772359200");
    }
}
