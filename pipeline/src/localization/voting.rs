//! Which images of the map see what a query sees.

use lsfb_geometry::{Se3, Vector3};

use crate::hd_map::{HdMap, MapNeighbour};

/// A map image: one camera of one keyframe.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct MapView {
    pub keyframe: u32,
    pub camera: u16,
}

/// Of two images the nearer one; where they look in opposite directions that counts as so many metres, twice.
const DIRECTION_M: f64 = 4.0;

/// The map's images and what they share.
#[derive(Clone, Debug)]
pub(crate) struct Places {
    /// Points of each image, ascending.
    points: Vec<Vec<u32>>,
    /// Images that see each point, by number.
    seen_by: Vec<Vec<u32>>,
    /// The images, by number.
    images: Vec<MapView>,
}

/// What one feature may show: candidates of the map, nearest first.
pub(crate) type Candidates = Vec<MapNeighbour>;

impl Places {
    pub fn new(map: &HdMap) -> Self {
        let mut all: Vec<MapView> = (0..map.point_count() as u32)
            .flat_map(|point| map.observations(point))
            .map(|o| MapView {
                keyframe: o.keyframe,
                camera: o.camera,
            })
            .collect();
        all.sort_unstable();
        all.dedup();
        let mut points = vec![Vec::new(); all.len()];
        let mut seen_by = Vec::with_capacity(map.point_count());
        for point in 0..map.point_count() as u32 {
            let mut images: Vec<u32> = map
                .observations(point)
                .filter_map(|o| {
                    let place = MapView {
                        keyframe: o.keyframe,
                        camera: o.camera,
                    };
                    all.binary_search(&place).ok().map(|i| i as u32)
                })
                .collect();
            images.sort_unstable();
            images.dedup();
            for image in &images {
                points[*image as usize].push(point);
            }
            seen_by.push(images);
        }
        Self {
            points,
            seen_by,
            images: all,
        }
    }

    /// Number of each image and `world_from_camera` of it; `None` where the map does not say.
    fn poses<'a>(&'a self, map: &'a HdMap) -> impl Iterator<Item = (u32, Option<Se3>)> + 'a {
        let pose = |view: &MapView| {
            let name = map.cameras().get(usize::from(view.camera))?;
            let mounted = map.rig().cameras.get(name)?;
            Some(map.keyframe(view.keyframe)?.world_from_rig * mounted.rig_from_camera)
        };
        let images = self.images.iter().map(pose);
        (0..).zip(images)
    }

    /// Numbers of the images that look most as a camera does from a pose, `count` at most.
    pub fn nearest(&self, map: &HdMap, world_from_camera: &Se3, count: usize) -> Vec<u32> {
        let ahead = |pose: &Se3| pose.rotation * Vector3::z();
        let away = |pose: &Se3| {
            let apart_m = (pose.translation - world_from_camera.translation).norm();
            apart_m + DIRECTION_M * (1.0 - ahead(pose).dot(&ahead(world_from_camera)))
        };
        let mut images: Vec<(f64, u32)> = self
            .poses(map)
            .filter_map(|(image, pose)| Some((away(&pose?), image)))
            .collect();
        images.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        images.truncate(count);
        images.into_iter().map(|(_, image)| image).collect()
    }

    /// Images with at least `min_votes`, most votes first. A feature votes once for each image that sees a candidate
    /// of it.
    pub fn vote(&self, features: &[Candidates], min_votes: u32) -> Vec<Vote> {
        let mut votes = vec![0u32; self.points.len()];
        let mut images: Vec<u32> = Vec::new();
        for candidates in features {
            images.clear();
            for c in candidates {
                images.extend(&self.seen_by[c.point as usize]);
            }
            images.sort_unstable();
            images.dedup();
            images.iter().for_each(|i| votes[*i as usize] += 1);
        }
        let mut ranked: Vec<Vote> = votes
            .iter()
            .enumerate()
            .filter(|(_, votes)| **votes >= min_votes.max(1))
            .map(|(image, votes)| Vote {
                image: image as u32,
                votes: *votes,
            })
            .collect();
        ranked.sort_by_key(|v| (std::cmp::Reverse(v.votes), v.image));
        ranked
    }

    /// The image itself and those that share most points with it.
    pub fn neighbourhood(&self, image: u32, size: usize) -> Vec<u32> {
        let mut shared = vec![0u32; self.points.len()];
        for point in &self.points[image as usize] {
            for other in &self.seen_by[*point as usize] {
                shared[*other as usize] += 1;
            }
        }
        let mut order: Vec<u32> = (0..shared.len() as u32)
            .filter(|i| shared[*i as usize] > 0)
            .collect();
        order.sort_by_key(|i| (std::cmp::Reverse(shared[*i as usize]), *i));
        order.truncate(size.max(1));
        order
    }

    /// Points that any of these images sees, ascending.
    pub fn points_of(&self, images: &[u32]) -> Vec<u32> {
        let mut points: Vec<u32> = images
            .iter()
            .flat_map(|i| self.points[*i as usize].iter().copied())
            .collect();
        points.sort_unstable();
        points.dedup();
        points
    }
}

/// Votes for an image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Vote {
    pub image: u32,
    pub votes: u32,
}
