//! Cameras on an IMU, against exact truth and with input that is bad.

use std::collections::BTreeMap;

use lsfb_calib::camera_imu::{
    AccelDelay, Axes, BoardShape, CameraImuCalibration, CameraImuConfig, JointCovariance,
    KnownCamera, Readout, calibrate_camera_imu,
};
use lsfb_calib::joint::{JointConfig, join_transforms};
use lsfb_calib::{Target, TransformEdge};
use lsfb_geometry::{Matrix6, Se3, Vector6};
use lsfb_rigs::rig::{GRID, Setup, Simulated, noise, simulate};
use lsfb_types::{Finding, ImuSample, Timestamp, Verdict, no_progress};

fn run(
    known: &[KnownCamera],
    imu: &[(Timestamp, ImuSample)],
    config: &CameraImuConfig,
) -> Result<CameraImuCalibration, lsfb_calib::Error> {
    calibrate_camera_imu(&GRID, known, imu, &noise(), config, &no_progress)
}

fn calibrate(simulated: &Simulated, config: &CameraImuConfig) -> CameraImuCalibration {
    run(&simulated.known(), &simulated.imu, config).expect("calibrated")
}

#[test]
fn three_seeds_are_found_again() {
    // At the last place nobody knows gravity.
    for (seed, gravity_sigma_m_s2) in [(1, 1e-3), (2, 1e-3), (3, 0.03)] {
        let simulated = simulate(&Setup {
            seed,
            duration_s: 20.0,
            gravity_sigma_m_s2,
            ..Setup::default()
        });
        let config = CameraImuConfig {
            gravity_sigma_m_s2,
            ..CameraImuConfig::default()
        };
        let found = calibrate(&simulated, &config);
        assert_eq!(
            found.judgement().verdict(),
            Verdict::Pass,
            "{:?}",
            found.findings
        );
        for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
            let off = (truth.camera_from_rig.inverse() * c.camera_from_rig).log();
            let turn = off.fixed_rows::<3>(0).norm().to_degrees();
            let place = truth.camera_from_rig.inverse().translation
                - c.camera_from_rig.inverse().translation;
            let clock_s = c.rig_from_camera_s - truth.rig_from_camera_s;
            let focal = c.camera.focal_px()[0] / truth.camera.focal_px()[0] - 1.0;
            assert!(turn < 0.02, "seed {seed}: {turn}°");
            assert!(place.norm() < 1e-3, "seed {seed}: {} m", place.norm());
            assert!(clock_s.abs() < 5e-5, "seed {seed}: {clock_s} s");
            assert!(
                focal.abs() < 4e-4,
                "seed {seed}: focal length off by {focal}"
            );
            // What it says of itself: six components, 99.99 % of the time below 27.9.
            let nees = (off.transpose() * c.covariance.try_inverse().expect("covariance") * off)[0];
            assert!(nees < 27.9, "seed {seed}: {nees}");
            assert!(clock_s.abs() < 4.0 * c.rig_from_camera_sigma_s);
            assert!((c.rms_px - 0.15 * 2f64.sqrt()).abs() < 0.01, "{}", c.rms_px);
            let holdout = c.holdout_rms_px.expect("views held back");
            assert!(holdout < 1.1 * c.rms_px, "{holdout}");
        }
        for (found, truth) in found
            .imu
            .gyro_bias_rad_s
            .iter()
            .zip(simulated.gyro_bias.iter())
        {
            assert!((found - truth).abs() < 2e-4);
        }
        for k in 0..3 {
            let off = found.imu.accel_bias_m_s2[k] - simulated.accel_bias[k];
            assert!(
                off.abs() < 4.5 * found.imu.accel_bias_sigma_m_s2[k],
                "{off}"
            );
            let off = found.gravity_in_target_m_s2[k] - simulated.gravity[k];
            assert!(off.abs() < 4.5 * found.gravity_sigma_m_s2[k], "{off}");
        }
        let page = found.page("Camera–IMU").to_html();
        assert!(page.contains("PASS: ") && page.contains("clock, ms"));
    }
}

