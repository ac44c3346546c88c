//! Keyframes: where on the trajectory, and with which images.

use std::collections::BTreeMap;

use lsfb_geometry::{Rig, Se3, StampedPose, Trajectory, Vector3};
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_types::{Image, Progress, ProgressFn, Stamped, Timestamp};

use super::{MappingConfig, MappingWarning};
use crate::features::{FeatureDetector, Features};
use crate::frames::clock_offsets_ns;
use crate::hd_map::{KeyframeImage, MapPoint};
use crate::lidar_features::LidarFeatures;
use crate::odometry::Damages;
use crate::{Error, Refusal};

/// A moment whose pose is optimised: images of different times belong to different keyframes.
pub(super) struct Keyframe {
    /// When its images were taken.
    pub time: Timestamp,
    /// Pose, from the odometry at first.
    pub world_from_rig: Se3,
    /// Features of the scans around it, in the rig frame at `time`.
    pub lidar: Option<LidarFeatures>,
}

/// Keyframes and their images.
pub(super) struct Keyframes {
    pub frames: Vec<Keyframe>,
    pub images: Vec<KeyframeImage>,
}

impl Keyframes {
    /// Times and current poses.
    pub(super) fn poses(&self) -> Vec<StampedPose> {
        let pose = |k: &Keyframe| StampedPose {
            time: k.time,
            world_from_rig: k.world_from_rig,
        };
        self.frames.iter().map(pose).collect()
    }

    /// Puts each keyframe where a pose in their order has it.
    pub(super) fn place(&mut self, poses: &[StampedPose]) {
        for (keyframe, pose) in self.frames.iter_mut().zip(poses) {
            keyframe.world_from_rig = pose.world_from_rig;
        }
    }

    /// Distance of a point from the nearest camera that sees it, metres.
    pub(super) fn nearest_camera_m(&self, rig: &Rig, point: &MapPoint) -> f64 {
        let cameras = self.cameras_of(rig, point);
        let distances = cameras.map(|camera| (camera - point.point_in_world).norm());
        distances.fold(f64::INFINITY, f64::min)
    }

    /// Where the cameras that see a point are, in the world.
    pub(super) fn cameras_of<'a>(
        &'a self,
        rig: &'a Rig,
        point: &'a MapPoint,
    ) -> impl Iterator<Item = Vector3<f64>> + 'a {
        point.observations.iter().filter_map(|o| {
            let image = self.images.get(o.image)?;
            let mounted = rig.cameras.get(&image.camera)?;
            let world_from_rig = self.frames.get(image.keyframe)?.world_from_rig;
            Some(world_from_rig * mounted.rig_from_camera.translation)
        })
    }

    /// Makes keyframes without images of those moments that no image is near to: their scans lead over the hole.
    fn bridge(&mut self, moments: &[Timestamp], trajectory: &Trajectory) {
        let times: Vec<Timestamp> = self.frames.iter().map(|k| k.time).collect();
        let has_image = |moment: &Timestamp| {
            let next = times.partition_point(|time| time < moment);
            let near = times[next.saturating_sub(1)..].iter().take(2);
            let mut secs = near.map(|time| time.secs_since(*moment).abs());
            secs.any(|secs| secs <= IMAGE_NEAR_S)
        };
        let bare = moments.iter().filter(|moment| !has_image(moment));
        let bare = bare.filter_map(|moment| {
            Some(Keyframe {
                time: *moment,
                world_from_rig: trajectory.at(*moment)?,
                lidar: None,
            })
        });
        let bare: Vec<Keyframe> = bare.collect();
        self.frames.extend(bare);
        self.frames.sort_by_key(|k| k.time);
        for image in &mut self.images {
            let time = times[image.keyframe];
            image.keyframe = self.frames.partition_point(|k| k.time < time);
        }
    }
}

/// Of cameras at 2 Hz and more every moment is so near to an image, seconds.
const IMAGE_NEAR_S: f64 = 0.25;

/// Offsets of clocks that differ by less are one, seconds: somebody who turns by 60° a second moves a wide image by 0.2 px in that time.
const ONE_CLOCK_S: f64 = 5e-4;
/// Images detected at once: bounds the memory.
const BATCH: usize = 32;

/// The cameras that are both on the rig and in the recording; the missing ones are named in `warnings`.
pub(super) fn find_cameras(
    recording: &Recording,
    rig: &Rig,
    warnings: &mut Vec<MappingWarning>,
) -> Result<Vec<String>, Error> {
    let mut names = Vec::new();
    for name in rig.cameras.keys() {
        match recording.images(name) {
            Ok(_) => names.push(name.clone()),
            Err(error) => warnings.push(MappingWarning::CameraMissing {
                camera: name.clone(),
                reason: error.to_string(),
            }),
        }
    }
    if names.is_empty() {
        return Err(Refusal::NoImages {
            path: recording.path().to_owned(),
            rig: rig.name.clone(),
        }
        .into());
    }
    Ok(names)
}

