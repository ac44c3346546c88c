//! The matches of a frame, drawn over its images.

use std::fmt::Write;

use anyhow::Context as _;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lsfb_geometry::{Camera, Rig, Se3};
use lsfb_pipeline::features::{FeatureDetector, FrameFeatures};
use lsfb_pipeline::localization::{Localization, Localizer, NotLocalized};
use lsfb_types::Image;

/// The images of a frame, by camera.
pub struct Shown<'a> {
    /// Of the frame.
    pub name: String,
    pub rig: &'a Rig,
    pub images: Vec<(String, Image)>,
}

/// Height of the line of text below the images, pixels.
const CAPTION_PX: u32 = 24;

/// The images, one below the other, with all features (grey), the inliers of the best pose (green), and lines from those to where the
/// pose expects their points (red), ten times as long. The picture holds the images, and fetches nothing.
pub fn draw(
    localizer: &Localizer,
    detector: &mut FeatureDetector,
    shown: &Shown,
) -> anyhow::Result<String> {
    let detected = shown.images.iter().map(|(camera, image)| FrameFeatures {
        camera: camera.clone(),
        features: detector.detect(image),
    });
    let frames: Vec<FrameFeatures> = detected.collect();
    let found = localizer.localize(&frames, shown.rig);
    let best = found.as_ref().map_or_else(NotLocalized::best, Some);
    let width = shown.images.iter().map(|(_, i)| i.width).max().unwrap_or(0);
    let height: u32 = shown.images.iter().map(|(_, i)| i.height).sum();
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-0.5 -0.5 {width} {}\">\n\
         <rect x=\"-0.5\" y=\"-0.5\" width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        height + CAPTION_PX,
    );
    let mut top = 0;
    for (index, ((camera, image), frame)) in shown.images.iter().zip(&frames).enumerate() {
        let mounted = shown.rig.cameras.get(camera);
        let mounted = mounted.with_context(|| format!("camera {camera} is not on the rig"))?;
        // As the pose was found.
        let mounted = localizer.map().as_found(camera, mounted);
        let _ = writeln!(
            svg,
            "<g transform=\"translate(0 {top})\"><image href=\"data:image/png;base64,{}\" x=\"-0.5\" y=\"-0.5\" \
             width=\"{}\" height=\"{}\"/>",
            STANDARD.encode(encoded(image)?),
            image.width,
            image.height,
        );
        for keypoint in &frame.features.keypoints {
            let [x, y] = keypoint.pixel;
            let _ = writeln!(
                svg,
                r#"<circle cx="{x:.1}" cy="{y:.1}" r="1" fill="silver"/>"#
            );
        }
        if let Some(best) = best {
            let (lens, place) = (&mounted.camera, &mounted.rig_from_camera);
            inliers(&mut svg, localizer, best, (index, frame), (lens, place));
        }
        svg.push_str("</g>\n");
        top += image.height;
    }
    let _ = writeln!(
        svg,
        r#"<text x="4" y="{}" font-family="sans-serif" font-size="12">{}</text></svg>"#,
        height + CAPTION_PX - 8,
        escaped(&format!("{}: {}", shown.name, caption(&found)))
    );
    Ok(svg)
}

fn caption(found: &Result<Localization, NotLocalized>) -> String {
    let said = match found {
        Ok(_) => "localized".to_owned(),
        Err(refused) => refused.to_string(),
    };
    let best = found.as_ref().map_or_else(NotLocalized::best, Some);
    let Some(best) = best else {
        return said;
    };
    let e = &best.evidence;
    format!(
        "{said}: {} inliers ({:.1} by chance), {} of {} first matches, 10^{:.0} false alarms expected, probability {:.4}",
        e.guided_inliers,
        e.decoy_inliers,
        e.first_inliers,
        e.first_matches,
        e.log10_false_alarms,
        best.probability
    )
}

fn encoded(image: &Image) -> anyhow::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width, image.height);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&image.pixels)?;
    writer.finish()?;
    Ok(bytes)
}

/// How much longer than they are errors are drawn.
const MAGNIFIED: f64 = 10.0;

fn inliers(
    svg: &mut String,
    localizer: &Localizer,
    best: &Localization,
    (index, frame): (usize, &FrameFeatures),
    (camera, rig_from_camera): (&Camera, &Se3),
) {
    let camera_from_world = (best.world_from_rig * *rig_from_camera).inverse();
    for m in best.matches.iter().filter(|m| m.frame == index) {
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
