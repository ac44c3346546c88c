use lsfb_geometry::{Se3, Vector3};
use lsfb_perception::projection::moved_by_pose;
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

/// A point of the world whose place in a site's frame was surveyed. Blocks: pose `site_from_world`, point.
///
/// `r = (T_SW X − P) / σ` axis by axis; `∂r/∂pose = R_SW [−[X]ₓ, I]`, `∂r/∂X = R_SW`, both over σ.
#[derive(Clone, Copy, Debug)]
pub struct SurveyedPoint {
    /// Where it is in the site's frame.
    pub place_in_site: Vector3<f64>,
    /// Standard deviation along each axis of that frame.
    pub sigmas_m: Vector3<f64>,
}

impl Residual for SurveyedPoint {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Se3>(), Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let site_from_world: Se3 = parameters.get(0);
        let point: Vector3<f64> = parameters.get(1);
        let off = site_from_world * point - self.place_in_site;
        out.set_residual(&off.component_div(&self.sigmas_m));
        let mut by_pose = moved_by_pose(&site_from_world, &point);
        let mut by_point = site_from_world.rotation_matrix();
        for axis in 0..3 {
            let weight = 1.0 / self.sigmas_m[axis];
            by_pose.row_mut(axis).scale_mut(weight);
            by_point.row_mut(axis).scale_mut(weight);
        }
        out.set_jacobian(0, &by_pose);
        out.set_jacobian(1, &by_point);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector6;
    use lsfb_solver::{Kernel, Problem, check_residual_jacobian};

    use super::*;

    #[test]
    fn jacobians_match_differences() {
        let mut problem = Problem::new();
        let site = problem.add_block(Se3::exp(&Vector6::new(0.1, -0.2, 1.3, 10.0, -4.0, 0.5)));
        let point = problem.add_block(Vector3::new(2.0, -1.0, 0.7));
        let residual = SurveyedPoint {
            place_in_site: Vector3::new(9.0, -3.0, 1.0),
            sigmas_m: Vector3::new(0.5, 0.2, 0.9),
        };
        problem
            .add_residual(residual, &[site.id(), point.id()], Kernel::Squared)
            .expect("blocks fit");
        check_residual_jacobian!(all of problem);
    }
}
