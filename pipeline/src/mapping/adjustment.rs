//! Eq. (4): keyframe poses and points from LiDAR planes and edges, reprojections, the odometry and, where that is asked for, the IMU.

use std::collections::BTreeMap;
use std::sync::Arc;

use lsfb_geometry::{Rig, Se3, StampedPose, Vector3};
use lsfb_perception::RelativePose;
use lsfb_solver::{Block, Kernel, Problem, Report, ResidualSet, SolveConfig};
use lsfb_types::ProgressFn;

use super::control::{ControlBlocks, ControlTerms, SolvedControl, add_control};
use super::inertial::{InertialBlocks, InertialEstimate, InertialTerm};
use super::keyframes::Keyframes;
use super::matched::{MatchedEdges, MatchedPlanes};
use super::scan_pairs::Compared;
use super::weights::Weights;
use super::{MappingConfig, TermConfig};
use crate::Error;
use crate::hd_map::MapPoint;
use crate::residuals::{ObservingCamera, Reprojection};
use crate::solve::solve_or_stop;

/// What an IMU alone is off by after a second, metres; it grows with the power 3/2 of time: 18 cm after five seconds of a walk through an office and 45 cm
/// after eight on stairs (`docs/figures.md`).
const BLIND_M: f64 = 0.02;
/// The IMU ties neighbours far more firmly than they are held to places: damping by a share of that would hold the whole.
const MOST_DAMPING_WITH_IMU: f64 = 1e-10;

/// Where Huber's kernel of reprojections turns linear, and that of Cauchy of planes and edges has halved a weight, in standard deviations.
pub(super) const IMAGE_KERNEL_SCALE: f64 = 2.0;
pub(super) const SCAN_KERNEL_SCALE: f64 = 2.0;

/// What is minimised besides the reprojection errors of the points, and how much each term weighs.
pub(super) struct Terms<'a> {
    pub scans: &'a [Compared],
    /// The keyframes where the odometry had them.
    pub odometry: &'a [StampedPose],
    /// How long no scan told the motion from each of them to the next, seconds.
    pub blind_s: &'a [f64],
    pub weights: Weights,
    /// Control points that hold the map, or marks that are placed.
    pub control: Option<&'a ControlTerms<'a>>,
    /// What the IMU says between keyframes, where that is asked for.
    pub imu: Option<&'a InertialTerm<'a>>,
}

impl Terms<'_> {
    /// How these terms are minimised.
    pub fn solver(&self, config: &MappingConfig) -> SolveConfig {
        let mut solver = config.solver;
        if self.imu.is_some() {
            solver.initial_damping = solver.initial_damping.min(MOST_DAMPING_WITH_IMU);
        }
        solver
    }
}

/// Eq. (4) at the poses and points at hand.
pub(super) struct Equation {
    pub problem: Problem,
    pub keyframes: KeyframeBlocks,
    /// The points.
    pub points: Vec<Block<Vector3<f64>>>,
    /// What control points bring, where there are any.
    pub control: Option<ControlBlocks>,
}

/// Blocks of the keyframes.
pub(super) struct KeyframeBlocks {
    /// The first is held.
    pub poses: Vec<Block<Se3>>,
    /// What the IMU brings, where it takes part.
    pub inertial: Option<InertialBlocks>,
}

/// What Eq. (4) found beside keyframes and points.
pub(super) struct Adjusted {
    pub report: Report,
    pub control: Option<SolvedControl>,
    pub inertial: Option<InertialEstimate>,
}

/// Minimises Eq. (4); `keyframes` and `points` take the result.
pub(super) fn adjust(
    rig: &Rig,
    keyframes: &mut Keyframes,
    points: &mut [MapPoint],
    terms: &Terms,
    config: &MappingConfig,
    progress: ProgressFn<'_>,
) -> Result<Adjusted, Error> {
    let Equation {
        mut problem,
        keyframes: KeyframeBlocks { poses, inertial },
        points: blocks,
        control,
    } = equation(rig, keyframes, points, terms, config)?;
    let solver = terms.solver(config);
    let report = solve_or_stop("map adjustment", &mut problem, &solver, progress)?;
    for (keyframe, block) in keyframes.frames.iter_mut().zip(&poses) {
        keyframe.world_from_rig = problem.value(*block);
    }
    for (point, block) in points.iter_mut().zip(&blocks) {
        point.point_in_world = problem.value(*block);
    }
    let control = control.zip(terms.control);
    let inertial = inertial.zip(terms.imu);
    Ok(Adjusted {
        report,
        control: control.and_then(|(blocks, terms)| blocks.solved(&problem, terms)),
        inertial: inertial.map(|(blocks, imu)| imu.solved(&problem, &blocks)),
    })
}

