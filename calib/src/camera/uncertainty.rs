//! How surely lenses and camera poses are known, and what the views do not determine.

use lsfb_solver::{Influence, Influences, Kernel, ResidualId, influences};
use nalgebra::DMatrix;

use super::batch::{Freedom, for_lens_size};
use super::solved::Solved;
use crate::Error;
use crate::board::Target;
use crate::residual_diagnosis::Field;
use crate::scatter::{Scatter, moved};

/// Tangent dimension of a pose.
const POSE: usize = 6;
const ADVICE: &str = "show the target tilted by 30° about both of its axes, near and far, and in every part of the image";

/// How surely a camera is known: its lens parameters, then rotation and translation of its pose. The first camera's pose is the frame
/// of all, and has no uncertainty.
pub(super) struct Uncertainty {
    /// By the weights alone.
    pub covariance: DMatrix<f64>,
    /// Factors on standard deviations, as instants scatter.
    pub factors: Vec<f64>,
    /// By how much what the models of lens and board do not know would move them.
    pub bias: Vec<f64>,
}

impl Solved<'_> {
    /// By camera, where pixels are moved by `fields`; `variance` is that of a corner in one direction, px².
    pub fn uncertainties(
        &self,
        target: &Target,
        fields: &[Field],
        variance: f64,
    ) -> Result<Vec<Uncertainty>, Error> {
        for_lens_size!(
            self,
            uncertainties_sized(target, fields, variance),
            Ok(Vec::new())
        )
    }

    fn uncertainties_sized<const N: usize>(
        &self,
        target: &Target,
        fields: &[Field],
        variance: f64,
    ) -> Result<Vec<Uncertainty>, Error> {
        if let Some([camera, parameters]) = self.undetermined.clone() {
            return Err(Error::Undetermined {
                camera,
                parameters,
                advice: ADVICE,
            });
        }
        let batch = self.batch::<N>(target, Kernel::Squared, Freedom::Everything, fields)?;
        let blocks = batch.cameras.iter().enumerate();
        let blocks = blocks.flat_map(|(k, (lens, pose))| {
            let pose = (k > 0).then_some(pose.id());
            [Some(lens.id()), pose].into_iter().flatten()
        });
        let blocks: Vec<_> = blocks.collect();
        let instants: Vec<Vec<ResidualId>> = batch.corners.into_values().collect();
        let Influences {
            covariance,
            step,
            groups,
        } = influences(&batch.problem, &blocks, &instants)?;
        // The problem's corners have a variance of one.
        let covariance = covariance.joint() * variance;
        let groups = groups.into_iter().map(|group| Influence {
            noise: group.noise * variance,
            ..group
        });
        let parts = moved(&covariance, groups.collect(), &step);
        let factors = Scatter::of_neighbours(&covariance, &parts).factors(step.len());
        // Where each row of a camera is among those that were asked for.
        let row = |camera: usize, own: usize| match (camera, own) {
            (0, own) => (own < N).then_some(own),
            (camera, own) => Some(camera * (N + POSE) - POSE + own),
        };
        let of_camera = |camera: usize| {
            let rows: Vec<Option<usize>> = (0..N + POSE).map(|own| row(camera, own)).collect();
            let at = |i: usize, j: usize| Some(covariance[(rows[i]?, rows[j]?)]);
            Uncertainty {
                covariance: DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
                    at(i, j).unwrap_or(0.0)
                }),
                factors: rows
                    .iter()
                    .map(|row| row.map_or(1.0, |r| factors[r]))
                    .collect(),
                bias: rows
                    .iter()
                    .map(|row| row.map_or(0.0, |r| step[r]))
                    .collect(),
            }
        };
        Ok((0..self.cameras.len()).map(of_camera).collect())
    }

    /// Number of unknowns, poses of the target included.
    pub fn unknowns(&self) -> usize {
        let poses = self.cameras.len().saturating_sub(1) + self.first_from_target.len();
        self.lens_size() * self.cameras.len() + POSE * poses
    }
}
