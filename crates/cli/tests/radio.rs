//! `lsfb dataset radio` and `lsfb bench radio` on the walks of a mall that others recorded.

use std::path::{Path, PathBuf};

use crate::answer::json;
use crate::process::lsfb;
use lsfb_tests::recordings;

/// Scans, mean, median and largest error, metres, as `benches/radio/neighbours.py` computes them from the walks' texts alone.
const EXPECTED: [(f64, f64, f64, f64); 3] = [
    (397.0, 20.894965, 11.313473, 104.969444),
    (178.0, 6.385683, 6.056773, 16.103417),
    (222.0, 7.166595, 6.552913, 24.845896),
];

#[test]
fn walks_of_a_mall_are_placed_by_their_wifi_as_a_script_has_it() {
    let test = "walks_of_a_mall_are_placed_by_their_wifi_as_a_script_has_it";
    let Some(walks) = recordings(test, "vision/indoorloc20/site1/F1/path_data_files") else {
        return;
    };
    let mut sources: Vec<PathBuf> = std::fs::read_dir(walks)
        .expect("walks")
        .map(|entry| {
            entry
                .expect("a file")
                .path()
                .canonicalize()
                .expect("a path")
        })
        .collect();
    sources.sort();
    let folder = tempfile::tempdir().expect("folder");
    let root = folder.path();
    let mut tables = Vec::new();
    for (i, source) in sources.iter().enumerate() {
        let source = source.to_str().expect("UTF-8");
        let (walk, table) = (format!("{i}.mcap"), format!("{i}.csv"));
        json(root, &["import", source, "--out", &walk], 0);
        let placed = json(root, &["dataset", "radio", &walk, "--out", &table], 0);
        assert!(placed["wifi"].as_u64() > Some(100), "{placed}");
        assert!(placed["magnetic"].as_u64() > Some(100), "{placed}");
        // Between waypoints ten seconds apart a place is known to some metres.
        let sigma_m = placed["sigma_rms_m"].as_f64().expect("σ");
        assert!((0.5..4.0).contains(&sigma_m), "{placed}");
        if i == 0 {
            places_in_centimetres_are_refused(root, &walk);
        }
        std::fs::remove_file(root.join(walk)).expect("removed");
        tables.push(table);
    }
    let mut arguments = vec!["bench", "radio"];
    arguments.extend(tables.iter().map(String::as_str));
    let found = json(root, &arguments, 0);
    assert_eq!(found["walks"], 24);
    // Half of a mall was walked once: that is said, and is no failure.
    assert_eq!(found["verdict"], "warn");
    let reaches = found["reaches"].as_array().expect("reaches");
    let figures = [
        &found["errors_m"],
        &reaches[0]["errors_m"],
        &reaches[1]["errors_m"],
    ];
    for (figures, (count, mean, median, max)) in figures.into_iter().zip(EXPECTED) {
        for (name, expected) in [
            ("count", count),
            ("mean", mean),
            ("median", median),
            ("max", max),
        ] {
            let value = figures[name].as_f64().expect(name);
            // The tables have tenths of millimetres.
            assert!(
                (value - expected).abs() < 2e-3,
                "{name}: {value} {expected}"
            );
        }
    }
    // A walk that is given twice would find itself.
    let twice = lsfb(root, &["bench", "radio", "0.csv", "1.csv", "./0.csv"]);
    assert_eq!(twice.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&twice.stderr).contains("given twice"));
}

/// A hundred metres a second.
fn places_in_centimetres_are_refused(root: &Path, walk: &str) {
    let line = |n: u32| format!("{n} {} 0 0 0 0 0 1\n", 100 * n);
    let lines: String = (0..20).map(line).collect();
    std::fs::write(root.join("centimetres.tum"), lines).expect("a trajectory");
    let command = [
        "dataset",
        "radio",
        walk,
        "--trajectory",
        "centimetres.tum",
        "--out",
        "cm.csv",
    ];
    let said = lsfb(root, &command);
    assert_eq!(said.status.code(), Some(1), "{said:?}");
    let said = String::from_utf8_lossy(&said.stderr);
    assert!(said.contains("100 m/s from one known place"), "{said}");
}