/// Sets up Eq. (4).
pub(super) fn equation(
    rig: &Rig,
    keyframes: &Keyframes,
    points: &[MapPoint],
    terms: &Terms,
    config: &MappingConfig,
) -> Result<Equation, Error> {
    let mut problem = Problem::new();
    let added = add_keyframes(&mut problem, keyframes, terms, config)?;
    let poses = &added.poses;
    let observing: BTreeMap<&str, Arc<ObservingCamera>> = rig
        .cameras
        .iter()
        .map(|(name, camera)| (name.as_str(), ObservingCamera::new(camera)))
        .collect();
    let blocks: Vec<_> = points
        .iter()
        .map(|p| problem.add_eliminated_point(p.point_in_world))
        .collect();
    let seen = points.iter().zip(&blocks);
    for (point, block) in seen.filter(|_| config.terms.images) {
        for o in &point.observations {
            let image = &keyframes.images[o.image];
            let Some(camera) = observing.get(image.camera.as_str()) else {
                continue;
            };
            let residual = Reprojection {
                camera: camera.clone(),
                pixel: image.features.keypoints[o.keypoint as usize].pixel_f64(),
                sigma_px: terms.weights.pixel_sigma_px,
            };
            let kernel = Kernel::Huber {
                scale: IMAGE_KERNEL_SCALE,
            };
            problem.add_residual(residual, &[poses[image.keyframe].id(), block.id()], kernel)?;
        }
    }
    let control = terms.control;
    let control = control.map(|terms| add_control(&mut problem, &observing, poses, terms));
    Ok(Equation {
        control: control.transpose()?,
        problem,
        keyframes: added,
        points: blocks,
    })
}

/// Adds the poses of the keyframes and what holds them besides images: the first, the odometry, the LiDAR and the IMU.
pub(super) fn add_keyframes(
    problem: &mut Problem,
    keyframes: &Keyframes,
    terms: &Terms,
    config: &MappingConfig,
) -> Result<KeyframeBlocks, Error> {
    let poses: Vec<Block<Se3>> = keyframes
        .frames
        .iter()
        .map(|k| problem.add_block(k.world_from_rig))
        .collect();
    // The first pose holds the map in place.
    if let Some(first) = poses.first() {
        problem.set_constant(*first);
    }
    for (k, step) in steps(keyframes, terms, config) {
        let pair = [poses[k].id(), poses[k + 1].id()];
        problem.add_residual(step, &pair, Kernel::Squared)?;
    }
    add_scans(problem, &poses, terms, config.terms)?;
    let inertial = terms.imu.map(|imu| imu.add(problem, &poses));
    Ok(KeyframeBlocks {
        inertial: inertial.transpose()?,
        poses,
    })
}

/// The motion from keyframe `k` to the next as the odometry has it, of all keyframes in which it takes part.
pub(super) fn steps(
    keyframes: &Keyframes,
    terms: &Terms,
    config: &MappingConfig,
) -> Vec<(usize, RelativePose)> {
    let contradicted = terms.weights.contradicted;
    let measured = terms.odometry.windows(2).zip(terms.blind_s);
    let pairs = keyframes.frames.len().saturating_sub(1);
    let measured = measured.take(pairs).enumerate();
    let step = |(k, (measured, blind_s)): (usize, (&[StampedPose], &f64))| {
        // The start has nothing there but the samples, which then say it themselves, and how well they know it.
        if *blind_s > 0.0 && terms.imu.is_some_and(|imu| imu.has(k)) {
            return None;
        }
        let blind_m = BLIND_M * blind_s.powf(1.5);
        let root_secs = measured[1].time.secs_since(measured[0].time).sqrt();
        let step = RelativePose::isotropic(
            measured[0].world_from_rig.inverse() * measured[1].world_from_rig,
            config.odometry_rotation_sigma_deg.to_radians() * root_secs * contradicted.rotation,
            (config.odometry_translation_sigma_m * root_secs * contradicted.translation)
                .hypot(blind_m),
        );
        Some((k, step))
    };
    measured.filter_map(step).collect()
}

fn add_scans(
    problem: &mut Problem,
    poses: &[Block<Se3>],
    terms: &Terms,
    taken: TermConfig,
) -> Result<(), Error> {
    let weights = &terms.weights;
    let kernel = Kernel::Cauchy {
        scale: SCAN_KERNEL_SCALE,
    };
    for (pair, found) in terms.scans {
        let blocks = [poses[pair.m].id(), poses[pair.n].id()];
        let planes: Arc<dyn ResidualSet> = Arc::new(MatchedPlanes {
            found: found.clone(),
            sigma_m: weights.plane_sigma_m,
        });
        for number in (0..found.planes.len() as u32).filter(|_| taken.planes) {
            problem.add_residual_of(planes.clone(), number, &blocks, kernel)?;
        }
        let edges: Arc<dyn ResidualSet> = Arc::new(MatchedEdges {
            found: found.clone(),
            sigma_m: weights.edge_sigma_m,
        });
        for number in (0..found.edges.len() as u32).filter(|_| taken.edges) {
            problem.add_residual_of(edges.clone(), number, &blocks, kernel)?;
        }
    }
    Ok(())
}
