//! What became of each frame, for JSON and CSV.

use std::fmt::Write;

use lsfb_geometry::{Quaternion, Se3, UnitQuaternion, Vector3};
use lsfb_pipeline::localization::{
    Evidence, FocalLengthDecision, JointFocalLength, Localization, NotLocalized, NotLocalizedReason,
};
use serde::{Deserialize, Serialize};

use super::PAPER_INLIERS;

/// What became of one frame.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub struct Frame {
    /// Name of the image, or time of the instant, seconds.
    pub frame: String,
    /// Whether the pose is right with the probability that is asked for.
    pub localized: bool,
    /// Why not, where it is not.
    pub reason: Option<String>,
    /// Whether that is an image that cannot be decoded.
    pub unreadable: bool,
    /// The best pose, localized or not.
    pub pose: Option<Pose>,
    /// Distance from the listed pose, metres.
    pub distance_m: Option<f64>,
    /// Angle to the listed pose, degrees.
    pub angle_deg: Option<f64>,
}

/// A pose and what speaks for it.
#[derive(Clone, PartialEq, Serialize, Deserialize)]
pub struct Pose {
    /// Position of the rig in the world of the map, metres.
    pub translation_m: [f64; 3],
    /// Rotation of the rig to the world.
    pub rotation_xyzw: [f64; 4],
    /// Standard deviation of the position, metres.
    pub position_sigma_m: f64,
    /// Standard deviation of the rotation, degrees.
    pub rotation_sigma_deg: f64,
    /// Covariance, tangent `[rotation, translation]` on the right, rad² and m²; by rows.
    pub covariance: Vec<f64>,
    /// Probability that the pose is right.
    pub probability: f64,
    /// Inliers after guided matching.
    pub inliers: usize,
    /// Whether the paper's rule would count the frame as localized.
    pub more_than_30_inliers: bool,
    /// Root mean square of their reprojection errors, pixels.
    pub reprojection_rms_px: f64,
    /// Votes of the place where it was found.
    pub votes: u32,
    /// What speaks for it.
    pub evidence: Evidence,
}

impl Frame {
    /// Of a frame and, where it is known, its listed pose.
    pub fn new(
        frame: String,
        found: &Result<Localization, NotLocalized>,
        listed: Option<&Se3>,
    ) -> Self {
        let best = found.as_ref().map_or_else(NotLocalized::best, Some);
        let off = best
            .zip(listed)
            .map(|(best, listed)| listed.inverse() * best.world_from_rig);
        Self {
            frame,
            localized: found.is_ok(),
            reason: found.as_ref().err().map(ToString::to_string),
            unreadable: found.as_ref().is_err_and(|refused| {
                matches!(refused.reason, NotLocalizedReason::Unreadable { .. })
            }),
            pose: best.map(Pose::new),
            distance_m: off.map(|off| off.translation.norm()),
            angle_deg: off.map(|off| off.rotation.angle().to_degrees()),
        }
    }
}

impl Pose {
    fn new(found: &Localization) -> Self {
        let covariance = &found.covariance;
        let deviation = |first: usize| {
            let variances = (first..first + 3).map(|i| covariance[(i, i)]);
            variances.sum::<f64>().sqrt()
        };
        Self {
            translation_m: found.world_from_rig.translation.into(),
            rotation_xyzw: found.world_from_rig.rotation.coords.into(),
            position_sigma_m: deviation(3),
            rotation_sigma_deg: deviation(0).to_degrees(),
            covariance: covariance.transpose().as_slice().to_vec(),
            probability: found.probability,
            inliers: found.matches.len(),
            more_than_30_inliers: found.matches.len() > PAPER_INLIERS,
            reprojection_rms_px: found.reprojection_rms_px,
            votes: found.votes,
            evidence: found.evidence,
        }
    }

    /// Pose of the rig, of the very numbers that are written.
    pub fn world_from_rig(&self) -> Se3 {
        let rotation = Quaternion::from(self.rotation_xyzw);
        Se3::new(
            UnitQuaternion::new_unchecked(rotation),
            Vector3::from(self.translation_m),
        )
    }
}

/// Judges the focal length of a camera by all of its frames, as [`lsfb_pipeline::localization::judge_together`] does.
pub fn judge_together(frames: &mut [&mut Frame], min_probability: f64) {
    let evidence = frames
        .iter()
        .filter_map(|f| Some(&f.pose.as_ref()?.evidence));
    let Some(joint) = JointFocalLength::of(evidence) else {
        return;
    };
    for frame in frames {
        let Some(pose) = &frame.pose else {
            continue;
        };
        match joint.judge(&pose.evidence, frame.localized) {
            FocalLengthDecision::Refused => {
                frame.localized = false;
                frame.reason = Some(joint.to_string());
            }
            FocalLengthDecision::Borne if pose.probability >= min_probability => {
                frame.localized = true;
                frame.reason = None;
            }
            FocalLengthDecision::Borne | FocalLengthDecision::AsAlone => {}
        }
    }
}

