//! A plane through the returns of a board: regression of the distance along its normal, with what all returns of one beam
//! have in common as an error of its own.

use lsfb_geometry::{Matrix3, Vector3};
use lsfb_perception::lidar::PointSums;
use lsfb_solver::gauss_newton::NormalEquations;

/// Noise of the direction of a ray, radians.
const POINTING_RAD: f64 = 5e-4;

/// The returns of one beam on the board.
#[derive(Clone, Debug)]
pub(super) struct Chord {
    /// Number of the beam's ring.
    pub ring: u16,
    pub points: Vec<Vector3<f64>>,
    /// How bright each of them is, as the sensor says it.
    pub intensities: Vec<u8>,
}

/// A plane with its own axes: `point = origin + x·axes₀ + y·axes₁ + z·normal`.
#[derive(Clone, Copy, Debug)]
pub(super) struct Plane {
    pub origin: Vector3<f64>,
    pub axes: [Vector3<f64>; 2],
    /// Towards the sensor.
    pub normal: Vector3<f64>,
}

/// How well points determine a plane and what they leave.
#[derive(Clone, Copy, Debug)]
pub(super) struct PlaneFit {
    pub plane: Plane,
    /// Information of slope along both axes and of height at the origin.
    pub information: Matrix3<f64>,
}

/// Sums over all boards that give the two variances.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Spread {
    /// Squares of range errors about each beam's mean, and their degrees of freedom.
    pub within: [f64; 2],
    /// Squares of the means of beams, less what the noise within explains, and their degrees of freedom.
    pub between: [f64; 2],
}

impl Plane {
    /// The plane of least squares; `None` for points on a line.
    pub fn through(points: &[Vector3<f64>]) -> Option<Self> {
        let mut sums = PointSums::default();
        points.iter().for_each(|p| sums.add(p));
        let found = sums.plane()?;
        Self::new(found.point, found.normal)
    }

    /// With a normal of any sign and axes of its own choice.
    pub fn new(origin: Vector3<f64>, normal: Vector3<f64>) -> Option<Self> {
        let normal = normal.try_normalize(1e-9)?;
        let normal = if normal.dot(&origin) > 0.0 {
            -normal
        } else {
            normal
        };
        // x level, so that rings run along it.
        let level = Vector3::z().cross(&normal);
        let x = level
            .try_normalize(1e-3)
            .or_else(|| Vector3::x().cross(&normal).try_normalize(1e-3))?;
        Some(Self {
            origin,
            axes: [x, normal.cross(&x)],
            normal,
        })
    }

    /// Coordinates in the plane and along its normal.
    pub fn local(&self, point: &Vector3<f64>) -> Vector3<f64> {
        let d = point - self.origin;
        Vector3::new(
            self.axes[0].dot(&d),
            self.axes[1].dot(&d),
            self.normal.dot(&d),
        )
    }

    /// Where a ray from the sensor meets the plane; `None` where it runs along it.
    pub fn meet(&self, direction: &Vector3<f64>) -> Option<Vector3<f64>> {
        let facing = self.normal.dot(direction);
        (facing.abs() > 0.05).then(|| direction * (self.normal.dot(&self.origin) / facing))
    }

    /// Range of the point less that of the plane along its ray, metres.
    pub fn range_error_m(&self, point: &Vector3<f64>) -> Option<f64> {
        let ray = point.try_normalize(1e-6)?;
        Some(point.norm() - self.meet(&ray)?.norm())
    }
}

/// Regression over chords; points of noise `range_noise_m` along their rays, beams with `beam_noise_m` in common.
pub(super) fn regress(
    chords: &[Chord],
    start: &Plane,
    range_noise_m: f64,
    beam_noise_m: f64,
) -> Option<PlaneFit> {
    let mut plane = *start;
    let mut information = Matrix3::zeros();
    for _ in 0..4 {
        let mut all = NormalEquations::<3>::default();
        for chord in chords {
            let mut own = NormalEquations::<3>::default();
            let mut sums = Vector3::zeros();
            let (mut total, mut first) = (0.0, 0.0);
            for point in &chord.points {
                // Where the ray meets the plane, not where noise along the ray has put the return: slopes would be biased.
                let Some(met) = plane.meet(&(point / point.norm())) else {
                    continue;
                };
                let place = plane.local(&met);
                let height = plane.local(point).z;
                let (weight, facing) = weight(&plane, point, range_noise_m);
                let row = Vector3::new(place.x, place.y, 1.0);
                own.add(-height, &row, weight);
                // A beam's own error lies along the ray: on the normal it is shortened.
                sums += row * (weight * facing);
                first += weight * facing * height;
                total += weight * facing * facing;
            }
            if beam_noise_m > 0.0 {
                let shared = 1.0 / (total + 1.0 / (beam_noise_m * beam_noise_m));
                own.information -= sums * sums.transpose() * shared;
                own.gradient += sums * (first * shared);
            }
            all.add_all(&own);
        }
        information = all.information;
        let [a, b, c]: [f64; 3] = all.step()?.into();
        let normal = plane.normal - plane.axes[0] * a - plane.axes[1] * b;
        plane = Plane::new(plane.origin + plane.normal * c, normal)?;
        if a.abs() + b.abs() + c.abs() < 1e-9 {
            break;
        }
    }
    Some(PlaneFit { plane, information })
}

/// Weight of a point's distance along the normal, and by how much that is shortened.
fn weight(plane: &Plane, point: &Vector3<f64>, range_noise_m: f64) -> (f64, f64) {
    let range_m = point.norm();
    let facing = (plane.normal.dot(point) / range_m).abs();
    let along = range_noise_m * facing;
    let across = POINTING_RAD * range_m;
    let variance = along * along + across * across * (1.0 - facing * facing);
    (1.0 / variance.max(1e-12), facing)
}

impl Spread {
    /// Adds one board.
    pub fn add(&mut self, chords: &[Chord], plane: &Plane) {
        let (mut within, mut freedom) = (0.0, 0.0);
        let mut means = Vec::new();
        for chord in chords {
            let errors: Vec<f64> = chord
                .points
                .iter()
                .filter_map(|p| plane.range_error_m(p))
                .collect();
            if errors.len() < 4 {
                continue;
            }
            let n = errors.len() as f64;
            let mean = errors.iter().sum::<f64>() / n;
            within += errors.iter().map(|e| (e - mean).powi(2)).sum::<f64>();
            freedom += n - 1.0;
            means.push((mean, n));
        }
        self.within[0] += within;
        self.within[1] += freedom;
        if means.len() > 3 {
            let noise = within / freedom;
            // Three parameters of the plane took their share of the means.
            let share = (means.len() - 3) as f64 / means.len() as f64;
            for (mean, n) in &means {
                self.between[0] += mean * mean - share * noise / n;
            }
            self.between[1] += (means.len() - 3) as f64;
        }
    }

    /// Standard deviation of a single range, metres.
    pub fn range_noise_m(&self) -> Option<f64> {
        (self.within[1] > 0.0).then(|| (self.within[0] / self.within[1]).sqrt())
    }

    /// Standard deviation of what a beam's returns have in common, metres.
    pub fn beam_noise_m(&self) -> f64 {
        if self.between[1] > 0.0 {
            (self.between[0] / self.between[1]).max(0.0).sqrt()
        } else {
            0.0
        }
    }
}
