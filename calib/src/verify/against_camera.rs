//! Two cameras against each other.

use lsfb_geometry::RigCamera;
use lsfb_recording::Recording;
use lsfb_types::{Image, Stamped};
use rayon::prelude::*;

use super::judgement::judged;
use super::{Check, Outcome, VerifyConfig, epipolar, unreadable};
use crate::Error;

/// Share of one image that the other camera must see.
const LEAST_OVERLAP: f64 = 0.1;
/// Corners that must be found in both.
const LEAST_MATCHES: usize = 40;
/// Images of one time are at most this far apart, nanoseconds.
const TOGETHER_NS: i64 = 2_000_000;

/// All pairs of cameras that see some of the same, and cameras that have no such partner.
pub(super) fn all(
    recording: &Recording,
    present: &[(&str, &RigCamera)],
    config: &VerifyConfig,
) -> Result<Vec<Check>, Error> {
    let mut checks = Vec::new();
    let mut alone = vec![present.len() > 1; present.len()];
    for (i, first) in present.iter().enumerate() {
        for (j, second) in present.iter().enumerate().skip(i + 1) {
            if let Some(check) = pair(recording, *first, *second, config)? {
                (alone[i], alone[j]) = (false, false);
                checks.push(check);
            }
        }
    }
    for ((name, _), _) in present.iter().zip(alone).filter(|(_, alone)| *alone) {
        checks.push(Check {
            sentence: "no other camera sees enough of what this one sees, from another place: its mounting is checked by gyroscope and LiDAR alone".to_owned(),
            ..Check::unknown(format!("{name} epipolar"), "px", config.epipolar_px)
        });
    }
    Ok(checks)
}

/// Two cameras that see much of the same: their epipolar error.
fn pair(
    recording: &Recording,
    (first, a): (&str, &RigCamera),
    (second, b): (&str, &RigCamera),
    config: &VerifyConfig,
) -> Result<Option<Check>, Error> {
    let second_from_first = b.rig_from_camera.inverse() * a.rig_from_camera;
    let shared = epipolar::overlap(&a.camera, &b.camera, &second_from_first);
    // Without a baseline there is no curve.
    if shared < LEAST_OVERLAP || second_from_first.translation.norm() < 0.01 {
        return Ok(None);
    }
    let all = recording
        .images_of(&[first, second])
        .map_err(unreadable(recording))?;
    let offset_ns = [a, b].map(|c| (c.timing.rig_from_camera_s * 1e9).round() as i64);
    let shift_ns = |earlier: usize, later: usize| offset_ns[later] - offset_ns[earlier];
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
            && (image.image.time - earlier.time + shift_ns(other, own)).abs() < TOGETHER_NS
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
        check.sentence = match pairs.len() {
            0 => "no two images were taken within 2 ms, as the rig has their clocks: trigger both together".to_owned(),
            n => format!(
                "{} corners of {n} pairs of images were found in both, {LEAST_MATCHES} are needed: a longer recording, with things to see where both look, would tell",
                errors.len()
            ),
        };
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
