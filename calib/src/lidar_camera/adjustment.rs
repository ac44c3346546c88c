//! Transform, boards and apparent size together, with weights from what corners, planes and edges leave.

use std::collections::BTreeMap;

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_perception::statistics::median;
use lsfb_solver::{BlockId, SolveConfig, covariance, influences, solve_until_converged};
use nalgebra::{DVector, Matrix2};

use super::association::Joined;
use super::plane::{Spread, regress};
use super::problem::{APPARENT_SIGMA_M, Factors, ProblemStart, Reach, Shift, build, plane_error};
use super::solved::{Solved, Used};
use super::{LidarCameraConfig, MountedBoard, Scene, shades};
use crate::scatter::Scatter;
use crate::{Error, JoinProblem};

/// Median of a chi-square with three degrees of freedom.
const MEDIAN_CHI_SQUARE: f64 = 2.366;
/// Rounds of weights.
const ROUNDS: usize = 4;
/// Poses whose normalized plane error exceeds this are rejected: three numbers, each within 4.5 σ.
const POSE_OUTLIER: f64 = 61.0;

/// Rounds in which offsets of beams are taken off.
const BEAM_ROUNDS: usize = 3;
/// Boards a beam must have met, and standard deviations its offset must be from zero.
const MIN_BOARDS: usize = 4;
const BEAM_DEVIATIONS: f64 = 2.5;

fn solve_config() -> SolveConfig {
    SolveConfig {
        max_iterations: 60,
        cost_tolerance: 1e-12,
        ..SolveConfig::default()
    }
}

