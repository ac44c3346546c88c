use std::path::Path;
use std::sync::Mutex;

use lsfb_geometry::camera::Lens;
use lsfb_geometry::{Camera, Matrix6, RigCamera, Se3, UnitQuaternion, Vector2, Vector3};
use lsfb_recording::{Writer, WriterConfig};
use lsfb_types::{Finding, Progress, Stopped, Timestamp, Verdict, no_progress};
use nalgebra::Matrix3;

use super::placed_points::drop_misplaced;
use super::*;
use crate::features::Features;
use crate::features::triangulation::TriangulationConfig;
use crate::hd_map::{Click, ControlPoint, KeyframeImage, MapPoint, PointObservation};
use crate::odometry::OdometryConfig;
use crate::odometry::tests::room::{self, Room};

/// A camera that looks along `yaw_rad` of the rig.
fn camera(yaw_rad: f64) -> RigCamera {
    let forward =
        UnitQuaternion::from_matrix(&Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0));
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw_rad);
    RigCamera {
        camera: Camera {
            width: 400,
            height: 250,
            lens: Lens::KannalaBrandt {
                focal_px: [220.0; 2],
                principal_px: [199.5, 124.5],
                distortion: [-0.02, 0.006, -0.003, 0.0004],
            },
        },
        rig_from_camera: Se3::new(turn * forward, turn * Vector3::new(0.1, 0.0, 0.1)),
        timing: Default::default(),
        sigmas: Default::default(),
    }
}

pub(super) fn rig() -> Rig {
    Rig {
        cameras: [("cam0", 0.0), ("cam1", 2.1), ("cam2", -2.1)]
            .map(|(name, yaw)| (name.to_owned(), camera(yaw)))
            .into(),
        imus: lsfb_geometry::RigImu::from(room::imu()).alone(),
        lidars: room::lidar().alone(),
        ..Rig::empty("backpack")
    }
}

/// A walk in the furnished room, its images `image_delay_s` late.
pub(super) fn record(path: &Path, duration_s: f64, cameras: &[&str], image_delay_s: f64) {
    record_with(path, duration_s, cameras, image_delay_s, 0, &rig());
}

/// The same with images whose stamps are `stamp_error_ns` off, and a rig file that says `stated`.
fn record_with(
    path: &Path,
    duration_s: f64,
    cameras: &[&str],
    image_delay_s: f64,
    stamp_error_ns: i64,
    stated: &Rig,
) {
    let (room, rig) = (Room::furnished(), rig());
    let mut writer = Writer::create(path, &WriterConfig::default()).expect("create");
    writer.attach_rig(stated).expect("rig");
    for sample in room::imu_samples(duration_s, 7) {
        writer.write_imu("imu0", &sample).expect("imu");
    }
    for i in 0..(duration_s * 10.0) as u64 - 1 {
        let t = i as f64 * 0.1;
        writer
            .write_scan("lidar", &room::scan(&room, t, i))
            .expect("scan");
        for name in cameras {
            let mut image = room::render(&room, &rig.cameras[*name], t + image_delay_s);
            image.time = image.time + stamp_error_ns;
            writer.write_image(name, &image).expect("image");
        }
    }
    writer.finish().expect("finish");
}

/// Root mean square distance from the truth, placed by the first pose.
fn rms_error_m(trajectory: &Trajectory) -> f64 {
    let poses = trajectory.poses();
    let truth = |pose: &StampedPose| room::world_from_rig(pose.time.secs_since(room::time(0.0)));
    let truth_from_found = truth(&poses[0]) * poses[0].world_from_rig.inverse();
    let error = |pose: &StampedPose| {
        (truth_from_found * pose.world_from_rig).translation - truth(pose).translation
    };
    let squares: f64 = poses.iter().map(|p| error(p).norm_squared()).sum();
    (squares / poses.len() as f64).sqrt()
}

