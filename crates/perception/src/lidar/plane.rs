//! Points summed up, and the plane through them.

use lsfb_geometry::{Matrix3, Vector3};
use nalgebra::SymmetricEigen;

/// A flat piece of surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plane {
    /// Mean of its points.
    pub point: Vector3<f64>,
    /// Unit normal.
    pub normal: Vector3<f64>,
    /// Standard deviation of its points along the normal, metres.
    pub thickness_m: f64,
    /// Standard deviation of its points along its narrower side, metres.
    pub breadth_m: f64,
}

/// Sums over points.
#[derive(Clone, Copy, Debug, Default)]
pub struct PointSums {
    count: u32,
    /// The first point: sums of coordinates far from zero would cost digits.
    origin: Vector3<f64>,
    sum: Vector3<f64>,
    squares: Matrix3<f64>,
}

impl PointSums {
    /// How many points there are.
    pub fn count(&self) -> u32 {
        self.count
    }

    /// The first point; zero without points.
    pub fn first(&self) -> Vector3<f64> {
        self.origin
    }

    /// Mean of the points; zero without points.
    pub fn mean(&self) -> Vector3<f64> {
        self.origin + self.sum / f64::from(self.count.max(1))
    }

    /// Adds a point.
    pub fn add(&mut self, point: &Vector3<f64>) {
        if self.count == 0 {
            self.origin = *point;
        }
        let d = point - self.origin;
        self.count += 1;
        self.sum += d;
        self.squares += d * d.transpose();
    }

    /// Adds all points of another.
    pub fn add_all(&mut self, other: &Self) {
        if self.count == 0 {
            *self = *other;
            return;
        }
        let n = f64::from(other.count);
        let shift = other.origin - self.origin;
        let across = other.sum * shift.transpose();
        self.squares += other.squares + across + across.transpose() + shift * shift.transpose() * n;
        self.sum += other.sum + shift * n;
        self.count += other.count;
    }

    /// The plane of least squares, its normal of any sign; `None` with fewer than three points. Whether the points are flat is for
    /// the caller to say, by thickness and breadth.
    pub fn plane(&self) -> Option<Plane> {
        if self.count < 3 {
            return None;
        }
        let n = f64::from(self.count);
        let mean = self.sum / n;
        let eigen = SymmetricEigen::new(self.squares / n - mean * mean.transpose());
        let mut order = [0, 1, 2];
        order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
        let spread_m = |k: usize| eigen.eigenvalues[order[k]].max(0.0).sqrt();
        Some(Plane {
            point: self.origin + mean,
            normal: eigen.eigenvectors.column(order[0]).into(),
            thickness_m: spread_m(0),
            breadth_m: spread_m(1),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_make_the_plane_of_all() {
        let (mut whole, mut parts) = (PointSums::default(), [PointSums::default(); 3]);
        for k in 0..300 {
            let (x, y) = (f64::from(k % 20) * 0.05, f64::from(k / 20) * 0.02);
            let thick = if k % 2 == 0 { 0.004 } else { -0.004 };
            let point = Vector3::new(500.0 + x, -300.0 + y, 0.5 * x + thick);
            whole.add(&point);
            parts[(k % 3) as usize].add(&point);
        }
        let mut joined = PointSums::default();
        parts.iter().for_each(|p| joined.add_all(p));
        let (a, b) = (whole.plane().expect("flat"), joined.plane().expect("flat"));
        assert!((a.point - b.point).norm() < 1e-9 && a.normal.cross(&b.normal).norm() < 1e-6);
        let expected = Vector3::new(-0.5, 0.0, 1.0).normalize();
        assert!(a.normal.dot(&expected).abs() > 0.9999);
        assert!((a.thickness_m - 0.004 * expected.z).abs() < 1e-4);
        assert!(PointSums::default().plane().is_none());
    }
}
