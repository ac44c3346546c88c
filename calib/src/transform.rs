//! A measured transform between two sensors, as a file: what one step gives and the joint graph takes.

use std::path::Path;

use lsfb_geometry::{Matrix6, Quaternion, Se3, UnitQuaternion, Vector3};
use serde::{Deserialize, Serialize};

use crate::Error;

/// Name of the IMU, in whose frame all poses of a rig are.
pub const IMU: &str = "imu";
/// No two sensors of a rig are farther apart, metres.
const FARTHEST_M: f64 = 10.0;
/// Name of the LiDAR.
pub const LIDAR: &str = "lidar";

/// Pose of one sensor in another, with its covariance where that was measured.
#[derive(Clone, Debug, PartialEq)]
pub struct TransformEdge {
    /// Name of the sensor it takes points to: `imu`, `lidar`, or a camera of the rig.
    pub target: String,
    /// Name of the sensor it takes points from.
    pub source: String,
    /// The transform.
    pub target_from_source: Se3,
    /// Covariance of its tangent `[rotation (rad), translation (m)]`, perturbed on the right; `None` where nothing was
    /// measured.
    pub covariance: Option<Matrix6<f64>>,
}

#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    target: String,
    source: String,
    rotation_xyzw: [f64; 4],
    translation_m: [f64; 3],
    /// By rows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    covariance: Option<[[f64; 6]; 6]>,
}

impl TransformEdge {
    /// Reads a file of [`TransformEdge::to_json`].
    pub fn read(path: &Path) -> Result<Self, Error> {
        let text = std::fs::read_to_string(path).map_err(|source| Error::Io {
            path: path.display().to_string(),
            source,
        })?;
        Self::from_json(&text).map_err(|problem| Error::Parse {
            path: path.display().to_string(),
            problem,
        })
    }

    fn from_json(text: &str) -> Result<Self, String> {
        let file: File = serde_json::from_str(text).map_err(|e| e.to_string())?;
        let [x, y, z, w] = file.rotation_xyzw;
        let rotation = Quaternion::new(w, x, y, z);
        if !((rotation.norm() - 1.0).abs() < 1e-3) {
            return Err(format!(
                "rotation_xyzw has norm {}, expected 1",
                rotation.norm()
            ));
        }
        let length_m = Vector3::from(file.translation_m).norm();
        if !(length_m < FARTHEST_M) {
            return Err(format!(
                "translation_m is {length_m:.1} m long: lengths are in metres, not millimetres"
            ));
        }
        let covariance = file
            .covariance
            .map(|rows| Matrix6::from_fn(|i, j| rows[i][j]));
        if let Some(c) = &covariance {
            let asymmetry = (c - c.transpose()).abs().max();
            if c.cholesky().is_none() || asymmetry > 1e-9 * c.abs().max() {
                return Err("covariance is not symmetric positive definite".to_owned());
            }
        }
        Ok(Self {
            target: file.target,
            source: file.source,
            target_from_source: Se3::new(
                UnitQuaternion::new_normalize(rotation),
                Vector3::from(file.translation_m),
            ),
            covariance,
        })
    }

    /// The file.
    pub fn to_json(&self) -> String {
        let q = self.target_from_source.rotation.quaternion();
        let file = File {
            target: self.target.clone(),
            source: self.source.clone(),
            rotation_xyzw: [q.i, q.j, q.k, q.w],
            translation_m: self.target_from_source.translation.into(),
            covariance: self
                .covariance
                .map(|c| std::array::from_fn(|i| std::array::from_fn(|j| c[(i, j)]))),
        };
        // Names and numbers: nothing in it can fail.
        serde_json::to_string_pretty(&file).unwrap_or_default() + "\n"
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use lsfb_geometry::Vector6;

    #[test]
    fn files_round_trip_and_wrong_ones_are_named() {
        let edge = TransformEdge {
            target: "cam0".into(),
            source: "lidar".into(),
            target_from_source: Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, 3.0)),
            covariance: Some(Matrix6::from_diagonal(&Vector6::new(
                1.0, 2.0, 3.0, 4.0, 5.0, 6.0,
            ))),
        };
        let back = TransformEdge::from_json(&edge.to_json()).expect("own output");
        let moved = edge.target_from_source.inverse() * back.target_from_source;
        assert!(moved.log().norm() < 1e-15 && back.covariance == edge.covariance);
        let text = edge.to_json();
        for (from, to, problem) in [
            ("\"target\"", "\"goal\"", "goal"),
            ("3.0", "9.0, 9.0", "line"),
            ("1.0", "-1.0", "positive"),
        ] {
            let error = TransformEdge::from_json(&text.replacen(from, to, 1)).expect_err(to);
            assert!(error.contains(problem), "{error}");
        }
        let millimetres = TransformEdge {
            target_from_source: Se3::new(UnitQuaternion::identity(), Vector3::new(83.0, 0.0, 0.0)),
            ..edge
        };
        let error = TransformEdge::from_json(&millimetres.to_json()).expect_err("too far");
        assert!(error.contains("not millimetres"), "{error}");
    }
}