#[test]
fn a_walk_becomes_a_map_though_one_camera_is_missing() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    // Images lie between the scans: no trigger couples cameras to a LiDAR.
    record(&path, 4.5, &["cam0", "cam1"], 0.03);
    let recording = Recording::open(&path).expect("recording");
    let result = build_map(&recording, &MappingConfig::default(), &no_progress).expect("map");
    let report = &result.report;
    assert!(
        report
            .warnings
            .iter()
            .any(|w| matches!(w, MappingWarning::CameraMissing { camera, .. } if camera == "cam2")),
        "{report:?}"
    );
    assert_eq!(report.images, 2 * report.keyframes);
    assert!(report.reprojection_rms_px < 1.0, "{report:?}");
    assert!(
        report.reprojection_rms_px < report.reprojection_rms_before_px,
        "{report:?}"
    );
    // By camera and by region it is the same residuals.
    let keypoints = report.reprojection_errors_px.len() as u64;
    let (cameras, regions) = (&report.by_camera, &report.by_region);
    assert_eq!(
        cameras.iter().map(|c| c.after.count).sum::<u64>(),
        keypoints
    );
    assert_eq!(
        regions.iter().map(|r| r.after.count).sum::<u64>(),
        keypoints
    );
    assert!(cameras.iter().all(|c| c.after.rms_px < c.before.rms_px));
    let planes = |of: fn(&RegionResiduals) -> u64| regions.iter().map(of).sum::<u64>();
    let (before, after) = (report.lidar_before, report.lidar_after);
    assert_eq!(
        planes(|r| r.lidar_before.plane_matches),
        before.plane_matches
    );
    assert_eq!(planes(|r| r.lidar_after.plane_matches), after.plane_matches);
    assert_eq!(planes(|r| r.keyframes), report.keyframes);
    assert_eq!(result.map.point_count() as u64, report.points);
    assert_eq!(result.map.observation_count() as u64, report.observations);
    assert!(report.points > 500, "{report:?}");
    assert!(report.rounds.iter().all(|r| r.final_cost <= r.initial_cost));
    assert!(report.rounds[0].plane_matches > 500 && report.rounds[0].edge_matches > 20);

    let start = result.trajectory.poses()[0];
    let secs = |time: Timestamp| time.secs_since(room::time(0.0));
    let truth_from_found = room::world_from_rig(secs(start.time)) * start.world_from_rig.inverse();
    for pose in result.trajectory.poses() {
        let truth = room::world_from_rig(secs(pose.time));
        let error = (truth_from_found * pose.world_from_rig).translation - truth.translation;
        assert!(
            error.norm() < 0.03,
            "{} m at {} s",
            error.norm(),
            secs(pose.time)
        );
    }
    let odometry = run_odometry(&recording, &OdometryConfig::default(), &no_progress);
    let before_m = rms_error_m(&odometry.expect("odometry").trajectory);
    let after_m = rms_error_m(&result.trajectory);
    // No worse than it was, but for its own standard deviation.
    assert!(after_m <= before_m + 0.002, "{before_m} → {after_m} m");
    // Keyframes are about as far off, relative to the first, as is said of them.
    let map = &result.map;
    let first = map.keyframe(0).expect("a keyframe");
    let truth_of = |pose: &StampedPose| room::world_from_rig(secs(pose.time));
    let by_first = truth_of(&first) * first.world_from_rig.inverse();
    assert_eq!(map.keyframe_covariance(0), Some(Matrix6::zeros()));
    let all = map.keyframe_count() as u32;
    let squares: Vec<f64> = (1..all)
        .filter_map(|k| {
            let (pose, covariance) = (map.keyframe(k)?, map.keyframe_covariance(k)?);
            let error = ((by_first * pose.world_from_rig).inverse() * truth_of(&pose)).log();
            Some(error.dot(&covariance.cholesky()?.solve(&error)))
        })
        .collect();
    assert_eq!(squares.len() as u32, all - 1, "each has one");
    let nees = squares.iter().sum::<f64>() / squares.len() as f64;
    assert!((1.0..16.0).contains(&nees), "NEES {nees} of 6");
    // Points lie on surfaces of the room.
    let room = Room::furnished();
    let mut off: Vec<f64> = (0..result.map.point_count() as u32)
        .filter_map(|i| result.map.position(i))
        .map(|p| room.distance_to_surface(&(truth_from_found * p)))
        .collect();
    off.sort_by(f64::total_cmp);
    assert!(off[off.len() / 2] < 0.01, "{} m", off[off.len() / 2]);
}

