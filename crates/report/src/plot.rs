//! What a plot is made of.

use super::axis::Axis;
use super::layout::{BELOW, LEFT, MARGIN, SERIES};

/// Shades from light to dark, of heights and counts.
pub const SHADES: u8 = 5;

/// A plot: two axes and what is drawn between them, the first layer at the bottom.
#[derive(Clone, Debug, PartialEq)]
pub struct Plot {
    /// What it shows, for who cannot see it.
    pub name: String,
    /// Width with labels, pixels of the page at 100 %.
    pub width_px: u32,
    /// Height with labels, pixels of the page at 100 %.
    pub height_px: u32,
    /// Along.
    pub x: Axis,
    /// Up.
    pub y: Axis,
    /// What is drawn.
    pub layers: Vec<Layer>,
}

/// One thing drawn; points are in the units of the axes, and those that are no numbers are left out.
#[derive(Clone, Debug, PartialEq)]
pub enum Layer {
    /// A line through points.
    Line {
        /// In order.
        points: Vec<[f64; 2]>,
        /// Its colour; [`Ink::Truth`] is dashed.
        ink: Ink,
        /// Its width, pixels of the page.
        width_px: f64,
    },
    /// A dot at each point.
    Dots {
        /// In any order.
        points: Vec<[f64; 2]>,
        /// Their colour.
        ink: Ink,
        /// Their radius, pixels of the page.
        radius_px: f64,
    },
    /// What a line encloses, filled so that the grid shines through.
    Area {
        /// Around it.
        outline: Vec<[f64; 2]>,
        /// Its colour.
        ink: Ink,
    },
    /// A word at the upper right of each point.
    Names {
        /// In any order.
        names: Vec<([f64; 2], String)>,
    },
    /// Filled rectangles: two opposite corners and the colour of each.
    Boxes {
        /// In any order.
        boxes: Vec<([f64; 2], [f64; 2], Ink)>,
    },
}

/// A colour by its meaning; the page's style sheet has one for light, dark and paper each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ink {
    /// The n-th of several things side by side; four differ.
    Series(usize),
    /// From light, 0, to dark, [`SHADES`] − 1.
    Shade(u8),
    /// The truth, or what is expected.
    Truth,
    /// What stands in the background.
    Muted,
    /// What is wrong.
    Bad,
}

/// The colour of an [`Ink::Series`] as a value of CSS, for legends.
pub fn ink_css(series: usize) -> String {
    format!("var(--track{})", series % usize::from(SERIES))
}

/// Pixels of a plot's width that labels leave to the data.
pub fn plot_width_px(width_px: u32) -> u32 {
    width_px.saturating_sub(LEFT + MARGIN)
}

/// Height of a plot whose data have so many pixels.
pub fn plot_height_px(data_height_px: u32) -> u32 {
    data_height_px + BELOW + MARGIN
}

impl Layer {
    /// A line of the usual width.
    pub fn line(points: Vec<[f64; 2]>, ink: Ink) -> Self {
        Self::Line {
            points,
            ink,
            width_px: 1.6,
        }
    }

    /// Dots of the usual size.
    pub fn dots(points: Vec<[f64; 2]>, ink: Ink) -> Self {
        Self::Dots {
            points,
            ink,
            radius_px: 1.5,
        }
    }
}
