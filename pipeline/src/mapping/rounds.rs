//! Rounds of new correspondences and Eq. (4), until the keyframes rest.

use lsfb_geometry::{Matrix6, Rig, Se3, StampedPose, Trajectory};
use lsfb_types::ProgressFn;

use super::adjustment::{Adjusted, Terms, adjust};
use super::control::{Control, ControlTerms, Hold, Marks, SolvedControl};
use super::inertial::{InertialEstimate, InertialTerm, KeyframeImu, RecordedImu};
use super::keyframe_scans::add_lidar_features;
use super::keyframes::Keyframes;
use super::placed_points::{drop_misplaced, triangulate_round};
use super::pose_covariance::{mark_covariance, pose_covariances};
use super::report::USUAL_OUTLIER_SHARE;
use super::residuals_by_part::{Measured, Moment, Regions, put_coverage};
use super::rig_check::{Checked, ShownCameras, camera_errors};
use super::scan_pairs::{Compared, ScanPair, scan_correspondences, scan_pairs};
use super::scan_source::ScanSource;
use super::weights::{Contradicted, Weights, lidar_residuals};
use super::{
    LidarResiduals, MappingConfig, MappingReport, MappingWarning, RoundReport, correct_trajectory,
};
use crate::error::Error;
use crate::features::tracks::Track;
use crate::hd_map::{
    ErrorSummary, MapPoint, PlacedImages, SiteFrame, drop_outliers, expect_map, find_tracks,
    observation_errors_px, track_errors,
};
use crate::kept_stages::KeptStages;

/// Rounds from a start that is another program's, at most; from the odometry the settings say how many.
const GIVEN_ROUNDS: usize = 10;

/// Images are matched where the poses have them, and scans joined along the way between keyframes: once a keyframe has moved or turned this much both are done
/// anew, metres and radians. A pixel of a wide camera, or its view of a wall.
const MATCHED_M: f64 = 0.03;
const MATCHED_RAD: f64 = 0.005;

/// Keyframes that move and turn less from one round to the next rest, metres and degrees.
pub(super) const RESTING_M: f64 = 1e-3;
pub(super) const RESTING_DEG: f64 = 0.02;

/// What Eq. (4) made of tracks and scans.
pub(super) struct Optimised {
    /// Of the keyframes.
    pub poses: Vec<StampedPose>,
    pub points: Vec<MapPoint>,
    /// Of the keyframes; none at all where the measurements do not determine them.
    pub covariances: Vec<Option<Matrix6<f64>>>,
    /// The rig file with cameras as the images show them, where some were taken so.
    pub refined: Option<String>,
    /// The surveyed frame that control points put the map into, and the world in that.
    pub site: Option<(SiteFrame, Se3)>,
}

/// What rounds of Eq. (4) read, where they are kept, and under which name.
pub(super) struct Run<'a> {
    pub source: ScanSource<'a>,
    /// Whether the start is another program's.
    pub given: bool,
    pub stages: &'a KeptStages,
    pub name: &'static str,
    pub control: Option<&'a Control>,
    pub imu: Option<&'a RecordedImu>,
    pub regions: &'a Regions,
}

/// Where Eq. (4) stands behind one of its rounds.
pub(super) struct Rounds {
    /// Rounds that are finished.
    pub done: usize,
    /// Rounds there are at most.
    pub most: usize,
    /// Of the keyframes.
    pub poses: Vec<StampedPose>,
    /// Where the keyframes were when images were matched last.
    pub matched: Vec<StampedPose>,
    /// How much the start is contradicted.
    pub contradicted: Contradicted,
    /// The control points that hold the map, once it was at rest without them.
    pub hold: Option<Hold>,
    /// What is found beside the poses, where the IMU takes part.
    pub inertial: Option<InertialEstimate>,
    /// The report so far.
    pub told: MappingReport,
}

