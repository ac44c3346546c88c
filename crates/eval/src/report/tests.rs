use super::*;
use crate::{EvalConfig, compare, evaluate};
use lsfb_geometry::{Se3, StampedPose, Vector6};
use lsfb_types::{Limit, Timestamp, Verdict};

/// Repeatable numbers from −1 to 1 without a generator: the fractional part of a large sine.
fn noise(i: usize) -> f64 {
    2.0 * ((i as f64 * 12.9898).sin() * 43_758.545).rem_euclid(1.0) - 1.0
}

fn walk(seconds: f64, rate_hz: f64, place: impl Fn(f64) -> [f64; 3]) -> Vec<StampedPose> {
    (0..(seconds * rate_hz) as usize)
        .map(|i| {
            let t = i as f64 / rate_hz;
            let [x, y, yaw] = place(t);
            let turn = Se3::exp(&Vector6::new(0.0, 0.0, yaw, 0.0, 0.0, 0.0));
            StampedPose {
                time: Timestamp::from_secs_f64(1_772_359_200.0).plus_secs(t),
                world_from_rig: Se3::new(
                    turn.rotation,
                    Vector3::new(x, y, 1.4 + 0.02 * (9.0 * t).sin()),
                ),
            }
        })
        .collect()
}

/// A loop in the room, then down the corridor and back.
fn scanner_place(t: f64) -> [f64; 3] {
    if t < 18.0 {
        let a = 0.7 * t;
        return [1.5 * a.cos(), 1.2 * a.sin(), a + 1.6];
    }
    let s = (t - 18.0) / 18.0;
    [
        1.5 + 7.0 * (std::f64::consts::PI * s).sin(),
        0.4 * (6.0 * s).sin(),
        3.1 * s,
    ]
}

fn glasses_place(t: f64) -> [f64; 3] {
    let s = 0.25 * t;
    [2.2 + 3.4 * s.sin(), 0.9 * (2.0 * s).sin() - 0.2, s]
}

fn shaken(truth: &[StampedPose], metres: f64, seed: usize) -> Vec<StampedPose> {
    let mut drift = Vector6::<f64>::zeros();
    truth
        .iter()
        .enumerate()
        .map(|(i, p)| {
            let mut delta = Vector6::<f64>::zeros();
            for k in 0..6 {
                drift[k] = 0.97 * drift[k] + 0.25 * metres * noise(seed + 6 * i + k);
                delta[k] = drift[k] + 0.15 * metres * noise(seed + 7000 + 6 * i + k);
            }
            delta.fixed_rows_mut::<3>(0).scale_mut(0.3);
            StampedPose {
                world_from_rig: p.world_from_rig * Se3::exp(&delta),
                ..*p
            }
        })
        .collect()
}

/// Walls of a room of 5 × 4 m and of a corridor of 8 × 1.8 m, with some furniture.
fn map() -> Vec<Vector3<f64>> {
    let walls = [
        ([-2.5, -2.0], [2.5, -2.0]),
        ([-2.5, 2.0], [2.5, 2.0]),
        ([-2.5, -2.0], [-2.5, 2.0]),
        ([2.5, -2.0], [2.5, -0.9]),
        ([2.5, 0.9], [2.5, 2.0]),
        ([2.5, -0.9], [10.5, -0.9]),
        ([2.5, 0.9], [10.5, 0.9]),
        ([10.5, -0.9], [10.5, 0.9]),
        ([-0.6, -0.4], [0.6, -0.4]),
        ([-0.6, 0.4], [0.6, 0.4]),
    ];
    (0..24_000)
        .map(|i| {
            let (a, b) = walls[i % walls.len()];
            let f = 0.5 * (noise(5 * i) + 1.0);
            let height = if i % walls.len() < 8 { 2.6 } else { 0.75 };
            Vector3::new(
                a[0] + f * (b[0] - a[0]) + 0.015 * noise(5 * i + 1),
                a[1] + f * (b[1] - a[1]) + 0.015 * noise(5 * i + 2),
                height * 0.5 * (noise(5 * i + 3) + 1.0),
            )
        })
        .collect()
}

