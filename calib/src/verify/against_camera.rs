//! Two cameras against each other.

use lsfb_geometry::RigCamera;
use lsfb_recording::Recording;
use lsfb_types::{Image, Stamped};
use rayon::prelude::*;

use super::judgement::judged;
use super::{Check, Outcome, VerifyConfig, epipolar, unreadable};
use crate::Error;

/// Cameras that see much of the same: their epipolar error.
pub(super) fn pair(
    recording: &Recording,
    (first, a): (&str, &RigCamera),
    (second, b): (&str, &RigCamera),
    config: &VerifyConfig,
) -> Result<Option<Check>, Error> {
    const LEAST_OVERLAP: f64 = 0.1;
    const LEAST_MATCHES: usize = 40;
    let second_from_first = b.rig_from_camera.inverse() * a.rig_from_camera;
    let shared = epipolar::overlap(&a.camera, &b.camera, &second_from_first);
    // Without a baseline there is no curve.
    if shared < LEAST_OVERLAP || second_from_first.translation.norm() < 0.01 {
        return Ok(None);
    }
    let all = recording
        .images_of(&[first, second])
        .map_err(unreadable(recording))?;
    let mut pairs: Vec<(Image, Image)> = Vec::new();
    let mut before: Option<(usize, Stamped<Image>)> = None;
    let mut met = 0usize;
    let count = recording
        .images(first)
        .map_err(unreadable(recording))?
        .count();
    let every = (count / config.views.max(1)).max(1);
    for image in all {
        let image = image.map_err(unreadable(recording))?;
        let own = image.camera;
        if let Some((other, earlier)) = before.take()
            && other != own
            && (image.image.time - earlier.time).abs() < 2_000_000
        {
            met += 1;
            if (met - 1).is_multiple_of(every) {
                let (mut x, mut y) = (earlier.sample, image.image.sample);
                if own == 0 {
                    std::mem::swap(&mut x, &mut y);
                }
                pairs.push((x, y));
            }
            continue;
        }
        before = Some((own, image.image));
    }
    let errors: Vec<Vec<f64>> = pairs
        .par_iter()
        .map(|(x, y)| epipolar::errors_px((x, &a.camera), (y, &b.camera), &second_from_first))
        .collect();
    let mut errors: Vec<f64> = errors.into_iter().flatten().collect();
    let mut check = Check::unknown(
        format!("{first}–{second} epipolar"),
        "px",
        config.epipolar_px,
    );
    if errors.len() < LEAST_MATCHES {
        check.sentence = format!(
            "{} corners of {} pairs of images were found in both: {LEAST_MATCHES} are needed",
            errors.len(),
            pairs.len()
        );
        return Ok(Some(check));
    }
    errors.sort_by(f64::total_cmp);
    let signed = errors[errors.len() / 2];
    let mut sizes: Vec<f64> = errors.iter().map(|e| e.abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let median = sizes[sizes.len() / 2];
    let sigma = 1.25 * median / (errors.len() as f64).sqrt();
    check.value = Some(median);
    check.sigma = Some(sigma);
    check.outcome = judged(median, sigma, config.epipolar_px);
    check.sentence = match check.outcome {
        Outcome::Pass => format!(
            "{} corners lie on their curves (median {signed:+.2} px)",
            errors.len()
        ),
        _ => format!(
            "{} corners miss their curves by {signed:+.2} px in the median: one of the two cameras was moved, or they are not triggered together",
            errors.len()
        ),
    };
    Ok(Some(check))
}
