use std::sync::Arc;

use lsfb_geometry::rolling_shutter::row_time_s;
use lsfb_geometry::{
    Camera, CameraSigmas, CameraTiming, Matrix2x3, Matrix2x6, Matrix3, RigCamera, Se3, Vector2,
    Vector3, so3,
};
use lsfb_perception::projection::by_pose_of_inverse;
use lsfb_solver::{Linearization, Undefined};
use nalgebra::{SMatrix, SVector};

/// How far a camera is from what the rig file says of it: turn (radians) and shift (metres) of the camera frame, both in its own axes
/// (`rig_from_camera` perturbed on the right), share of the focal length, clock and readout time (seconds). Zero where the file is right.
pub type CameraCorrection = SVector<f64, 9>;

/// Entries of a [`CameraCorrection`].
pub(crate) mod entry {
    /// Turn of the camera frame, three entries.
    pub const TURN: usize = 0;
    /// Shift of the camera frame, three entries.
    pub const SHIFT: usize = 3;
    /// Share by which the focal length is larger.
    pub const FOCAL: usize = 6;
    /// Added to the camera's stamps.
    pub const CLOCK: usize = 7;
    /// Added to the readout time.
    pub const READOUT: usize = 8;
}

/// Pose of the camera frame in the one that the rig file states.
pub(crate) fn stated_from_found(correction: &CameraCorrection) -> Se3 {
    let turn = correction.fixed_rows::<3>(entry::TURN).into_owned();
    let shift = correction.fixed_rows::<3>(entry::SHIFT).into_owned();
    Se3::new(so3::exp(&turn), shift)
}

/// Motion of the rig around the stamp of an image: to second order in time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FrameMotion {
    /// Turn rate in the rig frame at the stamp, rad/s.
    pub turn_rate_rad_s: Vector3<f64>,
    /// Its change, rad/s².
    pub turn_acceleration_rad_s2: Vector3<f64>,
    /// Velocity in the world at the stamp, m/s.
    pub velocity_m_s: Vector3<f64>,
    /// Its change, m/s².
    pub acceleration_m_s2: Vector3<f64>,
}

impl FrameMotion {
    fn turn(&self, after_secs: f64) -> Vector3<f64> {
        self.turn_rate_rad_s * after_secs
            + self.turn_acceleration_rad_s2 * (0.5 * after_secs * after_secs)
    }

    fn shift(&self, after_secs: f64) -> Vector3<f64> {
        self.velocity_m_s * after_secs + self.acceleration_m_s2 * (0.5 * after_secs * after_secs)
    }

    /// Pose of the rig a short time after the stamp, given that at the stamp.
    pub fn pose_after(&self, world_from_rig: &Se3, after_secs: f64) -> Se3 {
        Se3::new(
            world_from_rig.rotation * so3::exp(&self.turn(after_secs)),
            world_from_rig.translation + self.shift(after_secs),
        )
    }
}

/// A camera on a rig that moves while the image is read out, and whose clock may be off.
#[derive(Clone, Debug, PartialEq)]
pub struct MovingCamera {
    camera: Camera,
    camera_from_rig: Se3,
    camera_from_rig_rotation: Matrix3<f64>,
    timing: CameraTiming,
    sigmas: CameraSigmas,
}

/// Where a point of the world is seen, and how that changes.
pub(super) struct SeenInMotion {
    pub pixel: Vector2<f64>,
    pub by_pose: Matrix2x6<f64>,
    pub by_correction: SMatrix<f64, 2, 9>,
    pub by_point: Matrix2x3<f64>,
}

/// Times that the row of a pixel is sought again: each lowers the error by the pixels that the image moves per row, one in
/// ten at most.
const ROW_STEPS: usize = 4;

impl MovingCamera {
    /// From the rig's description of it.
    pub fn new(camera: &RigCamera) -> Arc<Self> {
        let camera_from_rig = camera.rig_from_camera.inverse();
        Arc::new(Self {
            camera: camera.camera,
            camera_from_rig_rotation: camera_from_rig.rotation_matrix(),
            camera_from_rig,
            timing: camera.timing,
            sigmas: camera.sigmas,
        })
    }