/// Where images and samples share one clock, the recording ends on a knot of the motion: its last control point was not determined.
#[test]
fn a_recording_may_end_on_a_knot() {
    let simulated = simulate(&Setup {
        duration_s: 4.0,
        view_rate_hz: 10.0,
        ..Setup::default()
    });
    const SAMPLE_NS: i64 = 5_000_000;
    let first_ns = simulated.imu[0].0.nanos();
    let known = simulated.known().into_iter().map(|mut camera| {
        let views = std::mem::take(&mut camera.views.views).into_iter();
        let on_sample = |ns: i64| ns - (ns - first_ns).rem_euclid(SAMPLE_NS);
        camera.views.views = views.map(|(ns, view)| (on_sample(ns), view)).collect();
        camera
    });
    run(
        &known.collect::<Vec<_>>(),
        &simulated.imu,
        &CameraImuConfig::default(),
    )
    .expect("determined");
}

/// Not a figure (that is `examples/simulated_rig.rs`), but the joint covariance is that of the errors.
#[test]
fn the_joint_covariance_holds_what_is_reported() {
    let simulated = simulate(&Setup {
        duration_s: 5.0,
        ..Setup::default()
    });
    let found = calibrate(&simulated, &CameraImuConfig::default());
    let JointCovariance { names, matrix } = &found.covariance;
    assert_eq!(names.len(), 2 * (6 + 2 + 8) + 9 + 1);
    let sigma = |name: &str| {
        let row = names.iter().position(|n| n == name).expect(name);
        matrix[(row, row)].sqrt()
    };
    for c in &found.cameras {
        for (k, axis) in ["x", "y", "z"].iter().enumerate() {
            let turn = sigma(&format!("{} turn {axis}", c.name));
            assert!((turn / c.rotation_sigma_rad[k] - 1.0).abs() < 1e-12);
        }
        assert_eq!(
            sigma(&format!("{} clock", c.name)),
            c.rig_from_camera_sigma_s
        );
        for p in &c.lens {
            assert_eq!(sigma(&format!("{} {}", c.name, p.name)), p.sigma);
        }
    }
    assert_eq!(
        sigma("gyroscope bias y"),
        found.imu.gyro_bias_sigma_rad_s[1]
    );
    assert_eq!(
        sigma("accelerometer bias z"),
        found.imu.accel_bias_sigma_m_s2[2]
    );
    assert_eq!(sigma("gravity x"), found.gravity_sigma_m_s2[0]);
}

#[test]
fn its_transforms_are_what_the_joint_graph_reads() {
    let simulated = simulate(&Setup::default());
    let found = calibrate(&simulated, &CameraImuConfig::default());
    let folder = tempfile::tempdir().expect("folder");
    let mut edges = Vec::new();
    for edge in found.edges() {
        let path = folder.path().join(format!("{}.json", edge.source));
        std::fs::write(&path, edge.to_json()).expect("file");
        edges.push(TransformEdge::read(&path).expect("own file"));
    }
    // A LiDAR that both cameras saw.
    let imu_from_lidar = Se3::exp(&Vector6::new(0.1, -0.2, 0.3, 0.05, 0.06, -0.1));
    for truth in &simulated.truth {
        edges.push(TransformEdge {
            target: format!("cam{}", edges.len() - 2),
            source: "lidar".into(),
            target_from_source: truth.camera_from_rig * imu_from_lidar,
            covariance: Some(Matrix6::from_diagonal_element(1e-8)),
        });
    }
    let joined = join_transforms(&edges, &JointConfig::default()).expect("joined");
    assert!(joined.edges.iter().all(|e| e.measured && !e.outlier));
    for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
        let sensor = joined.sensor(&c.name).expect("in the graph");
        let off = truth.camera_from_rig * sensor.imu_from_sensor;
        assert!(off.rotation.angle().to_degrees() < 0.02 && off.translation.norm() < 1e-3);
        // The covariance turned with the transform: the camera's place is known as well as before.
        let edge = found.edges().into_iter().find(|e| e.source == c.name);
        let edge = edge.expect("its edge");
        let covariance = edge.covariance.expect("measured");
        let r = edge.target_from_source.rotation_matrix();
        let place = r * covariance.fixed_view::<3, 3>(3, 3) * r.transpose();
        for (k, sigma) in c.position_sigma_m.iter().enumerate() {
            assert!((place[(k, k)].sqrt() / sigma - 1.0).abs() < 1e-9);
        }
    }
}

