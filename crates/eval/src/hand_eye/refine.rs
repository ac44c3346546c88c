//! Eq. (7) by least squares: first robustly with the paper's weights, then with weights from the residuals, without what does not fit.

use std::sync::Arc;

use lsfb_geometry::{Se3, Vector2, Vector6};
use lsfb_solver::{Block, Kernel, Problem, SolveConfig, covariance, solve_until_converged};
use lsfb_types::{ProgressFn, median};

use super::closed_form::Pair;
use super::continuous::Continuous;
use super::residual::{BodyResidual, Interpolated};
use super::{ClockModel, show_round};
use crate::Error;

/// The paper's Σ_N: 0.01 rad² and 0.003 m².
const PAPER_SIGMAS: [f64; 2] = [0.1, 0.054_772_256];
/// No measurement is better than this, rad and metres: residuals of zero have no weight.
const LEAST_SIGMAS: [f64; 2] = [1e-6, 1e-6];
/// Norm of a residual of six in units of its standard deviations beyond which it does not fit.
pub(super) const OUTLIER: f64 = 5.5;
/// More poses than this are thinned out evenly.
const MOST_POSES: usize = 4000;
/// Poses this near to a gap are left out, so that the offset can move, seconds.
const MARGIN_SECS: f64 = 0.05;
/// The median of the magnitude of a normal number, inverted.
const SIGMA_PER_MEDIAN: f64 = 1.4826;
/// Poses that a result must rest on.
const LEAST_POSES: usize = 20;

/// What least squares found.
pub(super) struct Refined {
    pub world: Se3,
    pub body: Se3,
    pub sigma_world: [f64; 6],
    pub sigma_body: [f64; 6],
    pub offset_secs: f64,
    pub sigma_offset_secs: f64,
    pub drift: f64,
    pub middle_secs: f64,
    /// Of the poses that fit.
    pub distances_m: Vec<f64>,
    pub angles_deg: Vec<f64>,
    pub poses: usize,
    pub outliers: usize,
    /// By how much standard deviations were raised as residuals hang together.
    pub correlated_by: Option<f64>,
    /// Standard deviations of a component of the rotation and the translation by which outliers were told, rad and metres.
    pub sigmas: [f64; 2],
}

/// How far two results of one thing are apart.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Apart {
    pub rotation_deg: f64,
    pub translation_m: f64,
    pub offset_secs: f64,
    /// The largest difference of a number, in standard deviations of the two.
    pub sigmas: f64,
}

impl Refined {
    /// From a result of other data.
    fn apart(&self, other: &Self) -> Apart {
        let between = (self.body.inverse() * other.body).log();
        let offset_secs = other.offset_secs - self.offset_secs;
        let both = |a: f64, b: f64| a.hypot(b).max(f64::MIN_POSITIVE);
        let of_body =
            (0..6).map(|k| between[k].abs() / both(self.sigma_body[k], other.sigma_body[k]));
        let of_clock = offset_secs.abs() / both(self.sigma_offset_secs, other.sigma_offset_secs);
        Apart {
            rotation_deg: between.fixed_rows::<3>(0).norm().to_degrees(),
            translation_m: between.fixed_rows::<3>(3).norm(),
            offset_secs,
            sigmas: of_body.fold(of_clock, f64::max),
        }
    }
}

/// What least squares found of all poses, and how far the results of the first and the second half of them are apart.
pub(super) struct Halved {
    pub whole: Refined,
    /// `None` where a half alone determines nothing, or the offset drifts.
    pub halves: Option<Apart>,
}

#[derive(Clone, Copy)]
struct Unknowns {
    world: Se3,
    body: Se3,
    /// Offset, seconds, and drift.
    clock: Vector2<f64>,
}

