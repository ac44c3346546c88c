//! Refinement on a simulated walk: the same answer from any number of threads, and a clock that is wrong.

use lsfb_calib::refine::{RefineConfig, RefinementReport, refine};
use lsfb_geometry::{Rig, Se3, Vector6};
use lsfb_recording::Recording;
use lsfb_rigs::walk::Walk;
use lsfb_sim::SimConfig;
use lsfb_types::{Verdict, no_progress};

fn walk() -> Walk {
    let mut config = SimConfig {
        texel_m: 0.006,
        ..SimConfig::default()
    };
    (config.scan_cameras.width, config.scan_cameras.height) = (320, 200);
    Walk::simulate(&config, &["cam0"], 9.0)
}

fn off_by(rig: &Rig, wrong: Vector6<f64>) -> Rig {
    let mut rig = rig.clone();
    let lidar = rig.lidar_mut().expect("a LiDAR");
    lidar.rig_from_lidar = lidar.rig_from_lidar * Se3::exp(&wrong);
    rig
}

fn refined(recording: &Recording, rig: &Rig, threads: usize) -> RefinementReport {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let config = RefineConfig::default();
    pool.expect("threads")
        .install(|| refine(recording, rig, &config, &no_progress))
        .expect("refined")
}

/// Degrees and millimetres from the truth.
fn left(found: &RefinementReport, rig: &Rig) -> [f64; 2] {
    let truth = rig.cameras["cam0"].rig_from_camera.inverse()
        * rig.lidar().expect("a LiDAR").rig_from_lidar;
    let camera = &found.cameras[0];
    let edge = camera.edge.as_ref();
    let pose = edge
        .unwrap_or_else(|| panic!("{}", camera.sentence))
        .target_from_source;
    let off = (pose * truth.inverse()).log();
    [
        off.fixed_rows::<3>(0).norm().to_degrees(),
        off.fixed_rows::<3>(3).norm() * 1e3,
    ]
}

#[test]
fn the_pose_is_found_whatever_the_threads_and_the_clock() {
    let folder = tempfile::tempdir().expect("a folder");
    let walk = walk();
    let open = |name: &str, late_s: f64| {
        let path = folder.path().join(name);
        walk.write(&path, late_s);
        Recording::open(&path).expect("a recording")
    };
    let recording = open("walk.mcap", 0.0);
    let wrong = Vector6::new(0.025, -0.025, 0.02, 0.03, -0.02, 0.03);
    let rig = off_by(&walk.rig, wrong);
    let found = refined(&recording, &rig, 1);
    assert_eq!(found, refined(&recording, &rig, 3));
    let [turn_deg, shift_mm] = left(&found, &walk.rig);
    assert!(
        turn_deg < 0.15 && shift_mm < 15.0,
        "{turn_deg}° {shift_mm} mm"
    );

    // What is right stays as it is, and images stamped 4 ms late do no harm but are said.
    let late = refined(&open("late.mcap", 0.004), &walk.rig, 2);
    let [turn_deg, shift_mm] = left(&late, &walk.rig);
    assert!(
        turn_deg < 0.15 && shift_mm < 15.0,
        "{turn_deg}° {shift_mm} mm"
    );
    let clock = late.cameras[0].evidence.as_ref().expect("evidence").clock_s;
    assert!((clock[0] + 0.004).abs() < 1.5e-3, "{clock:?}");
    let warns = |found: &RefinementReport, code: &str| {
        let judgement = found.judgement();
        let mut own = judgement.findings().iter();
        own.any(|f| f.code == code && f.verdict == Verdict::Warn)
    };
    assert!(warns(&late, "clock"), "{:?}", late.judgement());

    // A lens that is not that of the images moved the camera by centimetres, and passed.
    assert!(!warns(&found, "images"), "{:?}", found.judgement());
    let mut other = walk.rig.clone();
    let camera = &mut other.cameras.get_mut("cam0").expect("a camera").camera;
    let mut values = camera.lens.parameters().values;
    values[..2].iter_mut().for_each(|focal| *focal *= 1.02);
    camera.lens = camera.lens.model().lens(&values);
    let found = refined(&recording, &other, 2);
    assert!(warns(&found, "images"), "{:?}", found.judgement());
}
