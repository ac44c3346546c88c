//! One recording: poses, images, scans, inertial samples.

use lsfb_geometry::{Camera, Rig, Se3, Trajectory};
use lsfb_recording::{Error as RecordingError, Recording};
use lsfb_types::{ImuSample, LidarScan, Stamped, Stopped, Timestamp};
use re_sdk_types::archetypes::{Image, Pinhole, Points3D, Scalars, SeriesLines, Transform3D};
use re_sdk_types::components::{Color, PinholeProjection, Radius};
use re_sdk_types::datatypes::Quaternion;

use crate::{Error, View, ViewConfig, ViewReport, Walk};

/// Steps of [`log`] that are told one by one.
pub(crate) const PARTS: u64 = 4;

/// Distance at which images hang in front of their cameras, metres.
const IMAGE_PLANE_DISTANCE_M: f32 = 0.3;
/// In points of the screen.
const SCAN_POINT_RADIUS: f32 = 1.0;

/// Tells that so many parts are done, and hears whether to stop.
pub(crate) type Tell<'a> = dyn Fn(u64) -> Result<(), Stopped> + 'a;
/// The same from within one part.
type TellPart<'a> = dyn Fn() -> Result<(), Stopped> + 'a;

pub(crate) fn log(
    view: &View,
    walk: &Walk<'_>,
    config: &ViewConfig,
    tell: &Tell<'_>,
    report: &mut ViewReport,
) -> Result<(), Error> {
    let rig_entity = format!("world/{}/rig", walk.name);
    tell(0)?;
    for pose in walk.world_from_rig.poses() {
        view.set_time(pose.time);
        view.log(&rig_entity, &transform(&pose.world_from_rig))?;
    }
    log_images(view, walk, &rig_entity, config, &|| tell(1), report)?;
    log_scans(view, walk, config, &|| tell(2), report)?;
    log_imu(view, walk, config, report)?;
    tell(PARTS)?;
    Ok(())
}

fn log_images(
    view: &View,
    walk: &Walk<'_>,
    rig_entity: &str,
    config: &ViewConfig,
    tell: &TellPart<'_>,
    report: &mut ViewReport,
) -> Result<(), Error> {
    let mut recorded = Vec::new();
    for (name, rig_camera) in &walk.rig.cameras {
        let entity = format!("{rig_entity}/{name}");
        view.log_static(&entity, &transform(&rig_camera.rig_from_camera))?;
        view.log_static(&entity, &pinhole(&rig_camera.camera))?;
        match walk.recording.images(name) {
            Ok(_) => recorded.push(name.as_str()),
            Err(RecordingError::NoSuchTopic { .. }) => {}
            Err(error) => return Err(error.into()),
        }
    }
    if recorded.is_empty() {
        return Ok(());
    }
    let mut shown = vec![Every::new(config.image_period_secs); recorded.len()];
    for item in walk.recording.images_of(&recorded)? {
        let Some(item) = readable(item, report)? else {
            continue;
        };
        if !shown[item.camera].is_due(item.image.time) {
            continue;
        }
        tell()?;
        view.set_time(item.image.time);
        let image = item.image.sample;
        let entity = format!("{rig_entity}/{}", recorded[item.camera]);
        view.log(
            &entity,
            &Image::from_l8(image.pixels, [image.width, image.height]),
        )?;
        report.images += 1;
    }
    Ok(())
}

fn log_scans(
    view: &View,
    walk: &Walk<'_>,
    config: &ViewConfig,
    tell: &TellPart<'_>,
    report: &mut ViewReport,
) -> Result<(), Error> {
    let Some(lidar) = walk.rig.lidar() else {
        return Ok(());
    };
    let scans = match walk.recording.scans() {
        Ok(scans) => scans,
        Err(RecordingError::NoSuchTopic { .. }) => return Ok(()),
        Err(error) => return Err(error.into()),
    };
    let entity = format!("world/{}/scan", walk.name);
    let mut shown = Every::new(config.scan_period_secs);
    for item in scans {
        let Some(scan) = readable(item, report)? else {
            continue;
        };
        if !shown.is_due(scan.time) {
            continue;
        }
        tell()?;
        let placed = place(
            &scan,
            &walk.world_from_rig,
            &lidar.rig_from_lidar,
            config.points_per_scan,
        );
        if placed.positions_m.is_empty() {
            continue;
        }
        view.set_time(scan.time);
        let points = Points3D::new(placed.positions_m)
            .with_radii([Radius::new_ui_points(SCAN_POINT_RADIUS)])
            .with_colors(placed.colors);
        view.log(&entity, &points)?;
        report.scans += 1;
    }
    Ok(())
}

