//! Which points of the map a camera must see from a place, if they are there.
//!
//! That an image of the map shows a point does not say that it is seen from beside that image: a stand, a shelf or a corner may be in
//! between, the more likely the farther away the point is, however small the angle between the two views. What nothing hid while the
//! scanner went past it does say so: seen from several places, a point is seen from between them, and from a little beyond. So a point is
//! expected only in views that differ from one of the map's by less than those differ from their mean.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use lsfb_geometry::Vector3;

use crate::hd_map::HdMap;

/// A point is expected where a camera of the map that saw it is no farther away than this share of the point's distance: descriptors
/// change with the view.
const NEAR_SHARE: f64 = 0.5;
/// How many times as far from the point as that camera the other may be, and how many times nearer: they change with the scale too.
const LARGEST_SCALE: f64 = 1.6;

/// Where the images of a map saw its points from.
pub(super) struct Views<'a> {
    map: &'a HdMap,
    images: Vec<MapImage>,
    /// Of each point how far away it was where it was smallest, metres a pixel of focal length.
    smallest: Vec<f64>,
    /// Of each point the images that show it.
    seen_from: Vec<Vec<u32>>,
}

/// An image of the map.
struct MapImage {
    centre_in_world: Vector3<f64>,
    points: Vec<SeenPoint>,
    /// The largest of their distances, metres.
    farthest_m: f64,
}

/// A point that an image shows.
struct SeenPoint {
    point: u32,
    away_m: f64,
}

impl<'a> Views<'a> {
    /// Of all points of a map.
    pub fn of(map: &'a HdMap) -> Self {
        let mut images: BTreeMap<(u32, u16), MapImage> = BTreeMap::new();
        let mut smallest = Vec::with_capacity(map.point_count());
        for (point, point_in_world) in (0..).zip(map.positions()) {
            let mut farthest = 0.0_f64;
            for seen in map.observations(point) {
                let name = map.cameras().get(usize::from(seen.camera));
                let mounted = name.and_then(|name| map.rig().cameras.get(name));
                let (Some(mounted), Some(keyframe)) = (mounted, map.keyframe(seen.keyframe)) else {
                    continue;
                };
                let world_from_camera = keyframe.world_from_rig * mounted.rig_from_camera;
                let image = images
                    .entry((seen.keyframe, seen.camera))
                    .or_insert_with(|| MapImage {
                        centre_in_world: world_from_camera.translation,
                        points: Vec::new(),
                        farthest_m: 0.0,
                    });
                let away_m = (point_in_world - image.centre_in_world).norm();
                image.farthest_m = image.farthest_m.max(away_m);
                image.points.push(SeenPoint { point, away_m });
                farthest = farthest.max(away_m / mounted.camera.focal_px()[0]);
            }
            smallest.push(farthest);
        }
        let images: Vec<MapImage> = images.into_values().collect();
        let mut seen_from = vec![Vec::new(); map.point_count()];
        for (image, shown) in (0..).zip(&images) {
            for seen in &shown.points {
                seen_from[seen.point as usize].push(image);
            }
        }
        Self {
            map,
            images,
            smallest,
            seen_from,
        }
    }

    /// How large a point is in an image, as a multiple of how large it is where the map's images show it smallest. Below one nobody knows
    /// whether a detector finds it: what is smaller than the finest scale is not there for it.
    pub fn size(&self, point: u32, away_m: f64, focal_px: f64) -> f64 {
        let smallest = self.smallest.get(point as usize).copied();
        smallest.unwrap_or(0.0) * focal_px / away_m.max(f64::MIN_POSITIVE)
    }

    /// Smallest angle at a point between the way to a place in the world and those to the images of the map that show it, radians.
    pub fn aside_rad(&self, point: u32, centre_in_world: &Vector3<f64>) -> f64 {
        let Some(point_in_world) = self.map.position(point) else {
            return PI;
        };
        let here = centre_in_world - point_in_world;
        let seen_from = self.seen_from.get(point as usize).into_iter().flatten();
        let angles = seen_from.map(|image| {
            let there = self.images[*image as usize].centre_in_world - point_in_world;
            here.angle(&there)
        });
        angles.fold(PI, f64::min)
    }

    /// Points that a camera at a place in the world must see if it looks at them, in order.
    pub fn expected(&self, centre_in_world: &Vector3<f64>) -> Vec<u32> {
        let mut points: Vec<u32> = Vec::new();
        for image in &self.images {
            let apart_m = (image.centre_in_world - centre_in_world).norm();
            if apart_m <= NEAR_SHARE * image.farthest_m {
                let near = image.points.iter();
                let near = near.filter(|seen| apart_m <= NEAR_SHARE * seen.away_m);
                let alike = near.filter(|seen| self.is_alike(image, seen, centre_in_world));
                points.extend(alike.map(|seen| seen.point));
            }
        }
        points.sort_unstable();
        points.dedup();
        points
    }

