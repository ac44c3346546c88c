//! What calibration steps print, and the transforms they write beside a rig.

use std::path::{Path, PathBuf};

use anyhow::Context as _;
use lsfb_calib::TransformEdge;
use lsfb_calib::joint::IMU;
use lsfb_types::{Judgement, Verdict};
use serde::Serialize;

use crate::context::Context;
use crate::files::is_same;
use crate::judged::{self, Judged};
use crate::outcome::Outcome;

/// A calibration with its judgement, and what was written beside the rig.
pub struct Calibrated<'a, C: Serialize> {
    pub judgement: &'a Judgement,
    /// What was calibrated and how well, in a few words.
    pub summary: String,
    /// The rig; it is written unless the judgement is FAIL.
    pub out: &'a Path,
    pub page: &'a Path,
    /// For `lsfb calib joint`.
    pub transforms: &'a [PathBuf],
    pub calibration: &'a C,
}

/// The same in JSON.
#[derive(Serialize)]
struct Printed<'a, C: Serialize> {
    outcome: &'static str,
    page: &'a Path,
    transforms: &'a [PathBuf],
    #[serde(flatten)]
    calibration: &'a C,
}

impl<C: Serialize> Calibrated<'_, C> {
    /// Prints the headline, `details` in lines of their own, and what should be looked at.
    pub fn print(
        &self,
        context: &Context,
        details: impl FnOnce() -> String,
    ) -> anyhow::Result<Outcome> {
        let verdict = self.judgement.verdict();
        let printed = Printed {
            outcome: verdict.name(),
            page: self.page,
            transforms: self.transforms,
            calibration: self.calibration,
        };
        let judged = Judged::new(self.judgement, &self.summary, &printed);
        context.print(&judged, || {
            let mut text = format!(
                "{}: {}. See {}",
                self.out.display(),
                judged.summary,
                self.page.display()
            );
            if !self.transforms.is_empty() {
                text += &format!("; for `lsfb calib joint`: {}", listed(self.transforms));
            }
            text += &format!(".{}\n{}", details(), judged::problem_lines(self.judgement));
            judged::printable(text.trim_end())
        })?;
        if verdict == Verdict::Fail {
            context.note(&format!(
                "error: {} is not written, its calibration cannot be used: see {} for why",
                self.out.display(),
                self.page.display()
            ));
        }
        Ok(Outcome::of(verdict))
    }
}

/// Moves what an earlier run wrote to `out` and beside it aside, as `NAME.old`: whatever becomes of this run, nothing older looks
/// like its result. `transforms` are the sensors of those that this run will write; an `out` that is also read stays.
pub fn set_aside(out: &Path, transforms: &[[&str; 2]], inputs: &[&Path]) -> anyhow::Result<()> {
    let pages = [
        out.to_owned(),
        out.with_extension("html"),
        picture_path(out),
    ];
    let transforms = transforms
        .iter()
        .map(|[target, source]| transform_path(out, target, source));
    let old = pages.into_iter().chain(transforms);
    let is_read = |path: &Path| inputs.iter().any(|input| is_same(input, path));
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

/// Where the picture that the page of `lsfb calib lidar-camera` shows is written.
pub fn picture_path(rig: &Path) -> PathBuf {
    rig.with_extension("lidar.png")
}

/// Files in a sentence.
pub fn listed(paths: &[PathBuf]) -> String {
    let names: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    names.join(", ")
}
