//! The libraries that others can take from crates.io are whole, and nothing else can be published by mistake.

use std::path::Path;
use std::process::Command;

use lsfb_tests::workspace_root;
use serde_json::Value;

/// What is published, each behind those that it uses.
const PUBLISHED: [&str; 5] = [
    "lsfb-types",
    "lsfb-geometry",
    "lsfb-solver",
    "lsfb-recording",
    "lsfb-drivers",
];

/// What cargo prints at the root of the workspace, without a network.
fn cargo(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO"))
        .args(arguments)
        .arg("--offline")
        .current_dir(workspace_root())
        .output()
        .expect("cargo runs");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {said}");
    String::from_utf8(output.stdout).expect("text")
}

fn packages() -> Vec<Value> {
    let metadata = cargo(&["metadata", "--no-deps", "--format-version", "1"]);
    let metadata: Value = serde_json::from_str(&metadata).expect("cargo metadata is JSON");
    metadata["packages"].as_array().expect("packages").clone()
}

fn name(value: &Value) -> &str {
    value["name"].as_str().expect("a name")
}

/// `publish = false` is an empty list of registries.
#[test]
fn five_crates_can_be_published_and_no_other() {
    let packages = packages();
    let mut free: Vec<&str> = packages
        .iter()
        .filter(|package| package["publish"].is_null())
        .map(name)
        .collect();
    let mut published = PUBLISHED.to_vec();
    free.sort_unstable();
    published.sort_unstable();
    assert_eq!(free, published, "`publish = false` is missing, or too much");
}

/// What crates.io asks for and shows, and dependencies that it can resolve: of ours with a version, published before.
#[test]
fn what_is_published_says_what_it_is_and_needs_nothing_else_of_ours() {
    let packages = packages();
    for (place, published) in PUBLISHED.iter().enumerate() {
        let package = packages.iter().find(|p| name(p) == *published);
        let package = package.unwrap_or_else(|| panic!("there is no {published}"));
        for field in ["description", "license", "documentation", "readme"] {
            assert!(package[field].is_string(), "{published} has no {field}");
        }
        for field in ["keywords", "categories"] {
            let words = package[field].as_array().map_or(0, Vec::len);
            assert!((1..=5).contains(&words), "{published}: {words} {field}");
        }
        let dependencies = package["dependencies"].as_array().expect("dependencies");
        for dependency in dependencies.iter().filter(|d| d["kind"] != "dev") {
            let used = name(dependency);
            assert_ne!(dependency["req"], "*", "{published}: no version of {used}");
            let is_there = !used.starts_with("lsfb-") || PUBLISHED[..place].contains(&used);
            assert!(is_there, "{published} needs {used}, which is not published");
        }
    }
}

/// The package holds its library, what that includes, and its README.
#[test]
fn packages_hold_all_that_they_are_built_of() {
    for package in packages() {
        let published = name(&package);
        if !PUBLISHED.contains(&published) {
            continue;
        }
        let list = cargo(&["package", "--list", "--allow-dirty", "-p", published]);
        let list: Vec<&str> = list.lines().collect();
        for file in ["src/lib.rs", "README.md"] {
            assert!(list.contains(&file), "{published} lacks {file}");
        }
        let manifest = Path::new(package["manifest_path"].as_str().expect("a path"));
        let folder = manifest.parent().expect("a folder");
        // Tests are not built by whoever uses it, and may hold it against the rest of the workspace.
        let is_test = |file: &str| file.ends_with("tests.rs") || file.contains("tests/");
        let is_built = |file: &&&str| file.ends_with(".rs") && !is_test(file);
        for file in list.iter().filter(is_built) {
            let text = std::fs::read_to_string(folder.join(file)).expect("source");
            for macro_name in ["include_str!(\"", "include_bytes!(\""] {
                let named = text.split(macro_name).skip(1);
                for included in named.filter_map(|rest| rest.split('"').next()) {
                    let beside = Path::new(file).parent().expect("a folder").join(included);
                    let from_root = normal(&beside);
                    assert!(
                        list.contains(&from_root.as_str()),
                        "{published} lacks {from_root}, which {file} includes"
                    );
                }
            }
        }
    }
}

/// Whoever unpacks a package can build its examples: they use its dependencies, and of ours what is published before.
#[test]
fn examples_need_nothing_that_is_not_published() {
    let mut seen = 0;
    for package in packages().iter().filter(|p| PUBLISHED.contains(&name(p))) {
        let dependencies = package["dependencies"].as_array().expect("dependencies");
        let ours = dependencies
            .iter()
            .map(name)
            .filter(|d| d.starts_with("lsfb-"));
        let unpublished: Vec<String> = ours
            .filter(|used| !PUBLISHED.contains(used))
            .map(|used| used.replace('-', "_"))
            .collect();
        let manifest = Path::new(package["manifest_path"].as_str().expect("a path"));
        let examples = manifest.parent().expect("a folder").join("examples");
        let Ok(entries) = std::fs::read_dir(examples) else {
            continue;
        };
        for example in entries.map(|entry| entry.expect("an entry").path()) {
            // Those of several files would be looked into here too; there are none.
            assert!(example.is_file(), "{}: a folder", example.display());
            let text = std::fs::read_to_string(&example).expect("source");
            seen += 1;
            for used in &unpublished {
                assert!(!text.contains(used), "{} uses {used}", example.display());
            }
        }
    }
    assert!(seen > 5, "{seen} examples");
}

/// A path without `..`.
fn normal(path: &Path) -> String {
    let mut parts: Vec<&str> = Vec::new();
    for part in path.iter().map(|part| part.to_str().expect("text")) {
        match part {
            ".." => drop(parts.pop()),
            part => parts.push(part),
        }
    }
    parts.join("/")
}