    /// The camera as it is if it is off by this much.
    pub fn corrected(&self, correction: &CameraCorrection) -> Arc<Self> {
        let mut camera = self.camera;
        let mut lens = camera.lens.parameters().values;
        lens[..2]
            .iter_mut()
            .for_each(|focal_px| *focal_px *= 1.0 + correction[entry::FOCAL]);
        camera.lens = camera.lens.model().lens(&lens);
        let rig_from_camera = self.camera_from_rig.inverse() * stated_from_found(correction);
        let camera_from_rig = rig_from_camera.inverse();
        Arc::new(Self {
            camera,
            camera_from_rig_rotation: camera_from_rig.rotation_matrix(),
            camera_from_rig,
            timing: CameraTiming {
                rig_from_camera_s: self.timing.rig_from_camera_s + correction[entry::CLOCK],
                readout_s: self.timing.readout_s + correction[entry::READOUT],
            },
            sigmas: self.sigmas,
        })
    }

    /// As a rig file says it, but for how well it is known: that is of what a calibration found, not of what images made of it.
    pub fn mounted(&self) -> RigCamera {
        RigCamera {
            camera: self.camera,
            rig_from_camera: self.camera_from_rig.inverse(),
            timing: self.timing,
            sigmas: CameraSigmas::default(),
        }
    }

    /// Size and lens.
    pub fn camera(&self) -> &Camera {
        &self.camera
    }

    /// How well the rig file says all of it is known.
    pub fn sigmas(&self) -> &CameraSigmas {
        &self.sigmas
    }

    /// Pose of the rig in the camera frame.
    pub fn camera_from_rig(&self) -> Se3 {
        self.camera_from_rig
    }

    /// Its clock and shutter.
    pub fn timing(&self) -> &CameraTiming {
        &self.timing
    }

    /// When a row is exposed, after the image's stamp on the rig's clock, seconds.
    pub fn after_stamp_secs(&self, row_px: f64) -> f64 {
        self.timing.rig_from_camera_s + row_time_s(&self.camera, self.timing.readout_s, row_px)
    }

    /// Pose of the camera when it exposes a row, given the rig's at the stamp.
    pub fn world_from_camera(&self, at_stamp: &Se3, motion: &FrameMotion, row_px: f64) -> Se3 {
        motion.pose_after(at_stamp, self.after_stamp_secs(row_px)) * self.camera_from_rig.inverse()
    }

    /// Pixel of a point in the world that was seen in this row; `None` behind the lens.
    pub fn project_in_row(
        &self,
        at_stamp: &Se3,
        motion: &FrameMotion,
        row_px: f64,
        point_in_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        let camera_from_world = self.world_from_camera(at_stamp, motion, row_px).inverse();
        self.camera.project(&(camera_from_world * *point_in_world))
    }

    /// Pixel of a point in the world, in the row in which it is exposed; `None` behind the lens.
    pub fn project(
        &self,
        at_stamp: &Se3,
        motion: &FrameMotion,
        point_in_world: &Vector3<f64>,
    ) -> Option<Vector2<f64>> {
        let mut row_px = 0.5 * (f64::from(self.camera.height) - 1.0);
        let mut pixel = self.project_in_row(at_stamp, motion, row_px, point_in_world)?;
        if self.timing.readout_s != 0.0 {
            for _ in 0..ROW_STEPS {
                row_px = pixel.y;
                pixel = self.project_in_row(at_stamp, motion, row_px, point_in_world)?;
            }
        }
        Some(pixel)
    }

    /// A point of the world before the corrected camera, when it exposes a row.
    pub(super) fn sight(
        &self,
        at_stamp: &Se3,
        motion: &FrameMotion,
        correction: &CameraCorrection,
        row_px: f64,
        point_in_world: &Vector3<f64>,
    ) -> Sight<'_> {
        let share = row_time_s(&self.camera, 1.0, row_px);
        let after_secs = self.after_stamp_secs(row_px)
            + correction[entry::CLOCK]
            + share * correction[entry::READOUT];
        let turn = motion.turn(after_secs);
        let rig_from_stamp = so3::exp(&-turn).to_rotation_matrix().into_inner();
        let stamp_from_world = at_stamp.rotation_matrix().transpose();
        let at_stamp_y =
            stamp_from_world * (point_in_world - at_stamp.translation - motion.shift(after_secs));
        let in_rig = rig_from_stamp * at_stamp_y;
        let stated = self.camera_from_rig_rotation * in_rig + self.camera_from_rig.translation;
        let phi = correction.fixed_rows::<3>(entry::TURN).into_owned();
        let turned_back = so3::exp(&-phi).to_rotation_matrix().into_inner();
        Sight {
            camera: self,
            focal: 1.0 + correction[entry::FOCAL],
            share,
            turn,
            turn_rate_rad_s: motion.turn_rate_rad_s + motion.turn_acceleration_rad_s2 * after_secs,
            velocity_m_s: motion.velocity_m_s + motion.acceleration_m_s2 * after_secs,
            rig_from_stamp,
            stamp_from_world,
            at_stamp_y,
            in_rig,
            phi,
            turned_back,
            in_camera: turned_back * (stated - correction.fixed_rows::<3>(entry::SHIFT)),
        }
    }
}

