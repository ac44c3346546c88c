//! Rotation between LiDAR and cameras from any recording, without a target: mutual information first, edges as a check.

use lsfb_geometry::{Rig, Se3, Vector3, Vector6, so3};
use lsfb_recording::Recording;
use lsfb_types::ProgressFn;
use nalgebra::Matrix6;
use serde::Serialize;

use super::alignment::{Misalignment, Score, misalignment};
use super::{Seen, VerifyConfig, gyro, scans, views};
use crate::{Error, TransformEdge};

/// How well a translation is known that this step leaves as it was, metres: as a tape measure has it.
const TRANSLATION_SIGMA_M: f64 = 0.02;
/// Smallest standard deviation that is claimed for a rotation, radians: a third of a step of most LiDARs.
const LEAST_SIGMA_RAD: f64 = 1e-3;
/// Standard deviation beyond which the scene does not determine a rotation, radians.
const LARGEST_SIGMA_RAD: f64 = 0.012;
/// Standard deviations by which both scores may differ.
const MOST_DIFFERENCE: f64 = 4.0;

/// What is said of one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refinement {
    /// The camera.
    pub camera: String,
    /// Rotation of the camera to what the rig says, about its own axes, radians.
    pub turn_rad: [f64; 3],
    /// Its standard deviations, radians.
    pub sigma_rad: [f64; 3],
    /// The same from edges, where these say anything, radians.
    pub edges_turn_rad: Option<[f64; 3]>,
    /// Pose of the LiDAR in the camera with its covariance: rotation from here, translation as the rig had it. `None` where
    /// the recording does not determine the rotation.
    #[serde(skip)]
    pub edge: Option<TransformEdge>,
    /// In words.
    pub sentence: String,
}

/// Rotations between the LiDAR and all cameras of a rig that is nearly right: within 2.5°.
pub fn refine(
    recording: &Recording,
    rig: &Rig,
    config: &VerifyConfig,
    progress: ProgressFn,
) -> Result<Vec<Refinement>, Error> {
    let unknown = |problem: &str| Error::NotJoined {
        first: "cameras".to_owned(),
        second: "lidar".to_owned(),
        problem: problem.to_owned(),
    };
    let lidar = rig
        .lidar
        .as_ref()
        .ok_or_else(|| unknown("the rig has no LiDAR: give it a pose as measured by hand"))?;
    let gyro = gyro(recording)?;
    let scans = scans(recording, rig, config)?;
    if scans.is_empty() {
        return Err(unknown("the recording has no scans"));
    }
    let mut out = Vec::new();
    for (name, mounted) in &rig.cameras {
        if recording.images(name).is_err() {
            continue;
        }
        let only_views = VerifyConfig {
            max_frames: 0,
            ..*config
        };
        let seen = Seen::read(recording, name, mounted, &scans, &only_views, progress)?;
        let views = views(mounted, &seen, &scans, gyro.as_ref());
        let camera_from_rig = mounted.rig_from_camera.inverse();
        let by = |score| misalignment(&views, &camera_from_rig, score);
        let Some(found) = by(Score::MutualInformation) else {
            out.push(silent(name, "too few scans and images of the same time"));
            continue;
        };
        let camera_from_lidar = camera_from_rig * lidar.rig_from_lidar;
        out.push(judge(
            name,
            &found,
            by(Score::Edges).as_ref(),
            &camera_from_lidar,
        ));
    }
    if out.is_empty() {
        return Err(unknown("none of the rig's cameras is in the recording"));
    }
    Ok(out)
}

fn silent(camera: &str, why: &str) -> Refinement {
    Refinement {
        camera: camera.to_owned(),
        turn_rad: [0.0; 3],
        sigma_rad: [f64::INFINITY; 3],
        edges_turn_rad: None,
        edge: None,
        sentence: why.to_owned(),
    }
}

fn judge(
    camera: &str,
    found: &Misalignment,
    edges: Option<&Misalignment>,
    camera_from_lidar: &Se3,
) -> Refinement {
    let sigma = found.sigma_rad.map(|s| s.max(LEAST_SIGMA_RAD));
    let mut refinement = Refinement {
        camera: camera.to_owned(),
        turn_rad: found.turn.into(),
        sigma_rad: sigma.into(),
        edges_turn_rad: edges.map(|e| e.turn.into()),
        edge: None,
        sentence: String::new(),
    };
    let weak = sigma.iamax();
    if sigma[weak] > LARGEST_SIGMA_RAD {
        refinement.sentence = format!(
            "rotation about the camera's {} axis is not determined (σ {:.1}°): record a place with surfaces of different brightness",
            ["x", "y", "z"][weak],
            sigma[weak].to_degrees()
        );
        return refinement;
    }
    if let Some(edges) = edges {
        let spread = (edges.sigma_rad.norm_squared() + sigma.norm_squared()).sqrt();
        let apart = (edges.turn - found.turn).norm();
        if edges.sigma_rad.norm() < LARGEST_SIGMA_RAD && apart > MOST_DIFFERENCE * spread {
            refinement.sentence = format!(
                "brightness and edges differ by {:.2}°: look at the overlay of `lsfb calib verify`",
                apart.to_degrees()
            );
            return refinement;
        }
    }
    let turned = Se3::new(so3::exp(&found.turn), Vector3::zeros()) * *camera_from_lidar;
    // The turn is about the camera's axes; covariances of edges are in those of the LiDAR.
    let to_lidar = turned.rotation_matrix().transpose();
    let rotation = to_lidar
        * nalgebra::Matrix3::from_diagonal(&sigma.component_mul(&sigma))
        * to_lidar.transpose();
    let variance = TRANSLATION_SIGMA_M * TRANSLATION_SIGMA_M;
    let mut covariance = Matrix6::from_diagonal(&Vector6::repeat(variance));
    covariance.fixed_view_mut::<3, 3>(0, 0).copy_from(&rotation);
    refinement.sentence = format!(
        "turned by {:.2}° ± {:.2}°",
        found.turn.norm().to_degrees(),
        sigma.norm().to_degrees()
    );
    refinement.edge = Some(TransformEdge {
        target: camera.to_owned(),
        source: crate::joint::LIDAR.to_owned(),
        target_from_source: turned,
        covariance: Some(covariance),
    });
    refinement
}
