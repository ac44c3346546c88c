//! Single images of a walk against a map and the truth, and how far its trajectory is off from image to image.

use lsfb_geometry::{Se3, StampedPose, Trajectory, Vector3, so3};
use lsfb_pipeline::features::{FrameFeatures, SiftConfig, SiftDetector};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::localization::{Localizer, LocalizerConfig};
use lsfb_recording::Recording;
use lsfb_types::{Image, Progress, Timestamp, median};
use rayon::prelude::*;

use super::in_view::MapInView;
use super::result::WRONG_M;
use super::trial::Condition;
use crate::context::Context;
use crate::twin_truth::ate_rms_m;

/// Instants that are localized on their own, spread over the walk.
const INSTANTS: usize = 40;
/// A rotation that is further off is wrong, degrees.
const WRONG_DEG: f64 = 5.0;
/// Images of one instant are no further apart, nanoseconds.
const SAME_INSTANT_NS: i64 = 1_000_000;

/// Instants that were looked at.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Localized {
    /// Share with a pose.
    pub claimed: f64,
    /// Share with a pose that is right.
    pub right: f64,
    /// Error of the right ones after an alignment of their own, rms.
    pub ate_rms_m: Option<f64>,
    /// Share at which the map is in view, and these.
    pub map_in_view: f64,
    pub in_view: Vec<Timestamp>,
}

/// Error of the way from one image to the next, rms.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BetweenFrames {
    pub translation_m: f64,
    pub rotation_deg: f64,
}

/// Two poses are of neighbouring images where they are no further apart than so many times the usual.
const LONGEST_STEP: f64 = 1.5;

/// Of each two poses of neighbouring images; `None` where there are none.
pub fn between_frames(solved: &Trajectory, truth: &Trajectory) -> Option<BetweenFrames> {
    let pairs = || solved.poses().windows(2);
    let usual_s = median(pairs().map(|w| w[1].time.secs_since(w[0].time)).collect())?;
    let (mut squares, mut count) = ([0.0; 2], 0u32);
    for w in pairs().filter(|w| w[1].time.secs_since(w[0].time) <= LONGEST_STEP * usual_s) {
        let (Some(from), Some(to)) = (truth.at(w[0].time), truth.at(w[1].time)) else {
            continue;
        };
        let true_step = from.inverse() * to;
        let step = w[0].world_from_rig.inverse() * w[1].world_from_rig;
        let error = true_step.inverse() * step;
        squares[0] += error.translation.norm_squared();
        squares[1] += so3::log(&error.rotation).norm_squared();
        count += 1;
    }
    let [translation_m, rotation_rad] = squares.map(|s| (s / f64::from(count)).sqrt());
    (count > 0).then_some(BetweenFrames {
        translation_m,
        rotation_deg: rotation_rad.to_degrees(),
    })
}

/// Poses that are no further from an instant are of it, seconds.
const AT_ONCE_SECS: f64 = 0.01;

/// Share of some instants at which a trajectory has a pose.
pub fn answered(solved: &Trajectory, instants: &[Timestamp]) -> f64 {
    let poses = solved.poses();
    let has_pose = |time: &&Timestamp| {
        let next = poses.partition_point(|p| p.time < **time);
        let around = poses[next.saturating_sub(1)..].iter().take(2);
        let mut apart = around.map(|p| p.time.secs_since(**time).abs());
        apart.any(|secs| secs <= AT_ONCE_SECS)
    };
    let count = instants.iter().filter(has_pose).count();
    count as f64 / instants.len().max(1) as f64
}

impl Localized {
    /// Of a walk after such a change of the place: wherever a pose is on the mapped floor, who walks on another one is not there.
    pub fn under(self, condition: Condition) -> Self {
        match condition {
            Condition::OtherFloor => Self {
                right: 0.0,
                ate_rms_m: None,
                ..self
            },
            _ => self,
        }
    }
}

/// Images taken at one instant, by the number of their camera.
type Instant = (Timestamp, Vec<(usize, Image)>);

