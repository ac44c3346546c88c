//! The matches of a frame, drawn over its images.

use std::fmt::Write;

use anyhow::Context as _;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use lsfb_geometry::{Rig, Vector2};
use lsfb_perception::image::{Compression, Samples, write_png};
use lsfb_pipeline::features::{FeatureDetector, Features};
use lsfb_pipeline::localization::{FeatureMatch, Localizer};
use lsfb_types::Image;

use super::frames::Frame;
use super::matches::{Inliers, PosedCamera};

/// The images of a frame, by camera.
pub struct Shown<'a> {
    /// Of the frame.
    pub name: String,
    pub rig: &'a Rig,
    pub images: Vec<(String, Image)>,
}

/// Height of the line of text below the images, pixels.
const CAPTION_PX: u32 = 24;

/// The images, one below the other, with all features (grey), the inliers of the best pose that the frame was answered with (green), and
/// lines from those to where the pose expects their points (red), ten times as long. The picture holds the images, and fetches nothing.
pub fn draw(
    localizer: &Localizer,
    detector: &mut FeatureDetector,
    shown: &Shown,
    (frame, inliers): (&Frame, &Inliers),
) -> anyhow::Result<String> {
    let width = shown.images.iter().map(|(_, i)| i.width).max().unwrap_or(0);
    let height: u32 = shown.images.iter().map(|(_, i)| i.height).sum();
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"-0.5 -0.5 {width} {}\">\n\
         <rect x=\"-0.5\" y=\"-0.5\" width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
        height + CAPTION_PX,
    );
    let mut top = 0;
    for (camera, image) in &shown.images {
        let features = detector.detect(image);
        let _ = writeln!(
            svg,
            "<g transform=\"translate(0 {top})\"><image href=\"data:image/png;base64,{}\" x=\"-0.5\" y=\"-0.5\" \
             width=\"{}\" height=\"{}\"/>",
            STANDARD.encode(encoded(image)?),
            image.width,
            image.height,
        );
        for keypoint in &features.keypoints {
            let [x, y] = keypoint.pixel;
            let _ = writeln!(
                svg,
                r#"<circle cx="{x:.1}" cy="{y:.1}" r="1" fill="silver"/>"#
            );
        }
        if let Some(pose) = &frame.pose {
            let posed = PosedCamera::new(localizer, shown.rig, camera, &pose.world_from_rig());
            let posed = posed.with_context(|| format!("camera {camera} is not on the rig"))?;
            for m in inliers.of_camera(camera) {
                draw_inlier(&mut svg, localizer, &posed, &features, m);
            }
        }
        svg.push_str("</g>\n");
        top += image.height;
    }
    let _ = writeln!(
        svg,
        r#"<text x="4" y="{}" font-family="sans-serif" font-size="12">{}</text></svg>"#,
        height + CAPTION_PX - 8,
        escaped(&format!("{}: {}", shown.name, caption(frame)))
    );
    Ok(svg)
}

fn caption(frame: &Frame) -> String {
    let said = match frame.localized {
        true => "localized",
        false => frame.reason.as_deref().unwrap_or_default(),
    };
    let Some(best) = &frame.pose else {
        return said.to_owned();
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
    let size = (image.width, image.height);
    write_png(
        &mut bytes,
        size,
        Samples::Grey(&image.pixels),
        Compression::default(),
    )?;
    Ok(bytes)
}

/// How much longer than they are errors are drawn.
const MAGNIFIED: f64 = 10.0;

fn draw_inlier(
    svg: &mut String,
    localizer: &Localizer,
    camera: &PosedCamera,
    features: &Features,
    inlier: &FeatureMatch,
) {
    let [x, y] = inlier.pixel.map(f64::from);
    let seen = Vector2::new(x, y);
    let point = localizer.map().position(inlier.point);
    let Some(expected) = point.and_then(|point| camera.project(&point)) else {
        return;
    };
    let end = seen + (expected - seen) * MAGNIFIED;
    let keypoint = features.keypoints.get(inlier.keypoint as usize);
    let _ = writeln!(
        svg,
        r#"<circle cx="{:.1}" cy="{:.1}" r="{:.1}" fill="none" stroke="lime"/><line x1="{:.1}" y1="{:.1}" x2="{:.1}" y2="{:.1}" stroke="red"/>"#,
        seen.x,
        seen.y,
        keypoint.map_or(0.0, |k| k.scale_px).max(1.5),
        seen.x,
        seen.y,
        end.x,
        end.y
    );
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('"', "&quot;")
}