pub(super) fn refine(
    estimate: Continuous,
    reference: Continuous,
    interpolated: Interpolated,
    start: Pair,
    offset_secs: f64,
    clock: ClockModel,
    progress: ProgressFn<'_>,
) -> Result<Halved, Error> {
    let (sparse, dense, to_dense_secs) = match interpolated {
        Interpolated::Reference => (estimate, reference, offset_secs),
        Interpolated::Estimate => (reference, estimate, -offset_secs),
    };
    let dense = Arc::new(dense);
    let is_inside = |secs: f64| {
        let moved = [-MARGIN_SECS, 0.0, MARGIN_SECS].map(|m| dense.at(secs + to_dense_secs + m));
        moved.iter().all(Option::is_some)
    };
    let inside: Vec<(f64, Se3)> = sparse
        .samples()
        .filter(|(secs, _)| is_inside(*secs))
        .collect();
    let middle_secs = match (inside.first(), inside.last()) {
        (Some(first), Some(last)) => 0.5 * (first.0 + last.0),
        _ => 0.0,
    };
    let step = inside.len().div_ceil(MOST_POSES).max(1);
    let all: Vec<BodyResidual> = inside
        .iter()
        .step_by(step)
        .map(|(secs, pose)| BodyResidual {
            interpolated,
            dense: Arc::clone(&dense),
            pose: *pose,
            secs: *secs,
            middle_secs,
            sigmas: PAPER_SIGMAS,
        })
        .collect();
    let state = Unknowns {
        world: start.reference_from_estimate_world,
        body: start.reference_from_estimate_body,
        clock: Vector2::new(offset_secs, 0.0),
    };
    let mut whole = without_outliers(&all, state, clock, progress)?;
    if interpolated == Interpolated::Estimate {
        whole.middle_secs -= whole.offset_secs;
    }
    let (first, second) = all.split_at(all.len() / 2);
    let found = Unknowns {
        world: whole.world,
        body: whole.body,
        clock: Vector2::new(whole.offset_secs, 0.0),
    };
    let half = |residuals| without_outliers(residuals, found, clock, progress).ok();
    let halves = match clock {
        ClockModel::Constant => half(first).zip(half(second)),
        // Each half has its own middle, and no drift to speak of.
        ClockModel::Drifting => None,
    };
    // A half that was stopped is not one that determines nothing.
    show_round(ROUNDS, ROUNDS, progress)?;
    Ok(Halved {
        halves: halves.map(|(first, second)| first.apart(&second)),
        whole,
    })
}

/// Adjustments from a start to what fits, at most.
const ROUNDS: usize = 5;

/// From a start to what fits.
fn without_outliers(
    all: &[BodyResidual],
    mut state: Unknowns,
    clock: ClockModel,
    progress: ProgressFn<'_>,
) -> Result<Refined, Error> {
    let mut rounds = 0..ROUNDS;
    let mut adjust = |residuals: &[BodyResidual],
                      sigmas: [f64; 2],
                      kernel: Kernel,
                      state: &mut Unknowns|
     -> Result<Solved, Error> {
        show_round(rounds.next().unwrap_or(ROUNDS), ROUNDS, progress)?;
        adjust(residuals, sigmas, kernel, clock, state)
    };
    let robust = |scale| Kernel::Cauchy { scale };
    adjust(all, PAPER_SIGMAS, robust(1.0), &mut state)?;
    for _ in 0..2 {
        let sigmas = sigmas(&errors(all, &state));
        adjust(all, sigmas, robust(3.0), &mut state)?;
    }
    let found = errors(all, &state);
    let limits = sigmas(&found);
    let fits = |error: &Vector6<f64>| weighted_norm(error, limits) <= OUTLIER;
    let good: Vec<BodyResidual> = all
        .iter()
        .zip(&found)
        .filter(|(_, error)| error.as_ref().is_some_and(fits))
        .map(|(residual, _)| residual.clone())
        .collect();
    if good.len() < LEAST_POSES {
        return Err(Error::TooFewPoses {
            role: "aligned",
            poses: good.len(),
            needed: LEAST_POSES,
        });
    }
    let problem = adjust(&good, limits, Kernel::Squared, &mut state)?;
    let found = errors(&good, &state);
    let final_sigmas = deviations(&found);
    let problem = match final_sigmas == limits {
        true => problem,
        false => adjust(&good, final_sigmas, Kernel::Squared, &mut state)?,
    };
    let factor = correlation_factor(&found);
    let (sigma_world, sigma_body, sigma_clock) = problem.sigmas(factor)?;
    let known = || found.iter().flatten();
    Ok(Refined {
        world: state.world,
        body: state.body,
        sigma_world,
        sigma_body,
        offset_secs: state.clock.x,
        sigma_offset_secs: sigma_clock,
        drift: state.clock.y,
        middle_secs: all.first().map_or(0.0, |r| r.middle_secs),
        distances_m: known().map(|e| e.fixed_rows::<3>(3).norm()).collect(),
        angles_deg: known()
            .map(|e| e.fixed_rows::<3>(0).norm().to_degrees())
            .collect(),
        poses: all.len(),
        outliers: all.len() - good.len(),
        correlated_by: (factor > 1.2).then_some(factor),
        sigmas: limits,
    })
}

