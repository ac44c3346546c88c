//! What is said of a refinement.

use lsfb_geometry::Se3;
use lsfb_types::{Finding, Judgement, Limit, Verdict};
use serde::Serialize;

use crate::{Overlay, TransformEdge};

/// Squared σ of six numbers that chance leaves between halves in all but one of a thousand recordings (χ² of six).
const HALVES_AGREE: f64 = 22.5;
/// By how much the LiDAR's way may turn wrong from image to image, degrees: four cameras of a simulated walk have 0.008 to 0.011, and
/// 0.05 and 0.08 with a focal length that is 2 % off and a principal point that is 6 px off; small images (320 × 200 px) 0.034 and 0.24.
const WORRYING_TURN_DEG: f64 = 0.045;
/// Offset of a camera's clock that one which is synchronised does not have, milliseconds.
const WORRYING_CLOCK_MS: f64 = 3.0;
/// Standard deviations beyond which a clock is none of chance.
const CLEAR: f64 = 3.0;
/// Names of the six numbers.
pub(super) const NAMES: [&str; 6] = ["rotation x", "rotation y", "rotation z", "x", "y", "z"];

/// One number of the camera's pose, about or along its own axes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Component {
    /// `rotation x` … `z`.
    pub name: &'static str,
    /// What was added to what the rig says, radians or metres; `None` where the recording does not determine it: it is as it
    /// was.
    pub change: Option<f64>,
    /// Standard deviation, radians or metres; of what is not determined, that of a pose by hand.
    pub sigma: f64,
}

/// By how much corners, put from one image onto surfaces of the LiDAR, are elsewhere in others; medians, pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Transfer {
    /// With the rig's pose.
    pub before_px: f64,
    /// With the one found.
    pub after_px: f64,
    /// In every other part of the recording with the pose found in the rest.
    pub held_back_px: f64,
}

/// What speaks for a pose.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Evidence {
    /// Images looked at.
    pub images: usize,
    /// Corners on surfaces.
    pub corners: usize,
    /// How often they were seen.
    pub observations: usize,
    /// Parts of the recording that say something on their own.
    pub blocks: usize,
    /// Standard deviation of a corner, pixels of the image as it was looked at.
    pub pixel_px: f64,
    /// Of a corner from its surface, metres.
    pub plane_m: f64,
    /// By how much the LiDAR's way turns wrong at an image, beside what its returns know, radians.
    pub image_turn_rad: f64,
    /// And by how much it is elsewhere, metres.
    pub image_shift_m: f64,
    /// Variance between parts of the recording over what their noise explains; standard deviations take it in.
    pub inflation: f64,
    /// What is to be added to the camera's times, seconds, and its standard deviation.
    pub clock_s: [f64; 2],
    /// How well corners are transferred.
    pub transfer: Transfer,
    /// The pose of every other part less that of the rest: radians, metres.
    pub halves: [f64; 6],
    /// Squared length of that over its covariance: 6 is expected.
    pub halves_square: f64,
    /// How fast the camera turned about its axes, rms, rad/s.
    pub turning_rad_s: [f64; 3],
    /// And moved along them, rms, m/s.
    pub speed_m_s: [f64; 3],
    /// Errors of corners over their standard deviation.
    #[serde(skip)]
    pub(super) normalized: Vec<f64>,
    /// Corners by cell of the image, and their mean errors.
    #[serde(skip)]
    pub(super) coverage: Vec<u32>,
    #[serde(skip)]
    pub(super) cell_errors_px: Vec<[f64; 2]>,
    #[serde(skip)]
    pub(super) size_px: [u32; 2],
}

/// What is said of one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refinement {
    /// The camera.
    pub camera: String,
    /// Its six numbers; none where nothing can be said.
    pub components: Vec<Component>,
    /// What speaks for them.
    pub evidence: Option<Evidence>,
    /// How to record what is not determined.
    pub advice: Option<String>,
    /// The best pose of the camera on the LiDAR, also where it is not given out.
    #[serde(skip)]
    pub(super) lidar_from_camera: Option<Se3>,
    /// Pose of the LiDAR in the camera with its covariance. `None` where it may not be trusted.
    #[serde(skip)]
    pub edge: Option<TransformEdge>,
    /// Returns over an image, with the rig's pose and with the best one.
    #[serde(skip)]
    pub overlays: Option<[Overlay; 2]>,
    /// In words.
    pub sentence: String,
}

/// All cameras.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefinementReport {
    /// By name.
    pub cameras: Vec<Refinement>,
    /// The rig's cameras that the recording has no images of, and why.
    pub missing: Vec<(String, String)>,
}

impl Component {
    /// Whether it is an angle.
    pub fn is_angle(&self) -> bool {
        self.name.starts_with("rotation")
    }

    /// A value of it in degrees or millimetres.
    pub(super) fn shown(&self, value: f64) -> f64 {
        if self.is_angle() {
            value.to_degrees()
        } else {
            value * 1e3
        }
    }

    pub(super) fn unit(&self) -> &'static str {
        if self.is_angle() { "°" } else { "mm" }
    }
}