/// What is wrong with the cameras of a walk with stamps `stamp_error_ns` off, after a rig file that says `stated`.
fn camera_faults(stated: &Rig, stamp_error_ns: i64) -> Vec<(String, String)> {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record_with(
        &path,
        5.0,
        &["cam0", "cam1", "cam2"],
        0.03,
        stamp_error_ns,
        stated,
    );
    let recording = Recording::open(&path).expect("recording");
    let result = build_map(&recording, &MappingConfig::default(), &no_progress).expect("map");
    let findings: Vec<Finding> = result
        .report
        .cameras
        .iter()
        .flat_map(CameraError::findings)
        .collect();
    let all = result.report.findings();
    let failed = all.iter().filter(|f| f.verdict == Verdict::Fail);
    let failed: Vec<String> = failed.map(Finding::sentence).collect();
    assert_eq!(result.map.failures(), failed);
    let faults = findings.into_iter().filter(|f| f.verdict >= Verdict::Warn);
    faults.map(|f| (f.subject, f.code.into_owned())).collect()
}

#[test]
fn cameras_that_are_not_as_the_rig_file_says_are_named() {
    let mut wrong = rig();
    let camera = wrong.cameras.get_mut("cam0").expect("cam0");
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 3f64.to_radians());
    camera.rig_from_camera = camera.rig_from_camera * Se3::new(turn, Vector3::zeros());
    let camera = wrong.cameras.get_mut("cam1").expect("cam1");
    let mut lens = camera.camera.lens.parameters().values;
    lens[..2].iter_mut().for_each(|px| *px *= 1.03);
    camera.camera.lens = camera.camera.lens.model().lens(&lens);
    let faults = [("cam0", "camera-turn"), ("cam1", "camera-focal-length")];
    let faults = faults.map(|(camera, code)| (camera.to_owned(), code.to_owned()));
    assert_eq!(camera_faults(&wrong, 0), faults);
}

/// A camera turned by 3° and one whose focal length is 3 % too long, with the setting that takes them as the images show them.
#[test]
fn cameras_are_taken_as_the_images_show_them_where_that_is_asked_for() {
    let mut wrong = rig();
    let turn = UnitQuaternion::from_axis_angle(&Vector3::y_axis(), 3f64.to_radians());
    let camera = wrong.cameras.get_mut("cam0").expect("cam0");
    camera.rig_from_camera = camera.rig_from_camera * Se3::new(turn, Vector3::zeros());
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record_with(&path, 5.0, &["cam0", "cam1", "cam2"], 0.03, 0, &wrong);
    let recording = Recording::open(&path).expect("recording");
    let config = MappingConfig {
        refine_cameras: true,
        ..MappingConfig::default()
    };
    let MappingResult { map, report, .. } =
        build_map(&recording, &config, &no_progress).expect("map");
    let refined: Vec<&str> = report.refined.iter().map(|e| e.camera.as_str()).collect();
    assert_eq!(refined, ["cam0"]);
    let left = report.cameras.iter().flat_map(CameraError::findings);
    let left: Vec<Finding> = left.filter(|f| f.verdict >= Verdict::Warn).collect();
    assert!(left.is_empty(), "{left:?}");
    let found = map.rig().cameras["cam0"].rig_from_camera;
    let off = found.inverse() * rig().cameras["cam0"].rig_from_camera;
    assert!(off.rotation.angle() < 0.2f64.to_radians(), "{off:?}");
    assert_eq!(map.stated_cameras()["cam0"], wrong.cameras["cam0"]);
    assert!(map.failures().is_empty(), "{:?}", map.failures());
}