/// How far poses have moved and turned at most: metres, radians.
pub(super) fn largest_move(from: &[StampedPose], to: &[StampedPose]) -> [f64; 2] {
    let moves = from.iter().zip(to);
    moves.fold([0.0, 0.0], |[metres, angle], (a, b)| {
        let moved = a.world_from_rig.inverse() * b.world_from_rig;
        [
            f64::max(metres, moved.translation.norm()),
            f64::max(angle, moved.rotation.angle()),
        ]
    })
}

/// Alternates new correspondences with Eq. (4) until the keyframes rest; then once more with the control points that agree with what came of it, where there are any.
pub(super) fn optimise(
    rig: &Rig,
    keyframes: &mut Keyframes,
    trajectory: &Trajectory,
    config: &MappingConfig,
    report: &mut MappingReport,
    run: &Run<'_>,
    progress: ProgressFn<'_>,
) -> Result<(Optimised, ShownCameras), Error> {
    let alternation = Alternation::new(rig, keyframes, trajectory, config, report, run, progress)?;
    let mut rounds = alternation.begin(std::mem::take(report));
    keyframes.place(&rounds.matched);
    let mut tracks = alternation.look_at(&rounds.matched, keyframes)?;
    keyframes.place(&rounds.poses);
    loop {
        let mut matches = alternation.match_round(&mut rounds, tracks, keyframes)?;
        let step = alternation.adjust_round(&mut rounds, &mut matches, keyframes)?;
        if alternation.judge_round(&mut rounds, &step, &matches, keyframes)? {
            let found = alternation.finish(&mut rounds, &step, matches, keyframes)?;
            *report = rounds.told;
            return Ok(found);
        }
        run.stages.keep(run.name, &rounds)?;
        tracks = matches.tracks;
    }
}

/// The first round of [`optimise`] as far as its terms: `take` is given them.
#[expect(
    clippy::too_many_arguments,
    reason = "those of `optimise`, and what is done instead of solving"
)]
pub(super) fn first_terms<T>(
    rig: &Rig,
    keyframes: &mut Keyframes,
    trajectory: &Trajectory,
    config: &MappingConfig,
    report: MappingReport,
    run: &Run<'_>,
    progress: ProgressFn<'_>,
    take: impl FnOnce(&Keyframes, &[MapPoint], &Terms<'_>) -> Result<T, Error>,
) -> Result<T, Error> {
    let alternation = Alternation::new(rig, keyframes, trajectory, config, &report, run, progress)?;
    let mut rounds = alternation.begin(report);
    let tracks = alternation.look_at(&rounds.matched, keyframes)?;
    let matches = alternation.match_round(&mut rounds, tracks, keyframes)?;
    let terms = alternation.terms(&matches.scans, matches.weights, None, None);
    take(keyframes, &matches.points, &terms)
}

/// What is the same in all rounds.
struct Alternation<'a> {
    rig: &'a Rig,
    trajectory: &'a Trajectory,
    config: &'a MappingConfig,
    run: &'a Run<'a>,
    progress: ProgressFn<'a>,
    /// The keyframes where the start has them.
    odometry: Vec<StampedPose>,
    /// How long no scan told the motion from each of them to the next, seconds.
    blind_s: Vec<f64>,
    pairs: Vec<ScanPair>,
    imu: Option<KeyframeImu<'a>>,
    marks: Option<Marks<'a>>,
    /// Rounds there are at most, until control points hold the map and again from then on.
    most: usize,
}

/// What one round matched.
struct Matches {
    tracks: Vec<Track>,
    points: Vec<MapPoint>,
    scans: Vec<Compared>,
    /// How far the scans lie apart before the round.
    lidar: LidarResiduals,
    weights: Weights,
}

/// What one round of Eq. (4) did.
struct Step {
    moved_m: f64,
    turned_rad: f64,
    rests: bool,
    /// Where it has the control points that hold the map.
    in_site: Option<SolvedControl>,
}