/// A point before a camera of the rig in motion. With `τ` the time of the row, `y = R_WRᵀ (X − p − shift(τ))`,
/// `q = exp(turn(τ))ᵀ y`, `c = exp(φ)ᵀ (T_CR q − ρ)` and `Π = ∂π/∂c`, the derivatives of its pixel are, all by the chain rule:
///
/// | by | is |
/// |---|---|
/// | pose | `Π exp(φ)ᵀ R_CR exp(turn)ᵀ [[y]ₓ, −I]` |
/// | point | `Π exp(φ)ᵀ R_CR exp(turn)ᵀ R_WRᵀ` |
/// | φ, ρ | `Π [c]ₓ Jᵣ(φ)`, `−Π exp(φ)ᵀ` |
/// | focal length | `π(c) − principal point` |
/// | clock | `Π exp(φ)ᵀ R_CR (−Jᵣ(turn) turn' × q − (R_WR exp(turn))ᵀ shift')` |
/// | readout | the same times the row's share |
pub(super) struct Sight<'a> {
    camera: &'a MovingCamera,
    /// By how much the focal length is larger.
    focal: f64,
    /// Of the readout, until the row.
    share: f64,
    turn: Vector3<f64>,
    /// `turn'` and `shift'`.
    turn_rate_rad_s: Vector3<f64>,
    velocity_m_s: Vector3<f64>,
    rig_from_stamp: Matrix3<f64>,
    stamp_from_world: Matrix3<f64>,
    /// `y`.
    at_stamp_y: Vector3<f64>,
    /// `q`.
    in_rig: Vector3<f64>,
    phi: Vector3<f64>,
    /// `exp(φ)ᵀ`.
    turned_back: Matrix3<f64>,
    /// `c`.
    in_camera: Vector3<f64>,
}

impl Sight<'_> {
    /// Where it is seen: what costs need, and a third of the work.
    pub(super) fn pixel(&self) -> Result<Vector2<f64>, Undefined> {
        let pixel = self.camera.camera.project(&self.in_camera);
        let pixel = pixel.ok_or(Undefined)?;
        Ok(self.magnified(&pixel))
    }

    fn magnified(&self, pixel: &Vector2<f64>) -> Vector2<f64> {
        let principal = Vector2::from(self.camera.camera.principal_px());
        principal + (pixel - principal) * self.focal
    }

    /// The same with derivatives; those by the correction only where they are wanted, else zero.
    pub(super) fn see(&self, with_correction: bool) -> Result<SeenInMotion, Undefined> {
        let camera = &self.camera.camera;
        let projection = camera.project_with_jacobian(&self.in_camera);
        let projection = projection.ok_or(Undefined)?;
        let by_camera = projection.pixel_by_point * self.focal;
        let by_rig = by_camera * self.turned_back * self.camera.camera_from_rig_rotation;
        let by_stamp = by_rig * self.rig_from_stamp;
        let mut by_correction = SMatrix::<f64, 2, 9>::zeros();
        if with_correction {
            let turning = so3::right_jacobian(&self.turn) * self.turn_rate_rad_s;
            let moving = self.rig_from_stamp * self.stamp_from_world * self.velocity_m_s;
            let by_time = by_rig * (-turning.cross(&self.in_rig) - moving);
            let by_turn = by_camera * so3::hat(&self.in_camera) * so3::right_jacobian(&self.phi);
            by_correction
                .fixed_columns_mut::<3>(entry::TURN)
                .copy_from(&by_turn);
            by_correction
                .fixed_columns_mut::<3>(entry::SHIFT)
                .copy_from(&(-by_camera * self.turned_back));
            let from_principal = projection.pixel - Vector2::from(camera.principal_px());
            by_correction.set_column(entry::FOCAL, &from_principal);
            by_correction.set_column(entry::CLOCK, &by_time);
            by_correction.set_column(entry::READOUT, &(by_time * self.share));
        }
        Ok(SeenInMotion {
            pixel: self.magnified(&projection.pixel),
            by_pose: by_pose_of_inverse(&by_stamp, &self.at_stamp_y),
            by_correction,
            by_point: by_stamp * self.stamp_from_world,
        })
    }

    /// Writes `(π(X) − x) / σ` with its derivatives by pose and correction, blocks 0 and 1; gives that by the point where derivatives are wanted.
    pub(super) fn reproject(
        &self,
        pixel: &Vector2<f64>,
        sigma_px: f64,
        out: &mut Linearization<'_>,
    ) -> Result<Option<Matrix2x3<f64>>, Undefined> {
        let weight = 1.0 / sigma_px;
        if !out.wants_jacobians() {
            out.set_residual(&((self.pixel()? - pixel) * weight));
            return Ok(None);
        }
        let seen = self.see(out.wants_jacobian(1))?;
        out.set_residual(&((seen.pixel - pixel) * weight));
        out.set_jacobian(0, &(seen.by_pose * weight));
        out.set_jacobian(1, &(seen.by_correction * weight));
        Ok(Some(seen.by_point * weight))
    }
}