/// Another program's SLAM that drifts by 5 % and a degree a metre: scans and images lead back.
#[test]
fn a_start_that_drifts_comes_back() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 5.0, &["cam0", "cam1", "cam2"], 0.03);
    let recording = Recording::open(&path).expect("recording");
    let truth = |ms: i32| room::world_from_rig(f64::from(ms) * 1e-3);
    let mut pose = truth(0);
    let poses = (0..500).map(|step| {
        let moved = truth(10 * step).inverse() * truth(10 * step + 10);
        let stamped = StampedPose {
            time: room::time(f64::from(step) * 0.01),
            world_from_rig: pose,
        };
        let turn = 0.0175 * moved.translation.norm();
        let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turn);
        pose = pose * Se3::new(turn * moved.rotation, moved.translation * 1.05);
        stamped
    });
    let start = Trajectory::new(poses.collect());
    let before_m = rms_error_m(&start);
    let build = |start: &Trajectory| {
        let (config, none) = (MappingConfig::default(), KeptStages::none());
        let inputs = Inputs {
            start: Start::Given(start),
            ..Inputs::of(&recording)
        };
        build_map_in_stages(&inputs, &config, &none, &no_progress)
    };
    let result = build(&start).expect("map");
    let after_m = rms_error_m(&result.trajectory);
    assert!(
        before_m > 0.02 && after_m < 0.01,
        "{before_m} → {after_m} m"
    );
    let report = &result.report;
    assert!(report.reprojection_rms_px < 1.0, "{report:?}");
    assert!(report.rounds.len() > 1 && report.rounds.len() <= 10);
    // A walk of another hour.
    let hour_ns = 3_600_000_000_000;
    let elsewhere = start.poses().iter().map(|pose| StampedPose {
        time: pose.time + hour_ns,
        ..*pose
    });
    let refused = build(&Trajectory::new(elsewhere.collect()));
    assert!(matches!(
        refused,
        Err(Error::Refused(Refusal::StartElsewhere { .. }))
    ));
}

#[test]
fn the_cameras_clock_is_taken_from_the_rig_file_and_checked() {
    let late_ns = 50_000_000;
    let unsaid = camera_faults(&rig(), late_ns);
    assert!(
        unsaid.iter().any(|(_, code)| code == "camera-clock"),
        "{unsaid:?}"
    );
    let mut stated = rig();
    for camera in stated.cameras.values_mut() {
        camera.timing.rig_from_camera_s = -0.05;
    }
    assert_eq!(camera_faults(&stated, late_ns), []);
}

#[test]
fn cameras_that_were_exchanged_are_named() {
    let mut exchanged = rig();
    let there = |name: &str| rig().cameras[name].rig_from_camera;
    for (name, other) in [("cam1", "cam2"), ("cam2", "cam1")] {
        let camera = exchanged.cameras.get_mut(name).expect("a camera");
        camera.rig_from_camera = there(other);
    }
    let faults = camera_faults(&exchanged, 0);
    for name in ["cam1", "cam2"] {
        assert!(
            faults.iter().any(|(camera, _)| camera == name),
            "{faults:?}"
        );
    }
}