impl<'a> Alternation<'a> {
    fn new(
        rig: &'a Rig,
        keyframes: &Keyframes,
        trajectory: &'a Trajectory,
        config: &'a MappingConfig,
        report: &MappingReport,
        run: &'a Run<'a>,
        progress: ProgressFn<'a>,
    ) -> Result<Self, Error> {
        let odometry = keyframes.poses();
        let between = |imu: &'a RecordedImu| imu.between(&odometry, trajectory, &report.odometry);
        let marks = |control: &'a Control| Marks::find(control, rig, trajectory, &odometry);
        let least = if run.given { GIVEN_ROUNDS } else { 1 };
        Ok(Self {
            rig,
            trajectory,
            config,
            run,
            progress,
            blind_s: blind_secs(&odometry, trajectory, &report.odometry.gaps),
            pairs: scan_pairs(&keyframes.frames, config),
            imu: run.imu.map(between).transpose()?,
            marks: run.control.map(marks),
            most: config.outer_iterations.max(least),
            odometry,
        })
    }

    /// Behind the rounds that are kept already.
    fn begin(&self, report: MappingReport) -> Rounds {
        let count = self.odometry.len();
        let kept = self.run.stages.get::<Rounds>(self.run.name);
        let kept = kept.filter(|r| r.poses.len() == count && r.matched.len() == count);
        kept.unwrap_or_else(|| Rounds {
            done: 0,
            most: self.most,
            poses: self.odometry.clone(),
            matched: self.odometry.clone(),
            contradicted: Contradicted::default(),
            hold: None,
            inertial: self.imu.as_ref().map(|imu| imu.start.clone()),
            told: MappingReport {
                control: None,
                ..report
            },
        })
    }

    /// Tracks through the images as these poses have them; planes and edges of the scans along the way that they make.
    fn look_at(
        &self,
        poses: &[StampedPose],
        keyframes: &mut Keyframes,
    ) -> Result<Vec<Track>, Error> {
        let (config, progress) = (self.config, self.progress);
        if poses != self.odometry
            && let Some(lidar) = self.rig.lidar()
        {
            let now = correct_trajectory(self.trajectory, &self.odometry, poses);
            let frames = &mut keyframes.frames;
            add_lidar_features(self.run.source, lidar, frames, &now, config, progress)?;
        }
        let images = &keyframes.images;
        find_tracks(self.rig, poses, images, &config.reconstruction, progress)
    }

    /// Points and correspondences of scans where the keyframes are; the images are matched anew where these have left their matches.
    fn match_round(
        &self,
        rounds: &mut Rounds,
        mut tracks: Vec<Track>,
        keyframes: &mut Keyframes,
    ) -> Result<Matches, Error> {
        let (rig, config) = (self.rig, self.config);
        let [moved_m, turned_rad] = largest_move(&rounds.matched, &keyframes.poses());
        let has_left = moved_m > MATCHED_M || turned_rad > MATCHED_RAD;
        if (self.run.given || rounds.hold.is_some()) && has_left {
            rounds.matched = keyframes.poses();
            tracks = self.look_at(&rounds.matched, keyframes)?;
        }
        let points = triangulate_round(rig, keyframes, &tracks, rounds.done, config)?;
        let scans = scan_correspondences(&keyframes.frames, &self.pairs, config);
        let lidar = lidar_residuals(&keyframes.frames, &scans);
        let poses = keyframes.poses();
        let placed = PlacedImages {
            rig,
            keyframes: &poses,
            images: &keyframes.images,
        };
        let errors_px = observation_errors_px(&placed, &points);
        let told = &mut rounds.told;
        if told.rounds.is_empty() {
            let max_px = config.max_reprojection_px;
            let measured = Measured {
                keyframes,
                errors: track_errors(&placed, &points, &tracks),
                scans: &scans,
                max_px,
            };
            let errors_px = measured.put(self.run.regions, Moment::Before, told);
            let errors = ErrorSummary::of(&errors_px, max_px);
            told.reprojection_rms_before_px = errors.rms_px;
            told.reprojection_median_before_px = errors.median_px;
            told.lidar_before = lidar;
        }
        let weights = Weights {
            contradicted: rounds.contradicted,
            ..Weights::estimate(&lidar, &errors_px, &config.correlation)
        };
        Ok(Matches {
            tracks,
            points,
            scans,
            lidar,
            weights,
        })
    }

