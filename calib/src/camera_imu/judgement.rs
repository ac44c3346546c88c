//! What was looked at in a camera–IMU calibration, and how it came out.

use lsfb_report::{rounded, with_unit};
use lsfb_types::{Finding, Judgement, Limit, Verdict};

use super::board_size::BoardExcess;
use super::state::RigEstimate;
use super::{
    Axes, CameraImuCalibration, CameraImuConfig, CameraOnImu, ORDER, SplitEstimate, checks,
};
use crate::board::Target;
use crate::camera::Estimate;
use crate::findings;
use crate::residual_diagnosis::Diagnosis;

/// Standard deviations beyond which a delay of the accelerometer is none of chance.
const CLEAR_DELAY: f64 = 4.0;
/// Largest delay between the triads that filters explain, seconds.
const WORRYING_DELAY_S: f64 = 0.01;
/// Share of what is said beforehand of a scale that the recording must leave of it, to have had a say.
const TOLD_AXES: f64 = 0.5;
/// Errors of the IMU's axes, as a share or rad, that those who take them as ideal should know of.
const WORRYING_AXES: f64 = 4e-3;
/// Residual of the IMU, as a multiple of its noise, above which something is wrong with it.
const WORRYING_RATIO: f64 = 5.0;
/// Coverage below which a warning is due.
const LEAST_COVERAGE: f64 = 0.4;
/// Height of a corner out of the board's plane above which a warning is due, metres.
const WORRYING_BEND_M: f64 = 5e-4;
/// Standard deviations of position and clock above which a warning is due: metres and seconds.
const WORRYING_POSITION_M: f64 = 0.002;
const WORRYING_CLOCK_S: f64 = 0.0005;
/// Offset of a clock that one which is synchronised does not have, seconds.
const WORRYING_OFFSET_S: f64 = 0.025;
/// Drift of a clock that is worth a word: seconds per second, and over the recording.
const WORRYING_DRIFT: f64 = 1e-5;
const WORRYING_DRIFT_S: f64 = 1e-4;
/// Errors of the board's size as a share: what is worth a word, what spoils every distance, what is too uncertain to say.
const WORRYING_SIZE: f64 = 0.005;
const FAILED_SIZE: f64 = 0.02;
const UNKNOWN_SIZE: f64 = 0.01;
/// Standard deviations beyond which a finding is none of chance.
const DEVIATIONS: f64 = 4.0;
/// Jitter of the IMU's stamps that is worth a word, seconds.
const WORRYING_JITTER_S: f64 = 2e-4;
/// Times by which the axis least moved about falls behind the one most moved about when it gets the blame.
pub(super) const POOR_AXIS: f64 = 4.0;

impl CameraImuCalibration {
    /// Whether the result may be used, and how far.
    pub fn judgement(&self) -> Judgement {
        Judgement::new(self.findings.clone())
    }
}

/// What is said of the board's size; of none where something else is wrong as well, which takes what it can of that.
pub(super) fn size(target: &Target, excess: &BoardExcess, is_measured: bool) -> Finding {
    let percent = 100.0 * excess.share;
    let finding = |verdict, what: String, limit: f64| {
        Finding::new("board-size", verdict, "board", what)
            .value(percent, "%")
            .sigma(100.0 * excess.sigma)
            .limit(Limit::AtMost(100.0 * limit))
    };
    if !is_measured {
        let what = "board size not checked: the reprojection error has another cause".to_owned();
        return Finding::new("board-size", Verdict::Unknown, "board", what);
    }
    let (size, chance) = (excess.share.abs(), DEVIATIONS * excess.sigma);
    if size > WORRYING_SIZE.max(chance) {
        let is_failed = size > FAILED_SIZE.max(chance);
        let what = format!(
            "according to the accelerometer, the board is {:.1} ± {:.2} % {} than specified: {}",
            percent.abs(),
            excess.sigma * 100.0,
            if percent > 0.0 { "larger" } else { "smaller" },
            target.scaled_words(1.0 + excess.share)
        );
        let limit = if is_failed {
            FAILED_SIZE
        } else {
            WORRYING_SIZE
        };
        return finding(
            Verdict::Fail.unless(!is_failed).max(Verdict::Warn),
            what,
            limit,
        )
        .remedy("measure it and correct the target");
    }
    if excess.sigma > UNKNOWN_SIZE {
        let what = format!(
            "board size not checked (± {:.0} %): the rig hardly moves",
            excess.sigma * 100.0
        );
        return finding(Verdict::Warn, what, WORRYING_SIZE)
            .remedy("also move the rig by 20 cm along all axes");
    }
    let what = format!(
        "the board size is as specified (± {:.2} %)",
        100.0 * excess.sigma
    );
    finding(Verdict::Pass, what, WORRYING_SIZE)
}