#[test]
fn a_map_that_is_stopped_in_each_of_its_stages_goes_on_to_the_same_map() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 4.0, &["cam0", "cam1"], 0.03);
    let recording = Recording::open(&path).expect("recording");
    let mut config = MappingConfig::default();
    config.terms.imu = true;
    let shown = Mutex::new(Vec::new());
    let show = |p: Progress| {
        let mut shown = shown.lock().expect("stages");
        if !shown.contains(&p.stage) {
            shown.push(p.stage);
        }
        Ok(())
    };
    let whole = build_map(&recording, &config, &show).expect("map");
    let imu = whole.report.imu.expect("its term");
    assert_eq!((imu.factors, imu.left_out), (whole.report.keyframes - 1, 0));
    // Of 45 numbers in five factors velocities, biases and gravity take 27.
    assert!((0.3..1.3).contains(&imu.rms_sigmas), "{imu:?}");
    let off_m = rms_error_m(&whole.trajectory);
    assert!(off_m < 5e-3, "{off_m} m");
    let stages = std::mem::take(&mut *shown.lock().expect("stages"));
    assert!(stages.len() >= 6, "{stages:?}");

    let unfinished = folder.path().join("map.unfinished");
    let go_on = |stop: &(dyn Fn(Progress) -> bool + Sync)| {
        let kept = KeptStages::in_folder(&unfinished, "scan").expect("folder");
        shown.lock().expect("stages").clear();
        let progress = |p: Progress| match stop(p) {
            true => Err(Stopped),
            false => show(p),
        };
        build_map_in_stages(&Inputs::of(&recording), &config, &kept, &progress)
    };
    for stage in &stages {
        let stopped = go_on(&|p| p.stage == *stage);
        assert!(matches!(stopped, Err(Error::Stopped(_))), "{stage}");
    }
    // All but the index is kept by now.
    let last = stages.last().expect("a stage");
    let stopped = go_on(&|p| p.stage == *last);
    assert!(matches!(stopped, Err(Error::Stopped(_))), "{last}");
    let round = unfinished.join("rounds.stage");
    assert!(round.exists(), "several rounds of Eq. (4)");
    assert_eq!(
        *shown.lock().expect("stages"),
        Vec::<&str>::new(),
        "the rest is kept"
    );
    // In the middle of Eq. (4): its result is gone, its rounds are there.
    std::fs::remove_file(unfinished.join("adjusted.stage")).expect("a result");
    let last = go_on(&|_| false).expect("map");
    let shown = shown.lock().expect("stages").clone();
    for stage in ["lidar odometry", "image features"] {
        assert!(
            stages.contains(&stage) && !shown.contains(&stage),
            "{stage} was kept"
        );
    }
    assert!(shown.contains(&"map adjustment"), "{shown:?}");
    assert_eq!(last.trajectory, whole.trajectory);
    assert_eq!(last.report, whole.report);
    let [last, whole] = [(&last, "last"), (&whole, "whole")].map(|(result, name)| {
        let map = folder.path().join(name);
        result.map.write(&map).expect("written");
        bytes_of(&map)
    });
    assert_eq!(last, whole);
}

/// Of each file of a map, in the order of their names.
fn bytes_of(map: &Path) -> Vec<Vec<u8>> {
    let entries = std::fs::read_dir(map).expect("a folder");
    let mut files: Vec<_> = entries
        .map(|entry| entry.expect("an entry").path())
        .collect();
    files.sort();
    let bytes = files.iter().map(|f| std::fs::read(f).expect("a file"));
    bytes.collect()
}

#[test]
fn without_any_camera_it_says_so() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 0.5, &[], 0.0);
    let recording = Recording::open(&path).expect("recording");
    let error =
        build_map(&recording, &MappingConfig::default(), &no_progress).expect_err("no images");
    assert!(
        error.to_string().contains("no images of any camera"),
        "{error}"
    );
}

#[test]
fn images_of_another_time_say_so() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 0.5, &["cam0"], 100.0);
    let recording = Recording::open(&path).expect("recording");
    let error =
        build_map(&recording, &MappingConfig::default(), &no_progress).expect_err("other clock");
    assert!(error.to_string().contains("the cameras' clock"), "{error}");
}