/// A line for each frame; empty fields where there is no pose.
pub fn csv(frames: &[Frame]) -> String {
    let mut text = "frame,localized,probability,inliers,more_than_30_inliers,x_m,y_m,z_m,qx,qy,qz,qw,position_sigma_m,\
                    rotation_sigma_deg,reprojection_rms_px,votes,first_matches,first_inliers,log10_false_alarms,known_decades,\
                    decoy_inliers,rival_inliers,twin_inliers,image_spread,first_spread,log10_false_alarms_mirrored,focal_scale,focal_log_sigma,focal_decades"
        .to_owned();
    for row in 0..6 {
        for column in 0..6 {
            let _ = write!(text, ",cov_{row}{column}");
        }
    }
    text.push_str(",reason\n");
    for frame in frames {
        let mut fields = vec![field(&frame.frame), u8::from(frame.localized).to_string()];
        match &frame.pose {
            Some(pose) => fields.extend(pose.fields()),
            None => fields.resize(EMPTY_FIELDS, String::new()),
        }
        let reason = frame.reason.as_deref().unwrap_or_default();
        fields.push(quoted(reason));
        text.push_str(&fields.join(","));
        text.push('\n');
    }
    text
}

/// A name as a field of a line: quoted where it must be.
pub fn field(name: &str) -> String {
    match name.contains([',', '"']) {
        true => quoted(name),
        false => name.to_owned(),
    }
}

fn quoted(text: &str) -> String {
    format!("\"{}\"", text.replace('"', "'"))
}

/// Fields of a line before the reason.
const EMPTY_FIELDS: usize = 29 + 36;

impl Pose {
    fn fields(&self) -> Vec<String> {
        let mut fields = vec![
            self.probability.to_string(),
            self.inliers.to_string(),
            u8::from(self.more_than_30_inliers).to_string(),
        ];
        let [position, rotation] = [&self.translation_m[..], &self.rotation_xyzw[..]];
        fields.extend(position.iter().chain(rotation).map(f64::to_string));
        let e = &self.evidence;
        fields.extend([
            self.position_sigma_m.to_string(),
            self.rotation_sigma_deg.to_string(),
            self.reprojection_rms_px.to_string(),
            self.votes.to_string(),
            e.first_matches.to_string(),
            e.first_inliers.to_string(),
            e.log10_false_alarms.to_string(),
            e.known_decades.to_string(),
            e.decoy_inliers.to_string(),
            e.rival_inliers.to_string(),
            e.twin_inliers.to_string(),
            e.image_spread.to_string(),
            e.first_spread.to_string(),
            e.log10_false_alarms_mirrored.to_string(),
            e.focal_scale.to_string(),
            e.focal_log_sigma.to_string(),
            e.focal_decades.to_string(),
        ]);
        fields.extend(self.covariance.iter().map(f64::to_string));
        fields
    }
}

#[cfg(test)]
pub mod tests {
    use super::*;

    /// Of frames that find these factors of the focal length, which are localized.
    fn localized(scales: &[f64]) -> Vec<bool> {
        let found = scales.iter().map(|scale| {
            let mut found = frame(String::new(), 0.0, None);
            if let Some(pose) = &mut found.pose {
                pose.evidence.focal_scale = *scale;
                pose.evidence.focal_log_sigma = 0.01;
                pose.evidence.focal_decades = 10.0;
                found.localized = !pose.evidence.contradicts_focal_length();
            }
            found
        });
        let mut found: Vec<Frame> = found.collect();
        judge_together(&mut found.iter_mut().collect::<Vec<_>>(), 0.99);
        found.iter().map(|f| f.localized).collect()
    }

    #[test]
    fn frames_of_a_camera_are_judged_together() {
        assert_eq!(localized(&[1.0, 1.2]), [true, false]);
        assert_eq!(localized(&[1.0, 0.98, 1.2, 1.01, 0.99]), [true; 5]);
        assert_eq!(localized(&[1.1, 1.04, 1.09, 1.12, 1.11]), [false; 5]);
    }

    /// A frame that was localized at a place along x.
    pub fn frame(name: String, x_m: f64, listed: Option<&Se3>) -> Frame {
        let evidence = Evidence {
            first_matches: 300,
            first_inliers: 90,
            chance_level: 1.0 / 3000.0,
            log10_false_alarms: -120.25,
            known_decades: 0.0,
            guided_inliers: 200,
            decoy_inliers: 12.0,
            image_spread: 0.6,
            first_spread: 0.6,
            focal_scale: 1.0,
            // What the matches do not tell.
            focal_log_sigma: f64::INFINITY,
            focal_decades: 0.0,
            log10_false_alarms_mirrored: f64::MIN_POSITIVE,
            decades_together: 0.02,
            rival_inliers: 0,
            twin_inliers: 0,
        };
        Frame {
            frame: name,
            localized: true,
            reason: None,
            unreadable: false,
            pose: Some(Pose {
                translation_m: [x_m, x_m / 3.0, -0.0],
                rotation_xyzw: [0.1 * x_m, 0.0, 0.0, 1.0],
                position_sigma_m: 1e-3 * x_m,
                rotation_sigma_deg: 0.1,
                covariance: (0..36).map(|k| x_m / f64::from(k + 7)).collect(),
                probability: 1.0 - 1e-9 * x_m,
                inliers: 200,
                more_than_30_inliers: true,
                reprojection_rms_px: 1.0 / (1.0 + x_m),
                votes: 40,
                evidence,
            }),
            distance_m: listed.map(|listed| (listed.translation.x - x_m).abs()),
            angle_deg: listed.map(|_| x_m / 7.0),
        }
    }

    /// A frame that was not.
    pub fn not_found(name: String) -> Frame {
        Frame {
            frame: name,
            localized: false,
            reason: Some("\"too few\" matches".to_owned()),
            unreadable: false,
            pose: None,
            distance_m: None,
            angle_deg: None,
        }
    }
}