/// How far the board's corners lie out of its plane.
pub(super) fn bend(bend_m: f64, sigma_m: f64) -> Finding {
    let (mm, limit) = (bend_m * 1e3, Limit::AtMost(WORRYING_BEND_M * 1e3));
    let what = format!(
        "its corners lie up to {mm:.1} ± {:.1} mm out of its plane; the calibration accounts for that",
        sigma_m * 1e3
    );
    Finding::new("board-bend", Verdict::Warn, "board", what)
        .judged(mm, "mm", limit)
        .sigma(sigma_m * 1e3)
        .remedy("glue it to a stiff plate: `lsfb calib camera` assumes a flat board")
}

/// Whether the two halves of the recording agree; `None` where one of them does not tell.
pub(super) fn halves(halves: &[SplitEstimate]) -> Option<Finding> {
    let farthest = halves
        .iter()
        .max_by(|a, b| a.deviations().total_cmp(&b.deviations()))?;
    let deviations = farthest.deviations();
    let limit = Limit::AtMost(DEVIATIONS);
    let (factor, unit) = shown_in(&farthest.name);
    let [difference, sigma] = farthest.difference().map(|v| v * factor);
    let apart = format!("{} ± {}", rounded(difference), rounded(sigma));
    let what = format!(
        "the two halves of the recording, calibrated separately, differ most in {}: by {}, {deviations:.1} standard deviations",
        farthest.name,
        with_unit(&apart, unit),
    );
    let finding =
        Finding::new("halves", Verdict::Warn, "recording", what).judged(deviations, "σ", limit);
    Some(finding.remedy(
        "check that no mount moved and no clock jumped in between, and record again: the standard deviations are too small for this difference",
    ))
}

/// An accelerometer that measures later than the gyroscope, where that is clear: a filter's delay is taken off, more than filters
/// have is a fault of stamps.
pub(super) fn accel_delay(delay_s: f64, sigma_s: f64) -> Option<Finding> {
    if delay_s.abs() <= CLEAR_DELAY * sigma_s {
        return None;
    }
    let [delay_ms, sigma_ms] = [delay_s, sigma_s].map(|s| s * 1e3);
    let what = format!(
        "it measures {:.2} ± {sigma_ms:.2} ms {} the gyroscope; everything else is estimated with that delay",
        delay_ms.abs(),
        if delay_ms > 0.0 { "after" } else { "before" }
    );
    let limit = Limit::AtMost(WORRYING_DELAY_S * 1e3);
    let verdict = Verdict::Warn.unless(limit.holds(delay_ms.abs()));
    let finding = Finding::new("accelerometer-delay", verdict, "accelerometer", what);
    Some(finding.value(delay_ms, "ms").limit(limit).remedy(
        "use one clock for the stamps of both sensors of the IMU: filtering alone does not delay one that much relative to the other",
    ))
}

/// By what a number of that name is multiplied where it is shown, and its unit then.
pub(super) fn shown_in(name: &str) -> (f64, &'static str) {
    let mut words = name.split(' ');
    match (
        words.next().unwrap_or_default(),
        words.next().unwrap_or_default(),
    ) {
        (_, "turn") => (1f64.to_degrees(), "°"),
        (_, "shift") => (1e3, "mm"),
        (_, "clock" | "readout" | "delay") => (1e3, "ms"),
        (_, "drift") => (1e6, "ppm"),
        (_, "fx" | "fy" | "cx" | "cy") => (1.0, "px"),
        _ => (1.0, ""),
    }
}

