//! What surfaces look like. One recipe with parameters; the presets are the building's materials.

use super::april_grid;
use super::canvas::{Canvas, Leaves};
use super::grain::Grain;
use super::substance::Substance;
use crate::noise::{Dice, below, stream, uniform};

/// Marks painted over the ground of a surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Marks {
    None,
    /// Lines of letter-like strokes of this height, metres.
    Text(f32),
    /// A picture: shapes of all tones inside a margin of this width, metres, a headline and lines of text.
    Poster(f32),
    /// Boards or tiles of this size, each with its own tone.
    Boards([f32; 2]),
    /// Bands across and a title along, as on the spine of a book.
    Spine,
    /// Panels as on a door or a cupboard, drawn as lines this far inside the border.
    Panel(f32),
    /// A grid of AprilTags with tags of this edge, metres.
    AprilGrid(f32),
    /// An arrow, a figure and a line of large text, as on a sign.
    Sign,
}

/// How a surface is painted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Material {
    /// Mean reflectance.
    pub tone: f32,
    /// Amplitude of the noise in each octave.
    pub noise: f32,
    /// Longest wavelength of the noise, metres.
    pub longest_m: f32,
    /// Grain: how much longer the noise is along `a` and `b`.
    pub stretch: [f32; 2],
    /// Share of the area covered by shapes of each size, 0 for none.
    pub coverage: f32,
    /// Spread of the shapes' tones around `tone`.
    pub spread: f32,
    /// Largest shape, metres.
    pub largest_m: f32,
    pub marks: Marks,
    /// Whether light from the lamps is added by the surface itself (lamps, windows, screens).
    pub glow: f32,
    /// In baked light: mean luminance of what shines, cd/m².
    pub luminance_cd_m2: f32,
    /// In baked light: how much of what a smooth surface would mirror it does mirror, 0–1.
    pub gloss: f32,
    /// Pictures shown in turn; 1 for what does not change.
    pub pictures: u16,
    /// Whether one sees through it.
    pub glass: bool,
    /// Texels are this many times larger than elsewhere.
    pub coarseness: f32,
    /// What it is made of.
    pub substance: Substance,
    /// What it is like close by, in the detailed look.
    pub grain: Grain,
}

pub(super) const PLAIN: Material = Material {
    tone: 0.5,
    noise: 0.015,
    longest_m: 0.3,
    stretch: [1.0, 1.0],
    coverage: 0.0,
    spread: 0.0,
    largest_m: 0.05,
    marks: Marks::None,
    glow: 0.0,
    luminance_cd_m2: 0.0,
    gloss: 0.0,
    pictures: 1,
    glass: false,
    coarseness: 1.0,
    substance: Substance::Board,
    grain: Grain::None,
};

