//! What cannot be used is refused with one sentence, and what was there before stays as it was.

use std::path::Path;

use crate::answer::json;
use crate::capture_file::pcap;
use crate::process::lsfb;
use crate::refusal::{badly_asked, contents, found_unfit, refused};
use crate::session::{inputs, with};
use lsfb_recording::{Recording, read_tum};
use tempfile::TempDir;

fn noise(bytes: usize) -> Vec<u8> {
    let mut state = 0x9E37_79B9_u32;
    let next = |_| {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        (state >> 24) as u8
    };
    (0..bytes).map(next).collect()
}

#[test]
fn files_that_are_no_recordings() {
    let folder = with(&["map", "scan.tum"]);
    let path = folder.path();
    std::fs::write(path.join("noise.mcap"), noise(100_000)).expect("file");
    std::fs::write(path.join("empty.mcap"), "").expect("file");
    std::fs::create_dir(path.join("folder.mcap")).expect("folder");
    for (name, word) in [
        ("noise.mcap", "not an MCAP file"),
        ("empty.mcap", "empty"),
        ("missing.mcap", "no such file"),
        ("folder.mcap", ""),
    ] {
        refused(
            path,
            &["odometry", name, "--out", "scan.tum"],
            &[name, word],
        );
        refused(path, &["map", name, "--out", "map"], &[name]);
        refused(
            path,
            &["groundtruth", name, "--map", "map", "--out", "scan.tum"],
            &[name],
        );
    }
}

/// What is made of a map that failed its checks said so in sentences on stderr, and its JSON had no verdict.
#[test]
fn what_is_made_of_a_map_that_failed_has_failed() {
    let folder = with(&["map"]);
    let path = folder.path();
    let all = ["--min-m=-99,-99,-99", "--max-m", "99,99,99"];
    let crop = |out: &str, code| {
        let arguments = [&["map", "crop", "map"], &all[..], &["--out", out]].concat();
        json(path, &arguments, code)
    };
    let good = crop("good", 0);
    assert_eq!(good["verdict"], "pass", "{good}");
    let header = path.join("map/map.toml");
    let text = std::fs::read_to_string(&header).expect("header");
    let failed = "failures = ['the IMU: its axes are exchanged']\n".to_owned() + &text;
    std::fs::write(&header, failed).expect("header");
    let export = |format: &str| json(path, &["map", "export", format, "map", "--out", format], 4);
    let prune = [
        "map",
        "prune",
        "map",
        "--size-mb",
        "1000",
        "--out",
        "pruned",
    ];
    for made in [
        crop("part", 4),
        export("keyframes"),
        export("ply"),
        json(path, &prune, 4),
    ] {
        assert_eq!(made["verdict"], "fail", "{made}");
        let found = &made["findings"][0];
        assert_eq!(found["code"], "failed-map", "{made}");
        let what = found["what"].as_str().expect("words");
        assert!(what.contains("axes are exchanged"), "{made}");
    }
}