#[test]
fn order_does_not_matter() {
    let config = CameraImuConfig {
        view_step: 2,
        ..CameraImuConfig::default()
    };
    let simulated = simulate(&Setup {
        duration_s: 6.0,
        ..Setup::default()
    });
    let known = simulated.known();
    let straight = run(&known, &simulated.imu, &config).expect("calibrated");
    let mut shuffled = known.clone();
    shuffled.reverse();
    for corners in shuffled.iter_mut().flat_map(|k| k.views.views.values_mut()) {
        let middle = corners.len() / 2;
        corners.rotate_left(middle);
    }
    let mut imu = simulated.imu.clone();
    imu.reverse();
    imu.swap(3, 700);
    let mut again = run(&shuffled, &imu, &config).expect("calibrated");
    again.cameras.reverse();
    assert_eq!(again, straight);
}

/// What an IMU's maker leaves of its axes' errors is in the standard deviations, and where they are taken as ideal it is not.
#[test]
fn nearly_ideal_axes_are_in_the_deviations() {
    let mut squares = BTreeMap::new();
    for seed in 1..=4 {
        let simulated = simulate(&Setup {
            seed,
            duration_s: 5.0,
            axes_sigma: 1e-3,
            ..Setup::default()
        });
        for axes in [Axes::NearlyIdeal, Axes::Ideal] {
            let config = CameraImuConfig {
                axes,
                view_step: 2,
                ..CameraImuConfig::default()
            };
            let found = calibrate(&simulated, &config);
            for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
                let off = (truth.camera_from_rig.inverse() * c.camera_from_rig).log();
                let clock_s = c.rig_from_camera_s - truth.rig_from_camera_s;
                let focal_px = c.lens[0].value - truth.camera.focal_px()[0];
                let in_sigmas = [
                    ("turn", off[0] / c.covariance[(0, 0)].sqrt()),
                    ("turn", off[1] / c.covariance[(1, 1)].sqrt()),
                    ("turn", off[2] / c.covariance[(2, 2)].sqrt()),
                    ("shift", off[3] / c.covariance[(3, 3)].sqrt()),
                    ("shift", off[4] / c.covariance[(4, 4)].sqrt()),
                    ("shift", off[5] / c.covariance[(5, 5)].sqrt()),
                    ("clock", clock_s / c.rig_from_camera_sigma_s),
                    ("focal length", focal_px / c.lens[0].sigma),
                ];
                for (what, share) in in_sigmas {
                    let of = squares
                        .entry((what, axes == Axes::Ideal))
                        .or_insert((0.0, 0.0));
                    *of = (of.0 + share * share, of.1 + 1.0);
                }
            }
        }
    }
    let rms = |what, ideal| {
        let (sum, count): (f64, f64) = squares[&(what, ideal)];
        (sum / count).sqrt()
    };
    for what in ["turn", "shift", "clock", "focal length"] {
        assert!(rms(what, false) < 1.5, "{what}: {squares:?}");
    }
    assert!(rms("turn", true) > 3.0, "{squares:?}");

    // An IMU that is far worse than said, and a motion that hardly shows it: not called good.
    for seed in [1, 2] {
        let simulated = simulate(&Setup {
            seed,
            duration_s: 5.0,
            axes_sigma: 1e-2,
            turning_rad: [0.06, 0.05, 0.05],
            ..Setup::default()
        });
        let found = calibrate(&simulated, &CameraImuConfig::default());
        let finding = found.findings.iter().find(|f| f.code == "imu-scale");
        let finding = finding.expect("axes are judged");
        assert_ne!(finding.verdict, Verdict::Pass, "{finding:?}");
    }

    // Far beyond what a maker leaves: said, not taken in silence.
    let simulated = simulate(&Setup {
        axes_sigma: 1e-2,
        ..Setup::default()
    });
    let found = calibrate(&simulated, &CameraImuConfig::default());
    let named =
        |f: &Finding| f.verdict == Verdict::Warn && f.what.contains("scale and axes are off");
    assert!(found.findings.iter().any(named), "{:?}", found.findings);
}