    /// Eq. (4) once.
    fn adjust_round(
        &self,
        rounds: &mut Rounds,
        matches: &mut Matches,
        keyframes: &mut Keyframes,
    ) -> Result<Step, Error> {
        let (rig, config) = (self.rig, self.config);
        let before = keyframes.poses();
        let held = self.marks.as_ref().zip(rounds.hold.as_ref());
        let control = held.and_then(|(marks, hold)| {
            let placed = marks.place(rig, &before, &config.control);
            marks.terms(&placed, Some(hold))
        });
        let imu = self.imu_term(rounds);
        let weights = matches.weights;
        let terms = self.terms(&matches.scans, weights, control.as_ref(), imu.as_ref());
        let Adjusted {
            report: solved,
            control: in_site,
            inertial,
        } = adjust(
            rig,
            keyframes,
            &mut matches.points,
            &terms,
            config,
            self.progress,
        )?;
        let triangulation = &config.reconstruction.triangulation;
        drop_misplaced(rig, keyframes, &mut matches.points, triangulation);
        rounds.inertial = inertial;
        rounds.poses = keyframes.poses();
        if let (Some(hold), Some(in_site)) = (&mut rounds.hold, &in_site) {
            hold.centred_from_world = in_site.centred_from_world;
        }
        let [moved_m, turned_rad] = largest_move(&before, &rounds.poses);
        // The odometry knows how well it knows its motion: wrong cameras must not talk it out of that.
        if self.run.given {
            let seen = rounds.contradicted;
            rounds.contradicted = seen.seen(&self.odometry, &rounds.poses, config);
        }
        let contradicted = rounds.contradicted;
        let done = RoundReport {
            plane_matches: matches.lidar.plane_matches,
            edge_matches: matches.lidar.edge_matches,
            observations: observations(&matches.points),
            plane_sigma_m: weights.plane_sigma_m,
            edge_sigma_m: weights.edge_sigma_m,
            pixel_sigma_px: weights.pixel_sigma_px,
            initial_cost: solved.initial_cost,
            final_cost: solved.final_cost,
            iterations: solved.iterations as u64,
            moved_m,
            turned_deg: turned_rad.to_degrees(),
            start_contradicted: [contradicted.rotation, contradicted.translation],
        };
        let rests = done.moved_m < RESTING_M && done.turned_deg < RESTING_DEG;
        rounds.told.rounds.push(done);
        rounds.told.lidar_after = lidar_residuals(&keyframes.frames, &matches.scans);
        rounds.done += 1;
        Ok(Step {
            moved_m,
            turned_rad,
            rests,
            in_site,
        })
    }

    /// Whether this was the last round. Where it would be, and control points have not been asked yet, they are.
    fn judge_round(
        &self,
        rounds: &mut Rounds,
        step: &Step,
        matches: &Matches,
        keyframes: &Keyframes,
    ) -> Result<bool, Error> {
        let is_at_end = step.rests || rounds.done >= rounds.most;
        if !is_at_end {
            return Ok(false);
        }
        if let (Some(marks), None) = (&self.marks, &rounds.told.control) {
            self.ask_control(marks, rounds, matches, keyframes)?;
            if rounds.hold.is_some() {
                return Ok(false);
            }
        }
        // From the odometry few rounds are made: what moves images beyond their matches is too much for that.
        let moves = step.moved_m > MATCHED_M || step.turned_rad > MATCHED_RAD;
        if !step.rests && (self.run.given || moves) {
            rounds.told.warnings.push(MappingWarning::NotAtRest {
                rounds: rounds.done as u64,
                moved_m: step.moved_m,
                turned_deg: step.turned_rad.to_degrees(),
            });
        }
        Ok(true)
    }

