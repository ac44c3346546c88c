//! The 128-dimensional gradient histogram (Lowe, section 6) as RootSIFT bytes.
//!
//! The patch is resampled once, turned upright, at 16 × 16 places (and a margin for the soft borders of the cells).
//! Their weights in the 4 × 4 cells are then the same for every keypoint, and the blur of the level is wide enough
//! for this spacing.

use std::f32::consts::PI;

use super::orientation::fast_atan2;
use super::scale_space::Plane;
use super::{DESCRIPTOR_LEN, Descriptor};

const CELLS: usize = 4;
/// Samples along one side of a cell.
const SAMPLES_PER_CELL: usize = 4;
/// Half a cell more on either side, where samples still count for the outer cells.
const SIDE: usize = (CELLS + 1) * SAMPLES_PER_CELL;
/// Side of a cell in units of the keypoint's blur.
const CELL_SIGMAS: f32 = 3.0;
/// Largest share of one bin in the Euclidean norm: beyond it, it is a glare rather than a shape.
const CLIP: f32 = 0.2;

/// One place of the lattice: its offset and its part in the cells around it.
#[derive(Clone, Copy, Debug)]
struct LatticeSample {
    /// Offsets from the centre in units of the blur.
    u: f32,
    v: f32,
    cells: [(u8, f32); 4],
    count: u8,
}

/// The lattice, made once for all keypoints.
#[derive(Clone, Debug)]
pub(crate) struct Lattice {
    places: Vec<LatticeSample>,
}

impl Lattice {
    pub fn new() -> Self {
        let step = 1.0 / SAMPLES_PER_CELL as f32;
        let mut places = Vec::with_capacity(SIDE * SIDE);
        for row in 0..SIDE {
            for column in 0..SIDE {
                // In units of cells, origin at the patch's centre.
                let centred = |i: usize| (i as f32 + 0.5) * step - 0.5 * (CELLS + 1) as f32;
                let (u, v) = (centred(column), centred(row));
                let window = (-(u * u + v * v) / (2.0 * (0.5 * CELLS as f32).powi(2))).exp();
                let mut place = LatticeSample {
                    u: u * CELL_SIGMAS,
                    v: v * CELL_SIGMAS,
                    cells: [(0, 0.0); 4],
                    count: 0,
                };
                for cell_row in 0..CELLS {
                    for cell_column in 0..CELLS {
                        let middle = |i: usize| i as f32 + 0.5 - 0.5 * CELLS as f32;
                        let near = |d: f32| (1.0 - d.abs()).max(0.0);
                        let share = near(u - middle(cell_column)) * near(v - middle(cell_row));
                        if share > 0.0 && usize::from(place.count) < 4 {
                            let cell = (cell_row * CELLS + cell_column) as u8;
                            place.cells[usize::from(place.count)] = (cell, share * window);
                            place.count += 1;
                        }
                    }
                }
                places.push(place);
            }
        }
        Self { places }
    }

    /// Descriptor of the patch around `(x, y)` of a level with blur `sigma`, turned by `angle`.
    pub fn describe(&self, plane: &Plane, x: f32, y: f32, sigma: f32, angle: f32) -> Descriptor {
        let (sin, cos) = angle.sin_cos();
        let mut along = [0.0f32; SIDE * SIDE];
        let mut across = [0.0f32; SIDE * SIDE];
        for ((along, across), place) in along.iter_mut().zip(&mut across).zip(&self.places) {
            let px = x + sigma * (cos * place.u - sin * place.v);
            let py = y + sigma * (sin * place.u + cos * place.v);
            if let Some([dx, dy]) = gradient(plane, px, py) {
                *along = cos * dx + sin * dy;
                *across = cos * dy - sin * dx;
            }
        }
        // Whole arrays at a time, so that the compiler takes several lanes at once.
        let mut magnitudes = [0.0f32; SIDE * SIDE];
        let mut positions = [0.0f32; SIDE * SIDE];
        for i in 0..SIDE * SIDE {
            magnitudes[i] = (along[i] * along[i] + across[i] * across[i]).sqrt();
            positions[i] = 8.0 + fast_atan2(across[i], along[i]) * (8.0 / (2.0 * PI));
        }
        // One bin more per cell takes what goes round from the last to the first.
        let mut cells = [[0.0f32; 9]; CELLS * CELLS];
        for (place, (magnitude, position)) in
            self.places.iter().zip(magnitudes.iter().zip(&positions))
        {
            let low = *position as usize;
            let high_part = magnitude * (position - low as f32);
            let low_part = magnitude - high_part;
            for (cell, weight) in &place.cells[..usize::from(place.count)] {
                let bins = &mut cells[usize::from(*cell) & 15];
                bins[low & 7] += low_part * weight;
                bins[(low & 7) + 1] += high_part * weight;
            }
        }
        let mut histogram = [0.0f32; DESCRIPTOR_LEN];
        for (to, bins) in histogram.chunks_exact_mut(8).zip(&cells) {
            to.copy_from_slice(&bins[..8]);
            to[0] += bins[8];
        }
        root_sift(&mut histogram)
    }
}

