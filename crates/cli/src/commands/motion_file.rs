//! The motion of a walk as a ROS 2 bag.

use std::path::Path;

use lsfb_eval::covariance_in_world;
use lsfb_pipeline::ground_truth::GroundTruth;
use lsfb_recording::message::{self, Schema};
use lsfb_recording::{Channel, Writer, WriterConfig};
use lsfb_types::Timestamp;

/// The frame of the map, and that of the device.
const WORLD: &str = "world";
const RIG: &str = "rig";

/// Poses with their covariance at the images; pose, speed, turn rate and biases at the IMU's samples too; gravity once. The whole file or none.
pub fn write(found: &GroundTruth, path: &Path) -> anyhow::Result<()> {
    let mut part = path.as_os_str().to_owned();
    part.push(".part");
    let part = Path::new(&part);
    let written = write_all(found, part).and_then(|()| Ok(std::fs::rename(part, path)?));
    if written.is_err() {
        // The reason to report is that of the write.
        let _ = std::fs::remove_file(part);
    }
    super::about(path, written)
}

fn write_all(found: &GroundTruth, path: &Path) -> anyhow::Result<()> {
    let mut writer = Writer::create(path, &WriterConfig::default())?;
    let mut put = |topic, schema: Schema, time: Timestamp, bytes: &[u8]| {
        let channel = Channel {
            topic,
            schema_name: schema.name,
            schema_text: schema.text,
        };
        writer.write_cdr(&channel, time, time, bytes)
    };
    if let Some(first) = found.states.first() {
        let gravity = message::encode_vector(first.time, WORLD, &found.gravity_m_s2.into());
        put("/gravity", message::VECTOR, first.time, &gravity)?;
    }
    let poses = found.trajectory.poses().iter();
    for (pose, covariance) in poses.zip(&found.covariances) {
        let (time, place) = (pose.time, &pose.world_from_rig);
        let in_world = covariance_in_world(covariance, place);
        let values = std::array::from_fn(|i| in_world[(i / 6, i % 6)]);
        let pose = message::encode_pose_with_covariance(time, WORLD, place, &values);
        put("/pose", message::POSE_WITH_COVARIANCE, time, &pose)?;
    }
    for state in &found.states {
        let time = state.time;
        let pose = message::encode_pose(time, WORLD, &state.nav.world_from_rig);
        put("/imu_rate/pose", message::POSE, time, &pose)?;
        let vectors = [
            ("/imu_rate/velocity", WORLD, state.nav.velocity_m_s),
            ("/imu_rate/turn_rate", RIG, state.turn_rate_rad_s),
            ("/imu_rate/gyroscope_bias", RIG, state.bias.gyro_rad_s),
            ("/imu_rate/accelerometer_bias", RIG, state.bias.accel_m_s2),
        ];
        for (topic, frame, vector) in vectors {
            let vector = message::encode_vector(time, frame, &vector.into());
            put(topic, message::VECTOR, time, &vector)?;
        }
    }
    writer.finish()?;
    Ok(())
}
