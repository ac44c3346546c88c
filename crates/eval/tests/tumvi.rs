//! Motion capture beside a real gyroscope: TUM VI's `dataset-calib-imu1`, two parts of one recording.

use lsfb_eval::hand_eye::{GyroAlignment, GyroSample, HandEyeConfig, align_gyroscope};
use lsfb_eval::read_poses;
use lsfb_geometry::{UnitQuaternion, Vector3};
use lsfb_types::Timestamp;

fn aligned(test: &str, name: &str) -> Option<GyroAlignment> {
    let folder = lsfb_tests::recordings(test, &format!("vision/{name}/mav0"))?;
    let poses = read_poses(&folder.join("mocap0/data.csv")).expect("motion capture");
    let text = std::fs::read_to_string(folder.join("imu0/data.csv")).expect("inertial samples");
    let samples: Vec<GyroSample> = text
        .lines()
        .filter(|line| !line.starts_with('#'))
        .map(|line| {
            let mut cells = line.split(',');
            let nanos = cells.next().expect("stamp").parse().expect("nanoseconds");
            let rate: Vec<f64> = cells.take(3).map(|c| c.parse().expect("rate")).collect();
            GyroSample {
                time: Timestamp::from_nanos(nanos),
                rate_rad_s: Vector3::from_column_slice(&rate),
            }
        })
        .collect();
    Some(align_gyroscope(&poses, &samples, &HandEyeConfig::default()).expect("one body"))
}

/// The authors give the motion capture in the IMU's frame and on its clock: neither turn nor offset is left, and what the two parts
/// say of themselves agrees.
#[test]
fn the_authors_alignment_is_found_again() {
    let test = "the_authors_alignment_is_found_again";
    let parts = ["tumvi_calib_imu1", "tumvi_calib_imu1_next"].map(|name| aligned(test, name));
    let [Some(first), Some(second)] = parts else {
        return;
    };
    let angle_deg = |xyzw: [f64; 4]| {
        let rotation =
            UnitQuaternion::new_normalize(lsfb_geometry::Quaternion::from_vector(xyzw.into()));
        rotation.angle().to_degrees()
    };
    for part in [&first, &second] {
        assert!(part.correlation > 0.9, "{part:?}");
        assert!(angle_deg(part.rotation_xyzw) < 1.0, "{part:?}");
        assert!(part.offset_secs.abs() < 0.005, "{part:?}");
        assert!(part.rms_rad_s < 0.15, "{part:?}");
    }
    assert!(
        (first.offset_secs - second.offset_secs).abs() < 0.001,
        "{first:?} {second:?}"
    );
    let apart = Vector3::from(first.bias_rad_s) - Vector3::from(second.bias_rad_s);
    assert!(apart.norm() < 0.005, "{first:?} {second:?}");
}
