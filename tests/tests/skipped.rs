//! A test that cannot run says so in one way (`lsfb_tests::skip`), so that `.ci/run` lists it: one that prints the line itself, or
//! returns in silence where recordings made by others are absent, fails here. So does a file of tests that no program has as a module.

use lsfb_tests::{rust_files, workspace_root};

#[test]
fn no_test_is_skipped_but_by_the_one_function_that_lists_it() {
    let root = workspace_root();
    let files = rust_files(&root);
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

/// Where the programs are listed (`autotests = false`), cargo takes no other file for one: it would lie there and never run.
#[test]
fn every_file_of_tests_is_in_a_program() {
    let mut looked_at = 0;
    let root = workspace_root();
    let crates = std::fs::read_dir(root.join("crates")).expect("crates");
    let crates = crates.map(|entry| entry.expect("crate").path());
    let others = ["calib", "capture", "drivers", "pipeline"].map(|name| root.join(name));
    for folder in crates.chain(others) {
        let manifest = std::fs::read_to_string(folder.join("Cargo.toml")).expect("manifest");
        if !manifest.contains("\nautotests = false\n") {
            continue;
        }
        let names = manifest.split("[[test]]\nname = \"").skip(1);
        let names: Vec<&str> = names.filter_map(|rest| rest.split('"').next()).collect();
        let tests = folder.join("tests");
        let program = |name: &&str| {
            std::fs::read_to_string(tests.join(format!("{name}.rs"))).expect("a program")
        };
        let modules: String = names.iter().map(program).collect();
        for entry in std::fs::read_dir(&tests).expect("tests") {
            let path = entry.expect("file").path();
            let is_module = path.join("mod.rs").exists()
                || path.extension().is_some_and(|extension| extension == "rs");
            let name = path.file_stem().and_then(|stem| stem.to_str());
            let name = name.expect("a name");
            if is_module && !names.contains(&name) {
                let line = format!("mod {name};\n");
                assert!(modules.contains(&line), "{} never runs", path.display());
                looked_at += 1;
            }
        }
    }
    assert!(looked_at > 60, "{looked_at} files were looked at");
}
