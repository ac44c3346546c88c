//! Rigs as a calibration finds them: the simulated board before the cameras, then the steps that an operator takes.

use std::path::Path;

use anyhow::Context as _;
use lsfb_calib::camera::{
    CameraConfig, CameraViews, as_global_shutter, calibrate_cameras, views_from_recording,
};
use lsfb_calib::camera_imu::{CameraImuConfig, KnownCamera, calibrate_camera_imu};
use lsfb_calib::joint::{JointConfig, LIDAR, join_transforms};
use lsfb_calib::lidar_camera::{
    LidarCameraConfig, MountedBoard, RecordingConfig, calibrate_lidar_camera, poses_from_recording,
};
use lsfb_calib::{Target, TransformEdge};
use lsfb_geometry::camera::LensModel;
use lsfb_geometry::{Rig, RigLidar, Se3};
use lsfb_recording::{Provenance, Recording};
use lsfb_sim::{CalibrationBoard, CameraConfig as SimulatedCameras, LensKind, SimConfig, TAG_M};
use lsfb_types::{Judgement, Verdict};
use serde::{Deserialize, Serialize};

use crate::context::Context;
use crate::refused::Refused;
use crate::simulated::{self, Layout};
use crate::standing;

/// Gap between tags of the twin's board, as a share of a tag's edge.
const SPACING_RATIO: f64 = 0.3;
/// Poses of the board that place the LiDAR, at most.
const LIDAR_POSES: usize = 60;

/// Which rigs the estimators are given.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rigs {
    Calibrated,
    True,
}

/// Views further apart belong to different stretches of a recording, nanoseconds.
const GAP_NS: i64 = 1_000_000_000;

/// Whose rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bearer {
    Backpack,
    Walker,
}

/// How far a sensor of a calibrated rig is from where it is in truth.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorOff {
    /// Rig and sensor.
    pub sensor: String,
    pub rotation_deg: f64,
    pub translation_mm: f64,
    /// Of the focal length; absent for a LiDAR.
    pub focal_percent: Option<f64>,
    /// Of the clock; absent for a LiDAR.
    pub clock_ms: Option<f64>,
}

/// A calibrated rig.
#[derive(Clone, Debug)]
pub struct Calibrated {
    pub rig: Rig,
    pub off: Vec<SensorOff>,
}

/// The rig of a calibration, made in `folder` unless it stands; `made` is called before it is made.
pub fn calibrated(
    folder: &Path,
    config: &SimConfig,
    bearer: Bearer,
    made: impl Fn(),
    context: &Context,
) -> anyhow::Result<Calibrated> {
    let rig_path = folder.join("calibrated.toml");
    let made_from = Provenance::new(config);
    if let Some(off) = context.standing(&[&rig_path], &made_from) {
        let rig = Rig::read(&rig_path)?;
        return Ok(Calibrated { rig, off });
    }
    made();
    let layout = Layout::create(folder)?;
    let simulation = simulated::prepare(&layout, config, [None, None], None, context)?;
    let (name, cameras, truth) = match bearer {
        Bearer::Backpack => ("scan.mcap", &config.scan_cameras, simulation.scan().rig()),
        Bearer::Walker => {
            let truth = simulation.glasses().rig();
            ("walk.mcap", &config.glasses_cameras, truth)
        }
    };
    let path = layout.file(name);
    if context.standing::<u64>(&[&path], &made_from).is_none() {
        standing::forget(&[&path])?;
        let report = match bearer {
            Bearer::Backpack => simulated::record_backpack(&layout, &simulation, context)?,
            Bearer::Walker => simulated::record_glasses(&layout, &simulation, context)?,
        };
        standing::finish(&[&path], &[], &made_from, &report.lost)?;
    }
    let recording = context.open(&path)?;
    // Of the device is known what its sheet says: names, the IMU's noise, the shutter.
    let mut rig = Rig {
        imus: truth.imus.clone(),
        ..Rig::empty(&truth.name)
    };
    let names: Vec<&str> = truth.cameras.keys().map(String::as_str).collect();
    let session = Calibration {
        recording: &recording,
        cameras,
        context,
    };
    match bearer {
        Bearer::Backpack => {
            let noise_m = truth.lidar().map_or(0.0, |lidar| lidar.range_noise_m);
            session.backpack(&names, noise_m, &mut rig)?;
        }
        Bearer::Walker => {
            session.cameras(&names, &mut rig)?;
        }
    }
    rig.calibrated_unix_s = recording
        .end_time()?
        .map(|time| time.nanos().div_euclid(1_000_000_000));
    drop(recording);
    let off = difference(&rig, truth);
    crate::files::write(&rig_path, rig.to_toml())?;
    standing::finish(&[&rig_path], &[], &made_from, &off)?;
    standing::remove(&path)?;
    Ok(Calibrated { rig, off })
}

