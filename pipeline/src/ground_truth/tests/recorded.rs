//! The stage on files: images of a painted room, a map made from some of them, and what is wrong with a walk.

use std::path::Path;

use lsfb_geometry::{Rig, StampedPose};
use lsfb_recording::{Recording, Writer, WriterConfig};
use lsfb_types::{Image, Progress, Stopped};

use super::*;
use crate::features::{FeatureDetector, SiftConfig};
use crate::ground_truth::ground_truth_in_stages;
use crate::hd_map::{
    HdMap, HdMapConfig, KeyframeImage, MapContent, ReconstructionConfig, reconstruct,
};
use crate::kept_stages::KeptStages;
use crate::localization::{Localization, NotLocalized, NotLocalizedReason};

/// Smooth random paint, different for each `seed`: three octaves of value noise.
fn paint(seed: u64, face: u64, u: f64, v: f64) -> f64 {
    let lattice = |octave: u64, i: i64, j: i64| {
        let mut h = seed ^ (face << 8) ^ (octave << 16);
        for word in [i as u64, j as u64] {
            h = (h ^ word).wrapping_mul(0x9E37_79B9_7F4A_7C15);
            h ^= h >> 29;
        }
        (h & 0xffff) as f64 / 65536.0
    };
    let smooth = |x: f64| x * x * (3.0 - 2.0 * x);
    [(0, 0.5, 0.35), (1, 0.2, 0.35), (2, 0.09, 0.3)]
        .iter()
        .map(|&(octave, cell, share)| {
            let (x, y) = (u / cell, v / cell);
            let (i, j) = (x.floor(), y.floor());
            let (fx, fy) = (smooth(x - i), smooth(y - j));
            let at = |di: i64, dj: i64| lattice(octave, i as i64 + di, j as i64 + dj);
            let low = at(0, 0) * (1.0 - fx) + at(1, 0) * fx;
            let high = at(0, 1) * (1.0 - fx) + at(1, 1) * fx;
            share * (low * (1.0 - fy) + high * fy)
        })
        .sum()
}

/// How a room is painted.
#[derive(Clone, Copy)]
pub(super) struct Paint {
    seed: u64,
    /// Every second square metre has other paint: what another floor that is built alike looks like.
    is_other_floor: bool,
    /// Turned by half a turn about the middle it is the same room …
    is_same_turned: bool,
    /// … but for every second square metre.
    is_half_alike: bool,
}

impl Paint {
    pub fn of(seed: u64) -> Self {
        Self {
            seed,
            is_other_floor: false,
            is_same_turned: false,
            is_half_alike: false,
        }
    }

    pub fn same_turned(seed: u64) -> Self {
        Self {
            is_same_turned: true,
            ..Self::of(seed)
        }
    }

    pub fn half_alike_turned(seed: u64) -> Self {
        Self {
            is_half_alike: true,
            ..Self::same_turned(seed)
        }
    }

    pub fn other_floor(seed: u64) -> Self {
        Self {
            is_other_floor: true,
            ..Self::of(seed)
        }
    }

    fn seed_at(&self, face: u64, [u, v]: [f64; 2], is_second_half: bool) -> u64 {
        let square = (u.floor() as i64 + v.floor() as i64 + face as i64).rem_euclid(2);
        let is_other = self.is_other_floor || self.is_half_alike && is_second_half;
        self.seed + if is_other && square == 0 { 1000 } else { 0 }
    }
}

