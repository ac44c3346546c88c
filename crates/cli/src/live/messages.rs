//! What passes the tap, for Foxglove and Rerun: the messages that go into the recording.

use std::collections::BTreeMap;

use lsfb_capture::Tapped;
use lsfb_geometry::{Rig, Se3};
use lsfb_operator::LiveMessage;
use lsfb_pipeline::loops::OnlineLoop;
use lsfb_pipeline::odometry::{MotionKind, OdometryStep, StepOutcome};
use lsfb_recording::message::{self, Schema, StaticTransform};
use lsfb_recording::{ODOM_FRAME, TF};
use lsfb_types::Timestamp;

use super::Outputs;
use super::odometry::LiveStep;

/// Shortest time between two images of a camera that are shown, nanoseconds: what an eye needs, and a wireless link bears.
const IMAGE_EVERY_NS: i64 = 190_000_000;
const RIG: &str = "rig";
/// Where Foxglove gets the direction along and about which a scan sees no motion; zero where it sees all.
const UNSEEN: [(&str, MotionKind); 2] = [
    ("/odometry/unseen_shift", MotionKind::Shift),
    ("/odometry/unseen_turn", MotionKind::Turn),
];

fn about<'a>(topic: &'a str, schema: &Schema, arrival: Timestamp) -> LiveMessage<'a> {
    LiveMessage {
        topic,
        schema_name: schema.name,
        schema_text: schema.text,
        arrival,
    }
}

/// The direction of a kind of motion that a scan does not see, in the frame `odom`.
fn unseen_of(step: &OdometryStep, kind: MotionKind) -> [f64; 3] {
    let unseen = step.unseen.filter(|unseen| unseen.kind == kind);
    unseen.map_or([0.0; 3], |unseen| unseen.direction_in_world.into())
}

impl Outputs {
    /// Shows something on its way into the recording. `cameras_sent`: when an image of each camera was shown last.
    pub fn send(&self, entry: &Tapped, cameras_sent: &mut BTreeMap<String, Timestamp>) {
        if let Tapped::Image { camera, image } = entry {
            let last = cameras_sent.get(camera);
            if last.is_some_and(|last| (image.time - *last).abs() < IMAGE_EVERY_NS) {
                return;
            }
            cameras_sent.insert(camera.clone(), image.time);
        }
        #[cfg(feature = "view")]
        if let Some(rerun) = &self.rerun {
            match entry {
                Tapped::Image { camera, image } => rerun.image(camera, image),
                Tapped::Imu { sample, .. } => rerun.imu(sample),
                _ => {}
            }
        }
        let Some(foxglove) = &self.foxglove else {
            return;
        };
        match entry {
            Tapped::Image { camera, image } => {
                let topic = format!("/{camera}/image");
                foxglove.publish(&about(&topic, &message::IMAGE, image.arrival), || {
                    message::encode_image(image.time, camera, &image.sample)
                });
            }
            Tapped::Imu { imu, sample } => {
                let topic = format!("/{imu}/data_raw");
                foxglove.publish(&about(&topic, &message::IMU, sample.arrival), || {
                    message::encode_imu(
                        sample.time,
                        imu,
                        &sample.sample,
                        message::ImuVariance::UNKNOWN,
                    )
                });
            }
            Tapped::Scan { lidar, scan, .. } => {
                let topic = format!("/{lidar}/points");
                let about = about(&topic, &message::POINT_CLOUD, scan.arrival);
                foxglove.publish(&about, || {
                    message::encode_points(scan.time, lidar, &scan.sample)
                });
            }
            Tapped::Message {
                topic,
                schema_name,
                schema_text,
                arrival,
                bytes,
                ..
            } => {
                let about = LiveMessage {
                    topic,
                    schema_name,
                    schema_text,
                    arrival: *arrival,
                };
                foxglove.publish(&about, || bytes.clone());
            }
        }
    }

    /// Shows where the sensors are and what the cameras' lenses do.
    pub fn send_rig(&self, rig: &Rig, now: Timestamp) {
        #[cfg(feature = "view")]
        if let Some(rerun) = &self.rerun {
            rerun.rig(rig);
        }
        let Some(foxglove) = &self.foxglove else {
            return;
        };
        let edge = |child: &str, rig_from_child: Se3| StaticTransform {
            parent: RIG.to_owned(),
            child: child.to_owned(),
            parent_from_child: rig_from_child,
        };
        let cameras = rig.cameras.iter();
        let mut edges: Vec<_> = cameras
            .map(|(name, camera)| edge(name, camera.rig_from_camera))
            .collect();
        let lidars = rig.lidars.iter();
        edges.extend(lidars.map(|(name, lidar)| edge(name, lidar.rig_from_lidar)));
        let imus = rig.imus.iter();
        edges.extend(imus.map(|(name, imu)| edge(name, imu.rig_from_imu)));
        foxglove.publish_latched(
            &about("/tf_static", &message::TF_MESSAGE, now),
            message::encode_static_transforms(now, &edges),
        );
        for (name, camera) in &rig.cameras {
            let topic = format!("/{name}/camera_info");
            foxglove.publish_latched(
                &about(&topic, &message::CAMERA_INFO, now),
                message::encode_camera_info(now, name, &camera.camera),
            );
        }
    }

    /// Shows that a place was recognised.
    pub fn send_loop(&self, found: &OnlineLoop) {
        #[cfg(feature = "view")]
        if let Some(rerun) = &self.rerun {
            rerun.found_loop(
                found.found.later,
                &found.world_from_earlier.translation,
                &found.world_from_later.translation,
            );
        }
        #[cfg(not(feature = "view"))]
        let _ = found;
    }

    /// Shows where the rig is, and what the LiDAR saw there. Of a scan that found no place nothing is known.
    pub fn send_step(&self, live: &LiveStep, now: Timestamp) {
        #[cfg(feature = "view")]
        if let Some(rerun) = &self.rerun {
            if live.step.begins_again() {
                rerun.begin_again();
            }
            for step in live.step.placed() {
                let unseen = step.unseen.map(|unseen| unseen.direction_in_world);
                rerun.step(
                    step.time,
                    &step.world_from_rig,
                    &step.keypoints_in_rig,
                    unseen,
                );
            }
        }
        if let (Some(foxglove), Some(pose)) = (&self.foxglove, &live.at_cloud) {
            foxglove.publish(&about(TF, &message::TF_MESSAGE, now), || {
                message::encode_odometry(pose.time, &pose.world_from_rig)
            });
        }
        if let Some(foxglove) = &self.foxglove
            && live.step.outcome != StepOutcome::Lost
        {
            for (topic, kind) in UNSEEN {
                foxglove.publish(&about(topic, &message::VECTOR, now), || {
                    message::encode_vector(live.step.time, ODOM_FRAME, &unseen_of(&live.step, kind))
                });
            }
        }
    }
}
