use lsfb_geometry::UnitQuaternion;
use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{STANDARD_GRAVITY_M_S2, Verdict, no_progress};

use super::*;
use crate::mapping::adjustment::{Adjusted, Terms, adjust};
use crate::mapping::keyframes::{Keyframe, Keyframes};
use crate::mapping::weights::Weights;
use crate::odometry::tests::room;

/// Keyframes of the walk are so far apart, seconds.
const APART_S: f64 = 0.5;
/// Time of the walk, seconds.
const WALK_S: f64 = 12.0;

/// Keyframes every half a second, without those that `left_out` names.
fn times(left_out: impl Fn(f64) -> bool) -> Vec<f64> {
    let times = (1..(WALK_S / APART_S) as u32).map(|k| APART_S * f64::from(k));
    times.filter(|secs| !left_out(*secs)).collect()
}

fn poses(times_s: &[f64], world_from_rig: impl Fn(f64) -> Se3) -> Vec<StampedPose> {
    let pose = |secs: &f64| StampedPose {
        time: room::time(*secs),
        world_from_rig: world_from_rig(*secs),
    };
    times_s.iter().map(pose).collect()
}

/// Poses at 100 Hz.
fn trajectory(world_from_rig: impl Fn(f64) -> Se3) -> Trajectory {
    let times: Vec<f64> = (0..(100.0 * WALK_S) as u32)
        .map(|k| 0.01 * f64::from(k))
        .collect();
    Trajectory::new(poses(&times, world_from_rig))
}

/// Eq. (4) without scans and images, as its rounds take it: the start and, where `imu` is there, the IMU's term.
fn solved(
    start: &[StampedPose],
    blind_s: &[f64],
    imu: Option<&KeyframeImu>,
    config: &MappingConfig,
) -> (Vec<StampedPose>, Option<InertialReport>) {
    let mut keyframes = Keyframes {
        frames: start
            .iter()
            .map(|pose| Keyframe {
                time: pose.time,
                world_from_rig: pose.world_from_rig,
                lidar: None,
            })
            .collect(),
        images: Vec::new(),
    };
    let mut estimate = imu.map(|imu| imu.start.clone());
    let term = |estimate: &Option<InertialEstimate>| {
        let both = imu.zip(estimate.as_ref());
        both.map(|(imu, estimate)| imu.term(estimate))
    };
    for _ in 0..3 {
        let term = term(&estimate);
        let terms = Terms {
            scans: &[],
            odometry: start,
            blind_s,
            weights: Weights::default(),
            control: None,
            imu: term.as_ref(),
        };
        let rig = Rig::empty("none");
        let adjusted = adjust(&rig, &mut keyframes, &mut [], &terms, config, &no_progress);
        let Adjusted { inertial, .. } = adjusted.expect("solved");
        estimate = inertial;
    }
    let now = keyframes.poses();
    let report = term(&estimate).map(|term| term.report(&now));
    (now, report)
}

/// Farthest of the keyframes from the truth, the first of which is there.
fn worst_m(keyframes: &[StampedPose], times_s: &[f64]) -> f64 {
    let off = keyframes.iter().zip(times_s).map(|(pose, secs)| {
        (pose.world_from_rig.translation - room::world_from_rig(*secs).translation).norm()
    });
    off.fold(0.0, f64::max)
}

fn recorded(noise_factor: f64) -> RecordedImu {
    RecordedImu::new(room::imu_samples(WALK_S, 7), &room::imu(), noise_factor)
}

/// Whitened, what is left has the size of the noise: noise of another size than is said shows. With poses that are known to micrometres each factor leaves nine numbers and
/// each keyframe takes three for its velocity.
#[test]
fn what_is_left_at_the_truth_is_as_large_as_the_noise() {
    let times_s = times(|_| false);
    let truth = poses(&times_s, room::world_from_rig);
    let config = MappingConfig {
        odometry_rotation_sigma_deg: 1e-4,
        odometry_translation_sigma_m: 1e-6,
        ..MappingConfig::default()
    };
    let blind_s = vec![0.0; truth.len()];
    let path = trajectory(room::world_from_rig);
    let rms = |factor_said: f64| {
        let noise = inflated(&room::imu(), factor_said);
        let recorded = RecordedImu::new(room::imu_samples(WALK_S, 7), &noise, 1.0);
        let imu = recorded.between(&truth, &path, &OdometryReport::default());
        let imu = imu.expect("samples");
        let (now, report) = solved(&truth, &blind_s, Some(&imu), &config);
        assert!(worst_m(&now, &times_s) < 1e-4);
        let report = report.expect("a term");
        assert_eq!((report.factors, report.left_out), (22, 0));
        // Biases wander so little that there are six of them, and three of gravity.
        let (numbers, taken) = (9.0 * 22.0, 3.0 * 23.0 + 9.0);
        report.rms_sigmas * f64::sqrt(numbers / (numbers - taken))
    };
    let right = rms(1.0);
    assert!((0.85..1.15).contains(&right), "{right}");
    let twice = rms(2.0);
    assert!((0.42..0.58).contains(&twice), "{twice}");
    // Inflated it is said in the noise of the rig file.
    let recorded = recorded(3.0);
    let imu = recorded.between(&truth, &path, &OdometryReport::default());
    let imu = imu.expect("samples");
    let (_, report) = solved(&truth, &blind_s, Some(&imu), &config);
    let report = report.expect("a term");
    let all = report.rms_sigmas * f64::sqrt(198.0 / 120.0);
    assert!((0.8..1.2).contains(&all), "{all}");
    let verdicts = report.findings().map(|finding| finding.verdict);
    assert_eq!(verdicts, [Verdict::Pass; 2]);
}