    /// Holds control points against the map before they pull at it: those that agree hold it from now on.
    fn ask_control(
        &self,
        marks: &Marks<'a>,
        rounds: &mut Rounds,
        matches: &Matches,
        keyframes: &Keyframes,
    ) -> Result<(), Error> {
        let config = self.config;
        let placed = marks.place(self.rig, &rounds.poses, &config.control);
        let placing = marks.terms(&placed, None);
        let imu = self.imu_term(rounds);
        let terms = self.terms(
            &matches.scans,
            matches.weights,
            placing.as_ref(),
            imu.as_ref(),
        );
        let checked = self.checked(keyframes, &matches.tracks, terms);
        let covariance_m2 = match &placing {
            Some(_) => mark_covariance(&checked, &matches.points, config)?,
            None => None,
        };
        let (held, said) = marks.decide(&placed, covariance_m2.as_ref(), &config.control);
        rounds.told.control = Some(said);
        rounds.hold = held;
        rounds.most = rounds.done + self.most;
        Ok(())
    }

    /// What the last round leaves to be said: the site, cameras against the rig file, how well the keyframes are known, what fits.
    fn finish(
        &self,
        rounds: &mut Rounds,
        step: &Step,
        matches: Matches,
        keyframes: &Keyframes,
    ) -> Result<(Optimised, ShownCameras), Error> {
        let (rig, config, progress) = (self.rig, self.config, self.progress);
        let Matches {
            tracks,
            mut points,
            scans,
            weights,
            ..
        } = matches;
        rounds.told.tracks = tracks.len() as u64;
        if !config.terms.images {
            points = triangulate_round(rig, keyframes, &tracks, 1, config)?;
        }
        let (control, site) = self.lay_in_site(rounds, step, keyframes);
        let imu = self.imu_term(rounds);
        let told = &mut rounds.told;
        told.imu = imu.as_ref().map(|term| term.report(&keyframes.poses()));
        let terms = self.terms(&scans, weights, control.as_ref(), imu.as_ref());
        let checked = self.checked(keyframes, &tracks, terms);
        let shown = camera_errors(&checked, config, progress)?.unwrap_or_else(|warning| {
            told.warnings.push(warning);
            ShownCameras::none(rig)
        });
        told.cameras = shown.errors.clone();
        let factor = rounds.hold.as_ref().map_or(1.0, |hold| hold.map_factor);
        let covariances = match pose_covariances(&checked, &points, config, progress)? {
            Ok(known) => known
                .into_iter()
                .map(|c| Some(c * factor * factor))
                .collect(),
            Err(warning) => {
                told.warnings.push(warning);
                Vec::new()
            }
        };
        self.sum_up(told, &tracks, &mut points, &scans, keyframes);
        expect_map(&points, &keyframes.images)?;
        let optimised = Optimised {
            poses: keyframes.poses(),
            points,
            covariances,
            refined: None,
            site,
        };
        Ok((optimised, shown))
    }

    /// Where control points hold the map: what they add to Eq. (4), and the site with the world in it. The report has what the map says of them.
    fn lay_in_site(
        &self,
        rounds: &mut Rounds,
        step: &Step,
        keyframes: &Keyframes,
    ) -> (Option<ControlTerms<'a>>, Option<(SiteFrame, Se3)>) {
        let (Some(marks), Some(hold)) = (&self.marks, &rounds.hold) else {
            return (None, None);
        };
        let placed = marks.place(self.rig, &keyframes.poses(), &self.config.control);
        let site = rounds.told.control.as_mut().and_then(|said| {
            let Some(in_site) = &step.in_site else {
                said.lost();
                return None;
            };
            marks.say_after(said, &placed, in_site);
            Some(marks.site(hold))
        });
        (marks.terms(&placed, Some(hold)), site)
    }

