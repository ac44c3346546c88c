//! Transform, boards and apparent size together, with weights from what corners, planes and edges leave.

use std::collections::BTreeMap;

use lsfb_geometry::{Matrix6, Se3, Vector2, Vector3};
use lsfb_solver::{
    Block, BlockId, Kernel, PosePrior, Problem, SolveConfig, VectorPrior, covariance, solve,
};
use nalgebra::DMatrix;

use super::association::Joined;
use super::candidates::Patch;
use super::outline::{Edge, nearest_side};
use super::plane::{Chord, PlaneFit, Spread, regress};
use super::residuals::{EdgeResidual, PlaneResidual, facing};
use super::{Board, LidarCameraConfig, Scene};
use crate::Error;

/// What an edge misses beside the angle between rays: beam width, bent plates, metres.
const EDGE_FLOOR_M: f64 = 0.002;
/// How well half the plate's size and all ranges are known beforehand, metres.
const APPARENT_SIGMA_M: [f64; 3] = [0.01, 0.01, 0.02];
/// Median of a chi-square with three degrees of freedom.
const MEDIAN_CHI_SQUARE: f64 = 2.366;
/// Normalized error at which an edge's weight is halved in the first round.
const ROBUST_SCALE: f64 = 3.0;
/// Edges beyond this normalized error are outliers.
const EDGE_OUTLIER: f64 = 4.0;
/// Rounds of weights.
const ROUNDS: usize = 4;
/// Poses whose normalized plane error exceeds this are rejected: three numbers, each within 4.5 σ.
const POSE_OUTLIER: f64 = 61.0;

/// Rounds in which offsets of beams are taken off.
const BEAM_ROUNDS: usize = 3;
/// Boards a beam must have met, and standard deviations its offset must be from zero.
const MIN_BOARDS: usize = 4;
const BEAM_DEVIATIONS: f64 = 2.5;

/// One pose in the adjustment.
pub(super) struct Used {
    pub scene: usize,
    pub patch: usize,
    /// Returns on the board, less the offsets of their beams.
    pub chords: Vec<Chord>,
    pub fit: PlaneFit,
    pub camera_from_board: Se3,
    pub edges_used: usize,
}

pub(super) struct Solved {
    pub camera_from_lidar: Se3,
    pub covariance: Matrix6<f64>,
    /// Excess of half the width, half the height, and of every range, metres.
    pub apparent_m: Vector3<f64>,
    pub apparent_sigma_m: Vector3<f64>,
    pub used: Vec<Used>,
    /// Scenes left out, and why.
    pub rejected: Vec<(usize, String)>,
    pub range_noise_m: f64,
    pub beam_noise_m: f64,
    pub beam_offsets_m: BTreeMap<u16, f64>,
    pub spread: [f64; 3],
}

/// Standard deviations relative to what was expected: corners, planes, edges.
type Factors = [f64; 3];

pub(super) fn adjust(
    board: &Board,
    camera: &str,
    scenes: &[Scene],
    joined: &Joined,
    config: &LidarCameraConfig,
) -> Result<Solved, Error> {
    let mut used: Vec<Used> = joined
        .patch
        .iter()
        .enumerate()
        .filter_map(|(scene, k)| {
            let patch = &scenes[scene].in_lidar[(*k)?];
            Some(Used {
                scene,
                patch: (*k)?,
                chords: patch.chords.clone(),
                fit: patch.fit,
                camera_from_board: scenes[scene].in_camera.camera_from_board,
                edges_used: 0,
            })
        })
        .collect();
    let mut noise = refit(&mut used, config);
    let mut beam_offsets_m: BTreeMap<u16, f64> = BTreeMap::new();
    for _ in 0..BEAM_ROUNDS {
        let more = beam_offsets(&used);
        if more.is_empty() {
            break;
        }
        take_off(&mut used, &more);
        for (ring, offset_m) in more {
            *beam_offsets_m.entry(ring).or_insert(0.0) += offset_m;
        }
        noise = refit(&mut used, config);
    }
    let mut rejected = Vec::new();
    loop {
        let solved = converge(board, scenes, joined.camera_from_lidar, &mut used, config)?;
        let mut errors: Vec<f64> = used
            .iter()
            .map(|u| plane_error(u, &solved.camera_from_lidar, solved.apparent_m.z))
            .collect();
        let worst = errors
            .iter()
            .copied()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1));
        errors.sort_by(f64::total_cmp);
        // Against what most poses have: a single bad one would raise the spread of all.
        let median = errors.get(errors.len() / 2).copied().unwrap_or(0.0);
        let usual = (median / MEDIAN_CHI_SQUARE).max(0.5);
        let worst = worst.map(|(k, error)| (k, error / usual));
        match worst {
            Some((k, error)) if error > POSE_OUTLIER && used.len() > config.min_poses => {
                let out = used.remove(k);
                rejected.push((
                    out.scene,
                    format!(
                        "its plane is {:.0} σ off where the other poses have it: the board moved, or image and scan do not belong together",
                        error.sqrt()
                    ),
                ));
            }
            _ if used.len() < config.min_poses => {
                return Err(Error::NotJoined {
                    first: camera.to_owned(),
                    second: "lidar".to_owned(),
                    problem: format!(
                        "{} poses remain, {} are needed: record more",
                        used.len(),
                        config.min_poses
                    ),
                });
            }
            _ => {
                return Ok(Solved {
                    used,
                    rejected,
                    range_noise_m: noise.range_m,
                    beam_noise_m: noise.beam_m,
                    beam_offsets_m,
                    ..solved
                });
            }
        }
    }
}

