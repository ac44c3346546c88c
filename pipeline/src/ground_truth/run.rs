//! The stage as a whole: a recording and a map in, a trajectory out.

use std::ops::Range;
use std::path::Path;
use std::sync::Arc;

use lsfb_geometry::{Se3, Trajectory};
use lsfb_recording::Recording;
use lsfb_types::{Progress, ProgressFn, Verdict};
use rayon::prelude::*;

use super::accel_axes::misread_axis;
use super::cross_check::check_halves;
use super::dense::dense_states;
use super::estimate::Estimate;
use super::imu_refinement::ImuRefinement;
use super::in_view::{InView, Search};
use super::map_agreement::MapAgreement;
use super::other_place::Placed;
use super::recorded_walk::RecordedWalk;
use super::refusal::Judged;
use super::report::{Together, local_errors, map_errors, refinements};
use super::start::{Start, start_states};
use super::together::{Member, solve_together};
use super::trusted::{Solution, Trusted, trusted};
use super::uncertainty::uncertainty;
use super::walk::{FixedObservation, Frame, LocalPoint, LocalizedPose, Walk};
use super::warnings::{not_checked, out_of_reach, warnings};
use super::{
    GroundTruth, GroundTruthConfig, GroundTruthReport, GroundTruthWarning, Solved, solve_walk,
};
use crate::features::{Feature, Features};
use crate::frames::FeatureFrame;
use crate::hd_map::HdMap;
use crate::kept_stages::KeptStages;
use crate::localization::{Localization, Localizer, localize_frames_apart, localize_near};
use crate::residuals::MovingCamera;
use crate::{Error, Refusal};

/// Refuses maps in which no walk is to be solved: those that failed when they were made, and those of other features.
fn check_map(map: &HdMap, feature: &Feature, config: &GroundTruthConfig) -> Result<(), Error> {
    if !map.failures().is_empty() && !config.accept_failed_map {
        return Err(Refusal::FailedMap {
            failures: map.failures().to_vec(),
        }
        .into());
    }
    map.expect_feature(feature)
}

fn wanted_feature(config: &GroundTruthConfig) -> Feature {
    match &config.learned {
        Some(learned) => Feature::Learned(learned.feature.clone()),
        None => Feature::Sift,
    }
}

