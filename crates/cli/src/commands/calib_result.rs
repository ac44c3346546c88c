//! What calibration steps print, and the transforms they write beside a rig.

use std::path::{Path, PathBuf};

use lsfb_calib::TransformEdge;
use lsfb_calib::joint::IMU;
use lsfb_calib::verify::Outcome as Judgement;
use serde::Serialize;

/// A calibration as it is printed: with its verdict, and what was written beside the rig.
#[derive(Serialize)]
pub struct Judged<'a, C: Serialize> {
    pub outcome: Judgement,
    pub verdict: String,
    pub page: &'a Path,
    /// For `lsfb calib joint`.
    pub transforms: &'a [PathBuf],
    #[serde(flatten)]
    pub calibration: &'a C,
}

impl<C: Serialize> Judged<'_, C> {
    /// The first line of the text.
    pub fn headline(&self, out: &Path) -> String {
        let mut text = format!(
            "{}: {} See {}",
            out.display(),
            self.verdict,
            self.page.display()
        );
        if !self.transforms.is_empty() {
            text += &format!("; for `lsfb calib joint`: {}", listed(self.transforms));
        }
        text + "."
    }

    /// Fails where the calibration must not be used.
    pub fn ensure_usable(&self, out: &Path) -> anyhow::Result<()> {
        anyhow::ensure!(
            self.outcome != Judgement::Fail,
            "{} is not written, its calibration cannot be used: see {} for why",
            out.display(),
            self.page.display()
        );
        Ok(())
    }
}

/// Writes transforms beside a rig, `RIG.TARGET-SOURCE.json`, and says where; `imu` comes last in the names.
pub fn write_transforms(rig: &Path, edges: &[TransformEdge]) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for edge in edges {
        let (a, b) = if edge.target == IMU {
            (&edge.source, &edge.target)
        } else {
            (&edge.target, &edge.source)
        };
        let path = rig.with_extension(format!("{a}-{b}.json"));
        super::write(&path, edge.to_json())?;
        paths.push(path);
    }
    Ok(paths)
}

/// Files in a sentence.
pub fn listed(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    names.join(", ")
}
