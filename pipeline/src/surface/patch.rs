//! A piece of a plane, and where on it there is surface.

use lsfb_geometry::Vector3;

use super::VOXEL_M;

/// Squares along each side.
const SIDE: usize = 32;
/// Gaps of up to twice as many squares are closed: between two rings of a scan there is wall too.
const CLOSED: usize = 2;
/// So many squares beyond the surface one is at its outline.
const OUTLINE: usize = 1;
/// Sine of the least angle between a plane and a ray that meets it: where it is met is not known otherwise.
const LEAST_SLANT: f64 = 0.02;

/// Squares on the plane through `point`, some of which are surface.
#[derive(Clone, Debug)]
pub(super) struct Patch {
    point: Vector3<f64>,
    normal: Vector3<f64>,
    /// Along the plane; the grid's middle lies at `middle`.
    axes: [Vector3<f64>; 2],
    middle: Vector3<f64>,
    surface: [u32; SIDE],
    /// The surface, and what is next to it.
    outline: [u32; SIDE],
}

/// Where a ray meets the plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Meeting {
    /// On the surface.
    Surface,
    /// Next to it.
    Outline,
}

impl Patch {
    /// Around a place on the plane.
    pub fn new(point: Vector3<f64>, normal: Vector3<f64>, middle: &Vector3<f64>) -> Self {
        let across = Vector3::ith(normal.iamin(), 1.0);
        let first = normal.cross(&across).normalize();
        Self {
            point,
            normal,
            axes: [first, normal.cross(&first)],
            middle: *middle,
            surface: [0; SIDE],
            outline: [0; SIDE],
        }
    }

    /// Whether it is a piece of this very plane.
    pub fn is_on(&self, point: &Vector3<f64>, normal: &Vector3<f64>) -> bool {
        self.point == *point && self.normal == *normal
    }

    /// Row and column; `None` outside the grid.
    fn square(&self, at: &Vector3<f64>) -> Option<[usize; 2]> {
        let off = at - self.middle;
        let mut square = [0; 2];
        for (index, axis) in square.iter_mut().zip(&self.axes) {
            let place = (axis.dot(&off) / VOXEL_M).floor() + SIDE as f64 / 2.0;
            if !(0.0..SIDE as f64).contains(&place) {
                return None;
            }
            *index = place as usize;
        }
        Some(square)
    }

    /// There is surface at a point of the plane.
    pub fn set(&mut self, at: &Vector3<f64>) {
        if let Some([row, column]) = self.square(at) {
            self.surface[row] |= 1 << column;
        }
    }

    /// Closes small gaps, and finds the outline. Call it once, when all is set.
    pub fn close(&mut self) {
        let seen = self.surface;
        let grown = grow(&seen, CLOSED);
        let free = grown.map(|row| !row);
        let closed = grow(&free, CLOSED).map(|row| !row);
        for (row, (closed, seen)) in self.surface.iter_mut().zip(closed.iter().zip(&seen)) {
            *row = closed | seen;
        }
        self.outline = grow(&self.surface, OUTLINE);
    }

    /// How far along a ray of unit length its plane is met, from either side, metres; `None` along it, or backwards.
    pub fn reach_m(&self, origin: &Vector3<f64>, direction: &Vector3<f64>) -> Option<f64> {
        let along = self.normal.dot(direction);
        if along.abs() < LEAST_SLANT {
            return None;
        }
        let reach_m = self.normal.dot(&(self.point - origin)) / along;
        (reach_m > 0.0).then_some(reach_m)
    }

    /// Its unit normal where a ray meets the side that was seen.
    pub fn normal_towards(&self, direction: &Vector3<f64>) -> Option<Vector3<f64>> {
        (self.normal.dot(direction) < 0.0).then_some(self.normal)
    }

    /// What is at a point of the plane.
    pub fn meets(&self, at: &Vector3<f64>) -> Option<Meeting> {
        let [row, column] = self.square(at)?;
        let bit = 1 << column;
        if self.surface[row] & bit != 0 {
            Some(Meeting::Surface)
        } else {
            (self.outline[row] & bit != 0).then_some(Meeting::Outline)
        }
    }
}

/// All squares within so many rows and columns of one that is set.
fn grow(squares: &[u32; SIDE], by: usize) -> [u32; SIDE] {
    let wide = squares.map(|row| (1..=by).fold(row, |wide, n| wide | row << n | row >> n));
    std::array::from_fn(|row| {
        let near = row.saturating_sub(by)..(row + by + 1).min(SIDE);
        wide[near].iter().fold(0, |all, row| all | row)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wall that is seen in lines 15 cm apart is whole, its outline is where it ends, and from behind it has no normal.
    #[test]
    fn lines_are_closed_and_ends_are_outlines() {
        let normal = Vector3::new(0.0, 0.0, 1.0);
        let mut patch = Patch::new(Vector3::zeros(), normal, &Vector3::zeros());
        let at = |i: i32, j: i32| {
            Vector3::new(f64::from(i), f64::from(j), 0.0) * VOXEL_M + Vector3::new(0.02, 0.02, 0.0)
        };
        for j in [-6, -3, 0, 3, 6] {
            for i in -8..8 {
                patch.set(&at(i, j));
            }
        }
        patch.close();
        for j in -6..=6 {
            assert_eq!(patch.meets(&at(0, j)), Some(Meeting::Surface), "{j}");
        }
        assert_eq!(patch.meets(&at(0, 7)), Some(Meeting::Outline));
        assert_eq!(patch.meets(&at(0, -7)), Some(Meeting::Outline));
        assert_eq!(patch.meets(&at(0, 9)), None);
        assert_eq!(patch.meets(&at(40, 0)), None);
        let above = Vector3::new(0.0, 0.0, 2.0);
        let down = Vector3::new(0.0, 0.0, -1.0);
        assert_eq!(patch.reach_m(&above, &down), Some(2.0));
        assert_eq!(patch.reach_m(&above, &-down), None);
        assert_eq!(patch.reach_m(&above, &Vector3::x()), None);
        assert_eq!(patch.reach_m(&-above, &-down), Some(2.0));
        assert_eq!(patch.normal_towards(&down), Some(normal));
        assert_eq!(patch.normal_towards(&-down), None);
    }
}