/// Stretches of neighbouring images that are localized one by one, for their jitter, and images of each.
const STRETCHES: usize = 5;
const NEIGHBOURS: usize = 9;

/// Root mean square of the second difference of the errors of positions from image to image, metres: what is slower than images, and the walk's own
/// motion, are not in it.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Jitter {
    /// Of images that are localized one by one, where that is right; wrong ones would make it larger.
    pub localized_m: Option<f64>,
    /// Of the trajectory at the same images.
    pub solved_m: Option<f64>,
}

/// Compares the jitter of a trajectory with that of localization alone, at the same images.
pub fn jitter(
    walk: &Recording,
    map: &HdMap,
    truth: &Trajectory,
    truth_from_map: &Se3,
    solved: &Trajectory,
    context: &Context,
) -> anyhow::Result<Jitter> {
    let rig = walk.rig()?;
    let names: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    let times = stretches(&times_of_images(walk, &names)?);
    let chosen = instants(walk, &names, times)?;
    let localizer = Localizer::new(map, &LocalizerConfig::default())?;
    let detector = SiftDetector::new(&SiftConfig::default())?;
    let found: Vec<anyhow::Result<Option<Vector3<f64>>>> = chosen
        .par_iter()
        .map_init(
            || detector.clone(),
            |detector, (time, images)| {
                context.check_stop()?;
                let frames = features(detector, &names, images);
                let pose = localizer.localize(&frames, &rig).ok();
                let right = pose.filter(|pose| {
                    let at = truth.at(*time);
                    at.is_some_and(|at| is_right(&at, truth_from_map, &pose.world_from_rig))
                });
                let place = right.map(|p| *truth_from_map * p.world_from_rig);
                Ok(off(truth, *time, place))
            },
        )
        .collect();
    let localized: Vec<Option<Vector3<f64>>> = found.into_iter().collect::<Result<_, _>>()?;
    // Compared where both are known.
    let (of_localized, of_solved): (Vec<_>, Vec<_>) = chosen
        .iter()
        .zip(localized)
        .map(|((time, _), localized)| {
            let place = solved.at(*time).map(|pose| *truth_from_map * pose);
            localized.zip(off(truth, *time, place)).unzip()
        })
        .unzip();
    Ok(Jitter {
        localized_m: second_difference_rms_m(&of_localized),
        solved_m: second_difference_rms_m(&of_solved),
    })
}

/// Error of a place in the world of the truth.
fn off(truth: &Trajectory, time: Timestamp, pose: Option<Se3>) -> Option<Vector3<f64>> {
    Some(pose?.translation - truth.at(time)?.translation)
}

/// Over three neighbours of one stretch; `None` where there are no three.
fn second_difference_rms_m(errors: &[Option<Vector3<f64>>]) -> Option<f64> {
    let stretches = errors.chunks(NEIGHBOURS);
    let squares: Vec<f64> = stretches
        .flat_map(|stretch| stretch.windows(3))
        .filter_map(|w| Some((w[0]? - w[1]? * 2.0 + w[2]?).norm_squared()))
        .collect();
    let mean = squares.iter().sum::<f64>() / squares.len() as f64;
    (!squares.is_empty()).then(|| mean.sqrt())
}

/// Stretches of neighbours, spread over the walk; all of a walk that has no more.
fn stretches(all: &[Timestamp]) -> Vec<Timestamp> {
    let step = (all.len() / STRETCHES).max(NEIGHBOURS);
    let begins = all.chunks(step).take(STRETCHES);
    // A stretch that is cut off would not be told from the next.
    let whole = begins.filter_map(|chunk| chunk.get(..NEIGHBOURS));
    whole.flatten().copied().collect()
}

fn is_right(true_pose: &Se3, truth_from_map: &Se3, found: &Se3) -> bool {
    let off = true_pose.inverse() * *truth_from_map * *found;
    off.translation.norm() <= WRONG_M && off.rotation.angle().to_degrees() <= WRONG_DEG
}