#[test]
fn axes_of_the_imu_and_readout_times_are_found() {
    let simulated = simulate(&Setup {
        scale_error: 0.01,
        ..Setup::default()
    });
    let config = CameraImuConfig {
        axes: Axes::Estimated,
        board: BoardShape::Bent,
        ..CameraImuConfig::default()
    };
    let found = calibrate(&simulated, &config);
    // The board is flat, and is found to be.
    assert!(found.board_bend_m < 5.0 * found.board_bend_sigma_m && found.board_bend_m < 2e-4);
    for axis in &found.imu.axes {
        let diagonal = axis.name.as_bytes()[axis.name.len() - 2..]
            .windows(2)
            .all(|w| w[0] == w[1]);
        let truth = if diagonal { 0.01 } else { 0.0 };
        assert!((axis.value - truth).abs() < 5.0 * axis.sigma, "{axis:?}");
        assert!(axis.sigma < 2e-3, "{axis:?}");
    }

    let setup = Setup {
        readout_s: 0.025,
        duration_s: 5.0,
        view_rate_hz: 10.0,
        ..Setup::default()
    };
    let config = CameraImuConfig {
        readout: Readout::Estimated,
        ..CameraImuConfig::default()
    };
    let found = calibrate(&simulate(&setup), &config);
    for c in &found.cameras {
        let off_s = c.readout_s - 0.025;
        assert!(
            off_s.abs() < 5.0 * c.readout_sigma_s && c.readout_sigma_s < 3e-4,
            "{c:?}"
        );
    }
}

#[test]
fn bad_input_is_named() {
    let config = CameraImuConfig::default();
    let good = simulate(&Setup {
        duration_s: 8.0,
        ..Setup::default()
    });
    let error = |known: &[KnownCamera], imu: &[(Timestamp, ImuSample)]| {
        run(known, imu, &config).expect_err("bad input").to_string()
    };

    let mut unseen = good.known();
    unseen.iter_mut().for_each(|k| k.views.views.clear());
    assert!(error(&unseen, &good.imu).contains("cam0: the target was found in 0 of"));

    let mut blind = good.known();
    blind[1].views.views.clear();
    assert!(error(&blind, &good.imu).contains("cam1: the target was found in 0 of"));

    let wrong = Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio: 0.8,
    };
    let error_of_target = calibrate_camera_imu(
        &wrong,
        &good.known(),
        &good.imu,
        &noise(),
        &config,
        &no_progress,
    )
    .expect_err("another board")
    .to_string();
    assert!(
        error_of_target.contains("target's geometry is wrong"),
        "{error_of_target}"
    );

    // Tags as they should be, gaps that are not: corners are met, but badly.
    let gaps = Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088,
        spacing_ratio: 0.36,
    };
    let found = calibrate_camera_imu(
        &gaps,
        &good.known(),
        &good.imu,
        &noise(),
        &config,
        &no_progress,
    )
    .expect("calibrated");
    assert_eq!(
        found.judgement().verdict(),
        Verdict::Fail,
        "{:?}",
        found.findings
    );
    let named =
        |f: &Finding| f.what.contains("explained by gaps of 0.29") || f.what.contains("of 0.30");
    assert!(found.findings.iter().any(named), "{:?}", found.findings);
    assert!(found.page("page").to_html().contains("FAIL: "));

    let mut swapped = good.known();
    let (left, right) = swapped.split_at_mut(1);
    std::mem::swap(&mut left[0].views.views, &mut right[0].views.views);
    let text = error(&swapped, &good.imu);
    assert!(text.contains("their views are swapped"), "{text}");

    let text = error(
        &good.known(),
        &simulate(&Setup {
            seed: 77,
            ..Setup::default()
        })
        .imu,
    );
    assert!(text.contains("do not agree at any offset"), "{text}");

    let late: Vec<_> = good
        .imu
        .iter()
        .map(|(t, s)| (*t + 3_600_000_000_000, *s))
        .collect();
    let text = error(&good.known(), &late);
    assert!(text.contains("check the clocks"), "{text}");

    let drifting = simulate(&Setup {
        drift: 2e-3,
        duration_s: 15.0,
        ..Setup::default()
    });
    let text = error(&drifting.known(), &drifting.imu);
    assert!(
        text.contains("cam1") && text.contains("not synchronised"),
        "{text}"
    );

    let stiff = simulate(&Setup {
        turning_rad: [0.002, 0.002, 0.5],
        ..Setup::default()
    });
    let text = error(&stiff.known(), &stiff.imu);
    assert!(text.contains("rotate more about x"), "{text}");

    let mut broken = good.imu.clone();
    broken[9].1.specific_force_m_s2[0] = f64::NAN;
    assert!(error(&good.known(), &broken).contains("is not a number"));
    assert!(error(&good.known(), &[]).contains("there are no IMU samples"));
}

