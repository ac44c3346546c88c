//! Tracks from images: corners followed in each camera from image to image, and from the first camera into those beside it.

use lsfb_geometry::{ImuNoiseModel, RigCamera, UnitQuaternion, Vector2};
use lsfb_perception::image::{Follower, Pyramid};
use lsfb_types::{Image, ImuSample, Stamped, Timestamp};
use rayon::prelude::*;

use super::{RevisitConfig, Sight, TrackedFrame, TrackedWalk, WalkView};
use crate::Error;
use crate::features::SiftDetector;
use lsfb_perception::imu::{ImuBias, PreintegratedImu};

/// Cameras number their tracks apart from each other.
const TRACKS_PER_CAMERA: u32 = 1 << 24;

/// Takes the images of a walk one instant after the other and keeps what they show.
pub struct FrontEnd {
    cameras: Vec<RigCamera>,
    imu: Vec<Stamped<ImuSample>>,
    noise: ImuNoiseModel,
    keyframe_secs: f64,
    followers: Vec<Follower>,
    last: Option<Timestamp>,
    frames: Vec<TrackedFrame>,
    /// How far apart images are kept to be recognised, seconds, and what detects their features.
    detector: Option<(f64, SiftDetector)>,
    views: Vec<WalkView>,
}

impl FrontEnd {
    /// `imu` is in order of time. Corners are followed through all images; instants at least `keyframe_secs` apart become frames.
    pub fn new(
        cameras: Vec<RigCamera>,
        imu: Vec<Stamped<ImuSample>>,
        noise: ImuNoiseModel,
        keyframe_secs: f64,
    ) -> Self {
        Self {
            followers: vec![Follower::default(); cameras.len()],
            cameras,
            imu,
            noise,
            keyframe_secs,
            last: None,
            frames: Vec::new(),
            detector: None,
            views: Vec::new(),
        }
    }

    /// Keeps features of images, by which places are recognised again. Refuses settings without meaning, and a codebook that is none
    /// before anything is done that it is needed for.
    pub fn keeping_views(self, config: &RevisitConfig) -> Result<Self, Error> {
        config.read_codebook()?;
        let detector = match config.view_secs > 0.0 {
            true => Some((config.view_secs, SiftDetector::new(&config.sift)?)),
            false => None,
        };
        Ok(Self { detector, ..self })
    }

    /// The images of one instant, later than the last one, in the order of the cameras; `None` where one is missing. Images of another
    /// size than their camera's are left out.
    pub fn push(&mut self, time: Timestamp, images: &[Option<&Image>]) {
        let turn = self.last.and_then(|last| self.turn(last, time));
        let mut pyramids: Vec<Option<Pyramid>> = Vec::new();
        for (k, camera) in self.cameras.iter().enumerate() {
            let image = fitting(images, k, camera);
            pyramids.push(image.map(|image| Pyramid::new(image, &camera.camera)));
        }
        let mut sights = Vec::new();
        let turn_of = |camera: &RigCamera| {
            let rig_from_camera = camera.rig_from_camera.rotation;
            turn.map(|turn| rig_from_camera.inverse() * turn * rig_from_camera)
        };
        let mut beside: Vec<Vec<(u32, Vector2<f64>)>> = vec![Vec::new(); self.cameras.len()];
        for k in 0..self.cameras.len() {
            let Some(image) = pyramids[k].take() else {
                self.followers[k] = Follower::default();
                continue;
            };
            if k > 0 {
                let second_from_first =
                    self.cameras[k].rig_from_camera.inverse() * self.cameras[0].rig_from_camera;
                beside[k] = self.followers[0].seen_beside(&image, &second_from_first);
            }
            let taken: Vec<Vector2<f64>> = beside[k].iter().map(|(_, pixel)| *pixel).collect();
            self.followers[k].advance(image, turn_of(&self.cameras[k]).as_ref(), &taken);
            let own = self.followers[k].corners();
            sights.extend(own.map(|(number, pixel)| Sight {
                track: k as u32 * TRACKS_PER_CAMERA + number,
                camera: k,
                pixel,
            }));
            sights.extend(beside[k].iter().map(|(number, pixel)| Sight {
                track: *number,
                camera: k,
                pixel: *pixel,
            }));
        }
        self.last = Some(time);
        let since = self.frames.last().map(|f| time.secs_since(f.time));
        // Half a millisecond early is not early.
        if since.is_none_or(|secs| secs >= self.keyframe_secs - 5e-4) {
            self.frames.push(TrackedFrame { time, sights });
            self.keep_views(time, images);
        }
    }

    /// Keeps what the images of the last frame show, where it is time to.
    fn keep_views(&mut self, time: Timestamp, images: &[Option<&Image>]) {
        let Some((secs, detector)) = &self.detector else {
            return;
        };
        let last = self.views.last().map(|v| self.frames[v.frame].time);
        if last.is_some_and(|last| time.secs_since(last) < secs - 5e-4) {
            return;
        }
        let frame = self.frames.len() - 1;
        let cameras = self.cameras.par_iter().enumerate();
        let kept = cameras.filter_map(|(camera, mounted)| {
            let features = detector.clone().detect(fitting(images, camera, mounted)?);
            (!features.is_empty()).then_some(WalkView {
                frame,
                camera,
                features,
            })
        });
        let kept: Vec<WalkView> = kept.collect();
        self.views.extend(kept);
    }

    /// The samples that it was given.
    pub(super) fn imu(&self) -> &[Stamped<ImuSample>] {
        &self.imu
    }

    /// What was followed.
    pub fn finish(self) -> TrackedWalk {
        TrackedWalk {
            cameras: self.cameras,
            frames: self.frames,
            imu: self.imu,
            noise: self.noise,
            views: self.views,
        }
    }

    /// Directions of the rig at the first instant in the rig at the second, by the gyroscope as it is; `None` where it is silent.
    fn turn(&self, from: Timestamp, to: Timestamp) -> Option<UnitQuaternion<f64>> {
        let none = ImuBias::default();
        let between = PreintegratedImu::integrate(&self.imu, from, to, none, &self.noise);
        Some(between.ok()?.rotation.inverse())
    }
}

/// The image of a camera, where it is there and of the camera's size.
fn fitting<'a>(
    images: &[Option<&'a Image>],
    camera: usize,
    mounted: &RigCamera,
) -> Option<&'a Image> {
    let fits = |i: &&Image| {
        let camera = &mounted.camera;
        i.width == camera.width && i.height == camera.height
    };
    images.get(camera).copied().flatten().filter(fits)
}
