//! Everything that goes wrong when a rig is calibrated, by the words in which the built binary names it: as text, in the
//! JSON, on the page. The table for users is `docs/calibration-faults.md`.

mod before_a_lidar;
mod board_walk;
mod small_board;

use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use self::board_walk::{FISHEYE, GRID, ORIGIN_NS, Sample, Tags, Walk, write_samples};
use crate::process::lsfb;
use lsfb_geometry::camera::Lens;
use serde_json::Value;
use tempfile::TempDir;

fn folder() -> TempDir {
    TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("folder")
}

/// A walk as it should be, for all tests that spoil one thing of it.
fn good() -> &'static Path {
    static FOLDER: OnceLock<PathBuf> = OnceLock::new();
    FOLDER.get_or_init(|| {
        let path = folder().keep();
        Walk::default().write(&path);
        path
    })
}

/// How a command must end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    Pass,
    Warn,
    /// A page that says why, and no rig.
    Fail,
    /// One sentence, and no rig: the data is unfit.
    Refused,
}

/// Runs a command that writes `out` and must end so, with all of `words` in its JSON and on its page, or in its one sentence.
fn ends(path: &Path, arguments: &[&str], out: &str, end: End, words: &[&str]) -> Value {
    let output = lsfb(path, &[arguments, &["--out", out, "--json"]].concat());
    let sentence = String::from_utf8_lossy(&output.stderr).into_owned();
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let all = format!("{arguments:?}\n{printed}\n{sentence}");
    let page = path.join(out).with_extension("html");
    let found: Value = serde_json::from_str(&printed).unwrap_or_default();
    let places = match end {
        End::Refused => vec![sentence],
        _ => {
            let page = std::fs::read_to_string(page).unwrap_or_else(|_| panic!("no page: {all}"));
            vec![printed, page]
        }
    };
    let (code, verdict) = match end {
        End::Pass => (0, "pass"),
        End::Warn => (0, "warn"),
        End::Fail => (4, "fail"),
        End::Refused => (4, "fail"),
    };
    assert_eq!(output.status.code(), Some(code), "{all}");
    assert_eq!(path.join(out).exists(), code == 0, "{all}");
    assert_eq!(
        found["verdict"].as_str().unwrap_or_default(),
        verdict,
        "{all}"
    );
    if end == End::Refused {
        let refusal = &found["findings"][0];
        assert!(
            refusal["code"].is_string() && refusal["remedy"].is_string(),
            "{all}"
        );
        assert!(found["error"].is_string(), "{all}");
    }
    for word in words {
        for place in &places {
            assert!(place.contains(word), "{word:?} is not said: {all}");
        }
    }
    found
}

/// Says the words in text as well.
fn says(path: &Path, arguments: &[&str], words: &[&str]) {
    let output = lsfb(
        path,
        &[arguments, &["--out", "said.toml", "--force"]].concat(),
    );
    let text = String::from_utf8_lossy(&output.stdout);
    for word in words {
        assert!(text.contains(word), "{word:?} is not said: {text}");
    }
}

/// `lsfb calib camera` with one camera.
const LENSES: [&str; 6] = [
    "calib",
    "camera",
    "--april-grid",
    GRID,
    "--camera",
    "cam0=cam0",
];

/// `lsfb calib camera-imu` with one camera and a table of samples.
fn camera_imu<'a>(grid: &'a str, camera: &'a str, imu: &'a str) -> Vec<&'a str> {
    let command = ["calib", "camera-imu", "--rig", "rig.toml"];
    let rest = ["--april-grid", grid, "--camera", camera, "--imu", imu];
    [&command[..], &rest].concat()
}

/// The samples of the good walk, spoilt, and what is said of them.
fn samples_end(name: &str, spoil: impl Fn(&mut Sample), end: End, words: &[&str]) {
    let mut samples = Walk::default().samples();
    samples.iter_mut().for_each(spoil);
    let table = format!("{name}.csv");
    write_samples(&good().join(&table), &samples);
    let arguments = camera_imu(GRID, "cam0=cam0", &table);
    ends(good(), &arguments, &format!("{name}.toml"), end, words);
}

