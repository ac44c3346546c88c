//! Rotations as people read them.

use lsfb_geometry::Se3;

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
        let (roll, pitch, yaw) = pose.rotation.euler_angles();
        if pitch.to_degrees().abs() < NEARLY_VERTICAL_DEG {
            return Self {
                degrees: [roll, pitch, yaw].map(f64::to_degrees),
                names: ["roll", "pitch", "yaw"],
                remark: None,
            };
        }
        let vector = pose.rotation.scaled_axis();
        Self {
            degrees: [vector.x, vector.y, vector.z].map(f64::to_degrees),
            names: ["rotation x", "rotation y", "rotation z"],
            remark: Some(
                "a rotation vector, since the pitch is near ±90°, where roll and yaw turn about the same axis",
            ),
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
}