/// Where the device was at each of its images, in the world of the map.
///
/// [`Refusal::FailedMap`] of a map that failed when it was made; [`Error::WrongFeature`] of one with other features than the settings name;
/// [`Refusal::NotLocalized`] where too few images show the map; [`Refusal::AccelContradicts`] where a walk is refused and axes of the accelerometer explain it; [`Error::SensorMissing`] without cameras. Without an IMU images alone
/// say where the device was, and a warning that they do.
pub fn ground_truth(
    recording: &Recording,
    map: &HdMap,
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<GroundTruth, Error> {
    ground_truth_in_stages(recording, map, config, &KeptStages::none(), progress)
}

/// [`ground_truth`], going on behind what is kept of it: features and localizations of its images.
pub fn ground_truth_in_stages(
    recording: &Recording,
    map: &HdMap,
    config: &GroundTruthConfig,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<GroundTruth, Error> {
    config.check_bounds("ground_truth")?;
    // Before images are read: that takes a while.
    check_map(map, &wanted_feature(config), config)?;
    let recorded = RecordedWalk::read_in_stages(recording, config, stages, progress)?;
    solve_in_map(&recorded, map, config, stages, progress)
}

/// [`ground_truth`] of a walk that was read before, with the same features.
pub fn ground_truth_of(
    recorded: &RecordedWalk,
    map: &HdMap,
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<GroundTruth, Error> {
    config.check_bounds("ground_truth")?;
    check_map(map, &recorded.feature, config)?;
    solve_in_map(recorded, map, config, &KeptStages::none(), progress)
}

/// Walks through one map, solved together: what two of them see is one point, which holds them together. Each is solved and judged by itself
/// before, and judged again. What becomes of each, in their order; beside each walk stands what is kept of it, as in [`ground_truth_in_stages`].
///
/// As [`ground_truth`]; [`Refusal::FailedAlone`] where a walk by itself must not be used, [`Error::OtherWalk`] where one but the first is refused.
pub fn ground_truth_together(
    walks: &[(&Recording, &KeptStages)],
    map: &HdMap,
    config: &GroundTruthConfig,
    progress: ProgressFn<'_>,
) -> Result<Vec<GroundTruth>, Error> {
    config.check_bounds("ground_truth")?;
    check_map(map, &wanted_feature(config), config)?;
    let localizer = Localizer::new(map, &config.localization)?.without_twins();
    // All of them before any is solved: that takes longer.
    let recorded = of_each(walks, walks, |(recording, stages)| {
        RecordedWalk::read_in_stages(recording, config, stages, progress)
    })?;
    let to_solve = recorded.iter().zip(walks);
    let mut all = of_each(walks, to_solve, |(recorded, (_, stages))| {
        AloneInMap::solve(recorded, &localizer, config, stages, progress)
    })?;
    let mut members: Vec<Member> = all.iter_mut().map(AloneInMap::member).collect();
    let said = solve_together(&mut members, config, progress)?;
    for (walk, together) in all.iter_mut().zip(said) {
        walk.begun.together = Some(together);
    }
    of_each(walks, &all, |walk| {
        let judged = walk.attempt.judge(&walk.begun, Elsewhere::IsRefused);
        judged.map_err(|refused| refused.error)
    })
}

/// Does something to each walk; says of which it could not be done, where that is not the first.
fn of_each<W, T>(
    walks: &[(&Recording, &KeptStages)],
    each: impl IntoIterator<Item = W>,
    mut to_do: impl FnMut(W) -> Result<T, Error>,
) -> Result<Vec<T>, Error> {
    let mut done = Vec::with_capacity(walks.len());
    for (number, (walk, (recording, _))) in each.into_iter().zip(walks).enumerate() {
        let result = to_do(walk);
        done.push(result.map_err(|error| match error {
            stopped @ Error::Stopped(_) => stopped,
            error if number == 0 => error,
            error => Error::OtherWalk {
                path: recording.path().to_owned(),
                error: Box::new(error),
            },
        })?);
    }
    Ok(done)
}

/// A walk that is right by itself.
struct AloneInMap<'a> {
    attempt: Attempt<'a>,
    begun: Begun,
    given: GroundTruth,
}

impl<'a> AloneInMap<'a> {
    fn solve(
        recorded: &'a RecordedWalk,
        localizer: &'a Localizer,
        config: &'a GroundTruthConfig,
        stages: &KeptStages,
        progress: ProgressFn<'a>,
    ) -> Result<Self, Error> {
        let (attempt, localized) = Attempt::look_up(recorded, localizer, config, stages, progress)?;
        let begun = attempt.begin(&localized)?;
        let given = attempt.judge(&begun, Elsewhere::IsRefused);
        let given = given.map_err(|refused| refused.error)?;
        // Poses that are given, and are not to be used, would bend those of the other walks.
        let findings = given.report.findings().into_iter();
        let mut failed = findings.filter(|found| found.verdict == Verdict::Fail);
        if let Some(failed) = failed.next() {
            return Err(Refusal::FailedAlone {
                path: recorded.path.clone(),
                failed: Box::new(failed),
            }
            .into());
        }
        Ok(Self {
            attempt,
            begun,
            given,
        })
    }

    fn member(&mut self) -> Member<'_> {
        Member {
            walk: &mut self.begun.walk,
            features: &self.begun.features,
            solved: &mut self.begun.solved,
            given: &self.given.trajectory,
            covariances: &self.given.covariances,
        }
    }
}

fn solve_in_map(
    recorded: &RecordedWalk,
    map: &HdMap,
    config: &GroundTruthConfig,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<GroundTruth, Error> {
    let RecordedWalk { rig, read, .. } = recorded;
    // Whether there is another place that looks alike is asked of the whole walk.
    let localizer = Localizer::new(map, &config.localization)?.without_twins();
    let (attempt, localized) = Attempt::look_up(recorded, &localizer, config, stages, progress)?;
    let first = match attempt.solve(&localized, Elsewhere::IsTried) {
        Ok(solved) => return Ok(solved),
        Err(refused) => refused,
    };
    let Some(there) = &first.elsewhere else {
        return Err(first.error);
    };
    let frames = read
        .frames
        .par_iter()
        .zip(&attempt.was_looked_up)
        .enumerate();
    let localized: Vec<Option<Localization>> = frames
        .map(|(k, (frame, is_wanted))| {
            let near = there.pose(k).filter(|_| *is_wanted)?;
            localize_near(&localizer, rig, &frame.features, near)
        })
        .collect();
    match attempt.solve(&localized, Elsewhere::IsRefused) {
        Ok(mut solved) => {
            solved.report.warnings.push(there.warning.clone());
            Ok(solved)
        }
        Err(refused) => Err(match refused.error {
            stopped @ Error::Stopped(_) => stopped,
            // It is not there either: what speaks against the place where most of it was found stands.
            _ => first.error,
        }),
    }
}

/// A walk that is refused, and where else it is, if that is where what should be in view is seen.
struct Refused {
    error: Error,
    elsewhere: Option<Box<There>>,
}

/// A walk at another place.
struct There {
    /// The recording's frame that is its first one.
    first_frame: usize,
    estimate: Estimate,
    /// What is to be said of a walk that was solved there.
    warning: GroundTruthWarning,
}

impl There {
    /// Pose of the rig there at a frame of the recording; `None` outside the walk.
    fn pose(&self, frame: usize) -> Option<&Se3> {
        let own = frame.checked_sub(self.first_frame)?;
        (own < self.estimate.states.len()).then(|| self.estimate.pose(own))
    }
}

impl<E: Into<Error>> From<E> for Refused {
    fn from(error: E) -> Self {
        Self {
            error: error.into(),
            elsewhere: None,
        }
    }
}

/// What becomes of a walk that may be elsewhere.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Elsewhere {
    IsTried,
    IsRefused,
}

/// A walk that was solved, and not judged yet.
struct Begun {
    /// Of the recording's frames those that are solved.
    range: Range<usize>,
    /// Frames that were found in the map.
    localized: usize,
    walk: Walk,
    /// Numbered `frame * cameras + camera`.
    features: Vec<Features>,
    start: Start,
    solved: Solved,
    /// What other walks did to it.
    together: Option<Together>,
}

/// What a walk is solved with, wherever its images were found.
struct Attempt<'a> {
    recorded: &'a RecordedWalk,
    localizer: &'a Localizer,
    /// Which frames were looked up in the map on their own.
    was_looked_up: Vec<bool>,
    config: &'a GroundTruthConfig,
    progress: ProgressFn<'a>,
}

