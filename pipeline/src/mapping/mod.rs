#![doc = include_str!("README.md")]

mod adjustment;
mod camera_error;
mod config;
mod image_check;
mod kept;
mod keyframe_scans;
mod keyframes;
mod pose_covariance;
mod report;
mod reprojection_errors;
mod rig_check;
mod scan_pairs;
mod weights;

#[cfg(test)]
mod tests;

use lsfb_geometry::{Matrix6, Rig, Se3, StampedPose, Trajectory};
use lsfb_recording::Recording;
use lsfb_types::{Finding, ProgressFn, Verdict};
use sha2::{Digest, Sha256};

use crate::bending::bent;
use crate::error::Error;
use crate::features::FeatureDetector;
use crate::features::tracks::Track;
use crate::features::triangulation::TriangulationConfig;
use crate::hd_map::{HdMap, MapContent, MapPoint, expect_map, find_tracks, triangulate_tracks};
use crate::kept_stages::KeptStages;
use crate::loops::{close_loops, find_loops};
use crate::odometry::{Damages, run_odometry};
use adjustment::{Terms, adjust};
pub use camera_error::CameraError;
pub use config::{CorrelationConfig, MappingConfig, TermConfig};
use image_check::describe_images;
use keyframe_scans::add_lidar_features;
use keyframes::{Keyframes, choose_keyframes, find_cameras};
use pose_covariance::pose_covariances;
use report::USUAL_OUTLIER_SHARE;
pub use report::{LidarResiduals, MappingReport, MappingWarning, RoundReport};
use reprojection_errors::{ErrorSummary, drop_outliers, observation_errors_px, track_errors_px};
use rig_check::{Checked, camera_errors};
use scan_pairs::{scan_correspondences, scan_pairs};
use weights::{Weights, lidar_residuals};

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
    build_map_in_stages(recording, config, &KeptStages::none(), progress)
}

