//! Extrema of the difference of Gaussians, located between pixels and between scales.

use nalgebra::{Matrix3, Vector3};

use super::scale_space::Octave;

/// An extremum in the coordinates of its octave.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Extremum {
    pub x: f32,
    pub y: f32,
    /// Level of the difference with its fraction: blur is `sigma * 2^(level / scales)`.
    pub level: f32,
    pub response: f32,
}

/// What counts as an extremum.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub contrast: f32,
    pub edge_ratio: f32,
    /// Pixels at the border of the octave that are not looked at.
    pub border: usize,
}

/// All extrema of an octave, by level, row and column.
pub(crate) fn find_extrema(octave: &Octave, limits: &Limits) -> Vec<Extremum> {
    let mut found = Vec::new();
    let [width, height] = octave.size();
    if width <= 2 * limits.border || height <= 2 * limits.border {
        return found;
    }
    // Half the contrast on the grid: the peak between pixels is higher.
    let floor = 0.5 * limits.contrast;
    let (mut band, mut peaks) = (Band::default(), Vec::new());
    let mut rows: [Vec<f32>; 3] = Default::default();
    for level in 1..octave.differences().saturating_sub(1) {
        for (i, row) in rows.iter_mut().enumerate().skip(1) {
            octave.difference_row(level, limits.border + i - 2, row);
        }
        for y in limits.border..height - limits.border {
            rows.rotate_left(1);
            octave.difference_row(level, y + 1, &mut rows[2]);
            mark_peaks(&rows, floor, &mut band, &mut peaks);
            let inner = peaks.iter().enumerate().take(width - limits.border);
            for (x, _) in inner.skip(limits.border).filter(|(_, peak)| **peak) {
                if is_extremum(octave, level, x, y) {
                    found.extend(refine(octave, level, x, y, limits));
                }
            }
        }
    }
    found
}

/// Highest and lowest of three rows, column by column.
#[derive(Default)]
struct Band {
    highest: Vec<f32>,
    lowest: Vec<f32>,
}

/// Marks the pixels of the middle row that no neighbour in the three rows exceeds. Written without branches, for several
/// lanes at once: it leaves one pixel in fifty for the full test.
fn mark_peaks(rows: &[Vec<f32>; 3], floor: f32, band: &mut Band, peaks: &mut Vec<bool>) {
    let width = rows[1].len();
    band.highest.resize(width, 0.0);
    band.lowest.resize(width, 0.0);
    peaks.clear();
    peaks.resize(width, false);
    let higher = |a: f32, b: f32| if a > b { a } else { b };
    let lower = |a: f32, b: f32| if a < b { a } else { b };
    let columns = rows[0].iter().zip(&rows[1]).zip(&rows[2]);
    let bounds = band.highest.iter_mut().zip(&mut band.lowest);
    for ((highest, lowest), ((a, b), c)) in bounds.zip(columns) {
        *highest = higher(higher(*a, *b), *c);
        *lowest = lower(lower(*a, *b), *c);
    }
    let (high, low) = (&band.highest[..width], &band.lowest[..width]);
    let triples = high.windows(3).zip(low.windows(3));
    for ((peak, value), (high, low)) in peaks[1..].iter_mut().zip(&rows[1][1..]).zip(triples) {
        let highest = higher(higher(high[0], high[1]), high[2]);
        let lowest = lower(lower(low[0], low[1]), low[2]);
        *peak = ((*value > floor) & (*value >= highest)) | ((*value < -floor) & (*value <= lowest));
    }
}

fn is_extremum(octave: &Octave, level: usize, x: usize, y: usize) -> bool {
    let value = octave.difference(level, x, y);
    let sign = value.signum();
    let value = value * sign;
    for (i, level) in [level, level - 1, level + 1].into_iter().enumerate() {
        for dy in 0..3 {
            for dx in 0..3 {
                // Of two equal neighbours the later one wins, so that plateaus give one extremum.
                let itself = i == 0 && dx == 1 && dy == 1;
                let later = i == 0 && (dy, dx) > (1, 1);
                let neighbour = octave.difference(level, x + dx - 1, y + dy - 1) * sign;
                if !itself && (neighbour > value || (later && neighbour == value)) {
                    return false;
                }
            }
        }
    }
    true
}

/// Fits a quadric (Lowe, section 4) and tests contrast and edge response at its peak.
fn refine(octave: &Octave, level: usize, x: usize, y: usize, limits: &Limits) -> Option<Extremum> {
    let [width, height] = octave.size();
    let (mut level, mut x, mut y) = (level, x, y);
    for _ in 0..5 {
        let at = |l: usize, x: usize, y: usize| octave.difference(l, x, y);
        let centre = at(level, x, y);
        let gradient = Vector3::new(
            at(level, x + 1, y) - at(level, x - 1, y),
            at(level, x, y + 1) - at(level, x, y - 1),
            at(level + 1, x, y) - at(level - 1, x, y),
        ) * 0.5;
        let xx = at(level, x + 1, y) + at(level, x - 1, y) - 2.0 * centre;
        let yy = at(level, x, y + 1) + at(level, x, y - 1) - 2.0 * centre;
        let ss = at(level + 1, x, y) + at(level - 1, x, y) - 2.0 * centre;
        let xy = 0.25
            * (at(level, x + 1, y + 1) - at(level, x - 1, y + 1) - at(level, x + 1, y - 1)
                + at(level, x - 1, y - 1));
        let xs = 0.25
            * (at(level + 1, x + 1, y) - at(level + 1, x - 1, y) - at(level - 1, x + 1, y)
                + at(level - 1, x - 1, y));
        let ys = 0.25
            * (at(level + 1, x, y + 1) - at(level + 1, x, y - 1) - at(level - 1, x, y + 1)
                + at(level - 1, x, y - 1));
        let hessian = Matrix3::new(xx, xy, xs, xy, yy, ys, xs, ys, ss);
        let offset = -(hessian.try_inverse()? * gradient);
        if offset.iter().all(|o| o.abs() <= 0.5) {
            let response = (centre + 0.5 * gradient.dot(&offset)).abs();
            let (trace, determinant) = (xx + yy, xx * yy - xy * xy);
            let ratio = limits.edge_ratio;
            let on_edge = determinant <= 0.0
                || trace * trace * ratio >= (ratio + 1.0) * (ratio + 1.0) * determinant;
            return (response >= limits.contrast && !on_edge).then(|| Extremum {
                x: x as f32 + offset.x,
                y: y as f32 + offset.y,
                level: level as f32 + offset.z,
                response,
            });
        }
        let moved = |index: usize, offset: f32, low: usize, high: usize| {
            let to = index as f32 + offset.clamp(-1.0, 1.0).round();
            (to >= low as f32 && to < high as f32).then_some(to as usize)
        };
        x = moved(x, offset.x, limits.border, width - limits.border)?;
        y = moved(y, offset.y, limits.border, height - limits.border)?;
        level = moved(level, offset.z, 1, octave.differences() - 1)?;
    }
    None
}
