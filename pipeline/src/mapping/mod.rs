#![doc = include_str!("README.md")]

mod adjustment;
mod camera_error;
mod config;
mod control;
mod image_check;
mod inertial;
mod kept;
mod keyframe_scans;
mod keyframes;
mod matched;
mod pose_covariance;
mod posed_scans;
mod report;
mod reprojection_errors;
mod residuals;
mod residuals_by_part;
mod rig_check;
mod scan_check;
mod scan_offsets;
mod scan_pairs;
mod scan_source;
mod weights;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix6, Rig, Se3, StampedPose, Trajectory, Vector3};
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_types::{Finding, Progress, ProgressFn, Verdict};
use sha2::{Digest, Sha256};

use crate::bending::bent;
use crate::error::Error;
use crate::features::FeatureDetector;
use crate::features::tracks::Track;
use crate::features::triangulation::{TriangulationConfig, has_no_place};
use crate::hd_map::{
    HdMap, MapContent, MapPoint, SiteFrame, expect_map, find_tracks, triangulate_tracks,
};
use crate::kept_stages::KeptStages;
use crate::loops::{close_loops, find_loops};
use crate::odometry::{Damages, run_odometry, scan_count};
use crate::read_ahead::read_ahead;
use crate::stored_clouds::StoredClouds;
use crate::surface::{Agreement, SurfaceBuilder, SurfaceConfig};
use adjustment::{Adjusted, Terms, adjust};
pub use camera_error::CameraError;
pub use config::{CorrelationConfig, MappingConfig, TermConfig};
pub use control::{Control, ControlConfig, ControlMark, ControlReport};
use control::{Hold, Marks, SolvedControl};
use image_check::describe_images;
pub use inertial::InertialReport;
use inertial::{InertialEstimate, RecordedImu};
use keyframe_scans::add_lidar_features;
use keyframes::{Keyframes, choose_keyframes, find_cameras};
use pose_covariance::{mark_covariance, pose_covariances};
pub use posed_scans::{PosedScan, RefinedScans, ScanPoseConfig, ScanPoseReport, refine_scan_poses};
use report::USUAL_OUTLIER_SHARE;
pub use report::{MappingReport, MappingWarning, RoundReport};
use reprojection_errors::{ErrorSummary, drop_outliers, observation_errors_px, track_errors};
pub use residuals::{CameraResiduals, LidarResiduals, PixelResiduals, RegionResiduals};
use residuals_by_part::{Measured, Moment, Regions, put_coverage};
use rig_check::{Checked, ShownCameras, camera_errors};
use scan_check::offsets_of_scans;
pub use scan_offsets::ScanOffsets;
use scan_pairs::{scan_correspondences, scan_pairs};
use scan_source::ScanSource;
use weights::{Contradicted, Weights, lidar_residuals};

/// Where Eq. (4) has the rig's poses from at first.
#[derive(Clone, Copy, Debug)]
pub enum Start<'a> {
    /// The odometry, and loops where the settings ask for them.
    Odometry,
    /// Another program's SLAM: poses of the rig in a world with z upwards. How well it knows the motion from one keyframe to the next is taken
    /// from the settings, as the odometry's is, and counts less as soon as scans and images contradict it.
    Given(&'a Trajectory),
}

/// What a map is made of.
#[derive(Clone, Copy)]
pub struct Inputs<'a> {
    /// Images, and scans unless these are stored.
    pub recording: &'a Recording,
    /// Where the rig's poses are from at first.
    pub start: Start<'a>,
    /// Its scans as the odometry stored them, instead of those of the recording: for planes and edges of Eq. (4), and to be held against the finished map. How scans
    /// agree with one another along their beams is seen by those of the recording in any case.
    pub clouds: Option<&'a StoredClouds>,
    /// Surveyed marks that hold the map in a site's frame, and clicks on them.
    pub control: Option<&'a Control>,
}

impl<'a> Inputs<'a> {
    /// A recording alone, with the odometry to start from.
    pub fn of(recording: &'a Recording) -> Self {
        Self {
            recording,
            start: Start::Odometry,
            clouds: None,
            control: None,
        }
    }
}

/// Rounds of correspondences and Eq. (4) from such a start, at most; from the odometry the settings say how many.
const GIVEN_ROUNDS: usize = 10;
/// Least share of the scans that a trajectory to start from must reach.
const LEAST_REACHED: f64 = 0.5;

