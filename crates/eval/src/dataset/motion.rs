//! What a trajectory says of how somebody moved and looked.

use lsfb_geometry::{StampedPose, Vector3};
use serde::Serialize;

use super::plan::{Gait, Gaze};

/// Poses are taken this far apart, seconds: what lies between is the noise of their estimate, and adds to no path.
const STEP_S: f64 = 1.0 / 30.0;
/// Time over which a speed is measured, seconds: a step of a walk.
const SPEED_OVER_S: f64 = 0.5;
/// Time over which turning is measured, seconds.
const TURN_OVER_S: f64 = 0.1;
/// Time over which parallax is measured, seconds.
const PARALLAX_OVER_S: f64 = 1.0;
/// Distance of what is looked at, for parallax, metres.
const PARALLAX_AT_M: f64 = 5.0;
/// Across a gap this many times as long as what is measured over, nothing is measured.
const LONGEST: f64 = 1.5;
/// Slower than this nobody goes anywhere, m/s.
const GOING_M_S: f64 = 0.25;
/// Mean speed below which one stands, m/s.
const STANDS_BELOW_M_S: f64 = 0.35;
/// Mean speed above which one runs, m/s.
const RUNS_ABOVE_M_S: f64 = 1.7;
/// Angle between heading and view below which one looks ahead, degrees.
const AHEAD_BELOW_DEG: f64 = 20.0;
/// The same between which one looks sideways, degrees.
const SIDEWAYS_DEG: [f64; 2] = [60.0, 120.0];
/// Turning, 95 %, above which one looks around fast, degrees per second.
const FAST_ABOVE_DEG_S: f64 = 80.0;
/// Shorter motions have no class, seconds.
const CLASS_NEEDS_S: f64 = 30.0;

/// What was measured of a motion. The world's z points upwards.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MotionFigures {
    /// From the first pose to the last, seconds.
    pub duration_s: f64,
    /// Length of the path, metres.
    pub length_m: f64,
    /// Length by duration, m/s.
    pub mean_speed_m_s: f64,
    /// Largest speed over half a second, m/s.
    pub top_speed_m_s: f64,
    /// Angular rate over a tenth of a second: median, 95 % and largest, degrees per second.
    pub turning_deg_s: [f64; 3],
    /// Difference between the highest and the lowest place, metres.
    pub height_m: f64,
    /// Median angle by which something 5 m away is seen from elsewhere a second later, degrees.
    pub parallax_deg: f64,
    /// Median angle between where one goes and where one looks, degrees; absent where one goes nowhere.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub view_off_heading_deg: Option<f64>,
    /// Longest time without a pose, seconds.
    pub longest_gap_s: f64,
    /// How one moved.
    pub gait: Gait,
    /// Where one looked; absent below 30 s, and where no class fits.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub gaze: Option<Gaze>,
}

/// Measures poses in order of time; `view_in_rig` is where the cameras look. `None` where there are no two poses of different times.
pub fn motion_figures(poses: &[StampedPose], view_in_rig: &Vector3<f64>) -> Option<MotionFigures> {
    let (first, last) = (poses.first()?, poses.last()?);
    let duration_s = last.time.secs_since(first.time);
    if !(duration_s > 0.0) {
        return None;
    }
    let steps = thinned(poses);
    let pairs = steps.windows(2);
    let length_m: f64 = pairs.map(|w| travel(&w[0], &w[1]).norm()).sum();
    let mean_speed_m_s = length_m / duration_s;
    let speeds = over(&steps, SPEED_OVER_S, |a, b, s| {
        Some(travel(a, b).norm() / s)
    });
    let turning = sorted(over(&steps, TURN_OVER_S, |a, b, s| {
        let turned = a
            .world_from_rig
            .rotation
            .angle_to(&b.world_from_rig.rotation);
        Some(turned.to_degrees() / s)
    }));
    let off_heading = sorted(over(&steps, SPEED_OVER_S, |a, b, s| {
        off_heading_deg(a, b, s, view_in_rig)
    }));
    let parallax = sorted(over(&steps, PARALLAX_OVER_S, |a, b, _| {
        let view = (a.world_from_rig.rotation * view_in_rig).normalize();
        let across = travel(a, b) - view * view.dot(&travel(a, b));
        Some((across.norm() / PARALLAX_AT_M).atan().to_degrees())
    }));
    let heights = steps.iter().map(|p| p.world_from_rig.translation.z);
    let (low, high) = heights.fold((f64::MAX, f64::MIN), |(l, h), z| (l.min(z), h.max(z)));
    let gaps = poses.windows(2).map(|w| w[1].time.secs_since(w[0].time));
    let turning_deg_s = [0.5, 0.95, 1.0].map(|share| at(&turning, share).unwrap_or(0.0));
    let view_off_heading_deg = at(&off_heading, 0.5);
    let gait = match mean_speed_m_s {
        speed if speed < STANDS_BELOW_M_S => Gait::Stand,
        speed if speed > RUNS_ABOVE_M_S => Gait::Run,
        _ => Gait::Walk,
    };
    let gaze = gaze(gait, view_off_heading_deg, turning_deg_s[1]);
    Some(MotionFigures {
        duration_s,
        length_m,
        mean_speed_m_s,
        top_speed_m_s: speeds.into_iter().fold(0.0, f64::max),
        turning_deg_s,
        height_m: high - low,
        parallax_deg: at(&parallax, 0.5).unwrap_or(0.0),
        view_off_heading_deg,
        longest_gap_s: gaps.fold(0.0, f64::max),
        gait,
        gaze: gaze.filter(|_| duration_s >= CLASS_NEEDS_S),
    })
}