fn made_up() -> Report {
    let scanner_truth = walk(36.0, 20.0, scanner_place);
    let glasses_truth = walk(24.0, 10.0, glasses_place);
    let config = EvalConfig::default();
    let scanner =
        evaluate(&scanner_truth, &shaken(&scanner_truth, 0.02, 1), &config).expect("valid");
    let glasses = evaluate(
        &glasses_truth,
        &shaken(&glasses_truth, 0.035, 90_000),
        &config,
    )
    .expect("valid");
    let most = |name: &str, value, unit: &'static str, limit| {
        Figure::new(name, value, unit).with(Limit::AtMost(limit))
    };
    let pixels = |count: usize, spread: f64| -> Vec<f64> {
        (0..count)
            .map(|i| spread * (-2.0 * (0.5 * (noise(3 * i) + 1.0)).max(1e-9).ln()).sqrt())
            .collect()
    };
    let track = |name: &str, evaluation: &Evaluation, truth: &[StampedPose]| {
        Track::of(name, evaluation, &Trajectory::new(truth.to_vec()))
    };
    Report {
        introduction: String::new(),
        title: "Demo walk, seed 7".to_owned(),
        figures: vec![
            most("Scanner ATE rms", scanner.ate_translation_m.rmse, "m", 0.03),
            Figure::new("Scanner ATE max", scanner.ate_translation_m.max, "m"),
            most("Glasses ATE rms", glasses.ate_translation_m.rmse, "m", 0.03),
            Figure::new("Glasses ATE max", glasses.ate_translation_m.max, "m"),
            Figure::new(
                "Glasses rotation rms",
                glasses.ate_rotation_deg.expect("known").rmse,
                "°",
            ),
            most("Map reprojection rms", 0.74, "px", 1.5),
            Figure::new("Glasses frames localized", 98.3, "%").with(Limit::AtLeast(90.0)),
            Figure::new("Map points", 48_213.0, ""),
            most("Wall time", 186.4, "s", 300.0),
            most("Peak memory", 2_134.0, "MB", 4_096.0),
        ],
        map_points: map(),
        tracks: vec![
            track("scanner", &scanner, &scanner_truth),
            track("glasses", &glasses, &glasses_truth),
        ],
        insets: Vec::new(),
        timelines: Vec::new(),
        tables: Vec::new(),
        view: View::Above,
        comparison: compare(&[
            crate::Contender {
                name: "scanner",
                evaluation: &scanner,
            },
            crate::Contender {
                name: "glasses",
                evaluation: &glasses,
            },
        ]),
        courses: vec![Course {
            title: "Farthest that a keyframe moved".to_owned(),
            quantity: "round".to_owned(),
            unit: "mm".to_owned(),
            values: vec![5.0, 1.0, 0.1],
        }],
        histograms: vec![
            Distribution {
                title: "Reprojection errors of the map".to_owned(),
                quantity: "reprojection error".to_owned(),
                unit: "px".to_owned(),
                values: pixels(40_000, 0.52),
            },
            Distribution {
                title: "Reprojection errors of the glasses".to_owned(),
                quantity: "reprojection error".to_owned(),
                unit: "px".to_owned(),
                values: pixels(9_000, 0.81),
            },
        ],
        stages: [
            ("simulate", 71.2),
            ("scan", 38.0),
            ("odometry", 14.9),
            ("map", 33.5),
            ("ground truth", 28.1),
            ("evaluate", 0.7),
        ]
        .map(|(name, wall_secs)| StageTime {
            name: name.to_owned(),
            wall_secs,
        })
        .to_vec(),
        findings: vec![Finding::new(
            "lost",
            Verdict::Warn,
            "/lidar/packets",
            "12 of 14 930 packets were lost between 10:00:17 and 10:00:18",
        )],
        provenance: [
            ("seed", "7"),
            ("version", "lsfb 0.1.0 (fe8bbb9)"),
            (
                "scan.mcap",
                "sha256 3b7e8f0a4f1f2f5c0d9a4c1d2e3f405162738495a6b7c8d9e0f1a2b3c4d5e6f7",
            ),
            (
                "configuration",
                "voxel_size_m = 0.25\nmax_range_m = 60.0\nthreads = 2",
            ),
        ]
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .to_vec(),
        texts: vec![("Marks".to_owned(), "A 1.00 m".to_owned())],
    }
}