impl<'a> Attempt<'a> {
    /// Looks frames up in the map; beside each where it was found.
    fn look_up(
        recorded: &'a RecordedWalk,
        localizer: &'a Localizer,
        config: &'a GroundTruthConfig,
        stages: &KeptStages,
        progress: ProgressFn<'a>,
    ) -> Result<(Self, Vec<Option<Localization>>), Error> {
        let RecordedWalk { rig, read, .. } = recorded;
        let apart_secs = config.localize_every_secs;
        let found =
            localize_frames_apart(localizer, &read.frames, rig, apart_secs, stages, progress)?;
        let attempt = Self {
            recorded,
            localizer,
            was_looked_up: found.iter().map(Option::is_some).collect(),
            config,
            progress,
        };
        let localized = found.into_iter().map(|found| found?.ok()).collect();
        Ok((attempt, localized))
    }

    fn solve(
        &self,
        localized: &[Option<Localization>],
        elsewhere: Elsewhere,
    ) -> Result<GroundTruth, Refused> {
        self.judge(&self.begin(localized)?, elsewhere)
    }

    /// Solves the walk where its images were found.
    fn begin(&self, localized: &[Option<Localization>]) -> Result<Begun, Error> {
        let Self {
            recorded,
            localizer,
            config,
            progress,
            ..
        } = *self;
        let RecordedWalk {
            path, rig, read, ..
        } = recorded;
        let map = localizer.map();
        let count = localized.iter().flatten().count();
        if count < config.min_localized_frames {
            return Err(Error::Refused(Refusal::NotLocalized {
                path: path.clone(),
                frames: self.tried(0..read.frames.len()),
                localized: count,
                needed: config.min_localized_frames,
            }));
        }

        let range = frames_in_reach(&read.frames, localized, config);
        let mut features = Vec::new();
        let mut frames = Vec::new();
        for k in range.clone() {
            frames.push(frame_of(&read.frames[k], localized[k].as_ref(), map));
            features.extend(read.frames[k].features.iter().map(|f| f.features.clone()));
        }
        let seen = frames.iter().flat_map(|f: &Frame| &f.recognised);
        let stated = seen.filter_map(|s| Some((s.point, map.quality(s.point)?.covariance_m2)));
        let point_covariances_m2 = Arc::new(stated.collect());
        let mut walk = Walk {
            cameras: rig.cameras.values().map(MovingCamera::new).collect(),
            frames,
            imu: recorded.imu.clone(),
            noise: config.inflated(&recorded.noise),
            noise_factors: Default::default(),
            point_covariances_m2,
        };
        let start = start_states(&walk, config, progress)?;
        let start = accepted(start, count, path, config).map_err(|error| match error {
            Error::Refused(Refusal::MapDisagrees { .. }) => match misread_axis(&walk) {
                Some(misread) => misread.refusal(path),
                None => error,
            },
            other => other,
        })?;
        let solved = solve_walk(&mut walk, &start, &features, config, progress)?;
        Ok(Begun {
            range,
            localized: count,
            walk,
            features,
            start,
            solved,
            together: None,
        })
    }

