//! Uniform cumulative B-splines on SO(3) × R³: smooth motion with analytic velocity and acceleration.
//!
//! A spline of order `N` (degree `N − 1`) is moved at any time by `N` neighbouring control points. Formulas: Sommer,
//! Usenko, Schubert, Demmel, Cremers, "Efficient derivative computation for cumulative B-splines on Lie groups",
//! CVPR 2020. Derivatives by control points are by right perturbation, `R_j exp(delta_j)`.
//!
//! ```
//! use lsfb_geometry::spline::{Segment, UniformKnots};
//! use lsfb_geometry::{Vector3, so3};
//! // One turn in 4 s about z, as seen by a cubic spline with control points every 0.1 s.
//! let rate_rad_s = std::f64::consts::TAU / 4.0;
//! let knots = UniformKnots { start_s: 0.0, spacing_s: 0.1 };
//! let controls: Vec<_> = (0..10).map(|k| so3::exp(&Vector3::new(0.0, 0.0, rate_rad_s * 0.1 * f64::from(k)))).collect();
//! let Segment { first, weights } = knots.segment::<4>(0.25, controls.len()).expect("inside");
//! let rotation = lsfb_geometry::spline::rotation(&weights, &controls[first..first + 4]).expect("four control points");
//! assert!((rotation.angular_velocity - Vector3::new(0.0, 0.0, rate_rad_s)).norm() < 1e-12);
//! ```

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

use crate::so3;

/// Where the control points of a spline lie in time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UniformKnots {
    /// Start of the first segment, seconds.
    pub start_s: f64,
    /// Length of a segment, seconds.
    pub spacing_s: f64,
}

/// The place of a time on a spline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment<const N: usize> {
    /// First of the `N` control points that move this time.
    pub first: usize,
    /// Their weights.
    pub weights: Weights<N>,
}

/// Weights of the `N` control points of one time, with derivatives per second.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights<const N: usize> {
    /// `B_j`: they add up to 1.
    pub value: [f64; N],
    /// `dB_j/dt`.
    pub rate: [f64; N],
    /// `d²B_j/dt²`.
    pub acceleration: [f64; N],
}

impl UniformKnots {
    /// Control points that a spline of order `N` needs to cover `[start_s, end_s]`.
    pub fn count<const N: usize>(&self, end_s: f64) -> usize {
        let segments = ((end_s - self.start_s) / self.spacing_s).floor().max(0.0);
        // `as` saturates: an absurd length gives a count that allocation refuses, not a wrap-around.
        (segments as usize).saturating_add(N)
    }

    /// End of the time that `controls` control points cover, seconds.
    pub fn end_s<const N: usize>(&self, controls: usize) -> f64 {
        self.start_s + self.spacing_s * controls.saturating_sub(N - 1) as f64
    }

    /// The segment of `time_s` on a spline of `controls` control points; `None` outside it.
    pub fn segment<const N: usize>(&self, time_s: f64, controls: usize) -> Option<Segment<N>> {
        let position = (time_s - self.start_s) / self.spacing_s;
        if !(position >= 0.0) {
            return None;
        }
        let mut first = position as usize;
        // The very end belongs to the last segment.
        if first + N == controls + 1 && position == first as f64 {
            first = first.checked_sub(1)?;
        }
        if first.checked_add(N)? > controls {
            return None;
        }
        Some(Segment {
            first,
            weights: Weights::at(position - first as f64, self.spacing_s),
        })
    }
}

impl<const N: usize> Weights<N> {
    /// Weights at `fraction` of a segment of `spacing_s` seconds.
    pub fn at(fraction: f64, spacing_s: f64) -> Self {
        let inverse = 1.0 / spacing_s;
        let mut below = [[0.0; N]; 3];
        // Cox–de Boor on uniform knots, order 1 … N; the last three orders give value, rate and acceleration.
        let mut basis = [0.0; N];
        basis[0] = 1.0;
        for order in 1..=N {
            if order > 1 {
                let degree = (order - 1) as f64;
                let mut next = [0.0; N];
                for (j, out) in next.iter_mut().enumerate().take(order) {
                    // Of this order's `order` functions, number j has its support from −(degree − j).
                    let left = if j > 0 { basis[j - 1] } else { 0.0 };
                    let right = if j + 1 < order { basis[j] } else { 0.0 };
                    let j = j as f64;
                    *out = (left * (fraction + degree - j) + right * (1.0 + j - fraction)) / degree;
                }
                basis = next;
            }
            if order + 2 >= N {
                below[N - order] = basis;
            }
        }
        let mut rate = difference(&below[1]);
        rate.iter_mut().for_each(|w| *w *= inverse);
        let mut acceleration = if N >= 3 {
            difference(&difference(&below[2]))
        } else {
            [0.0; N]
        };
        acceleration
            .iter_mut()
            .for_each(|w| *w *= inverse * inverse);
        Self {
            value: below[0],
            rate,
            acceleration,
        }
    }
}

/// Derivative of a sum over functions of one order less: `B'_j = b_{j−1} − b_j`.
fn difference<const N: usize>(lower: &[f64; N]) -> [f64; N] {
    std::array::from_fn(|j| (if j > 0 { lower[j - 1] } else { 0.0 }) - lower[j])
}

/// Sums from `j` to the end: the weights of the cumulative form.
fn cumulative<const N: usize>(weights: &[f64; N]) -> [f64; N] {
    let mut out = *weights;
    for j in (0..N.saturating_sub(1)).rev() {
        out[j] += out[j + 1];
    }
    out
}

/// Position on the R³ part, with derivatives. Each derivative by control point `j` is the weight times identity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplinePosition {
    /// In the frame of the control points, metres.
    pub position: Vector3<f64>,
    /// m/s.
    pub velocity: Vector3<f64>,
    /// m/s².
    pub acceleration: Vector3<f64>,
}

