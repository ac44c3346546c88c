//! The keyframes of a map: their poses as files, and how well they are known.

use std::path::Path;

use anyhow::Context as _;
use lsfb_geometry::{Matrix6, StampedPose, Trajectory};
use lsfb_pipeline::hd_map::HdMap;
use lsfb_recording::write_tum;
use lsfb_types::quantile;
use serde::Serialize;

use super::covariance_file;
use crate::context::Context;
use crate::files;
use crate::outcome::Outcome;

/// What the file of covariances says of itself.
const WHAT_IS_IN_IT: &str = "Relative to the first keyframe of the original map, which is taken as \
     exact. Included: errors of images and scans that differ between keyframes.\nNot included: \
     errors of the rig file and a range offset of the LiDAR.";

/// Standard deviations of the keyframes relative to the first, in the direction in which each is known worst.
#[derive(Serialize)]
pub struct KeyframeSigma {
    /// Keyframes whose covariance is known, the first not counted.
    known: usize,
    /// Median, and what 95 % stay below.
    position_m: [f64; 2],
    rotation_deg: [f64; 2],
}

impl KeyframeSigma {
    /// `None` where nothing is known of any.
    pub fn of(map: &HdMap) -> Option<Self> {
        let known = known(map).into_iter().map(|(_, covariance)| covariance);
        // The reference is exact.
        let known: Vec<Matrix6<f64>> = known.filter(|c| c.iter().any(|v| *v != 0.0)).collect();
        let shares = |from: usize, unit: f64| {
            let worst = |c: &Matrix6<f64>| {
                let own = c.fixed_view::<3, 3>(from, from).into_owned();
                own.symmetric_eigenvalues().max().max(0.0).sqrt() * unit
            };
            let values: Vec<f64> = known.iter().map(worst).collect();
            Some([quantile(values.clone(), 0.5)?, quantile(values, 0.95)?])
        };
        Some(Self {
            position_m: shares(3, 1.0)?,
            rotation_deg: shares(0, 1f64.to_degrees())?,
            known: known.len(),
        })
    }

    /// As `lsfb map info` says it of a map with so many keyframes.
    pub fn sentence(&self, keyframes: usize) -> String {
        let ([half, most], [half_deg, most_deg]) = (self.position_m, self.rotation_deg);
        let mut text = format!(
            "σ of a keyframe relative to the first, in the worst direction: median {:.2} cm and {half_deg:.3}°, 95 % below {:.2} cm and {most_deg:.3}°",
            100.0 * half,
            100.0 * most
        );
        let unknown = keyframes.saturating_sub(self.known + 1);
        if unknown > 0 {
            text += &format!("; unknown for {unknown}");
        }
        text
    }
}

fn known(map: &HdMap) -> Vec<(StampedPose, Matrix6<f64>)> {
    let keyframes = 0..map.keyframe_count() as u32;
    keyframes
        .filter_map(|k| Some((map.keyframe(k)?, map.keyframe_covariance(k)?)))
        .collect()
}

/// Writes the poses into a folder, and their covariances where there are any; says what is not in these.
pub fn export(map: &HdMap, out: &Path, context: &Context) -> anyhow::Result<Outcome> {
    let all = map.keyframe_count();
    let trajectory = Trajectory::new(map.keyframes().collect());
    let known = known(map);
    let mut notes = Vec::new();
    if trajectory.len() < all {
        let twice = all - trajectory.len();
        notes.push(format!(
            "{twice} of {all} keyframes share their stamp with another, as in merged maps of images without times: keyframes.tum leaves them out"
        ));
    }
    if known.len() < all {
        notes.push(format!(
            "the covariance of {} of {all} keyframes is unknown, as for given poses or merged maps",
            all - known.len()
        ));
    }
    let poses = out.join("keyframes.tum");
    let covariances = files::beside(&poses, "covariance");
    context.claim(&poses, &[])?;
    context.claim(&covariances, &[])?;
    std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
    write_tum(&poses, &trajectory)?;
    let mut written = vec![poses];
    if known.is_empty() {
        // One of an earlier map would be taken for this one's.
        if covariances.exists() {
            std::fs::remove_file(&covariances)
                .with_context(|| covariances.display().to_string())?;
        }
    } else {
        let rows = known.iter().map(|(pose, covariance)| (pose, covariance));
        files::write(&covariances, covariance_file::text(WHAT_IS_IN_IT, rows))?;
        written.push(covariances);
    }
    let summary = serde_json::json!({
        "files": written.len(),
        "keyframes": all,
        "with_covariance": known.len(),
        "notes": &notes,
        "failures": map.failures(),
    });
    let text = || {
        let mut text = format!(
            "{}: {} files, {all} keyframes",
            out.display(),
            written.len()
        );
        for note in &notes {
            text += &format!("\n  {note}");
        }
        text
    };
    super::map_folder::print_made(map, out, &summary, text, context)
}
