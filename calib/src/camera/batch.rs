//! The least-squares problem of all corners that count.

use std::collections::BTreeMap;

use lsfb_geometry::{Se3, Vector2, Vector3};
use lsfb_solver::{
    Block, Kernel, Problem, ResidualId, SolveConfig, Undetermined, solve_until_converged,
};
use nalgebra::SVector;

use super::corner_residual::CornerResidual;
use super::solved::Solved;
use crate::Error;
use crate::board::Target;
use crate::detect::Corner;
use crate::projection::lens_camera;
use crate::residual_diagnosis::{Field, moved_by_field};

/// What an adjustment may change.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Freedom {
    Everything,
    PosesOfTarget,
}

/// The least-squares problem of all inliers, with lenses of `N` parameters.
pub(super) struct Batch<const N: usize> {
    pub problem: Problem,
    first_from_target: BTreeMap<i64, Block<Se3>>,
    /// Lens and pose of each.
    pub cameras: Vec<(Block<SVector<f64, N>>, Block<Se3>)>,
    /// Residuals by instant.
    pub corners: BTreeMap<i64, Vec<ResidualId>>,
}

impl<const N: usize> Batch<N> {
    /// The camera whose lens or pose it is, and what of it; where it is a pose of the board, it is that of all cameras.
    fn named(&self, solved: &Solved, found: &Undetermined) -> [String; 2] {
        for (start, (lens, pose)) in solved.cameras.iter().zip(&self.cameras) {
            let names = start.camera.lens.model().parameter_names();
            let what = match found.block {
                block if block == lens.id() => names.get(found.component).copied(),
                block if block == pose.id() => Some("its pose in the rig"),
                _ => continue,
            };
            return [start.views.name.as_str(), what.unwrap_or_default()].map(str::to_owned);
        }
        let names = solved.cameras.iter().map(|c| c.views.name.as_str());
        let names: Vec<&str> = names.collect();
        let mut poses = self.first_from_target.iter();
        let pose = match poses.find(|(_, block)| block.id() == found.block) {
            Some((instant, _)) => format!("a pose of the board (image {instant})"),
            None => "a pose of the board".to_owned(),
        };
        [names.join(", "), pose]
    }
}

/// Calls a method of [`Solved`] for the number of its lenses' parameters; without a camera there is `$nothing`. A model with another
/// number needs a line here: the test below finds it.
macro_rules! for_lens_size {
    ($solved:expr, $method:ident($($argument:expr),*), $nothing:expr) => {
        match $solved.lens_size() {
            5 => $solved.$method::<5>($($argument),*),
            6 => $solved.$method::<6>($($argument),*),
            8 => $solved.$method::<8>($($argument),*),
            9 => $solved.$method::<9>($($argument),*),
            _ => $nothing,
        }
    };
}
pub(super) use for_lens_size;

impl Solved<'_> {
    /// Minimises over the inliers.
    pub fn adjust(
        &mut self,
        target: &Target,
        kernel: Kernel,
        freedom: Freedom,
    ) -> Result<(), Error> {
        for_lens_size!(self, adjust_sized(target, kernel, freedom), Ok(()))
    }

    fn adjust_sized<const N: usize>(
        &mut self,
        target: &Target,
        kernel: Kernel,
        freedom: Freedom,
    ) -> Result<(), Error> {
        let mut batch = self.batch::<N>(target, kernel, freedom, &[])?;
        let config = SolveConfig {
            max_iterations: 100,
            cost_tolerance: 1e-12,
            ..SolveConfig::default()
        };
        let report = solve_until_converged(&mut batch.problem, &config)?;
        self.undetermined = report
            .undetermined
            .first()
            .map(|found| batch.named(self, found));
        for (t, block) in batch.first_from_target {
            self.first_from_target.insert(t, batch.problem.value(block));
        }
        for (start, (lens, pose)) in self.cameras.iter_mut().zip(batch.cameras) {
            let size = [start.camera.width, start.camera.height];
            let lens = batch.problem.value(lens);
            start.camera = lens_camera(start.camera.lens.model(), size, &lens);
            start.camera_from_first = batch.problem.value(pose);
        }
        Ok(())
    }

    /// The problem of all inliers at the present values; pixels are moved by what the models of lens and board do not know, by
    /// camera, where that is given.
    pub fn batch<const N: usize>(
        &self,
        target: &Target,
        kernel: Kernel,
        freedom: Freedom,
        fields: &[Field],
    ) -> Result<Batch<N>, Error> {
        let mut problem = Problem::new();
        let poses: BTreeMap<i64, Block<Se3>> = self
            .first_from_target
            .iter()
            .map(|(t, pose)| (*t, problem.add_block(*pose)))
            .collect();
        let mut cameras = Vec::with_capacity(self.cameras.len());
        let mut corners: BTreeMap<i64, Vec<ResidualId>> = BTreeMap::new();
        for (k, start) in self.cameras.iter().enumerate() {
            let values = start.camera.lens.parameters().values;
            let lens = problem.add_block(SVector::<f64, N>::from_column_slice(&values[..N]));
            let pose = problem.add_block(start.camera_from_first);
            if freedom == Freedom::PosesOfTarget {
                problem.set_constant(lens);
            }
            if k == 0 || freedom == Freedom::PosesOfTarget {
                problem.set_constant(pose);
            }
            cameras.push((lens, pose));
            for instant in &start.chosen {
                let blocks = [lens.id(), pose.id(), poses[instant].id()];
                let counts = &self.inliers[k][instant];
                let view = start.views.views[instant].iter().zip(counts);
                for (corner, _) in view.filter(|(_, inlier)| **inlier) {
                    let residual = CornerResidual::<N> {
                        model: start.camera.lens.model(),
                        size: [start.camera.width, start.camera.height],
                        point_in_target: target.corner(corner.index),
                        pixel: corner.pixel - self.moved_px(target, k, *instant, corner, fields),
                    };
                    let id = problem.add_residual(residual, &blocks, kernel)?;
                    corners.entry(*instant).or_default().push(id);
                }
            }
        }
        Ok(Batch {
            problem,
            first_from_target: poses,
            cameras,
            corners,
        })
    }

    /// By how much a field moves a corner, pixels.
    fn moved_px(
        &self,
        target: &Target,
        camera: usize,
        instant: i64,
        corner: &Corner,
        fields: &[Field],
    ) -> Vector2<f64> {
        let start = &self.cameras[camera];
        let moved = || {
            let field = fields.get(camera)?;
            let camera_from_target =
                start.camera_from_first * *self.first_from_target.get(&instant)?;
            let point = target.corner(corner.index);
            let seen = start.camera.project_full(&(camera_from_target * point))?;
            let by_point = seen.pixel_by_point * camera_from_target.rotation_matrix();
            let [width, height] = target.corners_size();
            let centre = Vector3::new(0.5 * width, 0.5 * height, 0.0);
            let place = (point - centre) / centre.amax().max(1e-9);
            Some(moved_by_field(&start.camera, &seen.pixel, &by_point, &place) * field)
        };
        moved().unwrap_or_else(Vector2::zeros)
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::camera::LensModel;

    struct Sized(usize);

    impl Sized {
        fn lens_size(&self) -> usize {
            self.0
        }

        fn size<const N: usize>(&self) -> usize {
            N
        }
    }

    /// One without a line would leave an adjustment as it began, and report no camera.
    #[test]
    fn every_lens_model_is_adjusted() {
        for model in LensModel::ALL {
            let count = model.parameter_count();
            let sized = Sized(count);
            assert_eq!(for_lens_size!(sized, size(), 0), count, "{}", model.name());
        }
    }
}