/// The R³ part at one time; `None` where there are not `N` control points.
pub fn position<const N: usize>(
    weights: &Weights<N>,
    controls: &[Vector3<f64>],
) -> Option<SplinePosition> {
    let controls: &[Vector3<f64>; N] = controls.try_into().ok()?;
    let sum = |weights: &[f64; N]| {
        controls
            .iter()
            .zip(weights)
            .fold(Vector3::zeros(), |sum, (c, w)| sum + c * *w)
    };
    Some(SplinePosition {
        position: sum(&weights.value),
        velocity: sum(&weights.rate),
        acceleration: sum(&weights.acceleration),
    })
}

/// Rotation on the SO(3) part, with derivatives in the body frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplineRotation {
    /// `world_from_body`, if that is what the control points are.
    pub rotation: UnitQuaternion<f64>,
    /// rad/s, in the body frame.
    pub angular_velocity: Vector3<f64>,
    /// rad/s², in the body frame.
    pub angular_acceleration: Vector3<f64>,
}

/// [`SplineRotation`] with its derivatives by the control points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplineRotationJacobians<const N: usize> {
    /// The values.
    pub at: SplineRotation,
    /// Right perturbation of the rotation by that of each control point.
    pub rotation_by_control: [Matrix3<f64>; N],
    /// Angular velocity by the right perturbation of each control point.
    pub angular_velocity_by_control: [Matrix3<f64>; N],
}

/// The SO(3) part at one time; `None` where there are not `N` control points.
pub fn rotation<const N: usize>(
    weights: &Weights<N>,
    controls: &[UnitQuaternion<f64>],
) -> Option<SplineRotation> {
    let controls: &[UnitQuaternion<f64>; N] = controls.try_into().ok()?;
    let lambda = cumulative(&weights.value);
    let lambda_rate = cumulative(&weights.rate);
    let lambda_acceleration = cumulative(&weights.acceleration);
    let mut at = SplineRotation {
        rotation: controls[0],
        angular_velocity: Vector3::zeros(),
        angular_acceleration: Vector3::zeros(),
    };
    for j in 1..N {
        let d = so3::log(&(controls[j - 1].inverse() * controls[j]));
        let step = so3::exp(&(d * lambda[j]));
        at.advance(&step, &d, lambda_rate[j], lambda_acceleration[j]);
    }
    at.rotation.renormalize();
    Some(at)
}

impl SplineRotation {
    /// Appends one factor `exp(λ d)` on the right.
    fn advance(
        &mut self,
        step: &UnitQuaternion<f64>,
        d: &Vector3<f64>,
        rate: f64,
        acceleration: f64,
    ) {
        let back = step.inverse();
        let moved = back * self.angular_velocity;
        self.rotation *= step;
        self.angular_velocity = moved + d * rate;
        self.angular_acceleration = back * self.angular_acceleration
            + self.angular_velocity.cross(d) * rate
            + d * acceleration;
    }
}

/// [`rotation`] with derivatives by the control points.
pub fn rotation_with_jacobians<const N: usize>(
    weights: &Weights<N>,
    controls: &[UnitQuaternion<f64>],
) -> Option<SplineRotationJacobians<N>> {
    let controls: &[UnitQuaternion<f64>; N] = controls.try_into().ok()?;
    let lambda = cumulative(&weights.value);
    let lambda_rate = cumulative(&weights.rate);
    let lambda_acceleration = cumulative(&weights.acceleration);

    let mut at = SplineRotation {
        rotation: controls[0],
        angular_velocity: Vector3::zeros(),
        angular_acceleration: Vector3::zeros(),
    };
    let mut differences = [Vector3::zeros(); N];
    let mut steps = [Matrix3::identity(); N];
    // Derivatives by the differences d_j, in the frame just after factor j.
    let mut rotation_by_d = [Matrix3::zeros(); N];
    let mut velocity_by_d = [Matrix3::zeros(); N];
    for j in 1..N {
        let d = so3::log(&(controls[j - 1].inverse() * controls[j]));
        let step = so3::exp(&(d * lambda[j]));
        differences[j] = d;
        steps[j] = step.to_rotation_matrix().into_inner();
        let by_d = so3::right_jacobian(&(d * lambda[j])) * lambda[j];
        let carried = step.inverse() * at.angular_velocity;
        rotation_by_d[j] = by_d;
        velocity_by_d[j] = so3::hat(&carried) * by_d + Matrix3::identity() * lambda_rate[j];
        at.advance(&step, &d, lambda_rate[j], lambda_acceleration[j]);
    }
    at.rotation.renormalize();

    let mut rotation_by_control = [Matrix3::zeros(); N];
    let mut angular_velocity_by_control = [Matrix3::zeros(); N];
    // `after`: transposed product of the factors behind j, which brings tangents to the end.
    let mut after = Matrix3::identity();
    for j in (1..N).rev() {
        let by_later = so3::right_jacobian_inverse(&differences[j]);
        // left inverse is the transpose of the right inverse
        let by_earlier = -by_later.transpose();
        let r = after * rotation_by_d[j];
        let w = after * velocity_by_d[j];
        rotation_by_control[j] += r * by_later;
        rotation_by_control[j - 1] += r * by_earlier;
        angular_velocity_by_control[j] += w * by_later;
        angular_velocity_by_control[j - 1] += w * by_earlier;
        after *= steps[j].transpose();
    }
    rotation_by_control[0] += after;
    Some(SplineRotationJacobians {
        at,
        rotation_by_control,
        angular_velocity_by_control,
    })
}

#[cfg(test)]
mod tests;
