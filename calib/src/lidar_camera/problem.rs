//! The least-squares problem of one round: corners, planes and outlines of all boards.

use lsfb_geometry::{Matrix6, Se3, Vector2, Vector3};
use lsfb_solver::{Block, Kernel, PosePrior, Problem, ResidualId, VectorPrior};
use nalgebra::DMatrix;

use super::outline::{Edge, nearest_side};
use super::residuals::{EdgeResidual, PlaneResidual, facing};
use super::solved::{Solved, Used};
use super::{MountedBoard, Scene};
use crate::{Error, JoinProblem};

/// What an edge misses beside the angle between rays: beam width, bent plates, metres.
const EDGE_FLOOR_M: f64 = 0.002;
/// How well half the plate's size and all ranges are known beforehand, metres.
pub(super) const APPARENT_SIGMA_M: [f64; 3] = [0.01, 0.01, 0.02];
/// How well the plate's middle is known where nothing is said of it, metres.
const SHIFT_SIGMA_M: f64 = 0.1;
/// Normalized error at which an edge's weight is halved in the first round.
const ROBUST_SCALE: f64 = 3.0;
/// Edges beyond this normalized error are outliers.
const EDGE_OUTLIER: f64 = 4.0;

/// Standard deviations relative to what was expected: corners, planes, edges.
pub(super) type Factors = [f64; 3];

/// Which edges count.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Reach {
    /// All within so many metres, those farther off less.
    Within(f64),
    /// Those that agree with their spread.
    Agreeing,
}

/// Whether the plate's middle is where it was said to be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Shift {
    None,
    Free,
}

pub(super) struct Built {
    pub problem: Problem,
    pub camera_from_lidar: Block<Se3>,
    pub apparent: Block<Vector3<f64>>,
    pub shift: Block<Vector2<f64>>,
    pub boards: Vec<Block<Se3>>,
    pub edges: usize,
    /// What was measured of each board.
    pub measured: Vec<Vec<ResidualId>>,
}

/// The state that a problem starts from.
pub(super) struct ProblemStart<'a> {
    pub camera_from_lidar: &'a Se3,
    pub apparent_m: &'a Vector3<f64>,
    pub factors: &'a Factors,
    /// Size of the pattern over what was said: the camera has boards so much nearer.
    pub pattern: f64,
}

pub(super) fn build(
    board: &MountedBoard,
    scenes: &[Scene],
    used: &mut [Used],
    state: &ProblemStart,
    reach: Reach,
    shift: Shift,
) -> Result<Built, Error> {
    let ProblemStart {
        camera_from_lidar: pose,
        apparent_m: apparent,
        factors,
        pattern,
    } = state;
    let mut problem = Problem::new();
    let camera_from_lidar = problem.add_block(**pose);
    problem.set_name(camera_from_lidar.id(), "camera from LiDAR");
    let apparent_block = problem.add_block(**apparent);
    problem.set_name(apparent_block.id(), "apparent size and range");
    problem.add_residual(
        VectorPrior::new(Vector3::zeros(), Vector3::from(APPARENT_SIGMA_M)),
        &[apparent_block.id()],
        Kernel::Squared,
    )?;
    let shift_block = problem.add_block(Vector2::<f64>::zeros());
    problem.set_name(shift_block.id(), "centre of the plate");
    if shift == Shift::Free {
        problem.add_residual(
            VectorPrior::new(Vector2::zeros(), Vector2::repeat(SHIFT_SIGMA_M)),
            &[shift_block.id()],
            Kernel::Squared,
        )?;
    } else {
        problem.set_constant(shift_block);
    }
    let mut boards = Vec::with_capacity(used.len());
    let mut edges = 0;
    let mut measured = Vec::with_capacity(used.len());
    for u in used.iter_mut() {
        let scene = &scenes[u.scene];
        let block = problem.add_block(u.camera_from_board);
        problem.set_name(block.id(), format!("board of {}", scene.name));
        let whitening = whitening6(&scene.in_camera.information)? / factors[0];
        let seen = scene.in_camera.camera_from_board;
        let prior = PosePrior {
            value: Se3::new(seen.rotation, seen.translation * *pattern),
            sqrt_information: whitening,
        };
        let mut of_board = vec![problem.add_residual(prior, &[block.id()], Kernel::Squared)?];
        let both = [camera_from_lidar.id(), block.id(), apparent_block.id()];
        let with_shift = [both[0], both[1], both[2], shift_block.id()];
        let factor = u
            .fit
            .information
            .cholesky()
            .ok_or_else(|| not_finite(&scene.name))?;
        let plane = PlaneResidual {
            plane: u.fit.plane,
            whitening: factor.l().transpose() / factors[1],
        };
        of_board.push(problem.add_residual(plane, &both, Kernel::Squared)?);
        u.edges_used = 0;
        let lidar_from_board = pose.inverse() * u.camera_from_board;
        for edge in &scene.in_lidar[u.patch].edges {
            let Some((residual, error)) =
                edge_residual(board, edge, &lidar_from_board, &apparent.xy())
            else {
                continue;
            };
            let (limit, kernel) = match reach {
                Reach::Within(m) => (
                    m / residual.sigma_m,
                    Kernel::Cauchy {
                        scale: ROBUST_SCALE,
                    },
                ),
                Reach::Agreeing => (EDGE_OUTLIER * factors[2].max(1.0), Kernel::Squared),
            };
            if error.abs() > limit {
                continue;
            }
            let weighed = EdgeResidual {
                sigma_m: residual.sigma_m * factors[2],
                ..residual
            };
            of_board.push(problem.add_residual(weighed, &with_shift, kernel)?);
            u.edges_used += 1;
            edges += 1;
        }
        boards.push(block);
        measured.push(of_board);
    }
    Ok(Built {
        problem,
        camera_from_lidar,
        apparent: apparent_block,
        shift: shift_block,
        boards,
        edges,
        measured,
    })
}

/// How far outside of the outline found the places are that the last round used, metres.
pub(super) fn edge_errors_m(board: &MountedBoard, scenes: &[Scene], solved: &Solved) -> Vec<f64> {
    let limit = EDGE_OUTLIER * solved.spread[2].max(1.0);
    let mut errors = Vec::new();
    for u in &solved.used {
        let pose = solved.camera_from_lidar.inverse() * u.camera_from_board;
        for edge in &scenes[u.scene].in_lidar[u.patch].edges {
            let found = edge_residual(board, edge, &pose, &solved.apparent_m.xy());
            errors.extend(
                found
                    .filter(|(_, error)| error.abs() <= limit)
                    .map(|(residual, error)| error * residual.sigma_m),
            );
        }
    }
    errors
}

/// The residual of an edge with its side, and its normalized error now.
fn edge_residual(
    board: &MountedBoard,
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
    pub fn leftover(
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

/// Squared normalized error of the plane alone.
pub(super) fn plane_error(used: &Used, camera_from_lidar: &Se3, range_excess_m: f64) -> f64 {
    let pose = camera_from_lidar.inverse() * used.camera_from_board;
    let plane = &used.fit.plane;
    PlaneResidual::parts(plane, &pose).map_or(f64::INFINITY, |(mut value, _)| {
        value.z -= facing(plane) * range_excess_m;
        (value.transpose() * used.fit.information * value)[0]
    })
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
        cause: JoinProblem::PointsOnALine,
    }
}