/// Images of the good walk under other names, by stamp.
fn restamped(name: &str, camera: &str, stamp: impl Fn(i64, usize) -> i64) {
    let from = good().join(camera);
    let to = good().join(name);
    std::fs::create_dir(&to).expect("folder");
    let mut names: Vec<i64> = std::fs::read_dir(&from)
        .expect("folder")
        .filter_map(|f| f.ok()?.path().file_stem()?.to_str()?.parse().ok())
        .collect();
    names.sort_unstable();
    for (k, old) in names.into_iter().enumerate() {
        let new = to.join(format!("{}.png", stamp(old, k)));
        std::fs::hard_link(from.join(format!("{old}.png")), new).expect("image");
    }
}

#[test]
fn samples_of_an_imu() {
    samples_end("as_they_are", |_| {}, End::Pass, &["no problems found"]);
    samples_end(
        "gyro_range",
        |s| s.gyro_rad_s[0] = s.gyro_rad_s[0].clamp(-1.1, 1.1),
        End::Warn,
        &["the gyroscope saturates along x", "widen the range"],
    );
    samples_end(
        "accel_range",
        |s| s.accel_m_s2[1] = s.accel_m_s2[1].clamp(-4.0, 4.0),
        End::Warn,
        &["the accelerometer saturates along y", "widen the range"],
    );
    samples_end(
        "degrees",
        |s| s.gyro_rad_s = s.gyro_rad_s.map(f64::to_degrees),
        End::Refused,
        &["in degrees", "convert them to radians per second"],
    );
    samples_end(
        "in_g",
        |s| s.accel_m_s2 = s.accel_m_s2.map(|a| a / 9.80665),
        End::Refused,
        &["it is in units of g"],
    );
    samples_end(
        "gyro_sign",
        |s| s.gyro_rad_s[1] = -s.gyro_rad_s[1],
        End::Refused,
        &["the gyroscope's axes are left-handed"],
    );
    samples_end(
        "accel_sign",
        |s| s.accel_m_s2[1] = -s.accel_m_s2[1],
        End::Refused,
        &["an axis of the accelerometer has the wrong sign"],
    );
}

#[test]
fn clocks_of_camera_and_imu() {
    samples_end(
        "early",
        |s| s.stamp_ns += 50_000_000,
        End::Warn,
        &["stamps are 50.0 ms early", "lsfb clock"],
    );
    says(
        good(),
        &camera_imu(GRID, "cam0=cam0", "early.csv"),
        &["WARN: ", "stamps are 50.0 ms early"],
    );
    samples_end(
        "a_second",
        |s| s.stamp_ns += 1_000_000_000,
        End::Refused,
        &["clocks are not synchronised", "+1.00 s"],
    );
    samples_end(
        "drift",
        |s| s.stamp_ns += (s.stamp_ns - ORIGIN_NS) / 10_000,
        End::Warn,
        &["ppm slower than the IMU's", "synchronise the clocks"],
    );
    // The same for every run: a sample in five comes late.
    samples_end(
        "late_samples",
        |s| {
            let number = (s.stamp_ns - ORIGIN_NS) / 5_000_000;
            s.stamp_ns += [0, 0, 4_000_000, 0, 2_000_000, 0, 0][(number * number % 7) as usize];
        },
        End::Warn,
        &["IMU stamps jitter by"],
    );
    restamped("jitter", "cam0", |stamp, k| {
        stamp + [0, 5_000_000, -4_000_000, 2_000_000, -3_000_000][k * k % 5]
    });
    restamped("jump", "cam0", |stamp, k| {
        stamp + if k > 60 { 6_000_000 } else { 0 }
    });
    // Another unit, and the numbers of frames.
    restamped("micro", "cam0", |stamp, _| stamp / 1000);
    restamped("milli", "cam0", |stamp, _| stamp / 1_000_000);
    restamped("frames", "cam0", |_, k| k as i64 + 1);
    for (camera, words) in [
        (
            "cam0=micro",
            &["images of cam0", "look like microseconds"][..],
        ),
        ("cam0=milli", &["images of cam0", "look like milliseconds"]),
        ("cam0=frames", &["images of cam0", "1 apart are not stamps"]),
    ] {
        let arguments = camera_imu(GRID, camera, "imu.csv");
        ends(good(), &arguments, "unit.toml", End::Refused, words);
    }
    for (camera, words) in [
        ("cam0=jitter", &["off their stamps", "jitter or jump"][..]),
        ("cam0=jump", &["synchronise the clocks"]),
    ] {
        let out = format!("{}.toml", &camera[5..]);
        ends(
            good(),
            &camera_imu(GRID, camera, "imu.csv"),
            &out,
            End::Warn,
            words,
        );
    }
}

