//! From a backpack's recording to an HD map: odometry, keyframes, visual tracks, and Eq. (4) alternating with new
//! correspondences.

mod adjustment;
mod keyframe_scans;
mod keyframes;

#[cfg(test)]
mod tests;

use lsfb_geometry::{Rig, StampedPose, Trajectory};
use lsfb_recording::Recording;
use lsfb_solver::SolveConfig;
use lsfb_types::{Bounds, ProgressFn};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

use crate::Error;
use crate::features::SiftConfig;
use crate::features::tracks::Track;
use crate::features::triangulation::TriangulationConfig;
use crate::hd_map::{
    HdMap, HdMapConfig, MapContent, MapPoint, ReconstructionConfig, find_tracks, triangulate_tracks,
};
use crate::lidar_features::{Correspondences, LidarFeatureConfig};
use crate::odometry::{Damages, OdometryConfig, OdometryReport, run_odometry};
use adjustment::{
    ScanPair, adjust, drop_outliers, reprojection_errors_px, scan_correspondences, scan_pairs,
};
use keyframe_scans::add_lidar_features;
use keyframes::{Keyframe, Keyframes, choose_keyframes, find_cameras};

/// Parameters of the mapping.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MappingConfig {
    /// The odometry.
    pub odometry: OdometryConfig,
    /// Distance between keyframes, metres.
    pub keyframe_distance_m: f64,
    /// Angle between keyframes, degrees.
    pub keyframe_angle_deg: f64,
    /// Image features.
    pub sift: SiftConfig,
    /// Image pairs, matching and triangulation.
    pub reconstruction: ReconstructionConfig,
    /// Descriptors and index of the map.
    pub map: HdMapConfig,
    /// LiDAR features and correspondences.
    pub lidar_features: LidarFeatureConfig,
    /// Weights of the LiDAR terms of Eq. (4).
    pub lidar_weights: LidarWeights,
    /// Scans this long before and after a keyframe make its LiDAR features, seconds.
    pub scan_window_secs: f64,
    /// Keyframes before each one that its scan is compared with.
    pub scan_neighbours: usize,
    /// Keyframes of earlier visits that its scan is compared with.
    pub scan_revisits: usize,
    /// Farthest such keyframe, metres.
    pub revisit_distance_m: f64,
    /// Standard deviation of a pixel coordinate, pixels.
    pub pixel_sigma_px: f64,
    /// Standard deviation of the odometry's rotation, degrees per square root of a second.
    pub odometry_rotation_sigma_deg: f64,
    /// Standard deviation of the odometry's translation, metres per square root of a second.
    pub odometry_translation_sigma_m: f64,
    /// How often correspondences are sought anew at most.
    pub outer_iterations: usize,
    /// Largest reprojection error of an observation in the map, pixels.
    pub max_reprojection_px: f64,
    /// When each minimisation stops.
    pub solver: SolveConfig,
}

/// Standard deviations of the LiDAR terms. The paper's Σp : Σe is 0.2 : 0.5; its absolute values leave the LiDAR no say
/// against pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct LidarWeights {
    /// Of a patch's distance from a plane, metres.
    pub plane_sigma_m: f64,
    /// Of an edge's distance from an edge, metres.
    pub edge_sigma_m: f64,
}

impl Default for LidarWeights {
    fn default() -> Self {
        Self {
            plane_sigma_m: 0.02,
            edge_sigma_m: 0.032,
        }
    }
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            odometry: OdometryConfig::default(),
            keyframe_distance_m: 0.35,
            keyframe_angle_deg: 20.0,
            sift: SiftConfig::default(),
            reconstruction: ReconstructionConfig::default(),
            map: HdMapConfig::default(),
            lidar_features: LidarFeatureConfig::default(),
            lidar_weights: LidarWeights::default(),
            scan_window_secs: 0.35,
            scan_neighbours: 2,
            scan_revisits: 3,
            revisit_distance_m: 2.0,
            pixel_sigma_px: 1.0,
            odometry_rotation_sigma_deg: 0.2,
            odometry_translation_sigma_m: 0.01,
            outer_iterations: 3,
            max_reprojection_px: 3.0,
            solver: SolveConfig {
                max_iterations: 20,
                cost_tolerance: 1e-5,
                ..SolveConfig::default()
            },
        }
    }
}

lsfb_types::bounds! {
    LidarWeights {
        plane_sigma_m: number(Bounds::POSITIVE),
        edge_sigma_m: number(Bounds::POSITIVE),
    }
}