#[test]
fn a_recording_that_is_cut_off_is_used_as_far_as_it_goes() {
    let folder = with(&[]);
    let whole = std::fs::read(inputs().join("scan.mcap")).expect("recording");
    std::fs::write(
        folder.path().join("cut.mcap"),
        &whole[..whole.len() * 6 / 10],
    )
    .expect("file");
    let before = contents(folder.path());
    let output = lsfb(folder.path(), &["odometry", "cut.mcap", "--out", "cut.tum"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(3), "{text}");
    assert!(
        text.lines()
            .any(|line| line.starts_with("warning: cut.mcap: ")),
        "{text}"
    );
    let found = read_tum(&folder.path().join("cut.tum")).expect("trajectory");
    let [first, .., last] = found.poses() else {
        panic!("no poses")
    };
    let secs = last.time.secs_since(first.time);
    assert!((2.0..3.5).contains(&secs), "{secs}");
    let cut = &folder.path().join("cut.mcap");
    assert_eq!(contents(folder.path()).get(cut), before.get(cut));
}

#[test]
fn damaged_captures() {
    let folder = with(&["scan.mcap"]);
    let path = folder.path();
    let whole = pcap(0..600);
    std::fs::write(path.join("whole.pcap"), &whole).expect("file");
    assert_eq!(
        json(
            path,
            &["scan", "--pcap", "whole.pcap", "--out", "whole.mcap"],
            0
        )["lost"],
        0
    );
    std::fs::write(path.join("cut.pcap"), &whole[..whole.len() * 6 / 10]).expect("file");
    let report = json(
        path,
        &["scan", "--pcap", "cut.pcap", "--out", "cut.mcap"],
        3,
    );
    let ending = report["streams"][0]["ending"].to_string();
    assert!(
        ending.contains("cut.pcap") && ending.contains("truncated"),
        "{report}"
    );
    let recorded = Recording::open(&path.join("cut.mcap")).expect("recording");
    assert_eq!(
        recorded.packets("lidar/packets").expect("packets").count(),
        359
    );

    std::fs::write(path.join("noise.pcap"), noise(10_000)).expect("file");
    std::fs::write(path.join("empty.pcap"), "").expect("file");
    for name in ["noise.pcap", "empty.pcap", "missing.pcap"] {
        refused(
            path,
            &["scan", "--pcap", name, "--out", "scan.mcap"],
            &[name],
        );
    }
    std::fs::write(path.join("noise.db3"), noise(10_000)).expect("file");
    std::fs::write(path.join("cut.db3"), b"SQLite format 3\0\x10\0\x01\x01").expect("file");
    std::fs::write(path.join("empty.db3"), "").expect("file");
    for name in ["noise.db3", "cut.db3", "empty.db3", "missing.db3"] {
        refused(
            path,
            &["scan", "--db3", name, "--out", "scan.mcap"],
            &[name],
        );
    }
}

#[test]
fn empty_folders() {
    let folder = with(&["walk.mcap", "map", "scan.tum"]);
    let path = folder.path();
    std::fs::create_dir(path.join("nothing")).expect("folder");
    let here = &["nothing"];
    refused(
        path,
        &[
            "groundtruth",
            "walk.mcap",
            "--map",
            "nothing",
            "--out",
            "scan.tum",
        ],
        &["nothing", "no map here"],
    );
    refused(
        path,
        &["localize", "--posed-images", "nothing", "--map", "map"],
        here,
    );
    refused(
        path,
        &["map", "--posed-images", "nothing", "--out", "map"],
        here,
    );
    refused(
        path,
        &["odometry", "nothing", "--out", "scan.tum"],
        &["nothing", ".pcd"],
    );
}

/// What is done to a session's folder before the command runs.
type Damage<'a> = &'a dyn Fn(&Path);

#[test]
fn maps_that_cannot_be_used() {
    let header = |folder: &Path| folder.join("map/map.toml");
    let rewrite = |folder: &Path, from: &str, to: &str| {
        let text = std::fs::read_to_string(header(folder)).expect("header");
        assert!(text.contains(from));
        std::fs::write(header(folder), text.replace(from, to)).expect("header");
    };
    let damages: [(Damage<'_>, &[&str]); 5] = [
        (
            &|f| rewrite(f, "format_version = 4", "format_version = 5"),
            &["map/map.toml", "version 5", "reads 2 to 4", "map again"],
        ),
        (
            &|f| std::fs::write(header(f), noise(500)).expect("header"),
            &["map/map.toml"],
        ),
        (
            &|f| rewrite(f, "points = ", "dots = "),
            &["map/map.toml", "dots"],
        ),
        (
            &|f| {
                let table = f.join("map/points.arrow");
                let bytes = std::fs::read(&table).expect("table");
                std::fs::write(&table, &bytes[..bytes.len() / 2]).expect("table");
            },
            &["map/points.arrow", "map again"],
        ),
        (
            &|f| std::fs::remove_file(f.join("map/index_lists.arrow")).expect("table"),
            &["map/index_lists.arrow"],
        ),
    ];
    for (damage, words) in damages {
        let folder = with(&["walk.mcap", "map", "scan.tum"]);
        damage(folder.path());
        refused(
            folder.path(),
            &[
                "groundtruth",
                "walk.mcap",
                "--map",
                "map",
                "--out",
                "scan.tum",
            ],
            words,
        );
    }
}

#[test]
fn sensors_that_are_not_there() {
    let folder = with(&[
        "no-imu.mcap",
        "no-cam2.mcap",
        "no-lidar.mcap",
        "no-rig.mcap",
        "walk-no-imu.mcap",
        "walk.mcap",
        "map",
    ]);
    let path = folder.path();
    for (name, word) in [("no-imu.mcap", "no_imu"), ("no-cam2.mcap", "cam2")] {
        let report = json(path, &["map", name, "--out", &format!("map-of-{name}")], 0);
        let warnings = [
            &report["report"]["odometry"]["warnings"],
            &report["report"]["warnings"],
        ];
        assert!(
            warnings.iter().any(|w| w.to_string().contains(word)),
            "{report}"
        );
        assert!(report["points"].as_u64() > Some(100), "{report}");
    }
    refused(
        path,
        &["map", "no-lidar.mcap", "--out", "map"],
        &["no-lidar.mcap", "lidar"],
    );
    refused(
        path,
        &["map", "walk.mcap", "--out", "map"],
        &["walk.mcap", "LiDAR"],
    );
    refused(
        path,
        &["map", "no-rig.mcap", "--out", "map"],
        &["no-rig.mcap", "rig"],
    );
    found_unfit(
        path,
        &[
            "groundtruth",
            "walk-no-imu.mcap",
            "--map",
            "map",
            "--out",
            "walk.tum",
        ],
        &["walk-no-imu.mcap", "imu"],
    );
}

#[test]
fn a_walk_that_never_sees_the_map() {
    let folder = with(&["elsewhere.mcap", "map", "scan.tum"]);
    let arguments = [
        "groundtruth",
        "elsewhere.mcap",
        "--map",
        "map",
        "--out",
        "scan.tum",
        "--out-report",
        "walk.html",
    ];
    let words = ["elsewhere.mcap", "check that it is the map of this place"];
    let found = found_unfit(folder.path(), &arguments, &words);
    assert_eq!(found["code"], "localized", "{found}");
    assert_eq!(found["where"], "elsewhere.mcap", "{found}");
    let least = found["limit"]["at_least"].as_f64().expect("a limit");
    assert!(
        found["value"].as_f64().expect("a number") < least,
        "{found}"
    );
    assert!(
        !folder.path().join("walk.html").exists(),
        "no page of nothing"
    );
}

#[test]
fn a_walk_is_not_solved_together_with_itself() {
    let folder = with(&["walk.mcap", "map", "scan.tum"]);
    let line = "groundtruth walk.mcap --with ./walk.mcap --map map --out scan.tum";
    let arguments: Vec<&str> = line.split(' ').collect();
    let words = ["./walk.mcap", "--with takes other walks"];
    badly_asked(folder.path(), &arguments, &words);
    // Nor with a copy of itself.
    let copy = folder.path().join("glasses.mcap");
    std::fs::copy(folder.path().join("walk.mcap"), copy).expect("a copy");
    let line = "groundtruth walk.mcap --with glasses.mcap --map map --out scan.tum";
    let arguments: Vec<&str> = line.split(' ').collect();
    let words = [
        "glasses.mcap",
        "--with takes other walks",
        "this is walk.mcap",
    ];
    badly_asked(folder.path(), &arguments, &words);
}

#[test]
fn places_that_cannot_be_written() {
    let folder = with(&["scan.mcap", "scan.tum"]);
    let path = folder.path();
    std::fs::write(path.join("whole.pcap"), pcap(0..300)).expect("file");
    // Permissions do not stop root; a file where a folder should be stops everybody.
    refused(
        path,
        &["odometry", "scan.mcap", "--out", "scan.tum/new.tum"],
        &["scan.tum"],
    );
    refused(
        path,
        &["map", "scan.mcap", "--out", "scan.tum/map"],
        &["scan.tum"],
    );
    refused(
        path,
        &["scan", "--pcap", "whole.pcap", "--out", "scan.tum/new.mcap"],
        &["scan.tum"],
    );
    refused(path, &["sim", "--out", "scan.tum/sim"], &["scan.tum"]);
    refused(path, &["demo", "--out", "scan.tum/demo"], &["scan.tum"]);
    let report = [
        "eval",
        "scan.tum",
        "--truth",
        "scan.tum",
        "--out",
        "scan.tum/report.html",
    ];
    refused(path, &report, &["scan.tum"]);
}

#[test]
fn files_that_are_not_there() {
    let folder = with(&["scan.mcap", "map"]);
    let path = folder.path();
    for (arguments, remedy) in [
        (&["map", "no.mcap", "--out", "m"][..], "`lsfb scan`"),
        (&["odometry", "no.mcap", "--out", "t.tum"], "`lsfb scan`"),
        (
            &["groundtruth", "scan.mcap", "--map", "no", "--out", "t.tum"],
            "`lsfb map`",
        ),
        (
            &["map", "scan.mcap", "--out", "m", "--config", "no.toml"],
            "the defaults",
        ),
        (
            &["localize", "--posed-images", "no", "--map", "map"],
            "posed images",
        ),
    ] {
        refused(path, arguments, &["no such file or folder", remedy]);
    }
}

/// Naively the rig was not looked at: the folder's own intrinsics counted.
#[test]
fn posed_images_bring_their_own_rig() {
    let folder = tempfile::tempdir().expect("folder");
    let posed = ["localize", "--posed-images", "office", "--map", "map"];
    let output = lsfb(folder.path(), &[&posed[..], &["--rig", "a.toml"]].concat());
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("cannot be used with"), "{said}");
}

#[test]
fn settings_that_mean_nothing() {
    let folder = with(&["scan.mcap", "walk.mcap", "map", "scan.tum"]);
    let path = folder.path();
    std::fs::write(path.join("wheels.toml"), "\nwheels = 4\n").expect("file");
    std::fs::write(path.join("broken.toml"), "\nx = [").expect("file");
    std::fs::write(path.join("rigless.toml"), "rig = \"rig.toml\"\n[lidar]\n").expect("file");
    let words: [(&str, &[&str]); 3] = [
        ("wheels.toml", &["wheels.toml", "line 2", "`wheels`"]),
        ("broken.toml", &["broken.toml", "line 2", "unclosed"]),
        ("missing.toml", &["missing.toml", "no such file"]),
    ];
    for (name, words) in words {
        refused(
            path,
            &[
                "odometry",
                "scan.mcap",
                "--config",
                name,
                "--out",
                "scan.tum",
            ],
            words,
        );
        refused(
            path,
            &["map", "scan.mcap", "--config", name, "--out", "map"],
            words,
        );
        refused(
            path,
            &[
                "groundtruth",
                "walk.mcap",
                "--config",
                name,
                "--map",
                "map",
                "--out",
                "scan.tum",
            ],
            words,
        );
        refused(path, &["sim", "--config", name, "--out", "sim"], words);
        refused(path, &["demo", "--config", name, "--out", "demo"], words);
        refused(
            path,
            &["scan", "--devices", name, "--out", "scan.mcap"],
            words,
        );
    }
    refused(
        path,
        &["scan", "--devices", "rigless.toml", "--out", "scan.mcap"],
        &["rig.toml"],
    );
    assert!(!path.join("sim").exists() && !path.join("demo").exists());
}

#[test]
fn trajectories_that_cannot_be_compared() {
    let folder = with(&["scan.tum"]);
    let path = folder.path();
    let later: String = (0..20)
        .map(|n| format!("{n} {n} {} 0 0 0 0 1\n", n * n))
        .collect();
    for (name, text, words) in [
        (
            "columns.tum",
            "1 2 3\n",
            &["columns.tum", "line 1", "expected 8"][..],
        ),
        ("empty.tum", "", &["empty.tum", "no pose"]),
    ] {
        std::fs::write(path.join(name), text).expect("file");
        refused(path, &["eval", name, "--truth", "scan.tum"], words);
    }
    std::fs::write(path.join("later.tum"), later).expect("file");
    let arguments = ["eval", "later.tum", "--truth", "scan.tum"];
    let found = found_unfit(path, &arguments, &["later.tum", "same clock"]);
    assert_eq!(found["code"], "no-match", "{found}");
    refused(
        path,
        &["eval", "missing.tum", "--truth", "scan.tum"],
        &["missing.tum"],
    );
}

/// They ended as what could not be done, or as a check that failed; now as any bad argument, before anything is read.
#[test]
fn values_that_an_option_cannot_have() {
    let folder = with(&["scan.mcap", "walk.mcap", "map", "scan.tum"]);
    let path = folder.path();
    std::fs::write(path.join("floor.survey"), "point A 0 0 0\n").expect("survey");
    for (line, words) in [
        (
            "eval scan.tum --truth scan.tum --rpe-delta 0",
            "--rpe-delta is 0: it must be more than 0",
        ),
        (
            "eval scan.tum --truth scan.tum --rpe-delta 1.5 --rpe-unit frames",
            "--rpe-delta is 1.5: it must be a whole number of frames",
        ),
        (
            "eval scan.tum --truth scan.tum --max-difference-secs=-1",
            "--max-difference-secs is -1: it must be 0 or more",
        ),
        (
            "align scan.tum --reference scan.tum --search-secs 9999",
            "--search-secs is 9999: it must be 0 to 3600",
        ),
        (
            "align scan.tum --reference scan.tum --offset-secs nan",
            "--offset-secs is NaN",
        ),
        (
            "bench radio a.csv b.csv --neighbours 0",
            "--neighbours is 0: it must be",
        ),
        (
            "dataset radio walk.mcap --out r.csv --place-sigma-m=-1",
            "--place-sigma-m is -1: it must be",
        ),
        (
            "clock scan.mcap --window-secs=0",
            "--window-secs is 0: it must be 1 or more",
        ),
        (
            "survey check floor.survey --reach-m=-1",
            "--reach-m is -1: it must be more than 0",
        ),
        (
            "survey check floor.survey --rest-spread-m=0",
            "--rest-spread-m is 0: it must be more than 0",
        ),
        (
            "map crop map --min-m=1,1,1 --max-m 2,0,2 --out part",
            "--max-m is 2,0,2: it must be the smallest coordinates or more",
        ),
        ("localize map", "give one map and one walk"),
        (
            "localize map walk.mcap --every 2",
            "--rig and --every are for folders",
        ),
        (
            "vio walk.mcap --camera nope --out v.tum",
            "--camera nope: rig",
        ),
    ] {
        let arguments: Vec<&str> = line.split(' ').collect();
        badly_asked(path, &arguments, &[words]);
    }
}

#[test]
fn arguments_that_do_not_fit() {
    let folder = TempDir::new_in(env!("CARGO_TARGET_TMPDIR")).expect("folder");
    for arguments in [
        &["scan", "--out", "x.mcap"][..],
        &["scan", "--pcap", "a", "--db3", "b", "--out", "x.mcap"],
        &["map", "--out", "map"],
        &["map", "x.mcap", "--threads", "many", "--out", "map"],
        &["fly"],
    ] {
        let output = lsfb(folder.path(), arguments);
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{text}");
        assert_eq!(
            text.lines()
                .filter(|line| line.starts_with("error: "))
                .count(),
            1,
            "{text}"
        );
    }
    assert!(contents(folder.path()).is_empty());
}