    /// Whether a camera at a place sees a point much as an image does, or from between it and others that see it.
    fn is_alike(&self, image: &MapImage, seen: &SeenPoint, centre_in_world: &Vector3<f64>) -> bool {
        let known = self.map.position(seen.point);
        let Some((point_in_world, quality)) = known.zip(self.map.quality(seen.point)) else {
            return false;
        };
        let own = image.centre_in_world - point_in_world;
        let other = centre_in_world - point_in_world;
        let (own_m, other_m) = (seen.away_m, other.norm());
        let scale_is_alike = other_m <= LARGEST_SCALE * own_m && own_m <= LARGEST_SCALE * other_m;
        // `view_cos` is the cosine of the largest angle between the mean of the map's views and one of them.
        scale_is_alike && own.dot(&other) >= quality.view_cos * own_m * other_m
    }
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::{Camera, CameraTiming, Rig, RigCamera, Se3, StampedPose};
    use lsfb_types::{Timestamp, no_progress};

    use super::*;
    use crate::features::{Feature, Features, Keypoint};
    use crate::hd_map::{HdMapConfig, KeyframeImage, MapContent, MapPoint, PointObservation};

    /// Images along a line, at these places in metres; each point is 24 m in front of it, and seen by some of the images.
    fn map(along_m: &[f64], seen_by: &[&[usize]]) -> HdMap {
        let mut rig = Rig::empty("one");
        let camera = RigCamera {
            camera: Camera::pinhole(640, 480, [400.0, 400.0], [319.5, 239.5]),
            rig_from_camera: Se3::identity(),
            timing: CameraTiming::default(),
            sigmas: Default::default(),
        };
        rig.cameras.insert("cam0".to_owned(), camera);
        let keyframes: Vec<StampedPose> = (0..)
            .zip(along_m)
            .map(|(k, x)| StampedPose {
                time: Timestamp::from_nanos(k),
                world_from_rig: Se3::new(Default::default(), Vector3::new(*x, 0.0, 0.0)),
            })
            .collect();
        let keypoint = Keypoint {
            pixel: [320.0, 240.0],
            scale_px: 2.0,
            angle_rad: 0.0,
            response: 0.1,
        };
        let images: Vec<KeyframeImage> = (0..along_m.len())
            .map(|keyframe| KeyframeImage {
                keyframe,
                camera: "cam0".to_owned(),
                features: Features {
                    keypoints: vec![keypoint; seen_by.len()],
                    descriptors: (0..seen_by.len()).map(|k| [k as u8; 128]).collect(),
                },
            })
            .collect();
        let points: Vec<MapPoint> = (0..)
            .zip(seen_by)
            .map(|(keypoint, images)| MapPoint {
                point_in_world: Vector3::new(0.0, 0.0, 24.0),
                observations: images
                    .iter()
                    .map(|image| PointObservation {
                        image: *image,
                        keypoint,
                    })
                    .collect(),
                reprojection_rms_px: 0.5,
            })
            .collect();
        let content = MapContent {
            rig: &rig,
            keyframes: &keyframes,
            images: &images,
            points: &points,
            feature: &Feature::Sift,
            provenance: "made up",
        };
        HdMap::build(&content, &HdMapConfig::default(), &no_progress).expect("consistent content")
    }

    /// In a hall, walked 5 m beside the scanner's path, all points that were looked for were behind the stands, none was found, and right
    /// walks were refused: two images side by side saw them, at an angle of 12° to the walk's camera.
    #[test]
    fn a_point_seen_through_a_gap_is_not_expected_from_far_beside_it() {
        let through_a_gap: &[usize] = &[1, 2];
        let from_all_along: &[usize] = &[0, 1, 2, 3];
        let map = map(&[-9.0, -0.2, 0.2, 9.0], &[through_a_gap, from_all_along]);
        let views = Views::of(&map);
        let expected = |x, z| views.expected(&Vector3::new(x, 0.0, z));
        assert_eq!(expected(0.0, 0.0), [0, 1]);
        assert_eq!(expected(5.0, 0.0), [1]);
        assert_eq!(expected(0.0, 4.0), [0, 1], "nearer");
        assert_eq!(expected(0.0, 16.0), [0u32; 0], "much nearer");
        assert_eq!(expected(-12.0, 0.0), [1], "a little beyond all");
        assert_eq!(expected(-24.0, 0.0), [0u32; 0], "far beyond all");
        let aside = |point, x: f64| views.aside_rad(point, &Vector3::new(x, 0.0, 0.0));
        let angle = |x: f64| (x / 24.0).atan();
        assert!(aside(1, 0.2).abs() < 1e-6);
        assert!((aside(0, 5.0) - (angle(5.0) - angle(0.2))).abs() < 1e-6);
        assert!((aside(1, 5.0) - (angle(9.0) - angle(5.0))).abs() < 1e-6);
    }

    /// Glasses whose lens is wider than the scanner's, farther away than it was, did not find a third of what was there.
    #[test]
    fn a_point_is_as_large_as_lens_and_distance_make_it() {
        let map = map(&[0.0, 0.2, 10.0], &[&[0, 1], &[0, 1, 2]]);
        let views = Views::of(&map);
        let size = |point, away_m, focal_px| views.size(point, away_m, focal_px);
        assert!((size(0, 24.0, 400.0) - 1.0).abs() < 1e-3);
        assert!((size(0, 36.0, 300.0) - 0.5).abs() < 1e-3);
        assert!((size(1, 26.0, 400.0) - 1.0).abs() < 1e-3, "seen from 26 m");
    }
}
