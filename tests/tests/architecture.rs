//! "Three ways through the code" of `ARCHITECTURE.md`: every place and every name in them exists.

use std::path::{Path, PathBuf};

use lsfb_tests::workspace_root;

/// A line of calls: where, and what is called there.
struct Step {
    place: String,
    names: Vec<String>,
}

/// The lines of the three blocks. Columns are two or more spaces apart.
fn steps() -> Vec<Step> {
    let text = std::fs::read_to_string(workspace_root().join("ARCHITECTURE.md")).expect("text");
    let ways = text.split("## Three ways through the code").nth(1);
    let ways = ways.and_then(|rest| rest.split("\n## ").next());
    let blocks = ways.expect("the chapter").split("```\n").skip(1).step_by(2);
    let lines = blocks.flat_map(str::lines).map(|line| {
        let mut columns = line.trim().split("  ").filter(|column| !column.is_empty());
        let mut next = || columns.next().unwrap_or_default().trim().to_owned();
        let place = next();
        let names = next().split(", ").map(str::to_owned).collect();
        Step { place, names }
    });
    lines.collect()
}

/// The file or folder of a place; those of a crate lie in its `src`.
fn path_of(place: &str) -> PathBuf {
    let (name, inside) = place.split_once('/').unwrap_or((place, ""));
    let root = workspace_root();
    let folder = [root.join(name), root.join("crates").join(name)]
        .into_iter()
        .find(|folder| folder.join("src").is_dir());
    let path = folder.unwrap_or_default().join("src").join(inside);
    match path.exists() {
        true => path,
        false => path.with_extension("rs"),
    }
}

/// Everything that is written in a file or below a folder.
fn source(path: &Path) -> String {
    if path.is_file() {
        return std::fs::read_to_string(path).expect("source");
    }
    let Ok(entries) = std::fs::read_dir(path) else {
        return String::new();
    };
    entries
        .flatten()
        .map(|entry| source(&entry.path()))
        .collect()
}

/// Whether a name is defined, as whatever.
fn defines(source: &str, name: &str) -> bool {
    let is_end = |c: char| !c.is_alphanumeric() && c != '_';
    ["fn", "struct", "enum", "mod"].iter().any(|kind| {
        let definition = format!("{kind} {name}");
        let mut found = source.match_indices(&definition);
        found.any(|(at, _)| source[at + definition.len()..].starts_with(is_end))
    })
}

#[test]
fn every_place_and_name_of_the_three_ways_exists() {
    let steps = steps();
    assert!(steps.len() > 35, "{} lines were read", steps.len());
    for Step { place, names } in steps {
        let path = path_of(&place);
        assert!(path.exists(), "{place}: {} is not there", path.display());
        let source = source(&path);
        for name in names.iter().flat_map(|name| name.split("::")) {
            assert!(defines(&source, name), "{place} has no {name}");
        }
    }
}

/// Half a name is no name: the check would otherwise pass over a function that was renamed to something longer.
#[test]
fn a_name_ends_where_it_ends() {
    let source = "pub fn push_scan(&mut self) {}\nstruct Odometry<T>;";
    assert!(defines(source, "push_scan") && defines(source, "Odometry"));
    assert!(!defines(source, "push") && !defines(source, "Odo"));
}
