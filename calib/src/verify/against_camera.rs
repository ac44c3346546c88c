//! Two cameras against each other.

use lsfb_geometry::RigCamera;
use lsfb_perception::image::Gray;
use lsfb_perception::statistics::median;
use lsfb_recording::Recording;
use lsfb_types::{Image, Stamped, Verdict};
use rayon::prelude::*;

use super::judgement::judged;
use super::{Check, VerifyConfig, epipolar};
use crate::Error;
use crate::recorded::unreadable;

/// Share of one image that the other camera must see.
const LEAST_OVERLAP: f64 = 0.1;
/// Corners that must be found in both.
const LEAST_MATCHES: usize = 40;
/// Errors that are looked for, pixels; and once more where too little is found so near.
const REACH_PX: i32 = 6;
const FAR_PX: i32 = 24;
/// Median distance from their median of errors that agree, pixels.
const AGREE_PX: f64 = 3.0;
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
            sentence: "no other camera sees enough of the same scene from another position: its mounting is checked against gyroscope and LiDAR only".to_owned(),
            ..Check::unknown("epipolar", format!("{name} epipolar"), "px", config.epipolar_px)
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
    let look = |reach_px: i32| -> Vec<Vec<f64>> {
        let errors = pairs.par_iter().map(|(x, y)| {
            let (x, y) = (Gray::new(x, &a.camera), Gray::new(y, &b.camera));
            epipolar::errors_px(&x, &y, &second_from_first, reach_px)
        });
        errors.collect()
    };
    let mut check = Check::unknown(
        "epipolar",
        format!("{first}–{second} epipolar"),
        "px",
        config.epipolar_px,
    );
    let mut found = Errors::of(look(REACH_PX));
    if found.signed.len() < LEAST_MATCHES {
        // A camera that was moved by degrees; what is found so far away is believed where it agrees.
        let far = Errors::of(look(FAR_PX));
        if far.signed.len() >= LEAST_MATCHES && far.spread_px() < AGREE_PX {
            found = far;
        }
    }
    if found.signed.len() < LEAST_MATCHES {
        check.sentence = match pairs.len() {
            0 => "no two images were taken within 2 ms, according to the rig's clocks: trigger both cameras together".to_owned(),
            n => format!(
                "{} corners of {n} image pairs were found in both, but {LEAST_MATCHES} are needed: record longer, with objects where both cameras look",
                found.signed.len()
            ),
        };
        return Ok(Some(check));
    }
    let errors = &found.signed;
    let signed = median_px(errors.clone());
    let (size, sigma) = (found.size_px, found.sigma_px);
    check.value = Some(size);
    check.sigma = Some(sigma);
    check.outcome = judged(size, sigma, config.epipolar_px);
    check.sentence = match check.outcome {
        Verdict::Pass => format!(
            "{} corners lie on their epipolar lines (median {signed:+.2} px)",
            errors.len()
        ),
        _ => format!(
            "{} corners are off their epipolar lines by {signed:+.2} px (median): one of the two cameras moved, or they are not triggered together",
            errors.len()
        ),
    };
    Ok(Some(check))
}

/// Errors over all pairs of images.
struct Errors {
    signed: Vec<f64>,
    /// Median of their sizes, and its standard deviation by how unlike pairs of images are.
    size_px: f64,
    sigma_px: f64,
}

impl Errors {
    fn of(by_pair: Vec<Vec<f64>>) -> Self {
        let sizes = |errors: &[f64]| errors.iter().map(|e| e.abs()).collect::<Vec<f64>>();
        let medians: Vec<f64> = by_pair
            .iter()
            .filter(|e| !e.is_empty())
            .map(|e| median_px(sizes(e)))
            .collect();
        let signed: Vec<f64> = by_pair.into_iter().flatten().collect();
        let size_px = median_px(sizes(&signed));
        let off = medians.iter().map(|m| (m - size_px).abs()).collect();
        // A median of normal numbers scatters by 1.25 of their mean's σ, which is 1.48 of the median deviation.
        let sigma_px = 1.25 * 1.48 * median_px(off) / (medians.len() as f64).sqrt();
        Self {
            size_px,
            sigma_px,
            signed,
        }
    }

    /// Median distance from the median.
    fn spread_px(&self) -> f64 {
        let middle = median_px(self.signed.clone());
        median_px(self.signed.iter().map(|e| (e - middle).abs()).collect())
    }
}

/// Not a number where there is none.
fn median_px(values: Vec<f64>) -> f64 {
    median(values).unwrap_or(f64::NAN)
}
