//! Images and matches for other programs.

use std::path::Path;

use lsfb_pipeline::features::Features;
use serde::Serialize;

use super::contestants::file_of;
use super::pairs::Pairs;
use super::scores::{matched, matchings, pose_error_deg};
use super::warps::Kind;
use crate::files::write;

/// Two images with a known homography.
#[derive(Serialize)]
struct Homography {
    kind: Kind,
    images: [usize; 2],
    /// Rows.
    target_from_source: [[f64; 3]; 3],
}

/// The images as `images/NNNN.pgm`, and which of them belong together as `homographies.json`.
pub fn write_images(out: &Path, pairs: &Pairs) -> anyhow::Result<()> {
    let folder = out.join("images");
    std::fs::create_dir_all(&folder)?;
    for (number, image) in pairs.images.iter().enumerate() {
        let mut bytes = format!("P5\n{} {}\n255\n", image.width, image.height).into_bytes();
        bytes.extend(&image.pixels);
        write(&folder.join(file_of(number, "pgm")), bytes)?;
    }
    let homographies = pairs.planar.iter().map(|pair| Homography {
        kind: pair.kind,
        images: pair.images,
        target_from_source: [0, 1, 2].map(|r| [0, 1, 2].map(|c| pair.target_from_source[(r, c)])),
    });
    let homographies: Vec<Homography> = homographies.collect();
    write(
        &out.join("homographies.json"),
        serde_json::to_vec(&homographies)?,
    )
}

/// A pair of images with known motion.
#[derive(Serialize)]
struct Exported<'a> {
    place: &'a str,
    images: [usize; 2],
    /// Focal lengths and principal point of each camera, pixels.
    pinholes: [[f64; 4]; 2],
    /// Rotation, rows, and translation.
    second_from_first: [[f64; 4]; 3],
    /// Pixels of both images, of matches as the toolkit makes them.
    matches: Vec<[[f64; 2]; 2]>,
    /// Of these by us; absent where they give no motion.
    error_deg: Option<f64>,
}

/// The matches of one feature as `matches-NAME.json`.
pub fn write_matches(
    out: &Path,
    feature: &str,
    pairs: &Pairs,
    features: &[Features],
) -> anyhow::Result<()> {
    let exported = pairs.posed.iter().map(|pair| {
        let [config, _] = matchings();
        let matches = matched(pair.images.map(|k| &features[k]), &config);
        let cameras = [&pair.cameras[0], &pair.cameras[1]];
        let error_deg = pose_error_deg(&matches, cameras, &pair.second_from_first);
        let rotation = pair.second_from_first.rotation_matrix();
        let translation = pair.second_from_first.translation;
        Exported {
            place: &pair.place,
            images: pair.images,
            pinholes: cameras.map(|c| {
                let ([fx, fy], [cx, cy]) = (c.focal_px(), c.principal_px());
                [fx, fy, cx, cy]
            }),
            second_from_first: [0, 1, 2].map(|r| {
                [
                    rotation[(r, 0)],
                    rotation[(r, 1)],
                    rotation[(r, 2)],
                    translation[r],
                ]
            }),
            matches,
            error_deg: error_deg.is_finite().then_some(error_deg),
        }
    });
    let path = out.join(format!("matches-{feature}.json"));
    write(&path, serde_json::to_vec(&exported.collect::<Vec<_>>())?)
}
