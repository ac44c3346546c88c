//! What surfaces are like close by: fibres, weave, pores, blades of grass, wear and scratches.

use super::canvas::Canvas;
use crate::noise::{Dice, below, hash, stream, uniform, unit};

/// How a material is built.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Grain {
    /// As painted by its shapes and noise.
    None,
    /// Fibres along the grain, rings, knots.
    Wood,
    /// Tufts in rows, worn where people walk.
    Carpet,
    /// A fine relief, scuffs, few holes.
    Plaster,
    /// Fine holes.
    Fibreboard,
    /// Pores, stains, cracks.
    Concrete,
    /// Mortar between bricks, each brick with a face of its own.
    Brick,
    /// Veins and speckles.
    Stone,
    /// Small stones in something dark, or grit.
    Aggregate,
    /// Blades in all directions.
    Grass,
    /// Leaves before the dark between them.
    Leaves,
    /// Brushed, with scratches.
    Metal,
    /// Woven threads, folds, stripes on some.
    Cloth,
    /// What is seen of the world outside, far away.
    Outlook,
}

impl Grain {
    /// Range of the tones of boards or tiles, compared to the mean; width of the joint, metres, and its tone.
    pub(crate) fn boards(self) -> ([f32; 2], f32, f32) {
        match self {
            Self::Fibreboard => ([0.97, 1.03], 0.003, 0.6),
            Self::Carpet => ([0.95, 1.05], 0.0008, 0.8),
            Self::Brick => ([0.7, 1.3], 0.006, 1.5),
            Self::Stone => ([0.9, 1.1], 0.0015, 0.6),
            Self::Wood => ([0.75, 1.25], 0.001, 0.45),
            Self::Aggregate => ([0.88, 1.12], 0.004, 0.6),
            _ => ([0.94, 1.06], 0.002, 0.6),
        }
    }

    /// Works it into a picture, whose mean becomes `tone` again; `stretch` says along which of its sides the grain runs.
    pub(crate) fn work(self, canvas: &mut Canvas, tone: f32, stretch: [f32; 2], seed: u64) {
        let rng = stream(seed, "grain", 0);
        match self {
            Self::None | Self::Outlook => return,
            Self::Wood => wood(canvas, stretch, &rng),
            Self::Carpet => carpet(canvas, &rng),
            Self::Plaster => plaster(canvas, &rng),
            Self::Fibreboard => dots(canvas, 260.0, [0.002, 0.005], [0.45, 0.75], &rng),
            Self::Concrete => concrete(canvas, &rng),
            Self::Brick => {
                speckle(canvas, 0.16, rng.bits());
                patches(canvas, 0.12, 0.25, [1.0, 1.0], &rng);
                dots(canvas, 90.0, [0.002, 0.006], [0.5, 0.8], &rng);
            }
            Self::Stone => stone(canvas, &rng),
            Self::Aggregate => {
                patches(canvas, 0.12, 1.6, [1.0, 1.0], &rng);
                dots(canvas, 500.0, [0.003, 0.009], [0.5, 1.9], &rng);
                cracks(canvas, 0.06, &rng);
                speckle(canvas, 0.2, rng.bits());
            }
            Self::Grass => blades(canvas, &rng),
            Self::Leaves => leaves(canvas, &rng),
            Self::Metal => {
                let along = match stretch[0] > stretch[1] {
                    true => [24.0, 1.0],
                    false => [1.0, 24.0],
                };
                patches(canvas, 0.07, 0.02, along, &rng);
                patches(canvas, 0.08, 0.5, [1.0, 1.0], &rng);
                scratches(canvas, 3.0, 1.5, &rng);
            }
            Self::Cloth => cloth(canvas, &rng),
        }
        let mean = canvas.values.iter().sum::<f32>() / canvas.values.len() as f32;
        let factor = tone / mean.max(1e-3);
        for value in &mut canvas.values {
            *value *= factor;
        }
    }
}

/// Fractal noise over the picture, about ±1.
fn field(canvas: &Canvas, longest_m: f32, stretch: [f32; 2], seed: u64) -> Vec<f32> {
    let mut noise = Canvas {
        values: vec![0.0; canvas.values.len()],
        ..*canvas
    };
    let texel_m = canvas.texel_m[0].min(canvas.texel_m[1]);
    let octaves = (longest_m / texel_m).log2().clamp(1.0, 10.0);
    noise.add_noise(1.6 / octaves.sqrt(), longest_m, stretch, seed);
    noise.values
}

/// Brighter and darker by a share, in patches of all sizes.
fn patches(canvas: &mut Canvas, share: f32, longest_m: f32, stretch: [f32; 2], rng: &Dice) {
    let noise = field(canvas, longest_m, stretch, rng.bits());
    for (value, noise) in canvas.values.iter_mut().zip(noise) {
        *value *= (1.0 + share * noise).max(0.1);
    }
}