/// The rig as it was built.
pub fn true_rig(config: &SimConfig, bearer: Bearer) -> Calibrated {
    Calibrated {
        rig: match bearer {
            Bearer::Backpack => lsfb_sim::rigs::backpack(config),
            Bearer::Walker => lsfb_sim::rigs::walker(config),
        },
        off: Vec::new(),
    }
}

/// A recording before the board.
struct Calibration<'a> {
    recording: &'a Recording,
    cameras: &'a SimulatedCameras,
    context: &'a Context,
}

impl Calibration<'_> {
    /// The twin's board.
    fn target() -> Target {
        Target::AprilGrid {
            columns: 6,
            rows: 6,
            tag_size_m: f64::from(TAG_M),
            spacing_ratio: SPACING_RATIO,
        }
    }

    /// Each camera by itself, since no two see the board at once; then the LiDAR to each, and all of them joined.
    fn backpack(&self, names: &[&str], noise_m: f64, rig: &mut Rig) -> anyhow::Result<()> {
        let plate_m = CalibrationBoard::of_room().plate_m;
        let board = MountedBoard {
            target: Self::target(),
            width_m: plate_m,
            height_m: plate_m,
            offset_m: [0.0; 2],
        };
        let mut edges: Vec<TransformEdge> = Vec::new();
        for name in names {
            let (views, on_imu) = self.cameras(&[name], rig)?;
            edges.extend(on_imu);
            let Some((views, mounted)) = views.first().zip(rig.cameras.get(*name)) else {
                continue;
            };
            let around = RecordingConfig {
                most: LIDAR_POSES,
                rig_from_camera_s: mounted.timing.rig_from_camera_s,
            };
            let poses = poses_from_recording(views, self.recording, &around)?;
            let config = LidarCameraConfig::default();
            let found =
                calibrate_lidar_camera(&board, name, &mounted.camera, &poses, &config, &|p| {
                    self.context.show(p)
                })?;
            accepted(&found.judgement(), &found.summary())?;
            edges.push(found.edge());
        }
        let joined = join_transforms(&edges, &JointConfig::default())?;
        accepted(&joined.judgement(), &joined.summary())?;
        let lidar = joined
            .sensor(LIDAR)
            .context("no camera sees the LiDAR's board")?;
        rig.set_lidar(RigLidar {
            rig_from_lidar: lidar.imu_from_sensor,
            range_noise_m: noise_m,
        });
        joined.put_into(rig);
        Ok(())
    }

    /// Lenses, poses and clocks of cameras that see the board together; their views, and their transforms to the IMU.
    fn cameras(
        &self,
        names: &[&str],
        rig: &mut Rig,
    ) -> anyhow::Result<(Vec<CameraViews>, Vec<TransformEdge>)> {
        let (target, show) = (Self::target(), |p| self.context.show(p));
        let views: Vec<CameraViews> = names
            .iter()
            .map(|name| views_from_recording(name, self.recording, &target, &show))
            .map(|views| views.map(longest_stretch))
            .collect::<Result<_, _>>()?;
        let config = CameraConfig {
            model: match self.cameras.lens {
                LensKind::KannalaBrandt => LensModel::KannalaBrandt,
                LensKind::PinholeRadtan => LensModel::PinholeRadtan,
            },
            ..CameraConfig::default()
        };
        let readout_s = f64::from(self.cameras.readout_ns) * 1e-9;
        let still: Vec<CameraViews> = views
            .iter()
            .map(|views| as_global_shutter(views, readout_s))
            .collect();
        let lenses = calibrate_cameras(&target, &still, &config, &show)?;
        accepted(&lenses.judgement(), &lenses.summary())?;
        lenses.put_into(rig);
        let samples = self.recording.imu()?;
        let imu = samples
            .map(|sample| sample.map(|s| (s.time, s.sample)))
            .collect::<Result<Vec<_>, _>>()?;
        let noise = rig.imu_noise().cloned().context("the rig has no IMU")?;
        let mut rig_from_first = Se3::identity();
        let mut known = Vec::with_capacity(views.len());
        for views in &views {
            let Some(mounted) = rig.cameras.get(&views.name) else {
                continue;
            };
            if known.is_empty() {
                rig_from_first = mounted.rig_from_camera;
            }
            known.push(KnownCamera {
                views: views.clone(),
                camera: mounted.camera,
                camera_from_first: mounted.rig_from_camera.inverse() * rig_from_first,
                readout_s,
            });
        }
        let config = CameraImuConfig::default();
        let found = calibrate_camera_imu(&target, &known, &imu, &noise, &config, &show)?;
        accepted(&found.judgement(), &found.summary())?;
        found.put_into(rig);
        Ok((views, found.edges()))
    }
}