impl RigEstimate {
    /// What is said of motion, IMU and board: `ratios` of the residuals of gyroscope and accelerometer to their stated noise, and the
    /// jitter of the IMU's stamps, seconds.
    pub(super) fn motion_findings(
        &self,
        target: &Target,
        ratios: [f64; 2],
        jitter_s: f64,
    ) -> Vec<Finding> {
        let mut found = self.findings.clone();
        found.extend(checks::upside_down(target, &self.gravity));
        found.push(self.excitation());
        let jitter_ms = jitter_s * 1e3;
        let limit = Limit::AtMost(WORRYING_JITTER_S * 1e3);
        if !limit.holds(jitter_ms) {
            let what = format!(
                "IMU stamps jitter by {jitter_ms:.1} ms rms: the faster the rotation changes, the larger the error of the gyroscope"
            );
            let jitter = Finding::new("imu-stamps", Verdict::Warn, "IMU", what);
            found.push(
                jitter
                    .value(jitter_ms, "ms")
                    .limit(limit)
                    .remedy("stamp samples when they are measured, not when they arrive"),
            );
        }
        for (name, ratio) in ["gyroscope", "accelerometer"].iter().zip(ratios) {
            let limit = Limit::AtMost(WORRYING_RATIO);
            let what = format!("its residual is {ratio:.1} times its specified noise");
            let fit = Finding::new("imu-fit", Verdict::Warn, *name, what);
            found.push(fit.judged(ratio, "", limit).remedy(
                "measure its noise (`lsfb calib imu-noise`), and check that it is firmly mounted and that no clock jumps",
            ));
        }
        found
    }

    /// What is said of one camera; `spread_px` is what the gyroscope leaves of views that were held back.
    pub(super) fn camera_findings(
        &self,
        target: &Target,
        k: usize,
        c: &CameraOnImu,
        spread_px: f64,
    ) -> Vec<Finding> {
        let name = &c.name;
        let (stamps, seen): (Vec<String>, Vec<_>) = self.seen_with_stamps(k).unzip();
        let diagnosis = Diagnosis::new(target, &c.camera, seen);
        let mut found = Vec::from_iter(diagnosis.another_lens(name, &stamps));
        found.push(diagnosis.finding(name, c.rms_px));
        found.extend(diagnosis.another_gap(name, c.rms_px));
        found.push(findings::coverage(name, &c.cells, LEAST_COVERAGE));
        found.push(findings::outliers(name, c.outliers, c.corners + c.outliers));
        if let Some(holdout_px) = c.holdout_rms_px {
            let most_px = 1.5 * c.rms_px.hypot(spread_px) + 0.05;
            found.push(findings::holdout(name, holdout_px, c.rms_px, most_px));
        }
        let worst_mm = c.position_sigma_m.iter().copied().fold(0.0, f64::max) * 1e3;
        let limit = Limit::AtMost(WORRYING_POSITION_M * 1e3);
        let what = format!("position on the IMU: standard deviation {worst_mm:.1} mm");
        let place = Finding::new("position-sigma", Verdict::Warn, name, what);
        found.push(place.judged(worst_mm, "mm", limit).remedy(self.advice()));
        found.push(clock_sigma(c));
        found.extend(clock_offset(c));
        found.extend(self.clock_drift(c));
        found
    }

    fn clock_drift(&self, c: &CameraOnImu) -> Option<Finding> {
        let drift = c.clock_drift.abs();
        let knots = self.motion.knots;
        let drifted_s = drift * (knots.end_s::<ORDER>(self.motion.rotations.len()) - knots.start_s);
        let is_clear = drift > WORRYING_DRIFT.max(DEVIATIONS * c.clock_drift_sigma);
        if !is_clear || drifted_s <= WORRYING_DRIFT_S {
            return None;
        }
        let what = format!(
            "its clock runs {:.0} ± {:.0} ppm {} than the IMU's, {:.1} ms over this recording: the offset holds only in the middle of it",
            drift * 1e6,
            c.clock_drift_sigma * 1e6,
            if c.clock_drift > 0.0 {
                "slower"
            } else {
                "faster"
            },
            drifted_s * 1e3
        );
        let finding = Finding::new("clock-drift", Verdict::Warn, &*c.name, what)
            .value(drift * 1e6, "ppm")
            .sigma(c.clock_drift_sigma * 1e6)
            .limit(Limit::AtMost(WORRYING_DRIFT * 1e6));
        Some(finding.remedy("synchronise the clocks; `lsfb clock` compares them"))
    }

