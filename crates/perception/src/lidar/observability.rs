//! Which motions of a scan its registration can see.
//!
//! The information of a registration is taken at fixed correspondences: a scan in a corridor without ends holds its place along it by
//! nearest points, where rings lie on rings, and by walls whose planes lean by a degree. It says millimetres and may be metres off. So only
//! planes count, and each weak direction is tried: the scan is shifted both ways, its planes are sought anew, and what the cost rises by is
//! compared with what it would rise by had they stayed. The share of the information that this leaves is what the scan sees.
//!
//! Directions are eigenvectors of the information, as in Zhang, Kaess and Singh, "On degeneracy of optimization-based state estimation
//! problems" (ICRA 2016), with rotations in metres at the usual range of the scan, so that all six can be compared.

use lsfb_geometry::{Matrix6, Se3, Vector3, Vector6};
use nalgebra::SymmetricEigen;

use super::plane::Plane;
use super::registration::{Match, Registration, RegistrationConfig};

/// Directions tried: no single surface leaves more than three free, the plane's two shifts and one turn.
const TRIED: usize = 3;
/// Points tried at most: what a direction sees is an average over them.
const POINTS: usize = 600;

/// One direction of the pose, and what a scan sees of motion along it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Direction {
    /// Unit vector `[rotation × usual range, translation]` in the tangent of the pose.
    pub along: Vector6<f64>,
    /// Information at fixed correspondences, 1/m².
    pub information_per_m2: f64,
    /// Share of it that is left where correspondences are sought anew, from 0 (blind) to 1.
    pub seen: f64,
}

impl Direction {
    /// What the scan sees of it, 1/m².
    pub fn seen_per_m2(&self) -> f64 {
        self.information_per_m2 * self.seen
    }
}

/// What a scan sees of each direction, the weakest first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observability {
    /// Root mean square range of the points: metres that a turn of one radian moves a usual point.
    pub usual_range_m: f64,
    /// The directions, by information at fixed correspondences.
    pub directions: [Direction; 6],
}

impl Observability {
    /// What planes tell of the directions that `keep` picks: information on `[rotation, translation]`.
    pub fn information_of(&self, keep: impl Fn(&Direction) -> bool) -> Matrix6<f64> {
        let kept = self.directions.iter().filter(|d| keep(d));
        let terms = kept.map(|d| d.along * d.along.transpose() * d.seen_per_m2());
        let scale = Matrix6::from_diagonal(&self.metres_per_unit());
        scale * terms.sum::<Matrix6<f64>>() * scale
    }

    /// Information on `[rotation, translation]` of any kind, without what it has of the directions that `drop` picks.
    pub fn without(
        &self,
        information: &Matrix6<f64>,
        drop: impl Fn(&Direction) -> bool,
    ) -> Matrix6<f64> {
        let kept = Matrix6::identity() - self.part(drop);
        kept * information * kept.transpose()
    }

    /// Takes a gradient by `[rotation, translation]` to its part along the directions that `keep` picks.
    pub fn part(&self, keep: impl Fn(&Direction) -> bool) -> Matrix6<f64> {
        let kept = self.directions.iter().filter(|d| keep(d));
        let kept: Matrix6<f64> = kept.map(|d| d.along * d.along.transpose()).sum();
        let metres = self.metres_per_unit();
        let to_metres = Matrix6::from_diagonal(&metres);
        let from_metres = Matrix6::from_diagonal(&metres.map(f64::recip));
        to_metres * kept * from_metres
    }

    /// Factors from `[rotation, translation]` to metres.
    fn metres_per_unit(&self) -> Vector6<f64> {
        let r = self.usual_range_m;
        Vector6::new(r, r, r, 1.0, 1.0, 1.0)
    }
}

/// Tries a registration that was found with `matches`, by shifts of `shift_m`. `None` where nothing agreed.
pub fn observability(
    points_in_rig: &[Vector3<f64>],
    found: &Registration,
    config: &RegistrationConfig,
    shift_m: f64,
    mut matches: impl FnMut(&[Vector3<f64>], &Se3, f64) -> Vec<Option<Match>>,
) -> Option<Observability> {
    let every = points_in_rig.len().div_ceil(POINTS).max(1);
    let points: Vec<Vector3<f64>> = points_in_rig.iter().step_by(every).copied().collect();
    let squares: f64 = points.iter().map(Vector3::norm_squared).sum();
    let usual_range_m = (squares / points.len() as f64).sqrt();
    if !(usual_range_m > 0.0) {
        return None;
    }
    let r = usual_range_m.recip();
    let per_metre = Vector6::new(r, r, r, 1.0, 1.0, 1.0);
    let scale = Matrix6::from_diagonal(&per_metre);
    let eigen = SymmetricEigen::new(scale * found.plane_information * scale);
    let mut order = [0, 1, 2, 3, 4, 5];
    order.sort_by(|a, b| eigen.eigenvalues[*a].total_cmp(&eigen.eigenvalues[*b]));
    let gate_m = 3.0 * config.min_kernel_m;
    let still = matches(&points, &found.world_from_rig, gate_m);
    let mut directions = order.map(|k| Direction {
        along: eigen.eigenvectors.column(k).into(),
        information_per_m2: eigen.eigenvalues[k].max(0.0),
        seen: 1.0,
    });
    for direction in directions.iter_mut().take(TRIED) {
        let (mut stayed, mut sought) = (0.0, 0.0);
        for sign in [-1.0, 1.0] {
            let step = direction.along.component_mul(&per_metre) * (sign * shift_m);
            let pose = found.world_from_rig.retract(&step);
            let anew = matches(&points, &pose, gate_m);
            for ((point, before), after) in points.iter().zip(&still).zip(&anew) {
                // A point that finds no plane any more tells nothing of where it should be.
                let (Some(Match::Plane(before)), Some(Match::Plane(after))) = (before, after)
                else {
                    continue;
                };
                let cost_still = cost(point, before, &found.world_from_rig, config);
                stayed += cost(point, before, &pose, config) - cost_still;
                sought += cost(point, after, &pose, config) - cost_still;
            }
        }
        direction.seen = if stayed > 0.0 {
            (sought / stayed).clamp(0.0, 1.0)
        } else {
            0.0
        };
    }
    Some(Observability {
        usual_range_m,
        directions,
    })
}

