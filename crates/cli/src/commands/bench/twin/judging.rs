//! Single images of a walk against a map and the truth.

use lsfb_geometry::{Se3, Trajectory, Vector3};
use lsfb_pipeline::features::{FrameFeatures, SiftConfig, SiftDetector};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_pipeline::localization::{Localizer, LocalizerConfig};
use lsfb_recording::Recording;
use lsfb_types::{Image, Progress, Timestamp};
use rayon::prelude::*;

use super::result::WRONG_M;
use super::trial::Condition;
use crate::context::Context;

/// Instants that are localized on their own, spread over the walk.
const INSTANTS: usize = 40;
/// A rotation that is further off is wrong, degrees.
const WRONG_DEG: f64 = 5.0;
/// Images of one instant are no further apart, nanoseconds.
const SAME_INSTANT_NS: i64 = 1_000_000;

/// Shares of the instants that were looked at.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Localized {
    /// With a pose.
    pub claimed: f64,
    /// With a pose that is right.
    pub right: f64,
}

impl Localized {
    /// Of a walk after such a change of the place: wherever a pose is on the mapped floor, who walks on another one is not there.
    pub fn under(self, condition: Condition) -> Self {
        match condition {
            Condition::OtherFloor => Self { right: 0.0, ..self },
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
    let found: Vec<anyhow::Result<[bool; 2]>> = chosen
        .par_iter()
        .map_init(
            || detector.clone(),
            |detector, (time, images)| {
                context.check_stop()?;
                let frames = features(detector, &names, images);
                let Ok(pose) = localizer.localize(&frames, &rig) else {
                    return Ok([false; 2]);
                };
                let right = truth
                    .at(*time)
                    .is_some_and(|at| is_right(&at, truth_from_map, &pose.world_from_rig));
                Ok([true, right])
            },
        )
        .collect();
    let mut counts = [0_usize; 2];
    for one in found {
        for (count, is) in counts.iter_mut().zip(one?) {
            *count += usize::from(is);
        }
    }
    let share = |count: usize| count as f64 / chosen.len().max(1) as f64;
    context.show(Progress {
        stage: "localizing single images",
        done: chosen.len() as u64,
        total: chosen.len() as u64,
    })?;
    Ok(Localized {
        claimed: share(counts[0]),
        right: share(counts[1]),
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
        };
        assert_eq!(found.under(Condition::Crowd), found);
        let elsewhere = found.under(Condition::OtherFloor);
        assert_eq!((elsewhere.claimed, elsewhere.right), (0.8, 0.0));
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
