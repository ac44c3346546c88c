use lsfb_geometry::Vector2;

use super::Keypoint;

/// Keypoints of one image by place, to find those near a predicted pixel.
#[derive(Clone, Debug)]
pub struct KeypointGrid {
    cell_px: f64,
    columns: usize,
    rows: usize,
    /// Where each cell's keypoints begin in `members`, and where the last ones end.
    starts: Vec<u32>,
    members: Vec<u32>,
    pixels: Vec<[f32; 2]>,
}

impl KeypointGrid {
    /// Sorts the keypoints of an image of this size into cells of `cell_px`, best about the search radius.
    pub fn new(keypoints: &[Keypoint], width: u32, height: u32, cell_px: f64) -> Self {
        let cell_px = cell_px.max(1.0);
        let columns = (f64::from(width) / cell_px).ceil().max(1.0) as usize;
        let rows = (f64::from(height) / cell_px).ceil().max(1.0) as usize;
        let cell_of = |k: &Keypoint| {
            let index =
                |v: f32, count: usize| ((f64::from(v).max(0.0) / cell_px) as usize).min(count - 1);
            index(k.pixel[1], rows) * columns + index(k.pixel[0], columns)
        };
        let mut starts = vec![0u32; columns * rows + 1];
        for k in keypoints {
            starts[cell_of(k) + 1] += 1;
        }
        for cell in 0..columns * rows {
            starts[cell + 1] += starts[cell];
        }
        let mut next = starts.clone();
        let mut members = vec![0u32; keypoints.len()];
        for (index, k) in keypoints.iter().enumerate() {
            let slot = &mut next[cell_of(k)];
            members[*slot as usize] = index as u32;
            *slot += 1;
        }
        Self {
            cell_px,
            columns,
            rows,
            starts,
            members,
            pixels: keypoints.iter().map(|k| k.pixel).collect(),
        }
    }

    /// Indices of the keypoints within `radius_px` of `pixel`, cell by cell.
    pub fn within(&self, pixel: &Vector2<f64>, radius_px: f64) -> impl Iterator<Item = u32> + '_ {
        let clamp =
            |v: f64, count: usize| ((v / self.cell_px).floor().max(0.0) as usize).min(count - 1);
        let (left, right) = (
            clamp(pixel.x - radius_px, self.columns),
            clamp(pixel.x + radius_px, self.columns),
        );
        let (top, bottom) = (
            clamp(pixel.y - radius_px, self.rows),
            clamp(pixel.y + radius_px, self.rows),
        );
        let pixel = *pixel;
        (top..=bottom)
            .flat_map(move |row| {
                let from = self.starts[row * self.columns + left] as usize;
                let to = self.starts[row * self.columns + right + 1] as usize;
                self.members[from..to].iter().copied()
            })
            .filter(move |index| {
                let [x, y] = self.pixels[*index as usize];
                let (dx, dy) = (f64::from(x) - pixel.x, f64::from(y) - pixel.y);
                dx * dx + dy * dy <= radius_px * radius_px
            })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn finds_what_a_full_search_finds() {
        let keypoints: Vec<Keypoint> = (0..400u32)
            .map(|i| Keypoint {
                pixel: [(i * 7919 % 640) as f32, (i * 104_729 % 400) as f32],
                scale_px: 1.0,
                angle_rad: 0.0,
                response: 1.0,
            })
            .collect();
        let grid = KeypointGrid::new(&keypoints, 640, 400, 16.0);
        for (x, y, radius) in [
            (320.0, 200.0, 40.0),
            (-5.0, 3.0, 30.0),
            (700.0, 390.0, 90.0),
        ] {
            let centre = Vector2::new(x, y);
            let mut found: Vec<u32> = grid.within(&centre, radius).collect();
            found.sort_unstable();
            let expected: Vec<u32> = (0..400)
                .filter(|i| (keypoints[*i as usize].pixel_f64() - centre).norm() <= radius)
                .collect();
            assert_eq!(found, expected);
        }
    }
}
