//! The LiDAR's pose to cameras from any recording, without a target: corners of images on surfaces that the LiDAR saw.
//!
//! | step | file |
//! | --- | --- |
//! | the LiDAR's path, by its own scans and the gyroscope | `scan.rs`, `lidar_path.rs`, `predicted_rotation.rs` |
//! | planes of the place | `../overlapping_planes.rs` |
//! | corners on planes, found in images from far apart | `landmarks.rs` |
//! | the pose at which both agree (Eq. 4) | `adjustment/`, `residuals.rs`, `noise.rs` |
//! | what it is worth | `estimate.rs` |
//! | all of it for one camera, and what is said of it | `camera.rs`, `refusal.rs`, `report.rs`, `page.rs` |

mod adjustment;
mod camera;
mod estimate;
mod landmarks;
mod lidar_path;
mod noise;
mod page;
mod predicted_rotation;
mod refusal;
mod report;
mod residuals;
mod scan;

use lsfb_geometry::Rig;
use lsfb_recording::Recording;
use lsfb_types::{Bounds, Progress, ProgressFn};
use serde::{Deserialize, Serialize};

use crate::{Error, JoinProblem, recorded};
use camera::CameraRefinement;
pub use page::Compared;
pub use report::{Component, Evidence, Refinement, RefinementReport, Transfer};

/// Shortest recording that is looked at, seconds.
const SHORTEST_S: f64 = 5.0;
/// Cells with a plane that a place needs.
const LEAST_PLANES: usize = 200;

/// Settings of [`refine`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RefineConfig {
    /// How much of a recording is looked at, from its first scan, seconds.
    pub longest_s: f64,
    /// Time between images that are looked at, seconds.
    pub image_gap_s: f64,
    /// Images in which the same corners are looked for.
    pub block_images: usize,
    /// Standard deviation beyond which a rotation is not determined, degrees.
    pub largest_sigma_deg: f64,
    /// Standard deviation beyond which a translation is not determined, metres.
    pub largest_sigma_m: f64,
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            longest_s: 60.0,
            image_gap_s: 0.25,
            block_images: 10,
            largest_sigma_deg: 0.3,
            largest_sigma_m: 0.015,
        }
    }
}

lsfb_types::bounds! {
    RefineConfig {
        longest_s: number(Bounds::POSITIVE),
        image_gap_s: number(Bounds::POSITIVE),
        block_images: number(Bounds::AT_LEAST_ONE),
        largest_sigma_deg: number(Bounds::POSITIVE),
        largest_sigma_m: number(Bounds::POSITIVE),
    }
}

/// Poses between the LiDAR and all cameras of a rig that is nearly right: within 2.5° and 5 cm.
pub fn refine(
    recording: &Recording,
    rig: &Rig,
    config: &RefineConfig,
    progress: ProgressFn,
) -> Result<RefinementReport, Error> {
    config.check_bounds("refine")?;
    let unknown = |cause: JoinProblem| Error::NotJoined {
        first: "cameras".to_owned(),
        second: "lidar".to_owned(),
        cause,
    };
    let Some(lidar) = rig.lidar() else {
        return Err(unknown(JoinProblem::NoLidar));
    };
    let (present, missing) = recorded::cameras(recording, rig);
    if present.is_empty() {
        return Err(unknown(JoinProblem::NoCamera));
    }
    if recording.scans().is_err() {
        return Err(unknown(JoinProblem::NoScans));
    }
    let gyro = recorded::gyro(recording)?;
    let scans = scan::read(recording, config.longest_s, progress)?;
    let length_s = match scans.as_slice() {
        [first, .., last] => last.middle_s - first.middle_s,
        _ => 0.0,
    };
    if length_s < SHORTEST_S {
        return Err(unknown(JoinProblem::ShortScans {
            length_s,
            needed_s: SHORTEST_S,
        }));
    }
    let followed = lidar_path::follow(&scans, rig, gyro.as_ref(), progress)?;
    let Some((path, place)) = followed.filter(|(_, place)| place.planes() >= LEAST_PLANES) else {
        return Err(unknown(JoinProblem::ScansUnregistered));
    };
    let mut cameras = Vec::new();
    for (k, (name, mounted)) in present.iter().enumerate() {
        progress(Progress {
            stage: "cameras",
            done: k as u64,
            total: present.len() as u64,
        })?;
        let one = CameraRefinement {
            name,
            mounted,
            start: lidar.rig_from_lidar.inverse() * mounted.rig_from_camera,
            path: &path,
            place: &place,
            scans: &scans,
            config,
        };
        cameras.push(one.refined(recording, progress)?);
    }
    let missing = missing.into_iter();
    let missing = missing.map(|(name, why)| (name.to_owned(), why));
    Ok(RefinementReport {
        cameras,
        missing: missing.collect(),
    })
}
