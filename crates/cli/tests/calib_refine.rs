//! The LiDAR placed to a camera without a board, as an operator does it, and what cannot be refined.

use std::path::Path;

use crate::answer::json;
use crate::pages;
use crate::process::lsfb;
use crate::refusal::{found_unfit, refused};
use lsfb_calib::TransformEdge;
use lsfb_geometry::{Rig, Se3, Vector6};
use lsfb_rigs::walk::Walk;
use lsfb_sim::SimConfig;

/// 95 % of six normal numbers squared lie within this, and all but one in a hundred thousand within that.
const SURELY_INSIDE: f64 = 33.1;

fn walk() -> Walk {
    let mut config = SimConfig {
        texel_m: 0.006,
        ..SimConfig::default()
    };
    (config.scan_cameras.width, config.scan_cameras.height) = (320, 200);
    Walk::simulate(&config, &["cam0"], 10.0)
}

fn write_rig(path: &Path, rig: &Rig, wrong: Vector6<f64>) {
    let mut rig = rig.clone();
    if let Some(lidar) = rig.lidar_mut() {
        lidar.rig_from_lidar = lidar.rig_from_lidar * Se3::exp(&wrong);
    }
    std::fs::write(path, rig.to_toml()).expect("rig");
}

#[test]
fn a_lidar_that_is_nearly_right_is_refined_and_what_cannot_be_is_said() {
    let folder = tempfile::tempdir().expect("folder");
    let path = folder.path();
    let walk = walk();
    walk.write(&path.join("scan.mcap"), 0.0);
    // 2.4° and 5 cm off.
    let wrong = Vector6::new(0.025, -0.024, 0.024, 0.03, 0.03, -0.027);
    write_rig(&path.join("by-hand.toml"), &walk.rig, wrong);
    let refine = ["calib", "refine", "scan.mcap", "--out", "refined.html"];
    let by_hand = [&refine[..], &["--rig", "by-hand.toml"]].concat();

    let found = json(path, &by_hand, 0);
    let edge = TransformEdge::read(&path.join("refined.cam0-lidar.json")).expect("edge");
    let truth = walk.rig.cameras["cam0"].rig_from_camera.inverse()
        * walk.rig.lidar().expect("a LiDAR").rig_from_lidar;
    let off = (truth.inverse() * edge.target_from_source).log();
    let covariance = edge.covariance.expect("covariance");
    let weighted = covariance.cholesky().expect("positive").solve(&off);
    assert!(off.dot(&weighted) < SURELY_INSIDE, "{off}: {found}");
    let [turn_deg, shift_mm] = [
        off.fixed_rows::<3>(0).norm().to_degrees(),
        off.fixed_rows::<3>(3).norm() * 1e3,
    ];
    assert!(
        turn_deg < 0.15 && shift_mm < 15.0,
        "{turn_deg}° {shift_mm} mm"
    );
    let camera = &found["cameras"][0];
    let components = camera["components"].as_array().expect("six");
    assert_eq!(components.len(), 6);
    for component in components {
        let sigma = component["sigma"].as_f64().expect("sigma");
        assert!(sigma > 0.0 && sigma < 0.05, "{component}");
    }
    let transfer = |which: &str| {
        let px = camera["evidence"]["transfer"][which].as_f64();
        px.expect("pixels")
    };
    assert!(
        transfer("held_back_px") < 0.6 * transfer("before_px"),
        "{camera}"
    );
    let page = std::fs::read_to_string(path.join("refined.html")).expect("a page");
    pages::are_whole(path);
    for word in [
        "PASS: 1 of 1 cameras",
        "held-out parts",
        "<svg",
        "<img src=\"data:image/png;base64,",
    ] {
        assert!(page.contains(word), "{word}: {page}");
    }
    for picture in ["refined.cam0-before.png", "refined.cam0-after.png"] {
        assert!(path.join(picture).exists(), "{picture}");
    }

    // Far off.
    let far = Vector6::new(0.15, -0.15, 0.1, 0.2, 0.2, -0.2);
    write_rig(&path.join("far.toml"), &walk.rig, far);
    let lost = |rig: &str, recording: &str, words: &[&str]| {
        let arguments = [
            "calib",
            "refine",
            recording,
            "--rig",
            rig,
            "--out",
            "lost.html",
            "--force",
        ];
        let output = lsfb(path, &arguments);
        let text = String::from_utf8_lossy(&output.stdout);
        assert_eq!(output.status.code(), Some(4), "{text}");
        for word in words {
            assert!(text.contains(word), "{word:?}: {text}");
        }
        let page = std::fs::read_to_string(path.join("lost.html")).expect("a page");
        assert!(page.contains("FAIL: 0 of 1 cameras"), "{page}");
        assert!(!path.join("lost.cam0-lidar.json").exists());
    };
    lost("far.toml", "scan.mcap", &["cam0", "2.5° and 5 cm"]);

    // A covered lens.
    let mut covered = walk.clone();
    for (_, image) in &mut covered.images {
        image.sample.pixels.fill(12);
    }
    covered.write(&path.join("covered.mcap"), 0.0);
    lost(
        "by-hand.toml",
        "covered.mcap",
        &["cam0", "covered, in the dark"],
    );

    // Nothing that stands still.
    let mut leaves = walk.clone();
    let mut state = 1u32;
    for scan in &mut leaves.scans {
        for point in &mut scan.sample.points {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            let longer = 1.0 + (state >> 8) as f32 / 16_777_216.0;
            point.position_m = point.position_m.map(|c| c * longer);
        }
    }
    leaves.write(&path.join("leaves.mcap"), 0.0);
    refuse_data(
        path,
        "leaves.mcap",
        "by-hand.toml",
        &["cannot be registered to each other"],
    );

    let mut blind = walk.clone();
    for scan in &mut blind.scans {
        scan.sample.points.clear();
    }
    blind.write(&path.join("blind.mcap"), 0.0);
    refuse_data(path, "blind.mcap", "by-hand.toml", &["lidar", "too short"]);

    let mut unplaced = walk.rig.clone();
    unplaced.lidars.clear();
    write_rig(&path.join("unplaced.toml"), &unplaced, Vector6::zeros());
    refuse(path, "scan.mcap", "unplaced.toml", &["no LiDAR", "by hand"]);

    let mut other = walk.rig.clone();
    let camera = other.cameras.remove("cam0").expect("cam0");
    other.cameras.insert("cam7".to_owned(), camera);
    write_rig(&path.join("other.toml"), &other, Vector6::zeros());
    refuse_data(
        path,
        "scan.mcap",
        "other.toml",
        &["none of the rig's cameras"],
    );

    std::fs::write(path.join("short.toml"), "longest_s = 3.0\n").expect("settings");
    let short = ["--config", "short.toml", "--rig", "by-hand.toml"];
    found_unfit(
        path,
        &[&refine[..3], &["--out", "no.html"], &short].concat(),
        &["too short", "30 s"],
    );
}

fn refine<'a>(recording: &'a str, rig: &'a str) -> [&'a str; 7] {
    [
        "calib", "refine", recording, "--rig", rig, "--out", "no.html",
    ]
}

fn refuse(folder: &Path, recording: &str, rig: &str, words: &[&str]) {
    refused(folder, &refine(recording, rig), words);
    assert!(!folder.join("no.html").exists());
}

/// The same where what was recorded is unfit.
fn refuse_data(folder: &Path, recording: &str, rig: &str, words: &[&str]) {
    found_unfit(folder, &refine(recording, rig), words);
    assert!(!folder.join("no.html").exists());
}