    /// What would help most, in words.
    fn advice(&self) -> &'static str {
        match self.excitation().verdict {
            Verdict::Warn => "see which axis it hardly rotates about",
            _ => "rotate faster about all axes, or record longer",
        }
    }

    /// Whether an axis is turned about far less than the others.
    fn excitation(&self) -> Finding {
        let weakest = self.rate_rms.imin();
        let (least, most) = (self.rate_rms[weakest], self.rate_rms.max());
        let axis = ["x", "y", "z"][weakest];
        let limit = Limit::AtLeast(most / POOR_AXIS);
        let verdict = Verdict::Warn.unless(limit.holds(least));
        let what = if verdict == Verdict::Pass {
            format!("rotation of at least {least:.2} rad/s rms about each axis; least about {axis}")
        } else {
            format!(
                "hardly any rotation about {axis} ({least:.2} rad/s rms, {most:.2} about another axis)"
            )
        };
        Finding::new("motion", verdict, "motion", what)
            .value(least, "rad/s")
            .limit(limit)
            .remedy(format!("rotate more about {axis}"))
    }
}

/// Whether the IMU's axes are what is said of them: those who use it take them as ideal. Nothing where they were not searched.
pub(super) fn axes(found: &[Estimate], config: &CameraImuConfig) -> Option<Finding> {
    let finding = |verdict, what: String| Finding::new("imu-scale", verdict, "IMU", what);
    let is_clear = |axis: &&Estimate| axis.value.abs() >= DEVIATIONS * axis.sigma;
    let clear = found.iter().filter(is_clear);
    let clear = clear.max_by(|a, b| a.value.abs().total_cmp(&b.value.abs()));
    let is_scale = |axis: &&Estimate| ["xx", "yy", "zz"].iter().any(|of| axis.name.ends_with(of));
    let scales = found.iter().filter(is_scale);
    let least_known = scales.max_by(|a, b| a.sigma.total_cmp(&b.sigma))?;
    let is_worrying = clear.is_some_and(|axis| axis.value.abs() > WORRYING_AXES);
    // An IMU that is worse than said, and a motion that does not show it, would look like a good one.
    if !is_worrying && least_known.sigma > TOLD_AXES * config.axes_sigma {
        let what = format!(
            "this motion does not determine its scale and axes ({} ± {:.2} %); they are assumed to be within {:.2} % of ideal (axes_sigma)",
            least_known.name,
            100.0 * least_known.sigma,
            100.0 * config.axes_sigma
        );
        let finding = finding(Verdict::Unknown, what);
        return Some(finding.remedy("rotate faster about all axes, or record longer"));
    }
    let Some(worst) = clear else {
        let what = "no significant error of scale or axes".to_owned();
        return Some(finding(Verdict::Pass, what));
    };
    let (percent, sigma) = (100.0 * worst.value.abs(), 100.0 * worst.sigma);
    let limit = Limit::AtMost(100.0 * WORRYING_AXES);
    let what = format!(
        "scale and axes are off by up to {percent:.2} ± {sigma:.2} % ({})",
        worst.name
    );
    // The prior has pulled at it where the IMU is worse than that says.
    let is_said = config.axes == Axes::Estimated || worst.value.abs() <= 4.0 * config.axes_sigma;
    let remedy = match is_said {
        true => "calibrate the IMU itself: everything that uses the rig assumes ideal axes",
        false => "set axes = \"estimated\", or set axes_sigma to the value in the IMU's data sheet",
    };
    let finding = finding(Verdict::Warn, what)
        .judged(percent, "%", limit)
        .sigma(sigma);
    Some(finding.remedy(remedy))
}

fn clock_sigma(c: &CameraOnImu) -> Finding {
    let sigma_ms = c.rig_from_camera_sigma_s * 1e3;
    let limit = Limit::AtMost(WORRYING_CLOCK_S * 1e3);
    let what = format!("time offset: standard deviation {sigma_ms:.2} ms");
    Finding::new("clock-sigma", Verdict::Warn, &*c.name, what)
        .judged(sigma_ms, "ms", limit)
        .remedy("move faster")
}

fn clock_offset(c: &CameraOnImu) -> Option<Finding> {
    let offset_ms = c.rig_from_camera_s * 1e3;
    let limit = Limit::AtMost(WORRYING_OFFSET_S * 1e3);
    if limit.holds(offset_ms.abs()) {
        return None;
    }
    let what = format!(
        "its stamps are {:.1} ms {} relative to the IMU's; the rig accounts for that (rig_from_camera_s), but clocks that far apart are not synchronised, and the offset may be different next time",
        offset_ms.abs(),
        if offset_ms > 0.0 { "early" } else { "late" }
    );
    let finding = Finding::new("clock-offset", Verdict::Warn, &*c.name, what)
        .value(offset_ms, "ms")
        .sigma(c.rig_from_camera_sigma_s * 1e3)
        .limit(limit);
    Some(finding.remedy("check the clocks with `lsfb clock`"))
}
