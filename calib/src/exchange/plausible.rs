//! Rigs whose numbers are right only in other units.

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{ImuNoiseModel, Rig};

/// Farther than this from the rig's origin no sensor of a rig that is carried is, metres.
const FARTHEST_M: f64 = 3.0;
/// No clock of a calibrated camera is farther off, seconds.
const LATEST_S: f64 = 1.0;
/// Focal lengths of lenses that exist, as shares of the image's width.
const FOCAL_SHARES: std::ops::Range<f64> = 0.1..20.0;
/// Focal lengths along both axes of an image differ by no more, as a factor: pixels are square.
const SQUARE_PIXELS: f64 = 1.05;
/// A principal point is no farther from the middle, as a share of the image's size. Images that were cropped on one side are.
const OFF_CENTRE: f64 = 0.2;
/// Tangential coefficients of lenses that exist are smaller.
const MOST_TANGENTIAL: f64 = 0.05;
/// Noise densities of IMUs that exist, from the best to the worst: rad/s/√Hz, m/s²/√Hz.
const GYRO_DENSITIES: std::ops::Range<f64> = 1e-7..0.1;
const ACCEL_DENSITIES: std::ops::Range<f64> = 1e-6..1.0;

/// What in a rig is right in other units only, in words.
pub fn implausible(rig: &Rig) -> Vec<String> {
    let mut notes = Vec::new();
    for (name, mounted) in &rig.cameras {
        let far_m = mounted.rig_from_camera.translation.norm();
        if far_m > FARTHEST_M {
            notes.push(format!(
                "{name} is {far_m:.1} m from the rig's origin: lengths are in metres, not millimetres"
            ));
        }
        let late_s = mounted.timing.rig_from_camera_s;
        if late_s.abs() > LATEST_S {
            notes.push(format!(
                "{name}: a time offset of {late_s} s: offsets are in seconds, not milliseconds"
            ));
        }
        let [width, height] = [mounted.camera.width, mounted.camera.height].map(f64::from);
        let [focal_px, focal_y_px] = mounted.camera.focal_px();
        let longer = (focal_px / focal_y_px).max(focal_y_px / focal_px);
        if longer > SQUARE_PIXELS {
            notes.push(format!(
                "{name}: focal lengths of {focal_px} and {focal_y_px} px, but pixels are square: are the numbers in another order, or were the images stretched?"
            ));
        }
        let [x, y] = mounted.camera.principal_px();
        if !((0.0..width).contains(&x) && (0.0..height).contains(&y)) {
            notes.push(format!(
                "{name}: the principal point ({x:.1}, {y:.1}) px is outside the image of {width} × {height} px: width and height are swapped, the numbers are in another order, or the lens is for another image size"
            ));
        } else if (x / width - 0.5).abs().max((y / height - 0.5).abs()) > OFF_CENTRE {
            notes.push(format!(
                "{name}: the principal point ({x:.1}, {y:.1}) px is far from the middle of the image of {width} × {height} px: width and height are swapped, the numbers are in another order, the lens is for another image size, or the images were cropped"
            ));
        }
        if let Lens::PinholeRadtan { distortion, .. } = mounted.camera.lens
            && let [_, _, p1, p2, _] = distortion
            && p1.abs().max(p2.abs()) > MOST_TANGENTIAL
        {
            notes.push(format!(
                "{name}: tangential distortion of {p1} and {p2} is implausible: is the order of the coefficients k1, k2, p1, p2?"
            ));
        }
        if !FOCAL_SHARES.contains(&(focal_px / width)) {
            notes.push(format!(
                "{name}: a focal length of {focal_px} px for an image {width} px wide: focal lengths are in pixels"
            ));
        }
    }
    notes.extend(rig.imu_noise().into_iter().flat_map(implausible_noise));
    notes
}

fn implausible_noise(noise: &ImuNoiseModel) -> Vec<String> {
    let mut notes = Vec::new();
    if !GYRO_DENSITIES.contains(&noise.gyro_noise_density) {
        notes.push(format!(
            "gyroscope noise density of {}: the unit is rad/s/√Hz",
            noise.gyro_noise_density
        ));
    }
    if !ACCEL_DENSITIES.contains(&noise.accel_noise_density) {
        notes.push(format!(
            "accelerometer noise density of {}: the unit is m/s²/√Hz",
            noise.accel_noise_density
        ));
    }
    notes
}