lsfb_types::bounds! {
    MappingConfig {
        odometry: section,
        keyframe_distance_m: number(Bounds::POSITIVE),
        keyframe_angle_deg: number(Bounds::POSITIVE),
        sift: section,
        reconstruction: section,
        map: section,
        lidar_features: section,
        lidar_weights: section,
        scan_window_secs: number(Bounds::NOT_NEGATIVE),
        scan_neighbours: any,
        scan_revisits: any,
        revisit_distance_m: number(Bounds::NOT_NEGATIVE),
        pixel_sigma_px: number(Bounds::POSITIVE),
        odometry_rotation_sigma_deg: number(Bounds::POSITIVE),
        odometry_translation_sigma_m: number(Bounds::POSITIVE),
        outer_iterations: any,
        max_reprojection_px: number(Bounds::POSITIVE),
        solver: section,
    }
}

/// What the mapping says about its own result.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct MappingReport {
    /// The odometry's own report.
    pub odometry: OdometryReport,
    /// Keyframes.
    pub keyframes: u64,
    /// Images of the keyframes.
    pub images: u64,
    /// Features in those images.
    pub features: u64,
    /// Tracks before triangulation.
    pub tracks: u64,
    /// Points in the map.
    pub points: u64,
    /// Observations of those points.
    pub observations: u64,
    /// Observations left out of the map because their point is seen elsewhere.
    pub dropped_observations: u64,
    /// Root mean square reprojection error with the odometry's poses, pixels.
    pub reprojection_rms_before_px: f64,
    /// Median reprojection error with the odometry's poses, pixels.
    pub reprojection_median_before_px: f64,
    /// Root mean square reprojection error of the map, pixels.
    pub reprojection_rms_px: f64,
    /// Median reprojection error of the map, pixels.
    pub reprojection_median_px: f64,
    /// Reprojection error of every observation in the map, pixels.
    #[serde(skip)]
    pub reprojection_errors_px: Vec<f64>,
    /// What each round of correspondences and minimisation did.
    pub rounds: Vec<RoundReport>,
    /// What the reader should know.
    pub warnings: Vec<String>,
}

