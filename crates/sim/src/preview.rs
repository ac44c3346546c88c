//! Pictures by which a person judges a simulation: a contact sheet of each walk, and the place from above.

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use rayon::prelude::*;
use wide::f32x8;

use lsfb_perception::image::{Compression, Samples, write_png};
use lsfb_types::{Image, Progress, ProgressFn};

use crate::world::{LANES, RayPacket};
use crate::{Error, Place, RigSim, Simulation};

/// A grey picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Grey values, row by row.
    pub pixels: Vec<u8>,
}

/// Width of one image on a sheet, pixels.
const TILE_PX: usize = 480;
const COLUMNS: usize = 4;
const ROWS: usize = 4;
/// Between the images of a sheet, pixels.
const GAP_PX: usize = 4;
/// Longer edge of a top view, pixels.
const TOP_PX: f64 = 1600.0;
/// Where one looks down from, metres: above all roofs.
const TOP_M: f32 = 60.0;

impl Picture {
    fn new(width: usize, height: usize) -> Self {
        Self {
            width,
            height,
            pixels: vec![24; width * height],
        }
    }

    /// Writes it as PNG.
    pub fn write_png(&self, path: &Path) -> Result<(), Error> {
        let failed = |source: std::io::Error| Error::Write {
            path: path.to_owned(),
            source,
        };
        let file = BufWriter::new(File::create(path).map_err(failed)?);
        let size = (self.width as u32, self.height as u32);
        let samples = Samples::Grey(&self.pixels);
        write_png(file, size, samples, Compression::default()).map_err(failed)
    }

    /// Puts an image, shrunk to a width, at a corner.
    fn paste(&mut self, image: &Image, [left, top]: [usize; 2], width: usize) {
        let (w, h) = (image.width as usize, image.height as usize);
        let height = h * width / w;
        for y in 0..height {
            for x in 0..width {
                // The mean of the pixels that fall on this one.
                let (x0, x1) = (x * w / width, ((x + 1) * w / width).max(x * w / width + 1));
                let (y0, y1) = (
                    y * h / height,
                    ((y + 1) * h / height).max(y * h / height + 1),
                );
                let mut sum = 0_usize;
                for row in y0..y1.min(h) {
                    sum += image.pixels[row * w + x0..row * w + x1.min(w)]
                        .iter()
                        .map(|p| usize::from(*p))
                        .sum::<usize>();
                }
                let count = (x1.min(w) - x0) * (y1.min(h) - y0);
                if let Some(pixel) = self.pixels.get_mut((top + y) * self.width + left + x) {
                    *pixel = (sum / count.max(1)) as u8;
                }
            }
        }
    }
}

/// Sixteen images of a walk, evenly over time, the rig's cameras in turn.
pub fn contact_sheet(
    simulation: &Simulation,
    rig: &RigSim,
    progress: ProgressFn,
) -> Result<Picture, Error> {
    let count = COLUMNS * ROWS;
    let mut sheet = Picture::new(0, 0);
    for k in 0..count {
        progress(Progress {
            stage: "contact sheet",
            done: k as u64,
            total: count as u64,
        })?;
        let camera = k % rig.rig().cameras.len().max(1);
        let frame = (u64::from(rig.frame_count()) * (2 * k as u64 + 1) / (2 * count as u64)) as u32;
        let Some(image) = rig.image(simulation.world(), camera, frame) else {
            continue;
        };
        let image = image.sample;
        let tile = image.height as usize * TILE_PX / image.width as usize;
        if sheet.width == 0 {
            sheet = Picture::new(COLUMNS * (TILE_PX + GAP_PX), ROWS * (tile + GAP_PX));
        }
        let corner = [
            (k % COLUMNS) * (TILE_PX + GAP_PX),
            (k / COLUMNS) * (tile + GAP_PX),
        ];
        sheet.paste(&image, corner, TILE_PX);
    }
    Ok(sheet)
}

/// The place from above, without its ceilings; the scanner's way is white, the second walk's black.
pub fn top_view(simulation: &Simulation) -> Picture {
    let world = simulation.world();
    let [low, high] = match simulation.config().place {
        Place::Demo | Place::Imported => world.extent_m().map(|v| [v[0].into(), v[1].into()]),
        place => [[0.0; 2], place.size_m()],
    };
    let [w, d]: [f64; 2] = std::array::from_fn(|i| high[i] - low[i]);
    let margin = 1.0;
    let scale = TOP_PX / (w.max(d) + 2.0 * margin);
    let width = ((w + 2.0 * margin) * scale) as usize / LANES * LANES;
    let height = ((d + 2.0 * margin) * scale) as usize;
    let mut picture = Picture::new(width, height);
    let moment = world.moment(0.0, [0.0, 1e4]);
    let angle = (1.0 / scale) as f32 / TOP_M;
    picture
        .pixels
        .par_chunks_mut(width)
        .enumerate()
        .for_each(|(row, pixels)| {
            let y = high[1] + margin - (row as f64 + 0.5) / scale;
            for (group, pixels) in pixels.chunks_exact_mut(LANES).enumerate() {
                let x: [f32; LANES] = std::array::from_fn(|lane| {
                    (low[0] + ((group * LANES + lane) as f64 + 0.5) / scale - margin) as f32
                });
                let flat = |v: f32| f32x8::splat(v);
                let rays = RayPacket {
                    origin: crate::world::Origin::Each([
                        f32x8::new(x),
                        flat(y as f32),
                        flat(TOP_M),
                    ]),
                    direction: [flat(1e-7), flat(1e-7), flat(-1.0)],
                };
                for (pixel, seen) in pixels.iter_mut().zip(world.see(&rays, angle, &moment)) {
                    *pixel = seen.value.clamp(0.0, 255.0) as u8;
                }
            }
        });
    for (rig, shade) in [(simulation.scan(), 255), (simulation.glasses(), 0)] {
        for step in 0..(rig.walk().duration_s() * 20.0) as u32 {
            let at = rig
                .walk()
                .at(f64::from(step) * 0.05)
                .world_from_rig
                .translation;
            let x = ((at.x - low[0] + margin) * scale) as usize;
            let y = ((high[1] + margin - at.y) * scale) as usize;
            for (dx, dy) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                if x + dx < width && y + dy < height {
                    picture.pixels[(y + dy) * width + x + dx] = shade;
                }
            }
        }
    }
    picture
}