/// Grey value seen along a ray in a room of 6 × 6 × 3 m.
fn shade(room: Paint, origin: &Vector3<f64>, direction: &Vector3<f64>) -> f64 {
    let (low, high) = (Vector3::new(-3.0, -3.0, 0.0), Vector3::new(3.0, 3.0, 3.0));
    let mut nearest = (f64::INFINITY, 0);
    for axis in 0..3 {
        let wall = if direction[axis] > 0.0 { high } else { low };
        let distance = (wall[axis] - origin[axis]) / direction[axis];
        if distance < nearest.0 {
            let side = usize::from(direction[axis] > 0.0);
            nearest = (distance, 2 * axis + side);
        }
    }
    let hit = origin + direction * nearest.0;
    let (axis, side) = (nearest.1 / 2, nearest.1 % 2);
    let is_second_half = match axis {
        2 => hit.x < 0.0,
        _ => side == 1,
    };
    let (hit, side) = match room.is_same_turned && is_second_half {
        true => (
            Vector3::new(-hit.x, -hit.y, hit.z),
            if axis == 2 { side } else { 0 },
        ),
        false => (hit, side),
    };
    let face = (2 * axis + side) as u64;
    let (u, v) = (hit[(axis + 1) % 3], hit[(axis + 2) % 3]);
    paint(room.seed_at(face, [u, v], is_second_half), face, u, v)
}

pub(super) fn rig() -> Rig {
    let mut rig = Rig {
        imus: lsfb_geometry::RigImu::from(NOISE).alone(),
        ..Rig::empty("glasses")
    };
    for (k, camera) in glasses().iter().enumerate() {
        let mut small = *camera.camera();
        (small.width, small.height) = (320, 200);
        small.lens = Lens::KannalaBrandt {
            focal_px: [145.0, 145.0],
            principal_px: [159.0, 100.0],
            distortion: [-0.012, 0.004, -0.002, 0.0003],
        };
        rig.cameras.insert(
            format!("cam{k}"),
            RigCamera {
                camera: small,
                rig_from_camera: camera.camera_from_rig().inverse(),
                timing: Default::default(),
                sigmas: Default::default(),
            },
        );
    }
    rig
}

pub(super) fn render(room: Paint, camera: &RigCamera, world_from_rig: &Se3) -> Image {
    let world_from_camera = *world_from_rig * camera.rig_from_camera;
    let (width, height) = (camera.camera.width, camera.camera.height);
    let pixels = (0..width * height)
        .map(|k| {
            let pixel = Vector2::new(f64::from(k % width), f64::from(k / width));
            let ray = camera.camera.unproject(&pixel).expect("inside the lens");
            let direction = world_from_camera.rotation * ray;
            (shade(room, &world_from_camera.translation, &direction) * 255.0) as u8
        })
        .collect();
    Image {
        width,
        height,
        pixels,
        exposure_ns: 0,
        frame_id: 0,
    }
}

const WALK_START_SECS: f64 = 0.7;
pub(super) const WALK_FRAMES: usize = 16;

pub(super) fn frame_time(k: usize) -> f64 {
    WALK_START_SECS + k as f64 * FRAME_SECS
}

/// A map from images taken beside the walk, with true poses.
pub(super) fn map(seed: u64) -> HdMap {
    let sift = FeatureDetector::sift(&SiftConfig::default()).expect("valid");
    map_of(seed, &sift)
}

/// The same of any features.
pub(super) fn map_of(seed: u64, detector: &FeatureDetector) -> HdMap {
    map_along(Paint::of(seed), &beside_the_walk(), detector)
}

/// Poses beside the walk.
pub(super) fn beside_the_walk() -> Vec<Se3> {
    let beside = Se3::new(Default::default(), Vector3::new(0.1, -0.15, 0.08));
    let poses = (0..7).map(|k| truth(0.9 + 0.27 * k as f64) * beside);
    poses.collect()
}

