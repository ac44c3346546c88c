//! Values between pixels.

use lsfb_geometry::Vector2;

/// The four pixels around a place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Around {
    /// Upper left, upper right, lower left, lower right.
    pub values: [f64; 4],
    /// How far the place lies from the upper left one, right and down: 0 to 1.
    pub way: [f64; 2],
}

impl Around {
    /// The pixels around a place in an image given row by row; `None` where one of them is outside.
    pub fn new(width: usize, values: &[f32], at: &Vector2<f64>) -> Option<Self> {
        let last_row = (values.len() / width.max(1)).checked_sub(1)?;
        let inside =
            at.x >= 0.0 && at.y >= 0.0 && at.x < width as f64 - 1.0 && at.y < last_row as f64;
        if !inside {
            return None;
        }
        let (x, y) = (at.x as usize, at.y as usize);
        let above = values.get(y * width + x..)?;
        let below = values.get((y + 1) * width + x..)?;
        let four = [above.first()?, above.get(1)?, below.first()?, below.get(1)?];
        Some(Self {
            values: four.map(|v| f64::from(*v)),
            way: [at.x - x as f64, at.y - y as f64],
        })
    }

    /// The bilinear value.
    pub fn value(&self) -> f64 {
        let ([a, b, c, d], [u, v]) = (self.values, self.way);
        let (top, bottom) = (a + (b - a) * u, c + (d - c) * u);
        top + (bottom - top) * v
    }

    /// The gradient of the bilinear value, per pixel.
    pub fn gradient(&self) -> Vector2<f64> {
        let ([a, b, c, d], [u, v]) = (self.values, self.way);
        let (top, bottom) = (a + (b - a) * u, c + (d - c) * u);
        Vector2::new((b - a) * (1.0 - v) + (d - c) * v, bottom - top)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plane_is_followed_and_its_border_kept() {
        let values: Vec<f32> = (0..12)
            .map(|k| (3 * (k % 4) + 10 * (k / 4)) as f32)
            .collect();
        let around = |x, y| Around::new(4, &values, &Vector2::new(x, y));
        let inside = around(1.25, 1.5).expect("inside");
        assert!((inside.value() - (3.0 * 1.25 + 15.0)).abs() < 1e-12);
        assert!((inside.gradient() - Vector2::new(3.0, 10.0)).norm() < 1e-12);
        assert_eq!(around(3.0, 1.0), None);
        assert_eq!(around(1.0, 2.0), None);
        assert_eq!(around(-0.1, 1.0), None);
        assert_eq!(around(f64::NAN, 1.0), None);
        assert_eq!(Around::new(0, &[], &Vector2::zeros()), None);
    }
}
