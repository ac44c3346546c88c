//! Pairs of images with a known motion: which of a folder's images show enough of the same, from places far enough apart.

use lsfb_geometry::{Camera, Se3, Vector2};
use lsfb_pipeline::features::Features;
use lsfb_pipeline::features::matching::{DescriptorSet, MatchConfig, RayFeatures, match_epipolar};
use lsfb_pipeline::features::triangulation::{TriangulationConfig, View, triangulate};
use lsfb_types::median;

/// An image with its pose.
pub struct Placed<'a> {
    pub camera: &'a Camera,
    pub world_from_camera: Se3,
    /// Any feature: they tell how deep the scene is, and nothing else.
    pub features: &'a Features,
}

/// Images near one another with which an image is matched for its depth.
const NEIGHBOURS: usize = 4;
/// Points that say how deep a scene is.
const FEWEST_POINTS: usize = 12;
/// Matches lie this near to their epipolar planes, radians.
const MATCH_ANGLE_RAD: f64 = 0.01;
/// Share of each image that the other sees, at least.
const LEAST_OVERLAP: f64 = 0.3;
/// Least distance between the cameras, share of the depth: nearer ones have no direction to speak of.
const LEAST_BASELINE: f64 = 0.05;

/// At most `limit` pairs, evenly over all that qualify: by the median depth of each image, and not by what any feature matches.
pub fn choose(images: &[Placed], limit: usize) -> Vec<(usize, usize)> {
    let sets: Vec<Described> = images.iter().map(Described::new).collect();
    let depths: Vec<Option<f64>> = (0..images.len()).map(|i| depth(images, &sets, i)).collect();
    let mut pairs = Vec::new();
    for first in 0..images.len() {
        for second in first + 1..images.len() {
            let (Some(near), Some(far)) = (depths[first], depths[second]) else {
                continue;
            };
            let baseline = offset(&images[first], &images[second]).norm();
            let shares = [
                seen_share(&images[first], &images[second], near),
                seen_share(&images[second], &images[first], far),
            ];
            let overlaps = shares.iter().all(|s| *s >= LEAST_OVERLAP);
            if overlaps && baseline >= LEAST_BASELINE * near.max(far) {
                pairs.push((first, second));
            }
        }
    }
    let count = pairs.len();
    let wanted = limit.min(count);
    (0..wanted)
        .map(|k| pairs[(2 * k + 1) * count / (2 * wanted)])
        .collect()
}

fn offset(a: &Placed, b: &Placed) -> lsfb_geometry::Vector3<f64> {
    b.world_from_camera.translation - a.world_from_camera.translation
}

/// What matching by a known pose needs.
struct Described {
    descriptors: DescriptorSet,
    rays: Vec<lsfb_geometry::Vector3<f64>>,
}

impl Described {
    fn new(image: &Placed) -> Self {
        let keypoints = image.features.keypoints.iter();
        let rays = keypoints.map(|k| image.camera.unproject(&k.pixel_f64()).unwrap_or_default());
        Self {
            descriptors: DescriptorSet::new(&image.features.descriptors),
            rays: rays.collect(),
        }
    }

    fn as_rays(&self) -> RayFeatures<'_> {
        RayFeatures {
            descriptors: &self.descriptors,
            rays: &self.rays,
        }
    }
}

/// Median distance of the points that an image shares with its neighbours.
fn depth(images: &[Placed], sets: &[Described], index: usize) -> Option<f64> {
    let here = &images[index];
    let axis = |image: &Placed| image.world_from_camera.rotation * lsfb_geometry::Vector3::z();
    let mut near: Vec<(f64, usize)> = (0..images.len())
        .filter(|k| axis(&images[*k]).dot(&axis(here)) > 0.8)
        .map(|k| (offset(here, &images[k]).norm(), k))
        .filter(|(baseline, _)| *baseline > 0.0)
        .collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let config = TriangulationConfig {
        min_views: 2,
        min_depth_m: 0.0,
        ..TriangulationConfig::default()
    };
    let mut found = Vec::new();
    for (_, other) in near.into_iter().take(NEIGHBOURS) {
        let there = &images[other];
        let there_from_here = there.world_from_camera.inverse() * here.world_from_camera;
        let (first, second) = (sets[index].as_rays(), sets[other].as_rays());
        let matches = match_epipolar(
            first,
            second,
            &there_from_here,
            MATCH_ANGLE_RAD,
            &MatchConfig::default(),
        );
        for m in matches {
            let seen = [(here, m.first), (there, m.second)];
            let views = seen.map(|(image, keypoint)| View {
                camera: image.camera,
                world_from_camera: image.world_from_camera,
                pixel: image.features.keypoints[keypoint as usize].pixel_f64(),
            });
            let point = triangulate(&views, &config).ok();
            found.extend(
                point.map(|p| (p.point_in_world - here.world_from_camera.translation).norm()),
            );
        }
    }
    match found.len() < FEWEST_POINTS {
        true => None,
        false => median(found),
    }
}