fn errors(residuals: &[BodyResidual], state: &Unknowns) -> Vec<Option<Vector6<f64>>> {
    let error = |r: &BodyResidual| r.error(&state.world, &state.body, &state.clock);
    residuals.iter().map(error).collect()
}

pub(super) fn weighted_norm(error: &Vector6<f64>, sigmas: [f64; 2]) -> f64 {
    let turn = error.fixed_rows::<3>(0).norm_squared() / (sigmas[0] * sigmas[0]);
    let shift = error.fixed_rows::<3>(3).norm_squared() / (sigmas[1] * sigmas[1]);
    (turn + shift).sqrt()
}

/// Standard deviations of a component, from medians: outliers do not move them.
pub(super) fn sigmas(errors: &[Option<Vector6<f64>>]) -> [f64; 2] {
    [0, 3].map(|first| {
        let parts = errors.iter().flatten();
        let sizes = parts
            .flat_map(|e| (first..first + 3).map(|k| e[k].abs()))
            .collect();
        let usual = median(sizes).unwrap_or(0.0);
        (SIGMA_PER_MEDIAN * usual).max(LEAST_SIGMAS[first / 3])
    })
}

/// The same from squares, of what fits.
pub(super) fn deviations(errors: &[Option<Vector6<f64>>]) -> [f64; 2] {
    [0, 3].map(|first| {
        let known = errors.iter().flatten();
        let sum: f64 = known
            .clone()
            .map(|e| e.fixed_rows::<3>(first).norm_squared())
            .sum();
        let count = 3 * known.count().max(1);
        (sum / count as f64).sqrt().max(LEAST_SIGMAS[first / 3])
    })
}

/// How many neighbouring residuals say the same thing: the root of the sum of their correlations, of the component that hangs
/// together most.
pub(super) fn correlation_factor(errors: &[Option<Vector6<f64>>]) -> f64 {
    let known: Vec<&Vector6<f64>> = errors.iter().flatten().collect();
    let longest = known.len() / 4;
    (0..6)
        .map(|k| {
            let variance: f64 = known.iter().map(|e| e[k] * e[k]).sum();
            if !(variance > 0.0) {
                return 1.0;
            }
            let mut sum = 1.0;
            for lag in 1..longest {
                let product: f64 = known
                    .iter()
                    .zip(&known[lag..])
                    .map(|(a, b)| a[k] * b[k])
                    .sum();
                // Beyond the first that is lost in noise nothing adds up but noise.
                if product < 0.05 * variance {
                    break;
                }
                sum += 2.0 * product / variance;
            }
            sum.sqrt()
        })
        .fold(1.0, f64::max)
}

/// A problem that was solved, for its covariance.
struct Solved {
    problem: Problem,
    world: Block<Se3>,
    body: Block<Se3>,
    clock: Block<Vector2<f64>>,
}

fn adjust(
    residuals: &[BodyResidual],
    sigmas: [f64; 2],
    kernel: Kernel,
    model: ClockModel,
    state: &mut Unknowns,
) -> Result<Solved, Error> {
    let mut problem = Problem::new();
    let world = problem.add_block(state.world);
    let body = problem.add_block(state.body);
    let clock = problem.add_block(state.clock);
    problem.set_name(world.id(), "pose of the estimate's world");
    problem.set_name(
        body.id(),
        "pose of the estimate's body in the reference's body frame",
    );
    problem.set_name(clock.id(), "clock offset");
    if model == ClockModel::Constant {
        problem.set_constant_components(clock, &[1])?;
    }
    for residual in residuals {
        let blocks = [world.id(), body.id(), clock.id()];
        problem.add_residual(residual.with(sigmas), &blocks, kernel)?;
    }
    let config = SolveConfig {
        max_iterations: 100,
        cost_tolerance: 1e-10,
        ..SolveConfig::default()
    };
    solve_until_converged(&mut problem, &config)?;
    *state = Unknowns {
        world: problem.value(world),
        body: problem.value(body),
        clock: problem.value(clock),
    };
    Ok(Solved {
        problem,
        world,
        body,
        clock,
    })
}

impl Solved {
    /// Standard deviations of world, body and offset, raised by a factor.
    fn sigmas(&self, factor: f64) -> Result<([f64; 6], [f64; 6], f64), Error> {
        let blocks = [self.world.id(), self.body.id(), self.clock.id()];
        let found = covariance(&self.problem, &blocks)?;
        let joint = found.joint();
        let sigma = |k: usize| factor * joint[(k, k)].max(0.0).sqrt();
        Ok((
            std::array::from_fn(sigma),
            std::array::from_fn(|k| sigma(6 + k)),
            sigma(12),
        ))
    }
}
