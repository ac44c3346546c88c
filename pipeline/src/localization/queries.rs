use std::collections::BTreeMap;
use std::path::PathBuf;

use lsfb_geometry::{Rig, Se3};
use lsfb_perception::image::ImageError;
use lsfb_recording::Recording;
use lsfb_types::{ImuSample, ProgressFn, SharedProgress, Stamped, Timestamp};
use rayon::prelude::*;

use super::expected::{WalkMotion, knowledge};
use super::joint_focal_length::{FocalLengthDecision, JointFocalLength};
use super::prior::PoseKnowledge;
use super::sequence::{refuse_contradicted, refuse_hardly_recognised};
use super::{Localization, Localizer, NotLocalized, NotLocalizedReason};
use crate::Error;
use crate::features::{FeatureDetector, FrameFeatures};
use crate::frames::{FeatureFrame, ImageClock, read_frames, read_imu_if_any, times_apart};
use crate::kept_stages::KeptStages;
use crate::posed_images::{PosedImages, QueryImage, read_image};

/// What became of one image, beside the pose its list gives.
#[derive(Clone, Debug, PartialEq)]
pub struct ImageLocalization {
    /// The image file.
    pub path: PathBuf,
    /// The pose that the list gives: never used to find the other.
    pub listed_world_from_rig: Se3,
    /// The pose found in the map.
    pub found: Result<Localization, NotLocalized>,
}

impl ImageLocalization {
    /// Distance of the pose found from the listed one, metres; `None` where none was found.
    pub fn distance_m(&self) -> Option<f64> {
        let found = self.found.as_ref().ok()?;
        Some((found.world_from_rig.translation - self.listed_world_from_rig.translation).norm())
    }

    /// Angle between the pose found and the listed one, degrees; `None` where none was found.
    pub fn angle_deg(&self) -> Option<f64> {
        let found = self.found.as_ref().ok()?;
        let off = self.listed_world_from_rig.inverse() * found.world_from_rig;
        Some(off.rotation.angle().to_degrees())
    }
}

/// Localizes each image of a list on its own, in the list's order; the focal length of each camera is judged by all of its images.
pub fn localize_posed_images(
    localizer: &Localizer,
    posed: &PosedImages,
    detector: &FeatureDetector,
    progress: ProgressFn,
) -> Result<Vec<ImageLocalization>, Error> {
    let queries: Vec<QueryImage> = posed
        .images
        .iter()
        .map(|image| QueryImage {
            path: image.path.clone(),
            camera: image.camera.clone(),
        })
        .collect();
    let found = localize_images(localizer, &posed.rig, &queries, detector, progress)?;
    let found = judge_each_camera(localizer, &queries, found);
    let localized = posed.images.iter().zip(found);
    Ok(localized
        .map(|(image, found)| ImageLocalization {
            path: image.path.clone(),
            listed_world_from_rig: image.world_from_rig,
            found,
        })
        .collect())
}

/// Answers of the images of one camera, or of the instants of one rig, with its focal length judged by all of them.
pub fn judge_together(
    found: Vec<Result<Localization, NotLocalized>>,
    min_probability: f64,
) -> Vec<Result<Localization, NotLocalized>> {
    let best = found
        .iter()
        .filter_map(|found| found.as_ref().map_or_else(NotLocalized::best, Some));
    let Some(joint) = JointFocalLength::of(best.map(|best| &best.evidence)) else {
        return found;
    };
    let refused = |best| {
        Err(NotLocalized {
            reason: NotLocalizedReason::FocalLength {
                best,
                joint: Some(joint),
            },
        })
    };
    let judged = found.into_iter().map(|found| match found {
        Ok(best) => match joint.judge(&best.evidence, true) {
            FocalLengthDecision::Refused => refused(Box::new(best)),
            FocalLengthDecision::Borne | FocalLengthDecision::AsAlone => Ok(best),
        },
        Err(NotLocalized {
            reason: NotLocalizedReason::FocalLength { best, joint: alone },
        }) => match joint.judge(&best.evidence, false) {
            FocalLengthDecision::Refused => refused(best),
            FocalLengthDecision::Borne if best.probability >= min_probability => Ok(*best),
            FocalLengthDecision::Borne | FocalLengthDecision::AsAlone => Err(NotLocalized {
                reason: NotLocalizedReason::FocalLength { best, joint: alone },
            }),
        },
        found => found,
    });
    judged.collect()
}