#[test]
fn boards_before_camera_and_imu() {
    let fails = |name: &str, grid: &str, words: &[&str]| {
        let arguments = camera_imu(grid, "cam0=cam0", "imu.csv");
        ends(good(), &arguments, name, End::Fail, words)
    };
    // Said to be 5 % smaller than it is.
    let larger = fails(
        "larger.toml",
        "4,3,0.133333,0.3",
        &["% larger than specified", "tags of 1", "measure it"],
    );
    let number = |name: &str| larger[name].as_f64().expect("a number");
    let (excess, sigma) = (number("board_excess"), number("board_excess_sigma"));
    assert!(
        (excess - 0.05).abs() < 4.0 * sigma && sigma < 0.003,
        "{excess} ± {sigma}"
    );
    fails(
        "gaps.toml",
        "4,3,0.14,0.36",
        &["gaps of 0.2", "correct tagSpacing"],
    );
    // Met to less than what fails anything: it was a warning once.
    fails(
        "smaller_gaps.toml",
        "4,3,0.14,0.25",
        &["gaps of 0.", "correct tagSpacing"],
    );
    let head = folder();
    Walk {
        upside_down: true,
        seconds: 6.0,
        cameras: &["cam0"],
        ..Walk::default()
    }
    .write(head.path());
    let arguments = camera_imu(GRID, "cam0=cam0", "imu.csv");
    ends(
        head.path(),
        &arguments,
        "o.toml",
        End::Warn,
        &["the board hangs upside down"],
    );
}

#[test]
fn cameras_that_are_not_what_they_are_called() {
    let imu = "imu.csv";
    ends(
        good(),
        &camera_imu(GRID, "cam0=cam1", imu),
        "one_swapped.toml",
        End::Warn,
        &[
            "found where the rig has cam1",
            "their images or their names are swapped",
        ],
    );
    let both = [
        &camera_imu(GRID, "cam0=cam1", imu)[..],
        &["--camera", "cam1=cam0"],
    ]
    .concat();
    ends(
        good(),
        &both,
        "swapped.toml",
        End::Refused,
        &["their views are swapped"],
    );
    let lenses = ["calib", "camera", "--rig", "rig.toml", "--april-grid", GRID];
    let cameras = ["--camera", "cam0=cam1", "--camera", "cam1=cam0"];
    let words = &[
        "are swapped compared with the rig",
        "their views or their names",
    ];
    ends(
        good(),
        &[&lenses[..], &cameras].concat(),
        "lenses.toml",
        End::Warn,
        words,
    );
}