/// The views while the rig was held before the board: those that a camera had in passing, as the rig was turned, are far apart in
/// time, and nothing says how it moved between them.
fn longest_stretch(mut views: CameraViews) -> CameraViews {
    let mut stretches: Vec<Vec<i64>> = Vec::new();
    for ns in views.views.keys().copied() {
        match stretches.last_mut() {
            Some(stretch) if stretch.last().is_some_and(|last| ns - last < GAP_NS) => {
                stretch.push(ns);
            }
            _ => stretches.push(vec![ns]),
        }
    }
    let longest = stretches
        .into_iter()
        .max_by_key(Vec::len)
        .unwrap_or_default();
    views
        .views
        .retain(|ns, _| longest.binary_search(ns).is_ok());
    views
}

/// An operator does not use a calibration that failed.
fn accepted(judgement: &Judgement, summary: &str) -> anyhow::Result<()> {
    let failed = judgement.problems().find(|f| f.verdict == Verdict::Fail);
    match failed {
        Some(failed) => {
            Err(anyhow::Error::new(Refused(failed.clone())).context(summary.to_owned()))
        }
        None => Ok(()),
    }
}

/// How far each sensor is from the truth.
fn difference(rig: &Rig, truth: &Rig) -> Vec<SensorOff> {
    let apart = |found: &Se3, truth: &Se3| {
        let off = truth.inverse() * *found;
        (
            off.rotation.angle().to_degrees(),
            1e3 * (found.translation - truth.translation).norm(),
        )
    };
    let mut all = Vec::new();
    for (name, true_one) in &truth.cameras {
        let Some(found) = rig.cameras.get(name) else {
            continue;
        };
        let (rotation_deg, translation_mm) =
            apart(&found.rig_from_camera, &true_one.rig_from_camera);
        let focal_px = |camera: &lsfb_geometry::RigCamera| camera.camera.focal_px()[0];
        all.push(SensorOff {
            sensor: format!("{} {name}", rig.name),
            rotation_deg,
            translation_mm,
            focal_percent: Some(100.0 * (focal_px(found) / focal_px(true_one) - 1.0)),
            clock_ms: Some(
                1e3 * (found.timing.rig_from_camera_s - true_one.timing.rig_from_camera_s),
            ),
        });
    }
    if let Some((found, true_one)) = rig.lidar().zip(truth.lidar()) {
        let (rotation_deg, translation_mm) = apart(&found.rig_from_lidar, &true_one.rig_from_lidar);
        all.push(SensorOff {
            sensor: format!("{} LiDAR", rig.name),
            rotation_deg,
            translation_mm,
            focal_percent: None,
            clock_ms: None,
        });
    }
    all
}