    /// How many of some frames were looked up in the map.
    fn tried(&self, range: Range<usize>) -> usize {
        self.was_looked_up[range].iter().filter(|is| **is).count()
    }

    /// Gives what may be believed of a walk that was solved.
    fn judge(&self, begun: &Begun, elsewhere: Elsewhere) -> Result<GroundTruth, Refused> {
        let Self {
            recorded,
            localizer,
            config,
            progress,
            ..
        } = *self;
        let RecordedWalk {
            path, rig, read, ..
        } = recorded;
        let map = localizer.map();
        let Begun {
            range,
            localized: count,
            walk,
            features,
            start,
            solved,
            together,
        } = begun;
        let mut walk = walk.clone();
        let (estimate, points) = (&solved.last.estimate, &solved.last.points);
        let used = &solved.config;
        let (imu, agreement) = if walk.has_imu() {
            let imu = ImuRefinement::of(&walk, &solved.last, config)?;
            walk.loosen_imu(imu.noise_factor());
            let agreement = MapAgreement::of(&walk, &solved.last, used)?;
            (Some(imu), Some(agreement))
        } else {
            (None, None)
        };
        let uncertainty = uncertainty(&walk, estimate, points, used, progress)?;

        let search = Search::new(&walk, (estimate, points), features, map, config);
        let in_view = search.judge(estimate);
        let halves = check_halves(&walk, estimate, points, used, progress)?;
        let with_shared = uncertainty.poses.iter().zip(&halves);
        let with_shared = with_shared.map(|(pose, halves)| pose.map(|own| own + halves.shared));
        let covariances: Vec<_> = with_shared.collect();
        let disagreements_m: Vec<f64> = halves.iter().map(|h| h.disagreement_m).collect();
        let trusted = trusted(
            &walk,
            &Solution {
                states: &estimate.states,
                accepted: &start.accepted,
                covariances: &covariances,
                disagreements_m: &disagreements_m,
                in_view: &in_view,
            },
            config,
        );
        let whole = InView::of_walk(&in_view);
        let judged = Judged {
            path,
            walk: &walk,
            looked_up: self.tried(range.clone()),
            start,
            imu: imu.as_ref(),
            trusted: &trusted,
            in_view: &whole,
            disagreements_m: &disagreements_m,
        };
        let refusal = judged.refusal(config);
        let seen = &read.frames[range.clone()];
        let placed = Placed {
            rig,
            walk: &walk,
            estimate,
            frames: seen,
            search: &search,
            here: &whole,
        };
        let is_elsewhere = elsewhere == Elsewhere::IsTried && whole.is_doubtful(config);
        let found = match refusal.is_none() || is_elsewhere {
            true => {
                progress(Progress {
                    stage: "other places",
                    done: 0,
                    total: 0,
                })?;
                placed.other_place(localizer, config)
            }
            false => None,
        };
        let other_place = found.as_ref().map(|(other, _)| *other);
        let alike = other_place.filter(|other| other.is_possible(config.min_place_margin));
        let alike = alike.map(|other| {
            Error::Refused(Refusal::LooksAlike {
                path: path.clone(),
                matches_here: other.matches_here,
                matches_there: other.matches_there,
                away_m: other.away_m,
                turn_deg: other.turn_deg,
                margin: config.min_place_margin,
            })
        });
        if let Some(error) = refusal.or(alike) {
            let there = found.filter(|(other, _)| is_elsewhere && other.is_seen);
            return Err(Refused {
                error,
                elsewhere: there.map(|(place, estimate)| {
                    Box::new(There {
                        first_frame: range.start,
                        estimate,
                        warning: GroundTruthWarning::FoundElsewhere {
                            away_m: place.away_m,
                            turn_deg: place.turn_deg,
                            absent_share: whole.absent_share(),
                        },
                    })
                }),
            });
        }
        let trajectory = Trajectory::new(trusted.poses.clone());
        let mut report = report(&walk, solved, &trusted, &trajectory)?;
        (report.imu, report.map) = (imu, agreement);
        let names = rig.cameras.keys().map(String::as_str);
        report.cameras = refinements(names, estimate, &uncertainty.corrections, config);
        report.frames = read.frames.len() as u64;
        report.features = read.frames.iter().map(FeatureFrame::feature_count).sum();
        report.looked_up = self.tried(0..read.frames.len()) as u64;
        report.together = *together;
        report.localized = *count as u64;
        report.other_place = other_place;
        report.rejected_localizations = (count - start.accepted_count) as u64;
        report.rival_localizations = start.rival_count as u64;
        report.max_disagreement_m = config.max_disagreement_m;
        report.max_absent_share = config.max_absent_share;
        (report.points_in_view, report.absent_share) = (whole.points as u64, whole.absent_share());
        report.place_checked = whole.is_judged();
        report.left_out.extend(out_of_reach(&read.frames, range));
        report.left_out.sort_by_key(|span| span.from_ns);
        report.warnings = warnings(&report, recorded);
        let in_rig = rig.imu_noise().is_some();
        let without_imu = (!walk.has_imu()).then_some(GroundTruthWarning::WithoutImu { in_rig });
        report.warnings.extend(without_imu);
        report.warnings.extend(solved.unrest.clone());
        report.warnings.extend(not_checked(&walk, &in_view));
        let failures = map.failures().iter();
        report
            .warnings
            .extend(failures.map(|what| GroundTruthWarning::FailedMap { what: what.clone() }));
        Ok(GroundTruth {
            trajectory,
            covariances: trusted.covariances,
            disagreements_m: trusted.disagreements_m,
            states: dense_states(&walk, &solved.last, &trusted.frames)?,
            gravity_m_s2: solved.last.gravity_m_s2,
            localizations: start.localizations(&walk),
            report,
        })
    }
}