/// Gradient between pixels: bilinear mean of the central differences of the four pixels around. `None` at the border.
fn gradient(plane: &Plane, x: f32, y: f32) -> Option<[f32; 2]> {
    if !(x >= 1.0 && y >= 1.0) {
        return None;
    }
    let (column, row) = (x as usize, y as usize);
    if column + 2 >= plane.width || row + 2 >= plane.height {
        return None;
    }
    let (fx, fy) = (x - column as f32, y - row as f32);
    let width = plane.width;
    let start = (row - 1) * width + column - 1;
    let r0 = &plane.values[start..start + 4];
    let r1 = &plane.values[start + width..start + width + 4];
    let r2 = &plane.values[start + 2 * width..start + 2 * width + 4];
    let r3 = &plane.values[start + 3 * width..start + 3 * width + 4];
    let dx_top = (r1[2] - r1[0]) * (1.0 - fx) + (r1[3] - r1[1]) * fx;
    let dx_bottom = (r2[2] - r2[0]) * (1.0 - fx) + (r2[3] - r2[1]) * fx;
    let dy_left = (r2[1] - r0[1]) * (1.0 - fy) + (r3[1] - r1[1]) * fy;
    let dy_right = (r2[2] - r0[2]) * (1.0 - fy) + (r3[2] - r1[2]) * fy;
    Some([
        dx_top * (1.0 - fy) + dx_bottom * fy,
        dy_left * (1.0 - fx) + dy_right * fx,
    ])
}

/// Clips, normalises to sum 1, takes the root and quantises.
fn root_sift(histogram: &mut [f32; DESCRIPTOR_LEN]) -> Descriptor {
    let norm = histogram.iter().map(|v| v * v).sum::<f32>().sqrt();
    let clip = CLIP * norm;
    let mut sum = 0.0;
    for v in histogram.iter_mut() {
        *v = v.min(clip);
        sum += *v;
    }
    let scale = if sum > 0.0 { 1.0 / sum } else { 0.0 };
    histogram.map(|v| ((v * scale).sqrt() * 512.0).round().min(255.0) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn turning_the_image_leaves_the_descriptor() {
        let value = |x: f32, y: f32| (0.21 * x).sin() * (0.17 * y + 0.5).cos() + 0.002 * x * y;
        let lattice = Lattice::new();
        let describe = |angle: f32| {
            let mut plane = Plane::default();
            plane.resize(121, 121);
            for y in 0..121 {
                for x in 0..121 {
                    let (dx, dy) = (x as f32 - 60.0, y as f32 - 60.0);
                    let (u, v) = (
                        angle.cos() * dx + angle.sin() * dy,
                        -angle.sin() * dx + angle.cos() * dy,
                    );
                    plane.values[y * 121 + x] = value(u, v);
                }
            }
            lattice.describe(&plane, 60.0, 60.0, 2.0, angle)
        };
        let upright = describe(0.0);
        for degrees in [30.0f32, 90.0, -135.0] {
            let turned = describe(degrees.to_radians());
            let distance: i32 = upright
                .iter()
                .zip(&turned)
                .map(|(a, b)| (i32::from(*a) - i32::from(*b)).pow(2))
                .sum();
            assert!(distance < 3000, "{degrees}: {distance}");
        }
    }
}
