//! Files between one step and the next, away from the result.

use std::path::PathBuf;

use anyhow::Context as _;

/// A folder for scans; gone with this.
pub struct Scratch {
    folder: PathBuf,
    pub scans: PathBuf,
}

impl Scratch {
    /// For scans of this kind: one at a time in a process.
    pub fn new(kind: &str) -> anyhow::Result<Self> {
        let name = format!("lsfb-odometry-{}-{kind}", std::process::id());
        let folder = std::env::temp_dir().join(name);
        std::fs::create_dir_all(&folder).with_context(|| folder.display().to_string())?;
        Ok(Self {
            scans: folder.join("scans.mcap"),
            folder,
        })
    }
}

impl Drop for Scratch {
    fn drop(&mut self) {
        // What stays behind in the system's folder for such files is the system's to clear.
        let _ = std::fs::remove_dir_all(&self.folder);
    }
}