impl Material {
    pub(crate) const WALLPAPER: Self = Self {
        tone: 0.62,
        noise: 0.018,
        longest_m: 0.6,
        coverage: 0.13,
        spread: 0.25,
        largest_m: 0.08,
        ..PLAIN
    };
    pub(crate) const PLASTER: Self = Self {
        tone: 0.66,
        noise: 0.016,
        longest_m: 0.8,
        coverage: 0.08,
        spread: 0.2,
        largest_m: 0.06,
        grain: Grain::Plaster,
        ..PLAIN
    };
    pub(crate) const CEILING: Self = Self {
        tone: 0.72,
        noise: 0.012,
        coverage: 0.06,
        spread: 0.3,
        largest_m: 0.02,
        marks: Marks::Boards([0.6, 0.6]),
        grain: Grain::Fibreboard,
        ..PLAIN
    };
    pub(crate) const PARQUET: Self = Self {
        tone: 0.4,
        noise: 0.02,
        longest_m: 0.2,
        stretch: [6.0, 1.0],
        coverage: 0.05,
        spread: 0.25,
        largest_m: 0.02,
        marks: Marks::Boards([0.5, 0.08]),
        gloss: 0.4,
        substance: Substance::Wood,
        grain: Grain::Wood,
        ..PLAIN
    };
    pub(crate) const LINOLEUM: Self = Self {
        tone: 0.42,
        noise: 0.02,
        coverage: 0.12,
        spread: 0.24,
        largest_m: 0.05,
        marks: Marks::Boards([0.5, 0.5]),
        gloss: 0.6,
        grain: Grain::Stone,
        ..PLAIN
    };
    pub(crate) const WOOD: Self = Self {
        tone: 0.42,
        noise: 0.028,
        longest_m: 0.15,
        stretch: [8.0, 1.0],
        coverage: 0.03,
        spread: 0.2,
        largest_m: 0.015,
        substance: Substance::Wood,
        grain: Grain::Wood,
        ..PLAIN
    };
    pub(crate) const CUPBOARD: Self = Self {
        tone: 0.5,
        noise: 0.02,
        stretch: [1.0, 6.0],
        coverage: 0.03,
        spread: 0.25,
        largest_m: 0.02,
        marks: Marks::Panel(0.03),
        substance: Substance::Wood,
        grain: Grain::Wood,
        ..PLAIN
    };
    pub(crate) const FABRIC: Self = Self {
        tone: 0.35,
        noise: 0.02,
        coverage: 0.15,
        spread: 0.25,
        largest_m: 0.06,
        substance: Substance::Soft,
        grain: Grain::Cloth,
        ..PLAIN
    };
    pub(crate) const RUG: Self = Self {
        tone: 0.35,
        noise: 0.02,
        coverage: 0.3,
        spread: 0.28,
        largest_m: 0.16,
        substance: Substance::Soft,
        ..PLAIN
    };
    pub(crate) const POSTER: Self = Self {
        tone: 0.6,
        noise: 0.012,
        coverage: 0.35,
        spread: 0.45,
        largest_m: 0.18,
        marks: Marks::Poster(0.03),
        substance: Substance::Soft,
        ..PLAIN
    };
    pub(crate) const PAPER: Self = Self {
        tone: 0.8,
        noise: 0.008,
        marks: Marks::Text(0.016),
        substance: Substance::Soft,
        ..PLAIN
    };
    pub(crate) const CORK: Self = Self {
        tone: 0.36,
        noise: 0.03,
        coverage: 0.12,
        spread: 0.14,
        largest_m: 0.015,
        grain: Grain::Aggregate,
        ..PLAIN
    };
    pub(crate) const METAL: Self = Self {
        tone: 0.3,
        noise: 0.02,
        stretch: [1.0, 5.0],
        coverage: 0.04,
        spread: 0.25,
        largest_m: 0.02,
        substance: Substance::Metal,
        grain: Grain::Metal,
        ..PLAIN
    };
    pub(crate) const BOOK: Self = Self {
        tone: 0.45,
        noise: 0.012,
        longest_m: 0.1,
        marks: Marks::Spine,
        substance: Substance::Soft,
        ..PLAIN
    };
    pub(crate) const PACKAGE: Self = Self {
        tone: 0.5,
        noise: 0.015,
        coverage: 0.2,
        spread: 0.3,
        largest_m: 0.05,
        marks: Marks::Text(0.02),
        ..PLAIN
    };
    pub(crate) const LEAF: Self = Self {
        tone: 0.25,
        noise: 0.03,
        longest_m: 0.05,
        coverage: 0.1,
        spread: 0.15,
        largest_m: 0.02,
        substance: Substance::Leaves,
        grain: Grain::Leaves,
        ..PLAIN
    };
    pub(crate) const LAMP: Self = Self {
        tone: 0.9,
        noise: 0.01,
        glow: 1.6,
        luminance_cd_m2: 4000.0,
        ..PLAIN
    };
    pub(crate) const WINDOW: Self = Self {
        tone: 0.6,
        noise: 0.02,
        longest_m: 0.8,
        coverage: 0.25,
        spread: 0.35,
        largest_m: 0.25,
        glow: 0.9,
        luminance_cd_m2: 3000.0,
        gloss: 1.0,
        ..PLAIN
    };
    pub(crate) const SCREEN: Self = Self {
        tone: 0.3,
        noise: 0.01,
        coverage: 0.2,
        spread: 0.3,
        largest_m: 0.12,
        marks: Marks::Text(0.018),
        glow: 0.5,
        luminance_cd_m2: 120.0,
        gloss: 0.7,
        ..PLAIN
    };