/// The start, where enough agrees with it and not half as much with another.
fn accepted(
    start: Option<Start>,
    localized: usize,
    path: &Path,
    config: &GroundTruthConfig,
) -> Result<Start, Error> {
    let path = || path.to_owned();
    let agreeing = start.as_ref().map_or(0, |start| start.accepted_count);
    let needed = (config.min_agreeing_share * localized as f64).ceil() as usize;
    let needed = needed.max(config.min_localized_frames);
    match start {
        Some(start) if agreeing >= needed => {
            let rival = start.rival_count;
            if (agreeing as f64) < config.min_rival_margin * rival as f64 {
                return Err(Refusal::AmbiguousPlace {
                    path: path(),
                    agreeing,
                    rival,
                    margin: config.min_rival_margin,
                }
                .into());
            }
            Ok(start)
        }
        _ => Err(Refusal::MapDisagrees {
            path: path(),
            localized,
            rejected: localized - agreeing,
            most: localized.saturating_sub(needed),
        }
        .into()),
    }
}

/// Frames from shortly before the first localized one to shortly after the last: beyond, nothing holds the IMU's drift.
fn frames_in_reach(
    frames: &[FeatureFrame],
    localized: &[Option<Localization>],
    config: &GroundTruthConfig,
) -> Range<usize> {
    let first = localized.iter().position(Option::is_some).unwrap_or(0);
    let last = localized.iter().rposition(Option::is_some).unwrap_or(0);
    let reach = config.max_extrapolation_secs;
    let start = frames.partition_point(|f| frames[first].time.secs_since(f.time) > reach);
    let end = frames.partition_point(|f| f.time.secs_since(frames[last].time) <= reach);
    start..end
}

