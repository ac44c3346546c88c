//! Standard deviations of everything that is reported.

use lsfb_geometry::camera::MAX_PARAMETERS;
use lsfb_geometry::{Matrix6, Se3, Vector3, so3};
use lsfb_solver::{BlockId, undamped_step};
use nalgebra::{DMatrix, DVector, Matrix3, SMatrix};
use rayon::prelude::*;

use super::bend::BEND;
use super::blocks::Blocks;
use super::effort::{Effort, Moved};
use super::halves::{SplitEstimate, halves};
use super::parts::known;
use super::state::{Mounted, RigEstimate};
use super::{Axes, BoardShape, CameraImuConfig, Lenses, Readout};
use crate::Error;
use crate::residual_diagnosis::FREED;

/// Joint covariance of what was found. Poses of cameras are there as right perturbations of `camera_from_rig`, biases as those
/// in the middle of the recording, gravity in the target's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct JointCovariance {
    /// What each row is: `cam0 turn x`, `cam0 shift x`, `cam0 clock`, `cam0 drift`, `cam0 fx`, `cam0 readout`, `gyroscope bias x`,
    /// `accelerometer bias x`, `gravity x`, `accelerometer delay`; cameras by name.
    pub names: Vec<String>,
    /// The covariance, in SI units and pixels.
    pub matrix: DMatrix<f64>,
}

/// Standard deviations of one camera.
pub(super) struct OfCamera {
    pub pose: Matrix6<f64>,
    pub offset_s: f64,
    pub drift: f64,
    pub readout_s: f64,
    /// By lens parameter; zero where they were not searched.
    pub lens: Vec<f64>,
}

/// Standard deviations of the IMU's errors, in the middle of the recording.
pub(super) struct Uncertainty {
    pub cameras: Vec<OfCamera>,
    pub gyro_bias: Vector3<f64>,
    pub accel_bias: Vector3<f64>,
    pub gravity: Vector3<f64>,
    /// Of how much later than the gyroscope the accelerometer measures, seconds; zero where it was not searched.
    pub accel_delay_s: f64,
    /// Covariance of the bend; zero where it was not searched.
    pub bend: SMatrix<f64, BEND, BEND>,
    /// Errors of the axes of gyroscope and accelerometer; empty where they were not searched.
    pub axes: Vec<f64>,
    pub joint: JointCovariance,
    /// What either half of the recording says for itself.
    pub halves: Vec<SplitEstimate>,
}

const AXES: [&str; 3] = ["x", "y", "z"];

impl RigEstimate {
    /// Which of the biases' control points lies in the middle of the recording.
    pub fn middle_bias(&self) -> usize {
        self.gyro_bias.len() / 2
    }

