//! What the tests of several crates share: where the workspace is, where recordings made by others and built examples are, who could
//! not run, packets of a LiDAR, a disk that is full.

pub mod fake_kernel;
mod limited_files;
pub mod velodyne;

use std::ffi::OsString;
use std::io::Write as _;
use std::path::{Path, PathBuf};

pub use limited_files::{limited_folder, run_with_limited_files};

/// The workspace's root.
pub fn workspace_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Rust files below a folder, without what was built.
pub fn rust_files(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut files = Vec::new();
    for path in entries.map(|entry| entry.path()) {
        if path.is_dir() && !path.ends_with("target") {
            files.extend(rust_files(&path));
        } else if path.extension().is_some_and(|e| e == "rs") {
            files.push(path);
        }
    }
    files
}

/// Why a test could not run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lacks {
    /// The recordings made by others: `.ci/run` fails where they are on the machine.
    Recording,
    /// Published weights that are handed out beside the recordings: likewise.
    Weights,
    /// A program or a kernel that not every machine has.
    Program,
}

/// Says that a test is skipped: a line on the screen, and one in the file named by `LSFB_SKIPPED_TESTS`, by which `.ci/run` lists
/// them at its end. A test that returns early without this call is a fault.
#[allow(
    clippy::print_stdout,
    reason = "the one line a skipped test owes its reader"
)]
pub fn skip(test: &str, lacks: Lacks, why: &str) {
    println!("skipped: {test}: {why}");
    if let Some(list) = std::env::var_os("LSFB_SKIPPED_TESTS") {
        let list = Path::new(&list);
        append(list, test, lacks, why)
            .unwrap_or_else(|error| panic!("{}: {error}", list.display()));
    }
}

fn append(list: &Path, test: &str, lacks: Lacks, why: &str) -> std::io::Result<()> {
    let kind = match lacks {
        Lacks::Recording => "recording",
        Lacks::Weights => "weights",
        Lacks::Program => "program",
    };
    let mut file = std::fs::File::options()
        .append(true)
        .create(true)
        .open(list)?;
    // One write per line, so that lines of tests that run side by side do not mix.
    file.write_all(format!("{kind}\t{test}: {why}\n").as_bytes())
}

/// A file or folder below the recordings made by others (`LSFB_TEST_DATA`, default `../shared/data`), by its absolute path: commands
/// run in folders of their own. `None`, and the test is [skipped](skip), where it is absent.
pub fn recordings(test: &str, below: &str) -> Option<PathBuf> {
    let root = std::env::var_os("LSFB_TEST_DATA")
        .map_or_else(|| workspace_root().join("../shared/data"), PathBuf::from);
    let path = root.join(below);
    if let Ok(there) = path.canonicalize() {
        return Some(there);
    }
    let why = format!("no recording at {}", path.display());
    skip(test, Lacks::Recording, &why);
    None
}

/// Published weights that are handed out with the recordings made by others; of the rest whoever has them sets `LSFB_TEST_MODELS`.
const HANDED_OUT: [&str; 6] = [
    "xfeat.safetensors",
    "xfeat.onnx",
    "alike-t.safetensors",
    "alike-t.onnx",
    "aliked-t16_gs.onnx",
    "superpoint_arch_random.onnx",
];

/// A file of the published weights of learned features (`LSFB_TEST_MODELS`, default `models` beside the recordings made by others).
/// `None`, and the test is [skipped](skip), where it is absent.
pub fn published_weights(test: &str, file: &str) -> Option<PathBuf> {
    let folder = std::env::var_os("LSFB_TEST_MODELS").map(PathBuf::from);
    let folder = folder.unwrap_or_else(|| {
        let data = std::env::var_os("LSFB_TEST_DATA").map(PathBuf::from);
        let data = data.unwrap_or_else(|| workspace_root().join("../shared/data"));
        data.join("../models")
    });
    let path = folder.join(file);
    if path.exists() {
        return Some(path);
    }
    let lacks = match HANDED_OUT.contains(&file) {
        true => Lacks::Weights,
        false => Lacks::Program,
    };
    skip(test, lacks, &format!("no weights at {}", path.display()));
    None
}

/// The Python with which recordings are opened by programs of others, named by `LSFB_FOREIGN_PYTHON`. `None`, and the test is
/// [skipped](skip), where there is none.
pub fn foreign_python(test: &str) -> Option<OsString> {
    let python = std::env::var_os("LSFB_FOREIGN_PYTHON");
    if python.is_none() {
        skip(test, Lacks::Program, "LSFB_FOREIGN_PYTHON names no python");
    }
    python
}

/// The built example of that name, beside the test that runs it: `cargo test` without a filter builds both. `None`, and the test is
/// [skipped](skip), where only tests were built.
pub fn example(test: &str, name: &str) -> Option<PathBuf> {
    let program = std::env::current_exe().ok();
    let target = program.as_deref().and_then(|path| path.parent()?.parent());
    let path = target.map(|folder| folder.join("examples").join(name));
    let built = path.filter(|path| path.is_file());
    if built.is_none() {
        let why = format!("the example {name} is not built: add --examples");
        skip(test, Lacks::Program, &why);
    }
    built
}

#[test]
fn each_skipped_test_is_a_line_of_the_list() {
    let list = std::env::temp_dir().join(format!("lsfb-skipped-{}", std::process::id()));
    append(&list, "a", Lacks::Recording, "no recording at x").expect("written");
    append(&list, "b", Lacks::Program, "no Chromium").expect("written");
    append(&list, "c", Lacks::Weights, "no weights at y").expect("written");
    let text = std::fs::read_to_string(&list).expect("read");
    std::fs::remove_file(&list).expect("removed");
    assert_eq!(
        text,
        "recording\ta: no recording at x\nprogram\tb: no Chromium\nweights\tc: no weights at y\n"
    );
}
