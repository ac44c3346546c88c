//! What calibration without a target reads of a recording.

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::{Rig, RigCamera, Vector3};
use lsfb_recording::Recording;
use lsfb_types::Image;

use crate::Error;

pub(crate) fn unreadable(recording: &Recording) -> impl Fn(lsfb_recording::Error) -> Error + '_ {
    |e| Error::Parse {
        path: recording.path().display().to_string(),
        problem: e.to_string(),
    }
}

/// Seconds of a time in nanoseconds after the recording's first.
pub(crate) fn seconds(time_ns: i64, recording: &Recording) -> f64 {
    let start = recording.arrival_range().map_or(0, |r| r.start.nanos());
    time_ns.saturating_sub(start) as f64 * 1e-9
}

/// The gyroscope of a recording; `None` where it has none.
pub(crate) fn gyro(recording: &Recording) -> Result<Option<IntegratedGyro>, Error> {
    let Ok(samples) = recording.imu() else {
        return Ok(None);
    };
    let mut rates = Vec::new();
    for sample in samples {
        let sample = sample.map_err(unreadable(recording))?;
        let rate = Vector3::from(sample.sample.angular_velocity_rad_s);
        rates.push((seconds(sample.time.nanos(), recording), rate));
    }
    rates.sort_by(|a, b| a.0.total_cmp(&b.0));
    Ok((rates.len() > 2).then(|| IntegratedGyro::new(rates)))
}

/// The rig's cameras that a recording has, by name, and why it has not the others.
pub(crate) type Cameras<'a> = (Vec<(&'a str, &'a RigCamera)>, Vec<(&'a str, String)>);

/// The rig's cameras in a recording.
pub(crate) fn cameras<'a>(recording: &Recording, rig: &'a Rig) -> Cameras<'a> {
    let (mut present, mut absent) = (Vec::new(), Vec::new());
    for (name, camera) in &rig.cameras {
        match recording.images(name) {
            Ok(_) => present.push((name.as_str(), camera)),
            Err(error) => absent.push((name.as_str(), error.to_string())),
        }
    }
    (present, absent)
}

/// An error where an image is not of the size that the rig's lens is for.
pub(crate) fn expect_size(
    recording: &Recording,
    name: &str,
    mounted: &RigCamera,
    image: &Image,
) -> Result<(), Error> {
    let size = (image.width, image.height);
    if size == (mounted.camera.width, mounted.camera.height) {
        return Ok(());
    }
    Err(Error::Parse {
        path: recording.path().display().to_string(),
        problem: format!(
            "camera {name}: images are {} × {} pixels, but the rig's lens is for {} × {}",
            size.0, size.1, mounted.camera.width, mounted.camera.height
        ),
    })
}