#[test]
fn a_map_is_the_same_on_any_number_of_threads() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 4.5, &["cam0"], 0.03);
    let run = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        let pool = pool.build().expect("pool");
        let recording = Recording::open(&path).expect("recording");
        let result = pool
            .install(|| build_map(&recording, &MappingConfig::default(), &no_progress))
            .expect("map");
        let map = folder.path().join(format!("map{threads}"));
        result.map.write(&map).expect("written");
        let bytes = bytes_of(&map);
        (bytes, result.trajectory, result.report)
    };
    assert_eq!(run(1), run(3));
}

#[test]
fn limits_must_be_positive() {
    let config = MappingConfig {
        max_reprojection_px: 0.0,
        ..MappingConfig::default()
    };
    let error = config.check_bounds("mapping").expect_err("no limit");
    assert!(error.to_string().contains("max_reprojection_px"), "{error}");
}

/// A start that is 5 % too long and scans that take no part. Control points put the map into their frame, of a national grid, though one of them was measured 40 cm off and one click
/// is on something else.
#[test]
fn control_points_hold_a_map_and_blunders_among_them_do_not() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("scan.mcap");
    record(&path, 5.0, &["cam0", "cam1", "cam2"], 0.03);
    let recording = Recording::open(&path).expect("recording");
    let truth = |secs: f64| room::world_from_rig(secs);
    let first = truth(0.0);
    let poses = (0..500).map(|step| {
        let secs = f64::from(step) * 0.01;
        let moved = first.inverse() * truth(secs);
        StampedPose {
            time: room::time(secs),
            world_from_rig: first * Se3::new(moved.rotation, moved.translation * 1.05),
        }
    });
    let start = Trajectory::new(poses.collect());
    // Twelve marks around the walk, each clicked in every image of half a second's steps that shows it.
    let middle = truth(2.5).translation;
    let place = |k: usize| {
        let angle = k as f64 * std::f64::consts::TAU / 12.0;
        let (far_m, up_m) = (2.0 + 0.3 * (k % 3) as f64, 0.4 * (k % 4) as f64 - 0.5);
        middle + Vector3::new(far_m * angle.cos(), far_m * angle.sin(), up_m)
    };
    let mut clicks = Vec::new();
    for k in 0..12 {
        for step in 1..10 {
            let secs = 0.5 * f64::from(step) - 0.013;
            for (name, mounted) in &rig().cameras {
                let in_camera = (truth(secs) * mounted.rig_from_camera).inverse() * place(k);
                let size = [mounted.camera.width, mounted.camera.height].map(f64::from);
                let pixel = mounted.camera.project(&in_camera);
                let inside = |p: &Vector2<f64>| {
                    (5.0..size[0] - 5.0).contains(&p.x) && (5.0..size[1] - 5.0).contains(&p.y)
                };
                let Some(pixel) = pixel.filter(inside).filter(|_| in_camera.z > 0.3) else {
                    continue;
                };
                clicks.push(Click {
                    mark: format!("m{k}"),
                    camera: name.clone(),
                    time: room::time(secs),
                    pixel,
                });
            }
        }
    }
    let wrong = clicks.iter_mut().find(|c| c.mark == "m4").expect("clicked");
    wrong.pixel.x += 30.0;
    let site_from_world = Se3::new(
        UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 0.6),
        Vector3::new(500_120.0, 5_400_900.0, 430.0),
    );
    let in_site = |k: usize| site_from_world * place(k);
    let points = (0..12).filter(|k| k % 3 != 0).map(|k| ControlPoint {
        mark: format!("m{k}"),
        place_m: in_site(k) + Vector3::x() * if k == 7 { 0.4 } else { 0.0 },
        sigmas_m: Vector3::repeat(0.002),
    });
    let control = Control::new(points.collect(), &clicks).expect("enough");
    let mut config = MappingConfig::default();
    (config.terms.planes, config.terms.edges) = (false, false);
    let inputs = Inputs {
        start: Start::Given(&start),
        control: Some(&control),
        ..Inputs::of(&recording)
    };
    let none = KeptStages::none();
    let held = build_map_in_stages(&inputs, &config, &none, &no_progress).expect("map");
    // Of marks that were not surveyed, along all pairs.
    let worst_m = |result: &MappingResult| {
        let along = Some(&result.trajectory);
        let placed = result.map.place_marks(&clicks, along, &Default::default());
        let seen = placed.marks.iter().filter_map(|mark| {
            let k: usize = mark.name[1..].parse().ok()?;
            k.is_multiple_of(3)
                .then(|| (place(k), Vector3::from(mark.place_m)))
        });
        let seen: Vec<_> = seen.collect();
        assert!(seen.len() > 2, "{placed:?}");
        let pairs = seen.iter().enumerate().flat_map(|(i, a)| {
            let others = seen[..i].iter();
            others.map(|b| ((a.0 - b.0).norm() - (a.1 - b.1).norm()).abs())
        });
        pairs.fold(0.0, f64::max)
    };
    let report = held.report.control.as_ref().expect("said");
    assert!(report.holds, "{report:?}");
    let held_m = worst_m(&held);
    assert!(held_m < 0.02, "{held_m} m");
    let site = held.map.site().expect("in the frame of the survey");
    assert_eq!(site.origin_m, [500_000.0, 5_401_000.0, 0.0]);
    let shift = Vector3::from(site.origin_m);
    for pose in held.trajectory.poses() {
        let truth = site_from_world * truth(pose.time.secs_since(room::time(0.0)));
        let off_m = (pose.world_from_rig.translation + shift - truth.translation).norm();
        assert!(off_m < 0.03, "{off_m} m");
    }
    let named: Vec<&str> = report
        .marks
        .iter()
        .filter(|mark| !mark.holds)
        .map(|mark| mark.name.as_str())
        .collect();
    assert_eq!(named, ["m7"]);
    let findings = held.report.findings();
    let off = findings.iter().find(|f| f.code == "control-point-off");
    let off = off.expect("named");
    assert!((off.value.expect("metres") - 0.4).abs() < 0.1, "{off:?}");
    assert!(!site.control_points.contains(&"m7".to_owned()));
    let m4 = report.marks.iter().find(|mark| mark.name == "m4");
    assert_eq!(m4.expect("placed").clicks_left_out, 1);
}