/// For 2 s no scan came, and the start goes on 15 cm and 2° beside where it should be. Without the IMU nothing contradicts it.
#[test]
fn where_scans_stay_away_the_imu_says_how_one_went_on() {
    let gone = |secs: f64| (5.0 + 1e-6..7.0 - 1e-6).contains(&secs);
    let times_s = times(gone);
    let wrong = Se3::new(
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 2f64.to_radians()),
        Vector3::new(0.10, -0.08, 0.08),
    );
    // Turned and shifted about where it was when the scans came again.
    let again = room::world_from_rig(7.0);
    let jump = again * wrong * again.inverse();
    let start_at = |secs: f64| {
        let truth = room::world_from_rig(secs);
        if secs < 6.0 { truth } else { jump * truth }
    };
    let start = poses(&times_s, start_at);
    let blind_s: Vec<f64> = start
        .windows(2)
        .map(|pair| pair[1].time.secs_since(pair[0].time))
        .map(|secs| if secs > 1.0 { secs } else { 0.0 })
        .collect();
    assert_eq!(blind_s.iter().filter(|secs| **secs > 0.0).count(), 1);
    let path = trajectory(start_at);
    let config = MappingConfig::default();
    let recorded = recorded(config.imu_noise_factor);
    let imu = recorded.between(&start, &path, &OdometryReport::default());
    let imu = imu.expect("samples");
    let (without, none) = solved(&start, &blind_s, None, &config);
    let (with, report) = solved(&start, &blind_s, Some(&imu), &config);
    assert!(none.is_none());
    let [without_m, with_m] = [without, with].map(|poses| worst_m(&poses, &times_s));
    assert!(without_m > 0.15, "{without_m} m");
    assert!(with_m < 0.03, "{with_m} m");
    let report = report.expect("a term");
    assert_eq!(report.left_out, 0);
    assert!(report.rms_sigmas < 2.0, "{report:?}");
}

/// A cable that has a bad contact, and somebody who stands for eleven seconds.
#[test]
fn what_the_imu_did_not_measure_is_left_out_and_counted() {
    let times_s = times(|_| false);
    let truth = poses(&times_s, room::world_from_rig);
    let path = trajectory(room::world_from_rig);
    let config = MappingConfig::default();
    let blind_s = vec![0.0; truth.len()];
    let report_of = |lost: &dyn Fn(f64) -> bool, keyframes: &[StampedPose]| {
        let mut samples = room::imu_samples(WALK_S, 7);
        samples.retain(|s| !lost(s.time.secs_since(room::time(0.0))));
        let recorded = RecordedImu::new(samples, &room::imu(), 1.0);
        let imu = recorded.between(keyframes, &path, &OdometryReport::default());
        let imu = imu.expect("samples");
        let (now, report) = solved(keyframes, &blind_s, Some(&imu), &config);
        let secs: Vec<f64> = now
            .iter()
            .map(|k| k.time.secs_since(room::time(0.0)))
            .collect();
        let off_m = worst_m(&now, &secs);
        assert!(off_m < 0.03, "{off_m} m");
        report.expect("a term")
    };
    // 30 ms are six periods; one sample alone is bridged.
    let report = report_of(&|secs| (4.1..4.13).contains(&secs), &truth);
    assert_eq!((report.factors, report.left_out), (21, 1));
    let report = report_of(&|secs| (secs - 4.1).abs() < 0.002, &truth);
    assert_eq!((report.factors, report.left_out), (22, 0));
    // From a third of the way on there is nothing: that half of the keyframes is tied by the start alone.
    let report = report_of(&|secs| secs > 4.1, &truth);
    assert_eq!((report.factors, report.left_out), (7, 15));
    assert_eq!(report.findings()[0].verdict, Verdict::Warn);
    let long = [truth[0], truth[truth.len() - 1]];
    let report = report_of(&|_| false, &long);
    assert_eq!((report.factors, report.left_out), (0, 1));
}