/// A map of a room from images at these poses.
pub(super) fn map_along(room: Paint, poses: &[Se3], detector: &FeatureDetector) -> HdMap {
    let rig = rig();
    let keyframes: Vec<StampedPose> = (0..)
        .zip(poses)
        .map(|(k, pose)| StampedPose {
            time: Timestamp::from_nanos(k),
            world_from_rig: *pose,
        })
        .collect();
    let (mut pixels, mut owners) = (Vec::new(), Vec::new());
    for (k, keyframe) in keyframes.iter().enumerate() {
        for (name, camera) in &rig.cameras {
            pixels.push(render(room, camera, &keyframe.world_from_rig));
            owners.push((k, name.clone()));
        }
    }
    let pixels: Vec<&Image> = pixels.iter().collect();
    let features = detector
        .detect_all(&pixels, &no_progress)
        .expect("features");
    let images: Vec<KeyframeImage> = owners
        .into_iter()
        .zip(features)
        .map(|((keyframe, camera), features)| KeyframeImage {
            keyframe,
            camera,
            features,
        })
        .collect();
    let config = ReconstructionConfig::default();
    let points = reconstruct(&rig, &keyframes, &images, &config, &no_progress).expect("points");
    let content = MapContent {
        rig: &rig,
        keyframes: &keyframes,
        images: &images,
        points: &points,
        feature: &detector.feature(),
        provenance: "painted room",
    };
    HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("map")
}

/// What the device measures on the walk.
pub(super) struct Measured {
    pub imu: Vec<Stamped<ImuSample>>,
    /// Camera and image, in order.
    pub images: Vec<(String, Stamped<Image>)>,
}

impl Measured {
    pub fn in_room(room: Paint, frames: usize) -> Self {
        let mut images = Vec::new();
        for k in 0..frames {
            let time = Timestamp::from_secs_f64(frame_time(k));
            for (name, camera) in &rig().cameras {
                let image = Stamped {
                    time,
                    arrival: time,
                    device_ticks: k as u64,
                    sample: render(room, camera, &truth(frame_time(k))),
                };
                images.push((name.clone(), image));
            }
        }
        Self {
            imu: imu(&mut Gauss(ChaCha8Rng::seed_from_u64(4))),
            images,
        }
    }

    pub fn record(&self, path: &Path, rig_file: &Rig) {
        let mut writer = Writer::create(path, &WriterConfig::default()).expect("create");
        writer.attach_rig(rig_file).expect("rig");
        for sample in &self.imu {
            writer.write_imu("imu0", sample).expect("imu");
        }
        for (name, image) in &self.images {
            writer.write_image(name, image).expect("image");
        }
        writer.finish().expect("finish");
    }
}

/// Records the walk through a room painted with `seed`.
pub(super) fn record(path: &Path, seed: u64, frames: usize, rig_file: &Rig, with_imu: usize) {
    let mut measured = Measured::in_room(Paint::of(seed), frames);
    measured.imu.truncate(with_imu);
    measured.record(path, rig_file);
}

pub(super) fn run(path: &Path, map: &HdMap) -> Result<GroundTruth, Error> {
    let recording = Recording::open(path)?;
    ground_truth(&recording, map, &GroundTruthConfig::default(), &no_progress)
}

/// Stopped in the stages that take longest; and what was kept of them is what is taken.
fn stopped_it_goes_on_to_the_same(path: &Path, map: &HdMap, whole: &GroundTruth) {
    let recording = Recording::open(path).expect("recording");
    let folder = path.with_extension("unfinished");
    let kept = || KeptStages::in_folder(&folder, "walk").expect("folder");
    let go_on = |stop: &str| {
        let progress = |p: Progress| match p.stage == stop {
            true => Err(Stopped),
            false => Ok(()),
        };
        let config = GroundTruthConfig::default();
        ground_truth_in_stages(&recording, map, &config, &kept(), &progress)
    };
    for (stage, is_kept) in [
        ("image features", "features_00000"),
        ("localization", "features_00000"),
        ("cross-check", "localized_00000"),
    ] {
        let stopped = go_on(stage);
        assert!(matches!(stopped, Err(Error::Stopped(_))), "{stage}");
        assert!(folder.join(is_kept).with_extension("stage").exists());
    }
    assert_eq!(go_on("").expect("ground truth"), *whole);

    let nowhere = || -> Result<Localization, _> {
        Err(NotLocalized {
            reason: NotLocalizedReason::NoPlace { votes: 1 },
        })
    };
    let answers: Vec<_> = (0..WALK_FRAMES).map(|_| nowhere()).collect();
    kept().keep("localized_00000", &answers).expect("kept");
    let refused = go_on("").expect_err("nowhere");
    assert!(
        matches!(
            refused,
            Error::Refused(Refusal::NotLocalized { localized: 0, .. })
        ),
        "{refused}"
    );
}

