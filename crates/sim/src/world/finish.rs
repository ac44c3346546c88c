//! Materials of large buildings and of what is outside them.

use super::grain::Grain;
use super::material::{Marks, Material, PLAIN};
use super::substance::Substance;

impl Material {
    /// A wall with nothing on it: what feature trackers fear.
    pub(crate) const BLANK: Self = Self {
        tone: 0.68,
        noise: 0.0025,
        longest_m: 1.5,
        grain: Grain::Plaster,
        ..PLAIN
    };
    /// A floor as blank as that wall.
    pub(crate) const VINYL: Self = Self {
        tone: 0.45,
        noise: 0.004,
        longest_m: 1.0,
        gloss: 0.8,
        ..PLAIN
    };
    /// Office wall paint with dirt and dents.
    pub(crate) const PAINT: Self = Self {
        tone: 0.66,
        noise: 0.01,
        longest_m: 1.2,
        coverage: 0.015,
        spread: 0.14,
        largest_m: 0.05,
        grain: Grain::Plaster,
        ..PLAIN
    };
    pub(crate) const CARPET: Self = Self {
        tone: 0.3,
        noise: 0.03,
        longest_m: 0.5,
        coverage: 0.05,
        spread: 0.12,
        largest_m: 0.05,
        marks: Marks::Boards([0.5, 0.5]),
        substance: Substance::Soft,
        grain: Grain::Carpet,
        ..PLAIN
    };
    pub(crate) const STONE: Self = Self {
        tone: 0.52,
        noise: 0.022,
        longest_m: 0.9,
        coverage: 0.06,
        spread: 0.2,
        largest_m: 0.12,
        marks: Marks::Boards([0.8, 0.8]),
        gloss: 0.5,
        substance: Substance::Concrete,
        grain: Grain::Stone,
        ..PLAIN
    };
    pub(crate) const CONCRETE: Self = Self {
        tone: 0.5,
        noise: 0.025,
        longest_m: 1.6,
        coverage: 0.03,
        spread: 0.18,
        largest_m: 0.1,
        substance: Substance::Concrete,
        grain: Grain::Concrete,
        ..PLAIN
    };
    pub(crate) const BRICK: Self = Self {
        tone: 0.36,
        noise: 0.03,
        longest_m: 0.8,
        coverage: 0.03,
        spread: 0.15,
        largest_m: 0.04,
        marks: Marks::Boards([0.24, 0.075]),
        coarseness: 1.5,
        substance: Substance::Brick,
        grain: Grain::Brick,
        ..PLAIN
    };
    pub(crate) const CLADDING: Self = Self {
        tone: 0.56,
        noise: 0.012,
        longest_m: 1.2,
        coverage: 0.02,
        spread: 0.15,
        largest_m: 0.06,
        marks: Marks::Boards([1.2, 0.6]),
        coarseness: 1.5,
        substance: Substance::Brick,
        grain: Grain::Stone,
        ..PLAIN
    };
    pub(crate) const PAVEMENT: Self = Self {
        tone: 0.42,
        noise: 0.03,
        longest_m: 1.2,
        coverage: 0.1,
        spread: 0.2,
        largest_m: 0.1,
        marks: Marks::Boards([0.4, 0.4]),
        coarseness: 1.5,
        substance: Substance::Concrete,
        grain: Grain::Aggregate,
        ..PLAIN
    };
    pub(crate) const ASPHALT: Self = Self {
        tone: 0.25,
        noise: 0.03,
        longest_m: 2.0,
        coverage: 0.12,
        spread: 0.12,
        largest_m: 0.08,
        coarseness: 1.5,
        substance: Substance::Concrete,
        grain: Grain::Aggregate,
        ..PLAIN
    };
    pub(crate) const GRASS: Self = Self {
        tone: 0.2,
        noise: 0.035,
        longest_m: 1.5,
        coverage: 0.2,
        spread: 0.12,
        largest_m: 0.12,
        coarseness: 1.5,
        grain: Grain::Grass,
        ..PLAIN
    };
    pub(crate) const FOLIAGE: Self = Self {
        tone: 0.18,
        noise: 0.05,
        longest_m: 0.8,
        coverage: 0.35,
        spread: 0.15,
        largest_m: 0.15,
        substance: Substance::Leaves,
        grain: Grain::Leaves,
        ..PLAIN
    };
    pub(crate) const BARK: Self = Self {
        tone: 0.24,
        noise: 0.05,
        longest_m: 0.4,
        stretch: [1.0, 4.0],
        coverage: 0.08,
        spread: 0.12,
        largest_m: 0.04,
        substance: Substance::Wood,
        grain: Grain::Wood,
        ..PLAIN
    };
    /// Clouds, seen two hundred metres away.
    pub(crate) const SKY: Self = Self {
        tone: 0.62,
        noise: 0.016,
        longest_m: 90.0,
        stretch: [2.0, 1.0],
        glow: 1.0,
        luminance_cd_m2: 5000.0,
        coarseness: 100.0,
        substance: Substance::Sky,
        ..PLAIN
    };
    /// Clouds over a city at night.
    pub(crate) const NIGHT_SKY: Self = Self {
        glow: 4e-4,
        luminance_cd_m2: 0.05,
        ..Self::SKY
    };
    /// A leaf of a fire door: painted steel.
    pub(crate) const FIRE_DOOR: Self = Self {
        tone: 0.52,
        noise: 0.008,
        longest_m: 0.5,
        coverage: 0.01,
        spread: 0.15,
        largest_m: 0.02,
        marks: Marks::Panel(0.06),
        substance: Substance::Metal,
        ..PLAIN
    };
    /// A screen whose content changes.
    pub(crate) const SHOW: Self = Self {
        tone: 0.4,
        noise: 0.01,
        coverage: 0.3,
        spread: 0.38,
        largest_m: 0.4,
        marks: Marks::Poster(0.02),
        glow: 0.9,
        luminance_cd_m2: 250.0,
        gloss: 0.7,
        pictures: 6,
        coarseness: 1.5,
        ..PLAIN
    };
    /// What is seen through a window that nobody can go through: bright, blurred.
    pub(crate) const VIEW: Self = Self {
        tone: 0.62,
        noise: 0.03,
        longest_m: 1.5,
        coverage: 0.05,
        spread: 0.3,
        largest_m: 0.5,
        glow: 1.0,
        luminance_cd_m2: 3000.0,
        gloss: 1.0,
        substance: Substance::Glass,
        grain: Grain::Outlook,
        ..PLAIN
    };
    pub(crate) const GLASS: Self = Self {
        tone: 0.08,
        noise: 0.0,
        glass: true,
        substance: Substance::Glass,
        ..PLAIN
    };
    pub(crate) const SIGN: Self = Self {
        tone: 0.2,
        noise: 0.006,
        marks: Marks::Sign,
        ..PLAIN
    };
    /// A panel of light in a ceiling.
    pub(crate) const SKYLIGHT: Self = Self {
        tone: 0.85,
        noise: 0.006,
        longest_m: 2.0,
        glow: 1.2,
        luminance_cd_m2: 1500.0,
        coarseness: 3.0,
        substance: Substance::Glass,
        ..PLAIN
    };
    pub(crate) const CLOTH: Self = Self {
        tone: 0.3,
        noise: 0.03,
        longest_m: 0.3,
        coverage: 0.06,
        spread: 0.2,
        largest_m: 0.08,
        substance: Substance::Soft,
        grain: Grain::Cloth,
        ..PLAIN
    };
    pub(crate) const SKIN: Self = Self {
        tone: 0.45,
        noise: 0.02,
        longest_m: 0.2,
        substance: Substance::Soft,
        ..PLAIN
    };

    /// The calibration board: the grid with a white margin.
    pub(crate) const fn april_grid(tag_m: f32) -> Self {
        Self {
            tone: 0.6,
            noise: 0.002,
            marks: Marks::AprilGrid(tag_m),
            coarseness: 0.34,
            ..PLAIN
        }
    }

    /// Whether it is so far away that nothing in the place lights it.
    pub(crate) fn is_backdrop(&self) -> bool {
        self.coarseness >= Self::SKY.coarseness
    }

    /// With this much less or more texture.
    pub(crate) const fn busier(self, coverage: f32) -> Self {
        Self { coverage, ..self }
    }
}
