//! Whether a rig still fits a recording: no target, no answer but PASS, WARN or FAIL, with the figures behind it.
//!
//! | check | compares | file |
//! | --- | --- | --- |
//! | time offset, rotation | a camera's angular velocity with the gyroscope's | `against_gyro.rs`, `time_offset.rs` |
//! | the same all along | these of parts of the recording with each other | `steadiness.rs` |
//! | LiDAR on image | steps in range with edges of brightness | `against_lidar.rs`, `alignment.rs` |
//! | epipolar | corners in one camera with their curves in another | `against_camera.rs`, `epipolar.rs` |
//!
//! `judgement.rs` says what the limits are, and why.

mod against_camera;
mod against_gyro;
mod against_lidar;
mod alignment;
mod camera_images;
mod clocks;
mod epipolar;
mod judgement;
mod mutual_information;
mod page;
mod scan_motion;
mod scans;
mod steadiness;
mod time_offset;
mod view;

use lsfb_geometry::Rig;
use lsfb_recording::Recording;
use lsfb_types::{Bounds, Finding, Judgement, Limit, Progress, ProgressFn, Verdict};
use serde::{Deserialize, Serialize, Serializer};

use crate::{Error, Overlay, recorded};
use camera_images::CameraImages;
pub use clocks::MeasuredClock;
use scans::scans;

/// Settings of [`verify`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct VerifyConfig {
    /// Images per camera compared with the gyroscope at most, spread over the recording in five parts.
    pub max_frames: usize,
    /// Images per camera compared with the LiDAR or another camera, spread over the recording.
    pub views: usize,
    /// Time offset beyond the rig's that is a warning, and a failure, milliseconds.
    pub time_offset_ms: [f64; 2],
    /// Rotation of a camera to the gyroscope that is a warning, and a failure, degrees.
    pub imu_rotation_deg: [f64; 2],
    /// Rotation of a camera to the LiDAR that is a warning, and a failure, degrees.
    pub lidar_rotation_deg: [f64; 2],
    /// Median epipolar error that is a warning, and a failure, pixels.
    pub epipolar_px: [f64; 2],
}

impl Default for VerifyConfig {
    fn default() -> Self {
        Self {
            max_frames: 400,
            views: 24,
            time_offset_ms: [2.0, 4.0],
            imu_rotation_deg: [0.5, 1.0],
            lidar_rotation_deg: [0.4, 0.8],
            epipolar_px: [1.0, 2.0],
        }
    }
}

lsfb_types::bounds! {
    VerifyConfig {
        max_frames: any,
        views: any,
        time_offset_ms: each(Bounds::NOT_NEGATIVE),
        imu_rotation_deg: each(Bounds::NOT_NEGATIVE),
        lidar_rotation_deg: each(Bounds::NOT_NEGATIVE),
        epipolar_px: each(Bounds::NOT_NEGATIVE),
    }
}

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// What was compared: `cam0 time offset`.
    pub name: String,
    /// The same for programs, whichever cameras it is: `time-offset`.
    pub code: &'static str,
    /// How it ended.
    #[serde(serialize_with = "named")]
    pub outcome: Verdict,
    /// What was found, in the unit of [`Check::unit`].
    pub value: Option<f64>,
    /// Its standard deviation.
    pub sigma: Option<f64>,
    /// From where on it is a warning, and a failure.
    pub limits: [f64; 2],
    /// Unit of all.
    pub unit: &'static str,
    /// In words, with what to do.
    pub sentence: String,
}

/// All checks of a rig on a recording.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Verification {
    /// The checks.
    pub checks: Vec<Check>,
    /// One picture per camera that sees the LiDAR's returns.
    pub overlays: Vec<Overlay>,
}

impl Verification {
    /// What follows from the checks.
    pub fn judgement(&self) -> Judgement {
        Judgement::new(self.checks.iter().map(Check::finding).collect())
    }