#[test]
fn a_recorded_walk_is_placed_in_its_map_and_refused_in_another() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    record(&path, 1, WALK_FRAMES, &rig(), usize::MAX);
    let map = map(1);
    let found = run(&path, &map).expect("ground truth");
    assert_eq!(found.trajectory.len(), WALK_FRAMES);
    for (k, pose) in found.trajectory.poses().iter().enumerate() {
        let error = truth(frame_time(k)).inverse() * pose.world_from_rig;
        let distance = error.translation.norm();
        assert!(distance < 0.01, "frame {k}: {distance} m");
        assert!(so3::log(&error.rotation).norm() < 0.005, "frame {k}");
    }
    let report = &found.report;
    assert_eq!((report.frames, report.left_out.len()), (16, 0));
    assert!(report.localized >= 15, "{report:#?}");
    assert!(report.map_errors.rms_px < 1.5, "{report:#?}");
    assert_eq!(report.warnings, []);
    for (pose, covariance) in found.trajectory.poses().iter().zip(&found.covariances) {
        let t = (pose.time.nanos() as f64) * 1e-9;
        let error = (truth(t).inverse() * pose.world_from_rig).log();
        let information = covariance.try_inverse().expect("determined");
        assert!(error.dot(&(information * error)) < 60.0, "{t} s: {error}");
    }

    stopped_it_goes_on_to_the_same(&path, &map, &found);

    // Certain to a micrometre is nothing.
    let strict = GroundTruthConfig {
        max_position_sigma_m: 1e-6,
        ..GroundTruthConfig::default()
    };
    let recording = Recording::open(&path).expect("recording");
    let error = ground_truth(&recording, &map, &strict, &no_progress).expect_err("uncertain");
    assert!(
        matches!(
            error,
            Error::Refused(Refusal::NothingCertain { frames: 16, .. })
        ),
        "{error}"
    );

    // Another room; one that lost a camera.
    let other = folder.path().join("other.mcap");
    record(&other, 2, 6, &rig(), usize::MAX);
    let error = run(&other, &map).expect_err("another room");
    // Not found at all, or found at places that contradict one another.
    let refused = matches!(
        &error,
        Error::Refused(Refusal::NotLocalized { path, .. } | Refusal::MapDisagrees { path, .. }) if *path == other
    );
    assert!(refused, "{error}");
    let mut third = rig();
    third
        .cameras
        .insert("cam2".into(), third.cameras["cam0"].clone());
    let short = folder.path().join("short.mcap");
    record(&short, 1, 1, &third, usize::MAX);
    let error = run(&short, &map).expect_err("camera missing");
    assert!(error.to_string().contains("cam2"), "{error}");
}

#[test]
fn a_walk_with_a_damaged_stretch_is_not_whole() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("walk.mcap");
    record(&path, 1, WALK_FRAMES, &rig(), usize::MAX);
    let map = map(1);
    let whole = run(&path, &map).expect("ground truth");
    assert!(whole.report.is_whole());
    let mut bytes = std::fs::read(&path).expect("read");
    let at = bytes.len() / 4 * 3;
    bytes[at..at + 1000].fill(0);
    std::fs::write(&path, &bytes).expect("written");
    let damaged = run(&path, &map).expect("ground truth of the rest");
    assert!(!damaged.report.is_whole(), "{:#?}", damaged.report);
    let read = damaged.report.warnings.iter();
    let unread = read.filter(|w| w.finding().code.starts_with("damaged-"));
    assert!(unread.count() > 0, "{:#?}", damaged.report.warnings);
}