fn features(
    detector: &mut SiftDetector,
    names: &[&str],
    images: &[(usize, Image)],
) -> Vec<FrameFeatures> {
    let of = images.iter().map(|(camera, image)| FrameFeatures {
        camera: names[*camera].to_owned(),
        features: detector.detect(image),
    });
    of.collect()
}

/// Localizes some instants of a walk on their own.
pub fn localize(
    walk: &Recording,
    map: &HdMap,
    truth: &Trajectory,
    truth_from_map: &Se3,
    context: &Context,
) -> anyhow::Result<Localized> {
    let rig = walk.rig()?;
    let names: Vec<&str> = rig.cameras.keys().map(String::as_str).collect();
    let chosen = some_instants(walk, &names)?;
    let localizer = Localizer::new(map, &LocalizerConfig::default())?;
    let detector = SiftDetector::new(&SiftConfig::default())?;
    let found: Vec<anyhow::Result<Option<(StampedPose, bool)>>> = chosen
        .par_iter()
        .map_init(
            || detector.clone(),
            |detector, (time, images)| {
                context.check_stop()?;
                let frames = features(detector, &names, images);
                let Ok(pose) = localizer.localize(&frames, &rig) else {
                    return Ok(None);
                };
                let right = truth
                    .at(*time)
                    .is_some_and(|at| is_right(&at, truth_from_map, &pose.world_from_rig));
                let pose = StampedPose {
                    time: *time,
                    world_from_rig: pose.world_from_rig,
                };
                Ok(Some((pose, right)))
            },
        )
        .collect();
    let found: Vec<Option<(StampedPose, bool)>> = found.into_iter().collect::<Result<_, _>>()?;
    let claimed = found.iter().flatten();
    let right = claimed.clone().filter(|(_, is_right)| *is_right);
    let right: Vec<StampedPose> = right.map(|(pose, _)| *pose).collect();
    let share = |count: usize| count as f64 / chosen.len().max(1) as f64;
    context.show(Progress {
        stage: "localizing single images",
        done: chosen.len() as u64,
        total: chosen.len() as u64,
    })?;
    let view = MapInView::new(map);
    let sees_map = |time: &Timestamp| {
        let at = truth.at(*time);
        at.is_some_and(|at| view.is_seen(&rig, &(truth_from_map.inverse() * at)))
    };
    let times = chosen.iter().map(|(time, _)| *time);
    let in_view: Vec<Timestamp> = times.filter(sees_map).collect();
    Ok(Localized {
        claimed: share(claimed.count()),
        right: share(right.len()),
        ate_rms_m: ate_rms_m(truth.poses(), &right),
        map_in_view: share(in_view.len()),
        in_view,
    })
}

fn some_instants(walk: &Recording, names: &[&str]) -> anyhow::Result<Vec<Instant>> {
    let all = times_of_images(walk, names)?;
    let step = all.len().div_ceil(INSTANTS).max(1);
    instants(walk, names, all.into_iter().step_by(step).collect())
}

fn times_of_images(walk: &Recording, names: &[&str]) -> anyhow::Result<Vec<Timestamp>> {
    let mut all = Vec::new();
    for image in walk.images(names.first().copied().unwrap_or_default())? {
        all.push(image?.time);
    }
    Ok(all)
}

