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
use crate::standing;

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
                "error: {} is not written because its calibration is unusable: see {} for the reasons",
                self.out.display(),
                self.page.display()
            ));
        }
        Ok(Outcome::of(verdict))
    }
}

/// What a step writes.
pub struct Results<'a> {
    /// The result, with its page and picture beside it.
    pub out: &'a Path,
    /// Sensors of the transforms beside it.
    pub transforms: &'a [[&'a str; 2]],
    /// Other files that were named.
    pub others: &'a [Option<&'a Path>],
    /// A rig that is read: a result of the same name brings it up to date.
    pub rig: Option<&'a Path>,
    /// The rest of what is read.
    pub read: Vec<&'a Path>,
}

impl Results<'_> {
    /// Fails where a result is there and may not be replaced. What may be, and pages of a run that came to nothing, becomes
    /// `NAME.old`: whatever becomes of this run, nothing older looks like its result.
    pub fn claim(&self, context: &Context) -> anyhow::Result<()> {
        let transforms = self.transforms.iter();
        let transforms =
            transforms.map(|[target, source]| transform_path(self.out, target, source));
        let named = self.others.iter().flatten().map(|p| p.to_path_buf());
        let results = [self.out.to_owned()]
            .into_iter()
            .chain(transforms)
            .chain(named);
        let results: Vec<PathBuf> = results.filter(|path| !self.is_rig(path)).collect();
        for result in &results {
            context.claim(result, &self.read)?;
        }
        standing::forget(&[self.out])?;
        let pages = [self.out.with_extension("html"), picture_path(self.out)];
        for older in results.iter().chain(&pages) {
            if older.is_file() && !self.is_rig(older) {
                let mut aside = older.clone().into_os_string();
                aside.push(".old");
                std::fs::rename(older, &aside).with_context(|| older.display().to_string())?;
            }
        }
        Ok(())
    }

    fn is_rig(&self, path: &Path) -> bool {
        self.rig.is_some_and(|rig| is_same(rig, path))
    }
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
