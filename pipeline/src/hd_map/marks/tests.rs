use lsfb_geometry::{
    Camera, Matrix6, Rig, RigCamera, Se3, StampedPose, Trajectory, Vector2, Vector3,
};
use lsfb_types::{Timestamp, no_progress};

use super::*;
use crate::error::Error;
use crate::features::{Feature, Features};
use crate::hd_map::{HdMapConfig, KeyframeImage, MapContent};

const SECOND_NS: i64 = 1_000_000_000;

fn rig() -> Rig {
    let mut rig = Rig::empty("one");
    let camera = RigCamera {
        camera: Camera::pinhole(640, 480, [400.0, 400.0], [319.5, 239.5]),
        rig_from_camera: Se3::exp(&[0.1, -0.2, 0.05, 0.1, 0.0, 0.2].into()),
        timing: Default::default(),
        sigmas: Default::default(),
    };
    rig.cameras = [("cam0".to_owned(), camera)].into();
    rig
}

/// Six keyframes a second and half a metre apart; a map without points: marks need none.
fn keyframes() -> Vec<StampedPose> {
    let pose = |k: i64| StampedPose {
        time: Timestamp::from_nanos(k * SECOND_NS),
        world_from_rig: Se3::exp(&[0.0, 0.02 * k as f64, 0.0, 0.5 * k as f64, 0.0, 0.0].into()),
    };
    (0..6).map(pose).collect()
}

fn map(covariance: Option<Matrix6<f64>>) -> HdMap {
    let keyframes = keyframes();
    let images: Vec<KeyframeImage> = (0..keyframes.len())
        .map(|keyframe| KeyframeImage {
            keyframe,
            camera: "cam0".to_owned(),
            features: Features::default(),
        })
        .collect();
    let content = MapContent {
        rig: &rig(),
        keyframes: &keyframes,
        images: &images,
        points: &[],
        feature: &Feature::Sift,
        provenance: "made up",
    };
    let map = HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("a map");
    map.with_keyframe_covariances(vec![covariance; keyframes.len()])
}

/// Clicks on a place in all keyframes, each off by `noise_px` of its own.
fn clicks(mark: &str, place: &Vector3<f64>, noise_px: impl Fn(usize) -> [f64; 2]) -> Vec<Click> {
    let rig = rig();
    let mounted = &rig.cameras["cam0"];
    let click = |(k, pose): (usize, &StampedPose)| {
        let camera_from_world = (pose.world_from_rig * mounted.rig_from_camera).inverse();
        let pixel = mounted.camera.project(&(camera_from_world * *place))?;
        Some(Click {
            mark: mark.to_owned(),
            camera: "cam0".to_owned(),
            time: pose.time,
            pixel: pixel + Vector2::from(noise_px(k)),
        })
    };
    keyframes().iter().enumerate().filter_map(click).collect()
}

#[test]
fn marks_are_where_they_are_seen() {
    let (a, b) = (Vector3::new(1.0, 0.3, 6.0), Vector3::new(2.5, -0.5, 5.0));
    let mut all = clicks("a", &a, |_| [0.0; 2]);
    all.extend(clicks("b", &b, |_| [0.0; 2]));
    let placed = map(None).place_marks(&all, None, &MarkConfig::default());
    assert!(placed.unplaced.is_empty() && placed.clicks_without_pose == 0);
    let [at_a, at_b] = &placed.marks[..] else {
        panic!("{placed:?}");
    };
    assert!((Vector3::from(at_a.place_m) - a).norm() < 1e-6, "{at_a:?}");
    let [distance_m, sigma_m] = at_a.distance_to(at_b);
    assert!((distance_m - (a - b).norm()).abs() < 1e-6);
    assert!(sigma_m > 1e-4 && sigma_m < 0.05, "{sigma_m}");
    assert!(at_a.is_checked() && !at_a.with_poses);
}

/// Half a pixel of noise, many draws: errors are what the standard deviations say.
#[test]
fn standard_deviations_are_those_of_the_errors() {
    let map = map(None);
    let (a, b) = (Vector3::new(1.0, 0.3, 6.0), Vector3::new(2.5, -0.5, 5.0));
    let mut state = 7u64;
    let mut uniform = || {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1);
        (state >> 11) as f64 / (1u64 << 53) as f64
    };
    let mut noise = || -> [f64; 2] {
        // Sums of twelve are normal enough.
        [(); 2].map(|()| 0.5 * ((0..12).map(|_| uniform()).sum::<f64>() - 6.0))
    };
    let (mut squares, draws) = (0.0, 400);
    for _ in 0..draws {
        let of_a: Vec<[f64; 2]> = (0..6).map(|_| noise()).collect();
        let of_b: Vec<[f64; 2]> = (0..6).map(|_| noise()).collect();
        let mut all = clicks("a", &a, |k| of_a[k]);
        all.extend(clicks("b", &b, |k| of_b[k]));
        let placed = map.place_marks(&all, None, &MarkConfig::default());
        let [distance_m, sigma_m] = placed.marks[0].distance_to(&placed.marks[1]);
        squares += ((distance_m - (a - b).norm()) / sigma_m).powi(2);
    }
    let mean = squares / f64::from(draws);
    assert!((0.6..1.3).contains(&mean), "{mean}");
}

