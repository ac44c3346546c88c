//! Poses in a ROS 2 bag.

use std::path::Path;

use lsfb_geometry::{Matrix6, StampedPose};
use lsfb_recording::{Channel, Writer, WriterConfig, message};

use crate::{Error, covariance_in_world};

const TOPIC: &str = "/pose";
/// The frame in which the poses are.
const FRAME: &str = "world";

/// Messages are stamped and logged at the times of the poses.
pub(super) fn write(
    poses: &[StampedPose],
    covariances: &[Matrix6<f64>],
    out: &Path,
) -> Result<(), Error> {
    // The whole file or none.
    let mut part = out.as_os_str().to_owned();
    part.push(".part");
    let part = Path::new(&part);
    let written = write_all(poses, covariances, part).and_then(|()| {
        std::fs::rename(part, out).map_err(|source| Error::Io {
            path: out.to_owned(),
            source,
        })
    });
    if written.is_err() {
        // The reason to report is the one above.
        let _ = std::fs::remove_file(part);
    }
    written
}

fn write_all(
    poses: &[StampedPose],
    covariances: &[Matrix6<f64>],
    path: &Path,
) -> Result<(), Error> {
    let schema = match covariances.is_empty() {
        true => message::POSE,
        false => message::POSE_WITH_COVARIANCE,
    };
    let channel = Channel {
        topic: TOPIC,
        schema_name: schema.name,
        schema_text: schema.text,
    };
    let mut writer = Writer::create(path, &WriterConfig::default())?;
    for (i, pose) in poses.iter().enumerate() {
        let (time, place) = (pose.time, &pose.world_from_rig);
        let bytes = match covariances.get(i) {
            None => message::encode_pose(time, FRAME, place),
            Some(covariance) => {
                let in_world = covariance_in_world(covariance, place);
                let values = std::array::from_fn(|i| in_world[(i / 6, i % 6)]);
                message::encode_pose_with_covariance(time, FRAME, place, &values)
            }
        };
        writer.write_cdr(&channel, time, time, &bytes)?;
    }
    writer.finish()?;
    Ok(())
}
