//! Returns of the LiDAR drawn into the camera's image, coloured by distance.

use lsfb_geometry::{Camera, Se3, Vector3};
use lsfb_perception::image::{Compression, Samples, write_png};
use lsfb_types::Image;
use serde::Serialize;

use crate::Error;

/// Returns of the LiDAR over an image.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Overlay {
    /// The camera.
    pub camera: String,
    /// The image's time, nanoseconds.
    pub time_ns: i64,
    /// Returns in view.
    pub points: usize,
    /// The picture.
    #[serde(skip)]
    pub png: Vec<u8>,
}

/// Distances at the ends of the colours, metres.
const NEAR_M: f64 = 0.5;
const FAR_M: f64 = 15.0;
/// Brightness of the image below, so that colours stand out.
const DIM: f32 = 0.65;

/// A picture with three bytes per pixel.
pub(crate) struct Picture {
    width: usize,
    height: usize,
    rgb: Vec<u8>,
}

impl Picture {
    /// The image with points of the rig drawn over it, far ones first; how many were in view.
    pub fn new(
        image: &Image,
        camera: &Camera,
        camera_from_rig: &Se3,
        points_in_rig: &[Vector3<f64>],
    ) -> (Self, usize) {
        let mut picture = Self {
            width: image.width as usize,
            height: image.height as usize,
            rgb: image
                .pixels
                .iter()
                .flat_map(|p| [(f32::from(*p) * DIM) as u8; 3])
                .collect(),
        };
        let mut seen: Vec<(f64, usize, usize)> = points_in_rig
            .iter()
            .filter_map(|p| {
                let point = *camera_from_rig * *p;
                let pixel = camera
                    .project(&point)
                    .filter(|px| point.z > 0.1 && camera.contains(px, 0.0))?;
                let place = pixel.map(|c| c.round().max(0.0) as usize);
                Some((point.norm(), place.x, place.y))
            })
            .collect();
        seen.sort_by(|a, b| b.0.total_cmp(&a.0));
        let size = (picture.width / 640).max(1);
        for (distance, x, y) in &seen {
            picture.dot(*x, *y, size, color(*distance));
        }
        (picture, seen.len())
    }

    fn dot(&mut self, x: usize, y: usize, size: usize, rgb: [u8; 3]) {
        for v in y..(y + size + 1).min(self.height) {
            for u in x..(x + size + 1).min(self.width) {
                let at = 3 * (v * self.width + u);
                if let Some(pixel) = self.rgb.get_mut(at..at + 3) {
                    pixel.copy_from_slice(&rgb);
                }
            }
        }
    }

    /// As PNG.
    pub fn to_png(&self) -> Result<Vec<u8>, Error> {
        let mut bytes = Vec::new();
        let size = (self.width as u32, self.height as u32);
        write_png(
            &mut bytes,
            size,
            Samples::Rgb(&self.rgb),
            Compression::default(),
        )
        .map_err(|e| Error::Parse {
            path: "overlay".to_owned(),
            problem: e.to_string(),
        })?;
        Ok(bytes)
    }
}

/// Red near, over yellow, green and cyan to blue far.
fn color(distance_m: f64) -> [u8; 3] {
    let share = ((distance_m / NEAR_M).ln() / (FAR_M / NEAR_M).ln()).clamp(0.0, 1.0);
    let hue = 4.0 * share;
    let ramp = |x: f64| (255.0 * x.clamp(0.0, 1.0)) as u8;
    [
        ramp(2.0 - hue),
        ramp(if hue < 2.0 { hue } else { 4.0 - hue }),
        ramp(hue - 2.0),
    ]
}