    pub(crate) const fn toned(self, tone: f32) -> Self {
        Self { tone, ..self }
    }

    pub(crate) const fn marked(self, marks: Marks) -> Self {
        Self { marks, ..self }
    }

    /// Grain along the other axis.
    pub(crate) const fn turned(self) -> Self {
        Self {
            stretch: [self.stretch[1], self.stretch[0]],
            ..self
        }
    }

    /// Paints a surface of this material; `seed` tells apart what is of one material.
    pub(crate) fn paint(&self, size_m: [f32; 2], texel_m: f32, seed: u64) -> Canvas {
        let rng = stream(seed, "material", 0);
        let mut canvas = Canvas::new(size_m, texel_m, self.tone);
        if let Marks::Boards(board_m) = self.marks {
            let joint = (0.0015, 0.5 * self.tone);
            boards(&mut canvas, board_m, self.tone, [0.8, 1.2], joint, &rng);
        }
        let inset = match self.marks {
            Marks::Poster(margin_m) => margin_m,
            _ => 0.0,
        };
        if self.coverage > 0.0 {
            canvas.scatter(
                &Leaves {
                    coverage: self.coverage,
                    largest_m: self.largest_m,
                    smallest_m: 0.003,
                    tones: [
                        (self.tone - self.spread).max(0.04),
                        (self.tone + self.spread).min(0.92),
                    ],
                },
                &rng,
            );
        }
        match self.marks {
            Marks::None | Marks::Boards(_) => {}
            Marks::Text(height_m) => {
                let [w, h] = canvas.size_m();
                let ink = if self.tone > 0.4 { 0.08 } else { 0.8 };
                let margin = 0.06 * w.min(h);
                text(
                    &mut canvas,
                    [margin; 2],
                    [w - margin, h - margin],
                    height_m,
                    ink,
                    &rng,
                );
            }
            Marks::Poster(_) => poster(&mut canvas, inset, &rng),
            Marks::Spine => spine(&mut canvas, self.tone, &rng),
            Marks::Panel(margin_m) => panel(&mut canvas, margin_m, self.tone),
            Marks::AprilGrid(tag_m) => april_grid::paint(&mut canvas, tag_m),
            Marks::Sign => sign(&mut canvas, self.tone, &rng),
        }
        canvas.add_noise(self.noise, self.longest_m, self.stretch, seed);
        for value in &mut canvas.values {
            *value = value.clamp(0.02, 0.95);
        }
        canvas
    }
}

/// Rows of boards, every row shifted: their tones are `tones` times `tone`; joints of half a width, metres, and a tone.
pub(super) fn boards(
    canvas: &mut Canvas,
    board_m: [f32; 2],
    tone: f32,
    tones: [f32; 2],
    (joint, joint_tone): (f32, f32),
    rng: &Dice,
) {
    let [w, h] = canvas.size_m();
    canvas.values.fill(joint_tone);
    let mut y = 0.0;
    while y < h {
        let mut x = if board_m[0] > 2.0 * board_m[1] {
            -uniform(rng, 0.0, board_m[0])
        } else {
            0.0
        };
        while x < w {
            let shade = tone * uniform(rng, tones[0], tones[1]);
            canvas.rectangle(
                [x + joint, y + joint],
                [x + board_m[0] - joint, y + board_m[1] - joint],
                shade,
            );
            x += board_m[0];
        }
        y += board_m[1];
    }
}

/// Lines of made-up letters: each one to four strokes between the nine points of a grid.
fn text(canvas: &mut Canvas, low: [f32; 2], high: [f32; 2], height_m: f32, ink: f32, rng: &Dice) {
    let mut y = low[1];
    while y + height_m <= high[1] {
        let mut x = low[0];
        let end = low[0] + (high[0] - low[0]) * uniform(rng, 0.55, 1.0);
        while x + 0.6 * height_m <= end {
            if below(rng, 6) > 0 {
                let mut at = [below(rng, 3), below(rng, 3)];
                for _ in 0..1 + below(rng, 4) {
                    let next = [below(rng, 3), below(rng, 3)];
                    let place = |g: [usize; 2]| {
                        [
                            x + g[0] as f32 * 0.25 * height_m,
                            y + (0.1 + g[1] as f32 * 0.4) * height_m,
                        ]
                    };
                    canvas.stroke(place(at), place(next), 0.13 * height_m, ink);
                    at = next;
                }
            }
            x += 0.72 * height_m;
        }
        y += 1.55 * height_m;
    }
}

