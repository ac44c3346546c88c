//! What calibration steps print, and the transforms they write beside a rig.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
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

/// Moves what an earlier run wrote to `out` and beside it aside, as `NAME.old`: whatever becomes of this run, nothing older looks
/// like its result. `transforms` are the sensors of those that this run will write; an `out` that is also read stays.
pub fn set_aside(out: &Path, transforms: &[[&str; 2]], inputs: &[&Path]) -> anyhow::Result<()> {
    let pages = [out.to_owned(), out.with_extension("html")];
    let transforms = transforms
        .iter()
        .map(|[target, source]| transform_path(out, target, source));
    let old = pages.into_iter().chain(transforms);
    let is_read = |path: &Path| {
        let same = |input: &&Path| match (input.canonicalize(), path.canonicalize()) {
            (Ok(input), Ok(path)) => input == path,
            _ => false,
        };
        inputs.iter().any(same)
    };
    for path in old {
        if path.is_file() && !is_read(&path) {
            let mut aside = path.clone().into_os_string();
            aside.push(".old");
            std::fs::rename(&path, &aside).with_context(|| path.display().to_string())?;
        }
    }
    Ok(())
}

/// Writes transforms beside a rig, `RIG.TARGET-SOURCE.json`, and says where; `imu` comes last in the names.
pub fn write_transforms(rig: &Path, edges: &[TransformEdge]) -> anyhow::Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for edge in edges {
        let path = transform_path(rig, &edge.target, &edge.source);
        super::write(&path, edge.to_json())?;
        paths.push(path);
    }
    Ok(paths)
}

/// Where the transform between two sensors is written; `imu` comes last in the name.
fn transform_path(rig: &Path, target: &str, source: &str) -> PathBuf {
    let (a, b) = if target == IMU {
        (source, target)
    } else {
        (target, source)
    };
    rig.with_extension(format!("{a}-{b}.json"))
}

/// Files in a sentence.
pub fn listed(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    names.join(", ")
}