/// Images of two cameras by turns: of each, those whose number is said to be its own.
fn mixed(name: &str, folders: [&Path; 2], of_second: impl Fn(usize) -> bool) {
    let to = good().join(name);
    std::fs::create_dir(&to).expect("folder");
    let entries = std::fs::read_dir(folders[0]).expect("folder");
    let mut names: Vec<_> = entries.map(|f| f.expect("image").file_name()).collect();
    names.sort();
    for (k, name) in names.into_iter().enumerate() {
        let from = folders[usize::from(of_second(k))].join(&name);
        std::fs::hard_link(from, to.join(name)).expect("image");
    }
}

/// Once PASS, with corners met to a tenth of a pixel: the lens of neither.
#[test]
fn images_of_two_cameras_in_one_folder() {
    let Lens::KannalaBrandt { distortion, .. } = FISHEYE else {
        panic!("a fisheye")
    };
    let other = folder();
    Walk {
        lens: Lens::KannalaBrandt {
            focal_px: [165.6, 166.1],
            principal_px: [163.0, 116.5],
            distortion,
        },
        cameras: &["cam0"],
        ..Walk::default()
    }
    .write(other.path());
    let [left, right] = ["cam0", "cam1"].map(|c| good().join(c));
    let twin = other.path().join("cam0");
    let folders = [left.as_path(), twin.as_path()];
    mixed("by_turns", folders, |k| k % 2 == 1);
    mixed("half_way", folders, |k| k >= 60);
    let words = &["not all images were taken with one lens", "cx"];
    for camera in ["by_turns", "half_way"] {
        let place = format!("cam0={camera}");
        let lenses = [&LENSES[..5], &[place.as_str()]].concat();
        ends(good(), &lenses, &format!("{camera}.toml"), End::Fail, words);
    }
    // Left is right and right is left from some instant on.
    let folders = [left.as_path(), right.as_path()];
    mixed("first", folders, |k| k >= 70);
    mixed("second", folders, |k| k < 70);
    let cameras = ["cam0=first", "--camera", "cam1=second"];
    let pair = [&LENSES[..5], &cameras].concat();
    let words = &["their images are swapped at"];
    ends(good(), &pair, "exchanged.toml", End::Refused, words);
}

#[test]
fn motions_that_say_too_little() {
    let base = Walk {
        seconds: 7.0,
        cameras: &["cam0"],
        ..Walk::default()
    };
    let motion = |turning_rad, moving_m| Walk {
        turning_rad,
        moving_m,
        ..base
    };
    let moving = base.moving_m;
    let cases = [
        (
            "x",
            motion([0.0, 0.02, 0.3], moving),
            End::Refused,
            &["rotate more about x"][..],
        ),
        (
            "y",
            motion([0.35, 0.0, 0.02], moving),
            End::Refused,
            &["rotate more about", "y ("],
        ),
        (
            "z",
            motion([0.02, 0.3, 0.0], moving),
            End::Refused,
            &["rotate more about", "z ("],
        ),
        (
            "hardly_x",
            motion([0.0, 0.3, 0.3], moving),
            End::Warn,
            &["hardly any rotation about x", "rotate more about x"],
        ),
        (
            "turning_alone",
            motion(base.turning_rad, [0.0; 3]),
            End::Warn,
            &["size not checked", "by 20 cm"],
        ),
        (
            "moving_alone",
            motion([0.0; 3], moving),
            End::Refused,
            &["rotate more about x"],
        ),
        (
            "still",
            motion([0.0; 3], [0.0; 3]),
            End::Refused,
            &["rotate more about x"],
        ),
    ];
    let root = folder();
    for (name, walk, end, words) in cases {
        let path = root.path().join(name);
        std::fs::create_dir(&path).expect("folder");
        walk.write(&path);
        ends(
            &path,
            &camera_imu(GRID, "cam0=cam0", "imu.csv"),
            "o.toml",
            end,
            words,
        );
        let of_lens: Option<&[&str]> = match name {
            "moving_alone" => Some(&["cannot be determined", "tilted by 30°", "near and far"]),
            // One image, again and again.
            "still" => Some(&["only 1 of them differ", "duplicates", "move the board"]),
            _ => None,
        };
        if let Some(words) = of_lens {
            ends(&path, &LENSES, "lens.toml", End::Refused, words);
        }
    }
}

