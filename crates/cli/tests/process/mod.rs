//! Runs the built binary.

use std::path::Path;
use std::process::{Command, Output};

/// Runs `lsfb` in `folder` to its end.
pub fn lsfb(folder: &Path, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_lsfb"))
        .args(arguments)
        .current_dir(folder)
        .env_remove("LSFB_LOG")
        .output()
        .expect("the built binary")
}