#[test]
fn what_can_be_calibrated_all_the_same_is_warned_of() {
    let config = CameraImuConfig {
        view_step: 2,
        ..CameraImuConfig::default()
    };
    let upside_down = simulate(&Setup {
        up: -1.0,
        duration_s: 8.0,
        ..Setup::default()
    });
    let found = calibrate(&upside_down, &config);
    assert!(
        found
            .findings
            .iter()
            .any(|f| f.what.contains("upside down")),
        "{:?}",
        found.findings
    );

    // All of the board larger than it is: only the accelerometer can tell.
    let larger = Target::AprilGrid {
        columns: 6,
        rows: 6,
        tag_size_m: 0.088 * 1.05,
        spacing_ratio: 0.3,
    };
    let simulated = simulate(&Setup {
        duration_s: 8.0,
        ..Setup::default()
    });
    let found = calibrate_camera_imu(
        &larger,
        &simulated.known(),
        &simulated.imu,
        &noise(),
        &config,
        &no_progress,
    )
    .expect("calibrated");
    let named =
        |f: &Finding| f.verdict == Verdict::Fail && f.what.contains("smaller than specified");
    assert!(found.findings.iter().any(named), "{:?}", found.findings);
    let off = 1.05 * (1.0 + found.board_excess) - 1.0;
    assert!(off.abs() < 4.0 * found.board_excess_sigma, "{off}");

    let mut pushed = simulated.clone();
    for (_, sample) in &mut pushed.imu {
        let x = &mut sample.specific_force_m_s2[0];
        *x = x.clamp(-1.5, 1.5);
    }
    let found = calibrate(&pushed, &config);
    let named = |f: &Finding| f.what.contains("the accelerometer saturates along x");
    assert!(found.findings.iter().any(named), "{:?}", found.findings);
    assert_eq!(found.judgement().verdict(), Verdict::Warn);

    let mut saturated = simulate(&Setup {
        duration_s: 8.0,
        ..Setup::default()
    });
    for (_, sample) in &mut saturated.imu {
        let x = &mut sample.angular_velocity_rad_s[0];
        *x = x.clamp(-1.2, 1.2);
    }
    let found = calibrate(&saturated, &config);
    let named = |f: &Finding| f.what.contains("the gyroscope saturates along x");
    assert!(found.findings.iter().any(named), "{:?}", found.findings);
    for (c, truth) in found.cameras.iter().zip(&saturated.truth) {
        let off = (truth.camera_from_rig.inverse() * c.camera_from_rig).log();
        assert!(off.fixed_rows::<3>(3).norm() < 3e-3, "{off}");
    }
}