/// Moments on the trajectory at least a distance or an angle apart, its first and its last among them: before the first keyframe and behind the last one
/// nothing would mend it.
fn moments(trajectory: &Trajectory, distance_m: f64, angle_rad: f64) -> Vec<Timestamp> {
    let mut moments = Vec::new();
    let mut last: Option<Se3> = None;
    for pose in trajectory.poses() {
        let far = last.is_none_or(|last| {
            let moved = last.inverse() * pose.world_from_rig;
            moved.translation.norm() >= distance_m || moved.rotation.angle() >= angle_rad
        });
        if far {
            moments.push(pose.time);
            last = Some(pose.world_from_rig);
        }
    }
    let end = trajectory.poses().last().map(|pose| pose.time);
    moments.extend(end.filter(|end| moments.last() != Some(end)));
    moments
}

/// What the rig file adds to the stamps of each camera. Clocks that differ by less than [`ONE_CLOCK_S`] keep the images of one trigger
/// together: one keyframe, not four.
fn keyframe_offsets_ns(rig: &Rig, cameras: &[&str]) -> Vec<i64> {
    let own_ns = clock_offsets_ns(rig, cameras);
    let middle_ns = median(own_ns.iter().map(|ns| *ns as f64).collect()).unwrap_or(0.0);
    let is_shared = |ns: i64| (ns as f64 - middle_ns).abs() < 1e9 * ONE_CLOCK_S;
    let shared = own_ns.into_iter().map(|ns| match is_shared(ns) {
        true => middle_ns.round() as i64,
        false => ns,
    });
    shared.collect()
}

/// Chooses keyframes along the trajectory and detects the features of their images.
pub(super) fn choose_keyframes(
    recording: &Recording,
    cameras: &[String],
    trajectory: &Trajectory,
    detector: &FeatureDetector,
    config: &MappingConfig,
    damages: &mut Damages,
    progress: ProgressFn<'_>,
) -> Result<Keyframes, Error> {
    let moments = moments(
        trajectory,
        config.keyframe_distance_m,
        config.keyframe_angle_deg.to_radians(),
    );
    let total = (moments.len() * cameras.len()) as u64;
    let names: Vec<&str> = cameras.iter().map(String::as_str).collect();
    let mut pickers = vec![Picker::default(); names.len()];
    let mut waiting: Vec<Picked> = Vec::new();
    let mut found: BTreeMap<(Timestamp, usize), Features> = BTreeMap::new();
    let mut detect = |waiting: &mut Vec<Picked>| -> Result<(), Error> {
        let images: Vec<&Image> = waiting.iter().map(|p| &p.image.sample).collect();
        let before = found.len() as u64;
        let features = detector.detect_all(&images, &|p| {
            progress(Progress {
                done: before + p.done,
                total,
                ..p
            })
        })?;
        for (picked, features) in waiting.drain(..).zip(features) {
            found.insert((picked.image.time, picked.camera), features);
        }
        Ok(())
    };
    let rig = recording.rig()?;
    let offsets_ns = keyframe_offsets_ns(&rig, &names);
    for item in recording.images_of(&names)? {
        let Some(mut item) = damages.keep(item) else {
            continue;
        };
        item.image.time = item.image.time + offsets_ns[item.camera];
        // Poses are known between the first and the last scan only.
        if trajectory.at(item.image.time).is_none() {
            continue;
        }
        pickers[item.camera].offer(&moments, item.camera, item.image, &mut waiting);
        if waiting.len() >= BATCH {
            detect(&mut waiting)?;
        }
    }
    for (camera, picker) in pickers.into_iter().enumerate() {
        picker.finish(&moments, camera, &mut waiting);
    }
    detect(&mut waiting)?;
    let mut keyframes = assemble(found, cameras, trajectory);
    if rig.lidar().is_some() && !keyframes.images.is_empty() {
        keyframes.bridge(&moments, trajectory);
    }
    Ok(keyframes)
}

fn assemble(
    found: BTreeMap<(Timestamp, usize), Features>,
    cameras: &[String],
    trajectory: &Trajectory,
) -> Keyframes {
    let mut keyframes = Keyframes {
        frames: Vec::new(),
        images: Vec::new(),
    };
    for ((time, camera), features) in found {
        let Some(world_from_rig) = trajectory.at(time) else {
            continue;
        };
        if keyframes.frames.last().is_none_or(|k| k.time != time) {
            keyframes.frames.push(Keyframe {
                time,
                world_from_rig,
                lidar: None,
            });
        }
        keyframes.images.push(KeyframeImage {
            keyframe: keyframes.frames.len() - 1,
            camera: cameras[camera].clone(),
            features,
        });
    }
    keyframes
}

