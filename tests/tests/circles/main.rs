//! Inside each crate: modules that lie side by side never use each other in a circle (ARCHITECTURE.md, "Layers").

#![allow(
    clippy::unwrap_used,
    reason = "a test file as a whole; clippy.toml only spares #[test] functions"
)]

mod graph;
mod modules;
mod tokens;

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use graph::Circle;
use lsfb_tests::workspace_root;
use modules::Modules;
use tokens::tokens;

/// Circles that are still to be cut: crate, parent, the modules. None is added.
const KNOWN: &[(&str, &str, &[&str])] = &[];

/// Name and root file of every library and program of ours.
fn crates() -> Vec<(String, PathBuf)> {
    let root = workspace_root();
    let below = |folder: &Path| {
        let entries = std::fs::read_dir(folder).unwrap();
        entries.map(|e| e.unwrap().path()).collect::<Vec<_>>()
    };
    let mut found = Vec::new();
    let folders = ["", "crates", "tests"].map(|within| below(&root.join(within)));
    for folder in folders.into_iter().flatten() {
        let roots = ["lib.rs", "main.rs"].map(|file| folder.join("src").join(file));
        for file in roots.into_iter().filter(|file| file.exists()) {
            let name = folder.file_name().unwrap().to_string_lossy().into_owned();
            found.push((name, file));
        }
    }
    found.sort();
    assert!(found.len() >= 22, "crates are missing: {found:?}");
    found
}

fn describe(name: &str, circle: &Circle) -> String {
    let mut text = format!("{name}, below {}: {:?}\n", circle.parent, circle.members);
    for ((from, to), found) in &circle.uses {
        let _ = writeln!(
            text,
            "    {from} -> {to}: {} x, {}",
            found.count, found.example
        );
    }
    text
}

#[test]
fn modules_use_each_other_in_one_direction() {
    let mut known: Vec<_> = KNOWN.to_vec();
    let mut new = String::new();
    for (name, file) in crates() {
        for circle in Modules::read(&file).circles() {
            let here = known.iter().position(|(crate_name, parent, members)| {
                *crate_name == name
                    && *parent == circle.parent
                    && circle.members.iter().all(|m| members.contains(&m.as_str()))
            });
            match here {
                Some(at) => drop(known.remove(at)),
                None => new.push_str(&describe(&name, &circle)),
            }
        }
    }
    assert!(new.is_empty(), "circles between modules:\n{new}");
    assert!(
        known.is_empty(),
        "no circle any more, strike them out: {known:?}"
    );
}

/// Every source file of ours.
fn sources() -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![workspace_root()];
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).unwrap() {
            let path = entry.unwrap().path();
            let name = path.file_name().unwrap().to_string_lossy().into_owned();
            if path.is_dir() && name != "target" && !name.starts_with('.') {
                open.push(path);
            } else if name.ends_with(".rs") {
                found.push(path);
            }
        }
    }
    found
}

#[test]
fn no_module_is_taken_from_another_place() {
    for path in sources() {
        let found = tokens(&std::fs::read_to_string(&path).unwrap());
        let attribute = found
            .windows(4)
            .find(|w| w[0].is('#') && w[1].is('[') && w[2].is_word("path") && w[3].is('='));
        assert!(attribute.is_none(), "{}: no #[path]", path.display());
    }
}

/// A test that looks for them by itself is skipped without anybody being told.
#[test]
fn recordings_of_others_are_found_by_one_helper() {
    let asks = concat!("\"LSFB", "_TEST_DATA\"");
    let who: Vec<_> = sources()
        .into_iter()
        .filter(|path| std::fs::read_to_string(path).unwrap().contains(asks))
        .filter(|path| !path.ends_with("tests/src/lib.rs"))
        .collect();
    assert!(who.is_empty(), "use lsfb_tests::recordings: {who:?}");
}

/// A crate in memory: each pair a top-level module and its body.
fn in_memory(root: &str, bodies: &[(&str, &str)]) -> Vec<Circle> {
    let mut text = root.to_owned();
    for (name, body) in bodies {
        let _ = writeln!(text, "mod {name} {{ {body} }}");
    }
    let mut modules = Modules::default();
    modules.add("crate", None, Path::new("memory.rs"), &tokens(&text));
    modules.circles()
}

fn members(circles: &[Circle]) -> Vec<Vec<&str>> {
    circles
        .iter()
        .map(|c| c.members.iter().map(String::as_str).collect())
        .collect()
}

#[test]
fn a_circle_is_found_by_each_way_of_naming_it() {
    let one = "pub struct One; ";
    for (root, back) in [
        ("", "use crate::one::One;"),
        ("", "use super::one::One;"),
        ("", "fn f() { let _ = crate::one::One; }"),
        ("", "use crate::{three, one::{self, One}};"),
        ("", "use super::one as first; fn f() { first::One; }"),
        ("", "mod deep { use super::super::one::One; }"),
        ("", "#[serde(with = \"crate::one::One\")] struct X;"),
        ("", "macro_rules! m { () => { $crate::one::One } }"),
        // the root hides where it comes from
        ("pub use one::One; ", "use crate::One;"),
        ("pub use one::*; ", "use crate::One;"),
        ("pub use one::One as Uno; ", "fn f(x: super::Uno) {}"),
        ("use one::One; ", "use super::*; fn f(x: One) {}"),
    ] {
        let forth = format!("{one} use crate::two::Two;");
        let two = format!("pub struct Two; {back}");
        let found = in_memory(root, &[("one", &forth), ("two", &two), ("three", "")]);
        assert_eq!(members(&found), [["one", "two"]], "{root} {back}");
    }
}

#[test]
fn three_modules_in_a_circle_are_one_circle() {
    let found = in_memory(
        "",
        &[
            ("a", "use crate::b::B; pub struct A;"),
            ("b", "use crate::c::C; pub struct B;"),
            ("c", "pub mod d { use crate::a::A; } pub struct C;"),
            ("e", "use crate::a::A;"),
        ],
    );
    assert_eq!(members(&found), [["a", "b", "c"]]);
}

#[test]
fn parents_children_tests_and_other_crates_make_no_circle() {
    let found = in_memory(
        "pub use a::A; pub struct Root; fn f() { b::g(); }",
        &[
            (
                "a",
                "use crate::Root; pub struct A; use super::b::B; // crate::c::C",
            ),
            (
                "b",
                "use crate::Root; pub struct B; pub fn g() {} #[cfg(test)] mod tests { use crate::A; }",
            ),
            (
                "c",
                "use std::b::B; #[cfg(test)] use crate::a::A; #[test] fn t() { crate::a::A; } pub struct C;",
            ),
        ],
    );
    assert!(found.is_empty(), "{found:?}");
}