fn gaze(gait: Gait, off_heading_deg: Option<f64>, turning_deg_s: f64) -> Option<Gaze> {
    let around = match turning_deg_s > FAST_ABOVE_DEG_S {
        true => Gaze::AroundFast,
        false => Gaze::Around,
    };
    let [from, to] = SIDEWAYS_DEG;
    match off_heading_deg {
        _ if gait == Gait::Stand => Some(Gaze::Around),
        Some(off) if off < AHEAD_BELOW_DEG => Some(Gaze::Ahead),
        Some(off) if off < from => Some(around),
        Some(off) if off <= to => Some(Gaze::Sideways),
        _ => None,
    }
}

/// Poses at least a step apart.
fn thinned(poses: &[StampedPose]) -> Vec<StampedPose> {
    let mut kept: Vec<StampedPose> = Vec::new();
    for pose in poses {
        // Of stamps that are a step apart but for their rounding none is lost.
        let is_next = |last: &StampedPose| pose.time.secs_since(last.time) > 0.99 * STEP_S;
        if kept.last().is_none_or(is_next) {
            kept.push(*pose);
        }
    }
    kept
}

/// What `measure` says of each pose, the first that is so many seconds later, and the seconds between.
fn over(
    poses: &[StampedPose],
    secs: f64,
    measure: impl Fn(&StampedPose, &StampedPose, f64) -> Option<f64>,
) -> Vec<f64> {
    let mut later = 0;
    let mut found = Vec::new();
    for pose in poses {
        let apart_s = |p: &StampedPose| p.time.secs_since(pose.time);
        while poses.get(later).is_some_and(|p| apart_s(p) < 0.99 * secs) {
            later += 1;
        }
        let Some(other) = poses.get(later) else { break };
        if apart_s(other) <= LONGEST * secs {
            found.extend(measure(pose, other, apart_s(other)));
        }
    }
    found
}

fn travel(from: &StampedPose, to: &StampedPose) -> Vector3<f64> {
    to.world_from_rig.translation - from.world_from_rig.translation
}

/// Angle between heading and view, seen from above; `None` where one goes nowhere or looks straight up or down.
fn off_heading_deg(
    from: &StampedPose,
    to: &StampedPose,
    secs: f64,
    view_in_rig: &Vector3<f64>,
) -> Option<f64> {
    let flat = |v: Vector3<f64>| Vector3::new(v.x, v.y, 0.0);
    let heading = flat(travel(from, to));
    let view = flat(from.world_from_rig.rotation * view_in_rig);
    let is_clear = heading.norm() > GOING_M_S * secs && view.norm() > 0.1 * view_in_rig.norm();
    is_clear.then(|| heading.angle(&view).to_degrees())
}

fn sorted(mut values: Vec<f64>) -> Vec<f64> {
    values.sort_by(f64::total_cmp);
    values
}

fn at(sorted: &[f64], share: f64) -> Option<f64> {
    let last = sorted.len().checked_sub(1)?;
    sorted.get((share * last as f64).round() as usize).copied()
}
