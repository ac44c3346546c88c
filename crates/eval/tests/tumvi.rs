//! Motion capture beside a real IMU: TUM VI's `dataset-calib-imu1`, two parts of one recording.

use lsfb_eval::hand_eye::{
    GyroAlignment, GyroSample, HandEyeConfig, MocapConfig, UncertainPose, align_gyroscope,
    align_gyroscopes, align_mocap,
};
use lsfb_eval::read_poses;
use lsfb_geometry::{StampedPose, UnitQuaternion, Vector3};
use lsfb_types::{ImuSample, Stamped, Timestamp, no_progress};

struct Part {
    poses: Vec<StampedPose>,
    samples: Vec<Stamped<ImuSample>>,
}

fn part(test: &str, name: &str) -> Option<Part> {
    let folder = lsfb_tests::recordings(test, &format!("vision/{name}/mav0"))?;
    let poses = read_poses(&folder.join("mocap0/data.csv")).expect("motion capture");
    let text = std::fs::read_to_string(folder.join("imu0/data.csv")).expect("inertial samples");
    let rows = text.lines().filter(|line| !line.starts_with('#'));
    let samples = rows.map(|line| {
        let mut cells = line.split(',');
        let nanos = cells.next().expect("stamp").parse().expect("nanoseconds");
        let values: Vec<f64> = cells.map(|c| c.parse().expect("a number")).collect();
        let three = |at: usize| [values[at], values[at + 1], values[at + 2]];
        let time = Timestamp::from_nanos(nanos);
        Stamped {
            time,
            arrival: time,
            device_ticks: 0,
            sample: ImuSample {
                angular_velocity_rad_s: three(0),
                specific_force_m_s2: three(3),
            },
        }
    });
    Some(Part {
        poses,
        samples: samples.collect(),
    })
}

fn aligned(test: &str, name: &str) -> Option<GyroAlignment> {
    let Part { poses, samples } = part(test, name)?;
    let samples: Vec<GyroSample> = samples
        .iter()
        .map(|s| GyroSample {
            time: s.time,
            rate_rad_s: s.sample.angular_velocity_rad_s.into(),
        })
        .collect();
    Some(
        align_gyroscope(&poses, &samples, &HandEyeConfig::default(), &no_progress)
            .expect("one body"),
    )
}

/// The same with the accelerometer: the IMU sits where the authors say, and both parts put it there.
#[test]
fn the_imu_sits_where_the_authors_say() {
    let test = "the_imu_sits_where_the_authors_say";
    let parts = ["tumvi_calib_imu1", "tumvi_calib_imu1_next"].map(|name| part(test, name));
    let [Some(first), Some(second)] = parts else {
        return;
    };
    let [first, second] = [first, second].map(|part| {
        align_mocap(
            &part.poses,
            &part.samples,
            &MocapConfig::default(),
            &no_progress,
        )
        .expect("one body")
    });
    for part in [&first, &second] {
        assert!(
            part.body.rotation.angle().to_degrees() < 1.0,
            "{:?}",
            part.markers_from_imu
        );
        assert!(
            part.body.translation.norm() < 0.005,
            "{:?}",
            part.markers_from_imu
        );
        assert!(part.offset_secs.abs() < 0.001, "{}", part.offset_secs);
        assert!(part.given > 0.9, "{}", part.given);
    }
    let apart = first.body.local(&second.body);
    for k in 0..3 {
        let sigma = |of: fn(&UncertainPose) -> [f64; 3]| {
            of(&first.markers_from_imu)[k].hypot(of(&second.markers_from_imu)[k])
        };
        assert!(
            apart[k].to_degrees().abs() < 4.0 * sigma(|p| p.sigma_rotation_deg),
            "{apart}"
        );
        assert!(
            apart[3 + k].abs() < 4.0 * sigma(|p| p.sigma_translation_m),
            "{apart}"
        );
    }
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

/// Two gyroscopes on one board, made of one: every other sample of it, one part turned and on another clock, so that their noise is real
/// and their own, and the offset is known.
#[test]
fn two_gyroscopes_have_one_clock_within_a_millisecond() {
    let test = "two_gyroscopes_have_one_clock_within_a_millisecond";
    let Some(Part { samples, .. }) = part(test, "tumvi_calib_imu1") else {
        return;
    };
    let turn = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, -1.1, 0.6));
    for offset_secs in [3.217, -7.9] {
        let every_other = |first: usize| samples.iter().skip(first).step_by(2);
        let phone: Vec<GyroSample> = every_other(0)
            .map(|s| GyroSample {
                time: s.time,
                rate_rad_s: s.sample.angular_velocity_rad_s.into(),
            })
            .collect();
        let rig: Vec<GyroSample> = every_other(1)
            .map(|s| GyroSample {
                time: s.time.plus_secs(offset_secs),
                rate_rad_s: turn * Vector3::from(s.sample.angular_velocity_rad_s),
            })
            .collect();
        let found = align_gyroscopes(&phone, &rig, &HandEyeConfig::default(), &no_progress)
            .expect("one body");
        println!("{found:?}");
        let off_secs = (found.offset_secs - offset_secs).abs();
        assert!(
            off_secs < 1e-3 && found.sigma_offset_secs < 1e-3,
            "{found:?}"
        );
        assert!(off_secs < 4.0 * found.sigma_offset_secs, "{found:?}");
    }
}
