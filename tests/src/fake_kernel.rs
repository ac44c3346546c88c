//! The library that programs are run above.

use std::path::PathBuf;
use std::process::Command;

use serde_json::Value;

use crate::{Lacks, skip, workspace_root};

/// Builds the emulated kernel, in a folder of its own: tests would wait for whatever else is being built.
pub fn library() -> PathBuf {
    let output = Command::new(env!("CARGO"))
        .args(["build", "--release", "--offline", "-p", "lsfb-fakekernel"])
        .arg("--message-format=json")
        .arg("--target-dir")
        .arg(workspace_root().join("target/fakekernel"))
        .current_dir(workspace_root())
        .output()
        .expect("cargo runs");
    let messages = String::from_utf8_lossy(&output.stdout);
    let failed = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{failed}");
    let file = messages
        .lines()
        .filter_map(|line| serde_json::from_str::<Value>(line).ok())
        .filter(|message| message["target"]["name"] == "lsfb_fakekernel")
        .find_map(|message| message["filenames"][0].as_str().map(PathBuf::from));
    file.expect("a library")
}

/// Whether the emulated kernel can be loaded here; says why not.
pub fn is_possible(name: &str) -> bool {
    let possible = cfg!(target_arch = "x86_64");
    if !possible {
        skip(name, Lacks::Program, "the emulated kernel is for x86_64");
    }
    possible
}