/// Spread of ranges.
struct Noise {
    range_m: f64,
    beam_m: f64,
}

/// Planes through the returns as they are now, weighed by the spread that they have.
fn refit(used: &mut Vec<Used>, config: &LidarCameraConfig) -> Noise {
    let mut spread = Spread::default();
    for u in used.iter() {
        spread.add(&u.chords, &u.fit.plane);
    }
    let noise = Noise {
        range_m: spread
            .range_noise_m()
            .unwrap_or(config.range_noise_m)
            .max(1e-3),
        beam_m: spread.beam_noise_m(),
    };
    used.retain_mut(
        |u| match regress(&u.chords, &u.fit.plane, noise.range_m, noise.beam_m) {
            Some(fit) => {
                u.fit = fit;
                true
            }
            None => false,
        },
    );
    noise
}

/// By how much each beam measures too far against the planes through all beams, where that is more than chance. What grows
/// evenly with elevation looks like a tilt of every board, and is not seen.
fn beam_offsets(used: &[Used]) -> BTreeMap<u16, f64> {
    let mut by_ring: BTreeMap<u16, Vec<f64>> = BTreeMap::new();
    for u in used {
        let plane = &u.fit.plane;
        for chord in &u.chords {
            let errors: Vec<f64> = chord
                .points
                .iter()
                .filter_map(|p| plane.range_error_m(p))
                .collect();
            if errors.len() >= 4 {
                let mean = errors.iter().sum::<f64>() / errors.len() as f64;
                by_ring.entry(chord.ring).or_default().push(mean);
            }
        }
    }
    by_ring
        .into_iter()
        .filter_map(|(ring, means)| {
            let n = means.len() as f64;
            let mean = means.iter().sum::<f64>() / n;
            let variance = means.iter().map(|m| (m - mean).powi(2)).sum::<f64>() / (n - 1.0);
            let of_mean = variance / n;
            let clear = mean * mean > BEAM_DEVIATIONS * BEAM_DEVIATIONS * of_mean;
            (means.len() >= MIN_BOARDS && clear)
                .then(|| (ring, mean * mean * mean / (mean * mean + of_mean)))
        })
        .collect()
}

fn take_off(used: &mut [Used], offsets_m: &BTreeMap<u16, f64>) {
    for chord in used.iter_mut().flat_map(|u| u.chords.iter_mut()) {
        if let Some(offset_m) = offsets_m.get(&chord.ring) {
            for point in &mut chord.points {
                *point *= 1.0 - offset_m / point.norm();
            }
        }
    }
}

/// Squared normalized error of the plane alone.
fn plane_error(used: &Used, camera_from_lidar: &Se3, range_excess_m: f64) -> f64 {
    let pose = camera_from_lidar.inverse() * used.camera_from_board;
    let plane = &used.fit.plane;
    PlaneResidual::parts(plane, &pose).map_or(f64::INFINITY, |(mut value, _)| {
        value.z -= facing(plane) * range_excess_m;
        (value.transpose() * used.fit.information * value)[0]
    })
}