fn poster(canvas: &mut Canvas, margin: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let paper = uniform(rng, 0.7, 0.88);
    let band = uniform(rng, 0.15, 0.3) * h;
    let top = if below(rng, 2) == 0 { 0.0 } else { h - band };
    // A white margin around the picture, and a band of text above or below it.
    canvas.rectangle([0.0, 0.0], [margin, h], paper);
    canvas.rectangle([w - margin, 0.0], [w, h], paper);
    canvas.rectangle([0.0, 0.0], [w, margin], paper);
    canvas.rectangle([0.0, h - margin], [w, h], paper);
    canvas.rectangle([0.0, top], [w, top + band], paper);
    let head = 0.3 * band;
    text(
        canvas,
        [2.0 * margin, top + margin],
        [w - 2.0 * margin, top + margin + head],
        head,
        0.06,
        rng,
    );
    text(
        canvas,
        [2.0 * margin, top + margin + 1.3 * head],
        [w - 2.0 * margin, top + band - margin],
        0.022,
        0.1,
        rng,
    );
}

fn spine(canvas: &mut Canvas, tone: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let ink = if tone > 0.4 { 0.06 } else { 0.85 };
    for _ in 0..1 + below(rng, 4) {
        let y = uniform(rng, 0.0, h);
        let shade = uniform(rng, 0.1, 0.85);
        canvas.rectangle([0.0, y], [w, y + uniform(rng, 0.004, 0.03)], shade);
    }
    let mut y = uniform(rng, 0.1, 0.3) * h;
    while y < 0.8 * h {
        // One letter after another down the spine.
        for _ in 0..2 + below(rng, 2) {
            let from = [uniform(rng, 0.25, 0.75) * w, y + uniform(rng, 0.0, 0.5 * w)];
            let to = [uniform(rng, 0.25, 0.75) * w, y + uniform(rng, 0.0, 0.5 * w)];
            canvas.stroke(from, to, 0.1 * w, ink);
        }
        y += 0.65 * w.max(0.01);
    }
}

/// An arrow at one end, a figure of strokes, and a line of large text.
fn sign(canvas: &mut Canvas, tone: f32, rng: &Dice) {
    let [w, h] = canvas.size_m();
    let ink = if tone > 0.4 { 0.05 } else { 0.9 };
    let (middle, reach) = (0.5 * h, 0.3 * h);
    let tip = 0.12 * w;
    canvas.stroke([tip, middle], [tip + 1.6 * reach, middle], 0.12 * h, ink);
    for side in [-1.0, 1.0] {
        let end = [tip + 0.7 * reach, middle + side * 0.7 * reach];
        canvas.stroke([tip, middle], end, 0.12 * h, ink);
    }
    let low = [tip + 2.4 * reach, 0.22 * h];
    text(canvas, low, [0.96 * w, 0.86 * h], 0.55 * h, ink, rng);
}

pub(super) fn panel(canvas: &mut Canvas, margin: f32, tone: f32) {
    let [w, h] = canvas.size_m();
    let (low, high) = ([margin, margin], [w - margin, h - margin]);
    let (dark, light) = (0.35 * tone, (1.4 * tone).min(0.9));
    for (offset, shade) in [(0.0, dark), (0.008, light)] {
        let (l, t) = (low[0] + offset, low[1] + offset);
        let (r, b) = (high[0] - offset, high[1] - offset);
        for (from, to) in [
            ([l, t], [r, t]),
            ([r, t], [r, b]),
            ([r, b], [l, b]),
            ([l, b], [l, t]),
        ] {
            canvas.stroke(from, to, 0.006, shade);
        }
    }
}