fn log_imu(
    view: &View,
    walk: &Walk<'_>,
    config: &ViewConfig,
    report: &mut ViewReport,
) -> Result<(), Error> {
    let samples = match walk.recording.imu() {
        Ok(samples) => samples,
        Err(RecordingError::NoSuchTopic { .. }) => return Ok(()),
        Err(error) => return Err(error.into()),
    };
    let (gyro, accel) = (
        format!("imu/{}/gyro_rad_s", walk.name),
        format!("imu/{}/accel_m_s2", walk.name),
    );
    for entity in [&gyro, &accel] {
        view.log_static(entity, &SeriesLines::new().with_names(["x", "y", "z"]))?;
    }
    let mut shown = Every::new(config.imu_period_secs);
    for item in samples {
        let Some(Stamped { time, sample, .. }) = readable(item, report)? else {
            continue;
        };
        if !shown.is_due(time) {
            continue;
        }
        let ImuSample {
            angular_velocity_rad_s,
            specific_force_m_s2,
        } = sample;
        view.set_time(time);
        view.log(&gyro, &Scalars::new(angular_velocity_rad_s))?;
        view.log(&accel, &Scalars::new(specific_force_m_s2))?;
        report.imu_samples += 1;
    }
    Ok(())
}

/// Damage is counted and passed over: whoever looks wants to see the rest.
fn readable<T>(
    item: Result<T, RecordingError>,
    report: &mut ViewReport,
) -> Result<Option<T>, Error> {
    match item {
        Ok(value) => Ok(Some(value)),
        Err(RecordingError::Damaged { .. } | RecordingError::Message { .. }) => {
            report.unreadable += 1;
            Ok(None)
        }
        Err(error) => Err(error.into()),
    }
}

struct PlacedScan {
    positions_m: Vec<[f32; 3]>,
    colors: Vec<Color>,
}

/// Points in the world, each at the pose of its own time; points outside the trajectory are left out.
fn place(
    scan: &Stamped<LidarScan>,
    world_from_rig: &Trajectory,
    rig_from_lidar: &Se3,
    most: usize,
) -> PlacedScan {
    let step = scan.sample.points.len().div_ceil(most.max(1)).max(1);
    let mut placed = PlacedScan {
        positions_m: Vec::new(),
        colors: Vec::new(),
    };
    for point in scan.sample.points.iter().step_by(step) {
        let time = scan.time + i64::from(point.time_offset_ns);
        let Some(world_from_rig) = world_from_rig.at(time) else {
            continue;
        };
        let point_in_lidar = lsfb_geometry::Vector3::from(point.position_m).cast::<f64>();
        let point_in_world = world_from_rig * (*rig_from_lidar * point_in_lidar);
        placed.positions_m.push(point_in_world.cast::<f32>().into());
        placed.colors.push(color_of(point.intensity));
    }
    placed
}

/// Dark blue to yellow with the reflectivity; retro-reflectors are white.
fn color_of(intensity: u8) -> Color {
    if intensity > 100 {
        return Color::from_rgb(255, 255, 255);
    }
    let share = f32::from(intensity) / 100.0;
    let mix = |from: f32, to: f32| (from + (to - from) * share.sqrt()) as u8;
    Color::from_rgb(mix(40.0, 250.0), mix(70.0, 220.0), mix(150.0, 60.0))
}

pub(crate) fn transform(pose: &Se3) -> Transform3D {
    let q = pose.rotation.cast::<f32>();
    let translation: [f32; 3] = pose.translation.cast::<f32>().into();
    let rotation = Quaternion::from_xyzw([q.i, q.j, q.k, q.w]);
    Transform3D::from_translation_rotation(translation, rotation)
}

pub(crate) fn pinhole(camera: &Camera) -> Pinhole {
    let focal_px = camera.focal_px().map(|f| f as f32);
    // Rerun's image starts at the corner of the top-left pixel, ours at its centre.
    let principal_px = camera.principal_px().map(|c| c as f32 + 0.5);
    Pinhole::new(PinholeProjection::from_focal_length_and_principal_point(
        focal_px,
        principal_px,
    ))
    .with_resolution([camera.width as f32, camera.height as f32])
    .with_image_plane_distance(IMAGE_PLANE_DISTANCE_M)
}

/// Lets samples through that are far enough apart.
#[derive(Clone)]
struct Every {
    period_secs: f64,
    last: Option<Timestamp>,
}

impl Every {
    fn new(period_secs: f64) -> Self {
        Self {
            period_secs,
            last: None,
        }
    }

    fn is_due(&mut self, time: Timestamp) -> bool {
        // Half a millisecond of tolerance: a period that is a multiple of the sensor's must not miss by a nanosecond.
        let is_due = self
            .last
            .is_none_or(|last| time.secs_since(last) >= self.period_secs - 5e-4);
        if is_due {
            self.last = Some(time);
        }
        is_due
    }
}

/// Cameras of the rig that took images.
pub(crate) fn camera_names(rig: &Rig, recording: &Recording) -> Vec<String> {
    rig.cameras
        .keys()
        .filter(|name| recording.images(name).is_ok())
        .cloned()
        .collect()
}
