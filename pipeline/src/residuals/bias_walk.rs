use lsfb_geometry::{Matrix3, Vector3};
use lsfb_solver::{Linearization, Parameters, Residual, Shape, Undefined};

/// A bias that wanders between two instants. Blocks: bias at the first, bias at the second.
///
/// `r = (b₂ − b₁) / (σ √Δt)` with the density σ of the random walk: derivatives `∓1 / (σ √Δt)`.
#[derive(Clone, Copy, Debug)]
pub struct BiasWalk {
    /// Random walk of the bias, unit of the bias per √s.
    pub walk_per_sqrt_s: f64,
    /// Time between the two, seconds.
    pub duration_secs: f64,
}

impl Residual for BiasWalk {
    fn dimension(&self) -> usize {
        3
    }

    fn blocks(&self) -> &[Shape] {
        const { &[Shape::of::<Vector3<f64>>(), Shape::of::<Vector3<f64>>()] }
    }

    fn evaluate(&self, parameters: &Parameters, out: &mut Linearization) -> Result<(), Undefined> {
        let (first, second): (Vector3<f64>, Vector3<f64>) = (parameters.get(0), parameters.get(1));
        let weight = 1.0 / (self.walk_per_sqrt_s * self.duration_secs.sqrt());
        out.set_residual(&((second - first) * weight));
        out.set_jacobian(0, &(Matrix3::identity() * -weight));
        out.set_jacobian(1, &(Matrix3::identity() * weight));
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use lsfb_solver::check_residual_jacobian;

    use super::*;

    check_residual_jacobian!(
        jacobians_match_differences,
        BiasWalk {
            walk_per_sqrt_s: 1e-2,
            duration_secs: 0.1,
        },
        Vector3::new(0.01, -0.02, 0.03),
        Vector3::new(0.02, -0.01, 0.0),
    );
}
