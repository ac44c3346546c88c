use lsfb_geometry::{Se3, StampedPose, UnitQuaternion, Vector3};
use lsfb_types::{Timestamp, Verdict};

use super::images::ImageFigures;
use super::*;

fn plan() -> DatasetPlan {
    DatasetPlan::paper().expect("the plan in the program")
}

#[test]
fn the_plan_has_the_sequences_of_the_paper() {
    let plan = plan();
    assert_eq!((plan.environments.len(), plan.motions.len()), (9, 25));
    let sequences = plan.sequences();
    assert_eq!(sequences.len(), 75);
    let c3 = sequences
        .iter()
        .find(|s| s.name == "C3-android")
        .expect("C3");
    assert_eq!((c3.frames, c3.length_m), (2001, 64.0));
    assert!((c3.duration_s - 66.7).abs() < 1e-9);
    let findings = judge_planned(&plan);
    let bad: Vec<_> = findings
        .iter()
        .filter(|f| f.verdict != Verdict::Pass)
        .collect();
    assert!(bad.is_empty(), "{bad:?}");
}

/// The paper prints 1175 m for O1 on the iPhone: nobody walks at 11 m/s.
#[test]
fn the_printed_length_of_o1_is_not_believed() {
    let mut plan = plan();
    let o1 = plan
        .motions
        .iter_mut()
        .find(|m| m.name == "O1")
        .expect("O1");
    o1.length_m.iphone = 1175.0;
    let findings = judge_planned(&plan);
    let bad: Vec<_> = findings
        .iter()
        .filter(|f| f.verdict != Verdict::Pass)
        .collect();
    let [found] = bad[..] else { panic!("{bad:?}") };
    assert_eq!(
        (found.subject.as_str(), found.verdict),
        ("O1-iphone", Verdict::Fail)
    );
    assert!(found.what.contains("11.00 m/s"), "{}", found.what);
}

/// A walk along x at a speed, looking to one side by so many radians, swinging by so many.
fn walk(speed_m_s: f64, aside_rad: f64, swing_rad: f64) -> Vec<StampedPose> {
    (0..60 * 200)
        .map(|i| {
            let t = f64::from(i) / 200.0;
            let yaw = aside_rad + swing_rad * (0.6 * t).sin();
            StampedPose {
                time: Timestamp::from_secs_f64(t),
                world_from_rig: Se3::new(
                    UnitQuaternion::from_euler_angles(0.0, 0.0, yaw),
                    Vector3::new(speed_m_s * t, 0.0, 1.5),
                ),
            }
        })
        .collect()
}

fn figures(poses: &[StampedPose]) -> MotionFigures {
    motion_figures(poses, &Vector3::x()).expect("moves")
}

#[test]
fn a_motion_is_measured_and_classed() {
    let ahead = figures(&walk(1.0, 0.0, 0.1));
    assert!((ahead.length_m - 60.0).abs() < 0.05 && (ahead.mean_speed_m_s - 1.0).abs() < 1e-2);
    assert!((ahead.top_speed_m_s - 1.0).abs() < 1e-6, "{ahead:?}");
    assert_eq!((ahead.gait, ahead.gaze), (Gait::Walk, Some(Gaze::Ahead)));
    let side = figures(&walk(1.0, 1.5, 0.1));
    assert_eq!(side.gaze, Some(Gaze::Sideways));
    // Something 5 m aside moves by atan(1/5) in a second; ahead it hardly does.
    assert!((side.parallax_deg - 11.3).abs() < 0.2 && ahead.parallax_deg < 1.2);
    let around = figures(&walk(1.0, 0.0, 1.0));
    assert_eq!(around.gaze, Some(Gaze::Around));
    // Fastest where the sine is steepest: 0.6 rad/s.
    assert!((around.turning_deg_s[2] - 34.4).abs() < 0.2, "{around:?}");
    assert_eq!(figures(&walk(2.0, 0.0, 0.1)).gait, Gait::Run);
    let stand = figures(&walk(0.1, 0.0, 1.0));
    assert_eq!((stand.gait, stand.gaze), (Gait::Stand, Some(Gaze::Around)));
}

#[test]
fn what_is_no_motion_has_no_figures() {
    assert_eq!(motion_figures(&[], &Vector3::x()), None);
    let poses = walk(1.0, 0.0, 0.1);
    assert_eq!(motion_figures(&poses[..1], &Vector3::x()), None);
    assert_eq!(motion_figures(&[poses[0]; 5], &Vector3::x()), None);
    // A class needs time.
    assert_eq!(figures(&poses[..2000]).gaze, None);
}