/// Judges the images of each camera together.
fn judge_each_camera(
    localizer: &Localizer,
    queries: &[QueryImage],
    found: Vec<Result<Localization, NotLocalized>>,
) -> Vec<Result<Localization, NotLocalized>> {
    let mut of_camera: BTreeMap<&str, (Vec<usize>, Vec<_>)> = BTreeMap::new();
    for (index, (query, found)) in queries.iter().zip(found).enumerate() {
        let (places, answers) = of_camera.entry(&query.camera).or_default();
        places.push(index);
        answers.push(found);
    }
    let min_probability = localizer.min_probability();
    let judged = of_camera.into_values().flat_map(|(places, answers)| {
        let judged = judge_together(answers, min_probability);
        places.into_iter().zip(judged)
    });
    let judged: BTreeMap<usize, _> = judged.collect();
    judged.into_values().collect()
}

/// Localizes each image on its own, in their order. Refuses a detector of another feature than the map's.
pub fn localize_images(
    localizer: &Localizer,
    rig: &Rig,
    images: &[QueryImage],
    detector: &FeatureDetector,
    progress: ProgressFn,
) -> Result<Vec<Result<Localization, NotLocalized>>, Error> {
    localizer.map().expect_feature(&detector.feature())?;
    let done = SharedProgress::new("localization", images.len(), progress);
    let localized = images.par_iter().map_init(
        || detector.clone(),
        |detector, image| {
            let found = match read_image(&image.path, &image.camera, rig) {
                Ok(pixels) => {
                    let frame = FrameFeatures {
                        camera: image.camera.clone(),
                        features: detector.detect(&pixels),
                    };
                    localizer.localize(&[frame], rig)
                }
                Err(Error::ImageSize {
                    camera,
                    expected_px,
                    found_px,
                    ..
                }) => Err(NotLocalized {
                    reason: NotLocalizedReason::ImageSize {
                        camera,
                        expected_px,
                        found_px,
                    },
                }),
                // One damaged file of many is no reason to give up.
                Err(
                    error @ Error::Image(
                        ImageError::Damaged { .. } | ImageError::OtherFormat { .. },
                    ),
                ) => Err(NotLocalized {
                    reason: NotLocalizedReason::Unreadable {
                        message: error.to_string(),
                    },
                }),
                Err(error) => return Err(error),
            };
            done.one_more()?;
            Ok(found)
        },
    );
    localized.collect()
}

/// What became of the images of one instant of a walk.
#[derive(Clone, Debug, PartialEq)]
pub struct InstantLocalization {
    /// When they were taken, by the rig's clock.
    pub time: Timestamp,
    /// The cameras, in the order of [`FeatureMatch::frame`](super::FeatureMatch::frame).
    pub cameras: Vec<String>,
    /// The pose found in the map.
    pub found: Result<Localization, NotLocalized>,
}

/// What became of a walk.
#[derive(Clone, Debug, PartialEq)]
pub struct WalkLocalization {
    /// By time.
    pub instants: Vec<InstantLocalization>,
    /// Messages that were damaged, and left out.
    pub damaged: u64,
}

/// Localizes the images of each instant of a walk on their own, and refuses poses that those of the seconds around them contradict, in a
/// map in metres, and the few of a walk that is hardly recognised. Instants that are not found so are looked for once more with what those around them and the IMU say of their poses.
/// Refuses a detector of another feature than the map's.
pub fn localize_recording(
    localizer: &Localizer,
    recording: &Recording,
    detector: &FeatureDetector,
    progress: ProgressFn,
) -> Result<WalkLocalization, Error> {
    let stages = KeptStages::none();
    localize_recording_in_stages(localizer, recording, detector, &stages, progress)
}

/// [`localize_recording`], going on behind what is kept of it.
pub fn localize_recording_in_stages(
    localizer: &Localizer,
    recording: &Recording,
    detector: &FeatureDetector,
    stages: &KeptStages,
    progress: ProgressFn,
) -> Result<WalkLocalization, Error> {
    let rig = recording.rig()?;
    localizer.map().expect_feature(&detector.feature())?;
    let read = read_frames(recording, &rig, ImageClock::Rig, detector, stages, progress)?;
    let found = localize_frames(localizer, &read.frames, &rig, stages, progress)?;
    let times: Vec<Timestamp> = read.frames.iter().map(|frame| frame.time).collect();
    let found = refuse_hardly_recognised(&times, refuse_contradicted(&times, found));
    let imu = read_imu_if_any(recording)?;
    let known = Known {
        samples: &imu.samples,
        times: &times,
    };
    let found = localize_lost(
        localizer,
        &read.frames,
        &rig,
        &known,
        found,
        stages,
        progress,
    )?;
    let instants = read.frames.iter().zip(found);
    Ok(WalkLocalization {
        instants: instants
            .map(|(frame, found)| InstantLocalization {
                time: frame.time,
                cameras: frame.features.iter().map(|f| f.camera.clone()).collect(),
                found,
            })
            .collect(),
        damaged: read.damaged + imu.damaged,
    })
}

/// Frames whose answers are kept together: enough for all threads, little enough to lose.
const PART: usize = 64;