    pub fn uncertainty(&self, config: &CameraImuConfig) -> Result<Uncertainty, Error> {
        let (problem, blocks) = self.problem(config, Effort::of_uncertainty())?;
        let named = self.named(&blocks, config);
        let ids = asked(&named, &blocks, config);
        let known = known(&problem, &ids, &blocks.timed)?;
        let factors = known.scatter.factors(known.bias.len());
        let mut found = known.covariance.widened(&factors, &known.bias);
        let mut unmodelled = known.bias.abs();
        let of = |blocks: &Blocks| asked(&self.named(blocks, config), blocks, config);
        // Poses and clocks rest on the IMU as well, lenses on the board alone.
        let is_lens: Vec<bool> = named
            .iter()
            .flat_map(|(id, names)| {
                let is_lens = blocks.lenses.iter().any(|lens| lens.id() == *id);
                std::iter::repeat_n(is_lens, names.len())
            })
            .collect();
        for by in self.moved_by_spread(config, Effort::of_round(0, true), of)? {
            let of_row = |k: usize, _| match is_lens.get(k) {
                Some(true) => by[k],
                _ => 0.0,
            };
            let by = DVector::from_fn(unmodelled.len(), of_row);
            found = found.widened(&[], &by);
            unmodelled.zip_apply(&by, |own, by| *own = own.hypot(by));
        }
        let sigmas = |block: BlockId| -> Vec<f64> {
            let own = found.between(block, block);
            own.map_or_else(Vec::new, |c| {
                c.diagonal().iter().map(|v| v.max(0.0).sqrt()).collect()
            })
        };
        let vector = |block: BlockId| Vector3::from_iterator(padded(sigmas(block)));
        let scalar = |block: BlockId| sigmas(block).first().copied().unwrap_or_default();
        let cameras = (0..self.cameras.len())
            .map(|k| {
                let pose = blocks.poses[k].id();
                let pose = found.between(pose, pose);
                let count = self.cameras[k].camera.lens.parameters().count;
                let lens = sigmas(blocks.lenses[k].id()).into_iter();
                OfCamera {
                    pose: pose.map_or_else(Matrix6::zeros, |c| {
                        Matrix6::from_iterator(c.iter().copied())
                    }),
                    offset_s: scalar(blocks.clocks[k].id()),
                    drift: padded(sigmas(blocks.clocks[k].id()))
                        .nth(1)
                        .unwrap_or_default(),
                    readout_s: scalar(blocks.readouts[k].id()),
                    lens: padded(lens).take(count).collect(),
                }
            })
            .collect();
        let middle = self.middle_bias();
        Ok(Uncertainty {
            cameras,
            gyro_bias: vector(blocks.gyro_bias[middle].id()),
            accel_bias: vector(blocks.accel_bias[middle].id()),
            gravity: vector(blocks.gravity.id()),
            accel_delay_s: blocks.delay(config).map_or(0.0, scalar),
            bend: found
                .between(blocks.bend.id(), blocks.bend.id())
                .map_or_else(SMatrix::zeros, |c| {
                    SMatrix::from_iterator(c.iter().copied())
                }),
            axes: of_axes(&blocks, config)
                .into_iter()
                .flat_map(sigmas)
                .collect(),
            joint: rows_with_names(&named, found.joint()),
            halves: self.halves(config, &unmodelled)?,
        })
    }

    /// By how much what is not known of lens and board would move blocks, one direction after the other: what it is likely to be is
    /// known no better than the views tell it.
    pub(super) fn moved_by_spread(
        &self,
        config: &CameraImuConfig,
        effort: Effort,
        asked: impl Fn(&Blocks) -> Vec<BlockId> + Sync,
    ) -> Result<Vec<DVector<f64>>, Error> {
        let is_there = |c: &Mounted| c.unmodelled.spread.iter().any(|v| *v != 0.0);
        if !self.cameras.iter().any(is_there) {
            return Ok(Vec::new());
        }
        let step = |moved| -> Result<DVector<f64>, Error> {
            let (problem, blocks) = self.problem(config, Effort { moved, ..effort })?;
            Ok(undamped_step(&problem, &asked(&blocks))?)
        };
        let still = step(Moved::Nothing)?;
        let along = |direction| Ok(step(Moved::Along(direction))? - &still);
        (0..FREED).into_par_iter().map(along).collect()
    }

    /// What either half of the recording finds by the models as they are.
    fn halves(
        &self,
        config: &CameraImuConfig,
        unmodelled: &DVector<f64>,
    ) -> Result<Vec<SplitEstimate>, Error> {
        let (problem, blocks) = self.problem(config, Effort::of_round(0, true))?;
        let named = self.named(&blocks, config);
        let asked = asked(&named, &blocks, config);
        let names: Vec<Option<String>> = named.into_iter().flat_map(|n| n.1).collect();
        halves(&problem, &asked, &blocks.timed, &names, unmodelled)
    }