    /// What fits, by camera and region; what does not leaves the map.
    fn sum_up(
        &self,
        told: &mut MappingReport,
        tracks: &[Track],
        points: &mut Vec<MapPoint>,
        scans: &[Compared],
        keyframes: &Keyframes,
    ) {
        let max_px = self.config.max_reprojection_px;
        let poses = keyframes.poses();
        let placed = PlacedImages {
            rig: self.rig,
            keyframes: &poses,
            images: &keyframes.images,
        };
        let measured = Measured {
            keyframes,
            errors: track_errors(&placed, points, tracks),
            scans,
            max_px,
        };
        told.reprojection_errors_px = measured.put(self.run.regions, Moment::After, told);
        let errors = ErrorSummary::of(&told.reprojection_errors_px, max_px);
        told.reprojection_rms_px = errors.rms_px;
        told.reprojection_median_px = errors.median_px;
        told.outlier_share = errors.share_beyond;
        drop_outliers(&placed, points, max_px);
        put_coverage(self.run.regions, keyframes, points, &mut told.by_region);
        told.points = points.len() as u64;
        told.observations = observations(points);
        let all = told.reprojection_errors_px.len() as u64;
        told.dropped_observations = all - told.observations.min(all);
        if errors.share_beyond > USUAL_OUTLIER_SHARE {
            told.warnings.push(MappingWarning::ManyOutliers {
                share: errors.share_beyond,
                max_px,
            });
        }
    }

    /// What the IMU says between keyframes, summed up at the biases that the last round found.
    fn imu_term(&self, rounds: &Rounds) -> Option<InertialTerm<'_>> {
        let both = self.imu.as_ref().zip(rounds.inertial.as_ref());
        both.map(|(imu, estimate)| imu.term(estimate))
    }

    fn terms<'t>(
        &'t self,
        scans: &'t [Compared],
        weights: Weights,
        control: Option<&'t ControlTerms<'t>>,
        imu: Option<&'t InertialTerm<'t>>,
    ) -> Terms<'t> {
        Terms {
            scans,
            odometry: &self.odometry,
            blind_s: &self.blind_s,
            weights,
            control,
            imu,
        }
    }

    fn checked<'t>(
        &'t self,
        keyframes: &'t Keyframes,
        tracks: &'t [Track],
        terms: Terms<'t>,
    ) -> Checked<'t> {
        Checked {
            rig: self.rig,
            keyframes,
            tracks,
            trajectory: self.trajectory,
            terms,
        }
    }
}

fn observations(points: &[MapPoint]) -> u64 {
    points.iter().map(|p| p.observations.len() as u64).sum()
}

/// How long no scan told the motion from each keyframe to the next, seconds: in holes of the trajectory, and in gaps of the odometry's scans, from and until
/// seconds after the first of its poses.
fn blind_secs(keyframes: &[StampedPose], trajectory: &Trajectory, gaps_s: &[[f64; 2]]) -> Vec<f64> {
    let Some(begin) = trajectory.poses().first().map(|pose| pose.time) else {
        return vec![0.0; keyframes.len()];
    };
    let holes = trajectory.holes();
    let holes = holes.map(|hole| hole.map(|pose| pose.time.secs_since(begin)));
    let blind: Vec<[f64; 2]> = holes.chain(gaps_s.iter().copied()).collect();
    let pairs = keyframes.windows(2);
    pairs
        .map(|pair| {
            let [from_s, to_s] = [0, 1].map(|k| pair[k].time.secs_since(begin));
            let shared = blind
                .iter()
                .map(|[a, b]| (b.min(to_s) - a.max(from_s)).max(0.0));
            shared.fold(0.0, f64::max)
        })
        .collect()
}