/// Localizes each frame of a walk on its own, in their order; the focal lengths of the rig are judged by all of them.
fn localize_frames(
    localizer: &Localizer,
    frames: &[FeatureFrame],
    rig: &Rig,
    stages: &KeptStages,
    progress: ProgressFn,
) -> Result<Vec<Result<Localization, NotLocalized>>, Error> {
    let alone = frames.iter().map(|frame| (frame, PoseKnowledge::NOTHING));
    let all: Vec<_> = alone.collect();
    let found = localize_parts(localizer, &all, rig, "localized", stages, progress)?;
    Ok(judge_together(found, localizer.min_probability()))
}

/// What a walk says besides its images.
struct Known<'a> {
    samples: &'a [Stamped<ImuSample>],
    times: &'a [Timestamp],
}

/// Looks once more for the frames that were not found, with what is known of their poses.
fn localize_lost(
    localizer: &Localizer,
    frames: &[FeatureFrame],
    rig: &Rig,
    known: &Known,
    found: Vec<Result<Localization, NotLocalized>>,
    stages: &KeptStages,
    progress: ProgressFn,
) -> Result<Vec<Result<Localization, NotLocalized>>, Error> {
    let poses: Vec<_> = found
        .iter()
        .map(|found| {
            let found = found.as_ref().ok()?;
            Some((&found.world_from_rig, &found.covariance))
        })
        .collect();
    let motion = WalkMotion::new(known.samples);
    let knowledge = knowledge(&motion, known.times, &poses);
    let is_known = |k: &usize| knowledge[*k] != PoseKnowledge::NOTHING;
    let lost: Vec<usize> = (0..frames.len()).filter(is_known).collect();
    let asked: Vec<(&FeatureFrame, PoseKnowledge)> =
        lost.iter().map(|k| (&frames[*k], knowledge[*k])).collect();
    let again = localize_parts(localizer, &asked, rig, "localized_again", stages, progress)?;
    let again = judge_together(again, localizer.min_probability());
    let mut all = found;
    for (k, again) in lost.into_iter().zip(again) {
        if again.is_ok() {
            all[k] = again;
        }
    }
    Ok(refuse_contradicted(known.times, all))
}

/// [`localize_frames`] of some: the first, those at least so much later than the one before, the last; and where one of these is not
/// found, all between it and its neighbours. `None` of the others.
pub(crate) fn localize_frames_apart(
    localizer: &Localizer,
    frames: &[FeatureFrame],
    rig: &Rig,
    apart_secs: f64,
    stages: &KeptStages,
    progress: ProgressFn,
) -> Result<Vec<Option<Result<Localization, NotLocalized>>>, Error> {
    let times: Vec<Timestamp> = frames.iter().map(|frame| frame.time).collect();
    let of = |name: &str, chosen: &[usize]| {
        let alone = chosen.iter().map(|k| (&frames[*k], PoseKnowledge::NOTHING));
        let frames: Vec<_> = alone.collect();
        localize_parts(localizer, &frames, rig, name, stages, progress)
    };
    let sparse = times_apart(&times, apart_secs);
    let found = of("localized", &sparse)?;
    let pairs = sparse.windows(2).zip(found.windows(2));
    let lost = pairs.filter(|(_, found)| found.iter().any(Result::is_err));
    let between: Vec<usize> = lost.flat_map(|(k, _)| k[0] + 1..k[1]).collect();
    let found_between = of("localized_between", &between)?;
    let both = sparse.into_iter().zip(found);
    let mut both: Vec<_> = both.chain(between.into_iter().zip(found_between)).collect();
    both.sort_by_key(|(k, _)| *k);
    let (places, answers): (Vec<usize>, Vec<_>) = both.into_iter().unzip();
    let judged = judge_together(answers, localizer.min_probability());
    let mut all: Vec<_> = frames.iter().map(|_| None).collect();
    for (k, found) in places.into_iter().zip(judged) {
        all[k] = Some(found);
    }
    Ok(all)
}

/// Localizes each of some frames with what is known of its pose; what is found is kept part by part.
fn localize_parts(
    localizer: &Localizer,
    frames: &[(&FeatureFrame, PoseKnowledge)],
    rig: &Rig,
    name: &str,
    stages: &KeptStages,
    progress: ProgressFn,
) -> Result<Vec<Result<Localization, NotLocalized>>, Error> {
    let mut found = Vec::with_capacity(frames.len());
    for (number, part) in frames.chunks(PART).enumerate() {
        let done = SharedProgress::new("localization", frames.len(), progress).after(found.len());
        let of_part: Vec<_> = stages.once(&format!("{name}_{number:05}"), || {
            let localized = part.par_iter().map(|(frame, known)| {
                let found = localizer.localize_known(&frame.features, rig, known);
                done.one_more()?;
                Ok(found)
            });
            localized.collect::<Result<Vec<_>, Error>>()
        })?;
        found.extend(of_part);
    }
    Ok(found)
}