/// Each texel by itself.
fn speckle(canvas: &mut Canvas, share: f32, seed: u64) {
    for (k, value) in canvas.values.iter_mut().enumerate() {
        let draw = unit(hash(seed ^ k as u64)) as f32;
        *value *= 1.0 + share * (2.0 * draw - 1.0);
    }
}

/// So many things on a square metre, each at its place.
fn strew(canvas: &mut Canvas, per_m2: f32, rng: &Dice, mut put: impl FnMut(&mut Canvas, [f32; 2])) {
    let [w, h] = canvas.size_m();
    for _ in 0..(per_m2 * w * h + uniform(rng, 0.0, 1.0)) as usize {
        let place = [uniform(rng, 0.0, w), uniform(rng, 0.0, h)];
        put(canvas, place);
    }
}

/// Tone at a place.
fn tone_at(canvas: &Canvas, [x, y]: [f32; 2]) -> f32 {
    let column = ((x / canvas.texel_m[0]) as usize).min(canvas.width - 1);
    let row = ((y / canvas.texel_m[1]) as usize).min(canvas.height - 1);
    canvas.values[row * canvas.width + column]
}

fn dots(canvas: &mut Canvas, per_m2: f32, radii_m: [f32; 2], shares: [f32; 2], rng: &Dice) {
    strew(canvas, per_m2, rng, |canvas, place| {
        // Many small ones, few large ones.
        let draw = uniform(rng, 0.0, 1.0);
        let r = radii_m[0] + (radii_m[1] - radii_m[0]) * draw * draw * draw;
        let tone = tone_at(canvas, place) * uniform(rng, shares[0], shares[1]);
        let axes = [r, r * uniform(rng, 0.6, 1.0)];
        canvas.ellipse(place, axes, uniform(rng, 0.0, 3.1), tone.min(0.92));
    });
}

fn scratches(canvas: &mut Canvas, per_m2: f32, share: f32, rng: &Dice) {
    strew(canvas, per_m2, rng, |canvas, from| {
        let (angle, length) = (uniform(rng, 0.0, 6.3), uniform(rng, 0.02, 0.3));
        let to = [
            from[0] + length * angle.cos(),
            from[1] + length * angle.sin(),
        ];
        let tone = (share * tone_at(canvas, from)).min(0.92);
        canvas.stroke(from, to, uniform(rng, 0.0008, 0.003), tone);
    });
}

fn cracks(canvas: &mut Canvas, per_m2: f32, rng: &Dice) {
    strew(canvas, per_m2, rng, |canvas, mut at| {
        let mut angle = uniform(rng, 0.0, 6.3);
        for _ in 0..20 + below(rng, 40) {
            angle += uniform(rng, -0.5, 0.5);
            let next = [at[0] + 0.03 * angle.cos(), at[1] + 0.03 * angle.sin()];
            canvas.stroke(at, next, 0.002, 0.35 * tone_at(canvas, at));
            at = next;
        }
    });
}

fn stains(canvas: &mut Canvas, per_m2: f32, share: f32, rng: &Dice) {
    strew(canvas, per_m2, rng, |canvas, place| {
        let tone = share * tone_at(canvas, place);
        let r = uniform(rng, 0.01, 0.07);
        for _ in 0..4 {
            let centre = [0, 1].map(|i| place[i] + uniform(rng, -0.6, 0.6) * r);
            let axes = [r * uniform(rng, 0.3, 1.0), r * uniform(rng, 0.3, 0.8)];
            canvas.ellipse(centre, axes, uniform(rng, 0.0, 3.1), tone);
        }
    });
}

fn wood(canvas: &mut Canvas, stretch: [f32; 2], rng: &Dice) {
    let is_along_a = stretch[0] >= stretch[1];
    let along = |n: f32| if is_along_a { [n, 1.0] } else { [1.0, n] };
    let warp = field(canvas, 0.25, along(8.0), rng.bits());
    let fibres = field(canvas, 0.012, along(30.0), rng.bits());
    let ring_m = uniform(rng, 0.014, 0.035);
    let (width, texel_m) = (canvas.width, canvas.texel_m);
    for (k, value) in canvas.values.iter_mut().enumerate() {
        let across_m = match is_along_a {
            true => (k / width) as f32 * texel_m[1],
            false => (k % width) as f32 * texel_m[0],
        };
        let phase = across_m / ring_m + 1.6 * warp[k];
        // Late wood is narrow and dark.
        let ring = (phase - phase.floor()).powi(3);
        *value *= (1.0 - 0.28 * ring + 0.1 * fibres[k] + 0.06 * warp[k]).max(0.1);
    }
    strew(canvas, 0.7, rng, |canvas, place| {
        let tone = tone_at(canvas, place);
        for (r, share) in [(0.02, 0.75), (0.012, 0.5), (0.006, 0.3)] {
            let axes = if is_along_a {
                [1.8 * r, r]
            } else {
                [r, 1.8 * r]
            };
            canvas.ellipse(place, axes, 0.0, share * tone);
        }
    });
    scratches(canvas, 1.0, 1.35, rng);
}