/// The images of all cameras at some times, which are in order.
fn instants(
    walk: &Recording,
    names: &[&str],
    wanted: Vec<Timestamp>,
) -> anyhow::Result<Vec<Instant>> {
    let mut chosen: Vec<Instant> = wanted.into_iter().map(|time| (time, Vec::new())).collect();
    for item in walk.images_of(names)? {
        let item = item?;
        let ns = item.image.time.nanos();
        let near = chosen.partition_point(|(time, _)| time.nanos() < ns - SAME_INSTANT_NS);
        if let Some((time, images)) = chosen.get_mut(near)
            && time.nanos() <= ns + SAME_INSTANT_NS
        {
            images.push((item.camera, item.image.sample));
        }
    }
    Ok(chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Floors are built alike, so that poses on another one lie where they would be right on this.
    #[test]
    fn no_image_of_another_floor_is_localized_rightly() {
        let found = Localized {
            claimed: 0.8,
            right: 0.7,
            ..Localized::default()
        };
        assert_eq!(found.clone().under(Condition::Crowd), found);
        let elsewhere = found.under(Condition::OtherFloor);
        assert_eq!((elsewhere.claimed, elsewhere.right), (0.8, 0.0));
    }

    fn line(times_s: &[f64], off: impl Fn(usize) -> Se3) -> Trajectory {
        let poses = times_s.iter().enumerate().map(|(k, secs)| StampedPose {
            time: Timestamp::from_secs_f64(*secs),
            world_from_rig: Se3::new(Default::default(), Vector3::new(*secs, 0.0, 0.0)) * off(k),
        });
        Trajectory::new(poses.collect())
    }

    /// A walk that is a metre off as a whole is right from image to image; what lies across a hole counts for nothing.
    #[test]
    fn errors_between_frames_are_those_of_steps() {
        let times = [0.0, 0.1, 0.2, 0.3, 0.8, 0.9];
        let truth = line(&[0.0, 0.5, 1.0], |_| Se3::identity());
        let aside = Se3::new(Default::default(), Vector3::new(0.0, 1.0, 0.0));
        let found = between_frames(&line(&times, |_| aside), &truth).expect("steps");
        assert!(
            found.translation_m < 1e-9 && found.rotation_deg < 1e-9,
            "{found:?}"
        );
        let jump = |k: usize| {
            Se3::new(
                Default::default(),
                Vector3::new(0.0, if k > 3 { 5.0 } else { 0.0 }, 0.0),
            )
        };
        let found = between_frames(&line(&times, jump), &truth).expect("steps");
        assert!(found.translation_m < 1e-9, "{found:?}");
        let shaking = |k: usize| {
            let turn = so3::exp(&Vector3::new(0.0, 0.0, 0.01 * (k % 2) as f64));
            Se3::new(turn, Vector3::new(0.0, 0.002 * (k % 2) as f64, 0.0))
        };
        let found = between_frames(&line(&times, shaking), &truth).expect("steps");
        assert!(
            (found.rotation_deg - 0.01f64.to_degrees()).abs() < 1e-9,
            "{found:?}"
        );
        assert!((0.002..0.003).contains(&found.translation_m), "{found:?}");
        assert_eq!(between_frames(&line(&times[..1], shaking), &truth), None);
    }

    /// Interpolated over a hole, a trajectory answers everything.
    #[test]
    fn an_instant_without_a_pose_is_not_answered() {
        let solved = line(&[0.0, 0.1, 0.2, 0.8], |_| Se3::identity());
        let at = |secs: &[f64]| -> Vec<Timestamp> {
            secs.iter().map(|s| Timestamp::from_secs_f64(*s)).collect()
        };
        assert_eq!(answered(&solved, &at(&[0.1, 0.5, 0.8, 0.801])), 0.75);
        assert_eq!(answered(&Trajectory::new(Vec::new()), &at(&[0.1])), 0.0);
    }

    #[test]
    fn jitter_is_what_changes_from_image_to_image_within_a_stretch() {
        let at = |x: f64| Some(Vector3::new(x, 0.0, 0.0));
        // A drift is none, nor is what lies between two stretches.
        let drift: Vec<_> = (0..18)
            .map(|k| at(f64::from(k) + 50.0 * f64::from(k / 9)))
            .collect();
        assert_eq!(second_difference_rms_m(&drift), Some(0.0));
        let shaking: Vec<_> = (0..9).map(|k| at(f64::from(k % 2))).collect();
        assert_eq!(second_difference_rms_m(&shaking), Some(2.0));
        let rare: Vec<_> = (0..9).map(|k| (k % 2 == 0).then(Vector3::zeros)).collect();
        assert_eq!(second_difference_rms_m(&rare), None);
        let times: Vec<Timestamp> = (0..100).map(Timestamp::from_nanos).collect();
        let chosen = stretches(&times);
        assert_eq!((chosen.len(), chosen[9].nanos()), (45, 20));
        assert!(stretches(&times[..5]).is_empty());
    }
}
