//! A camera against the LiDAR: edges of both, and a picture.

use lsfb_geometry::IntegratedGyro;
use lsfb_geometry::{RigCamera, Se3, Vector3};
use lsfb_types::Verdict;
use rayon::prelude::*;

use super::alignment::{self, Score};
use super::camera_images::{CameraImages, NearScan};
use super::judgement::judged;
use super::mutual_information::mutual_information;
use super::scans::ScanInRig;
use super::view::{EdgeImage, Return, StepPoint, View};
use super::{Check, VerifyConfig};
use crate::overlay::Picture;
use crate::{Error, Overlay};

/// Mutual information below which brightness in LiDAR and images has nothing in common, nats.
const LEAST_INFORMATION: f64 = 0.02;
/// What a rotation is known to at best, radians: a translation that is a centimetre wrong, ten metres away.
const LEAST_SIGMA_RAD: f64 = 1e-3;

/// Each image with what the scan of its time shows.
pub(super) fn views(
    mounted: &RigCamera,
    images: &CameraImages,
    scans: &[ScanInRig],
    gyro: Option<&IntegratedGyro>,
) -> Vec<View> {
    let camera_from_rig = mounted.rig_from_camera.inverse();
    scans
        .par_iter()
        .zip(&images.near_scan)
        .filter_map(|(scan, near)| {
            let NearScan { time_s, image, .. } = near.as_ref()?;
            // What this camera may see, also when it is turned a little.
            let mut ahead = scan.at(*time_s, gyro);
            ahead.retain(|p| (camera_from_rig * p.in_rig).z > 0.0);
            Some(View {
                steps: ahead
                    .iter()
                    .filter_map(|p| {
                        Some(StepPoint {
                            position: p.in_rig,
                            weight: p.step?,
                        })
                    })
                    .collect(),
                returns: ahead
                    .iter()
                    .map(|p| Return {
                        position: p.in_rig,
                        bin: p.bin,
                    })
                    .collect(),
                edges: EdgeImage::new(image, &mounted.camera),
            })
        })
        .collect()
}

/// The returns over the image in the middle of the recording; `None` without an image of a scan's time.
pub(super) fn overlay(
    name: &str,
    mounted: &RigCamera,
    images: &CameraImages,
    scans: &[ScanInRig],
    gyro: Option<&IntegratedGyro>,
) -> Result<Option<Overlay>, Error> {
    let camera_from_rig = mounted.rig_from_camera.inverse();
    let middle = scans.len() / 2;
    let near = images.near_scan.iter().enumerate();
    let near = near.filter_map(|(k, near)| Some((k, near.as_ref()?)));
    let Some((k, near)) = near.min_by_key(|(k, _)| k.abs_diff(middle)) else {
        return Ok(None);
    };
    let returns = scans[k].at(near.time_s, gyro);
    let points: Vec<Vector3<f64>> = returns.iter().map(|p| p.in_rig).collect();
    let (picture, points) = Picture::new(&near.image, &mounted.camera, &camera_from_rig, &points);
    Ok(Some(Overlay {
        camera: name.to_owned(),
        time_ns: near.time_ns,
        points,
        png: picture.to_png()?,
    }))
}

pub(super) fn against_lidar(
    name: &str,
    mounted: &RigCamera,
    images: &CameraImages,
    scans: &[ScanInRig],
    gyro: Option<&IntegratedGyro>,
    config: &VerifyConfig,
) -> Result<(Check, Option<Overlay>), Error> {
    let views = views(mounted, images, scans, gyro);
    let overlay = overlay(name, mounted, images, scans, gyro)?;
    let mut check = Check::unknown(
        "lidar-rotation",
        format!("{name} rotation to the LiDAR"),
        "°",
        config.lidar_rotation_deg,
    );
    match turned(&views, &mounted.rig_from_camera) {
        Some(found) => {
            let off = found.turn.norm().to_degrees();
            let sigma = found.sigma_rad.to_degrees();
            check.value = Some(off);
            check.sigma = Some(sigma);
            check.outcome = judged(off, sigma, check.limits);
            check.sentence = match check.outcome {
                Verdict::Unknown => format!(
                    "{} of LiDAR and images fit in too many ways (σ {sigma:.1}°): look at the overlay, or record a place with posts, pictures and furniture",
                    found.what
                ),
                Verdict::Pass => format!("{} of LiDAR and images agree", found.what),
                _ => format!(
                    "{} of LiDAR and images agree better if the camera is rotated by {off:.2}° about its {} axis: it was moved, or calibrate LiDAR and camera again",
                    found.what,
                    ["x", "y", "z"][found.turn.iamax()]
                ),
            };
        }
        None => {
            check.sentence = if scans.is_empty() {
                "the recording has no scans: record the LiDAR together with the cameras"
            } else {
                "too few scans with simultaneous images, with enough to see in both: record a place with posts, pictures and furniture"
            }
            .to_owned();
        }
    }
    Ok((check, overlay))
}

/// By how much a camera is turned to the LiDAR.
struct Turned {
    /// About the camera's axes, radians.
    turn: Vector3<f64>,
    sigma_rad: f64,
    what: &'static str,
}

/// Brightness says more than edges, where the LiDAR knows it. Either may be drawn by what has nothing to do with the other, a lamp's
/// light on a blank wall: then parts of the recording do not agree.
fn turned(views: &[View], rig_from_camera: &Se3) -> Option<Turned> {
    let (found, by) = match by_brightness(views, rig_from_camera) {
        Some(found) => (found, Score::MutualInformation),
        None => (by_edges(views, rig_from_camera)?, Score::Edges),
    };
    let usable = alignment::usable(views, by)?;
    let scatter_rad = alignment::scatter_rad(&usable, rig_from_camera, &found.turn, by);
    Some(Turned {
        sigma_rad: found.sigma_rad.max(scatter_rad),
        ..found
    })
}

fn by_edges(views: &[View], rig_from_camera: &Se3) -> Option<Turned> {
    let found = alignment::misalignment(views, rig_from_camera, Score::Edges)?;
    (!alignment::at_the_end(&found.turn)).then(|| Turned {
        turn: found.turn,
        sigma_rad: found.sigma_rad.norm(),
        what: "edges",
    })
}

fn by_brightness(views: &[View], rig_from_camera: &Se3) -> Option<Turned> {
    let usable = alignment::usable(views, Score::MutualInformation)?;
    if mutual_information(&usable, &rig_from_camera.inverse()) < LEAST_INFORMATION {
        return None;
    }
    let found = alignment::misalignment(views, rig_from_camera, Score::MutualInformation)?;
    Some(Turned {
        turn: found.turn,
        sigma_rad: found.sigma_rad.norm().hypot(LEAST_SIGMA_RAD),
        what: "brightness",
    })
}
