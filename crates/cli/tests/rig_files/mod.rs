//! Rigs on disk, and how far apart poses are.

use std::path::Path;

use lsfb_geometry::{Rig, Se3};

/// Degrees and millimetres between two poses.
pub fn apart(a: &Se3, b: &Se3) -> [f64; 2] {
    let off = (a.inverse() * *b).log();
    [
        off.fixed_rows::<3>(0).norm().to_degrees(),
        off.fixed_rows::<3>(3).norm() * 1e3,
    ]
}

/// Writes a rig that a command is to read.
pub fn write_rig(path: &Path, rig: &Rig) {
    std::fs::write(path, rig.to_toml()).expect("rig");
}
