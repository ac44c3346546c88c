//! A surface that shows patches of one picture side by side, each from another place of it, so that nothing comes back after
//! a period, however large the surface is.
//!
//! What has no joints fades from patch to patch, with the variance of the picture kept (as in Heitz and Neyret, "High-Performance
//! By-Example Noise using a Histogram-Preserving Blending Operator", 2018). What consists of boards is parted at their joints.

use crate::noise::{hash, unit};

/// Edge of a patch, metres, before its material's coarseness; whole boards are as near to it as they can be.
const PATCH_M: f32 = 1.0;
/// Width over which a patch fades into the next, as a share of the patch.
const FADE: f32 = 0.15;

/// Which part of a picture is where on a surface. Places on the surface, like those in the picture, are in widths and heights of
/// the picture.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patchwork {
    axes: [Axis; 2],
    seed: u64,
}

/// One direction of the surface.
#[derive(Clone, Copy, Debug)]
struct Axis {
    patch: f32,
    /// Width over which a patch fades into the next.
    fade: f32,
    /// Distance between the places where patches begin in the picture; 0 where they begin anywhere.
    step: f32,
}

/// What one patch has to say about a place.
#[derive(Clone, Copy, Debug, Default)]
struct Share {
    patch: f32,
    /// Distance from where the patch begins.
    within: f32,
    weight: f32,
}

impl Patchwork {
    /// Of a picture with edges of `picture_m`; with boards, their size in metres.
    pub(crate) fn new(
        picture_m: [f32; 2],
        coarseness: f32,
        boards_m: Option<[f32; 2]>,
        seed: u64,
    ) -> Self {
        let axis = |i: usize| {
            let wanted_m = (PATCH_M * coarseness).min(0.25 * picture_m[i]);
            match boards_m {
                None => Axis {
                    patch: wanted_m / picture_m[i],
                    fade: FADE * wanted_m / picture_m[i],
                    step: 0.0,
                },
                Some(boards_m) => Axis {
                    patch: boards_m[i] * (wanted_m / boards_m[i]).round().max(1.0) / picture_m[i],
                    fade: 0.0,
                    step: boards_m[i] / picture_m[i],
                },
            }
        };
        Self {
            axes: [axis(0), axis(1)],
            seed,
        }
    }

    /// Where the corner of a surface of this size lies: small ones within one patch where they fit, large ones of boards at the
    /// corner of a board, others anywhere; `draws` are in 0–1.
    pub(crate) fn corner(&self, size: [f32; 2], draws: [f32; 2]) -> [f32; 2] {
        std::array::from_fn(|i| {
            let Axis { patch, fade, step } = self.axes[i];
            let room = patch - fade - size[i];
            if room > 0.0 {
                0.5 * fade + draws[i] * room
            } else if step > 0.0 {
                0.0
            } else {
                draws[i] * patch
            }
        })
    }

    /// The brightness at a place of the surface, of `sample` at places of the picture, whose mean is `mean`.
    #[inline]
    pub(crate) fn blend(
        &self,
        place: [f32; 2],
        mean: f32,
        sample: impl Fn([f32; 2]) -> f32,
    ) -> f32 {
        let [columns, rows] = [0, 1].map(|i| self.axes[i].shares(place[i]));
        if columns[1].weight == 0.0 && rows[1].weight == 0.0 {
            return sample(self.place(&columns[0], &rows[0]));
        }
        let (mut sum, mut squares) = (0.0, 0.0);
        for column in &columns {
            for row in &rows {
                let weight = column.weight * row.weight;
                if weight > 0.0 {
                    sum += weight * (sample(self.place(column, row)) - mean);
                    squares += weight * weight;
                }
            }
        }
        (mean + sum / squares.sqrt()).max(0.0)
    }

    /// The place in the picture that a patch shows.
    #[inline]
    fn place(&self, column: &Share, row: &Share) -> [f32; 2] {
        let number = (column.patch as u32 as u64) | ((row.patch as u32 as u64) << 32);
        let bits = hash(self.seed ^ hash(number));
        let draws = [unit(bits) as f32, unit(hash(bits)) as f32];
        // The lowest bits are not in the draws.
        std::array::from_fn(|i| {
            let within = [column, row][i].within;
            self.axes[i].picture(within, draws[i], bits >> i & 1 == 1)
        })
    }
}

impl Axis {
    /// Begins at a drawn place, and may run backwards.
    #[inline]
    fn picture(&self, within: f32, draw: f32, backwards: bool) -> f32 {
        let room = (1.0 - self.patch - self.fade).max(0.0);
        let begin = if self.step > 0.0 {
            (draw * (room / self.step + 1.0).floor()).floor() * self.step
        } else {
            0.5 * self.fade + draw * room
        };
        begin
            + if backwards {
                self.patch - within
            } else {
                within
            }
    }

    /// The patch of a place, and the next one where the place is near to it.
    #[inline]
    fn shares(&self, place: f32) -> [Share; 2] {
        // Surfaces lie where places are not negative, but for the last digits.
        let patch = (place.max(0.0) / self.patch).floor();
        let within = place - patch * self.patch;
        let reach = 0.5 * self.fade;
        let (edge, next) = if within < 0.5 * self.patch {
            (within, -1.0)
        } else {
            (self.patch - within, 1.0)
        };
        let weight = if edge < reach && patch + next >= 0.0 {
            0.5 - 0.5 * edge.max(0.0) / reach
        } else {
            0.0
        };
        [
            Share {
                patch,
                within,
                weight: 1.0 - weight,
            },
            Share {
                patch: patch + next,
                within: within - next * self.patch,
                weight,
            },
        ]
    }
}