/// What the keyframes are off by moves the mark: 2 cm of each, and 0.01 rad at six metres.
#[test]
fn errors_of_the_poses_count() {
    let covariance = Matrix6::from_diagonal(&[1e-4, 1e-4, 1e-4, 4e-4, 4e-4, 4e-4].into());
    let place = Vector3::new(1.0, 0.3, 6.0);
    let all = clicks("a", &place, |_| [0.0; 2]);
    let placed = map(Some(covariance)).place_marks(&all, None, &MarkConfig::default());
    let mark = &placed.marks[0];
    assert!(mark.with_poses);
    assert!(mark.worst_sigma_m() > 0.06, "{}", mark.worst_sigma_m());
    let alone = map(None).place_marks(&all, None, &MarkConfig::default());
    assert!(alone.marks[0].worst_sigma_m() < 0.03);
}

#[test]
fn a_wrong_click_is_left_out_and_said() {
    let place = Vector3::new(1.0, 0.3, 6.0);
    let all = clicks("a", &place, |k| if k == 2 { [40.0, 5.0] } else { [0.0; 2] });
    let placed = map(None).place_marks(&all, None, &MarkConfig::default());
    let mark = &placed.marks[0];
    assert_eq!((mark.clicks, mark.left_out), (5, 1));
    assert!((Vector3::from(mark.place_m) - place).norm() < 1e-6);
}

/// Clicks on three things, two each, under one name: any two agree, and are no mark.
#[test]
fn clicks_on_different_things_are_no_mark() {
    let places = [[1.0, 0.3, 6.0], [-0.5, -0.4, 4.0], [2.2, 0.9, 7.0]].map(Vector3::from);
    let mut all = Vec::new();
    for (which, place) in places.iter().enumerate() {
        let both = clicks("a", place, |_| [0.0; 2]);
        all.extend(both.into_iter().skip(2 * which).take(2));
    }
    let placed = map(None).place_marks(&all, None, &MarkConfig::default());
    assert!(placed.marks.is_empty(), "{placed:?}");
    assert!(placed.unplaced[0].reason.contains("agree"), "{placed:?}");
}

#[test]
fn images_between_keyframes_need_a_trajectory() {
    let place = Vector3::new(1.0, 0.3, 6.0);
    let mut all = clicks("a", &place, |_| [0.0; 2]);
    for click in &mut all {
        click.time = click.time + SECOND_NS / 2;
    }
    let map = map(None);
    let placed = map.place_marks(&all, None, &MarkConfig::default());
    assert_eq!(placed.clicks_without_pose, all.len());
    assert!(placed.marks.is_empty() && placed.unplaced.len() == 1);
    // The same poses half a second later, as a trajectory.
    let later = keyframes().into_iter().map(|pose| StampedPose {
        time: pose.time + SECOND_NS / 2,
        ..pose
    });
    let trajectory = Trajectory::new(later.collect());
    let placed = map.place_marks(&all, Some(&trajectory), &MarkConfig::default());
    assert!((Vector3::from(placed.marks[0].place_m) - place).norm() < 1e-6);
}

#[test]
fn what_is_wrong_in_a_list_of_clicks_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("clicks.csv");
    let read = |text: &str| {
        std::fs::write(&path, text).expect("a file");
        read_clicks(&path)
    };
    let names = "mark,camera,time_ns,u_px,v_px\n";
    let good = read(&format!("{names}# by hand\ndoor, cam0, 12, 1.5, 2\n")).expect("a click");
    assert_eq!(good.len(), 1);
    assert_eq!((good[0].mark.as_str(), good[0].pixel.x), ("door", 1.5));
    for (text, line, part) in [
        ("", 1, "the file is empty"),
        ("door,cam0,12,1.5\n", 1, "4 columns"),
        ("\nthe door,cam0,12,1,2\n", 2, "one word"),
        ("door,cam0,1.2,1,2\n", 1, "stamp"),
        ("door,cam0,12,1,nan\n", 1, "not a pixel"),
    ] {
        match read(text).expect_err(text) {
            Error::ClickLine {
                line: at, reason, ..
            } => {
                assert_eq!(at, line, "{text}");
                assert!(reason.contains(part), "{reason}");
            }
            other => panic!("{other}"),
        }
    }
}

#[test]
fn control_points_are_read_and_what_is_wrong_is_named() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path().join("points.csv");
    let read = |text: &str| {
        std::fs::write(&path, text).expect("a file");
        read_control_points(&path)
    };
    let good = read(
        "mark,x_m,y_m,z_m,sigma_m\n# by total station\na, 1, -2, 0.5, 0.002\nb,5e5,5.4e6,112,0.01,0.01,0.02\n",
    );
    let good = good.expect("two points");
    assert_eq!((good[0].mark.as_str(), good[0].place_m.y), ("a", -2.0));
    assert_eq!(good[0].sigmas_m, Vector3::repeat(0.002));
    assert_eq!(good[1].sigmas_m, Vector3::new(0.01, 0.01, 0.02));
    for (text, line, part) in [
        ("# nothing\n", 1, "the file is empty"),
        ("a,1,2,3\n", 1, "4 columns"),
        ("a b,1,2,3,0.1\n", 1, "one word"),
        ("a,1,2,inf,0.1\n", 1, "not a coordinate"),
        ("a,1,2,1e12,0.1\n", 1, "not a coordinate"),
        ("\na,1,2,3,0\n", 2, "above zero"),
        ("a,1,2,3,0.1\na,1,2,4,0.1\n", 2, "twice"),
    ] {
        match read(text).expect_err(text) {
            Error::ControlPointLine {
                line: at, reason, ..
            } => {
                assert_eq!(at, line, "{text}");
                assert!(reason.contains(part), "{reason}");
            }
            other => panic!("{other}"),
        }
    }
}