/// Rounds of solving and weighing.
fn converge(
    board: &Board,
    scenes: &[Scene],
    start: Se3,
    used: &mut [Used],
    config: &LidarCameraConfig,
) -> Result<Solved, Error> {
    let mut pose = start;
    let mut apparent = Vector3::zeros();
    let mut factors: Factors = [1.0; 3];
    for round in 0..ROUNDS {
        let reach_m = (round == 0).then_some(config.max_edge_error_m);
        let mut built = build(board, scenes, used, &pose, &apparent, &factors, reach_m)?;
        let solve_config = SolveConfig {
            max_iterations: 60,
            cost_tolerance: 1e-12,
            ..SolveConfig::default()
        };
        let report = solve(&mut built.problem, &solve_config)?;
        pose = built.problem.value(built.camera_from_lidar);
        apparent = built.problem.value(built.apparent);
        for (u, block) in used.iter_mut().zip(&built.boards) {
            u.camera_from_board = built.problem.value(*block);
        }
        let mut blocks: Vec<BlockId> = vec![built.camera_from_lidar.id(), built.apparent.id()];
        blocks.extend(built.boards.iter().map(|b| b.id()));
        let joint = covariance(&built.problem, &blocks)?;
        if round + 1 == ROUNDS {
            let matrix = joint.joint();
            return Ok(Solved {
                camera_from_lidar: pose,
                covariance: matrix.fixed_view::<6, 6>(0, 0).into_owned(),
                apparent_m: apparent,
                apparent_sigma_m: Vector3::from_fn(|k, _| matrix[(6 + k, 6 + k)].max(0.0).sqrt()),
                used: Vec::new(),
                rejected: Vec::new(),
                range_noise_m: 0.0,
                beam_noise_m: 0.0,
                beam_offsets_m: BTreeMap::new(),
                spread: factors,
            });
        }
        if round > 0 {
            let sigma = Vector3::from(APPARENT_SIGMA_M);
            let prior = apparent.component_div(&sigma).norm_squared();
            let squares = 2.0 * report.final_cost - prior;
            let now = built.leftover(scenes, used, &pose, joint.joint(), &factors, squares);
            for (factor, more) in factors.iter_mut().zip(now) {
                *factor *= more;
            }
        }
    }
    Err(Error::NotJoined {
        first: "camera".to_owned(),
        second: "lidar".to_owned(),
        problem: "no round of weights ended".to_owned(),
    })
}

struct Built {
    problem: Problem,
    camera_from_lidar: Block<Se3>,
    apparent: Block<Vector3<f64>>,
    boards: Vec<Block<Se3>>,
    edges: usize,
}

fn build(
    board: &Board,
    scenes: &[Scene],
    used: &mut [Used],
    pose: &Se3,
    apparent: &Vector3<f64>,
    factors: &Factors,
    reach_m: Option<f64>,
) -> Result<Built, Error> {
    let mut problem = Problem::new();
    let camera_from_lidar = problem.add_block(*pose);
    problem.set_name(camera_from_lidar.id(), "camera from LiDAR");
    let apparent_block = problem.add_block(*apparent);
    problem.set_name(apparent_block.id(), "apparent size and range");
    problem.add_residual(
        VectorPrior::new(Vector3::zeros(), Vector3::from(APPARENT_SIGMA_M)),
        &[apparent_block.id()],
        Kernel::Squared,
    )?;
    let mut boards = Vec::with_capacity(used.len());
    let mut edges = 0;
    for u in used.iter_mut() {
        let scene = &scenes[u.scene];
        let block = problem.add_block(u.camera_from_board);
        problem.set_name(block.id(), format!("board of {}", scene.name));
        let whitening = whitening6(&scene.in_camera.information)? / factors[0];
        let prior = PosePrior {
            value: scene.in_camera.camera_from_board,
            sqrt_information: whitening,
        };
        problem.add_residual(prior, &[block.id()], Kernel::Squared)?;
        let both = [camera_from_lidar.id(), block.id(), apparent_block.id()];
        let factor = u
            .fit
            .information
            .cholesky()
            .ok_or_else(|| not_finite(&scene.name))?;
        let plane = PlaneResidual {
            plane: u.fit.plane,
            whitening: factor.l().transpose() / factors[1],
        };
        problem.add_residual(plane, &both, Kernel::Squared)?;
        u.edges_used = 0;
        let lidar_from_board = pose.inverse() * u.camera_from_board;
        for edge in &scene.in_lidar[u.patch].edges {
            let Some((residual, error)) =
                edge_residual(board, edge, &lidar_from_board, &apparent.xy())
            else {
                continue;
            };
            // In the first round everything near counts a little, later what agrees counts fully.
            let (limit, kernel) = match reach_m {
                Some(m) => (
                    m / residual.sigma_m,
                    Kernel::Cauchy {
                        scale: ROBUST_SCALE,
                    },
                ),
                None => (EDGE_OUTLIER * factors[2].max(1.0), Kernel::Squared),
            };
            if error.abs() > limit {
                continue;
            }
            let weighed = EdgeResidual {
                sigma_m: residual.sigma_m * factors[2],
                ..residual
            };
            problem.add_residual(weighed, &both, kernel)?;
            u.edges_used += 1;
            edges += 1;
        }
        boards.push(block);
    }
    Ok(Built {
        problem,
        camera_from_lidar,
        apparent: apparent_block,
        boards,
        edges,
    })
}