#[test]
fn page_stands_alone_and_shows_everything() {
    let dir = tempfile::tempdir().expect("scratch");
    // A developer who wants to look at the page names a place for it.
    let path = std::env::var_os("LSFB_REPORT_OUT")
        .map_or_else(|| dir.path().join("report.html"), Into::into);
    let report = made_up();
    report.write(&path).expect("written");
    let page = std::fs::read_to_string(&path).expect("readable");
    for part in [
        "http:", "https:", "src=", "@import", "#00000", "#00010", "NaN",
    ] {
        assert!(!page.contains(part), "{part}");
    }
    for part in [
        "Demo walk, seed 7",
        "scanner",
        "glasses",
        "simulate",
        "sha256",
        "stroke-dasharray",
        "var(--shade4)",
        "Farthest that a keyframe moved",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert_eq!(page.matches("<svg").count(), 8);
    assert_eq!(page.matches("<canvas").count(), 1);
    assert!(page.len() < 1_500_000, "{} bytes", page.len());
    assert_eq!(page, report.to_html());
}

#[test]
fn verdict_names_what_is_missed() {
    let figure = |value| Figure::new("Glasses ATE rms", value, "m").with(Limit::AtMost(0.03));
    let page = |figures| {
        Report {
            figures,
            ..Report::default()
        }
        .to_html()
    };
    assert!(page(vec![figure(0.02), figure(0.03)]).contains("PASS: no problems found"));
    let missed = page(vec![figure(0.02), figure(0.041)]);
    assert!(missed.contains("WARN: check Glasses ATE rms: 0.041\u{a0}m"));
    assert!(missed.contains("(at most 0.03 m)"));
    assert!(!page(vec![Figure::new("x", 1.0, "")]).contains("class=\"verdict"));
}

#[test]
fn report_of_one_evaluation() {
    let truth = walk(24.0, 10.0, glasses_place);
    let evaluation =
        evaluate(&truth, &shaken(&truth, 0.02, 5), &EvalConfig::default()).expect("valid");
    let page = Report::of_evaluation("glasses.tum", &evaluation, &Trajectory::new(truth)).to_html();
    for part in [
        "glasses.tum evaluated against ground truth",
        "ATE translation rmse",
        "RPE rotation rmse per 1 m",
        "Scale error",
        "Share of poses by translation error",
    ] {
        assert!(page.contains(part), "{part}");
    }
    assert_eq!(page.matches("<svg").count(), 5);
}

#[test]
fn hostile_text_and_odd_data_do_no_harm() {
    let mut report = made_up();
    report.title = "<script>alert(1)</script>".to_owned();
    report.map_points = vec![
        Vector3::new(f64::NAN, 0.0, 0.0),
        Vector3::new(1.0, 1.0, f64::INFINITY),
    ];
    report.histograms[0].values = vec![f64::NAN, 0.0, 0.0];
    report.histograms[1].values.clear();
    report.tracks.truncate(1);
    report.tracks[0].errors.truncate(1);
    let page = report.to_html();
    assert!(!page.contains("<script>alert"));
    assert!(Report::default().to_html().contains("<main>"));
}

#[test]
fn other_worlds_are_seen_where_they_are_widest() {
    let turned = |poses: Vec<StampedPose>| -> Vec<StampedPose> {
        // A camera's world: y down, z forward.
        let camera_from_world = Se3::exp(&Vector6::new(
            std::f64::consts::FRAC_PI_2,
            0.0,
            0.0,
            0.0,
            0.0,
            0.0,
        ));
        poses
            .into_iter()
            .map(|p| StampedPose {
                world_from_rig: camera_from_world * p.world_from_rig,
                ..p
            })
            .collect()
    };
    let truth = turned(walk(24.0, 10.0, glasses_place));
    let evaluation = evaluate(&truth, &truth, &EvalConfig::default()).expect("valid");
    let mut report = Report::of_evaluation("x", &evaluation, &Trajectory::new(truth));
    assert!(report.to_html().contains("In the plane of x and z"));
    report.view = View::Above;
    assert!(report.to_html().contains("From above"));
}

/// A flat line at zero would look like perfect rotations.
#[test]
fn positions_alone_have_no_rotation_error() {
    let truth = walk(36.0, 20.0, scanner_place);
    let config = EvalConfig {
        orientations: crate::Orientations::Missing,
        ..EvalConfig::default()
    };
    let found = evaluate(&truth, &shaken(&truth, 0.02, 1), &config).expect("valid");
    let page = Report::of_evaluation("positions", &found, &Trajectory::new(truth)).to_html();
    assert!(page.contains("Translation error over time"));
    assert!(!page.contains("Rotation error") && !page.contains("rotation rmse"));
}