/// Share of an image that another would see if all of it were at this distance.
fn seen_share(from: &Placed, by: &Placed, distance: f64) -> f64 {
    const CELLS: [u32; 2] = [16, 12];
    let by_from = by.world_from_camera.inverse() * from.world_from_camera;
    let mut seen = 0;
    for row in 0..CELLS[1] {
        for column in 0..CELLS[0] {
            let at = |k: u32, cells: u32, side: u32| {
                (f64::from(k) + 0.5) / f64::from(cells) * f64::from(side) - 0.5
            };
            let pixel = Vector2::new(
                at(column, CELLS[0], from.camera.width),
                at(row, CELLS[1], from.camera.height),
            );
            let point = from
                .camera
                .unproject(&pixel)
                .map(|ray| by_from * (ray * distance));
            let there = point.and_then(|point| by.camera.project(&point));
            seen += u32::from(there.is_some_and(|pixel| by.camera.contains(&pixel, 0.0)));
        }
    }
    f64::from(seen) / f64::from(CELLS[0] * CELLS[1])
}

#[cfg(test)]
mod tests {
    use lsfb_geometry::Vector3;
    use lsfb_pipeline::features::{Descriptor, Keypoint};
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    #[test]
    fn pairs_overlap_and_are_apart() {
        let camera = Camera::pinhole(640, 480, [500.0; 2], [319.5, 239.5]);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let points: Vec<(Vector3<f64>, Descriptor)> = (0..600)
            .map(|_| {
                let at = Vector3::new(
                    rng.random_range(-6.0..6.0),
                    rng.random_range(-2.0..2.0),
                    5.0,
                );
                (at, std::array::from_fn(|_| rng.random_range(0..90)))
            })
            .collect();
        // Along a wall: a hand's breadth on, a metre, three metres, nine metres, and one that looks the other way.
        let mut poses: Vec<Se3> = [0.0, 0.1, 1.0, 3.0, 9.0]
            .map(|x| Se3::new(Default::default(), Vector3::new(x, 0.0, 0.0)))
            .to_vec();
        poses.push(Se3::new(
            lsfb_geometry::UnitQuaternion::from_euler_angles(0.0, 3.1, 0.0),
            Vector3::new(0.5, 0.0, 0.0),
        ));
        let features: Vec<Features> = poses
            .iter()
            .map(|pose| {
                let mut found = Features::default();
                for (point, look) in &points {
                    let seen = camera.project(&(pose.inverse() * *point));
                    if let Some(at) = seen.filter(|at| camera.contains(at, 0.0)) {
                        found.keypoints.push(Keypoint {
                            pixel: [at.x as f32, at.y as f32],
                            scale_px: 2.0,
                            angle_rad: 0.0,
                            response: 1.0,
                        });
                        found.descriptors.push(*look);
                    }
                }
                found
            })
            .collect();
        let images: Vec<Placed> = poses
            .iter()
            .zip(&features)
            .map(|(pose, features)| Placed {
                camera: &camera,
                world_from_camera: *pose,
                features,
            })
            .collect();
        let pairs = choose(&images, 100);
        // 0.1 m of 5 m is too near; of the 6.4 m that an image shows 3 m leave half.
        assert_eq!(pairs, [(0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]);
        assert_eq!(choose(&images, 1), [(1, 2)]);
        assert!(choose(&images, 0).is_empty());
        assert!(choose(&[], 5).is_empty());
    }
}
