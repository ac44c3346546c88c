//! How a facet gets its brightness: a piece of a picture that many facets share, times the light of its own.
//!
//! Pictures and light are held as square roots of reflectance and irradiance, as a camera's gamma shows them, so that
//! their product is the brightness of the image.

use super::light::LightGrid;
use super::patchwork::Patchwork;

/// The look of one facet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skin {
    /// First of its pictures in the atlas.
    pub texture: u32,
    /// Pictures shown in turn; 1 for what does not change.
    pub pictures: u16,
    /// Whether one sees through it.
    pub glass: bool,
    /// Where in the picture one gets along either edge of the facet, in widths and heights of the picture.
    pub edges: [[f32; 2]; 2],
    /// Where in the picture the facet's corner is.
    pub offset: [f32; 2],
    /// How the picture goes on beyond its border.
    pub beyond: Beyond,
    /// Size of a texel as painted over its size on the facet.
    pub zoom: f32,
    /// Factor of the brightness.
    pub gain: f32,
    /// Its light in the [`LightMaps`].
    pub light: u32,
}

/// What is beyond the border of a picture.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Beyond {
    /// Its border: the picture covers the facet.
    Nothing,
    /// The picture again.
    Repeated,
    /// Other parts of the picture.
    Patched(Patchwork),
    /// Not on the facet at all: what lies far behind it.
    Outlook,
    /// The same, as the facet mirrors it.
    Mirrored,
}

impl Skin {
    /// A picture of the facet's own, with the light painted in.
    pub(crate) fn baked(texture: usize) -> Self {
        Self {
            texture: texture as u32,
            pictures: 1,
            glass: false,
            edges: [[1.0, 0.0], [0.0, 1.0]],
            offset: [0.0; 2],
            beyond: Beyond::Nothing,
            zoom: 1.0,
            gain: 1.0,
            light: LightMaps::NONE,
        }
    }

    /// The picture shown at a time, and the place in it; of patches, the place on the surface.
    #[inline]
    pub(crate) fn look_up(&self, a: f32, b: f32, time_s: f64) -> (usize, [f32; 2]) {
        let shown = if self.pictures > 1 {
            // Neighbouring screens do not change at the same moment.
            let phase = f64::from(self.light % 17) * 0.41;
            ((time_s + phase) / SECONDS_PER_PICTURE) as usize % usize::from(self.pictures)
        } else {
            0
        };
        let [along_a, along_b] = self.edges;
        let place = std::array::from_fn(|i| self.offset[i] + a * along_a[i] + b * along_b[i]);
        let place = match self.beyond {
            Beyond::Nothing | Beyond::Patched(_) | Beyond::Outlook | Beyond::Mirrored => place,
            Beyond::Repeated => place.map(|x: f32| x - x.floor()),
        };
        (self.texture as usize + shown, place)
    }
}

/// How long a changing screen shows one picture.
const SECONDS_PER_PICTURE: f64 = 4.0;

/// Light of all facets, as square roots in steps of 1/4096.
#[derive(Clone, Debug, Default)]
pub(crate) struct LightMaps {
    maps: Vec<LightMap>,
    values: Vec<u16>,
}

#[derive(Clone, Copy, Debug)]
struct LightMap {
    first: u32,
    columns: u16,
    rows: u16,
}

const STEP: f32 = 1.0 / 4096.0;

impl LightMaps {
    /// Light that changes nothing.
    pub(crate) const NONE: u32 = u32::MAX;

    /// Appends the light of one facet, `glow` of its own included; its index is the number of grids before it.
    pub(crate) fn push(&mut self, grid: &LightGrid, glow: f32) {
        self.maps.push(LightMap {
            first: self.values.len() as u32,
            columns: grid.columns as u16,
            rows: grid.rows as u16,
        });
        self.values.extend(
            grid.values
                .iter()
                .map(|v| ((v + glow).sqrt() / STEP + 0.5).min(65535.0) as u16),
        );
    }

    /// Square root of the irradiance at `(a, b)`.
    #[inline]
    pub(crate) fn at(&self, map: u32, a: f32, b: f32) -> f32 {
        let Some(map) = self.maps.get(map as usize) else {
            return 1.0;
        };
        let (columns, rows) = (usize::from(map.columns), usize::from(map.rows));
        let first = map.first as usize;
        if columns * rows == 1 {
            return f32::from(self.values[first]) * STEP;
        }
        let x = (a * (columns - 1) as f32).clamp(0.0, (columns - 1) as f32);
        let y = (b * (rows - 1) as f32).clamp(0.0, (rows - 1) as f32);
        let (i, j) = (
            (x as i32 as usize).min(columns - 2),
            (y as i32 as usize).min(rows - 2),
        );
        let (u, v) = (x - i as f32, y - j as f32);
        let k = first + j * columns + i;
        // From the first of the four values to the last.
        let window = &self.values[k..k + columns + 2];
        let row = |left: u16, right: u16| {
            let left = f32::from(left);
            left + u * (f32::from(right) - left)
        };
        let (top, low) = (
            row(window[0], window[1]),
            row(window[columns], window[columns + 1]),
        );
        (top + v * (low - top)) * STEP
    }

    /// Whether there is no light at all.
    pub(crate) fn are_dark(&self) -> bool {
        self.values.iter().all(|value| *value == 0)
    }

    /// Bytes held.
    pub(crate) fn bytes(&self) -> usize {
        self.values.len() * 2 + self.maps.len() * size_of::<LightMap>()
    }
}
