//! The matches of one image, drawn over it.

use std::fmt::Write;
use std::path::Path;

use lsfb_geometry::{Camera, Se3};
use lsfb_pipeline::features::{FeatureDetector, FrameFeatures};
use lsfb_pipeline::localization::{Localization, Localizer, NotLocalized};

use super::input::Input;

/// The image with all features (grey), the inliers of the best pose (green), and lines from those to where the pose expects
/// their points (red), ten times as long. The picture shows the image's file, which it names.
pub fn draw(
    localizer: &Localizer,
    detector: &mut FeatureDetector,
    input: &Input,
) -> anyhow::Result<String> {
    let Input::Images { rig, images, .. } = input else {
        anyhow::bail!("a walk has no image files to draw over");
    };
    let image = images
        .first()
        .ok_or_else(|| anyhow::anyhow!("no image to draw over"))?;
    let mounted = rig
        .cameras
        .get(&image.camera)
        .ok_or_else(|| anyhow::anyhow!("camera {} is not on the rig", image.camera))?;
    // As the pose was found.
    let mounted = localizer.map().as_found(&image.camera, mounted);
    let pixels = lsfb_pipeline::posed_images::read_image(&image.path, &image.camera, rig)?;
    let frame = FrameFeatures {
        camera: image.camera.clone(),
        features: detector.detect(&pixels),
    };
    let found = localizer.localize(std::slice::from_ref(&frame), rig);
    let best = found.as_ref().map_or_else(NotLocalized::best, Some);
    let mut caption = match &found {
        Ok(_) => "localized".to_owned(),
        Err(refused) => refused.to_string(),
    };
    let mut svg = begin(&image.path, &mounted.camera);
    for keypoint in &frame.features.keypoints {
        let [x, y] = keypoint.pixel;
        let _ = writeln!(
            svg,
            r#"<circle cx="{x:.1}" cy="{y:.1}" r="1" fill="silver"/>"#
        );
    }
    if let Some(best) = best {
        inliers(
            &mut svg,
            localizer,
            best,
            &frame,
            &mounted.camera,
            &mounted.rig_from_camera,
        );
        let e = &best.evidence;
        let _ = write!(
            caption,
            ": {} inliers ({:.1} by chance), {} of {} first matches, 10^{:.0} false alarms expected, probability {:.4}",
            e.guided_inliers,
            e.decoy_inliers,
            e.first_inliers,
            e.first_matches,
            e.log10_false_alarms,
            best.probability
        );
    }
    let _ = writeln!(
        svg,
        r#"<text x="4" y="{}" font-family="sans-serif" font-size="12">{}</text></svg>"#,
        mounted.camera.height + 16,
        escaped(&caption)
    );
    Ok(svg)
}

fn begin(path: &Path, camera: &Camera) -> String {
    let path = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    let (width, height) = (camera.width, camera.height);
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-0.5 -0.5 {width} {}\">\n\
         <rect x=\"-0.5\" y=\"-0.5\" width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <image href=\"file://{}\" x=\"-0.5\" y=\"-0.5\" width=\"{width}\" height=\"{height}\"/>\n",
        height + 24,
        escaped(&path.display().to_string()),
    )
}

/// How much longer than they are errors are drawn.
const MAGNIFIED: f64 = 10.0;

fn inliers(
    svg: &mut String,
    localizer: &Localizer,
    best: &Localization,
    frame: &FrameFeatures,
    camera: &Camera,
    rig_from_camera: &Se3,
) {
    let camera_from_world = (best.world_from_rig * *rig_from_camera).inverse();
    for m in &best.matches {
        let keypoint = &frame.features.keypoints[m.keypoint as usize];
        let seen = keypoint.pixel_f64();
        let point = localizer.map().position(m.point);
        let Some(expected) = point.and_then(|p| camera.project(&(camera_from_world * p))) else {
            continue;
        };
        let end = seen + (expected - seen) * MAGNIFIED;
        let _ = writeln!(
            svg,
            r#"<circle cx="{:.1}" cy="{:.1}" r="{:.1}" fill="none" stroke="lime"/><line x1="{:.1}" y1="{:.1}" x2="{:.1}" y2="{:.1}" stroke="red"/>"#,
            seen.x,
            seen.y,
            keypoint.scale_px.max(1.5),
            seen.x,
            seen.y,
            end.x,
            end.y
        );
    }
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}
