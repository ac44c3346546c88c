//! `lsfb demo` twice and its stages once more, on a walk short enough for a test.

mod answer;
mod process;

use std::collections::BTreeMap;
use std::path::Path;

use answer::json;

/// The demo but for its length.
const SHORT: &str = "[scan]\nduration_s = 14.0\n[glasses]\nduration_s = 6.0\nheight_m = 1.62\n";

/// What must not depend on the run: both trajectories and every file of the map.
fn results(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let map = std::fs::read_dir(folder.join("map")).expect("map");
    let mut names: Vec<String> = map
        .map(|entry| format!("map/{}", entry.expect("file").file_name().to_string_lossy()))
        .collect();
    assert!(names.len() >= 8, "{names:?}");
    names.extend(["scan.tum", "walk.tum"].map(str::to_owned));
    let read = |name: String| {
        let bytes = std::fs::read(folder.join(&name)).expect("result");
        (name, bytes)
    };
    names.into_iter().map(read).collect()
}

/// Like `assert_eq!`, without printing megabytes.
fn assert_same(left: &BTreeMap<String, Vec<u8>>, right: &BTreeMap<String, Vec<u8>>) {
    assert!(left.keys().eq(right.keys()));
    let differing: Vec<_> = left
        .iter()
        .filter(|(name, bytes)| right[*name] != **bytes)
        .map(|(name, _)| name)
        .collect();
    assert!(differing.is_empty(), "{differing:?} differ");
}

#[test]
fn the_same_seed_gives_the_same_bytes_and_no_stage_needs_the_truth() {
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    std::fs::write(root.join("short.toml"), SHORT).expect("settings");
    let demo = ["demo", "--seed", "1", "--sim-config", "short.toml", "--out"];
    let one = json(root, &[&demo[..], &["one", "--threads", "1"]].concat(), 0);
    let many = json(root, &[&demo[..], &["many"]].concat(), 0);
    for run in [&one, &many] {
        let figure = |name: &str| run[name].as_f64().expect("figure");
        assert!(figure("ate_glasses_rms_m") <= 0.03, "{run}");
        assert!(figure("ate_scanner_rms_m") <= 0.03, "{run}");
        assert!(figure("map_reprojection_px") <= 1.5, "{run}");
        assert_eq!(run["lost"], 0, "{run}");
    }
    let expected = results(&root.join("one"));
    assert_same(&expected, &results(&root.join("many")));

    // The stages as subcommands, where there are recordings and nothing else.
    let alone = root.join("alone");
    std::fs::create_dir(&alone).expect("folder");
    for name in ["scan.mcap", "walk.mcap"] {
        std::fs::rename(root.join("many").join(name), alone.join(name)).expect("recording");
    }
    std::fs::remove_dir_all(root.join("one")).expect("folder");
    std::fs::remove_dir_all(root.join("many")).expect("folder");
    json(
        &alone,
        &[
            "map",
            "scan.mcap",
            "--out",
            "map",
            "--trajectory",
            "scan.tum",
        ],
        0,
    );
    json(
        &alone,
        &[
            "groundtruth",
            "walk.mcap",
            "--map",
            "map",
            "--out",
            "walk.tum",
        ],
        0,
    );
    assert_same(&expected, &results(&alone));
}