/// As in TUM VI's IMU. Left out, as Kalibr does, it moves the cameras' clocks and places; searched, it does not, and where there is none
/// nothing is said of it.
#[test]
fn an_accelerometer_that_measures_before_the_gyroscope_moves_no_camera() {
    let off = |found: &CameraImuCalibration, simulated: &Simulated| -> (f64, f64, f64) {
        let (mut place_m, mut clock_s, mut deviations) = (0.0f64, 0.0f64, 0.0f64);
        for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
            let clock = c.rig_from_camera_s - truth.rig_from_camera_s;
            let pose = (truth.camera_from_rig.inverse() * c.camera_from_rig).log();
            place_m = place_m.max(pose.fixed_rows::<3>(3).norm());
            clock_s = clock_s.max(clock.abs());
            deviations = deviations.max(clock.abs() / c.rig_from_camera_sigma_s);
            for k in 0..6 {
                deviations = deviations.max(pose[k].abs() / c.covariance[(k, k)].sqrt());
            }
        }
        (place_m, clock_s, deviations)
    };
    let searched = CameraImuConfig::default();
    let absent = CameraImuConfig {
        accel_delay: AccelDelay::Absent,
        ..searched
    };
    for seed in 1..=3 {
        let simulated = simulate(&Setup {
            seed,
            accel_delay_s: -1.6e-3,
            ..Setup::default()
        });
        let found = calibrate(&simulated, &searched);
        let delay = found.findings.iter();
        let delay = delay
            .clone()
            .find(|f| f.code == "accelerometer-delay")
            .and_then(|f| f.value);
        let delay_ms = delay.expect("it is clear");
        let sigma_ms = found.imu.accel_delay_sigma_s * 1e3;
        println!("seed {seed}: {delay_ms} ± {sigma_ms} ms");
        assert!(
            (delay_ms + 1.6).abs() < 4.0 * sigma_ms && sigma_ms < 0.1,
            "{delay_ms} ± {sigma_ms} ms"
        );
        let (place_m, clock_s, deviations) = off(&found, &simulated);
        let without = calibrate(&simulated, &absent);
        let without = off(&without, &simulated);
        println!("searched: {place_m} m, {clock_s} s, {deviations} σ; left out: {without:?}");
        assert!(deviations < 4.0, "{deviations} σ");
        let size = found.findings.iter().find(|f| f.code == "board-size");
        assert_eq!(size.map(|f| f.verdict), Some(Verdict::Pass), "{size:?}");
        // Left out it is in clocks, places, or both.
        assert!(without.1 > 4.0 * clock_s.max(2e-5), "{without:?}");
    }
    let found = calibrate(&simulate(&Setup::default()), &searched);
    let said = found
        .findings
        .iter()
        .any(|f| f.code == "accelerometer-delay");
    assert!(!said, "{:?}", found.findings);
}

/// Stamps from `from` on, moved by `by_ns`.
/// Once the same images under other stamps were as many measurements more.
#[test]
fn copies_of_images_count_once() {
    let simulated = simulate(&Setup {
        duration_s: 4.0,
        ..Setup::default()
    });
    let config = CameraImuConfig::default();
    let alone = calibrate(&simulated, &config);
    let mut known = simulated.known();
    let views = &mut known[0].views;
    let count = views.views.len();
    let copies: Vec<_> = views.views.iter().step_by(4).collect();
    let copies = copies
        .into_iter()
        .map(|(ns, view)| (ns + 25_000_000, view.clone()));
    let copies: Vec<_> = copies.collect();
    let more = copies.len();
    views.images += more;
    views.views.extend(copies);
    let twice = run(&known, &simulated.imu, &config).expect("calibrated");
    assert!(twice.cameras == alone.cameras, "they counted");
    let of_copies =
        |c: &CameraImuCalibration| c.findings.iter().find(|f| f.code == "copies").cloned();
    assert_eq!(of_copies(&alone), None);
    let copies = of_copies(&twice).expect("a finding");
    assert_eq!(
        (copies.verdict, copies.subject.as_str()),
        (Verdict::Warn, "cam0")
    );
    let said = format!("{more} of {} images are duplicates", count + more);
    assert!(copies.what.contains(&said), "{}", copies.what);
    // One image all along.
    let one = known[0]
        .views
        .views
        .values()
        .next()
        .cloned()
        .expect("a view");
    known[0]
        .views
        .views
        .values_mut()
        .for_each(|view| view.clone_from(&one));
    let error = run(&known, &simulated.imu, &config)
        .expect_err("one image")
        .to_string();
    assert!(error.contains("only 1 of them differ"), "{error}");
}

fn stamped_later(known: &mut KnownCamera, from: i64, by_ns: i64) {
    let moved = std::mem::take(&mut known.views.views).into_iter();
    known.views.views = moved
        .map(|(t, corners)| (if t < from { t } else { t + by_ns }, corners))
        .collect();
}

/// The middle of what cameras saw, nanoseconds.
fn middle_ns(known: &[KnownCamera]) -> i64 {
    let stamps = || known.iter().flat_map(|k| k.views.views.keys().copied());
    let (first, last) = (stamps().min(), stamps().max());
    let (first, last) = (first.expect("views"), last.expect("views"));
    first + (last - first) / 2
}