fn frame_of(frame: &FeatureFrame, found: Option<&Localization>, map: &HdMap) -> Frame {
    let fixed = found.into_iter().flat_map(|found| &found.matches);
    Frame {
        time: frame.time,
        localized: found.map(|found| LocalizedPose {
            world_from_rig: found.world_from_rig,
            covariance: found.covariance,
        }),
        fixed: Vec::new(),
        recognised: fixed
            .filter_map(|m| {
                let keypoint = frame.features[m.frame]
                    .features
                    .keypoints
                    .get(m.keypoint as usize)?;
                Some(FixedObservation {
                    camera: m.frame,
                    keypoint: m.keypoint,
                    pixel: keypoint.pixel_f64(),
                    point: m.point,
                    point_in_world: map.position(m.point)?,
                })
            })
            .collect(),
    }
}

fn report(
    walk: &Walk,
    solved: &Solved,
    trusted: &Trusted,
    trajectory: &Trajectory,
) -> Result<GroundTruthReport, Error> {
    let last = &solved.last;
    let states = &last.estimate.states;
    let bias = states
        .get(states.len() / 2)
        .map(|s| s.bias)
        .unwrap_or_default();
    let gaps = walk.preintegrate(0..walk.frames.len(), |_| bias);
    Ok(GroundTruthReport {
        frames: 0,
        features: 0,
        looked_up: 0,
        localized: 0,
        rejected_localizations: 0,
        rival_localizations: 0,
        other_place: None,
        poses: trusted.poses.len() as u64,
        bridged: trusted.bridged as u64,
        largest_disagreement_m: trusted.disagreements_m.iter().copied().fold(0.0, f64::max),
        max_disagreement_m: 0.0,
        points_in_view: 0,
        place_checked: false,
        absent_share: 0.0,
        max_absent_share: 0.0,
        left_out: trusted.left_out.clone(),
        guided_matching: solved.guided_matching as u64,
        outliers: not_used(walk, &last.points) as u64,
        local_points: last.points.iter().filter(|p| p.is_determined()).count() as u64,
        map_errors: map_errors(walk, &last.estimate),
        local_errors: local_errors(&last.estimate, &last.points),
        imu_samples: walk.imu.len() as u64,
        imu_gaps: match walk.has_imu() {
            true => gaps.iter().filter(|gap| gap.is_none()).count() as u64,
            false => 0,
        },
        initial_cost: last.report.initial_cost,
        final_cost: last.report.final_cost,
        iterations: last.report.iterations as u64,
        termination: last.report.termination,
        gyro_bias_rad_s: bias.gyro_rad_s.into(),
        accel_bias_m_s2: bias.accel_m_s2.into(),
        cameras: Vec::new(),
        imu: None,
        map: None,
        together: None,
        path_length_m: trajectory.path_length_m(),
        warnings: Vec::new(),
    })
}

pub(super) fn not_used(walk: &Walk, points: &[LocalPoint]) -> usize {
    let of_map = walk
        .frames
        .iter()
        .map(|f| f.recognised.len() - f.fixed.len());
    let local = points.iter().flat_map(|p| &p.observations);
    of_map.sum::<usize>() + local.filter(|seen| !seen.used).count()
}
