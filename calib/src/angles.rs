//! Poses as people read them.

use lsfb_geometry::{Matrix6, Se3, UnitQuaternion, Vector3, Vector6};
use nalgebra::Matrix3;

/// Pitch beyond which roll and yaw nearly turn about the same axis, degrees: each alone says nothing there.
const NEARLY_VERTICAL_DEG: f64 = 80.0;

/// A rotation as three angles.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Angles {
    /// Degrees, in the order of `names`.
    pub degrees: [f64; 3],
    /// Roll, pitch and yaw; the axes of a rotation vector where these are nearly degenerate.
    pub names: [&'static str; 3],
    /// Why it is a rotation vector.
    pub remark: Option<&'static str>,
}

impl Angles {
    /// Of a pose's rotation.
    pub fn of(pose: &Se3) -> Self {
        let (_, pitch, _) = pose.rotation.euler_angles();
        let form = match pitch.to_degrees().abs() < NEARLY_VERTICAL_DEG {
            true => Form::RollPitchYaw,
            false => Form::Vector,
        };
        let degrees = form.angles(&pose.rotation).map(f64::to_degrees).into();
        match form {
            Form::RollPitchYaw => Self {
                degrees,
                names: ["roll", "pitch", "yaw"],
                remark: None,
            },
            Form::Vector => Self {
                degrees,
                names: ["rotation x", "rotation y", "rotation z"],
                remark: Some(
                    "a rotation vector, since near a pitch of ±90° roll and yaw turn about the same axis",
                ),
            },
        }
    }

    fn form(&self) -> Form {
        match self.remark {
            None => Form::RollPitchYaw,
            Some(_) => Form::Vector,
        }
    }
}

/// In which angles a rotation is told.
#[derive(Clone, Copy)]
enum Form {
    RollPitchYaw,
    Vector,
}

impl Form {
    /// Radians.
    fn angles(self, rotation: &UnitQuaternion<f64>) -> Vector3<f64> {
        match self {
            Self::RollPitchYaw => {
                let (roll, pitch, yaw) = rotation.euler_angles();
                Vector3::new(roll, pitch, yaw)
            }
            Self::Vector => rotation.scaled_axis(),
        }
    }

    /// The same angles, a turn more or less, as near to others as may be.
    fn near(self, angles: Vector3<f64>, to: &Vector3<f64>) -> Vector3<f64> {
        const TURN: f64 = std::f64::consts::TAU;
        match self {
            Self::RollPitchYaw => {
                angles.zip_map(to, |angle, to| angle - TURN * ((angle - to) / TURN).round())
            }
            Self::Vector => {
                let other = angles - angles.normalize() * TURN;
                match (other - to).norm() < (angles - to).norm() {
                    true => other,
                    false => angles,
                }
            }
        }
    }
}

/// A pose in numbers, each with its own standard deviation. That of a right perturbation is about and along the axes of the frame whose
/// points are taken; the numbers are those of the frame that they are taken to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseNumbers {
    /// Its rotation.
    pub angles: Angles,
    /// Standard deviations of the angles, degrees.
    pub angle_sigma_deg: [f64; 3],
    /// Its translation, metres.
    pub translation_m: [f64; 3],
    /// Standard deviations along the same axes, metres.
    pub translation_sigma_m: [f64; 3],
}

impl PoseNumbers {
    /// Of a pose with the covariance `[rotation, translation]` of a right perturbation.
    pub fn of(pose: &Se3, covariance: &Matrix6<f64>) -> Self {
        const STEP_RAD: f64 = 1e-6;
        let angles = Angles::of(pose);
        let form = angles.form();
        let at = form.angles(&pose.rotation);
        let mut by_turn = Matrix3::zeros();
        for k in 0..3 {
            let [before, after] = [-STEP_RAD, STEP_RAD].map(|step| {
                let mut turn = Vector6::zeros();
                turn[k] = step;
                form.near(form.angles(&(*pose * Se3::exp(&turn)).rotation), &at)
            });
            by_turn.set_column(k, &((after - before) / (2.0 * STEP_RAD)));
        }
        let of_turn = covariance.fixed_view::<3, 3>(0, 0);
        let of_shift = covariance.fixed_view::<3, 3>(3, 3);
        let sigma = |by: &Matrix3<f64>, own: Matrix3<f64>| -> [f64; 3] {
            let variance = (by * own * by.transpose()).diagonal();
            variance.map(|v| v.max(0.0).sqrt()).into()
        };
        let of_angles = sigma(&by_turn, of_turn.into_owned());
        let rotation = pose.rotation.to_rotation_matrix().into_inner();
        Self {
            angles,
            angle_sigma_deg: of_angles.map(f64::to_degrees),
            translation_m: pose.translation.into(),
            translation_sigma_m: sigma(&rotation, of_shift.into_owned()),
        }
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Se3, Vector6};

    use super::*;

    /// A camera that looks along the rig's x axis has a pitch of 90°: its roll and yaw are anything.
    #[test]
    fn angles_near_the_pole_are_a_rotation_vector() {
        let turned = |x: f64, y: f64, z: f64| Se3::exp(&Vector6::new(x, y, z, 0.0, 0.0, 0.0));
        let found = Angles::of(&turned(0.0, 89.9f64.to_radians(), 0.0));
        assert!((found.degrees[1] - 89.9).abs() < 1e-9 && found.degrees[0].abs() < 1e-9);
        assert!(found.names[0].starts_with("rotation") && found.remark.is_some());
        let found = Angles::of(&turned(0.0, 0.0, 0.5));
        assert!((found.degrees[2] - 0.5f64.to_degrees()).abs() < 1e-9);
        assert_eq!((found.names[2], found.remark), ("yaw", None));
    }
    /// A LiDAR that looks along x before a camera that looks along z: what is not known along the former's x is not known along the
    /// latter's z. It stood beside x once.
    #[test]
    fn standard_deviations_are_those_of_the_numbers_beside_them() {
        let camera_axes = Matrix3::new(0.0, -1.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0);
        let pose = Se3::new(
            UnitQuaternion::from_matrix(&camera_axes),
            Vector3::new(0.01, -0.13, -0.11),
        );
        let sigma = Vector6::new(1e-3, 2e-3, 3e-3, 0.056, 0.027, 0.010);
        let found = PoseNumbers::of(&pose, &Matrix6::from_diagonal(&sigma.map(|s| s * s)));
        for (found, expected) in found
            .translation_sigma_m
            .into_iter()
            .zip([0.027, 0.010, 0.056])
        {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        // By rotations drawn about it, whichever angles it is told in.
        for pose in [pose, Se3::exp(&Vector6::new(0.4, -0.3, 3.0, 0.0, 0.0, 0.0))] {
            let found = PoseNumbers::of(&pose, &Matrix6::from_diagonal(&sigma.map(|s| s * s)));
            let form = found.angles.form();
            let at = form.angles(&pose.rotation);
            let mut squares = Vector3::zeros();
            for k in 0..3 {
                let mut turn = Vector6::zeros();
                turn[k] = sigma[k];
                let turned = form.angles(&(pose * Se3::exp(&turn)).rotation);
                squares += (form.near(turned, &at) - at).map(|v| v * v);
            }
            for k in 0..3 {
                let expected = squares[k].sqrt().to_degrees();
                let off = found.angle_sigma_deg[k] / expected - 1.0;
                assert!(off.abs() < 0.02, "{k}: {off}");
            }
        }
    }
}