    /// Blocks of [`JointCovariance`] with the names of their components; components that are not searched have none.
    fn named(
        &self,
        blocks: &Blocks,
        config: &CameraImuConfig,
    ) -> Vec<(BlockId, Vec<Option<String>>)> {
        let along = |what: &str| AXES.map(|axis| Some(format!("{what} {axis}")));
        let mut named = Vec::new();
        for (k, camera) in self.cameras.iter().enumerate() {
            let name = &camera.name;
            let [turn, shift] = ["turn", "shift"].map(|word| along(&format!("{name} {word}")));
            named.push((blocks.poses[k].id(), [turn, shift].concat()));
            let clock = ["clock", "drift"].map(|word| Some(format!("{name} {word}")));
            named.push((blocks.clocks[k].id(), clock.to_vec()));
            if config.lenses == Lenses::Refined {
                let names = camera.model().parameter_names().iter();
                let mut names: Vec<_> = names.map(|p| Some(format!("{name} {p}"))).collect();
                names.resize(MAX_PARAMETERS, None);
                named.push((blocks.lenses[k].id(), names));
            }
            if config.readout == Readout::Estimated {
                named.push((
                    blocks.readouts[k].id(),
                    vec![Some(format!("{name} readout"))],
                ));
            }
        }
        let middle = self.middle_bias();
        for (what, block) in [
            ("gyroscope bias", blocks.gyro_bias[middle]),
            ("accelerometer bias", blocks.accel_bias[middle]),
            ("gravity", blocks.gravity),
        ] {
            named.push((block.id(), along(what).to_vec()));
        }
        let delay = blocks.delay(config);
        named.extend(delay.map(|id| (id, vec![Some("accelerometer delay".to_owned())])));
        named
    }
}

/// The blocks whose covariance is asked for, those with names first.
fn asked(
    named: &[(BlockId, Vec<Option<String>>)],
    blocks: &Blocks,
    config: &CameraImuConfig,
) -> Vec<BlockId> {
    let mut asked: Vec<BlockId> = named.iter().map(|n| n.0).collect();
    asked.extend(of_axes(blocks, config));
    if config.board == BoardShape::Bent {
        asked.push(blocks.bend.id());
    }
    asked
}

fn of_axes(blocks: &Blocks, config: &CameraImuConfig) -> Vec<BlockId> {
    match config.axes {
        Axes::Ideal => vec![],
        Axes::NearlyIdeal | Axes::Estimated => vec![blocks.gyro_axes.id(), blocks.accel_axes.id()],
    }
}

/// The rows and columns that have a name, of a joint covariance that begins with these blocks.
fn rows_with_names(
    named: &[(BlockId, Vec<Option<String>>)],
    joint: &DMatrix<f64>,
) -> JointCovariance {
    let (rows, names): (Vec<usize>, Vec<String>) = named
        .iter()
        .flat_map(|(_, names)| names)
        .enumerate()
        .filter_map(|(row, name)| Some((row, name.clone()?)))
        .unzip();
    JointCovariance {
        matrix: DMatrix::from_fn(rows.len(), rows.len(), |i, j| joint[(rows[i], rows[j])]),
        names,
    }
}

/// The values, then zeros.
fn padded(values: impl IntoIterator<Item = f64>) -> impl Iterator<Item = f64> {
    values.into_iter().chain(std::iter::repeat(0.0))
}

impl OfCamera {
    /// Standard deviations of the camera's orientation about the rig's axes and of its position in the rig: the camera stands
    /// at `p = −Rᵀ t`, and a right perturbation `(φ, ρ)` of `camera_from_rig` moves that by `p × φ − ρ`.
    pub fn in_rig(&self, camera_from_rig: &Se3) -> ([f64; 3], [f64; 3]) {
        let place = camera_from_rig.inverse().translation;
        let mut by_pose = SMatrix::<f64, 3, 6>::zeros();
        by_pose
            .fixed_view_mut::<3, 3>(0, 0)
            .copy_from(&so3::hat(&place));
        by_pose
            .fixed_view_mut::<3, 3>(0, 3)
            .copy_from(&-Matrix3::identity());
        let of_place = by_pose * self.pose * by_pose.transpose();
        let root = |v: f64| v.max(0.0).sqrt();
        (
            [0, 1, 2].map(|k| root(self.pose[(k, k)])),
            [0, 1, 2].map(|k| root(of_place[(k, k)])),
        )
    }
}