impl Evidence {
    /// How to move where something is not determined.
    pub(super) fn advice(&self, components: &[Component]) -> Option<String> {
        let missing: Vec<&str> = components
            .iter()
            .filter(|c| c.change.is_none())
            .map(|c| c.name)
            .collect();
        if missing.is_empty() {
            return None;
        }
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| self.turning_rad_s[*a].total_cmp(&self.turning_rad_s[*b]));
        let [least, next, _] = order.map(|k| ["x", "y", "z"][k]);
        Some(format!(
            "to determine {}: rotate the rig more about the camera's {least} and {next} axes, walk past furniture and pictures within 5 m, and record longer",
            missing.join(", ")
        ))
    }
}

impl Refinement {
    /// What was found, and what was not.
    pub(super) fn in_words(&self) -> String {
        let norm =
            |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
        let found = |angles: bool| {
            let own = self.components.iter();
            own.filter(move |c| c.is_angle() == angles && c.change.is_some())
        };
        let change = |angles: bool| norm(&mut found(angles).filter_map(|c| c.change));
        let sigma = |angles: bool| norm(&mut found(angles).map(|c| c.sigma));
        let mut words = Vec::new();
        if found(true).next().is_some() {
            words.push(format!(
                "rotated by {:.3}° ± {:.3}°",
                change(true).to_degrees(),
                sigma(true).to_degrees()
            ));
        }
        if found(false).next().is_some() {
            words.push(format!(
                "moved by {:.1} ± {:.1} mm",
                change(false) * 1e3,
                sigma(false) * 1e3
            ));
        }
        let lost: Vec<&str> = self
            .components
            .iter()
            .filter(|c| c.change.is_none())
            .map(|c| c.name)
            .collect();
        if !lost.is_empty() {
            words.push(format!(
                "not determined and left unchanged: {}",
                lost.join(", ")
            ));
        }
        words.join("; ")
    }

    /// Whether all six numbers were found.
    fn is_whole(&self) -> bool {
        self.edge.is_some() && self.components.iter().all(|c| c.change.is_some())
    }
}

impl Refinement {
    /// Whether the camera was placed, and what speaks against its pose.
    fn findings(&self) -> Vec<Finding> {
        let (verdict, code) = match &self.edge {
            None => (Verdict::Fail, "placed"),
            Some(_) if !self.is_whole() => (Verdict::Warn, "placed"),
            Some(_) => (Verdict::Pass, "placed"),
        };
        let placed = Finding::new(code, verdict, &*self.camera, &*self.sentence);
        let mut findings = vec![match &self.advice {
            Some(advice) => placed.remedy(&**advice),
            None => placed,
        }];
        if let Some(evidence) = self.evidence.as_ref().filter(|_| self.edge.is_some()) {
            let limit = Limit::AtMost(HALVES_AGREE);
            let agrees = limit.holds(evidence.halves_square);
            let what = format!(
                "halves of the recording differ with χ² = {:.1} (6 degrees of freedom)",
                evidence.halves_square
            );
            let halves = Finding::new("halves", Verdict::Warn.unless(agrees), &*self.camera, what);
            findings.push(
                halves
                    .value(evidence.halves_square, "")
                    .limit(limit)
                    .remedy("record another walk and compare"),
            );
            findings.push(self.lens(evidence));
            findings.extend(self.clock(evidence));
        }
        findings
    }

    /// Whether images lie on the LiDAR's way as one lens has them: a wrong one turns and moves the camera, and each image besides.
    fn lens(&self, evidence: &Evidence) -> Finding {
        let turn_deg = evidence.image_turn_rad.to_degrees();
        let limit = Limit::AtMost(WORRYING_TURN_DEG);
        let what =
            format!("each image is rotated by {turn_deg:.3}° relative to the LiDAR's trajectory");
        Finding::new("images", Verdict::Warn, &*self.camera, what)
            .judged(turn_deg, "°", limit)
            .remedy("the lens may not belong to these images, or the LiDAR's trajectory is poor, and the pose is then off by more than its standard deviation; calibrate the lens (`lsfb calib camera`) and refine again")
    }

    /// A clock that is not synchronised.
    fn clock(&self, evidence: &Evidence) -> Option<Finding> {
        let [offset_ms, sigma_ms] = evidence.clock_s.map(|s| s * 1e3);
        let limit = Limit::AtMost(WORRYING_CLOCK_MS);
        if limit.holds(offset_ms.abs()) || offset_ms.abs() < CLEAR * sigma_ms {
            return None;
        }
        let what = format!("its clock is off by {offset_ms:+.2} ± {sigma_ms:.2} ms");
        let finding = Finding::new("clock", Verdict::Warn, &*self.camera, what);
        Some(
            finding
                .value(offset_ms.abs(), "ms")
                .limit(limit)
                .remedy("synchronise it; a wrong lens can also look like a clock offset"),
        )
    }
}

impl RefinementReport {
    /// What was found, in a few words.
    pub fn summary(&self) -> String {
        let placed = self.cameras.iter().filter(|c| c.edge.is_some()).count();
        format!(
            "{placed} of {} cameras calibrated to the LiDAR without a board",
            self.cameras.len()
        )
    }

    /// Whether the result may be used, and how far.
    pub fn judgement(&self) -> Judgement {
        let missing = self.missing.iter().map(|(camera, why)| {
            let what = format!("the rig has this camera, but it was not checked: {why}");
            Finding::new("camera-missing", Verdict::Warn, camera, what)
        });
        let findings = self.cameras.iter().flat_map(Refinement::findings);
        Judgement::new(findings.chain(missing).collect())
    }
}
