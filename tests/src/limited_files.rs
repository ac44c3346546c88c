//! A disk that takes nothing more, for one test.

use std::path::{Path, PathBuf};
use std::process::Command;

/// Names the test's folder to the process with the limit.
const FOLDER: &str = "LSFB_TEST_LIMITED_FOLDER";

/// The folder that [`run_with_limited_files`] was given, in the process where files are limited; elsewhere none.
pub fn limited_folder() -> Option<PathBuf> {
    std::env::var_os(FOLDER).map(PathBuf::from)
}

/// Runs a test of this program again in a process of its own, where a file cannot grow beyond so many kilobytes: to write more fails,
/// as on a full disk. There [`limited_folder`] is `folder`.
pub fn run_with_limited_files(test: &str, file_kb: u32, folder: &Path) {
    // POSIX counts blocks of 512 bytes; without the trap the signal would end the process.
    let limited = format!(
        "trap '' XFSZ; ulimit -f {}; exec \"$0\" \"$@\"",
        2 * file_kb
    );
    let child = Command::new("sh")
        .args(["-c", &limited])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", test])
        .env(FOLDER, folder)
        .output()
        .expect("a shell");
    let output = String::from_utf8_lossy(&child.stdout);
    assert!(
        child.status.success() && output.contains("1 passed"),
        "{output}"
    );
}