pub(super) fn adjust(
    board: &MountedBoard,
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
    let dark = shades::take_off(&mut used);
    if dark.is_some() {
        noise = refit(&mut used, config);
    }
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
        let errors: Vec<f64> = used
            .iter()
            .map(|u| plane_error(u, &solved.camera_from_lidar, solved.apparent_m.z))
            .collect();
        let worst = errors
            .iter()
            .copied()
            .enumerate()
            .max_by(|a, b| a.1.total_cmp(&b.1));
        // Against what most poses have: a single bad one would raise the spread of all.
        let usual = (median(errors).unwrap_or(0.0) / MEDIAN_CHI_SQUARE).max(0.5);
        let worst = worst.map(|(k, error)| (k, error / usual));
        match worst {
            Some((k, error)) if error > POSE_OUTLIER && used.len() > config.min_poses => {
                let out = used.remove(k);
                rejected.push((
                    out.scene,
                    format!(
                        "its plane is {:.0} σ off the prediction from the other poses: the board moved, or image and scan do not belong together",
                        error.sqrt()
                    ),
                ));
            }
            _ if used.len() < config.min_poses => {
                return Err(Error::NotJoined {
                    first: camera.to_owned(),
                    second: "lidar".to_owned(),
                    cause: JoinProblem::FewPoses {
                        left: used.len(),
                        needed: config.min_poses,
                    },
                });
            }
            _ => {
                return Ok(Solved {
                    used,
                    rejected,
                    range_noise_m: noise.range_m,
                    beam_noise_m: noise.beam_m,
                    beam_offsets_m,
                    dark,
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

/// Rounds of solving and weighing.
fn converge(
    board: &MountedBoard,
    scenes: &[Scene],
    start: Se3,
    used: &mut [Used],
    config: &LidarCameraConfig,
) -> Result<Solved, Error> {
    let mut pose = start;
    let mut apparent = Vector3::zeros();
    let mut factors: Factors = [1.0; 3];
    for round in 0..ROUNDS {
        // In the first round everything near counts a little, later what agrees counts fully.
        let reach = if round == 0 {
            Reach::Within(config.max_edge_error_m)
        } else {
            Reach::Agreeing
        };
        let state = ProblemStart {
            camera_from_lidar: &pose,
            apparent_m: &apparent,
            factors: &factors,
            pattern: 1.0,
        };
        let mut built = build(board, scenes, used, &state, reach, Shift::None)?;
        let report = solve_until_converged(&mut built.problem, &solve_config())?;
        pose = built.problem.value(built.camera_from_lidar);
        apparent = built.problem.value(built.apparent);
        for (u, block) in used.iter_mut().zip(&built.boards) {
            u.camera_from_board = built.problem.value(*block);
        }
        let shared = [built.camera_from_lidar.id(), built.apparent.id()];
        if round + 1 == ROUNDS {
            let found = influences(&built.problem, &shared, &built.measured)?;
            let scatter = Scatter::of_strangers(found.covariance.joint(), found.groups);
            let dimension = found.step.len();
            let no_bias = DVector::zeros(dimension);
            let joint = found
                .covariance
                .widened(&scatter.factors(dimension), &no_bias);
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
                dark: None,
                spread: factors,
            });
        }
        if round > 0 {
            let boards = built.boards.iter().map(|b| b.id());
            let blocks: Vec<BlockId> = shared.into_iter().chain(boards).collect();
            let joint = covariance(&built.problem, &blocks)?;
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
        cause: JoinProblem::WeightsUnsettled,
    })
}

/// How far the plate's middle lies from where it was said to be on the pattern.
pub(super) struct PlateShift {
    pub shift_m: Vector2<f64>,
    pub covariance: Matrix2<f64>,
}

/// Solves once more, with the plate's middle free: what the outlines say of it when nothing is believed beforehand.
pub(super) fn plate_shift(
    board: &MountedBoard,
    scenes: &[Scene],
    solved: &Solved,
    config: &LidarCameraConfig,
) -> Result<PlateShift, Error> {
    let mut used = solved.used.clone();
    let nothing = Vector3::zeros();
    let state = ProblemStart {
        camera_from_lidar: &solved.camera_from_lidar,
        apparent_m: &nothing,
        factors: &solved.spread,
        pattern: 1.0,
    };
    let reach = Reach::Within(config.max_edge_error_m);
    let mut built = build(board, scenes, &mut used, &state, reach, Shift::Free)?;
    solve_until_converged(&mut built.problem, &solve_config())?;
    let joint = covariance(&built.problem, &[built.shift.id()])?;
    Ok(PlateShift {
        shift_m: built.problem.value(built.shift),
        covariance: joint.joint().fixed_view::<2, 2>(0, 0).into_owned(),
    })
}

/// Size of the pattern over what was said, as the LiDAR has it.
pub(super) struct PatternSize {
    pub factor: f64,
    pub sigma: f64,
}

/// Steps of the size at which the cost is asked for, first wide, then narrow.
const SIZE_STEPS: [f64; 3] = [0.02, 0.01, 0.005];

/// The size of the pattern at which cameras, planes and outlines agree best: the bottom of a parabola through the costs of three
/// sizes, with weights from what is expected, since a wrong size is no noise.
pub(super) fn pattern_size(
    board: &MountedBoard,
    scenes: &[Scene],
    solved: &Solved,
    config: &LidarCameraConfig,
) -> Result<PatternSize, Error> {
    let cost = |pattern: f64| -> Result<(f64, usize), Error> {
        let mut used = solved.used.clone();
        let state = ProblemStart {
            camera_from_lidar: &solved.camera_from_lidar,
            apparent_m: &Vector3::zeros(),
            factors: &[1.0; 3],
            pattern,
        };
        let reach = Reach::Within(config.max_edge_error_m);
        let mut built = build(board, scenes, &mut used, &state, reach, Shift::None)?;
        let cost = solve_until_converged(&mut built.problem, &solve_config())?.final_cost;
        Ok((cost, built.edges))
    };
    let mut size = PatternSize {
        factor: 1.0,
        sigma: f64::INFINITY,
    };
    for step in SIZE_STEPS {
        let (here, edges) = cost(size.factor)?;
        let [below, above] = [cost(size.factor - step)?.0, cost(size.factor + step)?.0];
        let bend = (below - 2.0 * here + above) / (step * step);
        if !(bend > 0.0) {
            break;
        }
        // Corners and planes of all boards beside their poses, outlines, less the transform and the apparent size.
        let freedom = (3 * solved.used.len() + edges).saturating_sub(9).max(1) as f64;
        size = PatternSize {
            factor: size.factor + (0.5 * (below - above) / (step * bend)).clamp(-0.1, 0.1),
            sigma: ((2.0 * here / freedom).max(1.0) / bend).sqrt(),
        };
    }
    Ok(size)
}