/// One round of new correspondences and Eq. (4).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RoundReport {
    /// Plane correspondences between keyframes.
    pub plane_matches: u64,
    /// Edge correspondences between keyframes.
    pub edge_matches: u64,
    /// Observations of points.
    pub observations: u64,
    /// Cost before.
    pub initial_cost: f64,
    /// Cost after.
    pub final_cost: f64,
    /// Linearizations.
    pub iterations: u64,
    /// Farthest that a keyframe moved, metres.
    pub moved_m: f64,
    /// Farthest that a keyframe turned, degrees.
    pub turned_deg: f64,
}

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
/// Missing or feature-poor cameras are warned of; without any camera, LiDAR or rig it is an error.
pub fn build_map(
    recording: &Recording,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<MappingResult, Error> {
    config.check_bounds("mapping")?;
    let rig = recording.rig()?;
    let mut report = MappingReport::default();
    let mut damages = Damages::default();
    let cameras = find_cameras(recording, &rig, &mut report.warnings)?;
    let odometry = run_odometry(recording, &config.odometry, progress)?;
    let mut keyframes = choose_keyframes(
        recording,
        &cameras,
        &odometry.trajectory,
        config,
        &mut damages,
        progress,
    )?;
    if keyframes.images.is_empty() {
        return Err(Error::NoKeyframe {
            path: recording.path().to_owned(),
        });
    }
    if let Some(lidar) = rig.lidar() {
        add_lidar_features(
            recording,
            lidar,
            &mut keyframes.frames,
            &odometry.trajectory,
            config,
            progress,
        )?;
    }
    report.odometry = odometry.report;
    damages.report(&mut report.warnings);
    describe_images(&keyframes, &cameras, &mut report);
    let before = keyframes.poses();
    let points = optimise(&rig, &mut keyframes, &before, config, &mut report, progress)?;
    let content = MapContent {
        keyframes: &keyframes.poses(),
        images: &keyframes.images,
        points: &points,
        provenance: &walk_hash(&rig, &odometry.trajectory),
    };
    Ok(MappingResult {
        map: HdMap::build(&content, &config.map, progress)?,
        trajectory: correct_trajectory(&odometry.trajectory, &before, &keyframes.frames),
        report,
    })
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

/// Alternates new correspondences with Eq. (4) until the keyframes rest.
fn optimise(
    rig: &Rig,
    keyframes: &mut Keyframes,
    odometry: &[StampedPose],
    config: &MappingConfig,
    report: &mut MappingReport,
    progress: ProgressFn<'_>,
) -> Result<Vec<MapPoint>, Error> {
    let tracks = find_tracks(
        rig,
        odometry,
        &keyframes.images,
        &config.reconstruction,
        progress,
    )?;
    report.tracks = tracks.len() as u64;
    let pairs = scan_pairs(&keyframes.frames, config);
    let mut points = Vec::new();
    for round in 0..config.outer_iterations.max(1) {
        points = triangulate_round(rig, keyframes, &tracks, round, config)?;
        if round == 0 {
            let errors = ErrorSummary::of(reprojection_errors_px(rig, keyframes, &points));
            report.reprojection_rms_before_px = errors.rms;
            report.reprojection_median_before_px = errors.median;
        }
        let scans = scan_correspondences(&keyframes.frames, &pairs, config);
        let before = keyframes.poses();
        let solved = adjust(
            rig,
            keyframes,
            &mut points,
            &scans,
            odometry,
            config,
            progress,
        )?;
        let moves = keyframes
            .frames
            .iter()
            .zip(&before)
            .map(|(k, b)| b.world_from_rig.inverse() * k.world_from_rig);
        let mut done = RoundReport {
            initial_cost: solved.initial_cost,
            final_cost: solved.final_cost,
            iterations: solved.iterations as u64,
            observations: points.iter().map(|p| p.observations.len() as u64).sum(),
            ..count_matches(&scans)
        };
        for moved in moves {
            done.moved_m = done.moved_m.max(moved.translation.norm());
            done.turned_deg = done.turned_deg.max(moved.rotation.angle().to_degrees());
        }
        let rests = done.moved_m < 1e-3 && done.turned_deg < 0.02;
        report.rounds.push(done);
        if rests {
            break;
        }
    }
    let max_px = config.max_reprojection_px;
    report.dropped_observations = drop_outliers(rig, keyframes, &mut points, max_px);
    report.reprojection_errors_px = reprojection_errors_px(rig, keyframes, &points);
    let errors = ErrorSummary::of(report.reprojection_errors_px.clone());
    report.reprojection_rms_px = errors.rms;
    report.reprojection_median_px = errors.median;
    report.points = points.len() as u64;
    report.observations = points.iter().map(|p| p.observations.len() as u64).sum();
    if points.len() < MIN_POINTS {
        report.warnings.push(format!(
            "the map has only {} points: too few features, or cameras and LiDAR do not fit together",
            points.len()
        ));
    }
    Ok(points)
}

/// Fewer points than this localize nobody.
const MIN_POINTS: usize = 100;
/// A camera with fewer features per image than this sees too little.
const MIN_FEATURES_PER_IMAGE: u64 = 50;

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

fn count_matches(scans: &[(ScanPair, Correspondences)]) -> RoundReport {
    let found = scans.iter().map(|(_, found)| found);
    RoundReport {
        plane_matches: found.clone().map(|f| f.planes.len() as u64).sum(),
        edge_matches: found.map(|f| f.edges.len() as u64).sum(),
        ..RoundReport::default()
    }
}

/// Counts features, and warns of cameras that see too little.
fn describe_images(keyframes: &Keyframes, cameras: &[String], report: &mut MappingReport) {
    report.keyframes = keyframes.frames.len() as u64;
    report.images = keyframes.images.len() as u64;
    for name in cameras {
        let images = keyframes.images.iter().filter(|i| i.camera == *name);
        let count = images.clone().count() as u64;
        let features: u64 = images.map(|i| i.features.len() as u64).sum();
        report.features += features;
        if features < MIN_FEATURES_PER_IMAGE * count.max(1) {
            report.warnings.push(format!(
                "{name} shows {features} features in {count} images: check focus, exposure and lens cap"
            ));
        }
    }
}

/// Root mean square and median.
struct ErrorSummary {
    rms: f64,
    median: f64,
}

impl ErrorSummary {
    fn of(mut errors: Vec<f64>) -> Self {
        errors.retain(|e| e.is_finite());
        errors.sort_by(f64::total_cmp);
        let squares: f64 = errors.iter().map(|e| e * e).sum();
        Self {
            rms: (squares / errors.len().max(1) as f64).sqrt(),
            median: errors.get(errors.len() / 2).copied().unwrap_or(0.0),
        }
    }
}

/// The odometry's trajectory bent through the optimised keyframes: between two of them a pose follows both, each with
/// the odometry's motion from it, in proportion to time.
fn correct_trajectory(
    odometry: &Trajectory,
    before: &[StampedPose],
    keyframes: &[Keyframe],
) -> Trajectory {
    let corrected = odometry.poses().iter().map(|pose| {
        let from = |index: usize| {
            let keyframe = keyframes.get(index)?;
            Some(
                keyframe.world_from_rig
                    * before[index].world_from_rig.inverse()
                    * pose.world_from_rig,
            )
        };
        let next = keyframes.partition_point(|k| k.time < pose.time);
        let previous = next.checked_sub(1);
        let world_from_rig = match (previous.and_then(from), from(next)) {
            (Some(a), Some(b)) => {
                let start = keyframes[next - 1].time;
                let fraction = pose.time.secs_since(start) / keyframes[next].time.secs_since(start);
                a.interpolate(&b, fraction)
            }
            (Some(only), None) | (None, Some(only)) => only,
            (None, None) => pose.world_from_rig,
        };
        StampedPose {
            time: pose.time,
            world_from_rig,
        }
    });
    Trajectory::new(corrected.collect())
}
