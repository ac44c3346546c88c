//! A test that cannot run says so in one way (`lsfb_tests::skip`), so that `.ci/run` lists it: one that prints the line itself, or
//! returns in silence where recordings made by others are absent, fails here.

use std::path::{Path, PathBuf};

use lsfb_tests::workspace_root;

/// Rust files below a folder, without what was built.
fn sources(folder: &Path, out: &mut Vec<PathBuf>) {
    let Ok(entries) = std::fs::read_dir(folder) else {
        return;
    };
    for path in entries.flatten().map(|entry| entry.path()) {
        if path.is_dir() && !path.ends_with("target") {
            sources(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

#[test]
fn no_test_is_skipped_but_by_the_one_function_that_lists_it() {
    let root = workspace_root();
    let mut files = Vec::new();
    sources(&root, &mut files);
    assert!(files.len() > 500, "{} files were read", files.len());
    let own = [
        root.join("tests/src/lib.rs"),
        root.join("tests/tests/skipped.rs"),
    ];
    for path in files.iter().filter(|path| !own.contains(path)) {
        let text = std::fs::read_to_string(path).expect("source");
        for forbidden in [
            "\"skipped: ",
            "\"skipped, ",
            "LSFB_TEST_DATA\"",
            "LSFB_FOREIGN_PYTHON\"",
        ] {
            let place = path.display();
            assert!(!text.contains(forbidden), "{place} has {forbidden}");
        }
    }
}
