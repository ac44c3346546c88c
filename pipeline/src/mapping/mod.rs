#![doc = include_str!("README.md")]

mod adjustment;
mod camera_error;
mod config;
mod control;
mod first_equation;
mod image_check;
mod inertial;
mod kept;
mod keyframe_scans;
mod keyframes;
mod matched;
mod placed_points;
mod pose_covariance;
mod posed_scans;
mod report;
mod residuals;
mod residuals_by_part;
mod rig_check;
mod rounds;
mod scan_check;
mod scan_offsets;
mod scan_pairs;
mod scan_source;
mod weights;

#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use lsfb_geometry::{Rig, Se3, StampedPose, Trajectory, Vector3};
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_types::{Finding, Progress, ProgressFn, Verdict};
use sha2::{Digest, Sha256};

use crate::bending::bent;
use crate::error::{Error, Refusal};
use crate::features::FeatureDetector;
use crate::hd_map::{HdMap, MapContent};
use crate::kept_stages::KeptStages;
use crate::loops::{close_loops, find_loops};
use crate::odometry::{Damages, run_odometry, scan_count};
use crate::read_ahead::read_ahead;
use crate::stored_clouds::StoredClouds;
use crate::surface::{Agreement, SurfaceBuilder, SurfaceConfig};
pub use camera_error::CameraError;
pub use config::{CorrelationConfig, MappingConfig, TermConfig};
pub use control::{Control, ControlConfig, ControlMark, ControlReport};
pub use first_equation::write_first_equation;
use image_check::describe_images;
pub use inertial::InertialReport;
use inertial::RecordedImu;
use keyframe_scans::add_lidar_features;
use keyframes::{Keyframes, choose_keyframes, find_cameras};
pub use posed_scans::{PosedScan, RefinedScans, ScanPoseConfig, ScanPoseReport, refine_scan_poses};
use report::LONGEST_WITHOUT_LOOP_M;
pub use report::{MappingReport, MappingWarning, RoundReport};
pub use residuals::{LidarResiduals, RegionResiduals};
use residuals_by_part::Regions;
use rounds::{Optimised, Run, optimise};
use scan_check::offsets_of_scans;
pub use scan_offsets::ScanOffsets;
use scan_pairs::longest_without_loop_m;
use scan_source::ScanSource;

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
        return Err(Refusal::NoKeyframe {
            path: recording.path().to_owned(),
        }
        .into());
    }
    let damaged = damaged.into_iter();
    report
        .warnings
        .extend(damaged.map(|what| MappingWarning::Damaged { what }));
    describe_images(&keyframes, &cameras, &mut report);
    let before = keyframes.poses();
    let open_m = longest_without_loop_m(&before, config);
    if open_m > LONGEST_WITHOUT_LOOP_M && control.is_none() {
        report.warnings.push(MappingWarning::NoLoops {
            open_m,
            within_m: config.revisit_distance_m,
        });
    }
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
        return Err(Refusal::StartElsewhere {
            path: recording.path().to_owned(),
            share,
            least: LEAST_REACHED,
        }
        .into());
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