/// [`build_map`] that goes on behind the stages that are kept already, and keeps those it finishes: the odometry, the features of the
/// images, each round of Eq. (4), its result. The map is the same bit for bit.
pub fn build_map_in_stages(
    recording: &Recording,
    config: &MappingConfig,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<MappingResult, Error> {
    config.check_bounds("mapping")?;
    let rig = recording.rig()?;
    let mut report = MappingReport::default();
    let cameras = find_cameras(recording, &rig, &mut report.warnings)?;
    let (trajectory, by_odometry) =
        stages.once("odometry", || walk(recording, config, progress))?;
    report.odometry = by_odometry.odometry;
    report.loops = by_odometry.loops;
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
    let (optimised, report) = stages.once("adjusted", || {
        if let Some(lidar) = rig.lidar() {
            add_lidar_features(
                recording,
                lidar,
                &mut keyframes.frames,
                &trajectory,
                config,
                progress,
            )?;
        }
        let optimised = optimise(
            &rig,
            &mut keyframes,
            &trajectory,
            config,
            &mut report,
            stages,
            progress,
        )?;
        Ok((optimised, std::mem::take(&mut report)))
    })?;
    let Optimised {
        poses,
        points,
        covariances,
    } = optimised;
    let content = MapContent {
        rig: &rig,
        keyframes: &poses,
        images: &keyframes.images,
        points: &points,
        feature: &detector.feature(),
        provenance: &walk_hash(&rig, &trajectory),
    };
    let findings = report.findings();
    let failed = findings.iter().filter(|f| f.verdict == Verdict::Fail);
    let failures = failed.map(Finding::sentence).collect();
    Ok(MappingResult {
        map: HdMap::build(&content, &config.map, progress)?
            .with_failures(failures)
            .with_keyframe_covariances(covariances),
        trajectory: correct_trajectory(&trajectory, &before, &poses),
        report,
    })
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

/// SHA-256 of the rig and the walk, as hexadecimal digits. Not of the recording: that holds arrival times, and the same
/// walk would give another map each time it is recorded.
fn walk_hash(rig: &Rig, odometry: &Trajectory) -> String {
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
    hash.finalize().iter().map(|b| format!("{b:02x}")).collect()
}

/// What Eq. (4) made of tracks and scans.
struct Optimised {
    /// Of the keyframes.
    poses: Vec<StampedPose>,
    points: Vec<MapPoint>,
    /// Of the keyframes; none at all where the measurements do not determine them.
    covariances: Vec<Option<Matrix6<f64>>>,
}

/// Where Eq. (4) stands behind one of its rounds.
struct Rounds {
    /// Rounds that are finished.
    done: usize,
    /// Of the keyframes.
    poses: Vec<StampedPose>,
    /// The report so far.
    told: MappingReport,
}

/// Alternates new correspondences with Eq. (4) until the keyframes rest.
fn optimise(
    rig: &Rig,
    keyframes: &mut Keyframes,
    trajectory: &Trajectory,
    config: &MappingConfig,
    report: &mut MappingReport,
    stages: &KeptStages,
    progress: ProgressFn<'_>,
) -> Result<Optimised, Error> {
    let odometry = &keyframes.poses();
    let tracks = find_tracks(
        rig,
        odometry,
        &keyframes.images,
        &config.reconstruction,
        progress,
    )?;
    report.tracks = tracks.len() as u64;
    let pairs = scan_pairs(&keyframes.frames, config);
    let max_px = config.max_reprojection_px;
    let (mut points, mut scans, mut weights) = (Vec::new(), Vec::new(), Weights::default());
    let mut first_round = 0;
    if let Some(Rounds { done, poses, told }) = stages.get("rounds")
        && poses.len() == keyframes.frames.len()
    {
        first_round = done;
        keyframes.place(&poses);
        *report = told;
    }
    for round in first_round..config.outer_iterations.max(1) {
        points = triangulate_round(rig, keyframes, &tracks, round, config)?;
        scans = scan_correspondences(&keyframes.frames, &pairs, config);
        let lidar = lidar_residuals(&keyframes.frames, &scans);
        let errors_px = observation_errors_px(rig, keyframes, &points);
        if round == 0 {
            let errors_px = track_errors_px(rig, keyframes, &points, &tracks);
            let errors = ErrorSummary::of(&errors_px, max_px);
            report.reprojection_rms_before_px = errors.rms_px;
            report.reprojection_median_before_px = errors.median_px;
            report.lidar_before = lidar;
        }
        weights = Weights::estimate(&lidar, &errors_px, &config.correlation);
        let terms = Terms {
            scans: &scans,
            odometry,
            weights,
        };
        let before = keyframes.poses();
        let solved = adjust(rig, keyframes, &mut points, &terms, config, progress)?;
        let moves = keyframes
            .frames
            .iter()
            .zip(&before)
            .map(|(k, b)| b.world_from_rig.inverse() * k.world_from_rig);
        let mut done = RoundReport {
            plane_matches: lidar.plane_matches,
            edge_matches: lidar.edge_matches,
            observations: points.iter().map(|p| p.observations.len() as u64).sum(),
            plane_sigma_m: weights.plane_sigma_m,
            edge_sigma_m: weights.edge_sigma_m,
            pixel_sigma_px: weights.pixel_sigma_px,
            initial_cost: solved.initial_cost,
            final_cost: solved.final_cost,
            iterations: solved.iterations as u64,
            ..RoundReport::default()
        };
        for moved in moves {
            done.moved_m = done.moved_m.max(moved.translation.norm());
            done.turned_deg = done.turned_deg.max(moved.rotation.angle().to_degrees());
        }
        let rests = done.moved_m < 1e-3 && done.turned_deg < 0.02;
        report.rounds.push(done);
        report.lidar_after = lidar_residuals(&keyframes.frames, &scans);
        if rests || round + 1 == config.outer_iterations {
            break;
        }
        let rounds = Rounds {
            done: round + 1,
            poses: keyframes.poses(),
            told: report.clone(),
        };
        stages.keep("rounds", &rounds)?;
    }
    if !config.terms.images {
        points = triangulate_round(rig, keyframes, &tracks, 1, config)?;
    }
    let checked = Checked {
        rig,
        keyframes,
        tracks: &tracks,
        trajectory,
        terms: Terms {
            scans: &scans,
            odometry,
            weights,
        },
    };
    report.cameras = camera_errors(&checked, config, progress)?;
    let covariances = match pose_covariances(&checked, &points, config, progress)? {
        Ok(known) => known.into_iter().map(Some).collect(),
        Err(warning) => {
            report.warnings.push(warning);
            Vec::new()
        }
    };
    report.reprojection_errors_px = track_errors_px(rig, keyframes, &points, &tracks);
    let errors = ErrorSummary::of(&report.reprojection_errors_px, max_px);
    report.reprojection_rms_px = errors.rms_px;
    report.reprojection_median_px = errors.median_px;
    report.outlier_share = errors.share_beyond;
    drop_outliers(rig, keyframes, &mut points, max_px);
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
    Ok(Optimised {
        poses: keyframes.poses(),
        points,
        covariances,
    })
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
    triangulate_tracks(rig, &poses, &keyframes.images, tracks, &triangulation)
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
