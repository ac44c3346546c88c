//! `sensor.yaml` of EuRoC: what programs that read the folder know of lenses and places of cameras, and of the noise of the IMU.
//!
//! ASL dataset format: <https://projects.asl.ethz.ch/datasets/doku.php?id=kmavvisualinertialdatasets>.

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Rig, RigCamera, RigImu, Se3};

/// The main IMU's name, whose frame is the body's.
const IMU: &str = "imu0";

/// Of a camera; `None` where the format has no such lens: pinholes with four coefficients are all it knows.
pub(super) fn camera(rig: &Rig, name: &str, rate_hz: f64) -> Option<String> {
    let RigCamera {
        camera,
        rig_from_camera,
        ..
    } = rig.cameras.get(name)?;
    let (focal_px, principal_px, model, distortion) = match &camera.lens {
        Lens::PinholeRadtan {
            focal_px,
            principal_px,
            distortion: [k1, k2, p1, p2, 0.0],
        } => (
            focal_px,
            principal_px,
            "radial-tangential",
            [k1, k2, p1, p2],
        ),
        Lens::KannalaBrandt {
            focal_px,
            principal_px,
            distortion: [k1, k2, k3, k4],
        } => (focal_px, principal_px, "equidistant", [k1, k2, k3, k4]),
        _ => return None,
    };
    let ([fu, fv], [cu, cv], [a, b, c, d]) = (focal_px, principal_px, distortion);
    Some(format!(
        "sensor_type: camera\ncomment: {name}\n{}rate_hz: {rate_hz}\nresolution: [{}, {}]\ncamera_model: pinhole\n\
         intrinsics: [{fu}, {fv}, {cu}, {cv}]\ndistortion_model: {model}\ndistortion_coefficients: [{a}, {b}, {c}, {d}]\n",
        placed(&(body_from_rig(rig) * *rig_from_camera)),
        camera.width,
        camera.height,
    ))
}

/// Of the IMU, whose frame is the body's.
pub(super) fn imu(rig: &Rig, rate_hz: f64) -> Option<String> {
    let RigImu { noise, .. } = rig.imus.get(IMU)?;
    Some(format!(
        "sensor_type: imu\ncomment: {IMU}\n{}rate_hz: {rate_hz}\ngyroscope_noise_density: {}\ngyroscope_random_walk: {}\n\
         accelerometer_noise_density: {}\naccelerometer_random_walk: {}\n",
        placed(&Se3::identity()),
        noise.gyro_noise_density,
        noise.gyro_bias_walk,
        noise.accel_noise_density,
        noise.accel_bias_walk,
    ))
}

fn body_from_rig(rig: &Rig) -> Se3 {
    let main = rig.imus.get(IMU);
    main.map_or_else(Se3::identity, |imu| imu.rig_from_imu.inverse())
}

/// `T_BS`, which takes points of the sensor into the body.
fn placed(body_from_sensor: &Se3) -> String {
    let (r, t) = (
        body_from_sensor.rotation.to_rotation_matrix(),
        body_from_sensor.translation,
    );
    let row = |i: usize| format!("{}, {}, {}, {}", r[(i, 0)], r[(i, 1)], r[(i, 2)], t[i]);
    format!(
        "T_BS:\n  cols: 4\n  rows: 4\n  data: [{},\n    {},\n    {},\n    0, 0, 0, 1]\n",
        row(0),
        row(1),
        row(2)
    )
}
