//! Whether what was planned or measured can be true: numbers that were typed wrongly, clocks that jump, recordings cut short.

use lsfb_types::{Finding, Limit, Verdict};

use super::motion::MotionFigures;
use super::plan::{DatasetPlan, Gait};
use super::sequence::SequenceFigures;

/// Share by which recorded images and path may differ from those planned.
const OFF_PLAN: [f64; 2] = [0.02, 0.10];
/// Share by which the rate of images may differ from that planned.
const OFF_RATE: f64 = 0.02;
/// Longest time without an image, or without a true pose, seconds.
const LONGEST_GAP_S: f64 = 0.5;
/// Nobody turns faster who holds a device, degrees per second.
const FASTEST_TURN_DEG_S: f64 = 500.0;
/// More blur leaves no corner to be found, pixels.
const MOST_BLUR_PX: f64 = 12.0;

/// Mean and top speed that are believed of a gait, m/s.
struct Speeds {
    mean_m_s: [f64; 2],
    top_m_s: f64,
}

impl Speeds {
    fn of(gait: Gait) -> Self {
        let (mean_m_s, top_m_s) = match gait {
            Gait::Stand => ([0.0, 0.4], 1.5),
            Gait::Walk => ([0.2, 2.0], 3.0),
            Gait::Run => ([1.2, 6.0], 10.0),
        };
        Self { mean_m_s, top_m_s }
    }
}

/// Judges a plan by its own numbers.
pub fn judge_planned(plan: &DatasetPlan) -> Vec<Finding> {
    let rate_hz = plan.rate_hz;
    if !(rate_hz > 0.0 && rate_hz.is_finite()) {
        let what = format!("{rate_hz} images per second");
        return vec![Finding::new("rate", Verdict::Fail, "plan", what)];
    }
    let mut findings = Vec::new();
    for planned in plan.sequences() {
        let motion = planned.motion;
        let mean_m_s = planned.length_m / planned.duration_s;
        let what = format!(
            "{} m in {:.0} s: {mean_m_s:.2} m/s on average",
            planned.length_m, planned.duration_s
        );
        findings.push(mean_speed(&planned.name, motion.gait, mean_m_s, &what));
        if !plan
            .environments
            .iter()
            .any(|e| e.name == motion.environment)
        {
            let what = format!("no environment is called {}", motion.environment);
            findings.push(Finding::new(
                "environment",
                Verdict::Fail,
                &planned.name,
                what,
            ));
        }
    }
    findings
}

/// Judges what was measured of a sequence against its plan and what people and cameras do.
pub fn judge_measured(measured: &SequenceFigures, rate_hz: f64) -> Vec<Finding> {
    let name = measured.planned.name.as_str();
    let mut findings = images(measured, rate_hz);
    match &measured.motion {
        Some(motion) => findings.extend(motions(measured, motion)),
        None => findings.push(
            Finding::new(
                "motion",
                Verdict::Unknown,
                name,
                "without its truth, the motion is unknown",
            )
            .remedy("put the folder truth beside the recordings"),
        ),
    }
    if let Some([_, most_px]) = measured.blur_px {
        let limit = Limit::AtMost(MOST_BLUR_PX);
        let what = format!("95 % of the images are blurred by at most {most_px:.1} px");
        findings.push(Finding::new("blur", Verdict::Warn, name, what).judged(most_px, "px", limit));
    }
    findings
}

