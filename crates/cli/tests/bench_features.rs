//! `lsfb bench features` on a few images: a feature whose answers are known by the homographies, and ours beside it.

use std::path::Path;
use std::process::Output;

use crate::answer::json;
use crate::process::lsfb;
use serde_json::Value;

fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// Numbers of a descriptor that no other has.
fn look(index: usize) -> String {
    let mut state = index as u64 + 1;
    let numbers = (0..128).map(|_| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (state >> 58).to_string()
    });
    numbers.collect::<Vec<_>>().join(" ")
}

/// Keypoints on a lattice in each source, and in its target where they belong but for a shift; nothing in images of other pairs.
fn write_peer(folder: &Path, out: &Path, shift_px: f64) {
    std::fs::create_dir(folder).expect("folder");
    let images = std::fs::read_dir(out.join("images"))
        .expect("images")
        .count();
    for number in 0..images {
        std::fs::write(folder.join(format!("{number:04}.txt")), "cpu_ms 7.5\n").expect("file");
    }
    let text = std::fs::read_to_string(out.join("homographies.json")).expect("homographies");
    let pairs: Value = serde_json::from_str(&text).expect("JSON");
    for pair in pairs.as_array().expect("a list") {
        let h = |r: usize, c: usize| pair["target_from_source"][r][c].as_f64().expect("a number");
        let (mut source, mut target) = (String::from("cpu_ms 7.5\n"), String::from("cpu_ms 7.5\n"));
        for index in 0..300usize {
            let (x, y) = (
                20.0 + 25.0 * (index % 20) as f64,
                20.0 + 22.0 * (index / 20) as f64,
            );
            let row = |r: usize| h(r, 0) * x + h(r, 1) * y + h(r, 2);
            let (u, v) = (row(0) / row(2), row(1) / row(2));
            source += &format!("{x} {y} 2 {}\n", look(index));
            target += &format!("{} {v} 2 {}\n", u + shift_px, look(index));
        }
        for (side, text) in [source, target].into_iter().enumerate() {
            let number = pair["images"][side].as_u64().expect("a number");
            std::fs::write(folder.join(format!("{number:04}.txt")), text).expect("file");
        }
    }
}

#[test]
fn features_are_compared_by_what_is_known_of_the_pairs() {
    let test = "features_are_compared_by_what_is_known_of_the_pairs";
    let below = ["hololens_office/images", "strecha_fountain_P11_half"];
    let [Some(office), Some(fountain)] =
        below.map(|name| lsfb_tests::recordings(test, &format!("vision/{name}")))
    else {
        return;
    };
    let scratch = tempfile::tempdir().expect("folder");
    let root = scratch.path();
    let [office, fountain] = [office, fountain].map(|path| path.display().to_string());
    let mut arguments: Vec<&str> = "bench features --out f --images".split(' ').collect();
    arguments.extend([&office[..], "--posed-images", &fountain]);
    let few = "--homography-images 1 --pose-pairs 4 --feature sift --keep-images";
    arguments.extend(few.split(' '));
    let ours = json(root, &arguments, 0);
    assert_eq!(
        (&ours["homography_pairs"], &ours["pose_pairs"]),
        (&5.into(), &4.into())
    );
    let again = lsfb(root, &arguments);
    assert_eq!(again.status.code(), Some(1), "{}", said(&again));
    assert!(said(&again).contains("--force"), "{}", said(&again));

    write_peer(&root.join("exact"), &root.join("f"), 0.0);
    write_peer(&root.join("shifted"), &root.join("f"), 2.0);
    arguments
        .extend("--force --peer-features Exact=exact --peer-features Shifted=shifted".split(' '));
    let all = json(root, &arguments, 0);
    let [sift, exact, shifted] = [0, 1, 2].map(|k| &all["features"][k]);
    // Same pairs, same figures.
    for part in [
        "homographies",
        "by_kind",
        "poses",
        "by_place",
        "features_per_image",
    ] {
        assert_eq!(sift[part], ours["features"][0][part], "{part}");
    }
    let share = |row: &Value, what: &str, limit: usize| {
        row["homographies"][what][limit].as_f64().expect("a number")
    };
    for what in ["repeatability", "matching_accuracy"] {
        assert_eq!(
            [0, 1].map(|limit| share(exact, what, limit)),
            [1.0, 1.0],
            "{what}"
        );
        assert!(
            share(sift, what, 0) > 0.2 && share(sift, what, 1) > share(sift, what, 0),
            "{what}"
        );
    }
    // But for those that the shift moves to the rim.
    assert!(share(shifted, "matching_accuracy", 1) > 0.97);
    assert_eq!(share(shifted, "matching_accuracy", 0), 0.0);
    assert_eq!(exact["cpu_ms_per_image"], 7.5);
    // It finds nothing in the images with poses.
    assert_eq!(exact["poses"]["auc"][2], 0.0);
    assert!(
        sift["poses"]["auc"][2]
            .as_f64()
            .is_some_and(|auc| auc > 0.5),
        "{}",
        sift["poses"]
    );

    std::fs::remove_file(root.join("exact/0003.txt")).expect("file");
    let torn = lsfb(root, &arguments);
    assert_eq!(torn.status.code(), Some(1), "{}", said(&torn));
    assert!(said(&torn).contains("0003.txt"), "{}", said(&torn));
}

#[test]
fn no_images_and_features_that_nobody_knows_are_refused() {
    let scratch = tempfile::tempdir().expect("folder");
    let root = scratch.path();
    std::fs::create_dir(root.join("empty")).expect("folder");
    let said_of = |arguments: &str| {
        let output = lsfb(root, &arguments.split(' ').collect::<Vec<_>>());
        assert_ne!(output.status.code(), Some(0), "{arguments}");
        said(&output)
    };
    assert!(said_of("bench features --out f").contains("--posed-images"));
    assert!(said_of("bench features --images empty --out f").contains("no images"));
    assert!(said_of("bench features --images nowhere --out f").contains("nowhere"));
    let unknown = said_of("bench features --images empty --out f --feature surf --models empty");
    assert!(unknown.contains("no feature surf"), "{unknown}");
    assert!(
        said_of("bench features --images empty --out f --peer-features surf")
            .contains("PEER=result")
    );
}

#[test]
fn an_image_without_a_keypoint_has_no_repeatability() {
    let scratch = tempfile::tempdir().expect("folder");
    let root = scratch.path();
    std::fs::create_dir(root.join("black")).expect("folder");
    let file = std::fs::File::create(root.join("black/a.png")).expect("file");
    let mut encoder = png::Encoder::new(file, 96, 80);
    encoder.set_color(png::ColorType::Grayscale);
    let mut writer = encoder.write_header().expect("header");
    writer.write_image_data(&[0; 96 * 80]).expect("pixels");
    writer.finish().expect("image");
    let arguments = "bench features --images black --feature sift --out f";
    let mut arguments: Vec<&str> = arguments.split(' ').collect();
    let printed = json(root, &arguments, 0);
    let planar = &printed["features"][0]["homographies"];
    assert_eq!(planar["repeatability"], Value::Null);
    assert_eq!(planar["right_matches"], 0.0);
    arguments.extend(["--force", "--homography-images", "0"]);
    let none = lsfb(root, &arguments);
    assert_eq!(none.status.code(), Some(1), "{}", said(&none));
    assert!(said(&none).contains("no pairs"), "{}", said(&none));
}
