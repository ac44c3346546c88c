//! Who may use whom (ARCHITECTURE.md, "Layers"): an edge that the table does not have fails here.

use std::collections::BTreeMap;
use std::process::Command;

use lsfb_tests::workspace_root;
use serde_json::Value;

/// Crate → what it may use. `lsfb-cli` and `lsfb-tests` may use everything.
const ALLOWED: &[(&str, &[&str])] = &[
    ("lsfb-types", &[]),
    ("lsfb-geometry", &["types"]),
    ("lsfb-drivers", &["types"]),
    ("lsfb-solver", &["types", "geometry"]),
    ("lsfb-recording", &["types", "geometry"]),
    (
        "lsfb-capture",
        &["types", "geometry", "drivers", "recording", "web"],
    ),
    ("lsfb-web", &[]),
    ("lsfb-perception", &["types", "geometry", "solver"]),
    ("lsfb-report", &["types"]),
    ("lsfb-networks", &["types"]),
    (
        "lsfb-datasets",
        &["types", "geometry", "recording", "perception"],
    ),
    (
        "lsfb-calib",
        &[
            "types",
            "geometry",
            "solver",
            "recording",
            "perception",
            "datasets",
            "report",
        ],
    ),
    (
        "lsfb-pipeline",
        &[
            "types",
            "geometry",
            "solver",
            "recording",
            "perception",
            "networks",
        ],
    ),
    (
        "lsfb-eval",
        &["types", "geometry", "solver", "recording", "report"],
    ),
    ("lsfb-view", &["types", "geometry", "recording"]),
    ("lsfb-operator", &["types", "geometry", "recording", "web"]),
    ("lsfb-sim", &["types", "geometry", "drivers", "recording"]),
    ("lsfb-fakekernel", &[]),
    ("lsfb-problems", &["geometry", "solver"]),
    (
        "lsfb-rigs",
        &["types", "geometry", "recording", "calib", "sim"],
    ),
];

/// Package → the names it depends on, dev-dependencies left out.
fn dependencies() -> BTreeMap<String, Vec<String>> {
    let output = Command::new(env!("CARGO"))
        .args([
            "metadata",
            "--no-deps",
            "--format-version",
            "1",
            "--offline",
        ])
        .current_dir(workspace_root())
        .output()
        .expect("cargo runs");
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let metadata: Value = serde_json::from_slice(&output.stdout).expect("cargo metadata is JSON");
    let packages = metadata["packages"].as_array().expect("packages");
    packages
        .iter()
        .map(|package| {
            let uses = package["dependencies"]
                .as_array()
                .expect("dependencies")
                .iter();
            let uses = uses
                .filter(|d| d["kind"].is_null())
                .filter_map(|d| d["name"].as_str());
            (
                package["name"].as_str().expect("name").to_owned(),
                uses.map(str::to_owned).collect(),
            )
        })
        .collect()
}

#[test]
fn no_crate_reaches_outside_its_layer() {
    for (name, uses) in dependencies() {
        if name == "lsfb-cli" || name == "lsfb-tests" {
            continue;
        }
        let (_, allowed) = ALLOWED
            .iter()
            .find(|(crate_name, _)| *crate_name == name)
            .unwrap_or_else(|| panic!("{name} is not in the layering table"));
        for used in uses.iter().filter_map(|u| u.strip_prefix("lsfb-")) {
            assert!(allowed.contains(&used), "{name} may not use lsfb-{used}");
        }
    }
}

#[test]
fn heavy_and_dangerous_crates_are_seen_where_they_belong() {
    let dependencies = dependencies();
    for (dependency, only) in [
        ("re_sdk", &["lsfb-view"][..]),
        ("mcap", &["lsfb-recording"]),
        ("serialport", &["lsfb-drivers"]),
        ("v4l", &["lsfb-drivers"]),
        ("socketcan", &["lsfb-drivers"]),
        ("rusb", &["lsfb-drivers"]),
        ("libc", &["lsfb-fakekernel"]),
        // Bags of packets, and bags of everything else: neither crate may use the other.
        ("rusqlite", &["lsfb-drivers", "lsfb-datasets"]),
        // Sparse systems, and the products of matrices that convolutions are.
        ("faer", &["lsfb-solver", "lsfb-networks"]),
        ("anyhow", &["lsfb-cli"]),
    ] {
        for (name, uses) in &dependencies {
            let sees = !only.contains(&name.as_str()) && uses.iter().any(|u| u == dependency);
            assert!(!sees, "only {only:?} may use {dependency}, not {name}");
        }
    }
}

#[test]
fn architecture_names_every_crate() {
    let text =
        std::fs::read_to_string(workspace_root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    for name in dependencies().keys() {
        assert!(
            text.contains(&format!("`{name}`")),
            "ARCHITECTURE.md does not mention `{name}`"
        );
    }
}