/// An image chosen for a moment.
struct Picked {
    camera: usize,
    image: Stamped<Image>,
}

/// Finds the image nearest to each moment in one camera's stream, however far it is: images have the poses of their own times, and a moment that none were
/// taken for would leave a hole that the start alone bridges.
#[derive(Clone, Default)]
struct Picker {
    next: usize,
    previous: Option<Stamped<Image>>,
    used: Option<Timestamp>,
}

impl Picker {
    fn offer(
        &mut self,
        moments: &[Timestamp],
        camera: usize,
        image: Stamped<Image>,
        out: &mut Vec<Picked>,
    ) {
        while let Some(moment) = moments.get(self.next).filter(|m| **m <= image.time) {
            let previous = self.previous.as_ref();
            let nearest = match previous {
                Some(p) if *moment - p.time < image.time - *moment => p,
                _ => &image,
            };
            let nearest = nearest.clone();
            self.pick(camera, nearest, out);
        }
        self.previous = Some(image);
    }

    fn finish(mut self, moments: &[Timestamp], camera: usize, out: &mut Vec<Picked>) {
        if let (true, Some(last)) = (self.next < moments.len(), self.previous.take()) {
            self.pick(camera, last, out);
        }
    }

    fn pick(&mut self, camera: usize, image: Stamped<Image>, out: &mut Vec<Picked>) {
        // Where moments are denser than images an image serves once.
        if self.used != Some(image.time) {
            self.used = Some(image.time);
            out.push(Picked { camera, image });
        }
        self.next += 1;
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector3;

    use super::*;

    /// Images at 5 Hz are up to a tenth of a second from any moment: somebody who stands, walks and stands gets keyframes all the way.
    #[test]
    fn rare_images_leave_no_hole() {
        let ms = |ms: i64| Timestamp::from_nanos(ms * 1_000_000);
        let pose = |k: i64| StampedPose {
            time: ms(10 * k + 3),
            world_from_rig: Se3::new(
                Default::default(),
                Vector3::x() * (0.008 * (k - 200).clamp(0, 600) as f64),
            ),
        };
        let trajectory = Trajectory::new((0..1000).map(pose).collect());
        let moments = moments(&trajectory, 0.35, 0.5);
        assert_eq!(moments.last(), Some(&ms(9993)));
        let (mut picker, mut picked) = (Picker::default(), Vec::new());
        let image = |k: i64| Stamped {
            time: ms(200 * k),
            arrival: ms(200 * k),
            device_ticks: 0,
            sample: Image {
                width: 1,
                height: 1,
                pixels: vec![0],
                exposure_ns: 0,
                frame_id: 0,
            },
        };
        for k in 1..50 {
            picker.offer(&moments, 0, image(k), &mut picked);
        }
        picker.finish(&moments, 0, &mut picked);
        let times: Vec<Timestamp> = picked.iter().map(|p| p.image.time).collect();
        assert_eq!(times.first(), Some(&ms(200)));
        assert_eq!(times.last(), Some(&ms(9800)));
        // Where three metres have no image, scans make keyframes.
        let found = times
            .iter()
            .filter(|time| **time < ms(3000) || **time > ms(7000))
            .map(|time| ((*time, 0), Features::default()));
        let mut keyframes = assemble(found.collect(), &["cam0".to_owned()], &trajectory);
        let images = keyframes.images.len();
        keyframes.bridge(&moments, &trajectory);
        let bare = keyframes.frames.len() - images;
        assert!(bare > 5, "{bare}");
        for pair in keyframes.frames.windows(2) {
            let moved = pair[1].world_from_rig.translation - pair[0].world_from_rig.translation;
            assert!(pair[1].time > pair[0].time && moved.norm() < 0.6);
        }
        let of_images = keyframes.images.iter().map(|i| i.keyframe);
        let of_images: Vec<Timestamp> = of_images.map(|k| keyframes.frames[k].time).collect();
        assert!(of_images.iter().all(|time| times.contains(time)));
        assert_eq!(of_images.len(), images);
        let place = |time: &Timestamp| {
            let pose = trajectory.at(*time).expect("within");
            pose.translation.x
        };
        for pair in times.windows(2) {
            let apart = place(&pair[1]) - place(&pair[0]);
            assert!(pair[1] > pair[0] && apart < 0.6, "{apart} m");
        }
    }
}