    /// What was judged, in a few words.
    pub fn summary(&self) -> String {
        let determined = self.checks.iter();
        let determined = determined.filter(|c| c.outcome != Verdict::Unknown);
        format!(
            "{} of {} checks determined",
            determined.count(),
            self.checks.len()
        )
    }
}

/// Compares a rig with a recording.
pub fn verify(
    recording: &Recording,
    rig: &Rig,
    config: &VerifyConfig,
    progress: ProgressFn,
) -> Result<Verification, Error> {
    config.check_bounds("verify")?;
    let gyro = recorded::gyro(recording)?;
    let scans = scans(recording, rig, gyro.as_ref(), config)?;
    let mut checks = Vec::new();
    let mut overlays = Vec::new();
    let (present, absent) = recorded::cameras(recording, rig);
    checks.extend(absent.into_iter().map(|(name, why)| Check {
        outcome: Verdict::Warn,
        sentence: format!("the rig has this camera, but it was not checked: {why}"),
        ..Check::unknown(
            "camera-missing",
            format!("{name} in the recording"),
            "",
            [0.0; 2],
        )
    }));
    for (k, (name, mounted)) in present.iter().enumerate() {
        progress(Progress {
            stage: "cameras",
            done: k as u64,
            total: present.len() as u64,
        })?;
        let images = CameraImages::read(recording, (name, mounted), &scans, config, progress)?;
        let pairs = &images.pairs;
        checks.extend(against_gyro::against_gyro(
            name,
            mounted,
            pairs,
            gyro.as_ref(),
            config,
        ));
        checks.extend(steadiness::steadiness(
            name,
            mounted,
            pairs,
            gyro.as_ref(),
            config,
        ));
        if rig.lidar().is_some() {
            let (check, overlay) = against_lidar::against_lidar(
                name,
                mounted,
                &images,
                &scans,
                gyro.as_ref(),
                config,
            )?;
            checks.push(check);
            overlays.extend(overlay);
        }
    }
    checks.extend(against_camera::all(recording, &present, config)?);
    if present.is_empty() {
        checks.push(Check {
            sentence: "none of the rig's cameras is in this recording: check the names".to_owned(),
            ..Check::unknown("cameras", "recording".to_owned(), "", [0.0; 2])
        });
    }
    Ok(Verification { checks, overlays })
}

/// Name of the check of a camera's clock.
fn time_offset_name(camera: &str) -> String {
    format!("{camera} time offset")
}

/// Name of the check of a camera's axes against the gyroscope's.
fn rotation_name(camera: &str) -> String {
    format!("{camera} rotation to the IMU")
}

/// Name of the check whether a camera's clock keeps its offset.
fn time_drift_name(camera: &str) -> String {
    format!("{camera} time offset over time")
}

/// Name of the check whether a camera keeps its axes.
fn mount_drift_name(camera: &str) -> String {
    format!("{camera} rotation over time")
}

/// As it stands in tables: `PASS`.
fn named<S: Serializer>(verdict: &Verdict, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(verdict.name())
}

impl Check {
    /// The check as all commands give theirs.
    fn finding(&self) -> Finding {
        let [warns, fails] = self.limits;
        let limit = match self.outcome {
            Verdict::Fail => fails,
            _ => warns,
        };
        Finding {
            value: self.value,
            sigma: self.sigma,
            unit: self.unit,
            limit: self.value.map(|_| Limit::AtMost(limit)),
            ..Finding::new(self.code, self.outcome, &*self.name, &*self.sentence)
        }
    }

    /// One that says nothing yet.
    fn unknown(code: &'static str, name: String, unit: &'static str, limits: [f64; 2]) -> Self {
        Self {
            name,
            code,
            outcome: Verdict::Unknown,
            value: None,
            sigma: None,
            limits,
            unit,
            sentence: String::new(),
        }
    }
}

#[cfg(test)]
mod tests;
