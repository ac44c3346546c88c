//! Whether the board is as large as it was said to be: the accelerometer knows lengths from gravity.

use lsfb_solver::solve;
use nalgebra::DVector;

use super::CameraImuConfig;
use super::bend::{BEND, SIZE};
use super::blocks::{Blocks, SIZE_SIGMA};
use super::effort::Effort;
use super::parts::{Known, known};
use super::state::RigEstimate;
use crate::Error;

/// By how much all of a board is larger than said, as a share.
#[derive(Clone, Copy)]
pub(super) struct BoardExcess {
    pub share: f64,
    pub sigma: f64,
    /// Share of the corners' squares that it takes off.
    pub explains: f64,
}

impl RigEstimate {
    /// By how much all of the board is larger than said, as the accelerometer has it against gravity: a wrong scale of the
    /// accelerometer is none of the board.
    pub fn board_excess(&self, config: &CameraImuConfig) -> Result<BoardExcess, Error> {
        let effort = Effort::of_size();
        let (mut problem, blocks) = self.problem(config, effort)?;
        let report = solve(&mut problem, &effort.settings())?;
        let size = 1.0 + problem.value(blocks.bend)[SIZE];
        let gravity = problem.value(blocks.gravity);
        let share = config.gravity_m_s2 / gravity.norm();
        let asked = |blocks: &Blocks| {
            let mut asked = vec![blocks.bend.id(), blocks.gravity.id()];
            asked.extend(blocks.of_cameras(config));
            asked
        };
        let found = known(&problem, &asked(&blocks), &blocks.timed);
        let Ok(Known {
            covariance,
            scatter,
            bias,
            ..
        }) = found
        else {
            // So little motion that only the prior is left.
            return Ok(BoardExcess {
                share: 0.0,
                sigma: SIZE_SIGMA,
                explains: 0.0,
            });
        };
        let mut by = DVector::zeros(bias.len());
        by[SIZE] = share;
        by.fixed_rows_mut::<3>(BEND)
            .copy_from(&(-gravity * (size * share / gravity.norm_squared())));
        let variance = by.dot(&(covariance.joint() * &by));
        let moved = self.moved_by_spread(config, effort, asked)?;
        let unmodelled: f64 = moved.iter().map(|m| by.dot(m).powi(2)).sum();
        Ok(BoardExcess {
            share: size * share - 1.0,
            sigma: (variance.max(0.0).sqrt() * scatter.factor_along(&by))
                .hypot(by.dot(&bias))
                .hypot(unmodelled.sqrt()),
            explains: (report.initial_cost - report.final_cost) / self.cost_of_corners().max(1e-12),
        })
    }
}