/// A map and how it was made.
#[derive(Clone, Debug)]
pub struct MappingResult {
    /// The map.
    pub map: HdMap,
    /// The odometry's trajectory, bent through the optimised keyframes.
    pub trajectory: Trajectory,
    /// What happened.
    pub report: MappingReport,
}

/// Builds the HD map of a recording; a hash of what it was built from is kept in it.
///
/// Missing or feature-poor cameras are warned of; without any camera, LiDAR or rig it is an error, and so is a map with hardly a
/// point.
pub fn build_map(
    recording: &Recording,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<MappingResult, Error> {
    build_map_in_stages(
        &Inputs::of(recording),
        config,
        &KeptStages::none(),
        progress,
    )
}

/// [`build_map`] that goes on behind the stages that are kept already, and keeps those it finishes: the odometry, the features of the
/// images, each round of Eq. (4), its result. The map is the same bit for bit. Stages of other inputs must not be among them.
pub fn build_map_in_stages(
    inputs: &Inputs<'_>,
    config: &MappingConfig,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<MappingResult, Error> {
    config.check_bounds("mapping")?;
    let Inputs {
        recording,
        start,
        clouds,
        control,
    } = *inputs;
    let source = clouds.map_or(ScanSource::Recorded(recording), ScanSource::Stored);
    let rig = recording.rig()?;
    let mut report = MappingReport::default();
    let cameras = find_cameras(recording, &rig, &mut report.warnings)?;
    // Before anything that takes a while.
    let imu = RecordedImu::read(recording, &rig, config)?;
    let (trajectory, by_odometry) = match start {
        Start::Odometry => stages.once("odometry", || walk(recording, config, progress))?,
        Start::Given(given) => (given.clone(), reached(recording, given)?),
    };
    report.odometry = by_odometry.odometry;
    report.warnings.extend(by_odometry.warnings);
    report.loops = by_odometry.loops;
    report.warnings.extend(clouds.and_then(|clouds| {
        let scans = scan_count(recording);
        let missing = scans.saturating_sub(clouds.scan_count());
        (missing > 2).then_some(MappingWarning::CloudsPartial { missing, scans })
    }));
    if let (Start::Given(_), Some(imu)) = (&start, &imu) {
        // Of its own start the odometry has said so.
        let damaged = (imu.damaged > 0).then(|| MappingWarning::Damaged {
            what: format!("{} IMU samples could not be read", imu.damaged),
        });
        report.warnings.extend(damaged);
    }
    let detector = FeatureDetector::new(&config.sift, config.learned.as_ref())?;
    let (mut keyframes, damaged) = stages.once("images", || {
        let mut damages = Damages::default();
        let keyframes = choose_keyframes(
            recording,
            &cameras,
            &trajectory,
            &detector,
            config,
            &mut damages,
            progress,
        )?;
        Ok((keyframes, damages.into_sentences()))
    })?;
    if keyframes.images.is_empty() {
        return Err(Error::NoKeyframe {
            path: recording.path().to_owned(),
        });
    }
    let damaged = damaged.into_iter();
    report
        .warnings
        .extend(damaged.map(|what| MappingWarning::Damaged { what }));
    describe_images(&keyframes, &cameras, &mut report);
    let before = keyframes.poses();
    let regions = Regions::of(&before);
    let (optimised, mut report) = stages.once("adjusted", || {
        if let Some(lidar) = rig.lidar() {
            add_lidar_features(
                source,
                lidar,
                &mut keyframes.frames,
                &trajectory,
                config,
                progress,
            )?;
            if let Some(clouds) = clouds {
                let without = keyframes.frames.iter().filter(|k| k.lidar.is_none());
                clouds.expect_scans(without.count(), keyframes.frames.len())?;
            }
        }
        let with = |rig: &Rig,
                    name: &'static str,
                    trajectory: &Trajectory,
                    keyframes: &mut Keyframes,
                    report: &mut MappingReport| {
            let run = Run {
                source,
                given: matches!(start, Start::Given(_)),
                stages,
                name,
                control,
                imu: imu.as_ref(),
                regions: &regions,
            };
            optimise(rig, keyframes, trajectory, config, report, &run, progress)
        };
        let (mut optimised, shown) =
            with(&rig, "rounds", &trajectory, &mut keyframes, &mut report)?;
        let refined = shown.refined(&rig).filter(|_| config.refine_cameras);
        if let Some(refined) = refined {
            let taken = report.cameras.iter().filter(|error| error.is_refinable());
            report.refined = taken.cloned().collect();
            report
                .warnings
                .retain(|warning| !warning.is_of_adjustment());
            let now = correct_trajectory(&trajectory, &before, &optimised.poses);
            (optimised, _) = with(
                &refined,
                "rounds-refined",
                &now,
                &mut keyframes,
                &mut report,
            )?;
            optimised.refined = Some(refined.to_toml());
        }
        Ok((optimised, std::mem::take(&mut report)))
    })?;
    let Optimised {
        poses,
        points,
        covariances,
        refined,
        site,
    } = optimised;
    let mut poses = poses;
    let mut points = points;
    let mut stated = BTreeMap::new();
    let map_rig = match &refined {
        Some(text) => {
            Rig::from_toml(text, "refined cameras").map_err(lsfb_recording::Error::from)?
        }
        None => rig.clone(),
    };
    for error in &report.refined {
        let camera = rig.cameras.get(&error.camera).cloned();
        stated.extend(camera.map(|camera| (error.camera.clone(), camera)));
    }
    let trajectory_before = trajectory;
    let mut trajectory = correct_trajectory(&trajectory_before, &before, &poses);
    let (agreement, gap) = stages.once("surface", || {
        look_at_scans(recording, &rig, &trajectory, config, progress)
    })?;
    report.agreement = agreement;
    if let Some(lidar) = rig.lidar() {
        report.scan_offsets = stages.once("scan-offsets", || {
            keyframes.place(&poses);
            let frames = &mut keyframes.frames;
            let total = scan_count(recording);
            offsets_of_scans(source, total, lidar, frames, &trajectory, config, progress)
        })?;
    }
    report
        .warnings
        .extend(gap.map(|(after_secs, secs)| MappingWarning::ScanGap { after_secs, secs }));
    let site = site.map(|(site, site_from_world)| {
        poses = moved(poses.iter(), &site_from_world);
        trajectory = Trajectory::new(moved(trajectory.poses().iter(), &site_from_world));
        for point in &mut points {
            point.point_in_world = site_from_world * point.point_in_world;
        }
        for region in &mut report.by_region {
            region.center_m = (site_from_world * Vector3::from(region.center_m)).into();
        }
        site
    });
    let content = MapContent {
        rig: &map_rig,
        keyframes: &poses,
        images: &keyframes.images,
        points: &points,
        feature: &detector.feature(),
        provenance: &walk_hash(&rig, &trajectory_before, control),
    };
    let findings = report.findings();
    let failed = findings.iter().filter(|f| f.verdict == Verdict::Fail);
    let failures = failed.map(Finding::sentence).collect();
    Ok(MappingResult {
        map: HdMap::build(&content, &config.map, progress)?
            .with_failures(failures)
            .with_stated_cameras(stated)
            .with_keyframe_covariances(covariances)
            .with_site(site),
        trajectory,
        report,
    })
}

/// Longest time between two scans that says nothing, seconds: somebody walks a step, and has the motion of the IMU for it.
const USUAL_GAP_S: f64 = 1.0;
/// Scans may be rarer where they always are.
const USUAL_PERIODS: f64 = 5.0;

/// When a time without a scan began, and how long it was, seconds.
type Gap = (f64, f64);

/// How well all scans agree with one another at the poses of the finished map (`None` without a LiDAR), and when after the first
/// the longest time without a scan began and how long that is, seconds, where it is long.
fn look_at_scans(
    recording: &Recording,
    rig: &Rig,
    world_from_rig: &Trajectory,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<(Option<Agreement>, Option<Gap>), Error> {
    let surface = SurfaceConfig {
        min_range_m: config.odometry.min_range_m,
        ..SurfaceConfig::default()
    };
    let Some(mut builder) = SurfaceBuilder::new(rig, &surface) else {
        return Ok((None, None));
    };
    let total = scan_count(recording);
    let mut times = Vec::new();
    let mut done = 0;
    read_ahead(
        || recording.scans(),
        |scan| {
            progress(Progress {
                stage: "agreement of scans",
                done,
                total,
            })?;
            done += 1;
            // Damaged ones are told by the stages before.
            let whole = scan.ok();
            let inserted = whole.filter(|scan| builder.insert(scan, world_from_rig));
            times.extend(inserted.map(|scan| scan.time));
            Ok(())
        },
    )?;
    let agreement = *builder.finish().agreement();
    let periods = times.windows(2).map(|t| t[1].secs_since(t[0]));
    let usual_s = median(periods.clone().collect()).unwrap_or(0.0);
    let since_first = times.iter().map(|time| time.secs_since(times[0]));
    let gaps = since_first.zip(periods);
    let longest = gaps.max_by(|a, b| a.1.total_cmp(&b.1));
    let limit_s = USUAL_GAP_S.max(USUAL_PERIODS * usual_s);
    Ok((Some(agreement), longest.filter(|(_, secs)| *secs > limit_s)))
}

/// Where the rig went: by the odometry, and by loops where these are asked for. The report has what both say of it.
fn walk(
    recording: &Recording,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<(Trajectory, MappingReport), Error> {
    let mut report = MappingReport::default();
    let mut odometry = run_odometry(recording, &config.odometry, progress)?;
    if config.close_loops {
        let loops = find_loops(&odometry, &config.odometry, progress)?;
        report.loops = Some(close_loops(&mut odometry, &loops, progress)?);
    }
    report.odometry = odometry.report;
    Ok((odometry.trajectory, report))
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

/// What is to be said of a trajectory to start from; refused where it is hardly of this recording.
fn reached(recording: &Recording, given: &Trajectory) -> Result<MappingReport, Error> {
    let (mut scans, mut reached) = (0u64, 0u64);
    let mut damages = Damages::default();
    for scan in recording.scans()?.filter_map(|scan| damages.keep(scan)) {
        scans += 1;
        reached += u64::from(given.at(scan.time).is_some());
    }
    let share = reached as f64 / scans.max(1) as f64;
    if share < LEAST_REACHED {
        return Err(Error::StartElsewhere {
            path: recording.path().to_owned(),
            share,
        });
    }
    let missing = scans - reached;
    // The first scan may begin before the first pose.
    let partial = (missing > 2).then_some(MappingWarning::StartPartial { missing, scans });
    let begin = given.poses().first().map(|pose| pose.time);
    let holes = given.holes().filter_map(|[start, end]| {
        Some(MappingWarning::StartHole {
            after_secs: start.time.secs_since(begin?),
            secs: end.time.secs_since(start.time),
        })
    });
    let damaged = damages.into_sentences().into_iter();
    let damaged = damaged.map(|what| MappingWarning::Damaged { what });
    Ok(MappingReport {
        warnings: partial.into_iter().chain(holes).chain(damaged).collect(),
        ..MappingReport::default()
    })
}

/// Poses in a frame that the world lies in.
fn moved<'a>(
    poses: impl Iterator<Item = &'a StampedPose>,
    frame_from_world: &Se3,
) -> Vec<StampedPose> {
    poses
        .map(|pose| StampedPose {
            time: pose.time,
            world_from_rig: *frame_from_world * pose.world_from_rig,
        })
        .collect()
}

/// SHA-256 of the rig, the walk and what holds it, as hexadecimal digits. Not of the recording: that holds arrival times, and the same
/// walk would give another map each time it is recorded.
fn walk_hash(rig: &Rig, odometry: &Trajectory, control: Option<&Control>) -> String {
    let mut hash = Sha256::new();
    hash.update(rig.to_toml());
    for StampedPose {
        time,
        world_from_rig: pose,
    } in odometry.poses()
    {
        hash.update(time.nanos().to_le_bytes());
        let numbers = pose.rotation.coords.iter().chain(pose.translation.iter());
        numbers.for_each(|v| hash.update(v.to_le_bytes()));
    }
    control.iter().for_each(|control| control.add_to(&mut hash));
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

/// What Eq. (4) made of tracks and scans.
struct Optimised {
    /// Of the keyframes.
    poses: Vec<StampedPose>,
    points: Vec<MapPoint>,
    /// Of the keyframes; none at all where the measurements do not determine them.
    covariances: Vec<Option<Matrix6<f64>>>,
    /// The rig file with cameras as the images show them, where some were taken so.
    refined: Option<String>,
    /// The surveyed frame that control points put the map into, and the world in that.
    site: Option<(SiteFrame, Se3)>,
}

/// What rounds of Eq. (4) read, where they are kept, and under which name.
struct Run<'a> {
    source: ScanSource<'a>,
    /// Whether the start is another program's.
    given: bool,
    stages: &'a KeptStages,
    name: &'static str,
    control: Option<&'a Control>,
    imu: Option<&'a RecordedImu>,
    regions: &'a Regions,
}

/// Where Eq. (4) stands behind one of its rounds.
struct Rounds {
    /// Rounds that are finished.
    done: usize,
    /// Rounds there are at most.
    most: usize,
    /// Of the keyframes.
    poses: Vec<StampedPose>,
    /// Where the keyframes were when images were matched last.
    matched: Vec<StampedPose>,
    /// How much the start is contradicted.
    contradicted: Contradicted,
    /// The control points that hold the map, once it was at rest without them.
    hold: Option<Hold>,
    /// What is found beside the poses, where the IMU takes part.
    inertial: Option<InertialEstimate>,
    /// The report so far.
    told: MappingReport,
}

/// Images are matched where the poses have them, and scans joined along the way between keyframes: once a keyframe has moved or turned this much both are done
/// anew, metres and radians. A pixel of a wide camera, or its view of a wall.
const MATCHED_M: f64 = 0.03;
const MATCHED_RAD: f64 = 0.005;

/// Keyframes that move and turn less from one round to the next rest, metres and degrees.
const RESTING_M: f64 = 1e-3;
const RESTING_DEG: f64 = 0.02;

/// How far poses have moved and turned at most: metres, radians.
fn largest_move(from: &[StampedPose], to: &[StampedPose]) -> [f64; 2] {
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
fn optimise(
    rig: &Rig,
    keyframes: &mut Keyframes,
    trajectory: &Trajectory,
    config: &MappingConfig,
    report: &mut MappingReport,
    run: &Run<'_>,
    progress: ProgressFn<'_>,
) -> Result<(Optimised, ShownCameras), Error> {
    let odometry = &keyframes.poses();
    let blind_s = blind_secs(odometry, trajectory, &report.odometry.gaps);
    let pairs = scan_pairs(&keyframes.frames, config);
    let max_px = config.max_reprojection_px;
    let imu = run
        .imu
        .map(|imu| imu.between(odometry, trajectory, &report.odometry))
        .transpose()?;
    let term_at = |estimate: &Option<InertialEstimate>| {
        let both = imu.as_ref().zip(estimate.as_ref());
        both.map(|(imu, estimate)| imu.term(estimate)).transpose()
    };
    let mut inertial = imu.as_ref().map(|imu| imu.start.clone());
    let mut contradicted = Contradicted::default();
    let mut matched = odometry.clone();
    let mut current = odometry.clone();
    let mut round = 0;
    let marks = run
        .control
        .map(|c| Marks::find(c, rig, trajectory, odometry));
    let mut hold: Option<Hold> = None;
    report.control = None;
    let mut most_rounds = match run.given {
        true => config.outer_iterations.max(GIVEN_ROUNDS),
        false => config.outer_iterations.max(1),
    };
    let rounds_of_start = most_rounds;
    if let Some(rounds) = run.stages.get::<Rounds>(run.name)
        && rounds.poses.len() == keyframes.frames.len()
        && rounds.matched.len() == keyframes.frames.len()
    {
        (round, most_rounds) = (rounds.done, rounds.most);
        (current, hold) = (rounds.poses, rounds.hold);
        (matched, contradicted) = (rounds.matched, rounds.contradicted);
        inertial = rounds.inertial;
        *report = rounds.told;
    }
    let look_at = |poses: &[StampedPose], keyframes: &mut Keyframes| {
        if poses != odometry.as_slice()
            && let Some(lidar) = rig.lidar()
        {
            let now = correct_trajectory(trajectory, odometry, poses);
            let frames = &mut keyframes.frames;
            add_lidar_features(run.source, lidar, frames, &now, config, progress)?;
        }
        let images = &keyframes.images;
        find_tracks(rig, poses, images, &config.reconstruction, progress)
    };
    keyframes.place(&matched);
    let mut tracks = look_at(&matched, &mut *keyframes)?;
    keyframes.place(&current);
    // What the last round has.
    let (mut points, mut weights);
    let mut scans = Vec::new();
    let mut in_site: Option<SolvedControl>;
    loop {
        let [moved_m, turned_rad] = largest_move(&matched, &keyframes.poses());
        let has_left = moved_m > MATCHED_M || turned_rad > MATCHED_RAD;
        if (run.given || hold.is_some()) && has_left {
            matched = keyframes.poses();
            tracks = look_at(&matched, &mut *keyframes)?;
        }
        points = triangulate_round(rig, keyframes, &tracks, round, config)?;
        // Not beside those that come: of a long walk a gigabyte.
        scans.clear();
        scans = scan_correspondences(&keyframes.frames, &pairs, config);
        let lidar = lidar_residuals(&keyframes.frames, &scans);
        let errors_px = observation_errors_px(rig, keyframes, &points);
        if report.rounds.is_empty() {
            let measured = Measured {
                keyframes,
                errors: track_errors(rig, keyframes, &points, &tracks),
                scans: &scans,
                max_px,
            };
            let errors_px = measured.put(run.regions, Moment::Before, report);
            let errors = ErrorSummary::of(&errors_px, max_px);
            report.reprojection_rms_before_px = errors.rms_px;
            report.reprojection_median_before_px = errors.median_px;
            report.lidar_before = lidar;
        }
        weights = Weights {
            contradicted,
            ..Weights::estimate(&lidar, &errors_px, &config.correlation)
        };
        let before = keyframes.poses();
        let control = marks.as_ref().zip(hold.as_ref()).and_then(|(marks, hold)| {
            let placed = marks.place(rig, &before, &config.control);
            marks.terms(&placed, Some(hold))
        });
        let term = term_at(&inertial)?;
        let terms = Terms {
            scans: &scans,
            odometry,
            blind_s: &blind_s,
            weights,
            control: control.as_ref(),
            imu: term.as_ref(),
        };
        let solved;
        Adjusted {
            report: solved,
            control: in_site,
            inertial,
        } = adjust(rig, keyframes, &mut points, &terms, config, progress)?;
        drop_misplaced(
            rig,
            keyframes,
            &mut points,
            &config.reconstruction.triangulation,
        );
        let poses = keyframes.poses();
        if let (Some(hold), Some(in_site)) = (&mut hold, &in_site) {
            hold.centred_from_world = in_site.centred_from_world;
        }
        let [moved_m, turned_rad] = largest_move(&before, &poses);
        // The odometry knows how well it knows its motion: wrong cameras must not talk it out of that.
        if run.given {
            contradicted = contradicted.seen(odometry, &poses, config);
        }
        let done = RoundReport {
            plane_matches: lidar.plane_matches,
            edge_matches: lidar.edge_matches,
            observations: points.iter().map(|p| p.observations.len() as u64).sum(),
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
        report.rounds.push(done);
        report.lidar_after = lidar_residuals(&keyframes.frames, &scans);
        round += 1;
        let mut is_last = rests || round >= most_rounds;
        if let (true, Some(marks), None) = (is_last, &marks, &report.control) {
            // Held against the map before they pull at it.
            let placed = marks.place(rig, &poses, &config.control);
            let placing = marks.terms(&placed, None);
            let term = term_at(&inertial)?;
            let checked = Checked {
                rig,
                keyframes,
                tracks: &tracks,
                trajectory,
                terms: Terms {
                    scans: &scans,
                    odometry,
                    blind_s: &blind_s,
                    weights,
                    control: placing.as_ref(),
                    imu: term.as_ref(),
                },
            };
            let covariance_m2 = match &placing {
                Some(_) => mark_covariance(&checked, &points, config)?,
                None => None,
            };
            let (held, said) = marks.decide(&placed, covariance_m2.as_ref(), &config.control);
            report.control = Some(said);
            is_last = held.is_none();
            hold = held;
            most_rounds = round + rounds_of_start;
        }
        if is_last {
            // From the odometry few rounds are made: what moves images beyond their matches is too much for that.
            let moves = moved_m > MATCHED_M || turned_rad > MATCHED_RAD;
            if !rests && (run.given || moves) {
                report.warnings.push(MappingWarning::NotAtRest {
                    rounds: round as u64,
                    moved_m,
                    turned_deg: turned_rad.to_degrees(),
                });
            }
            break;
        }
        let rounds = Rounds {
            done: round,
            most: most_rounds,
            poses,
            matched: matched.clone(),
            contradicted,
            hold: hold.clone(),
            inertial: inertial.clone(),
            told: report.clone(),
        };
        run.stages.keep(run.name, &rounds)?;
    }
    report.tracks = tracks.len() as u64;
    if !config.terms.images {
        points = triangulate_round(rig, keyframes, &tracks, 1, config)?;
    }
    let placed = marks
        .as_ref()
        .map(|marks| marks.place(rig, &keyframes.poses(), &config.control));
    let held = marks.as_ref().zip(placed.as_ref()).zip(hold.as_ref());
    let control = held.and_then(|((marks, placed), hold)| marks.terms(placed, Some(hold)));
    let mut site = None;
    if let (Some(((marks, placed), hold)), Some(said)) = (held, &mut report.control) {
        match &in_site {
            Some(in_site) => {
                marks.say_after(said, placed, in_site);
                site = Some(marks.site(hold));
            }
            None => said.lost(),
        }
    }
    let term = term_at(&inertial)?;
    report.imu = term.as_ref().map(|term| term.report(&keyframes.poses()));
    let checked = Checked {
        rig,
        keyframes,
        tracks: &tracks,
        trajectory,
        terms: Terms {
            scans: &scans,
            odometry,
            blind_s: &blind_s,
            weights,
            control: control.as_ref(),
            imu: term.as_ref(),
        },
    };
    let shown = camera_errors(&checked, config, progress)?.unwrap_or_else(|warning| {
        report.warnings.push(warning);
        ShownCameras::none(rig)
    });
    report.cameras = shown.errors.clone();
    let factor = hold.as_ref().map_or(1.0, |hold| hold.map_factor);
    let covariances = match pose_covariances(&checked, &points, config, progress)? {
        Ok(known) => known
            .into_iter()
            .map(|c| Some(c * factor * factor))
            .collect(),
        Err(warning) => {
            report.warnings.push(warning);
            Vec::new()
        }
    };
    let measured = Measured {
        keyframes,
        errors: track_errors(rig, keyframes, &points, &tracks),
        scans: &scans,
        max_px,
    };
    report.reprojection_errors_px = measured.put(run.regions, Moment::After, report);
    let errors = ErrorSummary::of(&report.reprojection_errors_px, max_px);
    report.reprojection_rms_px = errors.rms_px;
    report.reprojection_median_px = errors.median_px;
    report.outlier_share = errors.share_beyond;
    drop_outliers(rig, keyframes, &mut points, max_px);
    put_coverage(run.regions, keyframes, &points, &mut report.by_region);
    report.points = points.len() as u64;
    report.observations = points.iter().map(|p| p.observations.len() as u64).sum();
    let all = report.reprojection_errors_px.len() as u64;
    report.dropped_observations = all - report.observations.min(all);
    if errors.share_beyond > USUAL_OUTLIER_SHARE {
        report.warnings.push(MappingWarning::ManyOutliers {
            share: errors.share_beyond,
            max_px,
        });
    }
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

/// Points at the current poses: of observations far off while the poses are still wrong, of close ones later.
fn triangulate_round(
    rig: &Rig,
    keyframes: &Keyframes,
    tracks: &[Track],
    round: usize,
    config: &MappingConfig,
) -> Result<Vec<MapPoint>, Error> {
    let slack = if round == 0 { 3.0 } else { 1.0 };
    let triangulation = TriangulationConfig {
        max_reprojection_px: slack * config.reconstruction.triangulation.max_reprojection_px,
        ..config.reconstruction.triangulation.clone()
    };
    let poses = keyframes.poses();
    let mut points = triangulate_tracks(rig, &poses, &keyframes.images, tracks, &triangulation)?;
    drop_misplaced(rig, keyframes, &mut points, &triangulation);
    Ok(points)
}

/// What stands nearer before a lens is a wrong match, metres: it would count as a measurement of micrometres, and leave the pose of
/// its camera undetermined beside all others.
const LEAST_DEPTH_M: f64 = 0.1;

/// Takes out points before a lens, and those so far away that they have no place.
fn drop_misplaced(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &mut Vec<MapPoint>,
    config: &TriangulationConfig,
) {
    points.retain(|point| {
        let cameras = keyframes.cameras_of(rig, point);
        keyframes.nearest_camera_m(rig, point) >= LEAST_DEPTH_M
            && !has_no_place(&point.point_in_world, cameras, config)
    });
}

/// The odometry's trajectory bent through the optimised keyframes.
fn correct_trajectory(
    odometry: &Trajectory,
    before: &[StampedPose],
    keyframes: &[StampedPose],
) -> Trajectory {
    let after: Vec<Se3> = keyframes.iter().map(|k| k.world_from_rig).collect();
    let corrected = odometry.poses().iter().map(|pose| StampedPose {
        time: pose.time,
        world_from_rig: bent(pose, before, &after),
    });
    Trajectory::new(corrected.collect())
}