#[cfg(test)]
mod tests {
    use lsfb_types::no_progress;

    use crate::config::Look;
    use crate::world::material::{Marks, Material};
    use crate::world::{Blueprint, World};

    /// A wall or floor, metres, and the distance between the points at which it is looked at.
    const SIZE_M: [f32; 2] = [48.0, 10.0];
    const STEP_M: f32 = 0.05;

    /// Brightness of a large surface, row by row, with mean 0.
    fn surface(material: Material, look: Look) -> (usize, Vec<f32>) {
        let mut blueprint = Blueprint {
            ambient: 1.0,
            look,
            ..Blueprint::default()
        };
        let [w, h] = SIZE_M;
        let (along, up) = ([w, 0.0, 0.0], [0.0, 0.0, h]);
        blueprint.builder.quad([0.0; 3], along, up, material);
        let world = World::of(&blueprint, 7, 0.006, &no_progress).expect("built");
        let [columns, rows] = SIZE_M.map(|m| (m / STEP_M) as usize);
        let at = |k: usize, count: usize| (k as f32 + 0.5) / count as f32;
        let value = |k: usize| {
            let (a, b) = (at(k % columns, columns), at(k / columns, rows));
            world.radiance(0, a, b, STEP_M, 0.0)
        };
        let mut values: Vec<f32> = (0..columns * rows).map(value).collect();
        let mean = values.iter().sum::<f32>() / values.len() as f32;
        for value in &mut values {
            *value -= mean;
        }
        (columns, values)
    }

    /// Correlation of a surface with itself, shifted along and across.
    fn correlation(columns: usize, values: &[f32], along: usize, across: usize) -> f32 {
        let rows = values.len() / columns;
        let (mut product, mut squares) = (0.0, 0.0);
        for row in 0..rows - across {
            let here = &values[row * columns..(row + 1) * columns - along];
            let there = &values[(row + across) * columns + along..(row + across + 1) * columns];
            for (p, q) in here.iter().zip(there) {
                product += p * q;
                squares += 0.5 * (p * p + q * q);
            }
        }
        product / squares
    }

    /// What the trial's places have large surfaces of.
    const LARGE: [Material; 16] = [
        Material::PLASTER,
        Material::PAINT,
        Material::BLANK,
        Material::CONCRETE,
        Material::VINYL,
        Material::CARPET,
        Material::WOOD,
        Material::PARQUET,
        Material::LINOLEUM,
        Material::STONE,
        Material::CEILING,
        Material::ASPHALT,
        Material::PAVEMENT,
        Material::GRASS,
        Material::BRICK,
        Material::CLADDING,
    ];

    /// A picture of four metres, mirrored, comes back after eight: correlation 1, as it was before patches.
    #[test]
    fn no_surface_looks_the_same_again_after_a_period() {
        let looks = [Look::Plain, Look::Detailed].into_iter();
        let all = looks.flat_map(|look| LARGE.map(|material| (look, material)));
        let wrong = all.filter_map(|(look, material)| {
            let (columns, values) = surface(material, look);
            let mut worst = (0.0, 0.0, 0.0);
            // From beyond the longest wavelength of the noise on.
            let far = |m: f32| (m / STEP_M) as usize;
            let shifts = (far(2.5)..far(40.0)).map(|along| (along, 0));
            let shifts = shifts.chain((far(2.5)..far(7.0)).map(|across| (0, across)));
            for (along, across) in shifts.chain((far(2.5)..far(7.0)).map(|both| (both, both))) {
                let found = correlation(columns, &values, along, across).abs();
                if found > worst.0 {
                    worst = (found, along as f32 * STEP_M, across as f32 * STEP_M);
                }
            }
            // Real boards and tiles come back too, by their joints; and of waves of 1.5 m few fit into what overlaps, where there is nothing else.
            let has_joints = matches!(material.marks, Marks::Boards(_));
            let limit = match has_joints || material.noise < 0.005 {
                true => 0.4,
                false => 0.25,
            };
            (worst.0 >= limit).then(|| format!("{look:?} {material:?}: {worst:?}"))
        });
        let wrong: Vec<String> = wrong.collect();
        assert!(wrong.is_empty(), "{wrong:#?}");
    }

    #[test]
    fn patches_fade_into_each_other_without_losing_contrast() {
        let (columns, values) = surface(Material::PAINT, Look::Plain);
        let rows = values.len() / columns;
        let variance = |near: &dyn Fn(f32) -> bool| {
            let chosen = (0..columns).filter(|k| near(*k as f32 * STEP_M));
            let all: Vec<f32> = chosen
                .flat_map(|k| (0..rows).map(move |row| (row, k)))
                .map(|(row, k)| values[row * columns + k])
                .collect();
            all.iter().map(|v| v * v).sum::<f32>() / all.len() as f32
        };
        // Patches are a metre wide; where they begin is drawn.
        let bands = (0..20).map(|phase| {
            let begin = phase as f32 * 0.05;
            variance(&|x: f32| (x - begin).rem_euclid(1.0) < 0.05)
        });
        let bands: Vec<f32> = bands.collect();
        let mean = bands.iter().sum::<f32>() / bands.len() as f32;
        assert!(
            bands.iter().all(|b| (b / mean - 1.0).abs() < 0.35),
            "{bands:?}"
        );
    }
}