#[cfg(test)]
pub(super) mod tests {
    use lsfb_geometry::Vector6;

    use super::*;

    /// A phone's camera that looks forward (x of the rig), read out in 24 ms.
    pub fn phone() -> Arc<MovingCamera> {
        let forward = lsfb_geometry::UnitQuaternion::from_matrix(&Matrix3::new(
            0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0,
        ));
        MovingCamera::new(&RigCamera {
            camera: Camera {
                width: 640,
                height: 480,
                lens: lsfb_geometry::camera::Lens::PinholeRadtan {
                    focal_px: [480.0, 481.0],
                    principal_px: [318.0, 241.0],
                    distortion: [0.07, -0.16, 6e-4, -4e-4, 0.04],
                },
            },
            rig_from_camera: Se3::new(forward, Vector3::new(0.05, 0.06, 0.01)),
            timing: CameraTiming {
                rig_from_camera_s: 0.003,
                readout_s: 0.024,
            },
            sigmas: Default::default(),
        })
    }

    pub fn motion() -> FrameMotion {
        FrameMotion {
            turn_rate_rad_s: Vector3::new(0.4, -0.9, 1.2),
            turn_acceleration_rad_s2: Vector3::new(-8.0, 3.0, 5.0),
            velocity_m_s: Vector3::new(1.0, 0.4, -0.2),
            acceleration_m_s2: Vector3::new(-2.0, 1.0, 3.0),
        }
    }

    pub fn pose() -> Se3 {
        Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 1.0, 2.0, 0.5))
    }

    /// A correction with nothing small in it.
    pub fn correction() -> CameraCorrection {
        CameraCorrection::from_column_slice(&[
            0.02, -0.03, 0.01, 0.01, -0.02, 0.015, 0.01, 0.002, -0.004,
        ])
    }

    /// Points before the phone, with the pixels that the corrected camera sees.
    pub fn sights() -> Vec<(Vector3<f64>, Vector2<f64>)> {
        let (camera, pose, motion) = (phone().corrected(&correction()), pose(), motion());
        let pixels = [[100.0, 40.0], [320.0, 240.0], [600.0, 450.0], [60.0, 300.0]];
        let sight = |at: [f64; 2]| {
            let ray = camera.camera().unproject(&Vector2::from(at)).expect("ray");
            let rig = pose * camera.camera_from_rig().inverse();
            let point = rig * (ray * (2.0 + at[0] * 0.01));
            let pixel = camera.project(&pose, &motion, &point).expect("in front");
            (point, pixel)
        };
        pixels.map(sight).to_vec()
    }

    #[test]
    fn the_correction_that_is_searched_is_the_corrected_camera() {
        let (corrected, motion) = (phone().corrected(&correction()), motion());
        for (point, pixel) in sights() {
            let phone = phone();
            let sight = phone.sight(&pose(), &motion, &correction(), pixel.y, &point);
            let seen = sight.see(true).unwrap_or_else(|_| panic!("in front"));
            assert!((seen.pixel - pixel).norm() < 1e-3, "{}", seen.pixel - pixel);
            let alone = sight.pixel().unwrap_or_else(|_| panic!("in front"));
            assert!((seen.pixel - alone).norm() < 1e-9);
            let again = corrected.project_in_row(&pose(), &motion, pixel.y, &point);
            assert!((seen.pixel - again.expect("in front")).norm() < 1e-9);
        }
    }

    #[test]
    fn rows_are_seen_from_where_the_rig_is_then() {
        let camera = phone();
        let top = camera.after_stamp_secs(0.0);
        let below = camera.after_stamp_secs(480.0);
        assert!((below - top - 0.024).abs() < 1e-12);
        assert!((top + 0.012 - 0.003 - 0.5 * 0.024 / 480.0).abs() < 1e-12);
        let moved = motion().pose_after(&pose(), 0.01).translation - pose().translation;
        assert!((moved - Vector3::new(0.0099, 0.00405, -0.00185)).norm() < 1e-12);
    }
}
