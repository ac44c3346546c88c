//! What no IMU at rest measures: another gravity, one that turns around, axes that are dead or copies, samples that are repeated. The Allan
//! variance of such samples is a curve like any other; of an axis that always says zero it is zero, and its standard deviation too.

use lsfb_geometry::Vector3;
use lsfb_types::{Finding, Limit, STANDARD_GRAVITY_M_S2, Verdict};

use super::rest::Log;

/// Share by which an accelerometer's gravity may be off: scale errors of raw ones are below 3 %.
const GRAVITY_SHARE: f64 = 0.05;
/// By how much a tenth of the recording may differ from all of it, m/s²: three degrees of tilt. Biases wander by a tenth of that.
const GRAVITY_MOVES_M_S2: f64 = 0.5;
const PARTS: usize = 10;
/// Density above which a gyroscope does not count in radians, rad/s/√Hz: phones' have 1e-4 to 1e-3, in degrees 6e-3 and more.
const NOISY_GYRO: f64 = 4e-3;
/// Share of samples that may be the one before: to be warned of, and to fail.
const REPEATED: [f64; 2] = [0.01, 0.2];
const NAMES: [&str; 6] = [
    "gyro x", "gyro y", "gyro z", "accel x", "accel y", "accel z",
];

/// All of them; `gyro_density` is what was found, rad/s/√Hz.
pub(super) fn findings(log: &Log, gyro_density: f64) -> Vec<Finding> {
    let mut found = vec![gravity(log), gravity_moves(log), repeated(log)];
    found.extend(dead_and_copied(log));
    found.push(gyro_unit(gyro_density));
    found
}

/// Mean specific force over a part of the recording.
fn mean_force(log: &Log, part: std::ops::Range<usize>) -> Vector3<f64> {
    let count = part.len().max(1) as f64;
    Vector3::from_fn(|k, _| log.axes[3 + k][part.clone()].iter().sum::<f64>() / count)
}

fn gravity(log: &Log) -> Finding {
    let found = mean_force(log, 0..log.axes[0].len()).norm();
    let is = |unit: f64| (found * unit / STANDARD_GRAVITY_M_S2 - 1.0).abs() <= GRAVITY_SHARE;
    let cause = match (is(STANDARD_GRAVITY_M_S2), is(1e-3 * STANDARD_GRAVITY_M_S2)) {
        (true, _) => ": it is in units of g",
        (_, true) => ": it is in thousandths of g",
        _ => ": check its unit, and that gravity was not subtracted",
    };
    let what = format!(
        "it measures {found:.3} m/s² at rest{}",
        if is(1.0) { "" } else { cause }
    );
    Finding::new(
        "gravity",
        Verdict::Fail.unless(is(1.0)),
        "accelerometer",
        what,
    )
    .value(found, "m/s²")
    .remedy("convert to m/s²; noise and random walk are wrong by the same factor")
}

fn gravity_moves(log: &Log) -> Finding {
    let samples = log.axes[0].len();
    let all = mean_force(log, 0..samples);
    let part = |k: usize| k * samples / PARTS..(k + 1) * samples / PARTS;
    let off = |k: &usize| (mean_force(log, part(*k)) - all).norm();
    let (moved, part) = (0..PARTS)
        .map(|k| (off(&k), k))
        .max_by(|a, b| a.0.total_cmp(&b.0))
        .unwrap_or_default();
    let limit = Limit::AtMost(GRAVITY_MOVES_M_S2);
    let after_s = log.duration_s * part as f64 / PARTS as f64;
    let what = match limit.holds(moved) {
        true => "the direction of gravity is constant".to_owned(),
        false => format!(
            "{after_s:.0} s after the start, gravity differs by {moved:.2} m/s² from its mean over the recording: the IMU was turned, or its signs changed"
        ),
    };
    Finding::new("rest", Verdict::Fail, "accelerometer", what)
        .judged(moved, "m/s²", limit)
        .remedy("record again, with the IMU at rest the whole time")
}

fn repeated(log: &Log) -> Finding {
    let samples = log.axes[0].len();
    let is_repeated = |k: &usize| log.axes.iter().all(|axis| axis[*k] == axis[k - 1]);
    let repeated = (1..samples).filter(is_repeated).count();
    let share = repeated as f64 / samples.max(1) as f64;
    let [warn, fail] = REPEATED;
    let verdict = match share {
        s if s > fail => Verdict::Fail,
        s if s > warn => Verdict::Warn,
        _ => Verdict::Pass,
    };
    let what = format!("{repeated} of {samples} samples repeat the previous one in all six axes");
    Finding::new("repeated", verdict, "samples", what)
        .value(100.0 * share, "%")
        .limit(Limit::AtMost(100.0 * warn))
        .remedy("record at the IMU's measuring rate: repeated samples make the noise look smaller than it is")
}

/// Axes that always say the same, and axes that say what another one does.
fn dead_and_copied(log: &Log) -> Vec<Finding> {
    let fail = |axis: usize, what: String| {
        Finding::new("axis", Verdict::Fail, NAMES[axis], what)
            .remedy("check how its values are read and recorded")
    };
    let is_dead = |axis: &usize| {
        let values = &log.axes[*axis];
        values.iter().all(|v| Some(v) == values.first())
    };
    let mut found = Vec::new();
    for axis in 0..NAMES.len() {
        if is_dead(&axis) {
            let value = log.axes[axis].first().copied().unwrap_or_default();
            found.push(fail(
                axis,
                format!("constant value {value} in every sample"),
            ));
            continue;
        }
        let triad = axis / 3 * 3;
        let copied = (triad..axis).find(|other| log.axes[*other] == log.axes[axis]);
        if let Some(other) = copied {
            let what = format!("identical to {} in every sample", NAMES[other]);
            found.push(fail(axis, what));
        }
    }
    found
}

fn gyro_unit(density: f64) -> Finding {
    let limit = Limit::AtMost(NOISY_GYRO);
    let what = match limit.holds(density) {
        true => "noise is plausible for a gyroscope".to_owned(),
        false => {
            "noise is implausibly high for a gyroscope: is the unit degrees per second?".to_owned()
        }
    };
    Finding::new("gyro-unit", Verdict::Warn, "gyroscope", what)
        .judged(density, "rad/s/√Hz", limit)
        .remedy("give rad/s")
}