fn carpet(canvas: &mut Canvas, rng: &Dice) {
    let seed = rng.bits();
    // Tufts in rows, rows of one colour side by side; every tile is laid the other way.
    canvas.vary(|x, y, value| {
        let turned = ((x / 0.5) as i32 + (y / 0.5) as i32) % 2 == 0;
        let across = if turned { x } else { y };
        let row = hash(seed ^ (across / 0.012) as u64 ^ (u64::from(turned) << 40));
        value * (0.84 + 0.32 * unit(row) as f32)
    });
    patches(canvas, 0.08, 1.6, [1.0, 1.0], rng);
    stains(canvas, 0.25, 0.75, rng);
    speckle(canvas, 0.3, rng.bits());
}

fn plaster(canvas: &mut Canvas, rng: &Dice) {
    patches(canvas, 0.022, 1.6, [1.0, 1.0], rng);
    patches(canvas, 0.02, 0.012, [1.0, 1.0], rng);
    speckle(canvas, 0.012, rng.bits());
    scratches(canvas, 0.8, 0.86, rng);
    stains(canvas, 0.12, 0.93, rng);
    dots(canvas, 0.6, [0.002, 0.004], [0.25, 0.5], rng);
}

fn concrete(canvas: &mut Canvas, rng: &Dice) {
    patches(canvas, 0.12, 1.6, [1.0, 1.0], rng);
    stains(canvas, 0.4, 0.86, rng);
    dots(canvas, 60.0, [0.002, 0.009], [0.35, 0.7], rng);
    cracks(canvas, 0.08, rng);
    speckle(canvas, 0.06, rng.bits());
}

fn stone(canvas: &mut Canvas, rng: &Dice) {
    patches(canvas, 0.1, 0.3, [1.0, 1.0], rng);
    strew(canvas, 3.0, rng, |canvas, mut at| {
        let mut angle = 0.6 + uniform(rng, -0.5, 0.5);
        let light = uniform(rng, 0.8, 1.35);
        for _ in 0..6 + below(rng, 16) {
            angle += uniform(rng, -0.35, 0.35);
            let next = [at[0] + 0.025 * angle.cos(), at[1] + 0.025 * angle.sin()];
            let tone = (light * tone_at(canvas, at)).min(0.9);
            canvas.stroke(at, next, uniform(rng, 0.001, 0.005), tone);
            at = next;
        }
    });
    speckle(canvas, 0.08, rng.bits());
}

fn blades(canvas: &mut Canvas, rng: &Dice) {
    patches(canvas, 0.25, 1.6, [1.0, 1.0], rng);
    strew(canvas, 420.0, rng, |canvas, from| {
        let (angle, length) = (uniform(rng, 0.0, 6.3), uniform(rng, 0.02, 0.07));
        let to = [
            from[0] + length * angle.cos(),
            from[1] + length * angle.sin(),
        ];
        let share = uniform(rng, 0.45, 1.8);
        let tone = (share * tone_at(canvas, from)).clamp(0.03, 0.7);
        canvas.stroke(from, to, uniform(rng, 0.002, 0.006), tone);
    });
}

fn leaves(canvas: &mut Canvas, rng: &Dice) {
    for value in &mut canvas.values {
        *value *= 0.3;
    }
    strew(canvas, 420.0, rng, |canvas, place| {
        let (angle, r) = (uniform(rng, 0.0, 6.3), uniform(rng, 0.015, 0.04));
        let tone = 0.25 * uniform(rng, 0.15, 2.2);
        canvas.ellipse(place, [r, 0.5 * r], angle, tone);
        let rib = [place[0] + r * angle.cos(), place[1] + r * angle.sin()];
        canvas.stroke(place, rib, 0.0015, 0.6 * tone);
    });
}

fn cloth(canvas: &mut Canvas, rng: &Dice) {
    let (pitch_m, kind) = (uniform(rng, 0.02, 0.06), below(rng, 4));
    let dark = uniform(rng, 0.4, 0.85);
    let texel_m = canvas.texel_m[0].max(canvas.texel_m[1]);
    canvas.vary(|x, y, value| {
        let stripe = |m: f32| (m / pitch_m).rem_euclid(1.0) < 0.35;
        let pattern = match kind {
            0 => stripe(y),
            1 => stripe(x) ^ stripe(y),
            _ => false,
        };
        let thread = ((x / texel_m) as i32 + (y / texel_m) as i32) % 2 == 0;
        let paint = if pattern { dark } else { 1.0 };
        let tone = if thread { 1.05 } else { 0.95 };
        value * paint * tone
    });
    patches(canvas, 0.14, 0.3, [1.0, 2.5], rng);
    speckle(canvas, 0.06, rng.bits());
}
