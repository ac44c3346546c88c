//! What the built binary prints for machines.

use std::path::Path;

use serde_json::Value;

use crate::process::lsfb;

/// Runs a command that must end with `code`, and takes its JSON.
pub fn json(folder: &Path, arguments: &[&str], code: i32) -> Value {
    let output = lsfb(folder, &[arguments, &["--json"]].concat());
    assert_eq!(
        output.status.code(),
        Some(code),
        "{arguments:?}: {}",
        String::from_utf8_lossy(&output.stderr)
    );
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}