/// Squared distance to a plane in standard deviations, never above what the kernel lets a point count (Geman and McClure).
fn cost(
    point: &Vector3<f64>,
    plane: &Plane,
    world_from_rig: &Se3,
    config: &RegistrationConfig,
) -> f64 {
    let off_m = plane.normal.dot(&(*world_from_rig * *point - plane.point));
    let sigma_m = config.range_noise_m.max(plane.thickness_m);
    let (squared, scale) = (off_m * off_m, config.min_kernel_m * config.min_kernel_m);
    scale * squared / (scale + squared) / (sigma_m * sigma_m)
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Matrix6;

    use super::super::{LocalMap, LocalMapConfig, PosePrior, ScanFinder, Weighting, register};
    use super::*;

    /// Points of the planes `y = ±2` and `z = −1.5` along x, no two scans at the same places, with a wall that ends them or without.
    fn walls(seed: u64, end_x_m: Option<f64>) -> Vec<Vector3<f64>> {
        let mut state = seed;
        // From 0 to 1, each number from the one before it (a linear congruence).
        let mut uniform = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(u32::MAX >> 1)
        };
        let mut points = Vec::new();
        for _ in 0..6000 {
            let (x, z) = (40.0 * uniform() - 20.0, 3.0 * uniform() - 1.5);
            let noise_m = 0.05 * (uniform() + uniform() - 1.0);
            points.push(Vector3::new(x, 2.0 + noise_m, z));
            points.push(Vector3::new(x, -2.0 - noise_m, z));
            points.push(Vector3::new(x, 4.0 * uniform() - 2.0, -1.5 + noise_m));
        }
        for _ in 0..600 {
            let (y, z) = (4.0 * uniform() - 2.0, 3.0 * uniform() - 1.5);
            let noise_m = 0.05 * (uniform() + uniform() - 1.0);
            points.extend(end_x_m.map(|x| Vector3::new(x + noise_m, y, z)));
        }
        points
    }

    /// What is seen in a corridor along x, with or without an end.
    fn seen_in(end_x_m: Option<f64>) -> Observability {
        let config = RegistrationConfig {
            max_iterations: 30,
            gate_m: 0.5,
            min_kernel_m: 0.09,
            range_noise_m: 0.03,
            point_noise_m: 0.08,
            points_per_independent: 4.0,
            weighting: Weighting::Tightening,
        };
        let mut map = LocalMap::new(LocalMapConfig {
            cell_size_m: 1.0,
            levels: 3,
            range_noise_m: 0.03,
        });
        for k in 0..4 {
            let sensor = Vector3::new(0.1 * k as f64, 0.0, 0.0);
            map.insert(&walls(k, end_x_m), &Se3::identity(), &sensor);
        }
        let points = walls(9, end_x_m);
        let prior = PosePrior {
            world_from_rig: Se3::identity(),
            information: Matrix6::identity(),
        };
        let sensor = Vector3::zeros();
        let mut finder = ScanFinder::new(&map, &points, &sensor);
        let found = register(&points, &prior, &config, |pose, gate_m| {
            finder.find_all(pose, gate_m)
        });
        let seen = observability(&points, &found, &config, 0.125, |points, pose, gate_m| {
            ScanFinder::new(&map, points, &sensor).find_planes(pose, gate_m)
        });
        seen.expect("points agree")
    }

    /// Naively the corridor without end holds its place: nearest points and planes that lean by a degree say so.
    #[test]
    fn a_corridor_without_end_is_blind_along_it_and_one_with_an_end_is_not() {
        let endless = seen_in(None);
        let along = endless.directions[0];
        assert!(along.along[3].abs() > 0.99, "{along:?}");
        assert!(along.seen_per_m2() < 1500.0, "{along:?}");
        for other in &endless.directions[1..] {
            assert!(other.seen_per_m2() > 15_000.0, "{other:?}");
        }
        let ended = seen_in(Some(6.0));
        for direction in &ended.directions {
            assert!(direction.seen_per_m2() > 5000.0, "{direction:?}");
        }
        let seen = |d: &Direction| d.seen_per_m2() > 1500.0;
        let x = Vector6::new(0.0, 0.0, 0.0, 1.0, 0.0, 0.0);
        let along_it = |information: Matrix6<f64>| x.dot(&(information * x));
        assert!(along_it(endless.information_of(seen)) < 100.0);
        assert!(along_it(ended.information_of(seen)) > 5000.0);
    }
}