/// Descriptors that happen to be alike meet before a lens: there an observation would count for more than all others.
#[test]
fn what_stands_before_a_lens_or_infinitely_far_away_is_no_point() {
    let keyframe = |x: f64| keyframes::Keyframe {
        time: Timestamp::from_nanos((x * 1e9) as i64),
        world_from_rig: Se3::new(Default::default(), Vector3::x() * x),
        lidar: None,
    };
    let image = |keyframe: usize| KeyframeImage {
        keyframe,
        camera: "cam0".to_owned(),
        features: Features::default(),
    };
    let keyframes = Keyframes {
        frames: [0.0, 1.0].map(keyframe).into(),
        images: [0, 1].map(image).into(),
    };
    let point = |(x, y): (f64, f64)| MapPoint {
        point_in_world: Vector3::new(x, y, 0.1),
        observations: [0, 1]
            .map(|image| PointObservation { image, keypoint: 0 })
            .into(),
        reprojection_rms_px: 0.1,
    };
    // The cameras are at 0.1 and 1.1 m. They see what is 95 m away under 0.6°, and asked for is 1.5.
    let near = [(1.15, 0.04), (1.25, 0.04), (3.0, 0.3)];
    let far = [(0.6, 70.0), (0.6, 95.0), (0.6, 1e8), (30.0, 0.0)];
    let mut points: Vec<MapPoint> = near.into_iter().chain(far).map(point).collect();
    drop_misplaced(
        &rig(),
        &keyframes,
        &mut points,
        &TriangulationConfig::default(),
    );
    let left: Vec<f64> = points.iter().map(|p| p.point_in_world.x).collect();
    assert_eq!(left, [1.25, 3.0, 0.6]);
    assert_eq!(points[2].point_in_world.y, 70.0);
}
