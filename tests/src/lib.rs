//! What the end-to-end tests share: where the workspace is, where recordings made by others are.

pub mod fake_kernel;

use std::path::{Path, PathBuf};

/// The workspace's root.
pub fn workspace_root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// A file or folder below the recordings made by others (`LSFB_TEST_DATA`, default `../shared/data`). `None`, with one
/// line saying so, where it is absent.
#[allow(
    clippy::print_stdout,
    reason = "the one line a skipped test owes its reader"
)]
pub fn recordings(test: &str, below: &str) -> Option<PathBuf> {
    let root = std::env::var_os("LSFB_TEST_DATA")
        .map_or_else(|| workspace_root().join("../shared/data"), PathBuf::from);
    let path = root.join(below);
    if path.exists() {
        return Some(path);
    }
    println!("skipped: {test}: no recording at {}", path.display());
    None
}