#[test]
fn images_without_the_board() {
    let root = folder();
    let path = root.path();
    let short = Walk {
        seconds: 4.0,
        cameras: &["cam0"],
        ..Walk::default()
    };
    short.write(path);
    // As a driver that flips its images, as another family, and as a cap on the lens.
    let other = Walk {
        tags: Tags::Other,
        cameras: &["cam0"],
        ..short
    };
    std::fs::create_dir(path.join("other")).expect("folder");
    other.write(&path.join("other"));
    for (name, change) in [
        (
            "mirrored",
            (|row: &mut [u8]| row.reverse()) as fn(&mut [u8]),
        ),
        ("dark", |row| row.fill(3)),
    ] {
        std::fs::create_dir(path.join(name)).expect("folder");
        board_walk::changed_images(&path.join("cam0"), &path.join(name), change);
    }
    for (images, words) in [
        (
            "mirrored",
            &["show its tags mirrored", "turn off image flipping"][..],
        ),
        (
            "other/cam0",
            &["show other tags", "another family than 36h11"],
        ),
        ("dark", &["the target was found in 0 of 37 images", "focus"]),
    ] {
        let second = format!("cam1={images}");
        let imu = camera_imu(GRID, "cam0=cam0", "imu.csv");
        for arguments in [&imu[..], &LENSES] {
            let both = [arguments, &["--camera", &second]].concat();
            let words = [words, &["cam1: "]].concat();
            ends(path, &both, "o.toml", End::Refused, &words);
        }
    }
    let lenses = [
        "calib",
        "camera",
        "--camera",
        "cam0=cam0",
        "--checkerboard",
        "9,6,0.03",
    ];
    let words = &[
        "found in 0 of 37 images",
        "check the target's kind and size",
    ];
    ends(path, &lenses, "o.toml", End::Refused, words);
}

#[test]
fn lenses_and_triggers() {
    ends(good(), &LENSES, "fisheye.toml", End::Pass, &[]);
    let pinhole = [&LENSES[..], &["--model", "pinhole-radtan"]].concat();
    let words = &["the lens model does not fit", "use --model kannala-brandt"];
    ends(good(), &pinhole, "pinhole.toml", End::Warn, words);
    says(good(), &pinhole, words);
    // The right one is not accused: seen through a pinhole, a fisheye's model has no pattern to take off.
    let narrow = folder();
    let Lens::KannalaBrandt { principal_px, .. } = FISHEYE else {
        panic!("a fisheye")
    };
    Walk {
        lens: Lens::PinholeRadtan {
            focal_px: [180.0, 180.5],
            principal_px,
            distortion: [-0.08, 0.02, 0.0, 0.0, 0.0],
        },
        seconds: 8.0,
        cameras: &["cam0"],
        ..Walk::default()
    }
    .write(narrow.path());
    ends(narrow.path(), &pinhole, "pinhole.toml", End::Pass, &[]);

    // One camera a few milliseconds late, and one image late.
    restamped("next", "cam1", |stamp, _| stamp + 100_000_000);
    let pair = [&LENSES[..], &["--camera", "cam1=next"]].concat();
    ends(
        good(),
        &pair,
        "next.toml",
        End::Refused,
        &["not triggered together"],
    );
    let late = folder();
    let of = |cameras| Walk {
        seconds: 8.0,
        cameras,
        ..Walk::default()
    };
    of(&["cam0"]).write(late.path());
    of(&["cam1"]).write_late(&late.path().join("late"), 0.006);
    let pair = [&LENSES[..], &["--camera", "cam1=late/cam1"]].concat();
    let words = &["px together with the other cameras", "triggered together"];
    ends(late.path(), &pair, "late.toml", End::Warn, words);
}