fn images(measured: &SequenceFigures, rate_hz: f64) -> Vec<Finding> {
    let planned = &measured.planned;
    let name = planned.name.as_str();
    let mut findings = Vec::new();
    let [off_frames, _] = OFF_PLAN;
    if measured.images.cameras.is_empty() {
        findings.push(Finding::new("images", Verdict::Fail, name, "has no images"));
    }
    if measured.inertial_samples == 0 {
        findings.push(Finding::new(
            "imu",
            Verdict::Fail,
            name,
            "has no IMU samples",
        ));
    }
    for camera in &measured.images.cameras {
        let subject = format!("{name} {}", camera.topic);
        let off = (camera.frames as f64 / f64::from(planned.frames.max(1)) - 1.0).abs();
        let what = format!("{} images, {} planned", camera.frames, planned.frames);
        let limit = Limit::AtMost(100.0 * off_frames);
        findings.push(
            Finding::new("frames", Verdict::Fail, &subject, what).judged(100.0 * off, "%", limit),
        );
        let off = (camera.rate_hz / rate_hz - 1.0).abs();
        let what = format!("{:.2} images per second, {rate_hz} planned", camera.rate_hz);
        let limit = Limit::AtMost(100.0 * OFF_RATE);
        findings.push(Finding::new("rate", Verdict::Fail, &subject, what).judged(
            100.0 * off,
            "%",
            limit,
        ));
        let back = camera.not_rising as f64;
        let what = match camera.not_rising {
            0 => "stamps increase from image to image".to_owned(),
            1 => "one stamp is not later than the previous one".to_owned(),
            n => format!("{n} stamps are not later than the previous ones"),
        };
        let rise = Finding::new("stamps", Verdict::Fail, &subject, what).judged(
            back,
            "",
            Limit::AtMost(0.0),
        );
        findings.push(rise.remedy("check what sets the camera's clock with `lsfb clock`"));
        let gap_s = camera.longest_gap_s;
        let what = format!("{} gaps, the longest {gap_s:.2} s", camera.gaps);
        let limit = Limit::AtMost(LONGEST_GAP_S);
        findings.push(Finding::new("gap", Verdict::Warn, &subject, what).judged(gap_s, "s", limit));
    }
    findings
}

fn motions(measured: &SequenceFigures, motion: &MotionFigures) -> Vec<Finding> {
    let planned = &measured.planned;
    let name = planned.name.as_str();
    let what = format!(
        "{:.1} m in {:.1} s: {:.2} m/s on average",
        motion.length_m, motion.duration_s, motion.mean_speed_m_s
    );
    let mut findings = vec![mean_speed(name, planned.gait, motion.mean_speed_m_s, &what)];
    let top_m_s = motion.top_speed_m_s;
    let limit = Limit::AtMost(Speeds::of(planned.gait).top_m_s);
    let what = format!("{top_m_s:.2} m/s over half a second");
    findings
        .push(Finding::new("top-speed", Verdict::Fail, name, what).judged(top_m_s, "m/s", limit));
    let [_, _, turning_deg_s] = motion.turning_deg_s;
    let limit = Limit::AtMost(FASTEST_TURN_DEG_S);
    let what = format!("rotates at up to {turning_deg_s:.0} °/s");
    findings.push(Finding::new("turning", Verdict::Fail, name, what).judged(
        turning_deg_s,
        "°/s",
        limit,
    ));
    let gap_s = motion.longest_gap_s;
    let limit = Limit::AtMost(LONGEST_GAP_S);
    let what = format!("gaps between true poses are up to {gap_s:.2} s");
    findings.push(Finding::new("truth-gap", Verdict::Warn, name, what).judged(gap_s, "s", limit));
    let [_, off_length] = OFF_PLAN;
    let off = (motion.length_m / planned.length_m - 1.0).abs();
    let what = format!(
        "{:.1} m long, {:.1} planned",
        motion.length_m, planned.length_m
    );
    let limit = Limit::AtMost(100.0 * off_length);
    findings.push(Finding::new("length", Verdict::Warn, name, what).judged(
        100.0 * off,
        "%",
        limit,
    ));
    let is_as_planned =
        motion.gait == planned.gait && motion.gaze.is_none_or(|g| g == planned.gaze);
    if motion.gaze.is_some() {
        let [gait, gaze] = [motion.gait.to_string(), shown(motion.gaze)];
        let what = format!(
            "{gait}, {gaze}; planned: {}, {}",
            planned.gait, planned.gaze
        );
        findings.push(Finding::new(
            "class",
            Verdict::Warn.unless(is_as_planned),
            name,
            what,
        ));
    }
    findings
}

fn shown(gaze: Option<super::plan::Gaze>) -> String {
    gaze.map_or_else(|| "no class".to_owned(), |gaze| gaze.to_string())
}

/// A mean speed that nobody of this gait has is a number typed wrongly, or a clock that is wrong.
fn mean_speed(name: &str, gait: Gait, mean_m_s: f64, what: &str) -> Finding {
    let [least, most] = Speeds::of(gait).mean_m_s;
    let limit = match mean_m_s < least {
        true => Limit::AtLeast(least),
        false => Limit::AtMost(most),
    };
    Finding::new("mean-speed", Verdict::Fail, name, what)
        .judged(mean_m_s, "m/s", limit)
        .remedy("check the length, the number of images and the stamps")
}