/// A clock that jumps in the middle leaves corners that are met well enough, and one offset for both halves that is wrong in each.
#[test]
fn halves_that_disagree_are_warned_of() {
    let simulated = simulate(&Setup {
        duration_s: 10.0,
        ..Setup::default()
    });
    let mut known = simulated.known();
    let from = middle_ns(&known);
    for camera in &mut known {
        stamped_later(camera, from, 1_000_000);
    }
    let found = run(&known, &simulated.imu, &CameraImuConfig::default()).expect("calibrated");
    let halves = found.findings.iter().find(|f| f.code == "halves");
    let halves = halves.expect("halves are compared");
    assert_eq!(halves.verdict, Verdict::Warn, "{halves:?}");
    assert!(halves.value.expect("a number") > 4.0, "{halves:?}");
    assert!(
        found
            .page("Camera–IMU")
            .to_html()
            .contains("Halves of the recording")
    );
}

/// They are read off the normal equations of the whole; this is what they stand for.
#[test]
fn halves_are_what_either_half_finds_alone() {
    let simulated = simulate(&Setup {
        duration_s: 24.0,
        view_rate_hz: 10.0,
        ..Setup::default()
    });
    let known = simulated.known();
    let config = CameraImuConfig::default();
    let whole = run(&known, &simulated.imu, &config).expect("calibrated");
    // All but biases and gravity.
    assert_eq!(whole.halves.len() + 9, whole.covariance.names.len());
    let middle = middle_ns(&known);
    for half in 0..2 {
        let is_own = |t: i64| (t >= middle) == (half == 1);
        let mut own = known.clone();
        for camera in &mut own {
            camera.views.views.retain(|t, _| is_own(*t));
        }
        // Of the samples only those around its views are used.
        let alone = run(&own, &simulated.imu, &config).expect("calibrated");
        for (c, all) in alone.cameras.iter().zip(&whole.cameras) {
            let off = (all.camera_from_rig.inverse() * c.camera_from_rig).log();
            let names = [
                "turn x", "turn y", "turn z", "shift x", "shift y", "shift z",
            ];
            for (k, name) in names.iter().enumerate() {
                let name = format!("{} {name}", c.name);
                let split = whole.halves.iter().find(|s| s.name == name);
                let split = split.expect("in both");
                let missed = (split.from_whole[half] - off[k]) / split.sigma[half];
                assert!(missed.abs() < 0.5, "{name}, half {half}: {missed} σ");
                let sigma = split.sigma[half] / c.covariance[(k, k)].sqrt();
                assert!((0.7..1.4).contains(&sigma), "{name}, half {half}: {sigma}");
            }
        }
    }
}

/// A phone's shutter: once refused with "clocks are not synchronised", whatever the rig said of it.
#[test]
fn shutters_that_roll_are_taken_as_the_rig_has_them_or_named() {
    let simulated = simulate(&Setup {
        readout_s: 0.03,
        duration_s: 8.0,
        ..Setup::default()
    });
    let result = |known_s: f64, readout: Readout| {
        let mut known = simulated.known();
        known.iter_mut().for_each(|k| k.readout_s = known_s);
        let config = CameraImuConfig {
            readout,
            ..CameraImuConfig::default()
        };
        run(&known, &simulated.imu, &config)
    };
    let found = result(0.03, Readout::Known).expect("calibrated");
    assert_eq!(found.judgement().verdict(), Verdict::Pass, "{found:?}");
    for (c, truth) in found.cameras.iter().zip(&simulated.truth) {
        let off_s = c.rig_from_camera_s - truth.rig_from_camera_s;
        assert!(
            off_s.abs() < 4.0 * c.rig_from_camera_sigma_s,
            "{off_s} {c:?}"
        );
    }
    let error = result(0.0, Readout::Known).expect_err("a rolling shutter");
    let text = error.to_string();
    assert!(
        text.contains("cam0 and the IMU: rolling shutter detected") && text.contains("readout_s"),
        "{text}"
    );
    let found = result(0.0, Readout::Estimated).expect("calibrated");
    for c in &found.cameras {
        let off_s = c.readout_s - 0.03;
        assert!(
            off_s.abs() < 5.0 * c.readout_sigma_s && c.readout_sigma_s < 3e-4,
            "{c:?}"
        );
    }
}