/// One reading again and again while the walk went on is no measurement.
#[test]
fn readings_that_stand_are_left_out() {
    let times_s = times(|_| false);
    let truth = poses(&times_s, room::world_from_rig);
    let path = trajectory(room::world_from_rig);
    let mut samples = room::imu_samples(WALK_S, 7);
    let held = samples[1010].sample;
    for sample in &mut samples[1010..1290] {
        sample.sample = held;
    }
    let recorded = RecordedImu::new(samples, &room::imu(), 1.0);
    let imu = recorded.between(&truth, &path, &OdometryReport::default());
    let term = imu.expect("samples");
    let term = term.term(&term.start);
    // From 5.05 to 6.45 s.
    let missing: Vec<usize> = (0..truth.len() - 1).filter(|k| !term.has(*k)).collect();
    assert_eq!(missing, [9, 10, 11]);
}

#[test]
fn a_recording_without_an_imu_is_refused_where_it_is_to_take_part() {
    let folder = tempfile::tempdir().expect("folder");
    let mut config = MappingConfig::default();
    let told = |config: &MappingConfig, name: &str, rig: &Rig| {
        let path = folder.path().join(name);
        let mut writer = Writer::create(&path, &WriterConfig::default()).expect("create");
        writer.attach_rig(rig).expect("rig");
        writer.finish().expect("finish");
        let recording = Recording::open(&path).expect("recording");
        match RecordedImu::read(&recording, rig, config) {
            Ok(imu) => {
                assert!(imu.is_none());
                None
            }
            Err(error) => Some(error.to_string()),
        }
    };
    let (bare, mut with) = (Rig::empty("bare"), Rig::empty("with"));
    with.set_imu_noise(room::imu());
    assert_eq!(told(&config, "off.mcap", &bare), None);
    config.terms.imu = true;
    let without = told(&config, "rig.mcap", &bare).expect("refused");
    assert!(without.contains("rig file has no IMU") && without.contains("imu = false"));
    let silent = told(&config, "silent.mcap", &with).expect("refused");
    assert!(silent.contains("no IMU samples"), "{silent}");
    with.set_imu_noise(ImuNoiseModel {
        accel_noise_density: 0.0,
        ..room::imu()
    });
    let noiseless = told(&config, "noiseless.mcap", &with).expect("refused");
    assert!(noiseless.contains("no noise"), "{noiseless}");
}

/// An accelerometer in gravities says the same as one in m/s²; a gyroscope in degrees is not taken.
#[test]
fn the_term_has_the_units_that_the_odometry_has() {
    let folder = tempfile::tempdir().expect("folder");
    let mut config = MappingConfig::default();
    config.terms.imu = true;
    let mut rig = Rig::empty("with");
    rig.set_imu_noise(room::imu());
    let read = |name: &str, change: &dyn Fn(&mut ImuSample)| {
        let path = folder.path().join(name);
        let mut writer = Writer::create(&path, &WriterConfig::default()).expect("create");
        writer.attach_rig(&rig).expect("rig");
        for mut sample in room::imu_samples(2.0, 7) {
            change(&mut sample.sample);
            writer.write_imu("imu0", &sample).expect("imu");
        }
        writer.finish().expect("finish");
        let recording = Recording::open(&path).expect("recording");
        let imu = RecordedImu::read(&recording, &rig, &config);
        imu.map(|imu| imu.expect("asked for").samples)
    };
    let right = read("right.mcap", &|_| ()).expect("samples");
    let in_gravities = read("gravities.mcap", &|sample| {
        let force = &mut sample.specific_force_m_s2;
        *force = force.map(|c| c / STANDARD_GRAVITY_M_S2);
    });
    let in_gravities = in_gravities.expect("samples");
    assert_eq!(in_gravities.len(), right.len());
    for (a, b) in in_gravities.iter().zip(&right) {
        let (a, b) = (a.sample.specific_force_m_s2, b.sample.specific_force_m_s2);
        let off = a.iter().zip(b).map(|(a, b)| (a - b).abs());
        assert!(off.fold(0.0, f64::max) < 1e-9);
    }
    let in_degrees = read("degrees.mcap", &|sample| {
        sample.angular_velocity_rad_s = [120.0; 3];
    });
    let error = in_degrees.expect_err("no unit of a gyroscope").to_string();
    assert!(error.contains("degrees per second"), "{error}");
}