/// The residual of an edge with its side, and its normalized error now.
fn edge_residual(
    board: &Board,
    edge: &Edge,
    lidar_from_board: &Se3,
    excess: &Vector2<f64>,
) -> Option<(EdgeResidual, f64)> {
    let place = EdgeResidual::place(&edge.ray, lidar_from_board)?;
    let (side, _) = nearest_side(&place, [board.width_m, board.height_m]);
    let stride = (lidar_from_board.rotation.inverse() * edge.stride_m).xy();
    let crossing = side.dot(&stride);
    // A chord that leaves through this side crosses it outwards.
    if crossing <= 0.0 {
        return None;
    }
    // Anywhere between the last return and the next ray.
    let sigma_m = (crossing * crossing / 12.0 + EDGE_FLOOR_M * EDGE_FLOOR_M).sqrt();
    let which = side.map(f64::abs);
    let half_m = 0.5 * which.dot(&Vector2::new(board.width_m, board.height_m));
    let error = (side.dot(&place) - half_m - which.dot(excess)) / sigma_m;
    let residual = EdgeResidual {
        ray: edge.ray,
        side,
        half_m,
        sigma_m,
    };
    Some((residual, error))
}

impl Built {
    /// Root of squares over redundancy of corners, planes and edges (Helmert's components of variance).
    fn leftover(
        &self,
        scenes: &[Scene],
        used: &[Used],
        pose: &Se3,
        joint: &DMatrix<f64>,
        factors: &Factors,
        all_squares: f64,
    ) -> Factors {
        let range_excess_m = self.problem.value(self.apparent).z;
        let mut squares = [0.0; 3];
        let mut fixed = [0.0; 3];
        for (k, u) in used.iter().enumerate() {
            let at = 9 + 6 * k;
            let scene = &scenes[u.scene];
            let information = scene.in_camera.information / (factors[0] * factors[0]);
            let error = scene.in_camera.camera_from_board.inverse() * u.camera_from_board;
            let error = error.log();
            squares[0] += (error.transpose() * information * error)[0];
            let own: Matrix6<f64> = joint.fixed_view::<6, 6>(at, at).into_owned();
            fixed[0] += (information * own).trace();

            squares[1] += plane_error(u, pose, range_excess_m) / (factors[1] * factors[1]);
            fixed[1] += plane_share(u, pose, joint, at, factors[1]);
        }
        let rows = [6.0, 3.0].map(|n| n * used.len() as f64);
        let parameters = (9 + 6 * used.len()) as f64;
        squares[2] = all_squares - squares[0] - squares[1];
        // What corners and planes do not fix, edges (and the prior on the size, which hardly counts) do.
        let edge_share = (parameters - fixed[0] - fixed[1]).max(0.0);
        let redundancy = [
            rows[0] - fixed[0],
            rows[1] - fixed[1],
            self.edges as f64 - edge_share,
        ];
        std::array::from_fn(|k| {
            if redundancy[k] < 3.0 {
                1.0
            } else {
                (squares[k].max(0.0) / redundancy[k])
                    .sqrt()
                    .clamp(0.2, 20.0)
            }
        })
    }
}

/// How much of a plane's three numbers went into the parameters.
fn plane_share(
    used: &Used,
    camera_from_lidar: &Se3,
    joint: &DMatrix<f64>,
    at: usize,
    factor: f64,
) -> f64 {
    let lidar_from_board = camera_from_lidar.inverse() * used.camera_from_board;
    let Ok((_, by_pose)) = PlaneResidual::parts(&used.fit.plane, &lidar_from_board) else {
        return 0.0;
    };
    let through = lidar_from_board.inverse().adjoint();
    // Covariance of the board in the LiDAR, from those of both blocks and between them.
    let view = |i: usize, j: usize| joint.fixed_view::<6, 6>(i, j).into_owned();
    let (tt, tb, bb) = (view(0, 0), view(0, at), view(at, at));
    let cross = -through * tb;
    let moved: Matrix6<f64> = through * tt * through.transpose() + cross + cross.transpose() + bb;
    (used.fit.information * by_pose * moved * by_pose.transpose()).trace() / (factor * factor)
}

fn whitening6(information: &Matrix6<f64>) -> Result<Matrix6<f64>, Error> {
    information
        .cholesky()
        .map(|c| c.l().transpose())
        .ok_or_else(|| not_finite("a board"))
}

fn not_finite(name: &str) -> Error {
    Error::NotJoined {
        first: name.to_owned(),
        second: "lidar".to_owned(),
        problem: "its points lie on a line: remove this pose".to_owned(),
    }
}

/// The LiDAR's part of a pose, for reports.
pub(super) fn patch<'a>(scenes: &'a [Scene], used: &Used) -> &'a Patch {
    &scenes[used.scene].in_lidar[used.patch]
}
