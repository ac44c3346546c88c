//! Whether a map is in view from where a device truly is.
//!
//! No estimator is asked: points of the map are in view that lie within an image and were mapped from much the same side and distance, from where
//! nothing stood before them. What has been moved there since is not known to it.

use lsfb_geometry::{Rig, Se3, Vector3};
use lsfb_pipeline::hd_map::HdMap;

/// With so many points in view a device can be placed.
const ENOUGH_POINTS: usize = 30;
/// As features look much the same: seen from within so many degrees, and up to so many times farther or nearer.
const SAME_SIDE_DEG: f64 = 25.0;
const SAME_DISTANCE: f64 = 1.6;

/// A map's points with the places from which they were mapped.
pub struct MapInView {
    points: Vec<(Vector3<f64>, Vec<Vector3<f64>>)>,
}

impl MapInView {
    pub fn new(map: &HdMap) -> Self {
        let places: Vec<Vector3<f64>> = map
            .keyframes()
            .map(|keyframe| keyframe.world_from_rig.translation)
            .collect();
        let points = (0..).zip(map.positions()).map(|(number, point)| {
            let seen = map.observations(number);
            let from = seen.filter_map(|o| places.get(o.keyframe as usize).copied());
            (point, from.collect())
        });
        Self {
            points: points.collect(),
        }
    }

    /// Whether enough of the map is in view of the cameras of a rig, all of them together.
    pub fn is_seen(&self, rig: &Rig, map_from_rig: &Se3) -> bool {
        let cameras: Vec<_> = rig.cameras.values().collect();
        let place = map_from_rig.translation;
        let rig_from_map = map_from_rig.inverse();
        let mut seen = self.points.iter().filter(|(point, mapped_from)| {
            let in_rig = rig_from_map * *point;
            let is_in_image = cameras.iter().any(|camera| {
                let pixel = camera
                    .camera
                    .project(&(camera.rig_from_camera.inverse() * in_rig));
                pixel.is_some_and(|pixel| camera.camera.contains(&pixel, 0.0))
            });
            is_in_image
                && mapped_from
                    .iter()
                    .any(|from| is_alike(&(place - point), &(from - point)))
        });
        seen.nth(ENOUGH_POINTS - 1).is_some()
    }
}

/// Whether a point looks much the same from two places, which are given from it.
fn is_alike(here: &Vector3<f64>, there: &Vector3<f64>) -> bool {
    let (near, far) = (here.norm().min(there.norm()), here.norm().max(there.norm()));
    far <= SAME_DISTANCE * near && here.angle(there).to_degrees() <= SAME_SIDE_DEG
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, CameraTiming, Matrix3, RigCamera, UnitQuaternion};

    use super::*;

    /// Points of a wall that were mapped from before it are in view from there; not from behind it, though they lie in the image, nor from far away.
    #[test]
    fn a_wall_is_in_view_from_where_it_was_mapped() {
        let forward = Matrix3::new(0.0, 0.0, 1.0, -1.0, 0.0, 0.0, 0.0, -1.0, 0.0);
        let mut rig = Rig::empty("phone");
        let camera = RigCamera {
            camera: Camera::pinhole(320, 240, [200.0; 2], [159.5, 119.5]),
            rig_from_camera: Se3::new(UnitQuaternion::from_matrix(&forward), Vector3::zeros()),
            timing: CameraTiming::default(),
            sigmas: Default::default(),
        };
        rig.cameras.insert("cam0".to_owned(), camera);
        let wall = |count: i32| MapInView {
            points: (0..count)
                .map(|k| {
                    let (column, row) = (f64::from(k % 8) - 3.5, f64::from(k / 8) - 2.5);
                    let point = Vector3::new(4.0, 0.2 * column, 0.2 * row);
                    (point, vec![Vector3::zeros()])
                })
                .collect(),
        };
        let at = |x: f64, turned: f64| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), turned);
            Se3::new(turn, Vector3::new(x, 0.1, 0.0))
        };
        let is_seen = |count, place: &Se3| wall(count).is_seen(&rig, place);
        assert!(is_seen(48, &at(0.3, 0.0)));
        assert!(!is_seen(20, &at(0.3, 0.0)), "a few points");
        assert!(!is_seen(48, &at(0.3, 2.0)), "looks away");
        assert!(
            !is_seen(48, &at(8.0, std::f64::consts::PI)),
            "behind the wall"
        );
        assert!(!is_seen(48, &at(-8.0, 0.0)), "far away");
    }
}