fn sequence(motion: Option<MotionFigures>) -> SequenceFigures {
    let camera = CameraFigures {
        topic: "/cam0/image".to_owned(),
        frames: 1800,
        size_px: [640, 480],
        rate_hz: 30.0,
        gaps: 0,
        not_rising: 0,
        longest_gap_s: 0.034,
        view_deg: Some([67.0, 53.0]),
        is_rolling: Some(true),
    };
    SequenceFigures {
        planned: QueryEntry {
            name: "C0-android".to_owned(),
            motion: "C0".to_owned(),
            environment: "wide-corridor".to_owned(),
            device: Device::Android,
            gait: Gait::Walk,
            gaze: Gaze::Ahead,
            frames: 1800,
            length_m: 60.0,
            description: "along and back".to_owned(),
        },
        images: ImageFigures {
            cameras: vec![camera],
            exposures: Vec::new(),
        },
        inertial_samples: 12_000,
        wifi_readings: 0,
        ble_readings: 0,
        motion,
        blur_px: None,
    }
}

fn verdict_of(measured: &SequenceFigures, code: &str) -> Option<Verdict> {
    let findings = judge_measured(measured, 30.0);
    findings.iter().find(|f| f.code == code).map(|f| f.verdict)
}

#[test]
fn a_recording_that_cannot_be_is_named() {
    let right = sequence(Some(figures(&walk(1.0, 0.0, 0.1))));
    let findings = judge_measured(&right, 30.0);
    assert!(
        findings.iter().all(|f| f.verdict == Verdict::Pass),
        "{findings:?}"
    );
    // Metres that were feet, or stamps that run too fast.
    let fast = sequence(Some(figures(&walk(3.3, 0.0, 0.1))));
    assert_eq!(verdict_of(&fast, "mean-speed"), Some(Verdict::Fail));
    // On average all is well: the map jumped once.
    let mut jumped = walk(1.0, 0.0, 0.1);
    for pose in jumped.iter_mut().skip(6000) {
        pose.world_from_rig.translation.y += 4.0;
    }
    let jumped = sequence(Some(figures(&jumped)));
    assert_eq!(verdict_of(&jumped, "mean-speed"), Some(Verdict::Pass));
    assert_eq!(verdict_of(&jumped, "top-speed"), Some(Verdict::Fail));
    // Half of the images, at the right rate.
    let mut cut = right.clone();
    cut.images.cameras[0].frames = 900;
    assert_eq!(verdict_of(&cut, "frames"), Some(Verdict::Fail));
    // A clock that was set back once.
    let mut set_back = right.clone();
    set_back.images.cameras[0].not_rising = 1;
    assert_eq!(verdict_of(&set_back, "stamps"), Some(Verdict::Fail));
    // Somebody else's motion under this name.
    let other = sequence(Some(figures(&walk(1.0, 1.5, 0.1))));
    assert_eq!(verdict_of(&other, "class"), Some(Verdict::Warn));
    // Of a truth that is held back nothing is said to be right.
    assert_eq!(
        verdict_of(&sequence(None), "motion"),
        Some(Verdict::Unknown)
    );
    let mut nan = figures(&walk(1.0, 0.0, 0.1));
    nan.mean_speed_m_s = f64::NAN;
    assert_eq!(
        verdict_of(&sequence(Some(nan)), "mean-speed"),
        Some(Verdict::Fail)
    );
}

#[test]
fn tables_have_the_layout_of_the_paper() {
    let measured = [sequence(Some(figures(&walk(1.0, 0.0, 0.1))))];
    let mut description = Description::new("test", 30.0, 100.0);
    let environments = plan().environments;
    description.environments = environments
        .into_iter()
        .filter(|e| e.name == "wide-corridor")
        .collect();
    description.queries = vec![measured[0].planned.clone()];
    let cameras = cameras_table(&measured);
    for cell in ["Android phone", "640×480", "67°×53°", "30 Hz", "RS"] {
        assert!(cameras.contains(cell), "{cell}: {cameras}");
    }
    let motions = motions_table(&description, &measured);
    assert!(
        motions.contains("C0    1800 / – / –  60 / – / –"),
        "{motions}"
    );
    assert!(environments_table(&description).contains("Corridor (wide)  4×40        C0"));
    assert!(motion_classes_table(&measured).contains("C0-android  walk  ahead"));
}

#[test]
fn a_description_leads_nowhere_else() {
    let root = tempfile::tempdir().expect("folder");
    let folder = DatasetFolder::new(root.path());
    let mut description = Description::new("test", 30.0, 100.0);
    description.environments = plan().environments;
    description.queries = vec![sequence(None).planned];
    let put = |description: &Description| {
        let text = description.to_toml(root.path()).expect("text");
        std::fs::write(folder.description(), text).expect("file");
        Description::read(&folder)
    };
    assert_eq!(put(&description).expect("read"), description);
    for name in ["../C0", "a/b", "", ".hidden", "a b"] {
        description.queries[0].name = name.to_owned();
        assert!(put(&description).is_err(), "{name:?}");
    }
    description.queries = vec![sequence(None).planned; 2];
    assert!(put(&description).is_err(), "twice");
    description.queries = vec![sequence(None).planned];
    description.queries[0].environment = "elsewhere".to_owned();
    assert!(put(&description).is_err(), "no such environment");
}
