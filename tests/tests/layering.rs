//! Who may use whom (ARCHITECTURE.md, "Layers"): an edge that the table does not have fails here. So does whoever names the module of a
//! LiDAR's vendor instead of `any_lidar`.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Command;

use lsfb_tests::{rust_files, workspace_root};
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
        &[
            "types",
            "geometry",
            "solver",
            "recording",
            "perception",
            "report",
        ],
    ),
    ("lsfb-view", &["types", "geometry", "recording"]),
    ("lsfb-operator", &["types", "geometry", "recording", "web"]),
    (
        "lsfb-sim",
        &["types", "geometry", "drivers", "recording", "perception"],
    ),
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

/// Outside its own folder, a vendor stands in these files alone (CONTRIBUTING.md).
const VENDOR_PLACES: [&str; 2] = ["drivers/src/lidar_vendors/mod.rs", "drivers/README.md"];

fn text_of(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// The modules of the list of LiDARs.
fn vendors() -> Vec<String> {
    let text = text_of(&workspace_root().join(VENDOR_PLACES[0]));
    let list = text.split("$with! {\n").nth(1);
    let lines = list.and_then(|rest| rest.split('}').next()).expect("list");
    let modules = lines
        .lines()
        .filter_map(|line| line.split_whitespace().nth(1));
    let modules = modules.map(|module| module.trim_end_matches(',').to_owned());
    modules.collect()
}

/// Whether a source names a module, in a path or to use it; tests at its end may.
fn names_module(source: &str, module: &str) -> bool {
    let code = source
        .split("#[cfg(test)]\nmod ")
        .next()
        .unwrap_or_default();
    let lines = code.lines().map(str::trim_start);
    let mut code = lines.filter(|line| !line.starts_with("//"));
    code.any(|line| {
        line.match_indices(module).any(|(at, _)| {
            let (before, after) = (&line[..at], &line[at + module.len()..]);
            let is_whole = !before.ends_with(|c: char| c.is_alphanumeric() || c == '_');
            is_whole && (after.starts_with("::") || (before.ends_with("::") && after == ";"))
        })
    })
}

#[test]
fn nobody_but_the_list_of_lidars_names_a_vendor() {
    let root = workspace_root();
    let vendors = vendors();
    assert_eq!(vendors, ["velodyne", "hesai"], "read from the list");
    let mut looked_at = 0;
    for path in rust_files(&root) {
        let path = path.strip_prefix(&root).expect("below the root");
        let is_of_tests = path.components().any(|part| {
            let part = part.as_os_str();
            ["tests", "tests.rs", "fuzz", "benches", "examples"]
                .iter()
                .any(|name| part == *name)
        });
        if is_of_tests {
            continue;
        }
        looked_at += 1;
        let source = text_of(&root.join(path));
        for vendor in &vendors {
            let is_own = path.starts_with(Path::new("drivers/src/lidar_vendors").join(vendor));
            // The simulated LiDARs are Velodyne's.
            let is_simulated = vendor == "velodyne" && path.starts_with("crates/sim");
            let is_named = names_module(&source, vendor);
            assert!(
                is_own || is_simulated || !is_named,
                "{} names {vendor}: let it use any_lidar, which takes the next vendor too",
                path.display()
            );
        }
    }
    assert!(looked_at > 500, "{looked_at} files were looked at");
    assert!(names_module(
        "use lsfb_drivers::velodyne::SensorPage;",
        "velodyne"
    ));
    assert!(names_module("use lsfb_drivers::hesai;", "hesai"));
    assert!(!names_module(
        "use any_velodyne::X;\n// velodyne::X",
        "velodyne"
    ));
}

/// What CONTRIBUTING.md says that a new vendor takes is what each of them took.
#[test]
fn a_vendor_stands_where_contributing_says() {
    let root = workspace_root();
    let contributing = text_of(&root.join("CONTRIBUTING.md"));
    for place in VENDOR_PLACES {
        assert!(contributing.contains(&format!("`{place}`")), "{place}");
        let text = text_of(&root.join(place)).to_lowercase();
        for vendor in vendors() {
            assert!(text.contains(&vendor), "{place} lacks {vendor}");
        }
    }
    for vendor in vendors() {
        let folder = root.join("drivers/src/lidar_vendors").join(&vendor);
        for part in ["wire", "model", "decode", "device", "reference", "mod"] {
            let is_there = folder.join(part).join("mod.rs").is_file()
                || folder.join(format!("{part}.rs")).is_file();
            assert!(is_there, "{vendor} has no {part}.rs");
        }
        // No build setting, fuzz target or list of devices waits for the next vendor.
        for place in [
            "drivers/Cargo.toml",
            "drivers/src/lib.rs",
            "fuzz/Cargo.toml",
            ".ci/run",
            "docs/devices.md",
            "ARCHITECTURE.md",
        ] {
            let mut text = text_of(&root.join(place)).to_lowercase();
            // An example, and packets that its vendor alone sends.
            for own in ["velodyne_decode", "velodyne_position"] {
                text = text.replace(own, "");
            }
            assert!(!text.contains(&vendor), "{place} names {vendor}");
        }
    }
}
